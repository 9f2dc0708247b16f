"""Motion features: what effects do along the motion that was measured, before it passes through the rig.

Elements move smoothly: a law there looks at one of a few samples. Commands jump, and readings are rounded at each
sample. What candidates do is kept for the next screen of the same motion.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.inference.discovery import compiled_laws
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.inference.discovery.candidates import Candidate
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.smoothing import Motion, modes
from masking.inference.estimation.identification_data import Data
from masking.lab.records.noise_estimate import bandwidth

KEPT = 4e7  # numbers of what candidates do along a motion that are kept for the next screen of it

Features = tuple[Array, Array]  # means (m, c), and the columns where they act (c,)
FEWEST = 200  # means of a record that are compared at least, however short it is
BEYOND = 2.0  # times the frequency at which readings fall below their noise: means over many samples show more


@dataclass
class Kept:
    """What candidates do along a motion, by their factors and instances."""

    features: dict[tuple[tuple[int, ...], EffectInstance], Features] = field(default_factory=dict)
    numbers: int = 0


@dataclass(frozen=True)
class MotionFeatures:
    """What effects do along a motion."""

    rig: AugmentedModel
    record: Data
    motion: Motion  # the smoothed record
    simulated: Array  # readings as they are simulated (m, sensors)
    thinning: Thinning  # samples over which means are taken
    kept: Kept = field(default_factory=Kept)  # what is known of this motion already; it is added to
    # what is followed, as `_followed` gives it
    courses: dict[tuple[str, str, bool], tuple[Array, Array, int, int]] = field(default_factory=dict, init=False)

    def with_slopes(self, instance: EffectInstance) -> Features:
        """Signal that an instance adds where it acts, with slopes by its free parameters."""
        if instance.effect == compiled_laws.DELAY:
            half = 0.5 / self.record.rate
            late, at = self.signal(instance)
            later, _ = self.signal(instance.with_values((0,), (instance.values[0] + half,)))
            return np.hstack([late, (later - late) / half]), np.concatenate([at, at])
        if instance.sticks:  # a motion that is known is followed in samples
            instance = instance.at_step(self.rig.mobilities[instance.at], 1.0 / self.record.rate)
        return self.signal(instance, instance.free)

    def by_factors(self, candidate: Candidate, instance: EffectInstance) -> Features:
        """Signal of a candidate for each of its factors."""
        known = self.kept.features.get((candidate.factors, instance))
        if known is not None:
            return known
        found = self._by_factors(candidate, instance)
        numbers = self.kept.numbers + found[0].size
        follows_fit = instance.where == "sensor"  # it acts on readings as they are simulated
        if instance in candidate.instances and not follows_fit and numbers < KEPT:
            self.kept.features[candidate.factors, instance], self.kept.numbers = found, numbers
        return found

    def _by_factors(self, candidate: Candidate, instance: EffectInstance) -> Features:
        if candidate.effect == compiled_laws.DELAY or not candidate.factors or instance.entry.scaled:
            return self.signal(instance)
        instance = instance.with_values(candidate.factors, np.zeros(len(candidate.factors)))
        features, at = self.signal(instance, candidate.factors)
        return np.ascontiguousarray(features[:, 1:]), at[1:]

    def signal(self, instance: EffectInstance, free: tuple[int, ...] = ()) -> Features:
        """Signal that an instance adds where it acts, with slopes by some parameters; by channel of a delay."""
        if instance.effect == compiled_laws.DELAY:
            return self._late(instance)
        x, rate, column, stride = self._followed(instance)
        made = self.rig.along(instance, x, rate, stride / self.record.rate, free)
        if instance.where != "element":
            made[:, 0] -= x
        return thinned(made, self.thinning.motion // stride), np.full(made.shape[1], float(column))

    def _followed(self, instance: EffectInstance) -> tuple[Array, Array, int, int]:
        """What an instance follows, its rate (m,), the column where it acts, and the samples of each of m."""
        where, is_inertia = instance.where, instance.entry.is_inertia
        if (where, instance.at, is_inertia) not in self.courses:
            rig, at, stride, rate = self.rig, self.rig.index(instance), 1, np.zeros(len(self.record))
            if where == "element":
                x, rate = self.motion.acted_on(instance.entry, at)
                column, stride = rig.columns[1][at], 1 if is_inertia else self.thinning.stride
            elif where == "actuator":
                x, column = self.record.acting[:, at], rig.columns[2][at]
            else:
                x, column = self.simulated[:, at], at
            # Commands make an acceleration jump: each sample of it counts, as of commands and readings.
            self.courses[where, instance.at, is_inertia] = middles(x, stride), middles(rate, stride), column, stride
        return self.courses[where, instance.at, is_inertia]

    def _late(self, instance: EffectInstance) -> Features:
        """Change of each command by a delay, and the columns where these act."""
        actuators, t = self.rig.twin.actuators, np.arange(len(self.record)) / self.record.rate
        at = [actuators.index(instance.at)] if instance.at else [*range(len(actuators))]
        commands = self.record.acting[:, at]
        late = np.column_stack([np.interp(t - instance.values[0], t, command) for command in commands.T])
        return thinned(late - commands, self.thinning.motion), np.array([self.rig.columns[2][i] for i in at], float)


@dataclass(frozen=True)
class Thinning:
    """Samples over which means are taken: of motions a multiple of the stride, of readings a multiple of that.

    Of a stride, a law in an element looks at the middle.
    """

    motion: int
    readings: int
    stride: int = 1

    @classmethod
    def of(cls, problem: EstimationProblem) -> Thinning:
        """Thinning that keeps what a record shows."""
        rig, record, rate = problem.rig, problem.record, problem.record.rate
        own = np.abs(modes(rig, rig.start).imag).max(initial=0.0) / (2.0 * np.pi)
        seen = min(problem.rules.screened_frequency, BEYOND * rate * bandwidth(record.readings))
        highest = max(seen, 2.0 * float(own), 0.5 * FEWEST * rate / len(record))
        motion = max(1, int(rate / (6.0 * highest)))
        stride = max(1, motion // 2)
        motion -= motion % stride
        return cls(motion, motion * max(1, int(rate / (2.0 * highest) / motion)), stride)


def middles(samples: Array, stride: int) -> Array:
    """Middle of every `stride` samples of a table (m, c): a sample, or the mean of two."""
    cut = samples[: len(samples) // stride * stride]
    return np.asarray(0.5 * (cut[(stride - 1) // 2 :: stride] + cut[stride // 2 :: stride]))


def thinned(table: Array, thin: int) -> Array:
    """Means over `thin` samples of a table (m, c)."""
    cut = table[: len(table) // thin * thin]
    total = cut[0::thin].copy()
    for i in range(1, thin):  # measured: of few columns a sixth of the time of a mean over an axis
        total += cut[i::thin]
    return np.asarray(np.ascontiguousarray(total / thin))
