"""Kernels as Python calls them: those of the package are LLVM code that only other kernels call."""

from functools import cache

import numba


@cache
def called(kernel):
    """Return a kernel compiled for Python, with what it calls."""
    return numba.njit(error_model="numpy")(kernel.py_func)
