"""N coordinates, from 2 to 200: what loading, compiling, running and masking take, beside heyoka and casadi.

    python -m tests.benchmarks.many [--systems chain beam] [--counts 2 5 10 20 50 100] [--no-masking]

Processor seconds on an empty cache: `load` reads and checks the declaration, `lower` derives the equations and prints
their code, `compile` makes machine code, `run` is one simulation of 100 units of time, `mask` the same motion made by
the rig of `examples/many` in continuous time, `first` its first run with all that it loads and compiles; chi is the
worst masking error. heyoka and casadi are measured where they are installed, at the same tolerance.
"""

from __future__ import annotations

import argparse
import importlib
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from masking import load_model
from masking.modelling.model import Model
from masking.runs.experiment import Experiment

MANY = Path(__file__).resolve().parents[2] / "examples" / "many"
MODELS = {"chain": "duffing_chain.yaml", "beam": "pendula_beam.yaml"}
COUNTS = (2, 5, 10, 20, 50, 100, 200)
TIME, TOLERANCE = 100.0, 1e-10

Vector = Sequence[Any]


def spent(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the processor seconds that something takes, and its result."""
    begin = time.process_time()
    result = work()
    return time.process_time() - begin, result


def simulated(system: str, n: int) -> tuple[dict[str, float], Model]:
    """Measure a model by itself, in its scales."""

    def load() -> Model:
        model = load_model(MANY / MODELS[system], {"N": n})
        return model.dimensionless() if model.declaration.scales else model

    found = dict[str, float]()
    found["load"], model = spent(load)
    found["lower"], _ = spent(lambda: model.kernels)
    times = np.linspace(0.0, TIME, 201)
    first, _ = spent(lambda: model.simulate(times, tolerance=TOLERANCE))
    found["run"], _ = spent(lambda: model.simulate(times, tolerance=TOLERANCE))
    found["compile"] = first - found["run"]
    return found, model


def masked(system: str, n: int) -> dict[str, float]:
    """Measure the rig that moves as the model does."""

    def load() -> Experiment:
        return Experiment.load(MANY / f"{system}.yaml", counts={"N": n}).changed(duration=TIME, tolerance=TOLERANCE)

    first, _ = spent(lambda: load().run())
    wanted = load()
    wanted.run()
    again, recording = spent(wanted.run)
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
    hy = importlib.import_module("heyoka")
    names = model.coordinates
    q, v = hy.make_vars(*names), hy.make_vars(*(f"v_{name}" for name in names))
    made = accelerations(hy, system, q, v, model.parameter_values())
    states = [*zip(q, v, strict=True), *zip(v, made, strict=True)]
    options = {"tol": TOLERANCE, "compact_mode": compact}
    built, integrator = spent(lambda: hy.taylor_adaptive(states, model.initial_state({}), **options))
    run, _ = spent(lambda: integrator.propagate_grid(np.linspace(0.0, TIME, 201)))
    return {"compile": built, "run": run}


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
    run, _ = spent(lambda: integrator(x0=model.initial_state({})))
    return {"compile": built, "run": run}


def lines(systems: Sequence[str], counts: Sequence[int], masking: bool) -> Iterator[str]:
    """Yield the rows of the table."""
    keys = ("load", "lower", "compile", "run", "first", "mask", "chi")
    yield f"| system | N | by | {' | '.join(keys)} |"
    yield f"|{'---|' * (len(keys) + 3)}"
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
                cells = " | ".join(f"{values[key]:.2g}" if key in values else "" for key in keys)
                yield f"| {system} | {n} | {name} | {cells} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--systems", nargs="+", choices=MODELS, default=[*MODELS])
    parser.add_argument("--counts", nargs="+", type=int, default=COUNTS)
    parser.add_argument("--no-masking", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as cache:
        os.environ["MASKING_CACHE"] = cache
        for line in lines(given.systems, given.counts, not given.no_masking):
            print(line, flush=True)


if __name__ == "__main__":
    main()
