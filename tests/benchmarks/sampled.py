"""The sampled loop: the compiled kernel beside the same operations in C, printed from the same graph."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.printers import C, needed, statements
from masking.control.closed_loop import ClosedLoop
from masking.control.law import ControlLaw, ControllerParameters, RigSymbols
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.simulated_run import rig_state
from masking.model.modelling.lowering import LoweredEquations
from tests.benchmarks.table import Row, few, interleaved, limited, missing

RATE = 1000.0
# measured: after 90 s the loop of this experiment diverges, since a held input acts half a sample late.
SAMPLES = 10_000
EVERY = 10
ROUNDS = 300
LARGEST_DIFFERENCE = 1e-12
WHAT = "sampled loop: masking / C"
FLAGS = {
    "-O3": ["-O3"],
    "-O3 -march=native -ffp-contract=fast": ["-O3", "-march=native", "-ffp-contract=fast"],
}

# The loop of `masking.compile.numerics.runge_kutta.sampled` with `runge_kutta_4`, line by line.
LOOP = """
#include <math.h>

#define SIZE {size}
#define HALF {half}

{functions}

static void advance(double t, double *y, const double *u, const double *p, double h, double k[4][SIZE], double *state)
{{
    plant_derivative(t, y, u, p, k[0]);
    for (int i = 0; i < SIZE; i++) state[i] = y[i] + 0.5 * h * k[0][i];
    plant_derivative(t + 0.5 * h, state, u, p, k[1]);
    for (int i = 0; i < SIZE; i++) state[i] = y[i] + 0.5 * h * k[1][i];
    plant_derivative(t + 0.5 * h, state, u, p, k[2]);
    for (int i = 0; i < SIZE; i++) state[i] = y[i] + h * k[2][i];
    plant_derivative(t + h, state, u, p, k[3]);
    for (int i = 0; i < SIZE; i++) y[i] += h / 6.0 * (k[0][i] + 2.0 * (k[1][i] + k[2][i]) + k[3][i]);
}}

long run_sampled(long begin, long count, double dt, long substeps, long every, double *y, double *u, long inputs,
                 const double *p, double first, double *out_y, double *out_u)
{{
    double k[4][SIZE], state[SIZE];
    double h = dt / substeps;
    long row = 0;
    for (long index = begin; index < begin + count; index++) {{
        double t = index * dt;
        double health = step(t, y, y + HALF, u, p);
        if (first == 0.0) first = health;
        if (!(health * first > 1e-9 * first * first)) return 2;
        for (long i = 0; i < inputs; i++) if (!isfinite(u[i])) return 3;
        if (index % every == 0) {{
            for (int i = 0; i < SIZE; i++) out_y[row * SIZE + i] = y[i];
            for (long i = 0; i < inputs; i++) out_u[row * inputs + i] = u[i];
            row++;
        }}
        for (long i = 0; i < substeps; i++) advance(t + i * h, y, u, p, h, k, state);
    }}
    return 0;
}}
"""


def rows() -> Iterator[Row]:
    """Measure the Duffing experiment on the ideal rig at 1 kHz, one Runge-Kutta step of order 4 per sample."""
    gcc = shutil.which("gcc")
    if gcc is None:
        yield missing(WHAT, "there is no gcc")
        return
    experiment = Experiment.load("duffing")
    loop = experiment.loop
    start = rig_state(loop, experiment.virtual.initial_state(experiment.declaration.initial))
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "loop.c"
        source.write_text(c_source(loop), encoding="utf-8")
        runs = {"masking": Ours(loop, start)} | {
            name: Theirs(compiled(gcc, flags, source, i), loop, start) for i, (name, flags) in enumerate(FLAGS.items())
        }
        seconds = interleaved(runs, few(ROUNDS))
        nanoseconds = {name: min(s) / SAMPLES * 1e9 for name, s in seconds.items()}
        for name in FLAGS:
            ours, theirs = runs["masking"].out_y, runs[name].out_y
            difference = float(np.max(np.abs(ours - theirs)) / np.max(np.abs(ours)))
            row = limited(
                f"{WHAT} {name}",
                f"{nanoseconds['masking']:.4g} ns",
                f"{nanoseconds[name]:.4g} ns",
                nanoseconds["masking"] / nanoseconds[name],
                at_most=1.1,
                note=f"per sample, shortest of {ROUNDS} runs of {SAMPLES} samples; states differ by {difference:.1e}",
            )
            yield row if difference <= LARGEST_DIFFERENCE else missing(row.what, f"states differ by {difference:.1e}")


class Ours:
    """The compiled kernel."""

    def __init__(self, loop: ClosedLoop, start: np.ndarray) -> None:
        self.loop, self.start, self.p = loop, start, loop.values()
        count = -(-SAMPLES // EVERY)
        self.out_y, self.out_u = np.zeros((count, len(start))), np.zeros((count, len(loop.plant.inputs)))

    def __call__(self) -> None:
        y, u = self.start.copy(), np.zeros(self.out_u.shape[1])
        status, *_ = self.loop.kernels.run_sampled(
            0, SAMPLES, 1.0 / RATE, 1, EVERY, y, u, self.p, 0.0, self.out_y, self.out_u
        )
        assert status == 0


class Theirs(Ours):
    """The same in C."""

    def __init__(self, library: ctypes.CDLL, loop: ClosedLoop, start: np.ndarray) -> None:
        super().__init__(loop, start)
        self.run = library.run_sampled
        whole, real, array = ctypes.c_long, ctypes.c_double, np.ctypeslib.ndpointer(dtype=np.float64)
        self.run.argtypes = [whole, whole, real, whole, whole, array, array, whole, array, real, array, array]
        self.run.restype = whole

    def __call__(self) -> None:
        y, u = self.start.copy(), np.zeros(self.out_u.shape[1])
        status = self.run(0, SAMPLES, 1.0 / RATE, 1, EVERY, y, u, len(u), self.p, 0.0, self.out_y, self.out_u)
        assert status == 0


def compiled(gcc: str, flags: Sequence[str], source: Path, number: int) -> ctypes.CDLL:
    """Compile a C source and load it."""
    library = source.with_name(f"loop{number}.so")
    subprocess.run([gcc, *flags, "-shared", "-fPIC", str(source), "-o", str(library), "-lm"], check=True)
    return ctypes.CDLL(str(library))


def c_source(loop: ClosedLoop) -> str:
    """Print controller, plant and loop in C."""
    n = len(loop.plant.coordinates)
    graph = Graph()
    s = loop.plant.equations.symbols
    rig = RigSymbols(
        graph.symbol("t", varying=True),
        [graph.symbol(f"q_{c}", varying=True) for c in loop.plant.coordinates],
        [graph.symbol(f"v_{c}", varying=True) for c in loop.plant.coordinates],
    )
    law = ControlLaw.of(loop.controller, graph, rig)
    known = dict(zip((s.t, *s.q, *s.v), (rig.t, *rig.q, *rig.v), strict=True))
    plant = LoweredEquations.of(loop.plant.equations, graph, known=known)
    p = ControllerParameters.of(loop.controller, graph)
    split = {**p.loads(graph), **plant.loads("q[{i}]", "v[{i}]", offset=p.count)}
    joined = split | {f"q_{c}": f"y[{i}]" for i, c in enumerate(loop.plant.coordinates)}
    joined |= {f"v_{c}": f"y[{n + i}]" for i, c in enumerate(loop.plant.coordinates)}
    functions = [
        function(
            "step(double t, const double *q, const double *v, double *u, const double *p)",
            graph,
            [(f"u[{i}]", x) for i, x in enumerate(law.inputs)],
            split,
            law.health,
        ),
        function(
            "plant_derivative(double t, const double *y, const double *u, const double *p, double *dy)",
            graph,
            [(f"dy[{i}]", x) for i, x in enumerate([*rig.v, *plant.accelerations])],
            joined,
            plant.health,
        ),
    ]
    return LOOP.format(size=2 * n, half=n, functions="\n\n".join(functions))


def function(signature: str, graph: Graph, results: list[tuple[str, Node]], loads: dict[str, str], health: Node) -> str:
    """Print one function, which returns its health."""
    pairs = [*results, ("const double health", health)]
    used = {
        str(graph.operations[i][1]) for i in needed(graph, [i for _, i in pairs]) if graph.operations[i][0] == "symbol"
    }
    reads = [f"const double {name} = {text};" for name, text in loads.items() if name in used and name != text]
    lines = [*reads, *statements(graph, pairs, C), "return health;"]
    return "\n".join([f"static inline double {signature}", "{", *(f"    {line}" for line in lines), "}"])
