"""Compiled functions on a GPU of NVIDIA: the same LLVM code, made for that processor, with a thread for each run.

CuPy, an optional package, holds memory there and starts threads; LLVM makes code for such processors without it.
"""

from __future__ import annotations

import importlib
import re
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lazy_loader as lazy
import numpy as np

from masking.compile.codegen import llvm_text, native, trusted_files
from masking.compile.codegen.content_hashes import source_of
from masking.compile.codegen.native import DIMENSIONS, LLVM_TYPES, RESULTS, NativeFunction
from masking.errors import MaskingError

if TYPE_CHECKING:
    import llvmlite.binding as llvm
else:
    llvm = lazy.load("llvmlite.binding", suppress_warning=True)

KERNEL, OF_ONE = "masking_runs", "masking_run"
TRIPLE, OLDEST, PTX = "nvptx64-nvidia-cuda", "sm_75", "+ptx63"  # the driver makes machine code for what is newer
# measured: 32 to 256 take the same time.
THREADS = 64  # of a block
PART = 0.5  # of the free memory that runs take together
PLACE = ("tid", "ntid", "ctaid")  # of a thread: in its block, threads of a block, block


def each(function: NativeFunction, runs: int, *given: Any) -> np.ndarray:  # noqa: ANN401
    """Call a function on the GPU once for each of several runs, as `NativeFunction.each` does on the processor.

    Args:
        function: of a model, such as its integrator.
        runs: how many.
        given: arguments; an array with one axis more than the function takes is passed row by row, a row a run.

    Returns:
        results (runs, RESULTS).

    Raises:
        MaskingError: there is no GPU, or no CuPy; runs do not fit into its memory, or it fails.
    """
    cupy, kernel = available(), _loaded(function)
    results, pool = np.zeros((runs, RESULTS)), cupy.cuda.MemoryPool()
    types = _types(function)
    arguments = {name: (types[name], one) for name, one in zip(types, (*given, results), strict=True)}
    moved = [name for name, (kind, one) in arguments.items() if np.ndim(one) > DIMENSIONS.get(kind, 0)]
    bytes_of_one = sum(arguments[name][1][:1].nbytes for name in moved)
    count = max(1, min(runs, int(PART * cupy.cuda.Device().mem_info[0]) // bytes_of_one))
    try:
        with cupy.cuda.using_allocator(pool.malloc):
            for first in range(0, runs, count):
                rows = slice(first, min(first + count, runs))
                there = {
                    name: cupy.asarray(one[rows] if name in moved else one)
                    for name, (kind, one) in arguments.items()
                    if kind in DIMENSIONS
                }
                size = rows.stop - first
                passed = _passed(arguments, there, set(moved))
                kernel((-(-size // THREADS),), (THREADS,), (np.int64(size), *passed))
                for name in moved:
                    there[name].get(out=arguments[name][1][rows])
                del there, passed
    except cupy.cuda.memory.OutOfMemoryError:
        raise MaskingError(f"the GPU has no room for {count} runs together; give fewer times, or fewer runs") from None
    except (cupy.cuda.runtime.CUDARuntimeError, cupy.cuda.driver.CUDADriverError) as error:
        raise MaskingError(f"the GPU made no runs ({error}); let the processor make them") from None
    finally:
        pool.free_all_blocks()
    return results


def available() -> Any:  # noqa: ANN401  (a module without types)
    """CuPy where it has a GPU.

    Raises:
        MaskingError: it is not installed, or finds no GPU; says why.
    """
    try:
        cupy: Any = importlib.import_module("cupy")
    except ImportError:
        raise MaskingError(
            "CuPy is not installed, which starts work on a GPU: pip install cupy-cuda13x, or cupy-cuda12x for a driver "
            "older than 580; or let the processor make the runs"
        ) from None
    try:
        cupy.cuda.Device().compute_capability  # noqa: B018  (asks the driver)
    except cupy.cuda.runtime.CUDARuntimeError as error:
        raise MaskingError(f"CuPy finds no GPU ({error}); let the processor make the runs") from None
    return cupy


def code(function: NativeFunction) -> str:
    """Assembly of a function for GPUs, with `KERNEL` as what is started; from the cache if it is there."""
    path = function.stem.with_name(f"{function.stem.name}.{source_of(__name__)}.{OLDEST}.ptx")
    found = trusted_files.find(path)
    if found is None:
        found = _assembly("\n\n".join([assembled(function), _kernel(function)])).encode()
        trusted_files.keep(path, found)
    return found.decode()


def assembled(function: NativeFunction) -> str:
    """LLVM code for any processor that makes one run as `OF_ONE`, with elementary functions of its own.

    It takes the number of the run and the arguments of the function, behind each array how many numbers lie between
    what two runs take of it, 0 for the same; then an array for results.
    """
    text = str(function.assembled())
    entry = llvm_text.definition(text, native.ENTRY)
    called = re.search(r"call i32 @([^\s(]+)\(", entry)
    assert called is not None  # noqa: S101  (numba's interface calls what returns a status)
    text = re.sub(r"^target .*$", "", text.replace(entry, ""), flags=re.MULTILINE)
    text = re.sub(r' "(target-cpu|target-features|tune-cpu)"="[^"]*"', "", text)
    return "\n\n".join([*llvm_text.with_elementary_functions(text), _of_one(function, called[1])])


def _of_one(function: NativeFunction, called: str) -> str:
    """Definition of what makes one run."""
    lines, passed = ["%.returned = alloca ptr", "%.raised = alloca ptr"], ["ptr %.returned", "ptr %.raised"]
    for name, kind in {**function.arguments, "found": "Vector"}.items():
        axes = range(DIMENSIONS.get(kind, 0))
        if name == "work" and function.work is not None:
            rows, columns = function.work
            lines.append(f"%work = alloca [{rows * columns} x double], align 16")
            passed += ["ptr %work", f"i64 {rows}", f"i64 {columns}"]
            continue
        if axes:
            lines.append(f"%{name}.first = mul i64 %.run, %{name}.between")
            lines.append(f"%{name}.row = getelementptr double, ptr %{name}, i64 %{name}.first")
        passed.append(f"ptr %{name}.row" if axes else f"{LLVM_TYPES[kind]} %{name}")
        passed += [f"i64 %{name}.{axis}" for axis in axes if name != "found"]
    lines += [f"%.status = call i32 @{called}({', '.join(passed)})", "ret void"]
    return llvm_text.defined(f"void @{OF_ONE}(i64 %.run, {', '.join(_parameters(function))})", lines)


def _kernel(function: NativeFunction) -> str:
    """Definition of what a thread does: the run of its number, if there is one."""
    registers = [f"declare i32 @llvm.nvvm.read.ptx.sreg.{one}.x()" for one in PLACE]
    lines = list[str]()
    for one in PLACE:
        lines.append(f"%.{one}.short = call i32 @llvm.nvvm.read.ptx.sreg.{one}.x()")
        lines.append(f"%.{one} = zext i32 %.{one}.short to i64")
    given = _parameters(function)
    lines += [
        "%.before = mul i64 %.ntid, %.ctaid", "%.run = add i64 %.before, %.tid",
        "%.is_one = icmp slt i64 %.run, %.runs", "br i1 %.is_one, label %some, label %none",
        "some:", f"call void @{OF_ONE}(i64 %.run, {', '.join(given)})", "br label %none",
        "none:", "ret void",
    ]  # fmt: skip
    return "\n".join(
        [*registers, llvm_text.defined(f"ptx_kernel void @{KERNEL}(i64 %.runs, {', '.join(given)})", lines)]
    )


def _types(function: NativeFunction) -> dict[str, str]:
    return {name: kind for name, kind in function.arguments.items() if name != "work"} | {"found": "Vector"}


def _parameters(function: NativeFunction) -> list[str]:
    """Parameters of what makes one run, in LLVM."""
    found = list[str]()
    for name, kind in _types(function).items():
        axes = range(DIMENSIONS.get(kind, 0))
        found.append(f"ptr %{name}" if axes else f"{LLVM_TYPES[kind]} %{name}")
        found += [f"i64 %{name}.{axis}" for axis in axes] + [f"i64 %{name}.between"] * bool(axes)
    return found


def _passed(
    arguments: Mapping[str, tuple[str, Any]], there: Mapping[str, Any], moved: Iterable[str]
) -> Sequence[object]:
    """Return what the kernel is given for arguments, whose arrays are there."""
    passed = list[object]()
    for name, (kind, one) in arguments.items():
        if kind not in DIMENSIONS:
            passed.append(np.float64(one) if kind == "float" else np.int64(one))
            continue
        shape = there[name].shape[name in moved :]
        passed += [there[name], *map(np.int64, shape), np.int64(np.prod(shape) if name in moved else 0)]
    return passed


def _assembly(text: str) -> str:
    """Assembly of LLVM code for GPUs, as one function."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()

    def machine() -> Any:  # noqa: ANN401
        return llvm.Target.from_triple(TRIPLE).create_target_machine(cpu=OLDEST, features=PTX, opt=3)

    layout = machine().target_data
    module = native.parsed(f'target datalayout = "{layout}"\ntarget triple = "{TRIPLE}"\n\n{text}')
    native.optimise(module, KERNEL, machine)
    found = str(machine().emit_assembly(module))
    missing = re.findall(r"^\.extern \.func.*?(\w+)\s*$", found, re.MULTILINE)
    if missing:
        raise MaskingError(f"no GPU has the functions {', '.join(missing)}; let the processor make the runs")
    return found


_kernels: dict[Path, Any] = {}  # of this process, by the stems of functions, which are hashes of their content


def _loaded(function: NativeFunction) -> Any:  # noqa: ANN401  (a kernel of CuPy)
    """Return what is started of a function; the driver links it once in a process."""
    if function.stem not in _kernels:
        cupy = available()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "runs.ptx"
            path.write_text(code(function))
            try:
                _kernels[function.stem] = cupy.RawModule(path=str(path)).get_function(KERNEL)
            except cupy.cuda.driver.CUDADriverError as error:
                raise MaskingError(
                    f"the driver of the GPU refuses the code ({error}); the GPU may be too old"
                ) from None
    return _kernels[function.stem]
