"""Vectors of numbers in the rows of tables, each of which is one operation of the processor, or a few.

Rows are as long as whole vectors. Numba writes loops, of which LLVM makes vectors only where it can tell that tables do
not overlap: measured, a loop over a short row takes most of its time to find that out.
"""
# ruff: noqa: ANN001, ANN202, PLR0917
# The types are numba's to infer, and arguments of an intrinsic are those of the function that it is.

from __future__ import annotations

from typing import Any, Final

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from masking.compile.numerics.rig_sizes import LANES

_DOUBLE: Final = ir.DoubleType()
_VECTOR: Final = ir.VectorType(_DOUBLE, LANES)
_ALIGNED: Final = 8  # bytes of a number
_FUSED: Final = ("contract",)  # a product and a sum in one, rounded once


def _add_products(context, by, begin, n, table, first, out, target):
    """Add n rows of a table, each times a number, to another row, in the vector that begins at a column.

    With `begin` = (r, c) and `target` = (o, at), whole numbers,
    `out[o, at:] += by[r, c]*table[first, at:] + by[r, c + 1]*table[first + 1, at:] + ...`
    """

    def write(context: Any, builder: Any, signature: Any, values: Any) -> Any:  # noqa: ANN401
        by, begin, n, table, first, out, target = (
            _Table(context, builder, kind, value) if isinstance(kind, types.Array) else value
            for kind, value in zip(signature.args, values, strict=True)
        )
        (r, c), (o, at) = (cgutils.unpack_tuple(builder, pair, 2) for pair in (begin, target))
        factor, target = by.at(r, c), out.vector(o, at)
        total = cgutils.alloca_once_value(builder, builder.load(target, align=_ALIGNED))
        with cgutils.for_range(builder, n) as loop:
            row = builder.add(first, loop.index)
            product = builder.fmul(
                _repeated(builder, builder.load(builder.gep(factor, [loop.index]))),
                builder.load(table.vector(row, at), align=_ALIGNED),
                flags=_FUSED,
            )
            builder.store(builder.fadd(builder.load(total), product, flags=_FUSED), total)
        builder.store(builder.load(total), target, align=_ALIGNED)
        return context.get_dummy_value()

    return types.void(by, begin, n, table, first, out, target), write


add_products: Any = intrinsic(_add_products)


def _cleared(context, out, first, last):
    """Write 0 into the rows of a table from one on, up to another."""

    def write(context: Any, builder: Any, signature: Any, values: Any) -> Any:  # noqa: ANN401
        table, (_, first, last) = _Table(context, builder, signature.args[0], values[0]), values
        vectors = builder.udiv(builder.mul(builder.sub(last, first), table.width), table.width.type(LANES))
        begin = table.vector(first, table.width.type(0))
        with cgutils.for_range(builder, vectors) as loop:
            builder.store(_VECTOR(None), builder.gep(begin, [loop.index]), align=_ALIGNED)
        return context.get_dummy_value()

    return types.void(out, first, last), write


cleared: Any = intrinsic(_cleared)


def _repeated(builder: Any, value: Any) -> Any:  # noqa: ANN401
    """Vector of one number."""
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), value, ir.IntType(32)(0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES))


class _Table:
    """An array of two dimensions, row by row, in code that is being written."""

    def __init__(self, context: Any, builder: Any, kind: Any, value: Any) -> None:  # noqa: ANN401
        made = context.make_array(kind)(context, builder, value)
        _, self.width = cgutils.unpack_tuple(builder, made.shape)
        self.builder, self.data, self.stride = builder, made.data, self.width

    def at(self, row: Any, column: Any) -> Any:  # noqa: ANN401
        """Address of an element."""
        return self.builder.gep(self.data, [self.builder.add(self.builder.mul(row, self.stride), column)])

    def vector(self, row: Any, column: Any) -> Any:  # noqa: ANN401
        """Address of the vector that begins at an element."""
        return self.builder.bitcast(self.at(row, column), _VECTOR.as_pointer())
