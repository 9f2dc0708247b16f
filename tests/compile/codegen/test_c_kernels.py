"""Kernels translated into C, against the Python that they are written in."""

import ctypes
import math
import subprocess

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from masking.compile.codegen.c_expressions import ARRAY, INTEGERS, Value
from masking.compile.codegen.c_functions import CFunctions
from masking.compile.codegen.generated_module import Made, Module
from tests.support.compiled_unit import GCC, STRICT

ROWS, COLUMNS = 3, 4


def both(a, b):
    return a + b, a - b


def unusual(n, limits, is_on):
    """Make a kernel that holds what kernels are written in."""

    def inner(row, size):
        total = 0.0
        for i in range(size):
            total += row[i] if row[i] > 0.0 else -0.5 * row[i]
        return total

    def kernel(x, k, out):
        rows, width = x.shape
        low, high = x[0], x[1][1:]
        if is_on and rows > 2:
            out[0] = out[1] = inner(low, width)
        else:
            out[0] = -1.0
        for i in range(1, n):
            if x[i, 0] < x[i, 1] or not x[i, 2] <= 0.0:
                best = max(x[i, 0], x[i, 1], -x[i, 2])
            else:
                best = min(x[i, 0], limits.stop - limits.start)
            out[1 + i] = best / (1.0 + best * best)
        _, out[4] = both(high[0], high[1])
        out[5] = math.sqrt(abs(out[0])) * math.expm1(-1.0 / (1.0 + out[0] * out[0])) if math.isfinite(out[0]) else 7.0
        k[0] = (k[0] + 7) // 2 % 5 - min(k[1], 3)
        out[6] = math.floor(x[2, 3] / 2) + k[0] / 4
        out[7] = inner(x[k[2]], 2) - (x[0, 0] - (x[0, 1] - x[0, 2])) - -x[0, 3]

    return kernel


MADE = (ROWS, slice(2, 5), True)


@pytest.fixture(scope="module")
def in_c(tmp_path_factory):
    module = Module("test", {})
    module.add_factory("kernel", unusual, *MADE, exported=False)
    functions = CFunctions(module, "double")
    shapes = [Value(ARRAY, shape=(ROWS, COLUMNS)), Value(INTEGERS, shape=(3,)), Value(ARRAY, shape=(8,))]
    functions.add("kernel", shapes)
    folder = tmp_path_factory.mktemp("c")
    call = "void run(const double *x, int32_t *k, double *out)\n{\n    kernel(x, k, out);\n}\n"
    text = f"#include <math.h>\n#include <stdint.h>\n\n{functions.text()}\n\n{call}"
    (folder / "kernel.c").write_text(text)
    subprocess.run([GCC, *STRICT, "-shared", "-fPIC", "kernel.c", "-o", "kernel.so", "-lm"], cwd=folder, check=True)
    run = ctypes.CDLL(str(folder / "kernel.so")).run
    run.argtypes = [
        np.ctypeslib.ndpointer(dtype=np.float64),
        np.ctypeslib.ndpointer(dtype=np.int32),
        np.ctypeslib.ndpointer(dtype=np.float64),
    ]
    return run


numbers = st.floats(-1e3, 1e3, allow_subnormal=False) | st.just(math.nan)


@pytest.mark.skipif(GCC is None, reason="there is no gcc")
@hypothesis.given(
    st.lists(numbers, min_size=ROWS * COLUMNS, max_size=ROWS * COLUMNS),
    st.tuples(*[st.integers(0, 50)] * 2, st.integers(0, 2)),
)
@hypothesis.settings(suppress_health_check=[hypothesis.HealthCheck.function_scoped_fixture], deadline=None)
def test_a_kernel_gives_the_same_numbers_in_c(in_c, values, whole):
    values[-1] = 0.5 if math.isnan(values[-1]) else values[-1]  # floor of what is no number is no whole one
    x = np.array(values).reshape(ROWS, COLUMNS)
    found = []
    for run in (unusual(*MADE), in_c):
        k, out = np.array(whole, dtype=np.int32), np.zeros(8)
        run(x, k, out)
        found.append((k, out))
    (whole_numbers, reals), (k, out) = found
    assert np.array_equal(k, whole_numbers)
    np.testing.assert_allclose(out, reals, rtol=1e-14, atol=0.0)


def test_what_has_no_form_in_c_is_named():
    def made():
        def kernel(x):
            x[0] = [1.0][0]

        return kernel

    module = Module("test", {})
    module.parts["kernel"] = Made(made, ())
    with pytest.raises(TypeError, match=r"kernel: '\[1.0\]' has no form in C: no such expression"):
        CFunctions(module, "double").add("kernel", [Value(ARRAY, shape=(1,))])
