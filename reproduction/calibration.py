"""Calibration of the twin: `python -m reproduction.calibration` prints the values that `plants/tue_rig.yaml` rounds.

Appendix C.6 describes friction and hysteresis without their size. They are chosen so that the twin, identified as the
rig was in section 4.2, has the parameters that were found there:

* dry friction, one for all elements, by mu1 and mu2 of Table 4.4 in free motion;
* the displacement at which the hysteresis of the beam yields, by z3 of Table B.1 under the multisine and by its chi of
  Table 4.3. A longer one lowers both: that is taken with which z3 is as much too large as chi is too small. The beam
  has no other damping: with any that is viscous, z3 comes out larger still;
* the viscous damping of each oscillator, by its z of Table B.1 under the multisine.

The stiffness of the beam's hysteresis follows from Table B.4: what w3^2 has beyond the spring that a slow ramp sees.
Nothing else is chosen by a number of the source: frequencies and gains of the oscillators, and all other chi of Tables
4.3 and 4.5, are predictions.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from scipy.optimize import minimize_scalar, root_scalar

from masking.control.rig.twin import Twin
from masking.inference.estimation.fit import fit
from masking.inference.estimation.simulation import simulate
from reproduction.simulated_records import FREE, alone, free_motion, multisine_record

RATIOS: Final = ("mu1", "mu2")
CHI: Final = 0.2267  # Table 4.3: the beam under the multisine
FRICTION: Final = (5e-4, 2.5e-3)  # of l wbar^2
YIELD: Final = (8e-4, 1.6e-3)  # m
START: Final = 1.1e-3  # m
PASSES: Final = 2


def friction(share: float) -> dict[str, float]:
    """Return the parameters of the twin for a friction in parts of l wbar^2."""
    values = Twin.load("tue_rig").model.parameter_values()
    wbar = 0.5 * (values["w1"] + values["w2"])
    return {f"friction{i}_fc": share * values["l"] * wbar**2 for i in (1, 2, 3)}


def of_the_beam() -> tuple[float, float]:
    """Return the friction, in parts of l wbar^2, and the displacement in m at which the beam's hysteresis yields."""
    linear, beam = Twin.load("linear_rig"), alone(3, is_true=False)

    def off_in_free_motion(share: float) -> float:
        found = fit(linear, free_motion(friction(share) | {"hysteresis3_zmax": yields}), RATIOS).values
        return float(sum((a / linear.parameter_value(n) - 1.0) ** 2 for a, n in zip(found, RATIOS, strict=True)))

    def off_under_the_multisine(length: float) -> float:
        record = multisine_record(3, friction(share) | {"hysteresis3_zmax": length})
        z, chi = float(fit(beam, record, FREE).values[1]), simulate(beam, record).chi["s"]
        return z / beam.parameter_value("z") + chi / CHI - 2.0

    share, yields = 0.0, START
    for _ in range(PASSES):
        bounded = minimize_scalar(off_in_free_motion, bounds=FRICTION, method="bounded", options={"xatol": 5e-5})
        share = float(bounded.x)
        yields = float(root_scalar(off_under_the_multisine, bracket=YIELD, xtol=1e-5).root)
    return share, yields


def of_an_oscillator(number: int, others: Mapping[str, float]) -> float:
    """Return the viscous damping of an oscillator, in parts of the declared one.

    Args:
        number: 1 or 2.
        others: parameters of the twin that are calibrated already.
    """
    linear = alone(number, is_true=False)
    w, z = (linear.parameter_value(name) for name in FREE[:2])

    def off(share: float) -> float:
        record = multisine_record(number, {**others, f"damping{number}_c": share * 2.0 * z * w})
        return float(fit(linear, record, FREE).values[1]) - z

    return float(root_scalar(off, x0=0.0, x1=-0.05, xtol=1e-4).root)


def main() -> None:
    """Print the calibrated values."""
    share, yields = of_the_beam()
    print(f"friction: {share:.2g} l wbar^2\nhysteresis of the beam: yields at {1e3 * yields:.3g} mm")
    for number in (1, 2):
        print(f"damping{number}: {of_an_oscillator(number, friction(share)):.2g} of 2 z{number} w{number}")


if __name__ == "__main__":
    main()
