"""Definitions that hold each other: their order, all that is inside of them, and their sizes once written out.

Each of twenty definitions that holds the one before it twice is short; written out, the last has a million terms.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping

from masking.model.declaration.expression import Expression
from masking.model.declaration.syntax import LARGEST


def in_order(uses: Mapping[str, Collection[str]]) -> Iterator[str]:
    """Names, each after those that it uses; without names that use themselves, through others too.

    Args:
        uses: names that each name uses; those that are no keys are left out of account.
    """
    waiting, before = dict(uses), len(uses) + 1
    while len(waiting) < before:
        before = len(waiting)
        for name in [*waiting]:
            if waiting.keys().isdisjoint(waiting[name]):
                del waiting[name]
                yield name


def inside(symbols: Iterable[str], definitions: Mapping[str, Expression]) -> set[str]:
    """Symbols, and all symbols inside of those that are definitions."""
    pending = [*symbols]
    held = set(pending)
    while pending:
        name = pending.pop()
        more = definitions[name].symbols - held if name in definitions else ()
        held.update(more)
        pending += more
    return held


def holding(symbols: Collection[str], definitions: Mapping[str, Expression]) -> set[str]:
    """Definitions that hold one of some symbols, through other definitions too."""
    return {name for name in definitions if not inside(definitions[name].symbols, definitions).isdisjoint(symbols)}


def oversized(
    formulas: Iterable[tuple[str, Expression]], definitions: Mapping[str, Expression]
) -> Iterator[tuple[str, int]]:
    """Path and size of the first definition that is too large, or of each other expression that is.

    Args:
        formulas: all expressions by their paths.
        definitions: those that others may hold; cycles are reported elsewhere.
    """
    sizes: dict[str, int] = {}
    for name in in_order({name: expression.names for name, expression in definitions.items()}):
        sizes[name] = _size(definitions[name], sizes)
        if sizes[name] > LARGEST:
            yield f"definitions.{name}", sizes[name]
            return
    for path, expression in formulas if len(sizes) == len(definitions) else ():
        if (size := _size(expression, sizes)) > LARGEST:
            yield path, size


def _size(expression: Expression, sizes: Mapping[str, int]) -> int:
    held = (step.value if step.operation == "symbol" else "" for step in expression.steps)
    return sum(sizes.get(name, 1) for name in held)
