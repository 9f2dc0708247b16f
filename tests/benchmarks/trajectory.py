"""A single trajectory at a relative error of 1e-6 on 2000 points: masking beside the other integrators."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from tests.benchmarks.systems import SYSTEMS, Array, System
from tests.benchmarks.table import Row, interleaved, judged, milliseconds, missing, ratio, told

WANTED_ERROR = 1e-6
# Four tolerances per decade, from loose to tight.
SCAN = [10.0 ** (-e / 4) for e in range(8, 57)]
# The slow ones meet the error nowhere near its beginning.
SLOW_SCAN = [t for t in SCAN if t <= 1e-6]
ROUNDS = 200
SLOW_ROUNDS = 7

Solve = Callable[[float], Array]


@dataclass(frozen=True)
class Contender:
    """A program at the loosest tolerance that meets the wanted error; `solve()` runs it once."""

    name: str
    tolerance: float
    error: float
    solve: Callable[[], Array]

    @property
    def note(self) -> str:
        """Say at which tolerance it ran."""
        return f"{self.name} at tolerance {self.tolerance:.2g}, error {self.error:.1e}"


def rows() -> Iterator[Row]:
    """Measure Duffing against all, Huygens against heyoka."""
    duffing = SYSTEMS["duffing"]
    ours = tuned(duffing, "masking", masking_kernel(duffing))
    yield public(duffing, ours)
    yield against_numbalsoda(duffing, ours)
    yield against_scipy(duffing, ours)
    yield against_control(duffing, ours)
    yield against_heyoka(duffing, ours)
    huygens = SYSTEMS["huygens"]
    yield against_heyoka(huygens, tuned(huygens, "masking", masking_kernel(huygens)))


def masking_kernel(system: System) -> Solve:
    """Call the compiled kernel itself."""
    solve, p, u = system.model.kernels.solve_taylor, system.model.values(), np.zeros(0)
    start, times = system.start, system.times
    out = np.empty((len(times), len(start)))

    def run(tolerance: float) -> Array:
        solve(0.0, start.copy(), times, u, p, tolerance, 0.0, out)
        return out

    return run


def public(system: System, ours: Contender) -> Row:
    """Compare the kernel with the same through `Model.simulate`."""
    seconds = interleaved(
        {"ours": ours.solve, "public": lambda: system.model.simulate(system.times, tolerance=ours.tolerance)}, ROUNDS
    )
    return told(
        f"{system.name}: Model.simulate / its kernel",
        milliseconds(seconds["ours"]),
        milliseconds(seconds["public"]),
        ratio(seconds, "public", "ours"),
        ours.note,
    )


def against_numbalsoda(system: System, ours: Contender) -> Row:
    """Compare with the better of numbalsoda's two methods, their right-hand side compiled by numba."""
    what = f"{system.name}: numbalsoda / masking"
    try:
        numbalsoda = importlib.import_module("numbalsoda")
    except ImportError as error:
        return missing(what, str(error))
    import numba

    values = system.model.parameter_values()
    w1, w2, w3, th1, th2, mu1, mu2, z3 = (values[n] for n in ("w1", "w2", "w3", "th1", "th2", "mu1", "mu2", "z3"))

    @numba.cfunc(numbalsoda.lsoda_sig, fastmath=True, error_model="numpy")
    def rhs(t: float, y: Array, dy: Array, p: Array) -> None:
        d1, d2 = y[0] - y[2], y[1] - y[2]
        f1 = w1 * w1 * d1 + th1 * d1 * d1 * d1
        f2 = w2 * w2 * d2 + th2 * d2 * d2 * d2
        dy[0] = y[3]
        dy[1] = y[4]
        dy[2] = y[5]
        dy[3] = -f1
        dy[4] = -f2
        dy[5] = mu1 * f1 + mu2 * f2 - w3 * w3 * y[2] - 2 * z3 * w3 * y[5]

    def solver(method: Callable[..., Any]) -> Solve:
        def run(tolerance: float) -> Array:
            found, _ = method(rhs.address, system.start, system.times, rtol=tolerance, atol=tolerance, mxstep=100_000)
            return np.asarray(found)

        return run

    contenders = {m: tuned(system, m, solver(getattr(numbalsoda, m))) for m in ("lsoda", "dop853")}
    seconds = interleaved({"ours": ours.solve, **{m: c.solve for m, c in contenders.items()}}, ROUNDS // 2)
    best = min(contenders, key=lambda m: min(seconds[m]))
    note = "; ".join(f"{c.note}: {milliseconds(seconds[m])}" for m, c in contenders.items())
    return judged(
        what,
        milliseconds(seconds["ours"]),
        milliseconds(seconds[best]),
        ratio(seconds, best, "ours"),
        at_least=2.0,
        note=note,
    )


def against_scipy(system: System, ours: Contender) -> Row:
    """Compare with scipy's DOP853 and a right-hand side in plain Python."""
    from scipy.integrate import solve_ivp

    rhs = system.plain(system.model.parameter_values())

    def run(tolerance: float) -> Array:
        found = solve_ivp(rhs, (0.0, system.span), system.start, "DOP853", system.times, rtol=tolerance, atol=tolerance)
        return np.asarray(found.y.T)

    theirs = tuned(system, "scipy", run, SLOW_SCAN)
    return compared(f"{system.name}: scipy DOP853 / masking", ours, theirs, 200.0)


def against_control(system: System, ours: Contender) -> Row:
    """Compare with python-control by DOP853; measured: its default method takes twice as long."""
    import control

    rhs = system.plain(system.model.parameter_values())
    names = [name.replace("'", "_rate") for name in system.model.state_names]
    plant = control.NonlinearIOSystem(
        lambda t, x, u, params: rhs(t, x),
        None,
        inputs=0,
        outputs=names,
        states=names,
    )

    def run(tolerance: float) -> Array:
        found = control.input_output_response(
            plant,
            system.times,
            0.0,
            system.start,
            solve_ivp_method="DOP853",
            solve_ivp_kwargs={"rtol": tolerance, "atol": tolerance},
        )
        return np.asarray(found.states.T)

    theirs = tuned(system, "python-control", run, SLOW_SCAN)
    return compared(f"{system.name}: python-control / masking", ours, theirs, 1000.0)


def against_heyoka(system: System, ours: Contender) -> Row:
    """Compare with heyoka's Taylor integrator, its parameters compiled in."""
    what = f"{system.name}: heyoka / masking"
    try:
        heyoka = importlib.import_module("heyoka")
    except ImportError as error:
        return missing(what, str(error))
    equations = system.symbolic(system.model.parameter_values())
    built: dict[float, Any] = {}

    def run(tolerance: float) -> Array:
        if tolerance not in built:
            built[tolerance] = heyoka.taylor_adaptive(
                equations, system.start.copy(), tol=tolerance, fast_math=True, compact_mode=False, high_accuracy=False
            )
        integrator = built[tolerance]
        integrator.time = 0.0
        integrator.state[:] = system.start
        return np.asarray(integrator.propagate_grid(system.times)[-1])

    return compared(what, ours, tuned(system, "heyoka", run), 1.3)


def compared(what: str, ours: Contender, theirs: Contender, at_least: float) -> Row:
    """Time two contenders in turn."""
    begin = interleaved({"theirs": theirs.solve}, 1)["theirs"][0]
    seconds = interleaved({"ours": ours.solve, "theirs": theirs.solve}, max(SLOW_ROUNDS, min(ROUNDS, int(1.0 / begin))))
    return judged(
        what,
        milliseconds(seconds["ours"]),
        milliseconds(seconds["theirs"]),
        ratio(seconds, "theirs", "ours"),
        at_least=at_least,
        note=f"{ours.note}; {theirs.note}",
    )


def tuned(system: System, name: str, solve: Solve, scan: Sequence[float] = SCAN) -> Contender:
    """Find the loosest tolerance of the scan that meets the wanted error."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for tolerance in scan:
            states = solve(tolerance)
            if np.all(np.isfinite(states)) and system.error(states) <= WANTED_ERROR:
                return Contender(name, tolerance, system.error(states), partial(solve, tolerance))
    raise RuntimeError(f"{name} does not reach a relative error of {WANTED_ERROR:g}")
