"""The columns of variational equations over one step of the Runge-Kutta method, as LLVM code made for a size.

The motion of the step is known, so that rates of the columns S are linear in these at each of the four stages: with
A = df/dy and B what the parameters do, K = A Y + B, where Y is S at the first stage and S + c h K of the stage before
at the others. Some columns at a time, a vector each of S, Y and K, go through all stages in registers.
Source: as `masking.compile.numerics.motion_sensitivities`.
"""

from __future__ import annotations

from collections.abc import Sequence

from masking.compile.codegen import machine_code, module_store
from masking.compile.codegen.argument_conditions import Needed
from masking.compile.codegen.content_hashes import digest
from masking.compile.codegen.llvm_text import ALIGNED, FUSED, defined, number, parameters
from masking.compile.codegen.machine_code import NativeFunction
from masking.compile.numerics.rig_sizes import LANES

NAME = "carry"
TYPES = {"by_state": "Matrix", "rates": "Matrix", "columns": "Matrix", "h": "float"}
SIGNATURE = f"{NAME}({', '.join(f'{name}: {kind}' for name, kind in TYPES.items())})"
CONDITIONS = (
    f"columns.shape[1] % {LANES} == 0",
    "len(by_state) >= 4 * len(columns) and by_state.shape[1] >= len(columns)",
    "len(rates) >= 4 * len(columns) and rates.shape[1] >= columns.shape[1]",
)
VECTOR = f"<{LANES} x double>"
LARGEST = 16  # states up to which all loops over them are unrolled: the code grows with their square
UNROLLED = '!0 = distinct !{!0, !1}\n!1 = !{!"llvm.loop.unroll.full"}'


def link(states: int, coordinates: int, more: int = 0) -> dict[str, NativeFunction]:
    """Function by its signature, as `compiled_functions.linked` takes it.

    It moves `columns` (n, width) over a step of length h, with the derivatives of its stages by the state (4 n, n or
    more), those of coordinates left out, and by the columns (4 n, width), `rates`. For n `states`, of which the first
    `coordinates` have rates that are the states behind them, and for `more`, there is code of their own size unless
    that is too large; others run in loops.
    """
    made = _text([n for n in range(states, states + more + 1) if n <= LARGEST], coordinates)
    stem = module_store.directory() / "objects" / digest(made)
    needed = Needed({"columns": [2 * coordinates]}, CONDITIONS)
    return {SIGNATURE: NativeFunction(NAME, TYPES, [], None, lambda: machine_code.parsed(made), stem, needed)}


def _text(states: Sequence[int], coordinates: int) -> str:
    """Code of the function behind its C interface."""
    head, passed = ", ".join(parameters(TYPES)), ", ".join(parameters(TYPES)).replace(" noalias", "")
    cases = {f"of.{n}": (f"carry.{n}", str(n)) for n in states} | {"any": ("carry.any", "%columns.0")}
    body = [f"switch i64 %columns.0, label %any [{' '.join(f'i64 {n}, label %of.{n}' for n in states)}]"]
    for label, (name, _) in cases.items():
        body += [f"{label}:", f"call void @{name}({passed})", "ret void"]
    functions = [_function(name, n, coordinates, is_unrolled=label != "any") for label, (name, n) in cases.items()]
    entry = defined(f"void @{machine_code.ENTRY}({head}, ptr %.found)", body)
    return "\n".join([*functions, entry, UNROLLED])


def _function(name: str, n: str, coordinates: int, *, is_unrolled: bool) -> str:
    """Definition of the function for n states, which is a number, or what the function is given."""
    code = _Code(is_unrolled)
    add, get = code.add, code.get
    between, rate, total = (get(f"alloca {VECTOR}, i64 {n}") for _ in range(3))
    half, sixth, third = (get(f"fmul double %h, {number(part)}") for part in (0.5, 1 / 6, 1 / 3))
    columns = code.begin("0", "%columns.1", LANES)
    i = code.begin("0", n)  # Y = S
    own = code.load(code.element("columns", i, columns))
    add(f"store {VECTOR} {own}, ptr {code.vector(between, i)}", f"store {VECTOR} {own}, ptr {code.vector(total, i)}")
    code.end()
    stage = code.begin("0", "4")
    first = get(f"mul i64 {stage}, {n}")
    i = code.begin("0", str(coordinates))  # K = A Y + B: of coordinates, what their rates are
    moved = code.load(code.vector(between, get(f"add i64 {i}, {coordinates}")))
    add(f"store {VECTOR} {moved}, ptr {code.vector(rate, i)}")
    code.end()
    i = code.begin(str(coordinates), n)  # of the others
    row = get(f"add i64 {first}, {i}")
    add(f"store {VECTOR} {code.load(code.element('rates', row, columns))}, ptr {code.vector(rate, i)}")
    k = code.begin("0", n)
    by = code.repeated(get(f"load double, ptr {code.element('by_state', row, k)}, align {ALIGNED}"))
    code.add_product(code.vector(rate, i), by, code.load(code.vector(between, k)))
    code.end()
    code.end()
    is_outer = get(f"or i1 {get(f'icmp eq i64 {stage}, 0')}, {get(f'icmp eq i64 {stage}, 3')}")
    weight = code.repeated(get(f"select i1 {is_outer}, double {sixth}, double {third}"))
    length = code.repeated(get(f"select i1 {get(f'icmp eq i64 {stage}, 2')}, double %h, double {half}"))
    i = code.begin("0", n)  # Y = S + c h K of the next stage
    found = code.load(code.vector(rate, i))
    code.add_product(code.vector(total, i), weight, found)
    own = code.load(code.element("columns", i, columns))
    add(f"store {VECTOR} {own}, ptr {code.vector(between, i)}")
    code.add_product(code.vector(between, i), length, found)
    code.end()
    code.end()
    i = code.begin("0", n)
    moved = code.load(code.vector(total, i))
    add(f"store {VECTOR} {moved}, ptr {code.element('columns', i, columns)}, align {ALIGNED}")
    code.end()
    code.end()
    return defined(f"internal void @{name}({', '.join(parameters(TYPES))})", ["entry:", *code.lines, "ret void"])


class _Code:
    """Lines of a function, with the loops that are open."""

    def __init__(self, is_unrolled: bool) -> None:
        self.lines: list[str] = []
        self._end = ", !llvm.loop !0" if is_unrolled else ""
        self._count, self._open, self._block = 0, list[tuple[str, int]](), "entry"

    def add(self, *lines: str) -> None:
        self.lines += lines

    def get(self, line: str) -> str:
        """Add a line, and return the name of what it computes."""
        self._count += 1
        self.lines.append(f"%.{self._count} = {line}")
        return f"%.{self._count}"

    def begin(self, first: str, last: str, step: int = 1) -> str:
        """Begin a loop, and return its index, which is less than `last`."""
        self._count += 1
        label = f"loop.{self._count}"
        self.add(f"br label %{label}", f"{label}:")
        self.add(f"%.{label} = phi i64 [ {first}, %{self._block} ], [ %.{label}.next, %{label}.end ]")
        self.add(f"%.{label}.is = icmp slt i64 %.{label}, {last}")
        self.add(f"br i1 %.{label}.is, label %{label}.in, label %{label}.out", f"{label}.in:")
        self._open.append((label, step))
        self._block = f"{label}.in"
        return f"%.{label}"

    def end(self) -> None:
        """End the innermost loop; the one over columns alone is not unrolled."""
        label, step = self._open.pop()
        self.add(f"br label %{label}.end", f"{label}.end:", f"%.{label}.next = add i64 %.{label}, {step}")
        self.add(f"br label %{label}{self._end if step == 1 else ''}", f"{label}.out:")
        self._block = f"{label}.out"

    def element(self, table: str, row: str, column: str) -> str:
        """Address of an element of a table."""
        at = self.get(f"add i64 {self.get(f'mul i64 {row}, %{table}.1')}, {column}")
        return self.get(f"getelementptr double, ptr %{table}, i64 {at}")

    def vector(self, vectors: str, i: str) -> str:
        """Address of one of several vectors."""
        return self.get(f"getelementptr {VECTOR}, ptr {vectors}, i64 {i}")

    def load(self, address: str) -> str:
        return self.get(f"load {VECTOR}, ptr {address}, align {ALIGNED}")

    def repeated(self, value: str) -> str:
        """Vector of one number."""
        one = self.get(f"insertelement {VECTOR} undef, double {value}, i32 0")
        return self.get(f"shufflevector {VECTOR} {one}, {VECTOR} undef, <{LANES} x i32> zeroinitializer")

    def add_product(self, target: str, by: str, vector: str) -> None:
        """Add a product to the vector at an address."""
        product = self.get(f"fmul {FUSED} {VECTOR} {by}, {vector}")
        total = self.get(f"fadd {FUSED} {VECTOR} {self.load(target)}, {product}")
        self.add(f"store {VECTOR} {total}, ptr {target}, align {ALIGNED}")
