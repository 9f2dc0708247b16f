"""Places: where an effect may sit in a model: its elements, each coordinate, and between each two coordinates.

A port at a place lets effects act on the compiled model there; what these follow are nodes of its graph.

What a force moves by itself is a degree: a coordinate, and without one an internal state or an output that elements act
on. Each has a place, by whose force the model error there is reported, even where no law can sit in it.

A force between two coordinates acts on both, in the ratio of their masses. If these do not follow from the equations,
which may be divided by a mass, they follow from the elements, which pass a force on.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from masking.compile.codegen.graph import Node
from masking.compile.codegen.tangent import derivatives
from masking.control.rig.twin import LoweredTwin
from masking.errors import DeclarationError, Problem
from masking.model.declaration import couplings
from masking.model.declaration.dimensions import displacement_dimension, force_dimensions, is_plain, symbol_dimensions
from masking.model.declaration.expression import Expression
from masking.model.declaration.model_checks import equation_of, no_equation
from masking.model.declaration.schema import EffectUse, Element, ModelDeclaration, Parameter
from masking.model.declaration.units import Dimension, describe, dimension_of
from masking.model.effects import Directed, Effect

USUAL = ("1", "N", "N*m")  # units of forces
ON = " on "  # between what a force follows and what it acts on, in the name of a directed place


@dataclass(frozen=True)
class Place:
    """One place."""

    name: str  # of its element
    element: Element  # what it follows and acts on
    declared: bool  # whether the model declares it
    coordinate: str | None = None  # the degree that it is a place of, if one
    has_rate: bool = True  # whether it is known how fast it is stretched
    has_force: bool = False  # whether it declares a force of its own, with which effects may be in series
    directed: Directed = ""  # what it follows, if it acts on a coordinate by other than the motion of this alone

    @property
    def is_open(self) -> bool:
        """Whether any effect may sit here: an output by itself moves in no way that is known."""
        return self.declared or self.element.displacement is not None

    def takes(self, effect: Effect) -> bool:
        """Whether an effect finds here what it follows: a displacement, a rate, or neither."""
        if effect.directed != self.directed or (effect.attaches != "beside" and not self.has_force):
            return False
        if effect.is_carried and self.coordinate is None:
            return False
        if (effect.is_flow and self.has_rate) or (effect.follows & {"d_rate", "d_acc"} and not self.has_rate):
            return False
        return "d" not in effect.follows or self.element.displacement is not None


def degrees(model: ModelDeclaration) -> tuple[str, ...]:
    """Degrees of freedom that forces move: coordinates, internal states, and outputs that elements act on.

    An output that elements share with the coordinates, as the reading of a force on them, is none of its own.
    """
    own = {name for e in model.elements.values() if not e.acts.keys() & model.coordinates.keys() for name in e.acts}
    outputs = (name for name in couplings.driven_outputs(model) if name in own)
    return (*model.coordinates, *couplings.driven_states(model), *outputs)


def places(model: ModelDeclaration, *, directed: bool = False) -> tuple[Place, ...]:
    """Every place of a model: elements, degrees and pairs of coordinates, none twice; directed ones if asked for.

    Raises:
        DeclarationError: a force cannot act on a coordinate, since no equation is its own, or on nothing at all.
    """
    forces = force_dimensions(model)
    lost = [name for name in model.coordinates if model.lagrangian is None and not equation_of(model, name)]
    if lost:
        raise DeclarationError([no_equation(model, name, f"coordinates.{name}") for name in lost])
    found = [_place(model, name, e, _degree(model, e), declared=True) for name, e in model.elements.items()]
    taken = {place.coordinate for place in found}
    for name in degrees(model):
        if name not in taken:
            element = _alone(model, name, _force_unit(model, name, forces[name]))
            found.append(_place(model, name, element, name, declared=False))
    if not found:
        remedy = "declare where one may sit, such as 'elements: {strut: {displacement: d, rate: v, acts: {F: 1}}}'"
        what = f"{model.name} has no place for a force"
        raise DeclarationError(Problem(model.place("outputs"), "elements", what, remedy))
    between = {_text(e.displacement) for e in model.elements.values()}
    weights = _weights(model)
    if any(len({*element.acts} & {*model.coordinates}) > 2 for element in model.elements.values()):
        return tuple(found)  # coordinates are modes: nothing sits between two of them
    for a, b in itertools.combinations(model.coordinates, 2):
        if f"{a}-{b}" in between or f"{b}-{a}" in between or a not in weights or b not in weights:
            continue
        if model.coordinates[a].unit != model.coordinates[b].unit or forces[a] != forces[b]:
            continue
        acts = {a: Expression("-1"), b: Expression(f"({weights[a]})/({weights[b]})")}
        element = Element(displacement=Expression(f"{a} - {b}"), unit=_force_unit(model, a, forces[a]), acts=acts)
        found.append(Place(f"{a}-{b}", element, declared=False))
    return (*found, *(_directed(model, forces) if directed else ()))


def _directed(model: ModelDeclaration, forces: Mapping[str, Dimension | None]) -> Iterator[Place]:
    commands = [name for name in model.inputs if name not in couplings.measured_inputs(model)]
    units = {name: x.unit for section in (model.coordinates, model.inputs) for name, x in section.items()}
    for name in model.coordinates:
        unit, driven = _force_unit(model, name, forces[name]), _inputs_of(model, name)
        found: list[tuple[str, Directed, str, str]] = [
            *((f"{other}{ON}{name}", "coordinate", other, "") for other in model.coordinates if other != name),
            *((f"{u}{ON}{name}", "command", u, "") for u in commands if u not in driven),
            *((f"{u} at {name}", "gain", name, u) for u in commands if u in driven),
            *((f"{name} under {load}", "load", name, load) for load in (name, *commands)),
        ]
        for called, kind, followed, by in found:
            factor = f"-abs({by})" if kind == "load" else by or "-1"
            per = unit if not by or is_plain(model) else describe(dimension_of(f"({unit})/({units[by]})"))
            element = Element(displacement=Expression(followed), unit=per, acts={name: Expression(factor)})
            moves = followed in model.coordinates
            yield Place(called, element, False, None, moves, directed=kind)


def _inputs_of(model: ModelDeclaration, name: str) -> set[str]:
    """Inputs that the force on a coordinate, or its equation, holds, by way of definitions too."""
    left = equation_of(model, name)
    acting = model.forces.get(name) or (None if left is None else model.equations[left])
    names = frozenset[str]() if acting is None else acting.names
    return {u for u in model.inputs if names & {u, *couplings.definitions_with(model, {u})}}


def both_of(place: str) -> tuple[str, ...]:
    """Both ends of a directed place, followed and acted on: x2 and x1 of "x2 on x1"."""
    return tuple(place.split(ON))


def opened(model: ModelDeclaration, *, directed: bool = False) -> tuple[ModelDeclaration, tuple[Place, ...]]:
    """Model in which every place is an element, and the places; see `places`.

    Of the motion of an element with a force of its own, the parameters `taken(name)` are taken away.
    """
    found = places(model, directed=directed)
    elements = {**model.elements, **{identifier(p.name): p.element for p in found if not p.declared}}
    parameters = dict(model.parameters)
    symbols = symbol_dimensions(model) or {}
    for name, element in ((p.name, p.element) for p in found if p.has_force):
        if element.force is not None:
            moved, time = displacement_dimension(element, symbols), symbols["t"]
            unit = "1" if moved is None else describe(moved)
            per_second = unit if time is None else f"({unit})/({describe(time)})"
            lost, lost_rate = taken(name)
            parameters |= {lost: Parameter(value=0.0, unit=unit), lost_rate: Parameter(value=0.0, unit=per_second)}
            names = {"d": lost, "d_rate": lost_rate}
            less = {motion: f"({motion} - {one})" for motion, one in names.items()}
            unused = "".join(f"*{one}**0" for motion, one in names.items() if motion not in element.force.names)
            text = f"({element.force.renamed(less)}){unused}"
            elements[name] = element.model_copy(update={"force": Expression(text)})
    return model.model_copy(update={"elements": elements, "parameters": parameters}), found


def taken(element: str) -> tuple[str, str]:
    """Names of what is taken from the displacement and from the rate that an element's own force follows."""
    return f"taken_{element}", f"taken_rate_{element}"


def identifier(name: str) -> str:
    """Name of an element for a place, such as `x1_x2` for x1-x2, and `x1_on_x2` for "x1 on x2"."""
    return f"{name}_place" if name.isidentifier() else re.sub("[- ]", "_", name)


def followed(lowered: LoweredTwin, places: Sequence[Place]) -> list[Node]:
    """Displacement of each place as a node; 0 where it has none."""
    equations, zero = lowered.equations.equations, lowered.graph.number(0.0)
    every = [place.element.displacement for place in places]
    return [zero if one is None else lowered.equations.lower(equations.symbolic(one)) for one in every]


def rates(lowered: LoweredTwin, places: Sequence[Place], loads: Mapping[str, str]) -> list[Node]:
    """Rate of each place as a node: as declared, or by the chain rule from coordinates; 0 where unknown."""
    graph, equations = lowered.graph, lowered.equations.equations
    moving = len(equations.coordinates)
    velocities = [graph.symbol(loads[f"y[{moving + i}]"], varying=True) for i in range(moving)]
    positions = [graph.symbol(loads[f"y[{i}]"], varying=True) for i in range(moving)]
    found = []
    for place, row in zip(places, derivatives(graph, followed(lowered, places), positions), strict=True):
        if place.element.rate is not None:
            found.append(lowered.equations.lower(equations.symbolic(place.element.rate)))
        elif place.has_rate:
            found.append(graph.total([graph.mul(by, v) for by, v in zip(row, velocities, strict=True)]))
        else:
            found.append(graph.number(0.0))
    return found


def port(effect: Effect, at: str) -> EffectUse:
    """Effect at a place, with factors of 0, by which others act there."""
    return EffectUse(effect=effect.name, at=(at,), parameters=dict.fromkeys(effect.factors, 0.0))


def is_of_one(displacement: Expression | None, coordinates: Collection[str]) -> bool:
    """Whether a displacement is a coordinate, or a sum or difference of coordinates."""
    if displacement is None:
        return False
    alone = all(step.operation in {"symbol", "+", "-", "negative"} for step in displacement.steps)
    return alone and displacement.symbols <= set(coordinates)


def _place(model: ModelDeclaration, name: str, element: Element, degree: str | None, *, declared: bool) -> Place:
    has_force = declared and couplings.has_own_force(model, element)
    return Place(name, element, declared, degree, couplings.has_rate(model, element), has_force)


def _degree(model: ModelDeclaration, element: Element) -> str | None:
    """Degree that an element is a place of: what it follows alone, or an output, and it acts on that alone.

    A state may be the rate of its element, as the speed of a motor is.
    """
    name, *others = element.acts
    if others or name in couplings.driven_outputs(model):
        return None if others else name
    if name in model.coordinates and element.rate is not None and _text(element.rate) != f"{name}'":
        return None
    texts = {_text(element.displacement)} | ({_text(element.rate)} if name in model.states else set())
    return name if name in texts else None


def _alone(model: ModelDeclaration, name: str, unit: str) -> Element:
    """Element of a degree by itself; a force on an output follows nothing that is known."""
    if name in couplings.driven_outputs(model):
        return Element(unit=unit, acts={name: Expression("1")})
    return Element(displacement=Expression(name), unit=unit, acts={name: Expression("-1")})


def _weights(model: ModelDeclaration) -> Mapping[str, str]:
    """Relative masses of coordinates that elements join: m_b / m_a = -acts[a] / acts[b]."""
    known: dict[str, str] = {}
    joined = [e.acts for e in model.elements.values() if len(e.acts) == 2]
    if not joined:
        return dict.fromkeys(model.coordinates, "1")
    known[next(reversed(joined[0]))] = "1"
    for _ in joined:
        for acts in joined:
            (a, by_a), (b, by_b) = acts.items()
            if b in known and a not in known:
                known[a] = f"-({by_b.text})/({by_a.text})*{known[b]}"
            elif a in known and b not in known:
                known[b] = f"-({by_a.text})/({by_b.text})*{known[a]}"
    return known


def _force_unit(model: ModelDeclaration, name: str, dimension: Dimension | None) -> str:
    """Unit of a force on a coordinate, as it is usually written."""
    if is_plain(model) or dimension is None:
        return "1"
    own = {n: f"{c.unit}/s**2" for n, c in model.coordinates.items()}
    own |= {n: o.unit for n, o in model.outputs.items()} | {n: f"{z.unit}/s" for n, z in model.states.items()}
    usual = (*(e.unit for e in model.elements.values()), own[name], *USUAL)
    return next((unit for unit in usual if dimension_of(unit) == dimension), describe(dimension))


def _text(expression: Expression | None) -> str:
    return "" if expression is None else expression.text.replace(" ", "")
