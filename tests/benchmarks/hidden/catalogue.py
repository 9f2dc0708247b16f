"""The hidden effects of the benchmark: where each may sit, and its parameters for an amplitude and a random sign.

Amplitudes are in `amplitudes.py`: found once by `calibrate.py`, so that an effect changes the readings of the rig
without it by about `CHI` (4.12) under the reference excitation. Another excitation moves the rig more or less; an
amplitude is therefore multiplied by (level / reference level)**power, with the rms of the command or reading of its
place as level. The amplitude of a limit is the part of the signal, relative and in rms, that it takes away.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tests.benchmarks.hidden.excitation import Signals, channel
from tests.benchmarks.hidden.laws import SLIDING
from tests.benchmarks.hidden.rig import ACTUATORS, ALL_ACTUATORS, ELEMENTS, SENSORS, Array

Strength = Literal["weak", "medium", "strong"]
CHI: dict[Strength, float] = {"weak": 0.01, "medium": 0.03, "strong": 0.1}  # worst channel, relative rms

STRIBECK = 1e-2  # m/s
PRESLIDING = 5e-5  # m: deflection of LuGre's bristles at fc
BRISTLES = 1e-2  # m/s: rate at which the damping of LuGre's bristles alone would give fc
BUILD_UP = 2e-4  # m: of Dahl's friction
YIELD = 3e-4  # m: of Bouc and Wen's spring
EDGE = 1e-3  # m: of a stop and of a place that rubs
GAP = 1e-3  # m: of backlash and play
RADIUS = 1.2e-3  # m per rad
FREQUENCY = {"spring1": 1.13, "spring2": 1.71, "beam": 2.31}  # Hz: no line of an excitation

Build = Callable[[float, float, float], dict[str, float]]  # (amplitude, sign, phase) -> parameters


@dataclass(frozen=True)
class Entry:
    """An effect with its places, its parameters, a first amplitude, and the power of the level in its amplitude.

    `limits` is True where the amplitude is the lost part of the signal; `fixed` are amplitudes that are not calibrated.
    """

    effect: str
    places: tuple[str, ...]
    build: Build
    first: float
    power: float = 0.0
    limits: bool = False
    fixed: tuple[float, float, float] | None = None
    variant: str = ""

    @property
    def key(self) -> str:
        """Return the name that tells variants of one effect apart."""
        return self.effect + self.variant


def _scaled(name: str, factor: float = 1.0) -> Build:
    return lambda a, sign, phase: {name: factor * a}


def _signed(name: str) -> Build:
    return lambda a, sign, phase: {name: sign * a}


def _lugre(a: float, sign: float, phase: float) -> dict[str, float]:
    return {"fc": a, "fs": 1.5 * a, "vst": STRIBECK, "s0": a / PRESLIDING, "s1": a / BRISTLES, "s2": 0.0}


def _asymmetric(a: float, sign: float, phase: float) -> dict[str, float]:
    return {"fp": a * (1.0 + 0.5 * sign), "fm": a * (1.0 - 0.5 * sign), "vs": SLIDING}


def _local(a: float, sign: float, phase: float) -> dict[str, float]:
    return {"fc": a, "edge": sign * EDGE, "width": 2e-4, "vs": SLIDING, "side": sign}


def _periodic(place: str) -> Build:
    return lambda a, sign, phase: {
        "a": a * float(np.cos(phase)),
        "b": a * float(np.sin(phase)),
        "f": FREQUENCY[place],
    }


_E, _A, _S = ELEMENTS, ACTUATORS, SENSORS

EFFECTS: tuple[Entry, ...] = (
    Entry("constant_force", _E, _signed("f0"), 0.01, 1),
    Entry("hardening_spring", _E, _scaled("k3"), 4e5, -2, variant="+"),
    Entry("hardening_spring", _E, _scaled("k3", -1.0), 4e5, -2, variant="-"),
    Entry("polynomial_spring", _E, _signed("k2"), 1000.0, -1),
    Entry("quadratic_damping", _E, _scaled("c"), 5.0, -1),
    Entry("dry_friction", _E, lambda a, sign, phase: {"fc": a, "vs": SLIDING}, 3e-3, 1),
    Entry("asymmetric_friction", _E, _asymmetric, 3e-3, 1),
    Entry(
        "stribeck_friction",
        _E,
        lambda a, sign, phase: {"fc": a, "fs": 2.0 * a, "vst": STRIBECK, "vs": SLIDING},
        3e-3,
        1,
    ),
    Entry("lugre_friction", _E, _lugre, 3e-3, 1),
    Entry("dahl_friction", _E, lambda a, sign, phase: {"fc": a, "x0": BUILD_UP}, 3e-3, 1),
    Entry("hysteresis", _E, lambda a, sign, phase: {"k": a / YIELD, "zmax": YIELD, "beta": 0.5, "n": 2.0}, 3e-3, 1),
    Entry("backlash", _E, lambda a, sign, phase: {"k": a, "gap": GAP}, 5.0),
    Entry("stop", _E, lambda a, sign, phase: {"k": a, "edge": sign * EDGE, "c": 0.0, "side": sign}, 10.0),
    Entry("local_friction", _E, _local, 1e-2, 1),
    Entry("gravity_force", _E, lambda a, sign, phase: {"a": sign * a, "r": RADIUS}, 0.02),
    *(Entry("periodic_force", (place,), _periodic(place), 5e-3, 1) for place in _E),
    Entry("stiffness_drift", _E, _signed("k"), 20.0),
    Entry("linear_spring", ("x1-x2",), _scaled("k"), 3.0),
    Entry("actuator_offset", _A, _signed("u0"), 1e-3, 1),
    Entry("actuator_gain", _A, _signed("e"), 0.03),
    Entry("saturation", _A, _scaled("limit"), 0.03, limits=True),
    Entry("dead_zone", _A, _scaled("width"), 1e-3, 1),
    Entry("actuator_lag", _A, _scaled("tau"), 3e-3),
    Entry("delay", (ALL_ACTUATORS,), _scaled("seconds"), 3e-3),
    Entry("dac_quantisation", _A, _scaled("step"), 5e-3, 1),
    Entry("actuator_cubic", _A, _signed("c"), 100.0, -2),
    Entry("sensor_offset", _S, _signed("e0"), 5e-3, 1),
    Entry("sensor_gain", _S, _signed("e"), 0.03),
    Entry("sensor_cubic", _S, _signed("c"), 0.3, -2),
    Entry("sensor_saturation", _S, _scaled("limit"), 0.03, limits=True, fixed=(0.01, 0.03, 0.1)),
    Entry("sensor_lag", _S, _scaled("tau"), 2e-3),
    Entry("sensor_rectification", _S, _signed("r"), 0.03),
    Entry("quantisation", _S, _scaled("step"), 1e-2, fixed=(5e-3, 1e-2, 2e-2)),
)

OTHERS: tuple[Entry, ...] = (  # laws that are not those of a usual rig; some are in the dictionary by now
    Entry("bilinear_spring", _E, _scaled("k"), 5.0),
    Entry("position_damping", _E, _scaled("c"), 2e5, -2),
    Entry("saturating_spring", _E, lambda a, sign, phase: {"k": a, "d0": 1.5e-3}, 20.0),
    Entry(
        "play_with_friction",
        _E,
        lambda a, sign, phase: {"fc": a, "gap": GAP, "vs": SLIDING, "tau": 2e-3},
        5e-3,
        1,
    ),
    Entry("softening_with_travel", _E, lambda a, sign, phase: {"k": a, "travel": 0.3}, 10.0),
    Entry("relaxing_spring", _E, lambda a, sign, phase: {"k": a, "tau": 0.2}, 10.0),
    Entry("rubbing", _E, lambda a, sign, phase: {"g": a, "vs": SLIDING}, 5.0),
    Entry("fading_magnet", _E, lambda a, sign, phase: {"k": a, "d0": 1e-3}, 10.0),
)

INERTIAS: tuple[Entry, ...] = (  # all of whose effect the eleven parameters can have together: in no family
    Entry("added_mass", ("x1", "beam"), _scaled("m"), 0.05),
)

IMPERFECTIONS = (  # of the families `dirty`: each grows in proportion to its amplitude
    "bilinear_spring",
    "position_damping",
    "saturating_spring",
    "rubbing",
    "fading_magnet",
    "actuator_cubic",
    "sensor_cubic",
)

PLACED: dict[str, tuple[Entry, str]] = {
    f"{entry.key}@{place}": (entry, place) for entry in (*EFFECTS, *OTHERS, *INERTIAS) for place in entry.places
}


def parameters(
    key: str, amplitude: float, signals: Signals, reference: Array, *, sign: float = 1.0, phase: float = 0.7
) -> dict[str, float]:
    """Return the parameters of the effect `effect@place` for an amplitude, in a record of these signals.

    `reference` (2, 3) are the levels of commands and readings that the amplitude belongs to; `sign` is 1 or -1.
    """
    entry, place = PLACED[key]
    if entry.limits:
        return entry.build(signals.limit(place, amplitude), sign, phase)
    if entry.power:
        kind, number = channel(place)
        amplitude *= float(signals.levels[kind, number] / reference[kind, number]) ** entry.power
    return entry.build(amplitude, sign, phase)
