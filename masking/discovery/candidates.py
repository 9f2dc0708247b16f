"""Candidates: every effect of the dictionary at every place where it may sit, with values to begin from.

Of each effect some parameters enter its force as factors; the others are its shape, for which a few values are tried
that are spread over the motion of the record. Own effects say themselves what is tried.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from masking.discovery import laws
from masking.discovery.augmented_model import OpenRig, Slot
from masking.discovery.places import is_of_one
from masking.effects import EFFECTS, Effect, EffectParameter

BRISTLES = 3e-3  # s: damping of bristles for their stiffness, to begin with
TURNS = (1e-3, 1e-4, 1e-5)  # m/s, or another unit of rate, over which friction turns round
PARTS = (1e-2, 2e-3, 4e-4)  # of the rms rate, where that is not of coordinates
EDGES = (0.15, 0.3, 0.45, 0.6, 0.75, 0.85, 0.93)  # parts of the travel at which a contact is tried
EDGE = 0.04  # part of the largest displacement over which what begins at one begins, to begin with
MOST_LEVELS = 24.0  # steps of a converter from the middle to the end of its range that are tried


@dataclass(frozen=True)
class Span:
    """How far a place, sensor or actuator goes in a record.

    Args:
        low, high: least and largest value.
        size: largest magnitude.
        rate: root mean square of its rate.
        tones: frequencies in Hz of what is left, the strongest first.
        turns: rates over which friction is tried to turn round.
    """

    low: float
    high: float
    size: float
    rate: float
    tones: tuple[float, ...] = ()
    turns: tuple[float, ...] = TURNS


@dataclass(frozen=True)
class Candidate:
    """An effect at a place: its slots for the shapes that are tried.

    Args:
        effect: its name.
        at: the place.
        factors: indices of the parameters that are factors.
        free: indices of all that are estimated.
        slots: one for each shape, with factors 0 or as the shape wants them.
    """

    effect: str
    at: str
    factors: tuple[int, ...]
    free: tuple[int, ...]
    slots: tuple[Slot, ...]

    @property
    def key(self) -> tuple[str, str]:
        """Return effect and place."""
        return self.effect, self.at


Shapes = Callable[[Span], list[Mapping[str, float]]]


@dataclass(frozen=True)
class _Recipe:
    """How an effect is tried: factors, shape parameters that are estimated, and shapes to begin with."""

    factors: tuple[str, ...]
    shape: tuple[str, ...] = ()
    shapes: Shapes = lambda span: [{}]


def _parts(name: str, *parts: float) -> Shapes:
    return lambda span: [{name: part * span.size} for part in parts]


def _edges(span: Span, **more: float) -> list[Mapping[str, float]]:
    up = [{"side": 1.0, "edge": part * span.high, **more} for part in EDGES if span.high > 0]
    down = [{"side": -1.0, "edge": part * span.low, **more} for part in EDGES if span.low < 0]
    return [*up, *down, {"side": 1.0, "edge": 0.0, **more}, {"side": -1.0, "edge": 0.0, **more}]


def _rates(name: str, *parts: float) -> Shapes:
    return lambda span: [{name: part * span.rate} for part in parts]


def _bristles(more: float) -> Shapes:
    """Return shapes in which breaking loose takes `more` times the force of sliding; the factor scales all forces."""

    def shapes(span: Span) -> list[Mapping[str, float]]:
        made: list[Mapping[str, float]] = []
        for part in (0.005, 0.02, 0.08):
            stiffness = 1.0 / (part * span.size)
            rates = {"vst": 0.2 * span.rate, "s1": BRISTLES * stiffness}
            made.append({"fc": 1.0, "fs": more, "s0": stiffness, **rates})
        return made

    return shapes


def _turning(number: int) -> Shapes:
    return lambda span: [{"vs": span.turns[number]}]


def _bends(span: Span) -> list[Mapping[str, float]]:
    """Return shapes of a general hysteresis: a path back that bends soon or late, and yields or opens."""
    return [{"x0": part * span.size, "delta": delta} for part in (0.15, 0.6, 2.4) for delta in (-1.3, 0.0)]


def _steps(span: Span) -> list[Mapping[str, float]]:
    """Return steps of a converter from a few to `MOST_LEVELS` in the range, near enough to each other to be seen."""
    found: list[Mapping[str, float]] = []
    levels = 0.6
    while levels < MOST_LEVELS:
        found.append({"step": span.size / levels})
        levels += max(0.15, 0.02 * levels)
    return found


RECIPES: dict[str, tuple[_Recipe, ...]] = {
    "constant_force": (_Recipe(("f0",)),),
    "linear_spring": (_Recipe(("k",)),),
    "polynomial_spring": (
        _Recipe(("k2",)),
        _Recipe(("k2", "k3")),
        _Recipe(("k2", "k3", "k4", "k5")),
    ),
    "hardening_spring": (_Recipe(("k3",)),),
    "viscous_damping": (_Recipe(("c",)),),
    "quadratic_damping": (_Recipe(("c",)),),
    "added_mass": (_Recipe(("m",)),),
    "dry_friction": tuple(_Recipe(("fc",), (), _turning(number)) for number in range(len(TURNS))),
    "asymmetric_friction": (_Recipe(("fp", "fm")),),
    "stribeck_friction": (_Recipe(("fc", "fs"), ("vst",), _rates("vst", 0.05, 0.15, 0.4, 0.8)),),
    "lugre_friction": tuple(_Recipe(("s0",), ("fc", "fs", "vst", "s1"), _bristles(more)) for more in (1.2, 2.0)),
    "dahl_friction": (_Recipe(("fc",), ("x0",), _parts("x0", 0.003, 0.01, 0.03, 0.1, 0.3)),),
    "hysteresis": (_Recipe(("k",), ("zmax",), _parts("zmax", 0.01, 0.03, 0.08, 0.2, 0.4, 0.8)),),
    "bouc_wen_hysteresis": (_Recipe(("k",), ("x0", "delta"), _bends),),
    "backlash": (_Recipe(("k",), ("gap",), _parts("gap", 0.05, 0.15, 0.3, 0.5, 0.8, 1.2)),),
    "stop": (_Recipe(("k",), ("edge",), _edges),),
    "local_friction": (_Recipe(("fc",), ("edge", "width"), lambda span: _edges(span, width=EDGE * span.size)),),
    "gravity_force": (_Recipe(("a",), ("r",), _parts("r", 0.12, 0.2, 0.35, 0.6, 1.2, 3.0)),),
    "periodic_force": (_Recipe(("a", "b"), ("nu",), lambda span: [{"nu": tone} for tone in span.tones]),),
    "stiffness_drift": (_Recipe(("k",)),),
    "sensor_offset": (_Recipe(("e0",)),),
    "sensor_gain": (_Recipe(("e",)),),
    "sensor_saturation": (_Recipe((), ("limit",), _parts("limit", 0.3, 0.5, 0.7, 0.85, 0.95)),),
    "sensor_lag": (_Recipe((), ("tau",), lambda span: [{"tau": 1e-3}, {"tau": 5e-3}]),),
    "sensor_cubic": (_Recipe(("c",)),),
    "sensor_rectification": (_Recipe(("r",)),),
    "actuator_offset": (_Recipe(("u0",)),),
    "actuator_gain": (_Recipe(("e",)),),
    "saturation": (_Recipe((), ("limit",), _parts("limit", 0.3, 0.45, 0.6, 0.75, 0.9)),),
    "dead_zone": (_Recipe((), ("width",), _parts("width", 0.01, 0.03, 0.08, 0.2)),),
    "actuator_cubic": (_Recipe(("c",)),),
    "dac_quantisation": (_Recipe((), ("step",), _steps),),
    "actuator_lag": (_Recipe((), ("tau",), lambda span: [{"tau": 1e-3}, {"tau": 5e-3}, {"tau": 2e-2}]),),
}
# Where the rate is measured, or that of a state, its turn is seen well enough to be estimated.
RECIPES_OF_RATES: dict[str, tuple[_Recipe, ...]] = {
    "dry_friction": (_Recipe(("fc",), ("vs",), lambda span: [{"vs": turn} for turn in span.turns]),),
    "asymmetric_friction": (_Recipe(("fp", "fm"), ("vs",), lambda span: [{"vs": turn} for turn in span.turns]),),
    "stribeck_friction": (_Recipe(("fc", "fs"), ("vst", "vs"), _rates("vst", 0.05, 0.15, 0.4, 0.8)),),
    "local_friction": (
        _Recipe(
            ("fc",),
            ("edge", "width", "vs"),
            lambda span: [{**e, "vs": turn} for e in _edges(span, width=EDGE * span.size) for turn in span.turns],
        ),
    ),
}
FACTORS = {effect: recipes[-1].factors for effect, recipes in RECIPES.items()}
PAIRS = ("linear_spring", "viscous_damping", "hardening_spring", "dry_friction")  # between coordinates not joined


def candidates(rig: OpenRig, spans: Mapping[str, Span], period: float) -> Iterator[Candidate]:
    """Give every candidate.

    Args:
        rig: the rig.
        spans: of each place, sensor and actuator by name.
        period: time between samples, s.
    """
    every = [EFFECTS[name] for name in RECIPES] + [e for n, e in rig.twin.dictionary.items() if n not in EFFECTS]
    for place in rig.places:
        # Inertias take the displacement as linear, and change no reading at once.
        straight = is_of_one(place.element.displacement, rig.coordinates) and not rig.twin.is_fed
        kinds = [e for e in every if e.where == "element" and (straight or not e.is_inertia)]
        for effect in kinds if place.declared or place.coordinate else [EFFECTS[name] for name in PAIRS]:
            if place.is_open and place.takes(effect):
                recipes = {} if place.is_of_coordinates else RECIPES_OF_RATES
                yield from _of(effect, place.name, spans[place.name], recipes)
    commanded = tuple(name for name in rig.twin.actuators if name not in rig.twin.measured_actuators)
    for where, names in (("sensor", rig.twin.sensors), ("actuator", commanded)):
        for effect in [e for e in every if e.where == where]:
            for name in names:
                yield from _of(effect, name, spans[name])
    for at in ("", *commanded) if commanded == rig.twin.actuators else commanded:
        slots = tuple(Slot(laws.DELAY, at, (samples * period,), (0,)) for samples in (1.0, 5.0))
        yield Candidate(laws.DELAY, at, (), (0,), slots)


def _own(effect: Effect) -> _Recipe:
    """Return how an own effect is tried: all combinations of what its declaration says."""
    shape = {name: parameter for name, parameter in effect.parameters.items() if parameter.tried}

    def shapes(span: Span) -> list[Mapping[str, float]]:
        starts = itertools.product(*(_starts(parameter, span) for parameter in shape.values()))
        return [dict(zip(shape, values, strict=True)) for values in starts]

    return _Recipe(effect.factors, tuple(shape), shapes)


def _starts(parameter: EffectParameter, span: Span) -> list[float]:
    """Return what is tried of a parameter, within its bounds, in coherent units."""
    size = {"D": span.size, "S": span.size, "U": span.size, "D/s": span.rate}.get(parameter.unit.replace(" ", ""), 1.0)
    low, high = parameter.bounds
    least, most = -math.inf if low is None else low, math.inf if high is None else high
    return [min(max(part * size, least), most) for part in parameter.tried]


def _of(
    effect: Effect, at: str, span: Span, recipes: Mapping[str, tuple[_Recipe, ...]] = MappingProxyType({})
) -> Iterator[Candidate]:
    """Give an effect at a place in each way that it is tried: as other recipes say that know it, or as usual."""
    names, own = list(effect.parameters), None if effect.name in EFFECTS else effect
    for recipe in recipes.get(effect.name, RECIPES.get(effect.name, ())) if own is None else (_own(own),):
        factors = tuple(names.index(name) for name in recipe.factors)
        free = tuple(sorted((*factors, *(names.index(name) for name in recipe.shape))))
        slots = []
        for shape in recipe.shapes(span):
            values = {n: (0.0 if p.value is None else p.value) for n, p in effect.parameters.items()}
            values |= {"vs": span.turns[0]} if own is None and "vs" in values else {}
            values |= dict.fromkeys(recipe.factors, 0.0) | dict(shape)
            slots.append(Slot(effect.name, at, tuple(values.values()), free, own))
        if slots:
            yield Candidate(effect.name, at, factors, free, tuple(slots))
