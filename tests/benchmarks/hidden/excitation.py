"""Excitations: multisines of 25 lines on each actuator, and another excitation for validation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tests.benchmarks.hidden.rig import (
    ACTUATORS,
    ELEMENTS,
    LARGEST_COMMAND,
    RATE,
    SENSOR_GAIN,
    SENSORS,
    STROKE,
    Array,
    Damping,
    Rigs,
    declared,
    linear_response,
)

Shapes = Callable[[float, np.random.Generator], Array]  # (seconds, random) -> shapes (3, samples)

LINES = 25
PERIOD = 20.0  # s: the training lines are multiples of 1/20 Hz, up to 3.75 Hz
OTHER_PERIOD = 17.0  # s: those of the validation, up to 4.4 Hz
ALONE = np.array([0.45, 0.45, 0.8])  # part of the stroke that each actuator alone gives its own displacement
SLOWEST, FASTEST = 0.1, 4.0  # Hz: ends of the sweep
HOLD = (0.3, 1.5)  # s: how long a step lasts, at least and at most


def multisine(t: Array, lines: Array, period: float, rng: np.random.Generator) -> Array:
    """Return a sum of sines of equal amplitude and random phase at multiples (lines) of 1/period Hz, (len(t),)."""
    phases = rng.uniform(0.0, 2.0 * np.pi, len(lines))
    turns = np.exp(2j * np.pi * t / period)  # one turn per period
    powers = np.zeros(int(lines.max()) + 1, dtype=complex)
    powers[lines] = np.exp(1j * phases)
    total = np.zeros(len(t), dtype=complex)
    for coefficient in powers[::-1]:  # Horner's rule
        total = total * turns + coefficient
    return np.asarray(total.imag)


def training(seconds: float, rng: np.random.Generator) -> Array:
    """Return the shapes of the three commands (3, samples) of a training record: multisines with disjoint lines."""
    t = np.arange(round(seconds * RATE)) / RATE
    order = rng.permutation(3)
    return np.array([multisine(t, 1 + order[i] + 3 * np.arange(LINES), PERIOD, rng) for i in range(3)])


def validation(seconds: float, rng: np.random.Generator) -> Array:
    """Return the shapes of three commands (3, samples): steps, a sweep and another multisine, in random order."""
    t = np.arange(round(seconds * RATE)) / RATE
    sweep = np.sin(
        2.0 * np.pi * (SLOWEST * t + (FASTEST - SLOWEST) * t**2 / (2.0 * seconds)) + rng.uniform(0.0, 2.0 * np.pi)
    )
    ends = np.cumsum(rng.uniform(*HOLD, 4 + int(seconds / HOLD[0])))
    steps = rng.uniform(-1.0, 1.0, len(ends))[np.searchsorted(ends, t, side="right")]
    lines = np.sort(rng.choice(np.arange(1, 76), LINES, replace=False))
    shapes = (steps, sweep, multisine(t, lines, OTHER_PERIOD, rng))
    return np.array([shapes[i] for i in rng.permutation(3)])


def scaled(shapes: Array, damping: Damping) -> Array:
    """Return commands (samples, 3, batch) in V for shapes (batch, 3, samples), by the declared rig without effects.

    Each actuator is scaled for its own displacement first, then all three together until the largest of |d1|, |d2|
    and |x3| is `STROKE`, or less where a command would exceed `LARGEST_COMMAND`.
    """
    batch, _, samples = shapes.shape
    alone = np.zeros((samples, 3, batch * 3))
    for i in range(3):
        alone[:, i, i::3] = shapes[:, i].T
    rigs = Rigs(np.repeat(declared(damping)[None], batch * 3, axis=0))
    moved = linear_response(rigs, alone).reshape(samples, 3, batch, 3)  # sample, displacement, record, actuator
    own = np.abs(np.einsum("kibi->kbi", moved)).max(axis=0)  # (batch, 3)
    gains = np.minimum(ALONE * STROKE / own, LARGEST_COMMAND / np.abs(shapes).max(axis=2))
    together = np.abs(np.einsum("kdbi,bi->kdb", moved, gains)).max(axis=(0, 1))
    size = gains[:, :, None] * shapes
    common = np.minimum(STROKE / together, LARGEST_COMMAND / np.abs(size).max(axis=(1, 2)))
    return np.ascontiguousarray((size * common[:, None, None]).transpose(2, 1, 0))


def commands(shapes: Shapes, seconds: float, seeds: Sequence[Sequence[int]], dampings: Sequence[Damping]) -> Array:
    """Return the commands (samples, 3, batch) in V of an excitation for each seed and damping."""
    drawn = np.array([shapes(seconds, np.random.default_rng(seed)) for seed in seeds])
    result = np.empty((drawn.shape[2], 3, len(drawn)))
    for damping in dict.fromkeys(dampings):
        rows = [i for i, one in enumerate(dampings) if one == damping]
        result[:, :, rows] = scaled(drawn[rows], damping)
    return result


def channel(place: str) -> tuple[int, int]:
    """Return the signal whose level matters at a place: 0 and the number of a command, or 1 and that of a reading."""
    if place in ACTUATORS:
        return 0, ACTUATORS.index(place)
    if place in SENSORS:
        return 1, SENSORS.index(place)
    return 1, (ELEMENTS.index(place) if place in ELEMENTS else 0)


@dataclass(frozen=True)
class Signals:
    """The commands, and the readings of the declared rig without effects, of a record: each (samples, 3) in V."""

    commands: Array
    readings: Array

    @property
    def levels(self) -> Array:
        """Return the rms (2, 3) of commands and readings in V."""
        squares = [(x**2).mean(axis=0) for x in (self.commands, self.readings)]
        return np.asarray(np.sqrt(np.array(squares)))

    def limit(self, place: str, loss: float) -> float:
        """Return the limit in V that takes away this part of a signal: rms of the difference per rms."""
        kind, number = channel(place)
        size = np.abs((self.commands, self.readings)[kind][:, number])
        low, high = 0.0, float(size.max())
        for _ in range(30):
            limit = (low + high) / 2.0
            if np.mean(np.maximum(size - limit, 0.0) ** 2) > loss**2 * np.mean(size**2):
                low = limit
            else:
                high = limit
        return float(high)


def signals(commands: Array, dampings: Sequence[Damping]) -> list[Signals]:
    """Return the signals of records with these commands (samples, 3, batch) in V."""
    readings = SENSOR_GAIN * linear_response(Rigs(np.array([declared(one) for one in dampings])), commands)
    return [Signals(commands[:, :, i], readings[:, :, i]) for i in range(len(dampings))]
