"""Further places: what else a law without a name may follow than the motion of its own place.

Each is an element of a model that is made for it, at which the bases of laws act as anywhere: a law with memory follows
a displacement and its distance from an internal state that relaxes to it; others follow another coordinate.
Source: Christensen (1982), Theory of Viscoelasticity, chapter 1, for internal states that relax.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.places import Place, identifier
from masking.inference.discovery.problem import EstimationProblem
from masking.model.declaration.dimensions import dimension_in, is_plain, symbol_dimensions
from masking.model.declaration.expression import Expression
from masking.model.declaration.schema import Element, ModelDeclaration, Parameter, State
from masking.model.declaration.units import describe

TIMES = (0.1, 0.4, 1.5, 6.0)  # of the time of the motion: relaxation times that are tried
SHORTEST = 0.1  # of one that is tried: the shortest that it may become
NOUNS = {"d": "displacement", "v": "rate"}


@dataclass(frozen=True)
class FurtherPlaces:
    """A rig with further places for a law."""

    rig: AugmentedModel  # of the model that has them
    nouns: Mapping[str, Mapping[str, str]]  # for each of these elements, names of its displacement `d` and rate `v`
    on: Mapping[str, str]  # for each, the place whose force it is
    time: str = ""  # name of the relaxation time among the parameters; '' without memory
    tried: tuple[float, ...] = field(default=())  # relaxation times, s

    def problem(self, problem: EstimationProblem, seconds: float) -> EstimationProblem:
        """Problem of this rig, made of that without further places; a relaxation time is `seconds`, known to that."""
        prior = problem.prior
        if self.time:
            prior = prior.extended(len(problem.rig.names), seconds, seconds, SHORTEST * seconds, np.inf)
        return replace(problem, rig=self.rig, prior=prior)

    def hypothesis(self, known: Hypothesis, before: AugmentedModel, seconds: float) -> Hypothesis:
        """Hypothesis of the rig without further places as one of this rig, with the state at rest."""
        if not self.time:
            return known
        start = np.tile(self.rig.rest, (len(known.start), 1))
        start[:, [self.rig.twin.state_names.index(name) for name in before.twin.state_names]] = known.start
        return replace(known, theta=np.insert(known.theta, len(before.names), seconds), start=start)


def of(rig: AugmentedModel, at: str, time: float) -> list[FurtherPlaces]:
    """Further places of a law: those with memory at its place, and those that follow another coordinate.

    The others act at the place, and at each coordinate that it acts on. The time of the motion is in s.
    """
    base, place = rig.twin.base, next(one for one in rig.places if one.name == at)
    found = [] if place.element.displacement is None else [_with_memory(rig, place, time)]
    near = [one for one in rig.places if one.coordinate in place.element.acts and one.name != at and not one.directed]
    nouns, on = dict[str, Mapping[str, str]](), dict[str, str]()
    elements, parameters = dict[str, Element](), dict[str, Parameter]()
    for one in (place, *near):
        for name, element, parameter, noun in _others(base, one):
            elements[name], nouns[name], on[name] = element, noun, one.name
            parameters |= parameter
    if elements:
        changed = {"elements": {**base.elements, **elements}, "parameters": {**base.parameters, **parameters}}
        found.append(FurtherPlaces(_changed(rig, base.model_copy(update=changed)), nouns, on))
    return found


def _with_memory(rig: AugmentedModel, place: Place, time: float) -> FurtherPlaces:
    """Place with a state z that relaxes to its displacement d: a law follows d, and (d - z)/tau as its rate.

    That is the rate of d, of which tau is forgotten: f(d), f(d - z), and of both f(z), too.
    """
    base, element, label = rig.twin.base, place.element, identifier(place.name) if not place.declared else place.name
    state, seconds, name = (_free(base, f"{what}_{label}") for what in ("relaxed", "relaxation_time", "memory"))
    moved, tried = element.displacement.text if element.displacement else "", tuple(part * time for part in TIMES)
    rate = Expression(f"(({moved}) - {state})/{seconds}")
    symbols = {} if is_plain(base) else symbol_dimensions(base) or {}
    dimension = dimension_in(element.displacement, symbols) if symbols and element.displacement else None
    unit, per = ("1" if one is None else describe(one) for one in (dimension, symbols.get("t")))
    follows = Expression(f"({moved})")  # in brackets, it is not the place of a coordinate, which is another one
    law = Element(displacement=follows, rate=rate, unit=element.unit, acts=element.acts)
    usual = Parameter(value=tried[len(tried) // 2], unit=per, meaning=f"relaxation time of {place.name}")
    changed = {
        "states": {**base.states, state: State(meaning=f"displacement of {place.name}, relaxed", unit=unit)},
        "parameters": {**base.parameters, seconds: usual},
        "equations": {**base.equations, Expression(f"{state}'"): rate},
        "elements": {**base.elements, name: law},
    }
    made = _changed(rig, base.model_copy(update=changed), (seconds,))
    return FurtherPlaces(made, {name: {"d": "displacement", "v": "relaxing rate"}}, {name: place.name}, seconds, tried)


def _others(
    base: ModelDeclaration, place: Place
) -> Iterator[tuple[str, Element, Mapping[str, Parameter], Mapping[str, str]]]:
    """Elements that act as a place does and follow another coordinate, by itself or beside its displacement.

    With each come its name, its parameters and what a law calls what it follows.
    """
    element, label = place.element, identifier(place.name) if not place.declared else place.name
    symbols = {} if is_plain(base) else symbol_dimensions(base) or {}
    for other in base.coordinates:
        if element.displacement is not None and element.displacement.text.strip() == other:
            continue
        alone = Element(displacement=Expression(other), unit=element.unit, acts=element.acts)
        yield _free(base, f"{other}_at_{label}"), alone, {}, {k: f"{x} of {other}" for k, x in NOUNS.items()}
        if element.displacement is None:
            continue
        unit, seconds = "1", _free(base, f"second_{other}_{label}")
        if symbols:
            made = dimension_in(Expression(f"({other})*t/({element.displacement.text})"), symbols)
            unit = "1" if made is None else describe(made)
        with_it = element.model_copy(update={"rate": Expression(f"{other}/{seconds}"), "force": None, "meaning": ""})
        one = Parameter(value=1.0, unit=unit, meaning=f"{other} as a rate of {place.name}")
        nouns = {"d": f"displacement of {place.name}", "v": f"displacement of {other}"}
        yield _free(base, f"{label}_and_{other}"), with_it, {seconds: one}, nouns


def _changed(rig: AugmentedModel, base: ModelDeclaration, more: Sequence[str] = ()) -> AugmentedModel:
    return replace(rig, twin=replace(rig.twin, base=base), names=(*rig.names, *more))


def _free(base: ModelDeclaration, name: str) -> str:
    sections = (base.coordinates, base.states, base.inputs, base.parameters, base.definitions, base.outputs)
    taken = {*base.elements, *(known for section in sections for known in section)}
    return next(n for n in (name, *(f"{name}_{i}" for i in range(2, 99))) if n not in taken)
