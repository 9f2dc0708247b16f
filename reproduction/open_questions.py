"""What the source document announces or asks and does not compute: sections 3.1 and 10.2."""

from __future__ import annotations

import math

import numpy as np

from masking.analysis.stability.modes import modes, state_matrix, upsilon
from masking.analysis.synchronisation import mean_phase, running_peak
from masking.model.modelling.model import Model, load_model
from reproduction.comparison import Entry, Value, experimental
from reproduction.motion import Motion, masked, on_twin, simulated
from reproduction.plots import curves

HEAVIER = 10.0
LONGEST, HALVINGS = 1500.0, 6
NEAR = 0.2  # of pi
LAWS = {
    "the beam alone": {},
    "a spring between the oscillators, 0.1": {"spring": 0.1},
    "a damper of the sum, 0.05": {"of_sum": 0.05},
    "a damper of the difference, 0.05": {"of_difference": 0.05},
}
WANTED = {"anti-phase": {"of_sum": 0.05, "r": 0.1}, "in phase": {"of_difference": 0.05, "r": 0.1}}
DURATION = 400.0  # tau of an experiment with a coupling law
DECIMALS = 12  # of a decay: what is less is rounding


def heavy_beam() -> Entry:
    """Section 3.1: the mass of the beam may be varied by a factor of 10."""
    model = load_model("setup_identical")
    p, root = model.parameter_values(), math.sqrt(HEAVIER)
    heavy = model.with_parameters(
        mu1=p["mu1"] / HEAVIER, mu2=p["mu2"] / HEAVIER, w3=p["w3"] / root, z3=p["z3"] / root
    ).dimensionless()
    beams = {"beam as it is": model.dimensionless(), "beam ten times as heavy": heavy}
    motions = {name: simulated(m, 600.0) for name, m in beams.items()}
    rows = [Value(f"synchronisation time upsilon (8.13), {name}", upsilon(m)) for name, m in beams.items()]
    rows += [Value(f"largest displacement of the {name}", float(np.abs(m.c).max())) for name, m in motions.items()]
    words = (
        "Section 3.1 says that the mass of the beam may be varied by a factor of 10, which adjusts the strength of the "
        "coupling; no experiment does. Ten times the mass, on the same spring and damper, divides mu_i by 10, and w3 "
        "and z3 by the root of 10. Identical oscillators still synchronise, "
        f"{upsilon(heavy) / rows[0].ours:.0f} times as slowly: the beam is also further from "
        "their frequency, and its damping per mass is a tenth.",
    )
    return Entry("Section 3.1", "A beam ten times as heavy", "open question", tuple(rows), words)


def weakest_coupling() -> Entry:
    """Section 10.2: for which minimal coupling strength synchronisation starts to occur in practice."""
    setup = load_model("setup_identical").parameter_values()["mu1"]
    found = {}
    for name, move in (("the virtual system by itself", _by_itself), ("the twin", _on_twin)):
        low, high = 0.0, setup
        for _ in range(HALVINGS):
            mu = 0.5 * (low + high)
            low, high = (low, mu) if _is_anti_phase(move(mu)) else (mu, high)
        found[name] = high
    alone, twin = found.values()
    resting = _on_twin(0.0)
    rows = (
        Value("least mu that synchronises by tau = 1500, the virtual system by itself", alone),
        *experimental(
            Value("least mu that synchronises by tau = 1500, on the twin", twin),
            Value("amplitude at tau = 1500 without coupling, on the twin", resting.amplitude()),
        ),
    )
    words = (
        "Section 10.2 asks for which minimal coupling strength synchronisation starts to occur in practice. The ideal "
        f"system synchronises with any mu > 0, in a time of about 1/mu. Released as in Fig. 5.1, with mu1 = mu2, and "
        f"with a phase within {NEAR} pi of anti-phase over the last fifth of tau = 1500, it takes a mu of "
        f"{alone:.4f} by itself and {twin:.4f} on the twin, where the rig has {setup:.4f}. The search halves an "
        f"interval {HALVINGS} times, so that both are known to {setup / 2**HALVINGS:.4f}.",
        f"Without coupling the oscillators stay in phase on the twin, and end with {resting.amplitude():.2f} strokes "
        "instead of 1: what the cancellation of damping and friction misses.",
    )
    return Entry("Section 10.2", "The weakest coupling that synchronises", "open question", rows, words)


def coupling_laws() -> Entry:
    """Section 10.2: different coupling laws."""
    rows: list[Value] = []
    shown: dict[str, Motion] = {}
    for name, parameters in LAWS.items():
        model = load_model("setup_controlled").with_parameters(**parameters).dimensionless()
        shown[name] = _law(parameters)
        slow, fast = _decays(model)
        rows += [
            Value(f"decay of the sum, {name}", slow),
            Value(f"decay of the difference, {name}", fast),
            *experimental(Value(f"phase / pi at tau = {DURATION:g} on the twin, {name}", _last_phase(shown[name]))),
        ]
    words = (
        "Section 10.2 proposes to investigate different coupling laws. Each acts beside the coupling through the beam. "
        "A spring between the oscillators raises the frequency of anti-phase motion and changes nothing in the decay "
        "of the sum, whose equation does not contain it. A damper of the sum takes the oscillators to anti-phase "
        "without waiting for the beam, one of the difference to in-phase motion, which then dies out by the beam.",
    )
    title = "Coupling laws"
    return Entry("Section 10.2, laws", title, "open question", tuple(rows), words, _drawn(shown, title))


def controlled() -> Entry:
    """Section 10.2: controlled synchronisation."""
    rows: list[Value] = []
    shown: dict[str, Motion] = {}
    for name, parameters in WANTED.items():
        model = load_model("setup_controlled").with_parameters(**parameters).dimensionless()
        ideal, shown[name] = simulated(model, DURATION), _law(parameters)
        for where, motion in (("the virtual system by itself", ideal), ("on the twin", shown[name])):
            last = (
                Value(f"phase / pi at tau = {DURATION:g}, {name}, {where}", _last_phase(motion)),
                Value(f"amplitude at tau = {DURATION:g}, {name}, {where}", motion.amplitude()),
            )
            rows += experimental(*last) if motion is not ideal else last
    words = (
        "Section 10.2 and the ENOC paper call the set-up suitable for controlled synchronisation and show none. Here a "
        "damper of the sum or of the difference of the velocities decides between anti-phase and in-phase motion, and "
        "a regulator of the energy keeps the amplitude, 0.4 strokes. In phase the beam moves and dissipates, so that "
        "the regulator, which is proportional, keeps less than it is asked for.",
    )
    title = "Controlled synchronisation, on the twin"
    return Entry("Section 10.2, control", title, "open question", tuple(rows), words, _drawn(shown, title))


def _drawn(shown: dict[str, Motion], title: str) -> bytes:
    """Draw the phase difference and the larger amplitude, over the last period, of several motions."""
    t = next(iter(shown.values())).t
    larger = {name: np.maximum(np.abs(m.a), np.abs(m.b)) for name, m in shown.items()}
    rows = [
        (r"$\Delta\varphi\,/\,\pi$", {name: m.phase / np.pi for name, m in shown.items()}),
        ("amplitude", {name: running_peak(t, x, 2.0 * math.pi) for name, x in larger.items()}),
    ]
    return curves(t, rows, r"$\tau$", title)


def _by_itself(mu: float) -> Motion:
    return simulated(load_model("setup_identical").with_parameters(mu1=mu, mu2=mu).dimensionless(), LONGEST)


def _on_twin(mu: float) -> Motion:
    return masked(on_twin("setup_identical", duration=LONGEST, parameters={"mu1": mu, "mu2": mu}))


def _law(parameters: dict[str, float]) -> Motion:
    return masked(
        on_twin("setup_identical", virtual="setup_controlled", duration=DURATION, parameters=dict(parameters))
    )


def _is_anti_phase(motion: Motion) -> bool:
    last = motion.phase[motion.t >= 0.8 * motion.t[-1]]
    return bool(np.abs(last - np.pi).max() < NEAR * np.pi)


def _last_phase(motion: Motion) -> float:
    return mean_phase(motion.phase[motion.t >= 0.9 * motion.t[-1]])[0] / np.pi


def _decays(model: Model) -> tuple[float, float]:
    """Return how fast the sum and the difference of the oscillators decay."""
    by_shape = {True: math.inf, False: math.inf}
    for mode in modes(state_matrix(model), model.coordinates).modes:
        a, b = (mode.shape[name] for name in model.oscillators)
        is_sum = abs(a + b) > abs(a - b)
        by_shape[is_sum] = min(by_shape[is_sum], -mode.eigenvalue.real)
    return round(by_shape[True], DECIMALS) + 0.0, round(by_shape[False], DECIMALS) + 0.0
