"""Safe expressions: text to numbers, to sympy, to dimensions, by a whitelist.

Nothing is ever executed. `syntax` turns the text into a flat program in postfix order; `Expression.walk` folds it with
the functions of one meaning, whose operations are a column of `OPERATIONS`: here numbers, constant bounds and sympy.

    names  x1  x1' x1''    + - * / **    < <= > >= (in the condition of where)    pi    sin(x) ... where(c, a, b)
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from masking.errors import DeclarationError, Place, Problem, nearest
from masking.model.declaration.lazy_sympy import sp
from masking.model.declaration.operations import LARGEST_EXPONENT, OPERATIONS, Step
from masking.model.declaration.syntax import parse
from masking.model.declaration.tables import TABLES, trouble

V = TypeVar("V")


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
        self.walk(lambda step: (step.number(), 1.0), lambda step: (None, 1.0), self._bounded)

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
        """Place in the file of one character of the text."""
        for start, place in reversed(self.pieces):
            if start <= index:
                return Place(place.file, place.line, place.column + index - start)
        return self.place and Place(self.place.file, self.place.line, self.place.column + index)

    def problem(self, span: Step | tuple[int, int], message: str, mend: str = "") -> Problem:
        """Problem of one part of the text, with the source line and a caret below it.

        Args:
            span: the step, or first and last index in the text.
            message: what is wrong.
            mend: what to do about it.
        """
        start, end = (span.start, span.end) if isinstance(span, Step) else span
        window = max(0, start - 60)
        shown = re.sub(r"[^ -~\u00a0-\U0010ffff]", " ", self.text[window : window + 120])
        width = max(1, min(end, window + len(shown)) - start)
        excerpt = f"    {shown}\n    {' ' * (start - window)}{'^' * width}"
        return Problem(self.locate(start), self.path, message, mend, excerpt)

    def walk(
        self, number: Callable[[Step], V], symbol: Callable[[Step], V], apply: Callable[[Step, Sequence[V]], V]
    ) -> V:
        """Fold of the expression, arguments before operations.

        Args:
            number: meaning of a literal or of a named constant.
            symbol: meaning of a name, primes included.
            apply: meaning of an operation on the meanings of its arguments.
        """
        stack: list[V] = []
        for step in self.steps:
            if step.operation == "number":
                stack.append(number(step))
            elif step.operation == "symbol":
                stack.append(symbol(step))
            else:
                first = len(stack) - step.arity
                stack[first:] = [apply(step, stack[first:])]
        return stack[0]

    def first(self, symbol: str) -> Step:
        """First step that is this symbol."""
        return next(step for step in self.steps if step.operation == "symbol" and step.value == symbol)

    def renamed(self, names: Mapping[str, str]) -> str:
        """Text with other names for some of its symbols."""
        parts, end = [], 0
        symbols = (step for step in self.steps if step.operation == "symbol" and step.value in names)
        for step in sorted(symbols, key=lambda step: step.start):
            parts += [self.text[end : step.start], names[step.value]]
            end = step.end
        return "".join([*parts, self.text[end:]])

    def unknown(self, allowed: Collection[str]) -> list[str]:
        """Symbols that are not allowed, once each, in the order of the text."""
        return sorted(self.symbols - set(allowed), key=lambda symbol: self.first(symbol).start)

    def check_symbols(self, allowed: Collection[str]) -> list[Problem]:
        """Problem of every symbol that is not allowed, with its place and the nearest allowed one."""
        return [self._unknown(self.first(symbol), allowed) for symbol in self.unknown(allowed)]

    def evaluate(self, values: Mapping[str, float]) -> float:
        """Value with floats.

        Args:
            values: by symbol, primes included.

        Raises:
            DeclarationError: a symbol has no value, or the result is not finite.
        """

        def symbol(step: Step) -> float | Problem:
            if step.value not in values:
                return self._unknown(step, values.keys())
            value = float(values[step.value])
            return value if math.isfinite(value) else self.problem(step, f"'{step.value}' is {value}, not finite")

        def apply(step: Step, args: Sequence[float | Problem]) -> float | Problem:
            if step.operation == "where" and not isinstance(args[0], Problem):
                return args[1] if args[0] else args[2]  # the problem of the other branch is dropped
            return next((arg for arg in args if isinstance(arg, Problem)), None) or self._compute(step, args)

        result = self.walk(Step.number, symbol, apply)
        if isinstance(result, Problem):
            raise DeclarationError(result)
        return float(result)

    def to_sympy(self, symbols: Mapping[str, sp.Symbol] | None = None) -> sp.Expr:
        """Expression in sympy, in which decimals are exact rationals.

        Args:
            symbols: by name with primes; by default a real symbol for each name.

        Raises:
            DeclarationError: a symbol is not known, or the expression simplifies to what is not finite.
        """
        known = {name: sp.Symbol(name, real=True) for name in self.symbols} if symbols is None else symbols

        def symbol(step: Step) -> Any:  # noqa: ANN401  (sympy's classes are not known to the type checker)
            if step.value not in known:
                raise DeclarationError(self._unknown(step, known.keys()))
            return known[step.value]

        def apply(step: Step, args: Sequence[Any]) -> Any:  # noqa: ANN401
            if step.operation == "**" and args[1].is_Rational and abs(args[1]) > LARGEST_EXPONENT:
                message = f"the exponent simplifies to {args[1]}, larger than {LARGEST_EXPONENT}"
                raise DeclarationError(self.problem(step, message))
            symbolic = OPERATIONS[step.operation].symbolic
            result = getattr(sp, symbolic)(*args) if isinstance(symbolic, str) else symbolic(*args)
            if step.operation not in {"+", "-", "*", "negative"} and result.has(sp.zoo, sp.nan, sp.oo):
                raise DeclarationError(self.problem(step, "is not finite"))
            return result

        return self.walk(lambda step: sp.pi if step.value == "pi" else sp.Rational(step.value), symbol, apply)

    def _refuse(self, start: int, end: int, message: str, mend: str) -> DeclarationError:
        return DeclarationError(self.problem((start, end), message, mend))

    def _unknown(self, step: Step, allowed: Collection[str]) -> Problem:
        return self.problem(step, f"unknown symbol '{step.value}'", nearest(step.value, allowed))

    def _compute(self, step: Step, args: Sequence[Any]) -> float | Problem:
        """Value of an operation on floats; a problem with its place where that is not finite and real."""
        try:
            result: float = OPERATIONS[step.operation].number(*args)
        except ZeroDivisionError:
            return self.problem(step, "divides by zero")
        except OverflowError:
            return self.problem(step, "is not finite")
        except ValueError:
            shown = ", ".join(f"{value:.6g}" for value in args)
            name = "a power" if step.operation == "**" else step.operation
            return self.problem(step, f"{name} has no real value at {shown}")
        return result if math.isfinite(result) else self.problem(step, "is not finite")

    def _bounded(self, step: Step, args: Sequence[tuple[float | None, float]]) -> tuple[float | None, float]:
        """Value of an operation, None where it is not constant, and the product of nested exponents.

        Raises:
            DeclarationError: one of them is not finite and small.
        """
        constants, degree = [arg[0] for arg in args], max(arg[1] for arg in args)
        if step.operation == "/" and constants[1] == 0.0:
            raise DeclarationError(self.problem(step, "divides by zero"))
        if step.operation == "**" and constants[1] is not None:
            degree = args[0][1] * max(1.0, abs(constants[1]))
            if degree > LARGEST_EXPONENT:
                message = f"the exponent is larger than {LARGEST_EXPONENT}"
                raise DeclarationError(self.problem(step, message, "nested powers count as their product"))
        if step.operation in TABLES and (wrong := trouble(constants[1:])):
            raise DeclarationError(self.problem(step, wrong, f"write {step.operation}(x, x1, y1, x2, y2)"))
        if None in constants:
            return None, degree
        result = self._compute(step, constants)
        if isinstance(result, Problem):
            raise DeclarationError(result)
        return result, degree
