"""Units: their dimension, their factor to SI, and how a unit is made of declared scales.

`dimensions` checks those of a model's equations, `plant_units` those of a plant file, `quantities` writes values with
them, and `masking.model.modelling.scales` converts a model's values.

A dimension is a tuple of seven exponents over `BASES`. Units are written as expressions of unit names, such as
`N*s/m**2`, and read by the same parser as every other expression; only bare names reach pint.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

from masking.errors import DeclarationError, Problem
from masking.lazy_imports import pint
from masking.model.declaration.expression import Expression
from masking.model.declaration.operations import Step

Dimension = tuple[Fraction, ...]

BASES: dict[str, str] = {
    "mass": "kg", "length": "m", "time": "s", "current": "A", "temperature": "K", "substance": "mol",
    "luminosity": "cd",
}  # fmt: skip
ANGLES = dict.fromkeys(("deg", "degree", "degrees", "turn", "rev", "revolution"), "rad") | {"rpm": "rad/s"}
GRAM, GRAVITY = "g", "gravity"  # one that is often written for the other
PLURALS = {"rads": "rad"}  # angles, which pint would read as doses of radiation
# Units that files use most, which are read without pint: factor to SI, and powers of `BASES`.
USUAL: dict[str, tuple[float, dict[str, int]]] = {
    "m": (1.0, {"length": 1}), "mm": (0.001, {"length": 1}), "kg": (1.0, {"mass": 1}), "g": (0.001, {"mass": 1}),
    "s": (1.0, {"time": 1}), "ms": (0.001, {"time": 1}), "Hz": (1.0, {"time": -1}), "kHz": (1000.0, {"time": -1}),
    "rad": (1.0, {}), "A": (1.0, {"current": 1}), "V": (1.0, {"mass": 1, "length": 2, "time": -3, "current": -1}),
    "N": (1.0, {"mass": 1, "length": 1, "time": -2}), "J": (1.0, {"mass": 1, "length": 2, "time": -2}),
    "W": (1.0, {"mass": 1, "length": 2, "time": -3}), "ohm": (1.0, {"mass": 1, "length": 2, "time": -3, "current": -2}),
}  # fmt: skip
_PLAIN = ("N", "J", "W", "V", "ohm", "Pa")  # that SI values are given in, rather than in products of base units
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
NONE: Dimension = (Fraction(0),) * len(BASES)
TIME: Dimension = tuple(Fraction(int(base == "time")) for base in BASES)


class Conversion(NamedTuple):
    """A unit in terms of scales: value * factor / prod(scale_si**exponent) is dimensionless; `si` is its SI unit."""

    factor: float
    exponents: dict[str, float]
    si: str

    def scale(self, scales: Mapping[str, float]) -> float:
        """Size in SI units of what the scales make of this dimension."""
        return math.prod(float(scales[name] ** exponent) for name, exponent in self.exponents.items())


def dimension_of(unit: str) -> Dimension:
    """Give the exponents of a unit over `BASES`; raises `DeclarationError` for what is no unit."""
    return _unit(unit)[1]


def base_powers(unit: str) -> dict[str, Fraction]:
    """Give the powers of SI base units that a unit has, and that of rad."""
    found = dict(zip(BASES.values(), dimension_of(unit), strict=True)) | {"rad": _powers(coherent(unit)).get("rad")}
    return {name: power for name, power in found.items() if power}


def instead_of(unit: str, wanted: Dimension) -> str:
    """Say what to write for a unit whose name is that of another dimension than wanted; '' where nothing is known."""
    if unit == GRAM and wanted == dimension_of(GRAVITY):
        return f"{GRAM} is the gram: write {GRAVITY} for {factor_of(GRAVITY):g} m/s**2"
    return ""


def factor_of(unit: str) -> float:
    """Give how many SI base units one of this unit is."""
    return _unit(unit)[0]


def coherent(unit: str) -> str:
    """Write the unit of the SI values of what is declared in a unit: rad/s for deg/s, N*m for kN*mm."""
    return combined(unit, {name: _coherent(name) for name in _powers(unit)}) if unit else ""


def _coherent(name: str) -> str:
    factor, dimension = _unit(name)
    if factor == 1.0:
        return name
    plain = (one for one in _PLAIN if dimension_of(one) == dimension)
    return ANGLES.get(name) or next(plain, describe(dimension))


def describe(dimension: Dimension) -> str:
    """Write a dimension in plain SI base units, such as kg*m/s**2."""
    return _product(dict(zip(BASES.values(), dimension, strict=True)))


def combined(template: str, known: Mapping[str, str]) -> str:
    """Put units in place of letters, and keep each name as it is written.

    Of the template F/D and the units {"F": "m/s**2", "D": "m"} it gives 1/s**2.
    """
    powers: dict[str, Fraction] = {}
    for letter, power in _powers(template).items():
        for name, inner in _powers(known.get(letter, letter)).items():
            powers[name] = powers.get(name, Fraction(0)) + power * inner
    return _product(powers)


def pretty(unit: str) -> str:
    """Write a unit for people, such as 1/(m² s²) for 1/m**2/s**2; "" for 1.

    pint's own format writes 1/m²/s² and sorts N m to m·N, which is why it is not used.
    """
    raised = re.sub(r"\*\*(\d+)", lambda found: found[1].translate(RAISED), _product(_powers(unit)))
    first, *below = raised.replace("*", " ").split("/")
    return "" if raised == "1" else "/".join([first, *([f"({' '.join(below)})"] if len(below) > 1 else below)])


def _product(powers: Mapping[str, Fraction]) -> str:
    """Write powers of names as a product and quotients."""

    def factor(name: str, power: Fraction) -> str:
        exponent = str(power) if power.denominator == 1 else f"({power})"
        return name if power == 1 else f"{name}**{exponent}"

    above = "*".join(factor(name, power) for name, power in powers.items() if power > 0)
    below = "".join("/" + factor(name, -power) for name, power in powers.items() if power < 0)
    return (above or "1") + below


def _powers(unit: str) -> dict[str, Fraction]:
    """Names in a unit with their powers, without looking them up."""
    expression = Expression(unit or "1", path="unit")
    return expression.walk(_Units(expression, lambda name: (1.0, {name: Fraction(1)})))[1]


def names_in(unit: str) -> frozenset[str]:
    """Names of units in a unit, such as N and m in N*m."""
    return frozenset(_powers(unit))


def conversion(unit: str, scales: Mapping[str, str]) -> Conversion:
    """Resolve a unit into scales, given as name: unit.

    Solves unit = prod(scale_k**e_k) dimension by dimension in rationals. Scales that are not needed get the exponent 0.
    Without any scales only the factor to SI is found. Raises a `DeclarationError` where it is no unit, or the scales do
    not span it.
    """
    factor, wanted = _unit(unit)
    si = unit if factor == 1.0 else describe(wanted)
    if not scales:
        return Conversion(factor, {}, si)
    columns = [dimension_of(scale) for scale in scales.values()]
    if (exponents := _solve(columns, wanted)) is None:
        absent = [base for base, w, *c in zip(BASES, wanted, *columns, strict=True) if w != 0 and not any(c)]
        what = f"no scale for {' and '.join(absent)}" if absent else "no product of the scales"
        message = f"the unit {unit} cannot be made dimensionless: {what}"
        raise DeclarationError(Problem(None, "scales", message, f"add one under scales; there are {', '.join(scales)}"))
    return Conversion(factor, {name: float(power) for name, power in zip(scales, exponents, strict=True)}, si)


@functools.cache
def _registry() -> Any:  # noqa: ANN401  (pint's registry is built at run time)
    return pint.UnitRegistry(cache_folder=None)


def _named(name: str) -> tuple[float, dict[str, Fraction]]:
    """Factor of a unit to SI, and its powers of `BASES`."""
    name = PLURALS.get(name, name)
    if name not in USUAL:
        return named_by_pint(name)
    factor, powers = USUAL[name]
    return factor, {base: Fraction(power) for base, power in powers.items()}


@functools.cache
def named_by_pint(name: str) -> tuple[float, dict[str, Fraction]]:
    """Factor of a unit to SI, and its powers of `BASES`; a `LookupError` where pint knows no such multiple."""
    registry = _registry()
    try:
        one = registry.Quantity(1.0, name).to_base_units()
        two = registry.Quantity(2.0, name).to_base_units()
    except (pint.UndefinedUnitError, pint.OffsetUnitCalculusError, AttributeError, ValueError):
        raise LookupError(name) from None
    factor = float(two.magnitude - one.magnitude)  # a temperature scale with an offset counts as a difference
    powers = {base: Fraction(one.dimensionality.get(f"[{base}]", 0)).limit_denominator(60) for base in BASES}
    return factor, {base: power for base, power in powers.items() if power}


@functools.cache
def _unit(text: str) -> tuple[float, Dimension]:
    expression = Expression(text, path="unit")
    factor, powers, _ = expression.walk(_Units(expression, _named))
    return factor, tuple(powers.get(base, Fraction(0)) for base in BASES)


_Read = tuple[float, dict[str, Fraction], Fraction | None]


@dataclass(frozen=True, slots=True)
class _Units:
    """Reads a unit: (factor, powers, number if it is one), both as `named` gives them for each name in it."""

    expression: Expression
    named: Callable[[str], tuple[float, dict[str, Fraction]]]

    def number(self, step: Step) -> _Read:
        if step.value == "pi":
            raise DeclarationError(self.expression.problem(step, "pi is not a unit"))
        return float(step.value), {}, Fraction(step.value)

    def symbol(self, step: Step) -> _Read:
        try:
            return *self.named(step.value), None
        except LookupError:
            remedy = "units are written as in N*s/m**2"
            raise DeclarationError(self.expression.problem(step, f"'{step.value}' is not a unit", remedy)) from None

    def apply(self, step: Step, args: Sequence[_Read]) -> _Read:
        (factor, powers, number), (other, others, exponent) = args[0], args[-1]
        if step.operation == "negative" and number is not None:
            return -factor, powers, -number
        if step.operation in {"*", "/"}:
            sign = 1 if step.operation == "*" else -1
            joined = dict.fromkeys([*powers, *others], Fraction(0)) | powers
            joined |= {name: joined[name] + sign * power for name, power in others.items()}
            ratio = None if number is None or exponent is None else number * exponent**sign
            return factor * other**sign, joined, ratio
        if step.operation == "**" and exponent is not None and factor > 0.0:
            return math.pow(factor, other), {name: power * exponent for name, power in powers.items()}, None
        raise DeclarationError(self.expression.problem(step, "a unit is a product of powers of units"))


def _solve(columns: Sequence[Dimension], wanted: Dimension) -> list[Fraction] | None:
    """Solve for the exponents by elimination; None if there is no solution."""
    rows = [[column[i] for column in columns] + [wanted[i]] for i in range(len(wanted))]
    pivots: list[int] = []
    for column in range(len(columns)):
        top = len(pivots)
        pivot = next((i for i in range(top, len(rows)) if rows[i][column] != 0), None)
        if pivot is None:
            continue
        rows[top], rows[pivot] = rows[pivot], rows[top]
        rows[top] = [entry / rows[top][column] for entry in rows[top]]
        for i, row in enumerate(rows):
            if i != top and row[column] != 0:
                rows[i] = [entry - row[column] * above for entry, above in zip(row, rows[top], strict=True)]
        pivots.append(column)
    if any(row[-1] != 0 for row in rows[len(pivots) :]):
        return None
    solution = [Fraction(0)] * len(columns)
    for row, column in zip(rows, pivots, strict=False):
        solution[column] = row[-1]
    return solution
