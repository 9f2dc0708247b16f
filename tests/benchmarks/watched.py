"""Numbers that note where another value would have decided otherwise.

A watched number is computed with as if it were plain, beside the values that it would have if it began elsewhere. A
comparison is decided by the plain value, and notes the others by which it would have gone the other way. Where a number
leaves as a plain one, as an index or into compiled code, the others that differ are noted. A program whose notes lack a
value takes the same way with it, to the same end: there is no need to run it.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Hashable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from masking.inference.discovery.decision_rules import DecisionRules

Key = Hashable


class Watched:
    """A number, the values that it would have otherwise, and where these are noted."""

    __array_ufunc__ = None  # arrays leave the operation to this class

    def __init__(self, value: Any, others: Mapping[Key, Any], noted: set[Key]) -> None:
        """Watch a number.

        Args:
            value: by which it is decided.
            others: values that it would have otherwise.
            noted: gets the keys of those that would have decided otherwise.
        """
        self.value, self.others, self.noted = value, dict(others), noted

    def _made(self, function: Callable[..., Any], *arguments: Any) -> Watched:
        value, others = self._all(function, *arguments)
        return Watched(value, others, self.noted)

    def _compared(self, function: Callable[..., Any], other: Any) -> Any:
        value, others = self._all(function, other)
        self.noted.update(key for key, one in others.items() if not np.array_equal(one, value))
        return value

    def _all(self, function: Callable[..., Any], *arguments: Any) -> tuple[Any, dict[Key, Any]]:
        every = [self, *arguments]
        keys = dict.fromkeys(key for one in every if isinstance(one, Watched) for key in one.others)
        others = {key: function(*(_at(one, key) for one in every)) for key in keys}
        return function(*(one.value if isinstance(one, Watched) else one for one in every)), others

    def __float__(self) -> float:
        """Leave as a plain number."""
        return float(self._left())

    def __int__(self) -> int:
        """Leave as a whole number, which others may be, too."""
        return self._left(int)

    def __round__(self, digits: int | None = None) -> Any:
        """Leave as a rounded number, which others may be, too."""
        return self._left(lambda value: round(value, digits))

    def __bool__(self) -> bool:
        """Leave as a truth, which others may be, too."""
        return self._left(bool)

    def __index__(self) -> int:
        """Leave as a plain number."""
        return operator.index(self._left())

    def __hash__(self) -> int:
        """Leave as a plain number."""
        return hash(self._left())

    def __format__(self, words: str) -> str:
        """Leave as a text."""
        return format(self._left(), words)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray[Any, Any]:
        """Leave as a plain array."""
        return np.asarray(self._left(), dtype=dtype)

    def _left(self, convert: Callable[[Any], Any] = lambda value: value) -> Any:
        """Return the plain value, converted, and note the others that would leave as another one."""
        value = convert(self.value)
        self.noted.update(key for key, one in self.others.items() if not np.array_equal(convert(one), value))
        return value


def _at(number: Any, key: Key) -> Any:
    return number.others.get(key, number.value) if isinstance(number, Watched) else number


def _computed(function: Callable[..., Any]) -> Callable[..., Watched]:
    return lambda self, *others: self._made(function, *others)


def _reflected(function: Callable[..., Any]) -> Callable[..., Watched]:
    return lambda self, other: self._made(lambda right, left: function(left, right), other)


def _decided(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda self, other: self._compared(function, other)


for _name in ("add", "sub", "mul", "truediv", "floordiv", "pow"):
    setattr(Watched, f"__{_name}__", _computed(getattr(operator, _name)))
    setattr(Watched, f"__r{_name}__", _reflected(getattr(operator, _name)))
for _name in ("neg", "abs"):
    setattr(Watched, f"__{_name}__", _computed(getattr(operator, _name)))
for _name in ("lt", "le", "gt", "ge", "eq", "ne"):
    setattr(Watched, f"__{_name}__", _decided(getattr(operator, _name)))


class WatchedRules(DecisionRules):
    """The rules of every discovery, which note those that are read, and those that decide."""

    def watching(self, others: Mapping[str, Mapping[Key, Any]]) -> WatchedRules:
        """Return itself with the values that each rule would have otherwise."""
        watch = {"others": others, "read": set[str](), "noted": set[Key]()}
        object.__setattr__(self, "watch", watch)
        return self

    def __getattribute__(self, name: str) -> Any:
        """Return a rule as a watched number; one that cannot be watched as it is, with all others noted."""
        value = object.__getattribute__(self, name)
        if name not in NAMES:
            return value
        watch = object.__getattribute__(self, "watch")
        watch["read"].add(name)
        others = {(name, key): one for key, one in watch["others"].get(name, {}).items()}
        if isinstance(value, tuple) or name in COMPILED:
            watch["noted"].update(others)
            return value
        return Watched(value, others, watch["noted"])


COMPILED = {"stiff_steps", "most_refinement"}  # they enter compiled code
NAMES = frozenset(one.name for one in fields(DecisionRules))
