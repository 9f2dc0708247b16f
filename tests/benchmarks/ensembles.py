"""Runs of Huygens' clocks, each with its own damping and angle, beside heyoka's batch: largest error over all runs."""

from __future__ import annotations

import importlib
import os
import resource
import statistics
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from masking.model.modelling import ensembles
from tests.benchmarks.systems import SYSTEMS, Array, huygens_symbolic
from tests.benchmarks.table import Row, few, interleaved, judged, limited, missing, ratio
from tests.benchmarks.trajectory import SCAN

RUNS, CALLS, ROUNDS = 2000, 500, 15  # CALLS times RUNS are 10^6
AIMS = {1e-6: 3.0, 1e-9: 1.5}  # by the error
TIMES = np.linspace(0.0, 100.0, 2)
BATCHES = (4, 8)
EXACT = 1e-13

Solve = Callable[[float], Array]  # the last states (runs, 2 n), at a tolerance


def rows() -> Iterator[Row]:
    """Measure runs beside heyoka, on one core and on all, and a million of them."""
    exact = _masking(threads=None)(EXACT)
    for error in AIMS:
        yield _against_heyoka(error, exact)
    ours = _tolerance(_masking(threads=1), 1e-6, exact)
    yield _on_all_cores(ours)
    yield _a_million(ours)


def _values() -> dict[str, Array]:
    return {"z": np.linspace(0.1, 0.3, RUNS), "th1": np.linspace(-0.8, 0.8, RUNS)}


def _masking(threads: int | None) -> Solve:
    model, values = SYSTEMS["huygens"].model, _values()

    def run(tolerance: float) -> Array:
        found = ensembles.simulate(model, TIMES, values, initial={}, inputs=None, tolerance=tolerance, threads=threads)
        return found.states[:, -1]

    return run


def _heyoka(heyoka: Any, size: int) -> Solve:
    system, values = SYSTEMS["huygens"], _values()
    equations = huygens_symbolic({**system.model.parameter_values(), "z": heyoka.par[0]})
    starts = system.model.initial_state({"th1": values["th1"]}).T
    built: dict[float, Any] = {}

    def run(tolerance: float) -> Array:
        if tolerance not in built:
            built[tolerance] = heyoka.taylor_adaptive_batch(
                equations, starts[:, :size].copy(), tol=tolerance, fast_math=True, compact_mode=False,
                pars=np.zeros((1, size)),
            )  # fmt: skip
        integrator, found = built[tolerance], np.empty((RUNS, len(starts)))
        for first in range(0, RUNS, size):
            part = slice(first, first + size)
            integrator.set_time(0.0)
            integrator.state[:] = starts[:, part]
            integrator.pars[:] = values["z"][part]
            integrator.propagate_until(float(TIMES[-1]))
            found[part] = integrator.state.T
        return found

    return run


def _tolerance(solve: Solve, error: float, exact: Array) -> float:
    """Return the loosest tolerance that meets the wanted error in each run and state."""
    size = np.abs(exact).max()
    return next(one for one in SCAN if np.abs(solve(one) - exact).max() <= error * size)


def _against_heyoka(error: float, exact: Array) -> Row:
    what = f"huygens, {RUNS} runs, one core, error {error:g}: heyoka's batch / masking"
    try:
        heyoka = importlib.import_module("heyoka")
    except ImportError as why:
        return missing(what, str(why))
    batches = {str(size): _heyoka(heyoka, size) for size in BATCHES}
    ours = _tolerance(_masking(threads=1), error, exact)
    theirs = {size: _tolerance(solve, error, exact) for size, solve in batches.items()}
    contenders = {size: partial(solve, theirs[size]) for size, solve in batches.items()}
    seconds = interleaved({"ours": partial(_masking(threads=1), ours), **contenders}, few(ROUNDS))
    best = min(batches, key=lambda size: min(seconds[size]))
    note = f"tolerance {ours:.2g}; heyoka's batch of {best} at {theirs[best]:.2g}"
    return judged(
        what,
        _each(seconds["ours"]),
        _each(seconds[best]),
        ratio(seconds, best, "ours"),
        at_least=AIMS[error],
        note=note,
    )


def _on_all_cores(tolerance: float) -> Row:
    what, cores = f"huygens, {RUNS} runs: one core / all", os.cpu_count() or 1
    if cores < 2:
        return missing(what, "there is one core")
    contenders = {"one": _masking(threads=1), "all": _masking(threads=None)}
    seconds = interleaved(
        {name: partial(solve, tolerance) for name, solve in contenders.items()}, few(ROUNDS), time.perf_counter
    )
    note = f"{cores} cores, as the system counts them"
    return judged(
        what, _each(seconds["all"]), _each(seconds["one"]), ratio(seconds, "one", "all"), at_least=1.8, note=note
    )


def _a_million(tolerance: float) -> Row:
    solve = partial(_masking(threads=1), tolerance)
    begin = interleaved({"some": solve}, few(ROUNDS))["some"]
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    every = interleaved({"many": solve}, few(CALLS))["many"]
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    value = statistics.fmean(every) / statistics.median(begin)
    what = f"huygens: a run of {RUNS * CALLS:g} / of {RUNS}"
    note = f"{RUNS * CALLS:g} runs take {sum(every):.0f} s; largest memory grows by {grown / 1024:.0f} MB"
    return limited(what, _each([statistics.fmean(every)]), _each(begin), value, at_most=1.05, note=note)


def _each(seconds: list[float]) -> str:
    return f"{min(seconds) * 1e6 / RUNS:.3g} us"
