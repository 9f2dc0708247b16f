"""What machine code needs of its arguments: sizes that its text asks for, and conditions that a kernel declares.

A kernel states its conditions by `numerics.compilation.requires`; `machine_code` refuses a call that breaks one.

Conditions are Python expressions of the arguments by their names, fields of structs as `argument.field`, and of:

* `linked.y`: the greatest size that the functions which are linked to a kernel need of their argument `y`, of its first
  axis; `linked.width`, that of the last axis of what they write; and `linked.case(y, number)`, that of one which
  chooses by a number;
* `within(indices, size)`: whether all indices of an array, or one, are those of an axis of this size;
* `kept(begin, samples, every)`: the number of samples from `begin` on whose index is a multiple of `every`;
* `are_terms(terms, values, rows, entries, columns)`: whether terms of a sum (3, m) with values (m,) are of tables with
  this number of rows and columns;
* what a condition before it has named by `:=`.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

import numpy as np

GIVEN = {"t", "y", "u", "p"}  # arguments of a rig's functions that these only read
# Memory of an array that can be written; measured: its `addressof` takes a fifth of the time of `array.ctypes.data`.
MEMORY: Callable[[Any], Any] = (ctypes.c_char * 0).from_buffer
# What conditions on arrays name, and what passes arrays.
ARRAYS = {"ndarray": np.ndarray, "float64": np.dtype(np.float64), "int64": np.dtype(np.int64)}
ARRAYS |= {"addressof": ctypes.addressof, "memory": MEMORY}
AXES = ("len({x})", "{x}.shape[1]", "{x}.shape[2]")  # in formats; measured: `len` takes a third of the time


@dataclass(frozen=True)
class Needed:
    """What a function needs of its arguments."""

    sizes: Mapping[str, Sequence[int]] = field(default_factory=dict)  # least size of each axis of arrays
    conditions: Sequence[str] = ()
    cases: Mapping[str, Sequence[int]] = field(default_factory=dict)  # least size by the number of what is chosen


NOTHING = Needed()


@dataclass(frozen=True)
class Linked:
    """What functions that are linked to a kernel need."""

    functions: Sequence[Needed]

    def __getattr__(self, name: str) -> int:
        """Size of the first axis of an argument."""
        return max((one.sizes[name][0] for one in self.functions if name in one.sizes), default=0)

    @cached_property
    def width(self) -> int:
        """Size of the last axis of what they write."""
        return max((n[-1] for one in self.functions for name, n in one.sizes.items() if name not in GIVEN), default=0)

    def case(self, name: str, number: int) -> int:
        """Size of an argument of a function that chooses by a number; 0 where there is nothing of this number."""
        cases = (one.cases.get(name, ()) for one in self.functions)
        return max((sizes[number] for sizes in cases if 0 <= number < len(sizes)), default=0)


def within(indices: Any, size: int) -> bool:  # noqa: ANN401  (an array of whole numbers, or one)
    """Whether all indices are those of an axis of a size."""
    return bool(np.all((np.asarray(indices) >= 0) & (np.asarray(indices) < size)))


def kept(begin: int, samples: int, every: int) -> int:
    """Number of samples from one on whose index is a multiple of `every`."""
    return (begin + max(samples, 0) - 1) // every - (begin - 1) // every


def are_terms(terms: Any, values: Any, rows: int, entries: int, columns: int) -> bool:  # noqa: ANN401  (arrays)
    """Whether each term has a row, an entry and a column of tables of such a size, and a value."""
    return (
        len(terms) >= 3
        and terms.shape[1] >= len(values)
        and all(within(one, size) for one, size in zip(terms, (rows, entries, columns), strict=False))
    )


def of_array(kind: str, axes: int, least: Sequence[int]) -> dict[str, str]:
    """Conditions on an array `{x}` that machine code reads, and what is said of an array that breaks one.

    `kind` is that of its elements, `float64` or `int64`; `least` are the least sizes of its axes, where there are such.
    """
    read = f"must be a C-contiguous {kind} array of dimension {axes}, not {{x.dtype}} of shape {{x.shape}}"
    short = f"must have a shape of at least {tuple(least)}, not {{x.shape}}"
    return {
        "isinstance({x}, ndarray)": "must be an array, not {x.__class__.__name__}",
        f"{{x}}.ndim == {axes} and {{x}}.dtype == {kind} and {{x}}.flags.c_contiguous": read,
        "{x}.flags.writeable": "must be an array that can be written, not one that is read alone",
        **{f"{axis} >= {size}": short for axis, size in zip(AXES[:axes], least, strict=False) if size},
    }


def broken(value: Any, kind: str, axes: int, least: Sequence[int]) -> str:  # noqa: ANN401
    """What is wrong with a value as an array that machine code reads; '' if nothing is."""
    conditions = of_array(kind, axes, least).items()
    return next((said.format(x=value) for condition, said in conditions if not _holds(condition)(value)), "")


@cache
def _holds(condition: str) -> Callable[[Any], bool]:
    return guarded("True", [condition.format(x="x")], ["x"])


def guarded(
    result: str, conditions: Iterable[str], arguments: Iterable[str], linked: Linked | None = None
) -> Callable[..., Any]:
    """Expression as a function of the values of the arguments: None where they break a condition."""
    names = {"linked": linked, "within": within, "kept": kept, "are_terms": are_terms, **ARRAYS}
    text = " and ".join(f"({one})" for one in conditions) or "True"
    found = eval(f"lambda {', '.join(arguments)}: ({result}) if {text} else None", names)  # noqa: S307  # of kernels alone

    def value(*values: Any) -> Any:  # noqa: ANN401
        try:
            return found(*values)
        except IndexError:  # of a table that has not what a condition looks at
            return None

    return value
