"""How numba compiles kernels: to LLVM code alone.

By itself numba optimises a function together with all that it calls, and makes machine code of it, before it compiles
what calls that: a function within ten others is optimised eleven times. Machine code of kernels is made once, of all of
a kernel together, by `codegen.machine_code`. measured: the largest kernel then takes 16 s in the place of 94 s.
Kernels cannot be called from Python; `py_func` can.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numba
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder, StateDict
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.typed_passes import NativeLowering


class _Library(CPUCodeLibrary):
    """LLVM code of a function, with that of the functions that it calls."""

    def _optimize_final_module(self) -> None:
        """Leave the code as it is."""

    def _finalize_final_module(self) -> None:
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """No address."""
        self._ensure_finalized()
        return 0


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):
    """Makes LLVM code of a function, and lets others call it."""

    _name = "lowering_alone"

    def run_pass(self, state: StateDict) -> bool:
        """Lower a function."""
        context, flags = state.targetctx, state.flags
        state.library = _Library(context.codegen(), state.func_id.func_qualname)
        flags.no_compile = True
        if not flags.no_cpython_wrapper:  # only a C interface has nothing for Python, and wants a wrapper for C
            flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        super().run_pass(state)
        # Numba tells functions apart by what Python would call: here one of its own, which always raises.
        entry = dict[str, int]().popitem
        context.insert_user_function(entry, state.cr.fndesc, [state.library])
        state.cr = state.cr._replace(cfunc=entry)
        return True


class Lowered(CompilerBase):
    """Compiles in numba's passes, but for the last."""

    def define_pipelines(self) -> list[PassManager]:
        """Passes."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [(_Lowering if one is NativeLowering else one, text) for one, text in passes.passes]
        passes.finalize()
        return [passes]


Function = TypeVar("Function", bound=Callable[..., object])


def requires(*conditions: str) -> Callable[[Function], Function]:
    """State what a kernel needs of its arguments, besides what `codegen.argument_sizes` reads off its text.

    Each condition is a Python expression of the arguments, such as `len(states) >= len(times)`, which
    `codegen.machine_code` evaluates before each call, with the names that `codegen.argument_conditions` gives it.
    """

    def note(function: Function) -> Function:
        vars(function)["requires"] = conditions
        return function

    return note


compiled = numba.njit(error_model="numpy", nogil=True, pipeline_class=Lowered)
# measured: a call that LLVM does not take into its caller writes the arrays in its tuples to memory, twice the time.
inlined = numba.njit(error_model="numpy", nogil=True, pipeline_class=Lowered, forceinline=True)
