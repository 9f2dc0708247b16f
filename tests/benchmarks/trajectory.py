"""A single trajectory on 2000 points at relative errors of 1e-6, 1e-9 and 1e-12: masking beside other integrators."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from tests.benchmarks.systems import SYSTEMS, Array, System
from tests.benchmarks.table import Row, few, interleaved, judged, milliseconds, missing, ratio

ERRORS = (1e-6, 1e-9, 1e-12)
AIMS = {1e-6: 1.5, 1e-9: 1.25, 1e-12: 1.05}
# Four tolerances per decade, from loose to tight.
SCAN = [10.0 ** (-e / 4) for e in range(8, 63)]
ROUNDS, SLOW_ROUNDS = 200, 7

Solve = Callable[[float], Array]


@dataclass(frozen=True)
class Contender:
    """A program at the loosest tolerance that meets an error; `solve()` runs it once."""

    name: str
    tolerance: float
    error: float
    solve: Callable[[], Array]

    @property
    def note(self) -> str:
        """Say at which tolerance it ran."""
        return f"{self.name} at tolerance {self.tolerance:.2g}, error {self.error:.1e}"


def rows() -> Iterator[Row]:
    """Measure each system at each error beside heyoka, and one beside scipy."""
    for system in SYSTEMS.values():
        theirs = heyoka(system)
        for error in ERRORS:
            yield against_heyoka(system, error, theirs)
    yield against_scipy(SYSTEMS["duffing"])


def public(system: System) -> Solve:
    """Call `Model.simulate`."""
    return lambda tolerance: system.model.simulate(system.times, tolerance=tolerance).states


def kernel(system: System) -> Solve:
    """Call the compiled kernel itself."""
    solve, p, u = system.model.kernels.solve_taylor, system.model.values(), np.zeros(0)
    start, times = system.start, system.times
    out = np.empty((len(times), len(start)))

    def run(tolerance: float) -> Array:
        solve(0.0, start.copy(), times, u, p, tolerance, 0.0, out)
        return out

    return run


def heyoka(system: System) -> Solve | None:
    """Call heyoka's Taylor integrator, its parameters compiled in; None where it is not installed."""
    try:
        library = importlib.import_module("heyoka")
    except ImportError:
        return None
    equations = system.symbolic(system.model.parameter_values())
    built: dict[float, Any] = {}

    def run(tolerance: float) -> Array:
        if tolerance not in built:
            built[tolerance] = library.taylor_adaptive(
                equations, system.start.copy(), tol=tolerance, fast_math=True, compact_mode=False, high_accuracy=False
            )
        integrator = built[tolerance]
        integrator.time = 0.0
        integrator.state[:] = system.start
        return np.asarray(integrator.propagate_grid(system.times)[-1])

    return run


def against_heyoka(system: System, error: float, theirs: Solve | None) -> Row:
    """Compare the public calls, and say what the kernel alone takes."""
    what = f"{system.name}, error {error:g}: heyoka / Model.simulate"
    if theirs is None:
        return missing(what, "heyoka is not installed")
    ours, other = tuned(system, "masking", public(system), error), tuned(system, "heyoka", theirs, error)
    alone = partial(kernel(system), ours.tolerance)
    seconds = interleaved({"ours": ours.solve, "kernel": alone, "theirs": other.solve}, few(ROUNDS))
    note = f"{ours.note}; {other.note}; Model.simulate / its kernel {ratio(seconds, 'ours', 'kernel'):.3g}"
    times = [milliseconds(seconds[name]) for name in ("ours", "theirs")]
    return judged(what, *times, ratio(seconds, "theirs", "ours"), at_least=AIMS[error], note=note)


def against_scipy(system: System) -> Row:
    """Compare with scipy's DOP853 and a right-hand side that numba has compiled."""
    import numba
    from scipy.integrate import solve_ivp

    rhs = numba.njit(system.plain(system.model.parameter_values()))

    def run(tolerance: float) -> Array:
        found = solve_ivp(rhs, (0.0, system.span), system.start, "DOP853", system.times, rtol=tolerance, atol=tolerance)
        return np.asarray(found.y.T)

    error = ERRORS[0]
    ours = tuned(system, "masking", public(system), error)
    theirs = tuned(system, "scipy", run, error, [tolerance for tolerance in SCAN if tolerance <= 1e-6])
    seconds = interleaved({"ours": ours.solve, "theirs": theirs.solve}, few(SLOW_ROUNDS))
    return judged(
        f"{system.name}, error {error:g}: scipy's DOP853, compiled / Model.simulate",
        *(milliseconds(seconds[name]) for name in ("ours", "theirs")),
        ratio(seconds, "theirs", "ours"),
        at_least=200.0,
        note=f"{ours.note}; {theirs.note}",
    )


def tuned(system: System, name: str, solve: Solve, wanted: float, scan: Sequence[float] = SCAN) -> Contender:
    """Find the loosest tolerance of the scan that meets an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for tolerance in scan:
            states = solve(tolerance)
            if np.all(np.isfinite(states)) and system.error(states) <= wanted:
                return Contender(name, tolerance, system.error(states), partial(solve, tolerance))
    raise RuntimeError(f"{name} does not reach a relative error of {wanted:g}")
