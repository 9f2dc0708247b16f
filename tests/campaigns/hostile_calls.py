"""Hostile calls of machine code: arrays of random sizes, types, strides and contents, for every kernel's wrapper.

Calls that a kernel is given in use are recorded, and one or a few of their arguments are exchanged. Each array lies
against a page that nobody may touch, at its end or at its beginning, so that what is read or written beyond it ends the
process. A call is refused by a `TypeError`, or comes back; of every hundred calls the first to end their process is
counted, and the rest goes on in another.
"""

from __future__ import annotations

import ctypes
import faulthandler
import itertools
import math
import mmap
import os
import resource
import signal
import struct
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from masking.compile.codegen.machine_code import DIMENSIONS, NativeFunction
from tests.campaigns import kernels_in_use

SECONDS = 2  # of processor time that a call may take
SCALARS = (0, 1, 2, 3, 7, -1, -5, 40)
NUMBERS = (0.0, 1e-3, 1.0, -1.0, 1e6, 1e-300, 1e300, math.nan, math.inf, -math.inf)
PAGE = mmap.PAGESIZE


@dataclass
class Outcome:
    """How many calls came back, were refused, took too long, and ended their process (with what)."""

    returned: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    long: list[str] = field(default_factory=list)
    ended: list[str] = field(default_factory=list)

    def text(self) -> str:
        """Say it."""
        calls = self.returned.total() + self.refused.total() + len(self.long) + len(self.ended)
        lines = [
            f"{calls} calls of {len({*self.returned, *self.refused})} kernels: {self.refused.total()} refused, "
            f"{self.returned.total()} came back, {len(self.long)} took longer than {SECONDS} s, "
            f"{len(self.ended)} ended their process"
        ]
        never = sorted({*self.refused} - {*self.returned})
        lines += [f"always refused: {', '.join(never)}"] if never else []
        return "\n".join(
            [*lines, *(f"took long: {one}" for one in self.long), *(f"ended: {one}" for one in self.ended)]
        )


def run(calls: int, seed: int, *, together: int = 100, is_quick: bool = False) -> Outcome:
    """Make so many hostile calls, `together` of them in each process."""
    recorded = kernels_in_use.recorded(quick=is_quick)
    outcome = Outcome()
    for first in range(0, calls, together):
        numbers = iter(range(first, min(first + together, calls)))
        while (last := _in_a_process(recorded, numbers, seed, outcome)) is not None:
            numbers = iter(range(last + 1, min(first + together, calls)))
    return outcome


def _in_a_process(
    recorded: list[tuple[NativeFunction, tuple[Any, ...]]], numbers: Iterator[int], seed: int, outcome: Outcome
) -> int | None:
    """Make calls in a process of their own; the number of the call that ended it, None where all are done."""
    read, write = os.pipe()
    if (child := os.fork()) == 0:
        os.close(read)
        faulthandler.disable()
        signal.signal(signal.SIGVTALRM, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        warnings.simplefilter("ignore")
        with os.fdopen(write, "wb", buffering=0) as say:
            for number in numbers:
                function, _ = recorded[number % len(recorded)]
                say.write(struct.pack("qq", number, -1))
                say.write(struct.pack("qq", number, int(_is_taken(function, recorded, number, seed))))
        os._exit(0)
    os.close(write)
    with os.fdopen(read, "rb") as heard:
        said = [*struct.iter_unpack("qq", heard.read())]
    status = os.waitpid(child, 0)[1]
    for number, taken in said:
        name = _name(recorded, number)
        if taken >= 0:
            (outcome.returned if taken else outcome.refused)[name] += 1
    if status == 0:
        return None
    number = said[-1][0]
    what = f"{_name(recorded, number)}, call {number}: {_arguments(recorded, number, seed)}"
    is_long = os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGVTALRM
    (outcome.long if is_long else outcome.ended).append(f"{what}, status {status}")
    return int(number)


def _name(recorded: list[tuple[NativeFunction, tuple[Any, ...]]], number: int) -> str:
    one = recorded[number % len(recorded)][0]
    return f"{one.stem.name[:6]} {one.name}"


def _is_taken(
    function: NativeFunction, recorded: list[tuple[NativeFunction, tuple[Any, ...]]], number: int, seed: int
) -> bool:
    given, kept = hostile(recorded[number % len(recorded)], number, seed)
    signal.setitimer(signal.ITIMER_VIRTUAL, SECONDS)
    try:
        way = number // len(recorded) % 8
        if way == 0:
            function.each(2, *given)
        elif way == 1 and all(isinstance(one, np.ndarray) for one in given):
            function.bind(*given)
            return False
        else:
            function(*given)
    except (TypeError, ctypes.ArgumentError):
        return False
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        del kept
    return True


def _arguments(recorded: list[tuple[NativeFunction, tuple[Any, ...]]], number: int, seed: int) -> str:
    given, _ = hostile(recorded[number % len(recorded)], number, seed)
    names = recorded[number % len(recorded)][0].arguments
    shown = (f"{x.dtype}{x.shape}" if isinstance(x, np.ndarray) else repr(x) for x in given)
    return ", ".join(f"{name} {text}" for name, text in zip(names, shown, strict=False))


def hostile(one: tuple[NativeFunction, tuple[Any, ...]], number: int, seed: int) -> tuple[list[Any], list[Any]]:
    """Arguments of a call by its number, and what keeps their memory."""
    function, valid = one
    random = np.random.default_rng([seed, number])
    given, kept = list[Any](), list[Any]()
    count = int(random.choice([0, 1, 1, 1, 2, 3, len(valid)]))
    exchanged = set(random.choice(len(valid), min(count, len(valid)), replace=False).tolist()) if valid else set()
    others = sorted({size for x in valid if isinstance(x, np.ndarray) for size in x.shape} | {0, 1, 2, 5})
    for i, (value, kind) in enumerate(
        zip(valid, itertools.islice(function.arguments.values(), len(valid)), strict=True)
    ):
        if kind in DIMENSIONS:
            made = _array(random, value, others) if i in exchanged else value
            array, memory = guarded(made, at_end=bool(random.integers(4)))
            kept.append(memory)
            given.append(_spoilt(random, array) if i in exchanged else array)
        elif i in exchanged:
            given.append(int(random.choice(SCALARS)) if kind == "int" else float(random.choice(NUMBERS)))
        else:
            given.append(value)
    return given, kept


def _array(random: np.random.Generator, valid: np.ndarray, others: list[int]) -> np.ndarray:
    """Array of the same type with other sizes, or other numbers in it."""
    shape = list(valid.shape)
    how = random.integers(5)
    if how == 4:
        return _filled(random, valid.copy())
    axis = int(random.integers(len(shape)))
    near = max(0, shape[axis] + int(random.choice([-2, -1, -1, 1, 2, 7])))
    shape[axis] = near if how < 2 else int(random.choice(others))
    if how == 3:
        shape = [int(random.choice(others)) for _ in shape]
    if math.prod(shape) > 1 << 20:
        shape = [min(size, 64) for size in shape]
    made = np.zeros(shape, dtype=valid.dtype)
    part = tuple(slice(0, min(a, b)) for a, b in zip(shape, valid.shape, strict=True))
    made[part] = valid[part]
    return made


def _filled(random: np.random.Generator, array: np.ndarray) -> np.ndarray:
    if array.dtype == np.int64:
        array[...] = random.integers(-2, 9, array.shape)
    elif random.integers(2):
        array[...] = random.choice(NUMBERS)
    else:
        array[...] = random.standard_normal(array.shape)
    return array


def _spoilt(random: np.random.Generator, array: np.ndarray) -> Any:
    """Array of another type, rank or order, read alone, no array at all; most often as it is."""
    other = np.int64 if array.dtype == np.float64 else np.float64
    alone = array.view()
    alone.flags.writeable = False
    ways: tuple[Callable[[], Any], ...] = (
        lambda: array.astype(np.float32),
        lambda: array[np.newaxis],
        lambda: array[..., np.newaxis],
        lambda: np.repeat(array, 2, axis=-1)[..., ::2],
        lambda: array[::-1],
        lambda: alone,
        array.tolist,
        lambda: np.asfortranarray(np.broadcast_to(array, (2, *array.shape))),
        lambda: array.astype(other),
        lambda: None,
        lambda: array.astype(array.dtype.newbyteorder()),
    )
    chosen = int(random.integers(2 * len(ways)))
    return ways[chosen]() if chosen < len(ways) else array


def guarded(array: np.ndarray, *, at_end: bool) -> tuple[np.ndarray, mmap.mmap]:
    """Copy of an array that ends where a page begins that nobody may touch, or begins where one ends."""
    size = array.nbytes
    whole = max(1, -(-size // PAGE)) * PAGE
    memory = mmap.mmap(-1, whole + 2 * PAGE)
    address = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    for place in (0, PAGE + whole):
        if ctypes.CDLL(None).mprotect(ctypes.c_void_p(address + place), PAGE, 0):
            raise MemoryError("a page could not be protected")
    offset = PAGE + (whole - size if at_end else 0)
    copy = np.frombuffer(memory, dtype=array.dtype, count=array.size, offset=offset).reshape(array.shape)
    copy[...] = array
    return copy, memory
