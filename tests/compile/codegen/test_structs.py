"""Kernels that take structs, from Python and in C."""

from __future__ import annotations

import ctypes
import subprocess
from typing import NamedTuple

import numpy as np
import pytest

from masking.compile.codegen import module_store
from masking.compile.codegen.c_expressions import ARRAY, REAL, Value
from masking.compile.codegen.c_functions import CFunctions
from masking.compile.codegen.generated_module import Module
from masking.compile.numerics.arrays import Vector
from masking.compile.numerics.compilation import compiled
from tests.support.compiled_unit import GCC, STRICT


class Line(NamedTuple):
    """A line y = slope x + offset[0], and where it is wanted."""

    slope: float
    offset: Vector
    x: Vector


class Shifted(NamedTuple):
    """A line and a shift along it."""

    line: Line
    shift: Vector


def values_of_a_line(count):
    @compiled
    def value(shifted, i):
        slope, offset, x = shifted.line
        return slope * (x[i] + shifted.shift[0]) + offset[0]

    @compiled
    def kernel(line: Line, shift: Vector, out: Vector) -> float:
        shifted = Shifted(line, shift)
        for i in range(count):
            out[i] = value(shifted, i)
        return line.slope

    return kernel


X, SHIFT, EXPECTED = np.array([1.0, 2.0, 4.0]), np.array([0.5]), np.array([4.0, 6.0, 10.0])


def test_a_struct_is_passed_whole_or_field_by_field():
    def build():
        made = Module("lines", {})
        made.add_factory("kernel", values_of_a_line, 3)
        return made

    kernel = module_store.load(module_store.key({"lines": 3}), build).function("kernel")
    assert list(kernel.arguments) == ["line_slope", "line_offset", "line_x", "shift", "out"]
    line, out = Line(2.0, np.ones(1), X), np.zeros((2, 3))
    assert kernel(line, SHIFT, out[0]) == kernel(*line, SHIFT, out[1]) == 2.0
    assert np.array_equal(out, [EXPECTED, EXPECTED])
    bound = kernel.bind(line._replace(slope=np.array([2.0])), SHIFT, out[0])
    out[:] = 0.0
    bound.call()
    assert np.array_equal(out[0], EXPECTED)
    with pytest.raises(TypeError, match="line_x must be an array, not float"):
        kernel(line._replace(x=1.0), SHIFT, out[0])
    with pytest.raises(TypeError, match="got 3 arguments"):
        kernel(line)


@pytest.mark.skipif(GCC is None, reason="there is no gcc")
def test_c_functions_take_the_fields_of_a_struct(tmp_path):
    module = Module("lines", {})
    module.add_factory("kernel", values_of_a_line, 3, exported=False)
    functions = CFunctions(module, "double")
    functions.add("kernel", [Value(REAL), *(Value(ARRAY, shape=(n,)) for n in (1, 3, 1, 3))])
    head = "void run(const double *offset, const double *x, const double *shift, double *out)"
    text = f"#include <stdint.h>\n\n{functions.text()}\n\n{head}\n{{\n    kernel(2.0, offset, x, shift, out);\n}}\n"
    (tmp_path / "line.c").write_text(text)
    subprocess.run([GCC, *STRICT, "-shared", "-fPIC", "line.c", "-o", "line.so"], cwd=tmp_path, check=True)
    out, address = np.zeros(3), ctypes.c_void_p
    given = [np.ones(1), X, SHIFT, out]
    ctypes.CDLL(str(tmp_path / "line.so")).run(*(address(one.ctypes.data) for one in given))
    assert np.array_equal(out, EXPECTED)
