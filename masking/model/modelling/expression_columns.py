"""Values of an expression along a record: columns in, a column out."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.model.declaration.expression import Expression
from masking.model.declaration.operations import OPERATIONS, Step


def on_columns(expression: Expression, columns: Mapping[str, Array | float]) -> Array:
    """Values of an expression (m,), or () where no column is in it.

    Args:
        expression: in which all branches of a `where` are computed.
        columns: (m,), or numbers, by symbol, primes included.

    Raises:
        FloatingPointError: a value has no meaning, where `numpy.errstate` says so.
        ValueError: a function of floats has no value.
    """

    def apply(step: Step, args: Sequence[Any]) -> Any:  # noqa: ANN401  (a number, or a column of them)
        operation = OPERATIONS[step.operation]
        if not operation.array:
            return np.asarray(np.frompyfunc(operation.number, len(args), 1)(*args), dtype=float)
        function = getattr(np, operation.array)
        return functools.reduce(function, args) if step.operation in {"min", "max"} else function(*args)

    return np.asarray(expression.walk(Step.number, lambda step: columns[step.value], apply), dtype=float)
