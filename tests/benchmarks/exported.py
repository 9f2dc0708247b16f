"""Every packaged experiment exported: `python -m tests.benchmarks.exported [NAME ...]`.

Commands of C, FMUs and a Cortex-M4F against those of the compiled kernel: of a law, for 500 random states; of a
sampled controller, for the readings of a run around the twin, which the Cortex-M4F drives itself. Then the closed loop
of C in double and in float, and the size, stack, instructions and computed cycles of a step in float on a Cortex-M4F.
What is not installed is left out and named.
"""

from __future__ import annotations

import ctypes
import math
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from masking.analysis.masking_error import masking_error
from masking.compile.codegen.c_expressions import ARRAY, REAL, Value
from masking.compile.codegen.c_functions import CFunctions
from masking.control.closed_loop import module as module_of
from masking.control.exports.c_unit import CUnit
from masking.control.exports.controller_units import law_unit, sampled_unit
from masking.control.exports.fmu_unit import write
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.simulated_run import loop_state, rig_state
from masking.model.declaration import catalogue
from tests.control.exports.test_controller_units import around_a_twin, by_kernel, by_unit
from tests.support import cortex_m4
from tests.support.compiled_unit import GCC, TYPES, CompiledUnit
from tests.support.cortex_m4_cycles import of_longest_step

COLUMNS = (
    *("experiment", "C", "Python", "FMI 2.0", "FMI 3.0", "Cortex-M4F", "chi, kernel", "chi, double", "chi, float"),
    *("code", "state", "stack", "instructions", "cycles, computed"),
)
HEAD = f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|"
STATES = 500
SAMPLES = 6000  # of a sampled controller, in the comparison of commands
FEW = 300  # of them, where each goes through an emulator
STEPS_PER_SECOND = 8000.0  # of the closed loop of a law in continuous time

# The closed loop of a law: the classical Runge-Kutta method, the law at each of its stages, or held between samples.
LOOP = """
#include <math.h>
#include <stdint.h>
#include "{name}.h"

{functions}

static {name}_state unit;

static int slope(double t, const double *y, const double *p, double *dy, double *u, int is_held)
{{
    {real} readings[{size}], commands[{inputs}];
    int status = 0;
    if (!is_held) {{
        for (int i = 0; i < {size}; i++) readings[i] = ({real})y[i];
        status = {name}_step(&unit, ({real})t, readings, commands);
        for (int i = 0; i < {inputs}; i++) u[i] = (double)commands[i];
    }}
    plant_derivative(t, y, u, p, dy);
    return status;
}}

int run(double h, long steps, long substeps, long every, double *y, const double *p, double *out)
{{
    double k[4][{size}], x[{size}], u[{inputs}];
    int status = 0;
    {name}_init(&unit);
    for (long n = 0; n <= steps * substeps && status == 0; n++) {{
        const double t = (double)n * h;
        if (n % (every * substeps) == 0)
            for (int i = 0; i < {size}; i++) out[n / (every * substeps) * {size} + i] = y[i];
        status |= slope(t, y, p, k[0], u, substeps > 1 && n % substeps != 0);
        for (int i = 0; i < {size}; i++) x[i] = y[i] + 0.5 * h * k[0][i];
        status |= slope(t + 0.5 * h, x, p, k[1], u, substeps > 1);
        for (int i = 0; i < {size}; i++) x[i] = y[i] + 0.5 * h * k[1][i];
        status |= slope(t + 0.5 * h, x, p, k[2], u, substeps > 1);
        for (int i = 0; i < {size}; i++) x[i] = y[i] + h * k[2][i];
        status |= slope(t + h, x, p, k[3], u, substeps > 1);
        for (int i = 0; i < {size}; i++) y[i] += h / 6.0 * (k[0][i] + 2.0 * (k[1][i] + k[2][i]) + k[3][i]);
    }}
    return status;
}}
"""


class Law:
    """A control law: its kernel, and random states."""

    def __init__(self, experiment: Experiment, name: str) -> None:
        loop = experiment.loop
        self.experiment, self.unit, self.loop = experiment, law_unit(loop, name, None), loop
        self.size = len(self.unit.ports["readings"])
        sizes = np.concatenate([loop.controller.lengths, loop.controller.lengths / experiment.time_scale])
        sizes = np.append(sizes, np.ones(self.size - len(sizes)))
        self.states = sizes * np.random.default_rng(0).uniform(-0.5, 0.5, (STATES, self.size))
        n, u, p = len(loop.plant.coordinates), np.empty(len(loop.plant.inputs)), loop.values()
        self.commands = np.empty((STATES, len(u)))
        for i, y in enumerate(self.states):
            loop.kernels.step(float(i), y[:n], y[n:], u, p)
            self.commands[i] = u

    def difference(self, answer: Callable[[float, np.ndarray], np.ndarray], count: int = STATES) -> float:
        """Return the largest difference of commands, in parts of the largest command."""
        found = np.array([answer(float(i), y) for i, y in enumerate(self.states[:count])])
        return float(np.max(np.abs(found - self.commands[:count])) / np.max(np.abs(self.commands[:count])))

    def exact(self, unit: Any) -> float:
        """Return the difference of a unit that is called with time and states."""
        unit.init()
        return self.difference(unit.step)

    def of_fmu(self, slave: Any) -> float:
        """Return the difference of an FMU."""
        slave.begin(self.states[0])

        def answer(t: float, y: np.ndarray) -> np.ndarray:
            slave.set(y)
            slave.step(t, 1.0)
            return slave.get()

        return self.difference(answer)

    def on_board(self, board: cortex_m4.CortexM4) -> float:
        """Return the difference of the law on a Cortex-M4F."""
        board.init(np.zeros(self.size + 1))
        return self.difference(lambda t, y: board.step([t, *y]), FEW)

    def orders(self, _: Path) -> list[bytes]:
        """Return what a board is sent, in float."""
        given = [[float(i), *y] for i, y in enumerate(self.states[:FEW])]
        return [cortex_m4.order(b"i", np.zeros(self.size + 1), "float")] + [
            cortex_m4.order(b"s", each, "float") for each in given
        ]

    def chi(self, folder: Path, real: str) -> float:
        """Return the worst masking error of the closed loop of the law in C with the rig in double."""
        made, loop, unit = self.experiment, self.loop, self.unit
        rate = made.declaration.controller.rate
        substeps = 1 if rate is None else 4
        step = 1.0 / (STEPS_PER_SECOND if rate is None else rate * substeps)
        steps = math.floor(made.declaration.duration * made.time_scale / (step * substeps) * (1 + 1e-12))
        every = max(1, steps // 20_000)
        functions = CFunctions(module_of(loop), "double")
        shapes = [(self.size,), (self.commands.shape[1],), loop.values().shape, (self.size,)]
        functions.add("plant_derivative", [Value(REAL), *(Value(ARRAY, shape=shape) for shape in shapes)])
        names = {"name": unit.name, "size": self.size, "inputs": self.commands.shape[1], "real": real}
        files = {"loop.c": LOOP.format(functions=functions.text(), **names)}
        files |= {f"{unit.name}.h": CUnit(unit, real).header(), f"{unit.name}.c": CUnit(unit, real).source()}
        for file, text in files.items():
            (folder / file).write_text(text)
        given = [folder / file for file in files if file.endswith(".c")]
        library = folder / f"loop_{real}.so"
        command = [GCC, "-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC", *given, "-o", library, "-lm"]
        subprocess.run(command, check=True)
        run = ctypes.CDLL(str(library)).run
        array = np.ctypeslib.ndpointer(dtype=np.float64)
        run.argtypes = [ctypes.c_double, *[ctypes.c_long] * 3, array, array, array]
        y = loop_state(loop, made.virtual_start, rig_state(loop, made.virtual_start))
        out = np.zeros((steps // every + 1, self.size))
        if run(step, steps, substeps, every, y, loop.values(), out):
            return math.nan
        times = np.arange(len(out)) * step * substeps * every
        k = len(made.virtual.coordinates)
        virtual, inputs = np.empty((len(times), 2 * k)), np.empty((len(times), self.commands.shape[1]))
        loop.kernels.along(times, out, loop.values(), virtual, inputs)
        ideal, _ = made.ideal.along(times, {}, (0.0, made.virtual_start))
        return max(masking_error(virtual[:, i], ideal[:, i]) for i in range(k))


class Sampled:
    """A sampled controller: its kernel around the twin."""

    def __init__(self, experiment: Experiment, name: str) -> None:
        self.experiment, self.unit = experiment, sampled_unit(experiment.sampled, name, 0.02)
        self.samples = experiment.sampled.before + SAMPLES

    def difference(self, unit: Any, samples: int = 0) -> float:
        """Return the largest difference of commands for the same readings, in parts of the largest command."""
        samples = samples or self.samples
        _, ours, (found,) = by_kernel(self.experiment, samples, others=[unit])
        return float(np.max(np.abs(found - ours)) / max(np.max(np.abs(ours)), 1e-300))

    exact = difference

    def of_fmu(self, slave: Any) -> float:
        """Return the difference of an FMU."""
        period, index = self.unit.period or 0.0, iter(range(self.samples + 1))

        class Unit:
            init = staticmethod(slave.begin)

            @staticmethod
            def step(readings: np.ndarray) -> np.ndarray:
                slave.set(readings)
                slave.step(next(index) * period, period)
                return slave.get()

        return self.difference(Unit)

    def on_board(self, board: cortex_m4.CortexM4) -> float:
        """Return the difference of commands where the board drives the twin, to a second after the release."""
        samples = self.experiment.sampled.before + 1000
        _, ours, _ = by_kernel(self.experiment, samples)
        _, found, _ = by_unit(self.experiment, board, samples)
        return float(np.max(np.abs(found - ours)) / np.max(np.abs(ours)))

    def orders(self, folder: Path) -> list[bytes]:
        """Return what a board is sent, in float, where the same C on this machine drives the twin."""
        unit, orders = CompiledUnit(folder, self.unit, "float"), list[bytes]()

        class Noting:
            @staticmethod
            def init(readings: np.ndarray) -> None:
                orders.append(cortex_m4.order(b"i", readings, "float"))
                unit.init(readings)

            @staticmethod
            def step(readings: np.ndarray) -> np.ndarray:
                orders.append(cortex_m4.order(b"s", readings, "float"))
                return np.array(unit.step(readings))

        by_unit(self.experiment, Noting, self.experiment.sampled.before + 1000)
        return orders

    def chi(self, folder: Path, real: str) -> float:
        """Return the worst masking error of the closed loop of the controller in C around the twin."""
        made, before = self.experiment, self.experiment.sampled.before
        count = math.floor(made.declaration.duration * made.time_scale * made.sampled.rate * (1 + 1e-12)) + 1
        unit, feed, sources = CompiledUnit(folder, self.unit, real), made.sampled.feed, made.declaration.inputs
        names = [*(n for n, one in sources.items() if one.sensor), *(n for n, one in sources.items() if one.push)]
        cells, p = [one.cell for one in (*feed.sensors, *feed.pushes)], unit.memory("p")
        felt = np.empty((len(cells), before + count))  # what a run alone knows

        def step(index: int, readings: np.ndarray) -> np.ndarray:
            commands = unit.step(readings)
            felt[:, index + before] = p[cells]
            return commands

        states, _, _ = around_a_twin(made, step, unit.init, before + count)
        times, live = np.arange(count) / made.sampled.rate, dict(zip(names, felt[:, before:], strict=True))
        virtual = made._virtual(times, states[before:])
        ideal, _ = made.ideal.along(times, live, (0.0, made.virtual_start))
        return max(masking_error(virtual[:, i], ideal[:, i]) for i in range(len(made.virtual.coordinates)))


def is_exported(name: str) -> bool:
    """Tell whether an experiment is in the table.

    A law that is given the states keeps no past and makes no jumps.
    """
    experiment = Experiment.load(name)
    virtual = experiment.virtual
    return experiment.has_observer or not (len(virtual.delays()) or virtual.declaration.events)


def row(name: str) -> str:
    """Return the line of an experiment."""
    experiment = Experiment.load(name)
    case = (Sampled if experiment.has_observer else Law)(experiment, name)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        cells = [f"{case.exact(CompiledUnit(folder, case.unit)):.1g}"]
        cells += _of_fmus(case, folder)
        has_board = cortex_m4.COMPILER and cortex_m4.EMULATOR
        cells.append(_difference_on_board(case, folder) if has_board else "")
        cells.append(f"{max(experiment.run().manifest['masking_error'].values()):.3g}")
        cells += [f"{case.chi(folder, real):.3g}" for real in TYPES]
        cells += figures_on_board(case, folder) if has_board else [""] * 5
    return f"| `{name}` | {' | '.join(cells)} |"


def _of_fmus(case: Law | Sampled, folder: Path) -> list[str]:
    """Return the differences of both FMUs, which must be valid."""
    try:
        from fmpy.validation import validate_fmu

        from tests.support.fmu_slave import Slave
    except ImportError:
        return ["", ""]
    paths = write(case.unit, folder)
    for path in paths:
        if problems := validate_fmu(str(path)):
            raise AssertionError(f"{path.name} is not valid: {'; '.join(problems)}")
    return [f"{case.of_fmu(Slave(path, folder / path.stem)):.1g}" for path in paths]


def _difference_on_board(case: Law | Sampled, folder: Path) -> str:
    with cortex_m4.CortexM4(folder, case.unit, "double") as board:
        return f"{case.on_board(board):.1g}"


def figures_on_board(case: Law | Sampled, folder: Path) -> list[str]:
    """Return code, state, stack, instructions and cycles of the longest step, with float."""
    orders = case.orders(folder)
    with cortex_m4.CortexM4(folder, case.unit, "float") as board:
        ticks = board.replay(orders)
        _, longest, stack, state = board.measured()
    low, high, _ = of_longest_step(folder, case.unit, "float", orders, ticks)
    return [str(board.flash), str(state), str(stack), str(longest), f"{low} to {high}"]


def rows(names: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield the lines of the table, as Markdown."""
    yield HEAD
    for name in names or filter(is_exported, catalogue.names("experiment")):
        yield row(name)


def main() -> None:
    """Print the table as it comes."""
    if GCC is None:
        sys.exit("there is no gcc")
    for line in rows(tuple(sys.argv[1:])):
        print(line, flush=True)
    for what, is_there in (("fmpy", _has_fmpy()), (cortex_m4.MISSING, cortex_m4.COMPILER and cortex_m4.EMULATOR)):
        if not is_there:
            print(f"left out: {what}", file=sys.stderr)


def _has_fmpy() -> bool:
    try:
        import fmpy  # noqa: F401
    except ImportError:
        return False
    return True


if __name__ == "__main__":
    main()
