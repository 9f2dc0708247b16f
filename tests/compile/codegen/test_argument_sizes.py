"""Least sizes of arrays: those that a kernel's text asks for, and a page behind an array that nobody may touch.

Machine code is called with arrays that end where such a page begins. Of the sizes that were found it touches nothing
behind them; of one element less it does, and its process is killed.
"""

from __future__ import annotations

import ctypes
import dataclasses
import faulthandler
import math
import mmap
import os
import signal
from functools import cache

import numpy as np
import pytest

from masking.app.workflows.run import Experiment
from masking.compile.codegen.argument_conditions import NOTHING
from masking.compile.codegen.argument_sizes import least_sizes
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.machine_code import DIMENSIONS
from masking.compile.numerics.arrays import Matrix, Vector
from masking.compile.numerics.compilation import compiled
from masking.control.rig.twin import Twin
from masking.model.modelling.model import load_model


@compiled
def first_three(x, y):
    for i in range(3):
        y[i] = x[i + 1]


def in_loops(count, keeps):
    @compiled
    def kernel(x: Vector, y: Vector, table: Matrix, past: Vector, many: int) -> None:
        for i in range(count):
            for j in range(2 * count):
                table[i, j] = x[i + j]
        first_three(table[1], y[count:])
        if keeps:
            past[7] = 1.0
        if many > 2:
            past[9] = 1.0
        for k in range(many):
            y[k] = past[k]

    return kernel


@pytest.mark.parametrize(("count", "keeps"), [(2, True), (5, False)])
def test_a_kernel_asks_for_what_its_loops_slices_and_callees_touch(count, keeps):
    module = Module("loops", {})
    module.add_factory("kernel", in_loops, count, keeps)
    expected = {"x": [3 * count - 1], "y": [count + 3], "table": [max(count, 2), max(2 * count, 4)]}
    assert least_sizes(module)["kernel"] == expected | {"past": [10]}


@cache
def kernels(name):
    found = {
        "model": lambda: load_model("huygens").kernels,
        "twin": lambda: Twin.load("linear_rig").kernels,
        "loop": lambda: Experiment.load("duffing").loop.kernels,
        "controller": lambda: Experiment.load("huygens_rig").sampled.kernels,
    }
    return found[name]()


CASES = (
    *(("model", name) for name in ("accelerations", "derivative", "energy")),
    *(("twin", name) for name in ("sense_under", "sense", "twin_derivative", "advance")),
    *(("loop", name) for name in ("transform", "step", "plant_derivative", "input_matrix", "along")),
    *(("controller", name) for name in ("law", "rate", "measure", "virtual", "transforms")),
)


def guarded(shape):
    """Return an array that ends where a page begins that nobody may touch, and its memory."""
    page, size = mmap.PAGESIZE, 8 * math.prod(shape)
    whole = -(-size // page) * page
    memory = mmap.mmap(-1, whole + page)
    address = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    assert not ctypes.CDLL(None).mprotect(ctypes.c_void_p(address + whole), page, 0)
    return np.frombuffer(memory, count=math.prod(shape), offset=whole - size).reshape(shape), memory


def ends_by(function, shapes):
    """Return the signal that ends a process which calls a function with arrays of some shapes; 0 for none."""
    function.prepare()
    if child := os.fork():
        return os.waitpid(child, 0)[1] & 0x7F
    faulthandler.disable()
    given, kept = [], []
    for name, kind in function.arguments.items():
        if kind in DIMENSIONS:
            array, memory = guarded(shapes[name])
            array[...] = 0.1
            given.append(array)
            kept.append(memory)
        elif name != "work":
            given.append(1 if kind == "int" else 0.1)
    function(*(given if function.work is None else given[:-1]))
    os._exit(0)


def shapes_of(function):
    found = {}
    for name, kind in function.arguments.items():
        if kind in DIMENSIONS:
            least = [*function.needed.sizes.get(name, ())]
            found[name] = tuple(max(1, n) for n in [*least, *[0] * (DIMENSIONS[kind] - len(least))])
    return found


@pytest.mark.parametrize(("of", "name"), CASES)
def test_nothing_is_touched_behind_arrays_of_the_least_sizes(of, name):
    function = getattr(kernels(of), name)
    assert function.needed.sizes
    assert ends_by(function, shapes_of(function)) == 0


@pytest.mark.parametrize(("of", "name"), CASES)
def test_an_array_that_is_one_element_short_is_refused_and_would_be_left(of, name):
    function = getattr(kernels(of), name)
    careless = dataclasses.replace(function, needed=NOTHING)
    for argument, least in function.needed.sizes.items():
        if argument == "work":
            continue
        shapes = shapes_of(function)
        shapes[argument] = (*shapes[argument][:-1], least[-1] - 1)
        assert ends_by(careless, shapes) == signal.SIGSEGV, argument
        arrays = [np.zeros(shapes[n]) if kind in DIMENSIONS else 1 for n, kind in function.arguments.items()]
        with pytest.raises(TypeError, match=f"{name}: {argument} must have a shape of at least"):
            function(*(arrays if function.work is None else arrays[:-1]))
