"""Work of a sweep: its rows, made by this process, or by others on this machine.

A row depends on its number alone: neither on the rows beside it in a chunk nor on the process that makes it.
"""

from __future__ import annotations

import ast
import contextlib
import multiprocessing
import os
import pickle
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from multiprocessing.connection import wait as wait_for
from pathlib import Path
from types import ModuleType
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from masking import process_environment
from masking.compile.numerics.arrays import Array
from masking.errors import DeclarationError, MaskingError, Problem
from masking.lab.records.recording import Recording
from masking.lab.records.table_chunks import Columns
from masking.lab.runs import varied_experiment
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.sweep_values import Design
from masking.lab.runs.varied_experiment import Place
from masking.model.modelling import ensembles
from masking.reports import run_measures
from masking.reports.run_measures import Measurable, Measured

Rows: TypeAlias = NDArray[np.int64]  # numbers of rows
Measure: TypeAlias = str | Callable[[Recording], float]

RUN, ERROR, SEED, WAY = "run", "error", "seed", "way"  # columns beside those of parameters and measures
UP, DOWN = "up", "down"
_STATES: Final = 20_000_000  # numbers of the states that are in memory together
Made = tuple[int, int, Columns, float]  # first row, one more than the last, their columns, and the seconds that it took
Submit = Callable[[int, int], "Future[Made]"]
_SECONDS: Final = 2.0  # that a chunk takes, about
_MOST: Final = 2000  # rows of a chunk
_SCRIPT: Final = b"__main__"  # where a pickle has functions of the script that runs
_AHEAD: Final = 2  # chunks for each process


@dataclass(frozen=True)
class Plan:
    """All that makes the rows of a sweep what they are."""

    experiment: Experiment  # that varies
    design: Design  # the values of each run
    measures: tuple[Measure, ...]  # names, or functions of a recording that return a number
    virtual: bool = False  # whether the virtual system runs by itself, without a rig
    # whether the last axis of the grid is followed up and then down, each run from the end of the last
    continuation: bool = False
    trajectories: bool = False  # whether the virtual motion is kept

    def __reduce__(self) -> tuple[type[Plan], tuple[object, ...]]:
        """Pickled form: without compiled code, which each process has of its own."""
        others = (self.design, self.measures, self.virtual, self.continuation, self.trajectories)
        return Plan, (self.experiment, *others)

    @cached_property
    def places(self) -> tuple[tuple[Place, ...], ...]:
        """Where the values of each axis stand."""
        return tuple(
            tuple(varied_experiment.place(self.experiment, name) for name in axis.names) for axis in self.design.axes
        )

    @cached_property
    def chain(self) -> int:
        """How many rows in a row are made together: one, or those of an axis that is followed up and down."""
        values = self.design.grid[-1].values if self.continuation else None
        return 1 if values is None else 2 * len(values)

    @property
    def rows(self) -> int:
        """How many runs there are."""
        return len(self.design.points) * (2 if self.continuation else 1)

    @property
    def has_seeds(self) -> bool:
        """Whether each run has a seed of its own for the noise of its sensors."""
        is_given = any(where.path == (SEED,) for axis in self.places for where in axis)
        return self.experiment.has_observer and not self.virtual and self.design.runs > 1 and not is_given

    def seed(self, row: int) -> int:
        """Seed of a row."""
        return int(np.random.SeedSequence([self.design.seed, row]).generate_state(1)[0] >> 1)

    @cached_property
    def measurable(self) -> Measurable:
        """What runs have that can be measured."""
        virtual, known = self.experiment.virtual, self.experiment.instruments
        units = {name: one.unit for name, one in virtual.shown.items()}
        inputs = None if self.virtual else dict(zip(known.actuators, known.units[1], strict=True))
        is_scaled = virtual.is_dimensionless or virtual.units.is_plain
        return Measurable(virtual.oscillators, units, inputs, "units of time" if is_scaled else "s")

    def check(self) -> None:
        """Refuse what no run can be made of, and compile what runs need."""
        names = [one for one in self.measures if isinstance(one, str)]
        self.measurable.check(names)
        for axis in self.design.axes:
            for where in (varied_experiment.place(self.experiment, name) for name in axis.names):
                if self.virtual and where.path[0] not in {"parameters", "initial"}:
                    message = "is no parameter or initial state of the virtual system, which runs by itself"
                    raise DeclarationError(Problem(None, axis.label, message, "leave --virtual out"))
                varied_experiment.value(where, 1.0, is_factor=axis.is_factor)
        if self.continuation and not (self.virtual and self.design.grid and self.design.runs == 1):
            message = "follows a grid or a list with the virtual system by itself"
            raise DeclarationError(Problem(None, "continuation", message, "give --virtual, and no distributions"))
        if not self.virtual:
            self.experiment.validate()
        self.experiment.virtual.kernels.derivative.prepare()

    def rows_of(self, first: int, last: int) -> Columns:
        """Columns of the rows from `first` to before `last`."""
        numbers = np.arange(first, last, dtype=np.int64)
        made = self._virtual_rows(numbers) if self.virtual else [self._row(row) for row in numbers.tolist()]
        columns: dict[str, Any] = {RUN: numbers}
        points = self.design.points[self._points(numbers)]
        columns |= {axis.label: np.ascontiguousarray(points[:, i]) for i, axis in enumerate(self.design.axes)}
        if self.has_seeds:
            columns[SEED] = np.array([self.seed(row) for row in numbers.tolist()])
        if self.continuation:
            columns[WAY] = [DOWN if row % self.chain >= self.chain // 2 else UP for row in numbers.tolist()]
        for name in made[0]:
            values = [row[name] for row in made]
            columns[name] = np.array(values, dtype=float) if isinstance(values[0], float) else values
        return columns

    def _points(self, rows: Rows) -> Rows:
        """Point of the design of each row: a chain goes up, then down."""
        if not self.continuation:
            return rows
        at = rows % self.chain
        return rows // self.chain * (self.chain // 2) + np.minimum(at, self.chain - 1 - at)

    def _row(self, row: int) -> dict[str, Measured]:
        point = self.design.points[self._points(np.array([row], dtype=np.int64))[0]]
        settings = [
            (where, float(x), axis.is_factor)
            for axis, places, x in zip(self.design.axes, self.places, point, strict=True)
            for where in places
        ]
        settings += [(Place((SEED,), None), float(self.seed(row)), False)] if self.has_seeds else []
        return self._measured(lambda: varied_experiment.varied(self.experiment, settings).run())

    def _measured(self, run: Callable[[], Recording]) -> dict[str, Measured]:
        """Measures of a run, and why it has none."""
        try:
            recording = run()
            found = run_measures.measure(recording, [one for one in self.measures if isinstance(one, str)])
            own = {one.__name__: float(one(recording)) for one in self.measures if not isinstance(one, str)}
            names = ["t", *(f"virtual.{n}" for n in recording.coordinates)] if self.trajectories else []
            kept = {name: recording[name] for name in names}
        except MaskingError as error:
            return self._failed(str(error))
        except Exception as error:  # of a function of one's own: a run that fails must not end the others
            return self._failed(f"{type(error).__name__}: {error}")
        ordered = {_name(one): {**found, **own}[_name(one)] for one in self.measures}
        return {**ordered, **kept, ERROR: ""}

    def _failed(self, why: str) -> dict[str, Measured]:
        found = {_name(one): run_measures.empty(one) if isinstance(one, str) else np.nan for one in self.measures}
        kept = dict.fromkeys(["t", *(f"virtual.{n}" for n in self.experiment.virtual.coordinates)], np.empty(0))
        return {**found, **(kept if self.trajectories else {}), ERROR: why}

    @cached_property
    def _times(self) -> Array:
        return np.linspace(0.0, self.experiment.declaration.duration, self.experiment.samples)

    def _virtual_rows(self, numbers: Rows) -> list[dict[str, Measured]]:
        """Run the virtual system by itself for some rows: all of a chain one after the other, or all together."""
        if self.continuation:
            chains = [numbers[i : i + self.chain] for i in range(0, len(numbers), self.chain)]
            return [one for chain in chains for one in self._chain(chain)]
        size = max(1, _STATES // (len(self._times) * len(self.experiment.virtual.state_names)))
        parts = [numbers[i : i + size] for i in range(0, len(numbers), size)]
        return [one for part in parts for one in self._together(part)]

    def _together(self, rows: Rows) -> list[dict[str, Measured]]:
        """Run the virtual system for some rows by one call, without those whose parameters are out of their bounds."""
        model, columns = self.experiment.virtual, self._values(rows)
        if refused := dict(ensembles.refused(model, columns)):
            others = iter(self._virtual_rows(np.delete(rows, [*refused])))
            return [self._failed(str(refused[i])) if i in refused else next(others) for i in range(len(rows))]
        runs = ensembles.simulate(
            model, self._times, columns, initial=self._initial, inputs=None, threads=1,
            tolerance=self.experiment.declaration.tolerance,
        )  # fmt: skip
        together, found = self._measured_together(runs.states), list[dict[str, Measured]]()
        for i in range(len(rows)):
            if i in runs.errors:
                found.append(self._failed(runs.errors[i]))
            elif together is None:
                found.append(self._measured(partial(self._recorded, runs.states[i])))
            else:
                found.append({**{name: values[i] for name, values in together.items()}, ERROR: ""})
        return found

    def _measured_together(self, states: Array) -> dict[str, list[str]] | None:
        """Measures of all runs (runs, m, .) by name, if they can be taken together."""
        names = [one for one in self.measures if isinstance(one, str)]
        if self.trajectories or len(names) < len(self.measures):
            return None
        model = self.experiment.virtual
        if len({model.shown[name] for name in model.oscillators}) > 1:  # which have no common size
            return None
        places = [model.state_names.index(name) for name in model.oscillators]
        return run_measures.measure_each([states[:, :, i] for i in places], names)

    @property
    def _initial(self) -> Mapping[str, float]:
        names = self.experiment.virtual.state_names
        return {name: x for name, x in self.experiment.declaration.initial.items() if name in names}

    def _values(self, rows: Rows) -> dict[str, Array]:
        """Values of rows by parameter and state, each (rows,); those of one state if nothing varies."""
        if not self.design.axes:
            name = self.experiment.virtual.state_names[0]
            return {name: np.full(len(rows), varied_experiment.place(self.experiment, name).declared, dtype=float)}
        points = self.design.points[self._points(rows)]
        return {
            where.path[-1]: np.array(
                [float(varied_experiment.value(where, x, is_factor=axis.is_factor)) for x in column]
            )
            for axis, places, column in zip(self.design.axes, self.places, points.T, strict=True)
            for where in places
        }

    def _chain(self, rows: Rows) -> list[dict[str, Measured]]:
        """Run the virtual system from the end of the run before, whose time goes on."""
        found, model, state = list[dict[str, Measured]](), self.experiment.virtual, np.empty(0)
        u, tolerance = np.zeros(len(model.inputs)), self.experiment.declaration.tolerance
        columns = self._values(rows)
        for i in range(len(rows)):
            values = {name: float(x[i]) for name, x in columns.items()}
            times = self._times + i * self._times[-1]
            try:
                changed = model.with_parameters(**{n: x for n, x in values.items() if n in model.parameters})
                start = {n: x for n, x in values.items() if n not in model.parameters}
                begin = state if state.size else changed.initial_state({**self._initial, **start})
                run = changed.kernels.integrate(times, begin, u, changed.values(), tolerance=tolerance)
            except MaskingError as error:
                found.append(self._failed(str(error)))
                continue
            state = run.states[-1, : len(begin)].copy()
            found.append(self._measured(partial(self._recorded, run.states)))
        return found

    def _recorded(self, states: Array) -> Recording:
        """Motion of the virtual system (m, .) as a recording."""
        virtual, scale = self.experiment.virtual, self.experiment.time_scale
        columns, units = {"t": self._times * scale}, {"t": {"unit": "s"}}
        for series, (name, (unit, size)) in zip(states.T, virtual.shown.items(), strict=False):
            columns[f"virtual.{name}"], units[f"virtual.{name}"] = series / size, {"unit": unit}
        return Recording(columns, {"oscillators": [*virtual.oscillators], "time_scale": scale, "columns": units})


def _name(one: Measure) -> str:
    return one if isinstance(one, str) else one.__name__


_plans: list[Plan] = []  # of this process, which keeps what a plan has compiled


def made(plan: Plan, first: int, last: int) -> Made:
    """Make some rows."""
    begun = time.perf_counter()
    with threadpool_limits(1):
        columns = plan.rows_of(first, last)
    return first, last, columns, time.perf_counter() - begun


def _begin(path: Path) -> None:
    """Begin a process that makes rows of the plan in a file, and that ends with the one that started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the one that started it says when to end
    parent = multiprocessing.parent_process()

    def end() -> None:
        if parent is not None:
            wait_for([parent.sentinel])
            os._exit(1)

    threading.Thread(target=end, daemon=True).start()
    _plans[:] = [pickle.loads(path.read_bytes())]  # noqa: S301  (its parent wrote it)


def _made_here(first: int, last: int) -> Made:
    return made(_plans[0], first, last)


def work(plan: Plan, missing: Sequence[tuple[int, int]], *, workers: int) -> Iterator[Made]:
    """Make ranges of rows, each of whole chains, as chunks that take a second or two each.

    With one worker, this process makes them. Raises a `MaskingError` where another has ended.
    """
    if workers > 1:
        with _processes(plan, workers) as submit:
            yield from _chunks(plan, missing, submit, _AHEAD * workers)
        return

    def at_once(first: int, last: int) -> Future[Made]:
        future = Future[Made]()
        future.set_result(made(plan, first, last))
        return future

    yield from _chunks(plan, missing, at_once, 1)


def _chunks(plan: Plan, missing: Sequence[tuple[int, int]], submit: Submit, ahead: int) -> Iterator[Made]:
    """Chunks as they are made, each with as many rows as the last ones say that two seconds take."""
    rows, pending, left = plan.chain, set[Future[Made]](), [*missing]
    try:
        while left or pending:
            while left and len(pending) < ahead:
                first, last = left.pop(0)
                end = min(last, first + rows)
                if end < last:
                    left.insert(0, (end, last))
                pending.add(submit(first, end))
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                one = future.result()
                wanted = min(_MOST, int(_SECONDS / max(one[3] / (one[1] - one[0]), 1e-9)), 4 * rows)
                rows = max(1, wanted // plan.chain) * plan.chain
                yield one
    except BrokenProcessPool:
        raise MaskingError(
            "a process of the sweep has ended, perhaps for want of memory. Finished runs are kept: start the same "
            "again, with fewer --workers"
        ) from None


@contextmanager
def _processes(plan: Plan, workers: int) -> Iterator[Submit]:
    context, content = multiprocessing.get_context("spawn"), _pickled(plan)
    with tempfile.TemporaryDirectory(prefix="masking-") as folder:  # measured: through a pipe, each waits for the last
        path = Path(folder) / "plan"
        path.write_bytes(content)
        with process_environment.safe_start():  # of the process that looks after its locks
            pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(path,))

        def submit(first: int, last: int) -> Future[Made]:
            # of the process that this may start
            with _interrupts_later(), process_environment.safe_start(), _script(is_imported=_SCRIPT in content):
                return pool.submit(_made_here, first, last)

        try:
            yield submit
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _pickled(plan: Plan) -> bytes:
    """Plan for other processes; a `MaskingError` where these could not import its functions."""
    remedy = "write it into a module of its own and import it, or make the runs in this process, with workers=1"
    try:
        content = pickle.dumps(plan)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise MaskingError(f"other processes cannot import a function of this sweep ({error}); {remedy}") from None
    script = sys.modules["__main__"]
    file = str(getattr(script, "__file__", ""))
    if _SCRIPT in content and not Path(file).is_file():
        raise MaskingError(f"other processes cannot import a function of a notebook or a prompt; {remedy}")
    if _SCRIPT in content and _calls_when_imported(script, file):
        raise MaskingError(
            f"{file} begins a sweep when it is imported, as other processes do for its function; call masking.sweep "
            f"under 'if __name__ == \"__main__\":', or, of the function: {remedy}"
        )
    return content


def _calls_when_imported(script: ModuleType, file: str) -> bool:
    """Whether a statement of a script that runs now stands outside of `if __name__ == "__main__":`."""
    frames = (frame for frame, _ in traceback.walk_stack(None) if frame.f_globals is vars(script))
    lines = [frame.f_lineno for frame in frames if frame.f_code.co_name == "<module>"]
    with contextlib.suppress(OSError, SyntaxError, ValueError):  # its text is not to be had
        conditions = [one for one in ast.parse(Path(file).read_bytes()).body if isinstance(one, ast.If)]
        guards = [one for one in conditions if "__name__" in ast.unparse(one.test)]
        return any(not any(one.lineno <= line <= (one.end_lineno or 0) for one in guards) for line in lines)
    return False


@contextmanager
def _script(*, is_imported: bool) -> Iterator[None]:
    """Let processes that are started here import the script that runs, or nothing in place of it."""
    script = sys.modules["__main__"]
    # Of an empty one multiprocessing finds no file.
    sys.modules["__main__"] = script if is_imported else ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


@contextmanager
def _interrupts_later() -> Iterator[None]:
    """Hold interrupts back while inside; processes that are started here never get any, not even while they load."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
