"""The language of expressions: the one table of its operations, with a column for each of their meanings.

An expression is a postfix program of `Step`s; every operation of a step is a key of `OPERATIONS`. `Expression.walk`
folds it.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from masking.model.declaration import tables
from masking.model.declaration.lazy_sympy import sp

_MANY = 1000
LARGEST_EXPONENT = 64

# The dimension of a result. Of unlike arguments: "same" has theirs, "compared" has none, "chosen" has that of all but
# the first. "first" has that of its first argument, "any" and "pure" have none, and "pure" takes none.
Rule = Literal["same", "compared", "chosen", "product", "power", "root", "first", "any", "pure"]


def _power(base: float, exponent: float) -> float:
    if base == 0.0 and exponent < 0.0:
        raise ZeroDivisionError
    return math.pow(base, exponent)


def _sign(x: float) -> float:
    return 0.0 if x == 0.0 else math.copysign(1.0, x)


def _floor(x: float) -> float:
    return float(math.floor(x))


def _heaviside(x: float) -> float:
    return 0.5 if x == 0.0 else float(x > 0.0)


def _delay(x: float, time: float) -> float:
    raise ValueError


def delay_function() -> sp.Function:
    """Undefined function of sympy that stands for a delay."""
    return sp.Function("delay", real=True)


def _symbolic_delay(x: sp.Expr, time: sp.Expr) -> sp.Expr:
    return delay_function()(x, time)


@dataclass(frozen=True, slots=True)
class Operation:
    """One operation of an expression: a row with a column for each meaning.

    Args:
        number: its value of floats.
        symbolic: the same in sympy, as a function or as the name of sympy's own.
        array: name of the function of numpy; '' where `number` is applied to each element.
        least, most: number of arguments.
        dimension: rule for its dimension.
        derivative: by its argument, which is {0} in brackets, as a text; '' where no such text is known.
    """

    number: Callable[..., Any]
    symbolic: Callable[..., Any] | str
    array: str = ""
    least: int = 1
    most: int = 1
    dimension: Rule = "pure"
    derivative: str = ""


_infix = partial(Operation, least=2, most=2)
_comparison = partial(_infix, dimension="compared")
_several = partial(Operation, least=2, most=_MANY, dimension="same")
_table = partial(Operation, least=1 + 2 * tables.FEWEST, most=_MANY)

OPERATIONS: dict[str, Operation] = {
    "+": _infix(operator.add, operator.add, "add", dimension="same"),
    "-": _infix(operator.sub, operator.sub, "subtract", dimension="same"),
    "*": _infix(operator.mul, operator.mul, "multiply", dimension="product"),
    "/": _infix(operator.truediv, operator.truediv, "divide", dimension="product"),
    "**": _infix(_power, operator.pow, "power", dimension="power"),
    "negative": Operation(operator.neg, operator.neg, "negative", dimension="first"),
    "<": _comparison(operator.lt, "StrictLessThan", "less"),
    "<=": _comparison(operator.le, "LessThan", "less_equal"),
    ">": _comparison(operator.gt, "StrictGreaterThan", "greater"),
    ">=": _comparison(operator.ge, "GreaterThan", "greater_equal"),
    "sin": Operation(math.sin, "sin", "sin", derivative="cos{0}"),
    "cos": Operation(math.cos, "cos", "cos", derivative="(-sin{0})"),
    "tan": Operation(math.tan, "tan", "tan", derivative="(1 + tan{0}**2)"),
    "asin": Operation(math.asin, "asin", "arcsin", derivative="(1/sqrt(1 - {0}**2))"),
    "acos": Operation(math.acos, "acos", "arccos", derivative="(-1/sqrt(1 - {0}**2))"),
    "atan": Operation(math.atan, "atan", "arctan", derivative="(1/(1 + {0}**2))"),
    "atan2": _infix(math.atan2, "atan2", "arctan2", dimension="compared"),
    "sinh": Operation(math.sinh, "sinh", "sinh", derivative="cosh{0}"),
    "cosh": Operation(math.cosh, "cosh", "cosh", derivative="sinh{0}"),
    "tanh": Operation(math.tanh, "tanh", "tanh", derivative="(1 - tanh{0}**2)"),
    "exp": Operation(math.exp, "exp", "exp", derivative="exp{0}"),
    "log": Operation(math.log, "log", "log", derivative="(1/{0})"),
    "sqrt": Operation(math.sqrt, "sqrt", "sqrt", dimension="root", derivative="(1/(2*sqrt{0}))"),
    "abs": Operation(abs, "Abs", "abs", dimension="first"),
    "sign": Operation(_sign, "sign", "sign", dimension="any"),
    "floor": Operation(_floor, "floor", "floor"),
    "min": _several(min, "Min", "minimum"),
    "max": _several(max, "Max", "maximum"),
    "where": Operation(
        lambda condition, a, b: a if condition else b,
        lambda condition, a, b: sp.Piecewise((a, condition), (b, True)),
        "where",
        3,
        3,
        dimension="chosen",
    ),
    "interpolate": _table(tables.spline, tables.symbolic_spline),
    "interpolate_monotone": _table(tables.monotone, tables.symbolic_monotone),
    # What something was some time ago: it has no value in numbers, and equations take it out before they are lowered.
    "delay": _infix(_delay, _symbolic_delay, dimension="first"),
    "heaviside": Operation(_heaviside, lambda x: sp.Heaviside(x, sp.Rational(1, 2)), dimension="any"),
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

    def number(self) -> float:
        """Value of a literal or of a named constant."""
        return CONSTANTS[self.value] if self.value in CONSTANTS else float(self.value)
