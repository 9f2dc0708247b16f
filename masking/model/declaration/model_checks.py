"""What a model must fulfil beyond its schema, checked without sympy: names, symbols, structure and parameters."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter

from masking.errors import DeclarationError, Problem, nearest
from masking.model.declaration import expansion_size
from masking.model.declaration.couplings import definitions_with, driven_outputs, motions
from masking.model.declaration.expression import Expression
from masking.model.declaration.schema import Declaration, ModelDeclaration
from masking.model.declaration.shorthand import SHORT
from masking.model.declaration.syntax import LARGEST
from masking.model.declaration.tables import TABLES

_COHERENT = frozenset(
    ["m", "kg", "s", "A", "K", "mol", "cd", "rad", "Hz", "N", "J", "W", "V", "C", "F", "H", "T", "Pa", "Wb", "ohm"]
)
# The parts of an entry of each section that may be expressions.
_FORMULAS = {
    "parameters": ["value"], "outputs": ["expression"], "scales": ["value"],
    "elements": ["displacement", "rate", "force"], "states": ["size"],
}  # fmt: skip


def velocities(names: Iterable[str]) -> list[str]:
    """Give the first derivatives of coordinates."""
    return [f"{name}'" for name in names]


def accelerations(names: Iterable[str]) -> list[str]:
    """Give the second derivatives of coordinates."""
    return [f"{name}''" for name in names]


def equation_of(model: ModelDeclaration, coordinate: str) -> Expression | None:
    """Give the left-hand side of the equation in which a force on a coordinate acts: x'', or such as m*x''.

    It holds this acceleration and no other; that of an internal state holds its rate. None where there is no such
    equation, as in a Lagrangian model.
    """
    if coordinate in model.states:
        return next((left for left in model.equations if model.state_of(left) == coordinate), None)
    others = {f"{name}''" for name in model.coordinates if name != coordinate}
    own = [left for left in model.motion if f"{coordinate}''" in left.symbols and not left.symbols & others]
    return own[0] if own else None


def formulas(model: ModelDeclaration) -> Iterator[tuple[str, Expression]]:
    """Yield every expression of a model with its path, the left-hand sides of equations included."""
    found = {p: getattr(model, p) for p in ("lagrangian", "dissipation", "energy")}
    for section in ("definitions", "forces"):
        found |= {f"{section}.{name}": x for name, x in getattr(model, section).items()}
    for section, parts in _FORMULAS.items():
        for name, entry in getattr(model, section).items():
            found |= {f"{section}.{name}.{part}": getattr(entry, part) for part in parts}
    found |= {f"elements.{e}.acts.{name}": x for e, entry in model.elements.items() for name, x in entry.acts.items()}
    found |= {f"events.{e}.{part}": x for e, entry in model.events.items() for part, x in entry.formulas}
    yield from ((path, x) for path, x in found.items() if isinstance(x, Expression))
    yield from ((f"equations.{left}", side) for left, right in model.equations.items() for side in (left, right))


def used(model: ModelDeclaration) -> set[str]:
    """Names that the expressions of a model hold, those of its drawing and its effects included."""
    drawn = (formula for shape in model.drawing for _, formula in shape.formulas)
    given = (x for use in model.effects.values() for x in use.parameters.values() if isinstance(x, Expression))
    return {name for expression in [*(x for _, x in formulas(model)), *drawn, *given] for name in expression.names}


def delayed(model: ModelDeclaration) -> Iterator[tuple[str, Problem]]:
    """Yield the path of every formula with a delay, with the problem that it is where none may be."""
    for path, expression in formulas(model):
        for step in expression.steps:
            if step.operation == "delay":
                where = "delay(...) stands in equations, forces and definitions"
                yield path, expression.problem(step, "may not be delayed here", where)


def beyond_ordinary(model: ModelDeclaration) -> list[str]:
    """List what a model has that ordinary differential equations have not: delays, events."""
    return [*["delays"] * any(delayed(model)), *["events"] * bool(model.events)]


def check_model(model: ModelDeclaration, whole: bool = True, lost: Collection[str] = ()) -> list[Problem]:
    """List everything that is wrong with a model; of one that is not whole, only names and symbols.

    It is whole if the schema refused nothing of it; `lost` are names in a section whose key is not known, which pass
    for anything.
    """
    outside = [*_outside(model)]
    problems = [*outside, *_names(model, lost), *_symbols(model, lost), *_drawing(model, lost)]
    may_be_late = ("equations.", "forces.", "definitions.")
    problems += [problem for path, problem in delayed(model) if not path.startswith(may_be_late)]
    if whole:
        problems += [*_structure(model), *_elements(model), *_events(model), *_unused(model)]
        problems += _cycles(model, "definitions", model.definitions)
        for path, size in expansion_size.oversized(formulas(model), model.definitions):
            message = f"with its definitions written out it has {size} operations and operands"
            remedy = f"at most {LARGEST} are allowed: a definition that holds another one twice doubles it"
            problems.append(problem_at(model, path, message, remedy))
        problems += check_parameters(model, {})
    places = {problem.path for problem in outside}  # of which nothing else need be said
    return [problem for problem in problems if problem in outside or problem.path not in places]


def problem_at(declaration: Declaration, path: str, message: str, remedy: str = "", at_key: bool = False) -> Problem:
    """Describe what is wrong with one value of a declaration, or with its key."""
    place = declaration.key_place(path) if at_key else declaration.place(path)
    return Problem(place, path, message, remedy)


def strangers(
    declaration: Declaration, section: str, names: Iterable[str], allowed: Collection[str], what: str
) -> Iterator[Problem]:
    """Find keys of a section that are not among the names which are allowed; `what` says what these are."""
    for name in names:
        if name not in allowed:
            remedy = nearest(name, allowed) if allowed else "there is none"
            yield problem_at(declaration, f"{section}.{name}", f"'{name}' is not {what}", remedy, at_key=True)


def _names(model: ModelDeclaration, lost: Collection[str]) -> Iterator[Problem]:
    owner: dict[str, str] = {}
    for section in ("coordinates", "states", "inputs", "parameters", "definitions", "elements"):
        for name in getattr(model, section):
            if name in owner:
                message = f"the name '{name}' is already used in {owner[name]}"
                yield problem_at(model, f"{section}.{name}", message, "rename one of them", at_key=True)
            owner.setdefault(name, section)
    for i, name in enumerate(model.oscillators or ()):
        if name not in {*model.coordinates, *lost}:
            remedy = nearest(name, model.coordinates)
            yield problem_at(model, f"oscillators.{i}", f"'{name}' is not a coordinate", remedy)
    forces = [name for name in model.forces if name not in lost]
    yield from strangers(model, "forces", forces, model.coordinates, "a coordinate")
    taken = {*model.coordinates, *model.states, *model.outputs}
    kinds = ["a coordinate", *["a state"] * bool(model.states), *["an output"] * bool(model.outputs)]
    for element, entry in model.elements.items():
        acts = [name for name in entry.acts if name not in lost]
        yield from strangers(model, f"elements.{element}.acts", acts, taken, _joined(kinds, "or"))
    for name in driven_outputs(model):
        if name in owner:
            message = f"elements act on the output '{name}', a name that is already used in {owner[name]}"
            yield problem_at(model, f"outputs.{name}", message, "rename one of them", at_key=True)


def _symbols(model: ModelDeclaration, lost: Collection[str]) -> Iterator[Problem]:
    """Check which symbols each expression may use: accelerations not everywhere, parameters only over parameters."""
    static, coordinates = [*model.parameters, *lost], [*model.coordinates, *lost]
    rest = [*coordinates, *velocities(coordinates), *model.states, *model.inputs, *model.parameters]
    rest += [*model.definitions, "t"]
    moving = [*rest, *accelerations(coordinates)]
    accelerated = definitions_with(model, accelerations(coordinates))
    steady = [symbol for symbol in moving if symbol not in model.inputs]
    own = {id(left): f"{state}'" for left in model.equations if (state := model.state_of(left))}
    of_states = {f"equations.{left}" for left in model.equations if id(left) in own}
    for path, expression in formulas(model):
        section = path.partition(".")[0]
        rates = [x for x in sorted(expression.symbols) if x.endswith("'") and x.rstrip("'") in model.states]
        for symbol in (x for x in rates if x != own.get(id(expression))):
            name = symbol.rstrip("'")
            message = f"'{symbol}' is a rate of the internal state '{name}', which stands only in its own equation"
            remedy = f"write {name}': ... under equations, on the left side without other rates and accelerations"
            yield expression.problem(expression.first(symbol), message, remedy)
        stretched = [*static, *coordinates, *model.states, *model.inputs]
        if path.endswith(".rate") and section == "elements":
            stretched += velocities(coordinates)
        if path.endswith(".force") and section == "elements":
            stretched = ["d", "d_rate", "t", *static, *model.states, *model.definitions]
        narrow = {"parameters": static, "scales": static, "states": static, "elements": stretched, "events": steady}
        allowed = narrow.get(section, moving)
        yield from check_symbols(expression, [*allowed, *rates], coordinates, known=moving)
        where = section if section in {"lagrangian", "dissipation", "energy"} else ""
        if path in of_states:
            where = "the equation of an internal state"
        if section == "events":
            where = "an event"
        if where:
            for symbol in sorted(expression.symbols):
                if (symbol.endswith("''") and symbol in moving) or symbol in accelerated:
                    what = "is an acceleration" if symbol.endswith("''") else "contains an acceleration"
                    message = f"'{symbol}' {what}, which {where} may not contain"
                    yield expression.problem(expression.first(symbol), message)


def _drawing(model: ModelDeclaration, lost: Collection[str]) -> Iterator[Problem]:
    """Check that each shape is of one kind, and is placed by coordinates, internal states and parameters."""
    coordinates = [*model.coordinates, *lost]
    for i, shape in enumerate(model.drawing):
        if len(shape.kinds) != 1:
            message = f"a shape is of one kind, not {_joined(shape.kinds, 'and') or 'none'}"
            yield problem_at(model, f"drawing.{i}", message, f"write one of {', '.join(shape.KINDS)}")
        for _, expression in shape.formulas:
            known = [*velocities(coordinates), *model.inputs, *model.definitions]
            allowed = [*coordinates, *model.states, *model.parameters, "t"]
            yield from check_symbols(expression, allowed, coordinates, known)
            for step in expression.steps:
                if step.operation in TABLES:
                    yield expression.problem(step, "a drawing takes no tables", "write the curve as an expression")


def check_symbols(
    expression: Expression, allowed: Collection[str], coordinates: Collection[str], known: Collection[str] = ()
) -> Iterator[Problem]:
    """Yield a problem for each symbol that is not allowed: derivative of no coordinate, not for here, or unknown.

    Coordinates are names that have derivatives; `known` are symbols that are allowed elsewhere.
    """
    for problem, symbol in zip(expression.check_symbols(allowed), expression.unknown(allowed), strict=True):
        name = symbol.rstrip("'")
        if symbol != name and name not in coordinates and (name in allowed or name in known):
            message = f"'{symbol}' is a derivative of '{name}', which is not a coordinate"
            yield expression.problem(expression.first(symbol), message, nearest(name, coordinates))
        elif symbol in known:
            names = ", ".join(allowed)
            remedy = f"allowed: {names}" if names and len(allowed) < 9 else ""
            yield expression.problem(expression.first(symbol), f"'{symbol}' may not be used here", remedy)
        else:
            yield problem


def _structure(model: ModelDeclaration) -> Iterator[Problem]:
    """Check that the parts of a model fit together: as many equations as coordinates, or one Lagrangian."""
    motion = _motion(model)
    count, wanted = len(motion), len(model.coordinates)
    if model.terms:
        remedy = "add to the equations themselves, or extend another model"
        yield problem_at(model, "terms", "terms are only for a model that extends another", remedy, at_key=True)
    yield from _counted_states(model)
    if model.lagrangian is not None:
        if count:
            yield problem_at(model, "equations", "a model has equations or a lagrangian, not both", at_key=True)
        if not wanted:
            yield problem_at(model, "lagrangian", "a lagrangian needs coordinates", at_key=True)
        return
    for part in ("dissipation", "forces"):
        if getattr(model, part):
            message = f"{part} stands only with a lagrangian"
            yield problem_at(model, part, message, "write it into the equations", at_key=True)
    if not wanted:
        if count:
            yield problem_at(model, "equations", "equations need coordinates", at_key=True)
        if not model.outputs and not model.states:
            yield problem_at(model, "", "a model without coordinates needs outputs")
        return
    if not count:
        yield problem_at(model, "coordinates", "coordinates need equations or a lagrangian", at_key=True)
        return
    yield from _counted(model, motion)


def _states_in(model: ModelDeclaration, left: Expression) -> set[str]:
    """Internal states whose rates a left-hand side holds."""
    return {name for name in model.states if f"{name}'" in left.symbols}


def _motion(model: ModelDeclaration) -> dict[Expression, Expression]:
    """Equations of motion, but for those that hold rates of internal states, where that is said."""
    return {left: right for left, right in model.motion.items() if not _states_in(model, left)}


def _counted_states(model: ModelDeclaration) -> Iterator[Problem]:
    """Check that every internal state has one equation."""
    found: set[str] = set()
    for left in model.equations:
        name = model.state_of(left)
        if name in found:
            message = f"the internal state '{name}' has two equations"
            yield problem_at(model, f"equations.{left.text}", message, "remove one of them", at_key=True)
        found |= {name} if name else set()
    found = found.union(*(_states_in(model, left) for left in model.equations))
    for name in model.states:
        if name not in found:
            message = f"the internal state '{name}' has no equation"
            yield problem_at(model, f"states.{name}", message, f"write {name}': ... under equations", at_key=True)


def _elements(model: ModelDeclaration) -> Iterator[Problem]:
    """Check that every element moves, and that its force has something to act on."""
    for name, element in model.elements.items():
        moving = {*model.coordinates, *model.states, *model.inputs}
        if not motions(element):
            path, message = f"elements.{name}", "an element needs a displacement, or a rate"
            yield problem_at(model, path, message, "write how far it is stretched, such as x1 - x3", at_key=True)
        for part in ("displacement", "rate"):
            moved = getattr(element, part)
            if moved is not None and not moved.names & moving:
                kinds = [k for k, n in (("a state", model.states), ("an input", model.inputs)) if n]
                kinds = ["a coordinate", *(kinds if not model.coordinates else ())]
                path, message = f"elements.{name}.{part}", f"a {part} must contain {_joined(kinds, 'or')}"
                yield problem_at(model, path, message, "write the difference of two, such as x1 - x3")
        if not element.acts:
            path, message = f"elements.{name}.acts", "an element acts on at least one coordinate"
            yield problem_at(model, path, message, "write {x1: -1, x3: 1}")
        for coordinate in element.acts:
            if model.lagrangian is None and coordinate in model.coordinates and not equation_of(model, coordinate):
                yield no_equation(model, coordinate, f"elements.{name}.acts.{coordinate}")


def _events(model: ModelDeclaration) -> Iterator[Problem]:
    """Check that every event has a condition that changes, and jumps of states."""
    states = [*model.coordinates, *velocities(model.coordinates), *model.states]
    moving, driven = [*states, *model.definitions, "t"], definitions_with(model, model.inputs)
    for name, event in model.events.items():
        for part, message, remedy in event.problems(states, moving):
            yield problem_at(model, f"events.{name}.{part}", message, remedy, at_key=part.startswith("jumps."))
        for _, expression in event.formulas:
            for symbol in sorted(expression.symbols & driven):
                message = f"'{symbol}' contains an input, which an event may not contain"
                remedy = "write the condition in terms of the motion, or give the model a state that follows the input"
                yield expression.problem(expression.first(symbol), message, remedy)
    if model.events and any(delayed(model)):
        remedy = "leave one of them out"
        yield problem_at(model, "events", "a model has events or delays, not both", remedy, at_key=True)


def no_equation(model: ModelDeclaration, coordinate: str, path: str) -> Problem:
    """Describe that no equation of motion is a coordinate's own, so that a force cannot act on it."""
    message = f"no equation has {coordinate}'' and no other acceleration on its left side"
    remedy = f"a force on {coordinate} acts in such an equation, as {coordinate}'': ..., or in those of a lagrangian"
    return problem_at(model, path, message, remedy, at_key=True)


def _counted(model: ModelDeclaration, motion: Mapping[Expression, Expression]) -> Iterator[Problem]:
    """Check that the equations determine every acceleration."""
    count, wanted = len(motion), len(model.coordinates)
    present = [_accelerations_in(model, sides) for sides in motion.items()]
    missing = [name for name in model.coordinates if not any(name in found for found in present)]
    if count == wanted:
        yield from _determined(model, present)
        return
    for name in missing:
        message = f"no equation contains {name}''"
        yield problem_at(model, f"coordinates.{name}", message, f"write {name}'': ... under equations", at_key=True)
    if not (missing and count < wanted):
        few = "too few" if count < wanted else "too many"
        yield problem_at(model, "equations", f"{count} equations for {wanted} coordinates are {few}", at_key=True)


def _accelerations_in(model: ModelDeclaration, sides: Iterable[Expression]) -> list[str]:
    """List the coordinates whose accelerations an equation contains, in its definitions too."""
    pending = sorted(set().union(*(side.symbols for side in sides)))
    found, seen = set(), set(pending)
    while pending:
        symbol = pending.pop()
        found.add(symbol)
        inside = model.definitions[symbol].symbols - seen if symbol in model.definitions else frozenset()
        seen |= inside
        pending += sorted(inside)
    return [name for name in model.coordinates if f"{name}''" in found]


def _determined(model: ModelDeclaration, present: Sequence[Collection[str]]) -> Iterator[Problem]:
    """Check that each equation can give an acceleration of its own: a matching of equations with accelerations."""
    owner: dict[str, int] = {}
    crowds = [crowd for equation in range(len(present)) if (crowd := _matched(equation, present, owner))]
    never = _joined([f"{name}''" for name in model.coordinates if name not in owner], "and")
    lefts = list(model.motion)
    for crowd in crowds:
        equations = sorted(crowd)
        names = [f"{name}''" for name in model.coordinates if any(name in present[i] for i in equations)]
        places = [model.key_place(f"equations.{lefts[i].text}") for i in equations]
        if names:
            often = "twice" if len(equations) == 2 else f"by {len(equations)} equations"
            lines = _joined([str(place.line) for place in places if place], "and")
            where = f" (lines {lines})" if lines else ""
            message = f"the equations determine {_joined(names, 'and')} {often}{where} and {never} never"
            remedy = f"one of these must contain {never}"
        else:
            message = f"the equation contains no acceleration, and none determines {never}"
            remedy = f"write {never}: ..."
        yield problem_at(model, f"equations.{lefts[equations[-1]].text}", message, remedy, at_key=True)


def _matched(equation: int, present: Sequence[Collection[str]], owner: dict[str, int]) -> list[int]:
    """Give an equation an acceleration, moving others on; or list the equations that are too many for theirs."""
    reached: dict[str, int] = {}
    crowd = [equation]
    for current in crowd:  # grows
        for name in present[current]:
            if name in reached:
                continue
            reached[name] = current
            if name in owner:
                crowd.append(owner[name])
                continue
            free: str | None = name
            while free is not None:
                taker = reached[free]
                before = next((other for other, its in owner.items() if its == taker), None)
                owner[free], free = taker, before
            return []
    return crowd


def _joined(words: Sequence[str], last: str) -> str:
    return f" {last} ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def _outside(model: ModelDeclaration) -> Iterator[Problem]:
    """Find fields of an entry, such as its unit, that stand beside it instead of inside of it."""
    names = used(model)
    for section in ("coordinates", "states", "inputs", "parameters"):
        before = ""
        for name, entry in getattr(model, section).items():
            short = entry.model_fields_set == {SHORT[section]}
            if before and short and name in type(entry).model_fields and name not in names:
                message = f"'{name}' stands among the {section}, and is a field of one, such as of '{before}'"
                remedy = f"indent it below '{before}:', or write {before}: {{..., {name}: ...}}"
                yield problem_at(model, f"{section}.{name}", message, remedy, at_key=True)
            before = name


def _unused(model: ModelDeclaration) -> Iterator[Problem]:
    """Find what has no use; parameters of a model with inputs may be those of what an experiment feeds to them."""
    names = used(model)
    for section in ("parameters", "definitions", "inputs"):
        yield from unused(model, section, model.parameters if section == "parameters" and model.inputs else names)


def unused(model: ModelDeclaration, section: str, names: Collection[str]) -> Iterator[Problem]:
    """Find what a section of a model declares that is not among the names that are used."""
    for name in getattr(model, section):
        if name not in names:
            message = f"the {section.removesuffix('s')} '{name}' is not used"
            yield problem_at(model, f"{section}.{name}", message, "remove it or use it", at_key=True)


def _cycles(model: ModelDeclaration, section: str, expressions: Mapping[str, Expression]) -> Iterator[Problem]:
    """Yield one problem for each cycle of names that share none, at the first of them."""
    uses = {name: sorted(expression.names & expressions.keys()) for name, expression in expressions.items()}
    while True:
        try:
            return TopologicalSorter(uses).prepare()
        except CycleError as error:
            loop = error.args[1][:0:-1]  # graphlib names what is used before what uses it
        first = min(loop, key=[*uses].index)
        turned = [*loop[loop.index(first) :], *loop[: loop.index(first)]]
        message = f"defined by itself: {' -> '.join([*turned, first])}"
        yield problem_at(model, f"{section}.{first}", message, at_key=True)
        uses = {name: used for name, used in uses.items() if name not in loop}


def check_parameters(model: ModelDeclaration, overrides: Mapping[str, float]) -> list[Problem]:
    """List everything that is wrong with the values of parameters, of which some may be replaced by name."""
    given = {name: overrides.get(name, parameter.value) for name, parameter in model.parameters.items()}
    formulas = {name: value for name, value in given.items() if isinstance(value, Expression)}
    problems = [*_cycles(model, "parameters", formulas)]
    values = {name: value for name, value in given.items() if not isinstance(value, Expression)}
    waiting = dict(formulas)
    while ready := [name for name, expression in waiting.items() if expression.names <= values.keys()]:
        for name in ready:
            try:
                values[name] = waiting.pop(name).evaluate(values)
            except DeclarationError as error:
                problems += error.problems
    # Of SI units without prefixes: expressions over their numbers are meaningful.
    units = {name for parameter in model.parameters.values() for name in re.findall(r"[A-Za-z]+", parameter.unit)}
    is_coherent = units <= _COHERENT
    for name, parameter in model.parameters.items():
        if name in values and (is_coherent or name not in formulas):
            shown = f"{name} = {values[name]:.12g}" + ("" if parameter.unit == "1" else f" {parameter.unit}")
            problems += bounded(model, f"parameters.{name}", shown, values[name], parameter.bounds)
    return problems


def bounded(
    declaration: Declaration, path: str, shown: str, value: float | None, bounds: tuple[float | None, float | None]
) -> Iterator[Problem]:
    """Check the bounds of a parameter, and that its value, in words such as "w = 2 rad/s", lies within them."""
    low, high = bounds
    if value is not None and not math.isfinite(value):
        yield problem_at(declaration, f"{path}.value", f"{shown} is not finite")
    elif low is not None and high is not None and low > high:
        yield problem_at(declaration, f"{path}.bounds", f"the lower bound {low:g} is above the upper bound {high:g}")
    elif value is not None and low is not None and value < low:
        yield problem_at(declaration, f"{path}.value", f"{shown} is below its lower bound {low:g}")
    elif value is not None and high is not None and value > high:
        yield problem_at(declaration, f"{path}.value", f"{shown} is above its upper bound {high:g}")
