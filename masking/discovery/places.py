"""Places: where an effect may sit in a model: its elements, each coordinate, and between each two coordinates.

A force between two coordinates acts on both; how strongly, their masses tell. Where these are not known from the model
itself, as in equations that are divided by a mass, they follow from its elements, which pass a force on.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from masking.declaration.checks import equation_of, no_equation
from masking.declaration.dimensions import force_dimensions, is_plain
from masking.declaration.expression import Expression
from masking.declaration.schema import Element, ModelDeclaration
from masking.declaration.units import Dimension, describe, dimension_of
from masking.errors import DeclarationError

USUAL = ("1", "N", "N*m")  # units of forces


@dataclass(frozen=True)
class Place:
    """One place: the name of its element, whether the model declares it, and the coordinate that it is, if one."""

    name: str
    element: Element
    declared: bool
    coordinate: str | None = None


def places(model: ModelDeclaration) -> tuple[Place, ...]:
    """Return every place of a model: elements, coordinates and pairs of coordinates, none of them twice.

    Raises:
        DeclarationError: a force cannot act on a coordinate, since no equation is its own.
    """
    forces = force_dimensions(model)
    lost = [name for name in model.coordinates if model.lagrangian is None and not equation_of(model, name)]
    if lost:
        raise DeclarationError([no_equation(model, name, f"coordinates.{name}") for name in lost])
    found = [Place(name, e, declared=True, coordinate=_coordinate(model, e)) for name, e in model.elements.items()]
    taken = {place.coordinate for place in found}
    for name in model.coordinates:
        if name not in taken:
            unit = _force_unit(model, name, forces[name])
            element = Element(displacement=Expression(name), unit=unit, acts={name: _one("-1")})
            found.append(Place(name, element, declared=False, coordinate=name))
    between = {_text(e.displacement.text) for e in model.elements.values()}
    weights = _weights(model)
    for a, b in itertools.combinations(model.coordinates, 2):
        if f"{a}-{b}" in between or f"{b}-{a}" in between or a not in weights or b not in weights:
            continue
        if model.coordinates[a].unit != model.coordinates[b].unit or forces[a] != forces[b]:
            continue
        acts = {a: _one("-1"), b: _one(f"({weights[a]})/({weights[b]})")}
        unit = _force_unit(model, a, forces[a])
        element = Element(displacement=Expression(f"{a} - {b}"), unit=unit, acts=acts)
        found.append(Place(f"{a}-{b}", element, declared=False))
    return tuple(found)


def opened(model: ModelDeclaration) -> tuple[ModelDeclaration, tuple[Place, ...]]:
    """Return a model in which every place is an element, and the places."""
    found = places(model)
    elements = {**model.elements, **{identifier(p.name): p.element for p in found if not p.declared}}
    return model.model_copy(update={"elements": elements}), found


def identifier(name: str) -> str:
    """Return the name of an element for a place, such as `x1_x2` for x1-x2."""
    return name.replace("-", "_") if "-" in name else f"{name}_place" if name.isidentifier() else name


def is_of_one(displacement: Expression, coordinates: Collection[str]) -> bool:
    """Return whether a displacement is a coordinate, or a sum or difference of coordinates."""
    alone = all(step.operation in {"symbol", "+", "-", "negative"} for step in displacement.steps)
    return alone and displacement.symbols <= set(coordinates)


def _coordinate(model: ModelDeclaration, element: Element) -> str | None:
    """Return the coordinate that an element is a place of: its displacement alone, and it acts on that alone."""
    text = _text(element.displacement.text)
    return text if text in model.coordinates and set(element.acts) == {text} else None


def _weights(model: ModelDeclaration) -> Mapping[str, str]:
    """Return the relative masses of coordinates that elements join: m_b / m_a = -acts[a] / acts[b]."""
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
    """Return the unit of a force on a coordinate, as it is usually written."""
    if is_plain(model) or dimension is None:
        return "1"
    usual = (*(e.unit for e in model.elements.values()), f"{model.coordinates[name].unit}/s**2", *USUAL)
    return next((unit for unit in usual if dimension_of(unit) == dimension), describe(dimension))


def _one(text: str) -> Expression:
    return Expression(text)


def _text(text: str) -> str:
    return text.replace(" ", "")
