"""Sizes of expressions once their definitions are written out, found without writing them out.

Each of twenty definitions that holds the one before it twice is short; written out, the last has a million terms.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from graphlib import CycleError, TopologicalSorter

from masking.model.declaration.expression import Expression
from masking.model.declaration.syntax import LARGEST


def oversized(
    formulas: Iterable[tuple[str, Expression]], definitions: Mapping[str, Expression]
) -> Iterator[tuple[str, int]]:
    """Yield the path and size of the first definition that is too large, or of each other formula that is.

    Cycles of definitions are reported elsewhere.
    """
    uses = {name: expression.names & definitions.keys() for name, expression in definitions.items()}
    try:
        order = [*TopologicalSorter(uses).static_order()]
    except CycleError:
        return
    sizes: dict[str, int] = {}
    for name in order:
        sizes[name] = _size(definitions[name], sizes)
        if sizes[name] > LARGEST:
            yield f"definitions.{name}", sizes[name]
            return
    for path, expression in formulas:
        if (size := _size(expression, sizes)) > LARGEST:
            yield path, size


def _size(expression: Expression, sizes: Mapping[str, int]) -> int:
    held = (step.value if step.operation == "symbol" else "" for step in expression.steps)
    return sum(sizes.get(name, 1) for name in held)
