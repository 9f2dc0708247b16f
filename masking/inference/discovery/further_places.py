"""Further places: what else a law without a name may follow than the motion of its own place.

Each is an element of a model that is made for it, at which the bases of laws act as anywhere: a law with memory follows
a displacement and its distance from an internal state that relaxes to it; others follow another coordinate.
Source: Christensen (1982), Theory of Viscoelasticity, chapter 1, for internal states that relax.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.places import Place, identifier
from masking.model.declaration import couplings
from masking.model.declaration.dimensions import dimension_in, is_plain, symbol_dimensions
from masking.model.declaration.expression import Expression
from masking.model.declaration.schema import Element, ModelDeclaration, Parameter, State
from masking.model.declaration.units import describe

TIMES = (0.1, 0.4, 1.5, 6.0)  # of the time of the motion: relaxation times that are tried
SHORTEST = 0.1  # of one that is tried: the shortest that it may become
NOUNS = {"d": "displacement", "v": "rate"}


@dataclass(frozen=True)
class LawPlaces:
    """Places where a law without a name may sit, in a rig that has them."""

    rig: AugmentedModel
    nouns: Mapping[str, Mapping[str, str]]  # for each, names of its displacement `d` and rate `v`
    on: Mapping[str, str]  # for each, the place of the rig itself whose force it is
    time: str = ""  # name of the relaxation time among the parameters; '' without memory
    tried: tuple[float, ...] = ()  # relaxation times, s

    @property
    def are_own(self) -> bool:
        """Whether they are places of the rig itself."""
        return all(name == at for name, at in self.on.items())

    def begun(
        self, problem: EstimationProblem, known: Hypothesis, seconds: float
    ) -> tuple[EstimationProblem, Hypothesis]:
        """Problem and hypothesis of the rig itself as those of this one, at rest, with a relaxation time in s."""
        before, prior, theta = problem.rig, problem.prior, known.theta
        if self.time:
            prior = prior.extended(len(before.names), seconds, seconds, SHORTEST * seconds, np.inf)
            theta = np.insert(theta, len(before.names), seconds)
        start = np.tile(self.rig.rest, (len(known.start), 1))
        start[:, [self.rig.twin.state_names.index(name) for name in before.twin.state_names]] = known.start
        return replace(problem, rig=self.rig, prior=prior), replace(known, theta=theta, start=start)


def own(rig: AugmentedModel) -> LawPlaces:
    """Places of a rig itself where a law may sit: declared ones and coordinates."""
    names = [one.name for one in rig.places if one.is_open and (one.declared or one.coordinate)]
    return LawPlaces(rig, dict.fromkeys(names, NOUNS), dict(zip(names, names, strict=True)))


def of(rig: AugmentedModel, at: str, time: float) -> list[LawPlaces]:
    """Further places of a law: those with memory at its place, and those that follow another coordinate.

    The others act at the place, and at each coordinate that it acts on. The time of the motion is in s.
    """
    place = next(one for one in rig.places if one.name == at)
    found = [] if place.element.displacement is None else [_with_memory(rig, place, time)]
    near = [one for one in rig.places if one.coordinate in place.element.acts and one.name != at and not one.directed]
    others = _following_others(rig, (place, *near))
    return [*found, others] if others.on else found


def _with_memory(rig: AugmentedModel, place: Place, time: float) -> LawPlaces:
    """Place with a state z that relaxes to its displacement d: a law follows d, and (d - z)/tau as its rate.

    That is the rate of d, of which tau is forgotten: f(d), f(d - z), and of both f(z), too.
    """
    base, element, label = rig.twin.base, place.element, _label(place)
    state, seconds, name = (_free(base, f"{what}_{label}") for what in ("relaxed", "relaxation_time", "memory"))
    moved, tried = element.displacement.text if element.displacement else "", tuple(part * time for part in TIMES)
    rate = Expression(f"(({moved}) - {state})/{seconds}")
    symbols = {} if is_plain(base) else symbol_dimensions(base) or {}
    dimension = dimension_in(element.displacement, symbols) if symbols and element.displacement else None
    unit, per = ("1" if one is None else describe(one) for one in (dimension, symbols.get("t")))
    follows = Expression(f"({moved})")  # in brackets, it is not the place of a coordinate, which is another one
    driven = {one: Expression("0") for one in couplings.driven_states(base)}  # so that each keeps its place
    law = Element(displacement=follows, rate=rate, unit=element.unit, acts={**driven, **element.acts})
    usual = Parameter(value=tried[len(tried) // 2], unit=per, meaning=f"relaxation time of {place.name}")
    changed = {
        "states": {**base.states, state: State(meaning=f"displacement of {place.name}, relaxed", unit=unit)},
        "parameters": {**base.parameters, seconds: usual},
        "equations": {**base.equations, Expression(f"{state}'"): rate},
        "elements": {**base.elements, name: law},
    }
    twin = replace(rig.twin, base=base.model_copy(update=changed))
    made = replace(rig, twin=twin, names=(*rig.names, seconds))
    return LawPlaces(made, {name: {"d": "displacement", "v": "relaxing rate"}}, {name: place.name}, seconds, tried)


def _following_others(rig: AugmentedModel, places: Sequence[Place]) -> LawPlaces:
    """Places that act as others do, each following another coordinate."""
    base, elements = rig.twin.base, dict[str, Element]()
    nouns, on = dict[str, Mapping[str, str]](), dict[str, str]()
    for place, other in itertools.product(places, base.coordinates):
        element = place.element
        if element.displacement is None or element.displacement.text.strip() != other:
            name = _free(base, f"{other}_at_{_label(place)}")
            elements[name] = Element(displacement=Expression(other), unit=element.unit, acts=element.acts)
            nouns[name], on[name] = {key: f"{noun} of {other}" for key, noun in NOUNS.items()}, place.name
    twin = replace(rig.twin, base=base.model_copy(update={"elements": {**base.elements, **elements}}))
    return LawPlaces(replace(rig, twin=twin), nouns, on)


def _label(place: Place) -> str:
    return place.name if place.declared else identifier(place.name)


def _free(base: ModelDeclaration, name: str) -> str:
    sections = (base.coordinates, base.states, base.inputs, base.parameters, base.definitions, base.outputs)
    taken = {*base.elements, *(known for section in sections for known in section)}
    return next(n for n in (name, *(f"{name}_{i}" for i in range(2, 99))) if n not in taken)
