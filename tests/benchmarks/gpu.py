"""Many runs of Huygens' clocks on a GPU of NVIDIA, beside the cores of this machine.

    python -m tests.benchmarks.gpu [--runs 10000 100000 1000000] [--times 101] [--tolerance 1e-7]

Each run has its own damping and initial angle, over 100 units of time. `error` is the largest distance of the last
states from those at a tolerance of 1e-13, `apart` that of all states of the two; seconds are the least of three calls
of `Model.simulate`, with all that they copy, and `first` is the first call in a process, with what it compiles.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence

import numpy as np

from masking import load_model
from masking.compile.codegen import cuda
from masking.compile.codegen.compiled_functions import Trajectory

REPEATS = 3
EXACT, COMPARED = 1e-13, 2000


def spent(work: Callable[[], Trajectory]) -> tuple[float, Trajectory]:
    """Return the seconds that runs take, and the runs."""
    begin = time.perf_counter()
    found = work()
    return time.perf_counter() - begin, found


def measured(runs: Sequence[int], times: int, tolerance: float) -> None:
    """Print a table."""
    model, t = load_model("huygens").dimensionless(), np.linspace(0.0, 100.0, times)

    def simulated(count: int, *, gpu: bool, most: float = tolerance) -> Callable[[], Trajectory]:
        values = {"z": np.linspace(0.1, 0.3, count), "th1": np.linspace(-0.8, 0.8, count)}
        return lambda: model.simulate(t, ensemble=values, tolerance=most, gpu=gpu)

    cupy = cuda.available()
    card = cupy.cuda.runtime.getDeviceProperties(0)["name"].decode()
    print(f"{card}, tolerance {tolerance:g}, {times} samples")
    exact = simulated(COMPARED, gpu=False, most=EXACT)().states[:, -1]
    found = {}
    for gpu in (True, False):
        first, one = spent(simulated(COMPARED, gpu=gpu))
        found[gpu] = one.states
        error = np.abs(one.states[:, -1] - exact).max()
        name, steps = "GPU" if gpu else "cores", one.steps / COMPARED
        print(f"{name}: first call {first:.2f} s, {steps:.0f} steps a run, error {error:.1e}")
    print(f"apart {np.abs(found[True] - found[False]).max():.1e}")
    print("| runs | GPU, s | us a run | cores, s | us a run | ratio |\n|---|---|---|---|---|---|")
    for count in runs:
        gpu, cores = (min(spent(simulated(count, gpu=which))[0] for _ in range(REPEATS)) for which in (True, False))
        each = 1e6 / count
        print(f"| {count} | {gpu:.3f} | {gpu * each:.3f} | {cores:.2f} | {cores * each:.2f} | {cores / gpu:.0f} |")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, nargs="+", default=[10_000, 100_000, 1_000_000])
    parser.add_argument("--times", type=int, default=101)
    parser.add_argument("--tolerance", type=float, default=1e-7)
    given = parser.parse_args()
    measured(given.runs, given.times, given.tolerance)


if __name__ == "__main__":
    main()
