"""Motions of two oscillators on a beam: of a model by itself, and of a rig that is masked."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from masking.analysis.synchronisation import (
    Synchronisation,
    peak_sum,
    phase_difference,
    principal,
    synchronisation,
    synchronisation_time,
)
from masking.lab.runs.experiment import Experiment
from masking.model.modelling.model import Model
from masking.reports.style import Series

SAMPLE = 0.05  # units of dimensionless time
GROWN = 2.0  # of the first amplitude: what ends beyond has grown, also where the actuators' limits hold it there
# The controller of this project on the twin: its model has the measured springs, its observer estimates the rest.
OURS = {"rate": "1 kHz", "model": "setup_springs", "observer": "disturbance"}
# The document's: the linear model, and velocities from differences of positions.
THESIS = {"rate": "1 kHz", "observer": "differences"}


@dataclass(frozen=True)
class Motion:
    """Two oscillators and what couples them.

    Args:
        t: time (m,), dimensionless unless the model has no scales.
        a: first oscillator (m,), in the model's unit, as `b` and `c`.
        b: second oscillator (m,).
        c: what couples them (m,).
        names: of the three.
        chi: worst relative error against the ideal motion of an oscillator; NaN of a model by itself.
    """

    t: Series
    a: Series
    b: Series
    c: Series
    names: tuple[str, str, str]
    chi: float = math.nan

    @property
    def phase(self) -> Series:
        """Return the phase difference of the oscillators (m,), rad, in [-pi/2, 3 pi/2)."""
        return principal(phase_difference(self.t, self.a, self.b))

    def peak(self, tau: float, window: float) -> float:
        """Return the largest |a + b| over the `window` before a time."""
        return float(peak_sum(self.t, self.a, self.b, window)[np.searchsorted(self.t, tau - 1e-9)])

    def amplitude(self, fraction: float = 0.1) -> float:
        """Return the larger amplitude over the last part of the motion."""
        last = self.t >= self.t[-1] - fraction * (self.t[-1] - self.t[0])
        return float(max(np.abs(self.a[last]).max(), np.abs(self.b[last]).max()))

    def settled(self, part: float = 0.01) -> float:
        """Return the time from which on |a + b| stays below a part of the last amplitude (definition 8.1)."""
        return synchronisation_time(self.t, self.a + self.b, part * self.amplitude())

    def verdict(self) -> Synchronisation:
        """Return how the end of the motion is synchronised."""
        return synchronisation(self.t, self.a, self.b, names=self.names[:2])


def simulated(model: Model, end: float, *, sample: float = SAMPLE, tolerance: float = 1e-12) -> Motion:
    """Return the motion of a model from its declared initial state, to a time, every `sample` of time."""
    run = model.simulate(np.linspace(0.0, end, round(end / sample) + 1), tolerance=tolerance)
    first, second = model.oscillators[:2]
    third = next(c for c in model.coordinates if c not in (first, second))
    return Motion(run.times, run[first], run[second], run[third], (first, second, third))


def masked(experiment: Experiment) -> Motion:
    """Return the virtual motion of a rig that is masked."""
    made = experiment.run()
    first, second = experiment.virtual.oscillators[:2]
    third = next(c for c in experiment.virtual.coordinates if c not in (first, second))
    a, b, c = (made[f"virtual.{name}"] for name in (first, second, third))
    chi = max(made.manifest["masking_error"].values())
    return Motion(made.t / made.manifest["time_scale"], a, b, c, (first, second, third), chi)


def on_twin(name: str, *, controller: dict[str, object] | None = None, **sections: object) -> Experiment:
    """Return a packaged experiment on the twin of the rig, with sections of its file changed."""
    chosen = OURS if controller is None else controller
    return Experiment.load(name, plant="tue_rig").changed(controller=chosen, record=None, **sections)


def sustained(
    experiment: Experiment, *, largest: float, offsets: tuple[float, float] = (0.0, 0.0), steps: int = 10
) -> tuple[float, Motion]:
    """Tune the over-compensation of the damping until the motion neither dies nor grows, as section 5.4 does by hand.

    Bisects e, with e1 and e2 each e more than their offset, on the larger amplitude in the last tenth over that in the
    middle tenth.

    Args:
        experiment: with a virtual system that has parameters e1 and e2.
        largest: e with which the motion grows; -e is the least that is tried.
        offsets: of e1 and e2.
        steps: of the bisection.

    Returns:
        e, and the motion with it.
    """
    low, high = -largest if any(offsets) else 0.0, largest
    for _ in range(steps):
        e = 0.5 * (low + high)
        supply = {"e1": e + offsets[0], "e2": e + offsets[1]}
        motion = masked(experiment.changed(parameters={**experiment.declaration.parameters, **supply}))
        low, high = (low, e) if _grows(motion) else (e, high)
    return e, motion


def _grows(motion: Motion) -> bool:
    both, t = np.maximum(np.abs(motion.a), np.abs(motion.b)), motion.t / motion.t[-1]
    last = both[t > 0.9].max()
    return bool(last > both[(t > 0.45) & (t < 0.55)].max() or last > GROWN * both[0])
