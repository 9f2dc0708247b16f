"""Acting: what forces in elements act on, coordinates or not, and what moves the elements."""

from __future__ import annotations

from collections.abc import Collection

from masking.model.declaration.differentiate import rate_of
from masking.model.declaration.expression import Expression
from masking.model.declaration.schema import Element, ModelDeclaration


def acted_on(model: ModelDeclaration) -> set[str]:
    """Give the names of the coordinates, internal states and outputs that elements act on."""
    return {name for element in model.elements.values() for name in element.acts}


def driven_states(model: ModelDeclaration) -> tuple[str, ...]:
    """Give the internal states that forces act on: those of elements, or all of a model of nothing but states."""
    if not model.coordinates and not model.elements:
        return tuple(model.states)
    return tuple(name for name in model.states if name in acted_on(model))


def driven_outputs(model: ModelDeclaration) -> tuple[str, ...]:
    """Give the outputs that elements act on, such as the force of a component on a test bench."""
    others = {*model.coordinates, *model.states}
    return tuple(name for name in model.outputs if name in acted_on(model) - others)


def motions(element: Element) -> tuple[Expression, ...]:
    """Give what an element follows: displacement and rate, as far as it has them."""
    return tuple(x for x in (element.displacement, element.rate) if x is not None)


def measured_inputs(model: ModelDeclaration) -> tuple[str, ...]:
    """Give the inputs that elements follow: a motion that was measured, where others are commands.

    What acts on coordinates and follows no motion but inputs, without a rate, is a force of commands.
    """
    inputs, moved = {*model.inputs}, {*model.coordinates}
    followed = set[str]()
    for element in model.elements.values():
        names = {name for x in motions(element) for name in x.names}
        of_commands = element.rate is None and {*element.acts} <= moved and names <= inputs
        followed |= set() if of_commands else names
    return tuple(name for name in model.inputs if name in followed)


def has_rate(model: ModelDeclaration, element: Element) -> bool:
    """Whether it is known how fast an element is stretched: it is declared, or follows from coordinates."""
    if element.rate is not None or element.displacement is None:
        return element.rate is not None
    return not element.displacement.names & {*model.states, *model.inputs}


def has_own_force(model: ModelDeclaration, element: Element) -> bool:
    """Whether an element declares a force that follows nothing but its own motion."""
    if element.force is None:
        return False
    moving = {name + primes for name in model.coordinates for primes in ("", "'", "''")}
    return not element.force.names & definitions_with(model, {*moving, *model.inputs, "t"})


def motion_rate(model: ModelDeclaration, element: Element) -> Expression | None:
    """Give how fast an element is stretched: as declared, or from its displacement of coordinates; None if unknown."""
    if element.rate is not None or element.displacement is None or not has_rate(model, element):
        return element.rate
    return Expression(rate_of(element.displacement, model.coordinates))


def is_fed(model: ModelDeclaration, measured: Expression) -> bool:
    """Whether inputs or forces change what a sensor measures at once, before the motion follows.

    It holds inputs or accelerations, or an output that does, or that elements act on.
    """
    direct, driven = _fed_names(model), driven_outputs(model)
    fed = {n for n, output in model.outputs.items() if n in driven or output.expression.symbols & direct}
    return bool(measured.symbols & (direct | fed - {*model.coordinates, *model.states}))


def is_commanded(model: ModelDeclaration, measured: Expression) -> bool:
    """Whether inputs change what a sensor measures at once; forces of elements that follow the motion do not."""
    commanded = {*model.inputs} | definitions_with(model, model.inputs)
    direct = _fed_names(model) if _accelerate(model, commanded) else commanded
    elements = [one for one in model.elements.values() if any(x.symbols & direct for x in motions(one))]
    driven = {name for one in elements for name in one.acts}
    outputs = {n for n, output in model.outputs.items() if n in driven or output.expression.symbols & direct}
    return bool(measured.symbols & (direct | outputs - {*model.coordinates, *model.states}))


def _accelerate(model: ModelDeclaration, names: Collection[str]) -> bool:
    """Whether some of these names stand in the equations of motion: they change accelerations at once."""
    pushing = [one for one in model.elements.values() if {*one.acts} & {*model.coordinates}]
    texts = [*(side for sides in model.motion.items() for side in sides), *model.forces.values()]
    texts += [x for one in pushing for x in (one.force, *motions(one), *one.acts.values()) if x is not None]
    texts += [x for x in (model.lagrangian, model.dissipation) if x is not None]
    return any(x.symbols & {*names} for x in texts)


def _fed_names(model: ModelDeclaration) -> set[str]:
    """Give inputs, accelerations, and the definitions that hold them."""
    direct = {*model.inputs, *(f"{name}''" for name in model.coordinates)}
    return direct | definitions_with(model, direct)


def definitions_with(model: ModelDeclaration, symbols: Collection[str]) -> set[str]:
    """Give the definitions that contain one of some symbols, by way of other definitions too."""
    found, more = set[str](), {*symbols}
    while more:
        more = {name for name, expression in model.definitions.items() if expression.symbols & more} - found
        found |= more
    return found
