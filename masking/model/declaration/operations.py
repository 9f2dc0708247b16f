"""The language of expressions: the one table of what may be written and what it means.

An expression is a postfix program of `Step`s; every operation of a step is a key of `OPERATIONS`.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from masking.lazy_imports import sympy as sp
from masking.model.declaration import tables

_MANY = 1000
# Functions of one argument that sympy calls as `math` does.
_SAME_NAMES = ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "sqrt")
LARGEST_EXPONENT = 64


def _power(base: float, exponent: float) -> float:
    if base == 0.0 and exponent < 0.0:
        raise ZeroDivisionError
    return math.pow(base, exponent)


def _sign(x: float) -> float:
    return 0.0 if x == 0.0 else math.copysign(1.0, x)


def _delay(x: float, time: float) -> float:
    raise ValueError


def delay_function() -> sp.Function:
    """Undefined function of sympy that stands for a delay."""
    return sp.Function("delay", real=True)


def _symbolic_delay(x: sp.Expr, time: sp.Expr) -> sp.Expr:
    return delay_function()(x, time)


@dataclass(frozen=True, slots=True)
class Operation:
    """One thing an expression may do.

    `number` computes it on floats; `symbolic` is the same in sympy, as a function or as the name of sympy's own;
    `least` and `most` bound the number of arguments.
    """

    number: Callable[..., Any]
    symbolic: Callable[..., Any] | str
    least: int = 1
    most: int = 1


def _table(curve: tables.Curve) -> Operation:
    return Operation(partial(tables.value, curve), partial(tables.symbolic, curve), 1 + 2 * tables.FEWEST, _MANY)


OPERATIONS: dict[str, Operation] = {
    "+": Operation(operator.add, operator.add, 2, 2),
    "-": Operation(operator.sub, operator.sub, 2, 2),
    "*": Operation(operator.mul, operator.mul, 2, 2),
    "/": Operation(operator.truediv, operator.truediv, 2, 2),
    "**": Operation(_power, operator.pow, 2, 2),
    "negative": Operation(operator.neg, operator.neg),
    "<": Operation(operator.lt, "StrictLessThan", 2, 2),
    "<=": Operation(operator.le, "LessThan", 2, 2),
    ">": Operation(operator.gt, "StrictGreaterThan", 2, 2),
    ">=": Operation(operator.ge, "GreaterThan", 2, 2),
    **{name: Operation(getattr(math, name), name) for name in _SAME_NAMES},
    "atan2": Operation(math.atan2, "atan2", 2, 2),
    "abs": Operation(abs, "Abs"),
    "sign": Operation(_sign, "sign"),
    "floor": Operation(lambda x: float(math.floor(x)), "floor"),
    "min": Operation(min, "Min", 2, _MANY),
    "max": Operation(max, "Max", 2, _MANY),
    "where": Operation(
        lambda condition, a, b: a if condition else b,
        lambda condition, a, b: sp.Piecewise((a, condition), (b, True)),
        3,
        3,
    ),
    "interpolate": _table(tables.natural),
    "interpolate_monotone": _table(tables.monotone),
    # What something was some time ago: it has no value in numbers, and equations take it out before they are lowered.
    "delay": Operation(_delay, _symbolic_delay, 2, 2),
    "heaviside": Operation(lambda x: 0.5 if x == 0.0 else float(x > 0.0), lambda x: sp.Heaviside(x, sp.Rational(1, 2))),
}
FUNCTIONS = frozenset(name for name in OPERATIONS if name.isidentifier() and name != "negative")
COMPARISONS = frozenset({"<", "<=", ">", ">="})
CONSTANTS: dict[str, float] = {"pi": math.pi}
# An effect may be called delay; no expression can use the name for anything but the function.
RESERVED = (FUNCTIONS - {"delay"}) | CONSTANTS.keys() | {"t"}


@dataclass(frozen=True, slots=True)
class Step:
    """One step of the postfix program: "number", "symbol" or a key of `OPERATIONS`, and its span in the text."""

    operation: str
    arity: int
    value: str
    start: int
    end: int
