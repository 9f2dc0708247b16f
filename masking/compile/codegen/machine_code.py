"""Compiled functions kept on disk as machine code, and called without numba.

The first call of a function compiles it: numba turns it into LLVM code behind a C interface, whose machine code is
written to a file that is named by the hash of the function's content. Every later call, in this process or another,
only links that: starting takes a tenth of the time that importing numba does. A file that was damaged, or that holds
another function, is compiled anew.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import itertools
import re
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from masking.compile.codegen import argument_conditions, structs, trusted_files
from masking.compile.codegen.argument_conditions import MEMORY, NOTHING, Linked, Needed
from masking.compile.codegen.content_hashes import versions
from masking.lazy_imports import binding as llvm
from masking.lazy_imports import compilation, numba

# How an argument of each type goes through the C interface: an array as its address and its shape.
DIMENSIONS = {"Vector": 1, "Matrix": 2, "IntVector": 1, "IntMatrix": 2}
C_TYPES: dict[str, tuple[Any, ...]] = {"float": (ctypes.c_double,), "int": (ctypes.c_int64,)}
C_TYPES |= {kind: (ctypes.c_void_p, *(ctypes.c_int64,) * axes) for kind, axes in DIMENSIONS.items()}
NUMBA_TYPES = {"float": "f8", "int": "i8"}
NUMBA_TYPES |= {
    kind: f"CPointer({'i8' if kind.startswith('Int') else 'f8'})" + axes * ", i8" for kind, axes in DIMENSIONS.items()
}
ELEMENTS = {kind: "int64" if kind in {"int", "IntVector", "IntMatrix"} else "float64" for kind in C_TYPES}
LLVM_TYPES = {"float": "double", "int": "i64"}
ENTRY = "masking_entry"
# No liberty is taken with floating point: NaN, infinity and the order of operations are kept, so that every path
# computes the same numbers. measured: fused multiply-add makes the sampled loop slower, not faster.
DECORATOR = "@compiled"
VECTOR = 64  # bytes of the longest that a processor computes with
RESULTS = 4  # room for the results of a function
Results = ctypes.c_double * RESULTS
SIMPLIFYING = ("sroa", "simplify_cfg", "instruction_combine", "new_gvn", "simplify_cfg", "aggressive_dce")


@dataclass(frozen=True, eq=False)
class BoundFunction:
    """A function with its arguments, which costs little to call: machine code that passes the same arrays each time."""

    # calls it; other threads of Python wait meanwhile, so that the caller never waits for them
    call: Callable[[], object]
    results: ctypes.Array[ctypes.c_double]  # of the last call, (RESULTS,)
    arguments: Sequence[np.ndarray]  # the arrays, kept alive
    code: object = field(repr=False)  # the machine code, kept alive


@dataclass
class NativeFunction:
    """A function of a generated module, called with numpy arrays."""

    name: str  # its name in the module
    arguments: Mapping[str, str]  # the types of its arguments by their names, such as `float` or `Matrix`
    results: Sequence[str]  # the types of its results: none, or `float` and `int`
    work: tuple[int, int] | None  # the shape of its work space, which callers need not give; None if it has none
    # returns LLVM code in which `ENTRY` is the function behind a C interface, not optimised yet
    assembled: Callable[[], Any]
    stem: Path  # path of its machine code, which the processor and an ending follow
    needed: Needed = NOTHING  # of its arguments
    # functions whose machine code it calls, by the names that it has for them
    links: Mapping[str, NativeFunction] = field(default_factory=dict, repr=False)
    _call: Any = field(default=None, repr=False)

    def __call__(self, *given: Any) -> Any:  # noqa: ANN401
        """Call the machine code, on arrays in place; a `TypeError` where one is missing or not as it takes them."""
        call, values, found = self.prepare(), self._completed(given), Results()
        call(*self._passed(values), found)
        read = found[: len(self.results)]
        for place in self._whole:
            read[place] = int(read[place])
        return None if not read else read[0] if len(read) == 1 else tuple(read)

    def each(self, runs: int, *given: Any, threads: int = 1) -> np.ndarray:  # noqa: ANN401
        """Call the machine code once for each of several runs, which threads share; measured: 3 us of Python a run.

        An array with one axis more than the function takes is passed row by row, a row a run. Results are (runs,
        RESULTS); errors are those of a call, and a `TypeError` where there are fewer rows than runs.
        """
        call, results = self.prepare(), np.zeros((runs, RESULTS))

        def part(first: int, last: int) -> None:
            values, moved, place = [*self._completed(given)], list[tuple[int, int, int]](), 0
            for i, (name, kind) in enumerate(self.arguments.items()):
                value, axes = values[i], DIMENSIONS.get(kind, 0)
                if is_rows := axes > 0 and np.ndim(value) == axes + 1:
                    self._check(name, kind, axes + 1, value)
                    values[i] = value[0] if len(value) else np.empty(value.shape[1:], value.dtype)
                if axes:
                    self._check(name, kind, axes, values[i])
                if is_rows:
                    if len(value) < runs:
                        have = len(value)
                        raise TypeError(f"{self.name}: {name} must have a row for each of {runs} runs, not {have}")
                    moved.append((place, value.ctypes.data, value.strides[0]))
                place += 1 + axes
            if not runs:
                return
            passed = [*self._passed(values), 0]
            moved.append((place, results.ctypes.data, results.strides[0]))
            for run in range(first, last):
                for place, address, stride in moved:
                    passed[place] = address + run * stride
                call(*passed)

        share(part, runs, threads)
        return results

    def bind(self, *given: np.ndarray | tuple[Any, ...]) -> BoundFunction:
        """Function with arrays that it reads and writes at each call; a number is an array of one."""
        results, passed, lines = Results(), list[str](), list[str]()
        arrays = self._completed(given)
        for (name, kind), value in zip(self.arguments.items(), arrays, strict=True):
            self._check(name, kind, DIMENSIONS.get(kind, 1), value)
            address = _pointer(value.ctypes.data)
            if kind in DIMENSIONS:
                passed += [address, *(f"i64 {size}" for size in value.shape)]
            else:
                lines.append(f"  %{name} = load {LLVM_TYPES[kind]}, {address}")
                passed.append(f"{LLVM_TYPES[kind]} %{name}")
        kinds = self.arguments.values()
        self._require([x if kind in DIMENSIONS else x[0] for kind, x in zip(kinds, arrays, strict=True)])
        passed.append(_pointer(ctypes.addressof(results)))
        called = _pointer(self.address).removeprefix("ptr ")
        body = [f"define void @{ENTRY}() {{", *lines, f"  call void {called}({', '.join(passed)})", "  ret void", "}"]
        _initialise()
        code = llvm.JITLibraryBuilder().add_ir("\n".join(body)).export_symbol(ENTRY)
        with _linking:
            library = code.link(_linker(), f"bound {next(_numbers)}")
        call = ctypes.PYFUNCTYPE(None)(library[ENTRY])
        return BoundFunction(call, results, arrays, (library, self))

    def _passed(self, values: Sequence[Any]) -> Any:  # noqa: ANN401  (a tuple)
        """Arguments of the C interface: numbers, and addresses and shapes of arrays that a caller holds."""
        passed = self._guarded(*values)
        if passed is None:
            for (name, kind), value in zip(self.arguments.items(), values, strict=True):
                if kind in DIMENSIONS:
                    self._check(name, kind, DIMENSIONS[kind], value)
            self._require(values)
        return passed

    @cached_property
    def _whole(self) -> Sequence[int]:
        """Places of the results that are whole numbers."""
        return [place for place, kind in enumerate(self.results) if kind == "int"]

    @cached_property
    def _guarded(self) -> Callable[..., Any]:
        """What `_passed` returns, of arguments that meet all conditions; else None."""
        passed, conditions = list[str](), list[str]()
        for name, kind in self.arguments.items():
            axes = DIMENSIONS.get(kind, 0)
            passed += [f"addressof(memory({name}))", f"len({name})", f"{name}.shape[1]"][: axes + 1] if axes else [name]
            least = self.needed.sizes.get(name, ())
            of_array = argument_conditions.of_array(ELEMENTS[kind], axes, least) if axes else ()
            conditions += [condition.format(x=name) for condition in of_array]
        return self._under([*conditions, *self.needed.conditions], f"{', '.join(passed)},")

    def _completed(self, given: Sequence[Any]) -> Sequence[Any]:
        """All arguments for those that a caller has given, structs taken apart."""
        values = given
        if any(map(isinstance, given, itertools.repeat(tuple))):
            values = [part for value in given for part in (value if isinstance(value, tuple) else (value,))]
        if len(values) + (self.work is not None) != len(self.arguments):
            raise TypeError(f"{self.name} takes {', '.join(self.arguments)}: got {len(values)} arguments")
        return values if self.work is None else [*values, _aligned(self.work)]

    def _check(self, name: str, kind: str, axes: int, value: Any) -> None:  # noqa: ANN401
        """Refuse what machine code cannot read as an array."""
        least = self.needed.sizes.get(name, ()) if axes == DIMENSIONS.get(kind, 1) else ()  # not of an array of rows
        if said := argument_conditions.broken(value, ELEMENTS[kind], axes, least):
            raise TypeError(f"{self.name}: {name} {said}")

    def _require(self, values: Sequence[Any]) -> None:
        """Refuse arguments that do not meet the conditions of the function."""
        conditions = self.needed.conditions
        if self._under(conditions)(*values):
            return
        first = next(i for i in range(len(conditions)) if not self._under(conditions[: i + 1])(*values))
        given = {n: x for n, x in zip(self.arguments, values, strict=True) if n in conditions[first]}
        found = [f"{name} {f'of shape {x.shape}' if np.ndim(x) else f'= {x}'}" for name, x in given.items()]
        raise TypeError(f"{self.name}: {conditions[first]} must hold; got {', '.join(found)}")

    def _under(self, conditions: Sequence[str], result: str = "True") -> Callable[..., Any]:
        """Expression of the arguments as a function of them: None where they break a condition."""
        linked = Linked([self.needed, *(one.needed for one in self.links.values())])
        return argument_conditions.guarded(result, conditions, self.arguments, linked)

    def prepare(self) -> Any:  # noqa: ANN401  (a ctypes function)
        """Compile or load the function now; return its C interface."""
        if self._call is None:
            self._call = self._load()
        return self._call

    @property
    def address(self) -> int:
        """Address of the machine code, compiled or loaded now."""
        return int(ctypes.cast(self.prepare(), ctypes.c_void_p).value or 0)

    def _load(self) -> Callable[..., None]:
        path = self.stem.with_name(f"{self.stem.name}.{processor()}.o")
        code = trusted_files.find(path)
        if code is not None:
            try:
                return self._interface(path.stem, code)
            except RuntimeError as error:  # of the linker
                message = f"{path} is no machine code of this processor ({error}); it is made anew"
                trusted_files.notice("linked", message)
        code = self._compile()
        trusted_files.keep(path, code)
        return self._interface(f"{path.stem} anew", code)

    def _interface(self, content: str, code: bytes) -> Callable[..., None]:
        types = [c_type for kind in self.arguments.values() for c_type in C_TYPES[kind]]
        called = {symbol(name): one for name, one in self.links.items() if symbol(name).encode() in code}
        addresses = {name: one.address for name, one in called.items()}
        return ctypes.CFUNCTYPE(None, *types, ctypes.c_void_p)(_linked(content, code, addresses))

    def _compile(self) -> bytes:
        """Machine code of the function behind a C interface."""
        module = self.assembled()
        optimise(module, ENTRY, _machine)
        code: bytes = _machine().emit_object(module)
        return code


def share(part: Callable[[int, int], None], runs: int, threads: int) -> None:
    """Call a function with the first of a range of runs and that after its last, for one range in each thread."""
    bounds = [runs * i // threads for i in range(threads + 1)]
    if threads == 1:  # a thread takes 0.1 ms to begin
        part(0, runs)
        return
    with ThreadPoolExecutor(threads - 1) as pool:
        others = pool.map(part, bounds[:-2], bounds[1:-1])
        part(*bounds[-2:])
        list(others)


def _aligned(shape: tuple[int, int]) -> np.ndarray:
    """New array that begins where a vector does: one that lies across two lines of the cache is read twice."""
    rows, columns = shape
    memory = np.empty(rows * columns + VECTOR // 8)
    first = -ctypes.addressof(MEMORY(memory)) % VECTOR // 8
    return memory[first : first + rows * columns].reshape(shape)


def compiled_by_numba(interface: Callable[..., None], arguments: Iterable[str], symbols: Iterable[str]) -> Any:  # noqa: ANN401
    """LLVM code of a function's C interface, as `ENTRY`; `symbols` are linked later."""
    signature = f"void({', '.join(NUMBA_TYPES[kind] for kind in arguments)}, CPointer(f8))"
    for name in symbols:  # numba links what it compiles at once, although it is not called there
        llvm.add_symbol(name, _stop())
    made = numba.cfunc(signature, error_model="numpy", pipeline_class=compilation.Lowered)(interface)
    module = parsed(_without_aliases(made.inspect_llvm()))
    module.get_function(made.native_name).name = ENTRY
    return module


@contextlib.contextmanager
def lightly_optimised() -> Iterator[None]:
    """Let numba leave its code as it is: only with what a template is linked with is it known how loops unroll.

    measured: optimised before, loops over states stay loops, and the Runge-Kutta method takes 2.8 times as long.
    """
    config: Any = numba.config
    names = {"OPT": type(config.OPT)(0), "LOOP_VECTORIZE": 0, "SLP_VECTORIZE": 0}
    before = {name: getattr(config, name) for name in names}
    try:
        for name, value in names.items():
            setattr(config, name, value)
        yield
    finally:
        for name, value in before.items():
            setattr(config, name, value)


def parsed(text: str) -> Any:  # noqa: ANN401
    """LLVM code of a text."""
    _initialise()
    return llvm.parse_assembly(text)


def linked_template(bitcode: bytes, text: str) -> Any:  # noqa: ANN401
    """Template, as LLVM bitcode, together with the functions that are linked to it."""
    _initialise()
    module = llvm.parse_bitcode(bitcode)
    module.link_in(llvm.parse_assembly(text))
    return module


def interface(name: str, arguments: Mapping[str, Any], results: Sequence[str]) -> str:
    """Source of a function's C interface: pointers and sizes in, results through a pointer; structs are classes."""
    parameters, passed = [], []
    for argument, kind in arguments.items():
        texts = []
        for part, part_kind in structs.fields({argument: kind}).items():
            axes = [f"{part}_{axis}" for axis in range(DIMENSIONS.get(part_kind, 0))]
            parameters += [part, *axes]
            texts.append(f"carray({part}, ({', '.join(axes)},))" if axes else part)
        passed.append(texts[0] if isinstance(kind, str) else f"{kind.__name__}({', '.join(texts)})")
    call = f"{name}({', '.join(passed)})"
    lines = [f"def {name}_c({', '.join([*parameters, 'found'])}):"]
    if not results:
        lines.append(f"    {call}")
    elif len(results) == 1:
        lines.append(f"    carray(found, ({RESULTS},))[0] = {call}")
    else:
        names = ", ".join(f"r{i}" for i in range(len(results)))
        lines += [f"    {names} = {call}", f"    results = carray(found, ({RESULTS},))"]
        lines += [f"    results[{i}] = r{i}" for i in range(len(results))]
    return "\n".join(lines)


def passed(arguments: Mapping[str, str]) -> tuple[list[str], list[str]]:
    """Types in numba by which arguments go to machine code, and the texts that are passed."""
    types, texts = [], []
    for argument, kind in arguments.items():
        axes = [f"{argument}.shape[{axis}]" for axis in range(DIMENSIONS.get(kind, 0))]
        types.append(re.sub(r"\b([fi]8)", r"numba.\1", NUMBA_TYPES[kind].replace("CPointer(", "numba.types.CPointer(")))
        texts += [f"{argument}.ctypes", *axes] if axes else [argument]
    return types, texts


def link(name: str, arguments: Mapping[str, str], *, returns: bool, is_apart: bool) -> str:
    """Source of a function `linked_<name>` that calls one with a symbol that is linked later, by its arguments.

    One that is machine code apart stands behind a C interface, and one of its arguments is an array.
    """
    types, given = passed(arguments)
    if is_apart:
        types.append("numba.types.CPointer(numba.f8)")
        given.append(next(text for text in given if text.endswith(".ctypes")))  # where nothing is returned
    external = f'"{symbol(name)}", {"numba.f8" if returns else "numba.void"}({", ".join(types)})'
    call = f"{'return ' if returns else ''}_{name}({', '.join(given)})"
    head = f"{DECORATOR}\ndef linked_{name}({', '.join(arguments)}):"
    return f"_{name} = numba.types.ExternalFunction({external})\n\n\n{head}\n    {call}"


def _without_aliases(text: str) -> str:
    """LLVM code in which the arrays that a function is given do not overlap; numba has no option for that.

    No kernel is given overlapping arrays. measured: parameters then stay in registers through a loop.
    """

    def mark(head: re.Match[str]) -> str:
        return re.sub(r"\bptr (?!noalias|@)(?=[^,]*%)", "ptr noalias ", head[0])

    return re.sub(r"^define (?!.*@NRT_)[^\n]*$", mark, text, flags=re.MULTILINE)


def _keep_inside(module: Any, entry: str) -> None:  # noqa: ANN401
    """Export no name but one: numba gives functions of different processes the same ones."""
    for value in (*module.functions, *module.global_variables):
        if not value.is_declaration and not value.name.startswith("llvm.") and value.name != entry:
            value.linkage = "internal"


def template_bitcode(module: Any) -> bytes:  # noqa: ANN401
    """LLVM bitcode of a template, in its simplest form; loops stay as they are.

    measured: a quarter of the size; optimising a model's kernels takes 0.7 to 0.9 of the time, with the same results.
    """
    _keep_inside(module, ENTRY)
    passes = llvm.create_new_module_pass_manager()
    for name in SIMPLIFYING:
        getattr(passes, f"add_{name}_pass")()
    passes.run(module, llvm.create_pass_builder(_machine(), llvm.create_pipeline_tuning_options()))
    return bytes(module.as_bitcode())


def optimise(module: Any, entry: str, machine: Callable[[], Any]) -> None:  # noqa: ANN401
    """Optimise LLVM code once more, now that it is one function, for a processor that `machine` describes anew."""
    _keep_inside(module, entry)
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    for _ in range(2):  # measured: what the first unrolls, the second unrolls further; a third changes nothing
        builder = llvm.create_pass_builder(machine(), options)
        builder.getModulePassManager().run(module, builder)


def _machine() -> Any:  # noqa: ANN401  (llvmlite has no types)
    """New description of this processor that machine code is made for; a linker takes it over."""
    _initialise()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=3,
        reloc="pic",
        codemodel="jitdefault",
    )


@cache
def _initialise() -> None:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()


@cache
def processor() -> str:
    """Short name of this processor, its features, and the versions of what compiles for it."""
    features = f"{llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"
    return hashlib.sha256(f"{features} {versions()}".encode()).hexdigest()[:8]


def system() -> str:
    """Kind of processor and system, as LLVM names them."""
    return str(llvm.get_process_triple())


def readable(path: Path) -> bytes | None:
    """LLVM bitcode of a file; None where there is none, or only a later LLVM reads it."""
    try:
        found = path.read_bytes()
        llvm.parse_bitcode(found)
    except (OSError, RuntimeError):
        return None
    return found


_libraries: dict[str, Any] = {}  # the machine code that this process has linked, which lives as long as these
_linking = threading.Lock()
_numbers = itertools.count()  # of bound functions, each of which is a library of its own


def symbol(name: str) -> str:
    """Symbol of a function that is linked to machine code."""
    return f"masking_link_{name}"


def _linked(content: str, code: bytes, addresses: Mapping[str, int]) -> int:
    """Link machine code into this process, once with the same functions; return the address of its entry."""
    name = " ".join([content, *(f"{address:x}" for _, address in sorted(addresses.items()))])
    with _linking:
        if name not in _libraries:
            builder = llvm.JITLibraryBuilder().add_object_img(code).add_current_process().export_symbol(ENTRY)
            # Numba's error handlers get an address also if numba is not loaded: generated code raises nothing.
            for one, address in {**dict.fromkeys(ERROR_SYMBOLS, _stop()), **addresses}.items():
                builder.import_symbol(one, address)
            _libraries[name] = builder.link(_linker(), name)
        return int(_libraries[name][ENTRY])


def _pointer(address: int) -> str:
    return f"ptr inttoptr (i64 {address} to ptr)"


@cache
def _stop() -> int:
    return int(ctypes.cast(ctypes.CDLL(None).abort, ctypes.c_void_p).value or 0)


@cache
def _linker() -> Any:  # noqa: ANN401
    return llvm.create_lljit_compiler(_machine())


ERROR_SYMBOLS = (
    *("numba_gil_ensure", "numba_gil_release", "numba_unpickle", "numba_do_raise"),
    *("numba_runtime_build_excinfo_struct", "NRT_Free", "NRT_MemInfo_call_dtor"),
)
