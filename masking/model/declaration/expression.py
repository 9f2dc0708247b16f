"""Safe expressions: text to numbers, to sympy, to dimensions, by a whitelist.

Nothing is ever executed. `syntax` turns the text into a flat program in postfix order; `Expression.walk` folds it, with
one algebra for each meaning: numbers, constant bounds, sympy and, in `dimensions`, units.

    names  x1  x1' x1''    + - * / **    < <= > >= (in the condition of where)    pi    sin(x) ... where(c, a, b)
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from masking.errors import DeclarationError, Place, Problem, nearest
from masking.lazy_imports import sympy as sp
from masking.model.declaration.operations import CONSTANTS, LARGEST_EXPONENT, OPERATIONS, Step
from masking.model.declaration.syntax import parse
from masking.model.declaration.tables import TABLES, trouble

V = TypeVar("V")


class Algebra(Protocol[V]):
    """What a fold over an expression does with numbers, symbols and operations."""

    def number(self, step: Step) -> V:
        """Give the value of a literal or of a named constant."""

    def symbol(self, step: Step) -> V:
        """Give the value of a name, primes included."""

    def apply(self, step: Step, args: Sequence[V]) -> V:
        """Give the value of an operation on the values of its arguments."""


@dataclass(frozen=True)
class Expression:
    """An expression that has been read and found harmless.

    `place` is where the text starts in its file and `path` which value it is; `pieces` are (index into the text, place)
    pairs for a text that is spread over several lines of its file. Raises `DeclarationError` when the text is refused.
    """

    text: str
    place: Place | None = None
    path: str = ""
    pieces: tuple[tuple[int, Place], ...] = ()
    steps: tuple[Step, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "steps", parse(self.text, self._refuse))
        self.walk(_Bounds(self))

    def __str__(self) -> str:
        return self.text

    @property
    def symbols(self) -> frozenset[str]:
        """Every name with its primes, such as "x1''"."""
        return frozenset(step.value for step in self.steps if step.operation == "symbol")

    @property
    def names(self) -> frozenset[str]:
        """Every name without primes, functions and constants left out."""
        return frozenset(symbol.rstrip("'") for symbol in self.symbols)

    def locate(self, index: int) -> Place | None:
        """Give the place in the file of one character of the text."""
        for start, place in reversed(self.pieces):
            if start <= index:
                return Place(place.file, place.line, place.column + index - start)
        return self.place and Place(self.place.file, self.place.line, self.place.column + index)

    def problem(self, span: Step | tuple[int, int], message: str, remedy: str = "") -> Problem:
        """Describe what is wrong with a step or a span of the text, with the source line and a caret below it."""
        start, end = (span.start, span.end) if isinstance(span, Step) else span
        window = max(0, start - 60)
        shown = re.sub(r"[^ -~\u00a0-\U0010ffff]", " ", self.text[window : window + 120])
        width = max(1, min(end, window + len(shown)) - start)
        excerpt = f"    {shown}\n    {' ' * (start - window)}{'^' * width}"
        return Problem(self.locate(start), self.path, message, remedy, excerpt)

    def walk(self, algebra: Algebra[V]) -> V:
        """Fold the expression, arguments before operations."""
        stack: list[V] = []
        for step in self.steps:
            if step.operation == "number":
                stack.append(algebra.number(step))
            elif step.operation == "symbol":
                stack.append(algebra.symbol(step))
            else:
                first = len(stack) - step.arity
                stack[first:] = [algebra.apply(step, stack[first:])]
        return stack[0]

    def first(self, symbol: str) -> Step:
        """Give the first step that is this symbol."""
        return next(step for step in self.steps if step.operation == "symbol" and step.value == symbol)

    def renamed(self, names: Mapping[str, str]) -> str:
        """Give the text with other names for some of its symbols."""
        parts, end = [], 0
        symbols = (step for step in self.steps if step.operation == "symbol" and step.value in names)
        for step in sorted(symbols, key=lambda step: step.start):
            parts += [self.text[end : step.start], names[step.value]]
            end = step.end
        return "".join([*parts, self.text[end:]])

    def unknown(self, allowed: Collection[str]) -> list[str]:
        """List every symbol that is not allowed, once each, in the order of the text."""
        return sorted(self.symbols - set(allowed), key=lambda symbol: self.first(symbol).start)

    def check_symbols(self, allowed: Collection[str]) -> list[Problem]:
        """List a problem for every symbol that is not allowed, with its place and the nearest allowed one."""
        return [self._unknown(self.first(symbol), allowed) for symbol in self.unknown(allowed)]

    def evaluate(self, values: Mapping[str, float]) -> float:
        """Compute the value with floats; `values` are given by symbol, primes included.

        Raises a `DeclarationError` where a symbol has no value, or the result is not finite.
        """
        result = self.walk(_Floats(self, values))
        if isinstance(result, Problem):
            raise DeclarationError(result)
        return float(result)

    def to_sympy(self, symbols: Mapping[str, sp.Symbol]) -> sp.Expr:
        """Translate into sympy; decimals become exact rationals; `symbols` are given by name with primes."""
        return _added(self.walk(_Symbolic(self, symbols)))

    def _refuse(self, start: int, end: int, message: str, remedy: str) -> DeclarationError:
        return DeclarationError(self.problem((start, end), message, remedy))

    def _unknown(self, step: Step, allowed: Collection[str]) -> Problem:
        return self.problem(step, f"unknown symbol '{step.value}'", nearest(step.value, allowed))


def _compute(expression: Expression, step: Step, args: Sequence[float]) -> float | Problem:
    """Apply one operation to floats; what has no finite real value becomes a problem with its place."""
    try:
        result: float = OPERATIONS[step.operation].number(*args)
    except ZeroDivisionError:
        return expression.problem(step, "divides by zero")
    except OverflowError:
        return expression.problem(step, "is not finite")
    except ValueError:
        shown = ", ".join(f"{value:.6g}" for value in args)
        name = "a power" if step.operation == "**" else step.operation
        return expression.problem(step, f"{name} has no real value at {shown}")
    return result if math.isfinite(result) else expression.problem(step, "is not finite")


@dataclass(frozen=True, slots=True)
class _Floats:
    """Numbers; a problem travels up and is dropped where `where` does not choose it."""

    expression: Expression
    values: Mapping[str, float]

    def number(self, step: Step) -> float | Problem:
        return CONSTANTS[step.value] if step.value in CONSTANTS else float(step.value)

    def symbol(self, step: Step) -> float | Problem:
        if step.value not in self.values:
            return self.expression._unknown(step, self.values.keys())
        value = float(self.values[step.value])
        message = f"'{step.value}' is {value}, not finite"
        return value if math.isfinite(value) else self.expression.problem(step, message)

    def apply(self, step: Step, args: Sequence[float | Problem]) -> float | Problem:
        if step.operation == "where" and not isinstance(args[0], Problem):
            return args[1] if args[0] else args[2]
        numbers = [value for value in args if not isinstance(value, Problem)]
        wrong = next((value for value in args if isinstance(value, Problem)), None)
        return _compute(self.expression, step, numbers) if wrong is None else wrong


@dataclass(frozen=True, slots=True)
class _Bounds:
    """Constant folding to (value or None, product of nested exponents), refusing what is not finite and small."""

    expression: Expression

    def number(self, step: Step) -> tuple[float | None, float]:
        return (CONSTANTS[step.value] if step.value in CONSTANTS else float(step.value)), 1.0

    def symbol(self, step: Step) -> tuple[float | None, float]:
        return None, 1.0

    def apply(self, step: Step, args: Sequence[tuple[float | None, float]]) -> tuple[float | None, float]:
        degree = max(arg[1] for arg in args)
        constants = [arg[0] for arg in args]
        if step.operation == "/" and constants[1] == 0.0:
            raise DeclarationError(self.expression.problem(step, "divides by zero"))
        if step.operation == "**" and constants[1] is not None:
            degree = args[0][1] * max(1.0, abs(constants[1]))
            if degree > LARGEST_EXPONENT:
                message = f"the exponent is larger than {LARGEST_EXPONENT}"
                raise DeclarationError(self.expression.problem(step, message, "nested powers count as their product"))
        if step.operation in TABLES and (wrong := trouble(constants[1:])):
            remedy = f"write {step.operation}(x, x1, y1, x2, y2)"
            raise DeclarationError(self.expression.problem(step, wrong, remedy))
        known = [value for value in constants if value is not None]
        if len(known) < len(constants):
            return None, degree
        result = _compute(self.expression, step, known)
        if isinstance(result, Problem):
            raise DeclarationError(result)
        return result, degree


def _added(value: Any) -> Any:  # noqa: ANN401
    """Expression of sympy; a list is one of terms that have not been added yet."""
    return sp.Add(*value) if isinstance(value, list) else value


@dataclass(frozen=True, slots=True)
class _Symbolic:
    """sympy expressions, or the terms of a sum: sympy sorts a sum whenever it adds to it."""

    expression: Expression
    symbols: Mapping[str, Any]

    def number(self, step: Step) -> Any:  # noqa: ANN401  (sympy's classes are not known to the type checker)
        return sp.pi if step.value == "pi" else sp.Rational(step.value)

    def symbol(self, step: Step) -> Any:  # noqa: ANN401
        if step.value not in self.symbols:
            raise DeclarationError(self.expression._unknown(step, self.symbols.keys()))
        return self.symbols[step.value]

    def apply(self, step: Step, args: Sequence[Any]) -> Any:  # noqa: ANN401
        if step.operation in {"+", "-"}:
            terms, more = (one if isinstance(one, list) else [one] for one in args)
            terms += more if step.operation == "+" else [-one for one in more]
            return terms
        args = [_added(one) for one in args]
        if step.operation == "**" and args[1].is_Rational and abs(args[1]) > LARGEST_EXPONENT:
            message = f"the exponent simplifies to {args[1]}, larger than {LARGEST_EXPONENT}"
            raise DeclarationError(self.expression.problem(step, message))
        symbolic = OPERATIONS[step.operation].symbolic
        result = getattr(sp, symbolic)(*args) if isinstance(symbolic, str) else symbolic(*args)
        if step.operation not in {"*", "negative"} and result.has(sp.zoo, sp.nan, sp.oo):
            raise DeclarationError(self.expression.problem(step, "is not finite"))
        return result
