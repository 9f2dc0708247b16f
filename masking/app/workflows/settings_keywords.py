"""Verbs that take the fields of a settings object as keywords, so that a list of arguments stands in one place."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeVar

P = ParamSpec("P")
S = TypeVar("S")
R = TypeVar("R")

_ARGS, _SETTINGS = "    Args:\n", "        settings: "


def with_fields_of(
    settings: Callable[P, S],
) -> Callable[[Callable[[str | Path, S], R]], Callable[Concatenate[str | Path, P], R]]:
    """Decorator: a verb of a name and a settings object takes the fields of the settings as keywords.

    `help` and type checkers see the fields; in the docstring, their lines take the place of that of the settings.

    Args:
        settings: a frozen dataclass whose fields have defaults or are given by keyword.
    """

    def decorated(verb: Callable[[str | Path, S], R]) -> Callable[Concatenate[str | Path, P], R]:
        @functools.wraps(verb)
        def called(name: str | Path, /, *args: P.args, **fields: P.kwargs) -> R:
            return verb(name, settings(*args, **fields))

        signature = inspect.signature(verb)
        first, _ = signature.parameters.values()
        shown = [first, *inspect.signature(settings).parameters.values()]
        called.__signature__ = signature.replace(parameters=shown)  # type: ignore[attr-defined]  # inspect reads it
        before, _, after = (verb.__doc__ or "").partition(_SETTINGS)
        called.__doc__ = f"{before}{_arguments(settings)}{after[after.find(chr(10)) + 1 :]}"
        return called

    return decorated


def _arguments(settings: object) -> str:
    """Lines under Args of a class and of those that it derives from."""
    docs = [str(kind.__doc__) for kind in inspect.getmro(settings) if kind is not object]  # type: ignore[arg-type]
    blocks = [doc.partition(_ARGS)[2].partition("\n\n")[0].rstrip() for doc in reversed(docs)]
    return "".join(f"{block}\n" for block in blocks if block)
