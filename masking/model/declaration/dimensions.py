"""The dimensions of a model: what is added, compared or equated must have one dimension, and scales must span it.

The dimension of an expression follows from the declared units of its symbols; a derivative divides by time, a literal
is a pure number, and a literal 0 fits everything. Units of one dimension, such as m and mm, are not distinguished here.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction

from masking.errors import DeclarationError, Problem
from masking.model.declaration.couplings import driven_outputs
from masking.model.declaration.expression import Expression
from masking.model.declaration.model_checks import equation_of, formulas
from masking.model.declaration.operations import COMPARISONS, Step
from masking.model.declaration.schema import Declaration, Element, ModelDeclaration
from masking.model.declaration.units import NONE, TIME, Dimension, conversion, describe, dimension_of, instead_of

_SECTIONS = ("coordinates", "states", "inputs", "parameters", "outputs", "elements", "scales")
_USUAL = {  # the scales that are proposed, in this order
    "time": "s", "length": "m", "mass": "kg", "voltage": "V", "current": "A", "temperature": "K", "substance": "mol",
    "luminosity": "cd",
}  # fmt: skip
_SAME = COMPARISONS | {"+", "-", "min", "max", "atan2"}


def check_dimensions(model: ModelDeclaration) -> list[Problem]:
    """List where a model adds, compares or equates unlike dimensions; a model without units is not looked at."""
    units, problems = _dimensions(model)
    if problems or is_plain(model):
        return problems
    return _Checker(model, units).check()


def check_scales(model: ModelDeclaration) -> list[Problem]:
    """List the units of a model that its scales cannot make dimensionless, each with the scales to add.

    A model without scales is not looked at, nor one with a unit that is none, which `check_dimensions` reports.
    """
    units, problems = _dimensions(model)
    if problems or not model.scales:
        return []
    scales = {name: scale.unit for name, scale in model.scales.items()}
    used: dict[str, list[str]] = {}
    for path in units:
        section, name, _ = path.split(".")
        if section not in {"outputs", "elements", "scales"}:
            used.setdefault(getattr(model, section)[name].unit, []).append(path)
    whole = dict(scales)  # and what is proposed
    for unit, (path, *others) in used.items():
        try:
            conversion(unit, scales)
        except DeclarationError as error:
            whole |= _additions(unit, whole)
            powers = conversion(unit, whole).exponents
            more = {name: of for name, of in whole.items() if name not in scales and powers[name] != 0.0}
            wanted = ", ".join(f"'{name}: {{value: 1, unit: {of}}}'" for name, of in more.items())
            also = f" (also of {', '.join(other.split('.')[1] for other in others)})" if others else ""
            remedy = f"add to scales: {wanted}, with the value that suits"
            problems.append(Problem(model.place(path), path, error.problems[0].message + also, remedy))
    return problems


def is_plain(model: ModelDeclaration) -> bool:
    """Whether nothing in a model but its scales has a unit."""
    return all(entry.unit == "1" for section in _SECTIONS[:-1] for entry in getattr(model, section).values())


def symbol_dimensions(model: ModelDeclaration) -> dict[str, Dimension | None] | None:
    """Give the dimension of every symbol of a model, derivatives included; None where a declared unit is none."""
    units, problems = _dimensions(model)
    if problems:
        return None
    checker = _Checker(model, units)
    checker.start()
    return checker.symbols


def force_dimensions(model: ModelDeclaration) -> dict[str, Dimension | None]:
    """Give the dimension of a force on each coordinate: that of its equation, or energy per coordinate of a Lagrangian.

    That on an output that elements act on is of the output itself. Raises a `DeclarationError` where a unit or an
    expression of the model has no dimension.
    """
    units, problems = _dimensions(model)
    checker = _Checker(model, units, problems=problems)
    if not problems:
        checker.start()
        action = None if model.lagrangian is None else checker.of(model.lagrangian)
        found = {name: checker.on(name, action) for name in (*model.coordinates, *model.states, *driven_outputs(model))}
    if problems:
        raise DeclarationError(problems)
    return found


def dimension_in(expression: Expression, symbols: Mapping[str, Dimension | None]) -> Dimension | None:
    """Give the dimension of an expression, None when it fits any; raises `DeclarationError` where it has none."""
    return expression.walk(_Dimensions(expression, symbols))[0]


def displacement_dimension(element: Element, symbols: Mapping[str, Dimension | None]) -> Dimension | None:
    """Give the dimension of how far an element is stretched: as declared, or that of its rate times time."""
    if element.displacement is not None:
        return dimension_in(element.displacement, symbols)
    rate, time = None if element.rate is None else dimension_in(element.rate, symbols), symbols["t"]
    return None if rate is None or time is None else _times(rate, time, 1)


def unit_problem(declaration: Declaration, path: str, error: DeclarationError) -> Problem:
    """Describe a unit that is none, at its place in a declaration, by what reading it raised."""
    return replace(error.problems[0], place=declaration.place(path), path=path)


def _dimensions(model: ModelDeclaration) -> tuple[dict[str, Dimension], list[Problem]]:
    """Give the dimension of every declared unit by its path, and the units that are none."""
    problems: list[Problem] = []
    units: dict[str, Dimension] = {}
    for section in _SECTIONS:
        for name, entry in getattr(model, section).items():
            path = f"{section}.{name}.unit"
            try:
                units[path] = dimension_of(entry.unit)
            except DeclarationError as error:
                problems.append(unit_problem(model, path, error))
    return units, problems


def _additions(unit: str, scales: Mapping[str, str]) -> dict[str, str]:
    """Give the fewest usual scales that make a unit dimensionless together with those that are there."""
    usual = {(f"{name}2" if name in scales else name): of for name, of in _USUAL.items()}
    for count in range(len(usual) + 1):
        for names in itertools.combinations(usual, count):
            more = {name: usual[name] for name in names}
            try:
                conversion(unit, {**scales, **more})
            except DeclarationError:
                continue
            return more
    return usual


@dataclass
class _Checker:
    """Walks the expressions of one model with the dimensions of its symbols."""

    model: ModelDeclaration
    units: Mapping[str, Dimension]
    symbols: dict[str, Dimension | None] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)

    def start(self) -> Dimension:
        """Find the dimensions of all symbols; gives that of time."""
        model, time = self.model, TIME if self.has_time() else NONE
        self.symbols["t"] = time
        for section, orders in (("coordinates", 3), ("states", 2)):
            for name in getattr(model, section):
                unit = self.units[f"{section}.{name}.unit"]
                self.symbols |= {name + "'" * order: _times(unit, time, -order) for order in range(orders)}
        for section in ("inputs", "parameters"):
            self.symbols |= {name: self.units[f"{section}.{name}.unit"] for name in getattr(model, section)}
        self.define()
        return time

    def check(self) -> list[Problem]:
        model, time = self.model, self.start()
        for left, right in model.equations.items():
            self.same(self.of(left), right, "the left side is {}, the right side {}")
        for path, expression in formulas(model):
            section, _, rest = path.partition(".")
            if section in {"parameters", "outputs", "scales", "states"}:
                name = rest.rpartition(".")[0]
                is_declared = "unit" in getattr(model, section)[name].model_fields_set
                if section in {"scales", "states"} and not expression.symbols:
                    continue  # a number, in the unit of the entry
                unit = self.units[f"{section}.{name}.unit"] if is_declared else None
                written = getattr(model, section)[name].unit
                self.same(unit, expression, "the declared unit is {}, the expression {}", written)
            elif section == "energy":
                self.of(expression)
        action = None if model.lagrangian is None else self.of(model.lagrangian)
        if model.lagrangian is not None:
            self.lagrangian(action, time)
        for name in model.elements:
            self.element(name, action, time)
        for path, expression in formulas(model):
            if path.startswith("events."):
                jumping = path.partition(".jumps.")[2]
                self.same(self.symbols.get(jumping), expression, "what jumps is {}, its value afterwards {}")
        self.drawing()
        return self.problems

    def drawing(self) -> None:
        """Check that angles of a drawing are numbers, and that all its lengths have one dimension."""
        length: Dimension | None = None
        for shape in self.model.drawing:
            for path, expression in shape.formulas:
                if path.endswith(".angle"):
                    self.same(NONE, expression, "an angle must be {}, not {}")
                else:
                    self.same(length, expression, "the drawing begins with lengths in {}, this is {}")
                    length = length if length is not None else self.of(expression)

    def has_time(self) -> bool:
        """Whether time has a unit here: whether any unit but those of the scales involves it."""
        position = TIME.index(1)
        return any(unit[position] != 0 for path, unit in self.units.items() if not path.startswith("scales."))

    def lagrangian(self, action: Dimension | None, time: Dimension) -> None:
        """Check that forces and dissipation go with the Lagrangian: L/q, and L per time."""
        if self.model.dissipation is not None:
            power = None if action is None else _times(action, time, -1)
            self.same(power, self.model.dissipation, "a dissipation must be {} as the lagrangian says, not {}")
        for name, force in self.model.forces.items():
            message = "a force on this coordinate must be {} as the lagrangian says, not {}"
            self.same(self.on(name, action), force, message)

    def element(self, name: str, action: Dimension | None, time: Dimension) -> None:
        """Check that the force of an element, times what it acts with, goes with the equations of motion."""
        element, force = self.model.elements[name], self.units[f"elements.{name}.unit"]
        moved = None if element.displacement is None else self.of(element.displacement)
        if element.rate is not None:
            wanted = None if moved is None else _times(moved, time, -1)
            self.same(wanted, element.rate, "the rate of this displacement is in {}, not in {}")
        if element.force is not None:
            moved = displacement_dimension(element, self.symbols)
            motion = {"d": moved, "d_rate": None if moved is None else _times(moved, time, -1)}
            law = replace(self, symbols=self.symbols | motion)
            law.same(force, element.force, "the unit of the element is {}, its force is {}")
        message = f"the force in {element.unit} must be multiplied by {{}} to act here, not by {{}}"
        for coordinate, factor in element.acts.items():
            wanted = self.on(coordinate, action)
            self.same(None if wanted is None else _times(wanted, force, -1), factor, message)

    def on(self, coordinate: str, action: Dimension | None) -> Dimension | None:
        """Give the dimension of a force on a coordinate, as `force_dimensions` does; that of L is the `action`."""
        if coordinate in self.model.outputs and coordinate not in {*self.model.coordinates, *self.model.states}:
            output = self.model.outputs[coordinate]
            is_declared = "unit" in output.model_fields_set
            return self.units[f"outputs.{coordinate}.unit"] if is_declared else self.of(output.expression)
        if self.model.lagrangian is None or coordinate in self.model.states:
            left = equation_of(self.model, coordinate)
            return None if left is None else self.of(left)
        moved = self.symbols.get(coordinate)
        return None if action is None or moved is None else _times(action, moved, -1)

    def define(self) -> None:
        """Find the dimensions of definitions, each after those it uses."""
        waiting = dict(self.model.definitions)
        while waiting:
            ready = [name for name, expression in waiting.items() if not expression.names & waiting.keys()]
            for name in ready:
                self.symbols[name] = self.of(waiting.pop(name))
            if not ready:  # a cycle, which is reported elsewhere
                return

    def of(self, expression: Expression) -> Dimension | None:
        """Give the dimension of an expression, None when it fits any."""
        try:
            return dimension_in(expression, self.symbols)
        except DeclarationError as error:
            self.problems += error.problems
            return None

    def same(self, wanted: Dimension | None, expression: Expression, message: str, written: str = "") -> None:
        found = self.of(expression)
        if wanted is not None and found is not None and wanted != found:
            whole = (0, len(expression.text))
            first = describe(wanted) if "unit is {}" in message else _shown(wanted)
            remedy = instead_of(written, found)
            self.problems.append(expression.problem(whole, message.format(first, _shown(found)), remedy))


def _shown(dimension: Dimension) -> str:
    return "a number without unit" if dimension == NONE else describe(dimension)


def _times(a: Dimension, b: Dimension, power: int | Fraction) -> Dimension:
    return tuple(x + power * y for x, y in zip(a, b, strict=True))


@dataclass(frozen=True, slots=True)
class _Dimensions:
    """Reads an expression: (dimension or None when any fits, number if constant)."""

    expression: Expression
    symbols: Mapping[str, Dimension | None]

    def number(self, step: Step) -> tuple[Dimension | None, float | None]:
        value = math.pi if step.value == "pi" else float(step.value)
        return (None if value == 0.0 else NONE), value

    def symbol(self, step: Step) -> tuple[Dimension | None, float | None]:
        return self.symbols.get(step.value), None

    def apply(
        self, step: Step, args: Sequence[tuple[Dimension | None, float | None]]
    ) -> tuple[Dimension | None, float | None]:
        a, b = args[0], args[-1]
        if step.operation == "negative":
            return a[0], None if a[1] is None else -a[1]
        if step.operation in {"*", "/"}:
            sign = 1 if step.operation == "*" else -1
            number = None if a[1] is None or b[1] is None else a[1] * b[1] ** sign
            return (None if a[0] is None or b[0] is None else _times(a[0], b[0], sign)), number
        return self._dimension(step, args), None

    def _dimension(self, step: Step, args: Sequence[tuple[Dimension | None, float | None]]) -> Dimension | None:
        dimensions = [dimension for dimension, _ in args]
        first, name = dimensions[0], step.operation
        if name == "**":
            return self._power(step, first, args[1])
        if name == "sqrt":
            return None if first is None else _times(NONE, first, Fraction(1, 2))
        if name in {"abs", "delay"}:
            late, time = dimensions[-1], self.symbols.get("t")
            if name == "delay" and late is not None and time is not None and late != time:
                message = f"the delay is {_shown(late)}, and time is {_shown(time)}"
                remedy = "declare the delay as a parameter with a unit"
                raise DeclarationError(self.expression.problem(step, message, remedy))
            return first
        if name == "where":
            return self._same(step, dimensions[1:])
        if name in _SAME:
            common = self._same(step, dimensions)
            return NONE if name == "atan2" or name in COMPARISONS else common
        if name not in {"sign", "heaviside"} and first is not None and first != NONE:
            message = f"takes {name} of {describe(first)}"
            raise DeclarationError(self.expression.problem(step, message, "its argument must be dimensionless"))
        return NONE

    def _same(self, step: Step, dimensions: Sequence[Dimension | None]) -> Dimension | None:
        first: Dimension | None = None
        for dimension in dimensions:
            if first is not None and dimension is not None and dimension != first:
                a, b = _shown(first), _shown(dimension)
                verb = "adds {} to {}" if step.operation == "+" else "subtracts {} from {}"
                message = verb.format(b, a) if step.operation in {"+", "-"} else f"compares {a} with {b}"
                raise DeclarationError(self.expression.problem(step, message))
            first = first if first is not None else dimension
        return first

    def _power(
        self, step: Step, base: Dimension | None, exponent: tuple[Dimension | None, float | None]
    ) -> Dimension | None:
        if exponent[0] not in {None, NONE}:
            message = f"the exponent is {describe(exponent[0] or NONE)}"
            raise DeclarationError(self.expression.problem(step, message, "an exponent must be dimensionless"))
        if base is None or base == NONE:
            return base
        if exponent[1] is None:
            message = f"raises {describe(base)} to a power that is not a number"
            raise DeclarationError(self.expression.problem(step, message, "make the base dimensionless"))
        return _times(NONE, base, Fraction(exponent[1]).limit_denominator(60))
