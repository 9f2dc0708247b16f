"""N coordinates, from 2 to 200: what loading, compiling, running and masking take, beside heyoka and casadi.

    python -m tests.benchmarks.many [--systems chain beam] [--counts 2 5 10 20 50 100] [--no-masking]

Processor seconds on an empty cache: `load` reads and checks the declaration, `lower` derives the equations and prints
their code, `compile` makes machine code, `run` is one simulation of 100 units of time, `mask` the same motion made by
the rig of `examples/many` in continuous time, both the median of 5, `first` its first run with all that it loads and
compiles; chi is the worst masking error. heyoka and casadi are measured where they are installed, with this tolerance.
"""

from __future__ import annotations

import argparse
import importlib
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from masking import load_model
from masking.lab.runs.experiment import Experiment
from masking.model.modelling.model import Model
from tests.benchmarks.table import Row, few, interleaved, limited, milliseconds, missing, ratio

MANY = Path(__file__).resolve().parents[2] / "examples" / "many"
MODELS = {"chain": "duffing_chain.yaml", "beam": "pendula_beam.yaml"}
COUNTS = (2, 5, 10, 20, 50, 100, 200)
TIME, TOLERANCE = 100.0, 1e-10
REPEATS = 5
# Of the rows of `make bench`: heyoka's default mode takes minutes to compile larger systems.
BESIDE, ROUNDS = (10, 20, 50), 21
HEYOKA = ("default mode", "compact mode")
BOUNDS = [float(f"{digit}e{power}") for power in range(-4, 4) for digit in (1, 2, 5)]
KEYS = ("load", "lower", "compile", "run", "first", "mask", "chi")

Vector = Sequence[Any]


def spent(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the processor seconds that something takes, and its result."""
    begin = time.process_time()
    result = work()
    return time.process_time() - begin, result


def settled(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the median of the processor seconds that something takes several times, and its last result."""
    found = [spent(work) for _ in range(REPEATS)]
    return statistics.median(seconds for seconds, _ in found), found[-1][1]


def loaded(system: str, n: int) -> Model:
    """Load a model, in its scales."""
    model = load_model(MANY / MODELS[system], {"N": n})
    return model.dimensionless() if model.declaration.scales else model


def simulated(system: str, n: int) -> tuple[dict[str, float], Model]:
    """Measure a model by itself, in its scales."""

    found = dict[str, float]()
    found["load"], model = spent(lambda: loaded(system, n))
    found["lower"], _ = spent(lambda: model.kernels)
    times = np.linspace(0.0, TIME, 201)
    first, _ = spent(lambda: model.simulate(times, tolerance=TOLERANCE))
    found["run"], _ = settled(lambda: model.simulate(times, tolerance=TOLERANCE))
    found["compile"] = first - found["run"]
    return found, model


def masked(system: str, n: int) -> dict[str, float]:
    """Measure the rig that moves as the model does."""

    def load() -> Experiment:
        return Experiment.load(MANY / f"{system}.yaml", counts={"N": n}).changed(duration=TIME, tolerance=TOLERANCE)

    first, _ = spent(lambda: load().run())
    wanted = load()
    wanted.run()
    again, recording = settled(wanted.run)
    return {"first": first, "mask": again, "chi": max(recording.manifest["masking_error"].values())}


def accelerations(library: Any, system: str, q: Vector, v: Vector, p: dict[str, float]) -> list[Any]:
    """Write the equations again for another library: those of the beam solved by hand for its acceleration."""
    if system == "chain":
        at = [q[0], *q, q[-1]]
        pull = [p["c"] * (2.0 * at[i] - at[i - 1] - at[i + 1]) for i in range(1, len(q) + 1)]
        return [-x - p["th"] * x * x * x - f for x, f in zip(q, pull, strict=True)]
    *angles, x = q
    part = p["m"] / len(angles)
    sines, cosines = [library.sin(th) for th in angles], [library.cos(th) for th in angles]
    force, inertia = -p["k"] * x, p["M"] + p["m"]
    for s, c, rate in zip(sines, cosines, v, strict=False):
        force = force + part * (p["l"] * rate * rate * s + p["g"] * s * c)
        inertia = inertia - part * c * c
    beam = force / inertia
    return [*(-(p["g"] * s + beam * c) / p["l"] for s, c in zip(sines, cosines, strict=True)), beam]


def heyoka(system: str, model: Model, compact: bool) -> dict[str, float]:
    """Measure heyoka's Taylor integrator."""
    built, integrator = spent(lambda: taylor_adaptive(system, model, compact))
    begin = model.initial_state({})

    def again() -> Any:
        integrator.time, integrator.state[:] = 0.0, begin
        return integrator.propagate_grid(np.linspace(0.0, TIME, 201))

    run, _ = settled(again)
    return {"compile": built, "run": run}


def taylor_adaptive(system: str, model: Model, compact: bool) -> Any:
    """Make heyoka's integrator."""
    hy = importlib.import_module("heyoka")
    names = model.coordinates
    q, v = hy.make_vars(*names), hy.make_vars(*(f"v_{name}" for name in names))
    made = accelerations(hy, system, q, v, model.parameter_values())
    states = [*zip(q, v, strict=True), *zip(v, made, strict=True)]
    options = {"tol": TOLERANCE, "compact_mode": compact}
    return hy.taylor_adaptive(states, model.initial_state({}), **options)


def rows() -> Iterator[Row]:
    """Measure runs of each system beside the faster of heyoka's two modes, taken in turn."""
    for system, n in product(MODELS, BESIDE[: few(len(BESIDE))]):
        what = f"{system}, {n} coordinates: Model.simulate / heyoka's faster mode"
        try:
            importlib.import_module("heyoka")
        except ImportError:
            yield missing(what, "heyoka is not installed")
            continue
        model, times = loaded(system, n), np.linspace(0.0, TIME, 201)
        runs = {"ours": partial(model.simulate, times, tolerance=TOLERANCE)}
        runs |= {name: propagation(system, model, compact=name == "compact mode") for name in HEYOKA}
        for run in runs.values():
            run()
        seconds = interleaved(runs, few(ROUNDS, 2))
        theirs = min(HEYOKA, key=lambda name: statistics.median(seconds[name]))
        found = ratio(seconds, "ours", theirs)
        cells = milliseconds(seconds["ours"]), milliseconds(seconds[theirs])
        yield limited(what, *cells, found, at_most=1.5, note=f"heyoka's {theirs}, tolerance {TOLERANCE:g}")


def propagation(system: str, model: Model, *, compact: bool) -> Callable[[], object]:
    """Make heyoka's integrator, and a run of it from the start."""
    integrator, start, times = (
        taylor_adaptive(system, model, compact),
        model.initial_state({}),
        np.linspace(0, TIME, 201),
    )

    def run() -> object:
        integrator.time, integrator.state[:] = 0.0, start
        return integrator.propagate_grid(times)

    return run


def casadi(system: str, model: Model) -> dict[str, float]:
    """Measure casadi's interface to CVODES."""
    ca = importlib.import_module("casadi")
    n = len(model.coordinates)

    def build() -> Any:
        y = ca.SX.sym("y", 2 * n)
        q, v = [y[i] for i in range(n)], [y[n + i] for i in range(n)]
        ode = ca.vertcat(*v, *accelerations(ca, system, q, v, model.parameter_values()))
        options = {"abstol": TOLERANCE, "reltol": TOLERANCE, "max_num_steps": 10**7}
        return ca.integrator("run", "cvodes", {"x": y, "ode": ode}, 0.0, list(np.linspace(0.0, TIME, 201)[1:]), options)

    built, integrator = spent(build)
    run, _ = settled(lambda: integrator(x0=model.initial_state({})))
    return {"compile": built, "run": run}


def bound(seconds: float) -> str:
    """Return the next round number, which a slower moment of the same machine keeps to."""
    return next(f"{most:g}" for most in BOUNDS if most > 1.2 * seconds)


def growth(counts: Sequence[int], seconds: Sequence[float]) -> float:
    """Return the power of N with which a time grows, by least squares of its logarithm from N = 10 on."""
    n, t = (np.log([x for x, count in zip(of, counts, strict=True) if count >= 10]) for of in (counts, seconds))
    return float(np.polyfit(n, t, 1)[0])


@contextmanager
def empty_cache() -> Iterator[None]:
    """Compile into a folder of its own."""
    before = os.environ.get("MASKING_CACHE")
    with tempfile.TemporaryDirectory() as cache:
        os.environ["MASKING_CACHE"] = cache
        try:
            yield
        finally:
            os.environ.pop("MASKING_CACHE")
            os.environ.update({"MASKING_CACHE": before} if before is not None else {})


def table(system: str) -> str:
    """Return a table of this package alone, with times rounded up, and below which power of N those of runs grow."""
    with empty_cache():
        masked(system, 3)  # what no model needs alone: imports, and kernels that all share
        found = [simulated(system, n)[0] | masked(system, n) for n in COUNTS]
    rows = ["| N | load | derive | compile | run | first masked run | next masked runs | chi |", f"|{'---|' * 8}"]
    for n, one in zip(COUNTS, found, strict=True):
        times = [bound(one[key]) for key in KEYS if key != "chi"]
        rows.append(f"| {n} | {' | '.join(times)} | {'below 1e-6' if one['chi'] < 1e-6 else one['chi']} |")
    powers = [growth(COUNTS, [one[key] for one in found]) for key in ("run", "mask")]
    most = next(power for power in (1.0, 1.5, 2.0, 3.0) if power > max(powers))
    return "\n".join(rows) + f"\n\nFrom N = 10 on, the times of runs grow more slowly than N^{most:g}."


def lines(systems: Sequence[str], counts: Sequence[int], masking: bool) -> Iterator[str]:
    """Yield the rows of the table."""
    yield f"| system | N | by | {' | '.join(KEYS)} |"
    yield f"|{'---|' * (len(KEYS) + 3)}"
    for system in systems:
        for n in counts:
            ours, model = simulated(system, n)
            found = {"masking": ours | (masked(system, n) if masking else {})}
            for name, measure in (
                ("heyoka", partial(heyoka, system, model, compact=False)),
                ("heyoka, compact", partial(heyoka, system, model, compact=True)),
                ("casadi", partial(casadi, system, model)),
            ):
                try:
                    found[name] = measure()
                except ImportError:
                    continue
            for name, values in found.items():
                cells = " | ".join(f"{values[key]:.2g}" if key in values else "" for key in KEYS)
                yield f"| {system} | {n} | {name} | {cells} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--systems", nargs="+", choices=MODELS, default=[*MODELS])
    parser.add_argument("--counts", nargs="+", type=int, default=COUNTS)
    parser.add_argument("--no-masking", action="store_true")
    given = parser.parse_args()
    with empty_cache():
        for line in lines(given.systems, given.counts, not given.no_masking):
            print(line, flush=True)


if __name__ == "__main__":
    main()
