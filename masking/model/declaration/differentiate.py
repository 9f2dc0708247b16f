"""The rate of an expression of coordinates and velocities, as text: the chain rule over a smooth expression."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from masking.errors import DeclarationError
from masking.model.declaration.expression import Expression
from masking.model.declaration.operations import OPERATIONS, Step

_SUM, _PRODUCT, _ATOM = 1, 2, 3
_LEVELS = dict.fromkeys(("+", "-", "negative"), _SUM) | dict.fromkeys(("*", "/", "**"), _PRODUCT)


@dataclass(frozen=True, slots=True)
class _Text:
    """A text with how strongly it binds."""

    text: str
    level: int

    def at(self, level: int) -> str:
        """Text that binds at least so strongly."""
        return self.text if self.level >= level else f"({self.text})"


_Pair = tuple[_Text, _Text | None]  # a text and its rate, None where it is constant


def rate_of(expression: Expression, coordinates: Collection[str]) -> str:
    """Rate of an expression of coordinates and of what is constant, such as "x1' - x3'" of "x1 - x3".

    Velocities that are named among the coordinates count as these: the rate of "x1'" is "x1''".

    Raises:
        DeclarationError: the expression contains what has no derivative, such as abs.
    """

    def written(step: Step) -> _Text:
        return _Text(expression.text[step.start : step.end], _LEVELS.get(step.operation, _ATOM))

    def symbol(step: Step) -> _Pair:
        return written(step), _Text(f"{step.value}'", _ATOM) if step.value in coordinates else None

    def apply(step: Step, args: Sequence[_Pair]) -> _Pair:
        return written(step), None if all(rate is None for _, rate in args) else _rate(expression, step, args)

    rate = expression.walk(lambda step: (written(step), None), symbol, apply)[1]
    return "0" if rate is None else rate.text


def _rate(expression: Expression, step: Step, args: Sequence[_Pair]) -> _Text:
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
        case name if (derivative := OPERATIONS[name].derivative) and da is not None:
            parts = [_product(_Text(derivative.format(f"({a.text})"), _ATOM), "*", da)]
    if parts:
        return parts[0] if len(parts) == 1 else _sum(parts[0], "+", parts[1])
    message = "has no derivative, so that its rate cannot be derived"
    raise DeclarationError(expression.problem(step, message, "write a smooth expression, such as x1 - x3"))


def _negative(a: _Text) -> _Text:
    return _Text(f"-{a.at(_PRODUCT)}", _SUM)


def _sum(a: _Text, sign: str, b: _Text) -> _Text:
    return _Text(f"{a.at(_SUM)} {sign} {b.at(_PRODUCT)}", _SUM)


def _product(a: _Text, sign: str, b: _Text) -> _Text:
    return _Text(f"{a.at(_PRODUCT)}{sign}{b.at(_ATOM)}", _PRODUCT)
