"""Parameters of a verb: from its signature and docstring, or from those of the settings that it takes as keywords.

A list of arguments stands in one place: `help`, type checkers and the command line read it there.
"""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Concatenate, ParamSpec, TypeVar, get_type_hints

P = ParamSpec("P")
N = TypeVar("N")
S = TypeVar("S")
R = TypeVar("R")
V = TypeVar("V", bound=Callable[..., Any])

_ARGS, _SETTINGS = "    Args:\n", "        settings: "
_ENTRY = re.compile(r"^ {8}(\w+(?:, \w+)*): (.*(?:\n {12,}.*)*)", re.MULTILINE)


@dataclass(frozen=True)
class Parameter:
    """A parameter of a verb and its text in a docstring; `kind` and `default` are as `inspect.Parameter` has them."""

    name: str
    kind: Any
    type: Any
    default: object
    text: str

    @property
    def is_repeated(self) -> bool:
        """Whether it takes any number of arguments."""
        return bool(self.kind is inspect.Parameter.VAR_POSITIONAL)

    @property
    def is_required(self) -> bool:
        """Whether it has no default."""
        return self.default is inspect.Parameter.empty


def parameters(function: Callable[..., Any]) -> dict[str, Parameter]:
    """Parameters of a function, or of a class with fields, by name."""
    hints, entries = get_type_hints(function), _ENTRY.findall(_arguments(function))
    texts = {name: " ".join(text.split()) for names, text in entries for name in names.split(", ")}
    return {
        name: Parameter(name, known.kind, hints.get(name, known.annotation), known.default, texts.get(name, ""))
        for name, known in inspect.signature(function).parameters.items()
    }


def with_fields_of(settings: Callable[P, S]) -> Callable[[Callable[[N, S], R]], Callable[Concatenate[N, P], R]]:
    """Decorator: a verb of one object and its settings takes the fields of these, a frozen dataclass, as keywords.

    `help` and type checkers see the fields; in the docstring, their lines take the place of that of the settings.
    """

    def decorated(verb: Callable[[N, S], R]) -> Callable[Concatenate[N, P], R]:
        first = next(iter(inspect.signature(verb).parameters))

        def take(name: N, /, *args: P.args, **fields: P.kwargs) -> R:
            return verb(name, settings(*args, **fields))

        take.__qualname__ = verb.__name__  # for the message of a TypeError

        @functools.wraps(verb)
        def called(*args: Any, **keywords: Any) -> R:  # noqa: ANN401  # as `take`, whose first argument has a name
            if first in keywords:
                args = (keywords.pop(first), *args)
            return take(*args, **keywords)

        return showing(settings)(called)

    return decorated


def showing(settings: Callable[..., Any]) -> Callable[[V], V]:
    """Decorator: the signature and the docstring of a verb have the fields of its settings in place of them."""

    def decorated(verb: V) -> V:
        show(verb, parameters(settings), _arguments(settings))
        return verb

    return decorated


def show(verb: Callable[..., Any], fields: Mapping[str, Parameter], lines: str) -> None:
    """Let the signature and the docstring of a verb have fields in place of its last parameter, `settings`."""
    signature = inspect.signature(verb)
    *first, _ = signature.parameters.values()
    shown = [inspect.Parameter(p.name, p.kind, default=p.default, annotation=p.type) for p in fields.values()]
    verb.__signature__ = signature.replace(parameters=[*first, *shown])  # type: ignore[attr-defined]  # for inspect
    before, _, after = (verb.__doc__ or "").partition(_SETTINGS)
    verb.__doc__ = f"{before}{lines}{after[after.find(chr(10)) + 1 :]}"


def _arguments(function: Callable[..., Any]) -> str:
    """Lines under Args of a function, or of a class and those that it derives from."""
    sources = inspect.getmro(function)[:-1] if inspect.isclass(function) else (function,)
    blocks = [str(source.__doc__).partition(_ARGS)[2].partition("\n\n")[0].rstrip() for source in reversed(sources)]
    return "".join(f"{block}\n" for block in blocks if block)
