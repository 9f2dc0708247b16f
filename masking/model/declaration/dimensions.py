"""The dimensions of a model: what is added, compared or equated must have one dimension, and scales must span it.

The dimension of an expression follows from the declared units of its symbols; a derivative divides by time, a literal
is a pure number, and a literal 0 fits everything. Units of one dimension, such as m and mm, are not distinguished here.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction

from masking.errors import DeclarationError, Problem
from masking.model.declaration.checks import equation_of, formulas
from masking.model.declaration.couplings import driven_outputs
from masking.model.declaration.definitions import in_order
from masking.model.declaration.expression import Expression
from masking.model.declaration.operations import OPERATIONS, Step
from masking.model.declaration.schema import Declaration, Element, ModelDeclaration
from masking.model.declaration.units import NONE, TIME, Dimension, conversion, describe, dimension_of, instead_of, times

_SECTIONS = ("coordinates", "states", "inputs", "parameters", "outputs", "elements", "scales")
_USUAL = {  # the scales that are proposed, in this order
    "time": "s", "length": "m", "mass": "kg", "voltage": "V", "current": "A", "temperature": "K", "substance": "mol",
    "luminosity": "cd",
}  # fmt: skip


def check_dimensions(model: ModelDeclaration) -> list[Problem]:
    """Problems where a model adds, compares or equates unlike dimensions; none of a model without units."""
    units, problems = _dimensions(model)
    if problems or is_plain(model):
        return problems
    return _Checker(model, units).check()


def check_scales(model: ModelDeclaration) -> list[Problem]:
    """Problems of units that a model's scales cannot make dimensionless, each with the scales to add.

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
            mend = f"add to scales: {wanted}, with the value that suits"
            problems.append(Problem(model.place(path), path, error.problems[0].message + also, mend))
    return problems


def is_plain(model: ModelDeclaration) -> bool:
    """Whether nothing in a model but its scales has a unit."""
    return all(entry.unit == "1" for section in _SECTIONS[:-1] for entry in getattr(model, section).values())


def symbol_dimensions(model: ModelDeclaration) -> dict[str, Dimension | None] | None:
    """Dimension of every symbol of a model, derivatives included; None where a declared unit is none."""
    units, problems = _dimensions(model)
    if problems:
        return None
    checker = _Checker(model, units)
    checker.start()
    return checker.symbols


def force_dimensions(model: ModelDeclaration) -> dict[str, Dimension | None]:
    """Dimension of a force on each coordinate: that of its equation, or energy per coordinate of a Lagrangian.

    That on an internal state is of its rate, and that on an output that elements act on of the output itself.

    Raises:
        DeclarationError: a unit or an expression of the model has no dimension.
    """
    units, problems = _dimensions(model)
    checker = _Checker(model, units, problems=problems)
    if not problems:
        checker.start()
        action = None if model.lagrangian is None else checker.of(model.lagrangian)
        forces = {
            name: checker.on(name, action) for name in (*model.coordinates, *model.states, *driven_outputs(model))
        }
    if problems:
        raise DeclarationError(problems)
    return forces


def dimension_in(expression: Expression, symbols: Mapping[str, Dimension | None]) -> Dimension | None:
    """Dimension of an expression, None where any fits; raises `DeclarationError` where it has none."""
    return _Reader(expression, symbols).read()


def displacement_dimension(element: Element, symbols: Mapping[str, Dimension | None]) -> Dimension | None:
    """Dimension of an element's displacement: as declared, or that of its rate times time."""
    if element.displacement is not None:
        return dimension_in(element.displacement, symbols)
    rate, time = None if element.rate is None else dimension_in(element.rate, symbols), symbols["t"]
    return None if rate is None or time is None else times(rate, time, 1)


def unit_problems(declaration: Declaration, path: str, error: DeclarationError) -> list[Problem]:
    """Problems of a text that is no unit, at its place in a declaration.

    Args:
        declaration: that was read.
        path: of the unit.
        error: what reading the unit raised.
    """
    return [replace(problem, place=declaration.place(path), path=path) for problem in error.problems]


def _dimensions(model: ModelDeclaration) -> tuple[dict[str, Dimension], list[Problem]]:
    """Dimension of every declared unit by its path, and problems of those that are none."""
    problems: list[Problem] = []
    units: dict[str, Dimension] = {}
    for section in _SECTIONS:
        for name, entry in getattr(model, section).items():
            path = f"{section}.{name}.unit"
            try:
                units[path] = dimension_of(entry.unit)
            except DeclarationError as error:
                problems += unit_problems(model, path, error)
    return units, problems


def _additions(unit: str, scales: Mapping[str, str]) -> dict[str, str]:
    """Fewest usual scales that make a unit dimensionless together with those that are there."""
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
        for name in model.coordinates:
            for order in range(3):
                self.symbols[name + "'" * order] = times(self.units[f"coordinates.{name}.unit"], time, -order)
        for name in model.states:
            for order in range(2):
                self.symbols[name + "'" * order] = times(self.units[f"states.{name}.unit"], time, -order)
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
            power = None if action is None else times(action, time, -1)
            self.same(power, self.model.dissipation, "a dissipation must be {} as the lagrangian says, not {}")
        for name, force in self.model.forces.items():
            self.same(
                self.on(name, action), force, "a force on this coordinate must be {} as the lagrangian says, not {}"
            )

    def element(self, name: str, action: Dimension | None, time: Dimension) -> None:
        """Check that the force of an element, times what it acts with, goes with the equations of motion."""
        element, force = self.model.elements[name], self.units[f"elements.{name}.unit"]
        moved = None if element.displacement is None else self.of(element.displacement)
        if element.rate is not None:
            wanted = None if moved is None else times(moved, time, -1)
            self.same(wanted, element.rate, "the rate of this displacement is in {}, not in {}")
        if element.force is not None:
            moved = displacement_dimension(element, self.symbols)
            motion = {"d": moved, "d_rate": None if moved is None else times(moved, time, -1)}
            law = replace(self, symbols=self.symbols | motion)
            law.same(force, element.force, "the unit of the element is {}, its force is {}")
        message = f"the force in {element.unit} must be multiplied by {{}} to act here, not by {{}}"
        for coordinate, factor in element.acts.items():
            wanted = self.on(coordinate, action)
            self.same(None if wanted is None else times(wanted, force, -1), factor, message)

    def on(self, coordinate: str, action: Dimension | None) -> Dimension | None:
        """Dimension of a force on a coordinate: of its equation, or L/q where L, the `action`, has it.

        That on an internal state is of its rate, and that on an output of the output itself.
        """
        if coordinate in self.model.states:
            return self.symbols[f"{coordinate}'"]
        if coordinate in self.model.outputs and coordinate not in self.model.coordinates:
            output = self.model.outputs[coordinate]
            is_declared = "unit" in output.model_fields_set
            return self.units[f"outputs.{coordinate}.unit"] if is_declared else self.of(output.expression)
        if self.model.lagrangian is None:
            left = equation_of(self.model, coordinate)
            return None if left is None else self.of(left)
        moved = self.symbols.get(coordinate)
        return None if action is None or moved is None else times(action, moved, -1)

    def define(self) -> None:
        """Dimensions of definitions, each after those it uses; cycles are reported elsewhere."""
        declared = self.model.definitions
        for name in in_order({name: expression.names for name, expression in declared.items()}):
            self.symbols[name] = self.of(declared[name])

    def of(self, expression: Expression) -> Dimension | None:
        try:
            return dimension_in(expression, self.symbols)
        except DeclarationError as error:
            self.problems += error.problems
            return None

    def same(self, wanted: Dimension | None, expression: Expression, message: str, written: str = "") -> None:
        own = self.of(expression)
        if wanted is not None and own is not None and wanted != own:
            whole = (0, len(expression.text))
            first = describe(wanted) if "unit is {}" in message else _shown(wanted)
            mend = instead_of(written, own)
            self.problems.append(expression.problem(whole, message.format(first, _shown(own)), mend))


def _shown(dimension: Dimension) -> str:
    return "a number without unit" if dimension == NONE else describe(dimension)


@dataclass(frozen=True, slots=True)
class _Reader:
    """Reads the dimension of an expression, None where any fits, and the number that it is, None where it is none."""

    expression: Expression
    symbols: Mapping[str, Dimension | None]

    def read(self) -> Dimension | None:
        read: tuple[Dimension | None, float | None] = self.expression.walk(
            lambda step: (NONE if (value := step.number()) else None, value),
            lambda step: (self.symbols.get(step.value), None),
            lambda step, args: (self.dimension(step, args), _constant(step, [number for _, number in args])),
        )
        return read[0]

    def dimension(self, step: Step, args: Sequence[tuple[Dimension | None, float | None]]) -> Dimension | None:
        dimensions, first = [dimension for dimension, _ in args], args[0][0]
        match OPERATIONS[step.operation].dimension:
            case "same" | "chosen" as rule:
                return self.same(step, dimensions[rule == "chosen" :])
            case "compared":
                self.same(step, dimensions)
            case "product":
                a, b = dimensions
                return None if a is None or b is None else times(a, b, 1 if step.operation == "*" else -1)
            case "power":
                return self.power(step, *args)
            case "root":
                return None if first is None else times(NONE, first, Fraction(1, 2))
            case "first":
                self.check_delay(step, dimensions)
                return first
            case "pure" if first not in {None, NONE}:
                message = f"takes {step.operation} of {describe(first or NONE)}"
                raise self.refusal(step, message, "its argument must be dimensionless")
        return NONE

    def check_delay(self, step: Step, dimensions: Sequence[Dimension | None]) -> None:
        late, time = dimensions[-1], self.symbols.get("t")
        if step.operation == "delay" and late is not None and time is not None and late != time:
            message = f"the delay is {_shown(late)}, and time is {_shown(time)}"
            raise self.refusal(step, message, "declare the delay as a parameter with a unit")

    def same(self, step: Step, dimensions: Sequence[Dimension | None]) -> Dimension | None:
        first: Dimension | None = None
        for dimension in dimensions:
            if first is not None and dimension is not None and dimension != first:
                a, b = _shown(first), _shown(dimension)
                verb = "adds {} to {}" if step.operation == "+" else "subtracts {} from {}"
                raise self.refusal(
                    step, verb.format(b, a) if step.operation in {"+", "-"} else f"compares {a} with {b}"
                )
            first = first if first is not None else dimension
        return first

    def power(
        self, step: Step, base: tuple[Dimension | None, float | None], exponent: tuple[Dimension | None, float | None]
    ) -> Dimension | None:
        if exponent[0] not in {None, NONE}:
            message = f"the exponent is {describe(exponent[0] or NONE)}"
            raise self.refusal(step, message, "an exponent must be dimensionless")
        if base[0] is None or base[0] == NONE:
            return base[0]
        if exponent[1] is None:
            message = f"raises {describe(base[0])} to a power that is not a number"
            raise self.refusal(step, message, "make the base dimensionless")
        return times(NONE, base[0], Fraction(exponent[1]).limit_denominator(60))

    def refusal(self, step: Step, message: str, mend: str = "") -> DeclarationError:
        return DeclarationError(self.expression.problem(step, message, mend))


def _constant(step: Step, numbers: Sequence[float | None]) -> float | None:
    """Number that a sign, a product or a quotient of numbers is, which may be an exponent."""
    if None in numbers or step.operation not in {"negative", "*", "/"}:
        return None
    return float(OPERATIONS[step.operation].number(*numbers))
