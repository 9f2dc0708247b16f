"""The rate of an expression of coordinates and velocities, as text: the chain rule over a smooth expression."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from masking.errors import DeclarationError
from masking.model.declaration.expression import Expression
from masking.model.declaration.operations import Step

# The derivative of a function by its argument; {0} is the argument in parentheses.
_DERIVATIVES: dict[str, str] = {
    "sin": "cos{0}",
    "cos": "(-sin{0})",
    "tan": "(1 + tan{0}**2)",
    "asin": "(1/sqrt(1 - {0}**2))",
    "acos": "(-1/sqrt(1 - {0}**2))",
    "atan": "(1/(1 + {0}**2))",
    "sinh": "cosh{0}",
    "cosh": "sinh{0}",
    "tanh": "(1 - tanh{0}**2)",
    "exp": "exp{0}",
    "log": "(1/{0})",
    "sqrt": "(1/(2*sqrt{0}))",
}
_SUM, _PRODUCT, _ATOM = 1, 2, 3
_LEVELS = dict.fromkeys(("+", "-", "negative"), _SUM) | dict.fromkeys(("*", "/", "**"), _PRODUCT)


@dataclass(frozen=True, slots=True)
class _Text:
    """A text with how strongly it binds."""

    text: str
    level: int

    def at(self, level: int) -> str:
        """Give the text so that it binds at least so strongly."""
        return self.text if self.level >= level else f"({self.text})"


def rate_of(expression: Expression, coordinates: Collection[str]) -> str:
    """Give the rate of an expression of coordinates and of what is constant, such as "x1' - x3'" of "x1 - x3".

    Velocities that are named among the coordinates count as these: the rate of "x1'" is "x1''". Raises a
    `DeclarationError` where the expression contains what has no derivative, such as abs.
    """
    rate = expression.walk(_Rates(expression, coordinates))[1]
    return "0" if rate is None else rate.text


@dataclass(frozen=True, slots=True)
class _Rates:
    """Reads an expression: (its text, the text of its rate or None where it is constant)."""

    expression: Expression
    coordinates: Collection[str]

    def number(self, step: Step) -> tuple[_Text, _Text | None]:
        return self._text(step), None

    def symbol(self, step: Step) -> tuple[_Text, _Text | None]:
        return self._text(step), _Text(f"{step.value}'", _ATOM) if step.value in self.coordinates else None

    def apply(self, step: Step, args: Sequence[tuple[_Text, _Text | None]]) -> tuple[_Text, _Text | None]:
        return self._text(step), None if all(rate is None for _, rate in args) else self._rate(step, args)

    def _text(self, step: Step) -> _Text:
        return _Text(self.expression.text[step.start : step.end], _LEVELS.get(step.operation, _ATOM))

    def _rate(self, step: Step, args: Sequence[tuple[_Text, _Text | None]]) -> _Text:
        (a, da), (b, db) = args[0], args[-1]
        parts: list[_Text] = []
        match step.operation:
            case "negative" if da is not None:
                parts = [_negative(da)]
            case "+" | "-" as sign:
                parts = [da] if da is not None else []
                if db is not None:
                    parts = [_sum(da, sign, db) if da is not None else db if sign == "+" else _negative(db)]
            case "*":
                parts = [_product(x, "*", y) for x, y in ((da, b), (a, db)) if x is not None and y is not None]
            case "/":
                parts = [_product(da, "/", b)] if da is not None else []
                if db is not None:
                    parts.append(_negative(_product(_product(_product(a, "/", b), "*", db), "/", b)))
            case "**" if db is None and da is not None:
                less = _Text(f"{b.at(_ATOM)}*{a.at(_ATOM)}**({b.text} - 1)", _PRODUCT)
                parts = [_product(less, "*", da)]
            case name if name in _DERIVATIVES and da is not None:
                parts = [_product(_Text(_DERIVATIVES[name].format(f"({a.text})"), _ATOM), "*", da)]
        if parts:
            return parts[0] if len(parts) == 1 else _sum(parts[0], "+", parts[1])
        message = "has no derivative, so that its rate cannot be derived"
        raise DeclarationError(self.expression.problem(step, message, "write a smooth expression, such as x1 - x3"))


def _negative(a: _Text) -> _Text:
    return _Text(f"-{a.at(_PRODUCT)}", _SUM)


def _sum(a: _Text, sign: str, b: _Text) -> _Text:
    return _Text(f"{a.at(_SUM)} {sign} {b.at(_PRODUCT)}", _SUM)


def _product(a: _Text, sign: str, b: _Text) -> _Text:
    return _Text(f"{a.at(_PRODUCT)}{sign}{b.at(_ATOM)}", _PRODUCT)
