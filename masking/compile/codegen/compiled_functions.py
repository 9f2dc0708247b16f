"""The compiled functions of one generated module, with the checks that their callers want."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from masking.compile.codegen import chattering, machine_code, module_store
from masking.compile.codegen.event_jumps import Jumps
from masking.compile.codegen.generated_module import FROM, Module
from masking.compile.codegen.machine_code import NativeFunction
from masking.compile.codegen.module_store import Generated
from masking.compile.codegen.time_switches import NO_INSTANTS, Spans, TimeSwitches
from masking.compile.codegen.trajectory import Trajectory
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.stop_codes import (
    EVENT,
    MESSAGES,
    MOST_STEPS,
    NOT_FINITE,
    REACHED,
    SINGULAR,
    TOO_MANY_STEPS,
    TOO_SMALL_STEP,
)
from masking.errors import IntegrationError, SingularityError, UnreachableError, nearest

# The classical Runge-Kutta method errs by 1e-9 per radian when a radian takes this many steps.
STEPS_PER_RADIAN = 50.0
# What decays by exp(-5) between samples, to less than a hundredth, is not followed: a step of a radian is stable.
GONE, STABLE = 5.0, 1.0


@dataclass(frozen=True)
class InPieces:
    """Number of pieces that times are cut into, and what is called with the part done after each."""

    count: int = 1
    progress: Callable[[float], None] | None = None


WHOLE = InPieces()


@dataclass(frozen=True)
class Kernels:
    """The functions of a generated module, by the names they have in it, and what it says of itself."""

    generated: Generated

    @property
    def meta(self) -> Mapping[str, Any]:
        """Names of coordinates, states, inputs and parameters, in the order of the arrays, and the units."""
        return self.generated.meta

    def __getattr__(self, name: str) -> NativeFunction:
        """Function of the module; it is compiled when it is first called."""
        if name.startswith("_") or name not in self.meta["functions"]:
            raise AttributeError(f"there is no compiled function '{name}'; {nearest(name, self.meta['functions'])}")
        found = vars(self)[name] = self.generated.function(name)  # where it is found from now on
        return found

    def _solver(self, method: str, tolerance: float) -> NativeFunction:
        """Integrator by a method, of the order that suits a tolerance."""
        return next(self._solvers(method, tolerance))

    def _solvers(self, method: str, tolerance: float) -> Iterator[NativeFunction]:
        """Integrators by a method that suit a tolerance, from the fastest to the most precise."""
        for ending, least in FROM.items():
            if tolerance >= least and (name := f"solve_{method}{ending}") in self.meta["functions"]:
                yield getattr(self, name)

    def by_signature(self, *signatures: str) -> dict[str, NativeFunction]:
        """Functions by their signatures, as `linked` takes them."""
        return {signature: getattr(self, signature.partition("(")[0]) for signature in signatures}

    def integrate(
        self,
        times: Array,
        state: Array,
        inputs: Array,
        parameters: Array,
        *,
        tolerance: float,
        method: str | None = None,
        fixed_step: float = 0.0,
        pieces: InPieces = WHOLE,
    ) -> Trajectory:
        """Integrate the module's dynamics over given times.

        Args:
            times: monotone (m,); the state is that at the first.
            state: (2 n + k,) at `times[0]`; left as it is. States that are returned have delayed expressions behind.
            inputs: (k,), held constant.
            parameters: array in the module's order.
            tolerance: local relative error of a step.
            method: `taylor` or `runge_kutta`; by default Taylor series where the dynamics have them.
            fixed_step: length of every step; 0 to control it.
            pieces: that the times are cut into.

        Raises:
            SingularityError: a matrix that must be inverted became singular; holds the state.
            IntegrationError: the integrator could not go on, or an event comes without end; says when and why.
        """
        times, meta = in_order(times), self.meta
        solve = self._solver(method or meta["method"], 0.0 if fixed_step else tolerance)
        lags = meta.get("lags", 0)
        if lags and times[-1] < times[0]:
            message = "what depends on the past by a delay is integrated forwards only: let times increase"
            raise IntegrationError(message)
        jumps = Jumps(self, times, state, parameters) if meta.get("events") else None
        instants = NO_INSTANTS if self._time_switches is None else self.instants(*_span(times), inputs, parameters)
        spans = Spans.of(times, NO_INSTANTS if lags else instants)  # the past is that of one call
        past = [np.zeros(lags), instants.ravel()] if lags else []
        begin = np.concatenate([state, *past]) if past else np.array(state, dtype=float)
        y = begin if jumps is None else jumps.state
        grid, out = spans.grid, np.empty((len(spans.grid), len(state) + lags))
        t, steps = float(times[0]), 0
        for first, last in spans.ranges(1 if lags else pieces.count):
            t, status = spans.begins.get(first, t), EVENT
            while status == EVENT or (status == TOO_MANY_STEPS and steps < MOST_STEPS and not lags):
                rows = slice(first, last)
                status, t, taken = solve(t, y, grid[rows], inputs, parameters, tolerance, fixed_step, out[rows])
                steps += taken
                if status in {TOO_MANY_STEPS, TOO_SMALL_STEP}:
                    self._refuse_chattering(t, y[: len(state)], inputs, parameters, abs(float(times[-1] - times[0])))
                if (jumps is not None and jumps.follow(status, t)) or status == TOO_MANY_STEPS:
                    first = max(first, int(np.searchsorted(grid[:last], t, side="right")))  # noqa: PLW2901
            if status != REACHED:
                self.stop(status, t, y[: len(state)])
            if pieces.progress is not None:
                pieces.progress(last / len(grid))
        names, log = meta["coordinates"], () if jumps is None else tuple(jumps.log)
        return Trajectory(times, out[spans.rows], tuple(names), steps, tuple(meta.get("states", ())), log)

    def _refuse_chattering(self, t: float, y: Array, inputs: Array, parameters: Array, span: float) -> None:
        """Refuse to go on where the motion slides along a switch."""
        texts = self.meta.get("switches", ())

        def filled(function: NativeFunction, size: int) -> Callable[[float, Array], Array]:
            def call(at: float, state: Array) -> Array:
                out = np.empty(size)
                function(at, state, inputs, parameters, out)
                return out

            return call

        if texts and span > 0.0 and not self.meta.get("lags"):  # the past is known in the integrator alone
            values, slope = filled(self.switching, len(texts)), filled(self.derivative, len(y))
            number = chattering.sliding(values, slope, t, y, span)
            if number >= 0:
                raise IntegrationError(
                    f"chattering at t = {t:.6g} along {texts[number]} = 0: both sides lead back to it, so that it "
                    "switches without end. Make the switch smooth: for sign(x) write tanh(x/w) with a width w; declare "
                    "dry friction under effects, where it sticks: {effect: dry_friction, at: ELEMENT, parameters: {fc: "
                    "..., c: 500, hold: 500}}"
                )

    @cached_property
    def _time_switches(self) -> TimeSwitches | None:
        meta = self.meta.get("time_switches")
        return None if meta is None else TimeSwitches.from_meta(meta)

    def instants(self, begin: float, end: float, inputs: Array, parameters: Array) -> Array:
        """Last time before and first time behind each instant (b, 2) at which the dynamics switch with time."""
        if self._time_switches is None:
            return NO_INSTANTS
        delays = np.empty(self.meta.get("lags", 0))
        if len(delays):
            self.delays(parameters, delays)
        return self._time_switches.instants(begin, end, inputs, parameters, delays)

    def may_switch(self, times: Array, inputs: Array, parameters: Array) -> bool:
        """Whether dynamics may switch with time between times (m,), with parameters (runs, k) of any run."""
        switching = self._time_switches
        return switching is not None and bool(switching.may_be(*_span(times), inputs, parameters).any())

    def integrate_each(
        self, times: Array, states: Array, inputs: Array, parameters: Array, *, tolerance: float, threads: int
    ) -> Trajectory:
        """Integrate dynamics over times (m,), each run from its own state at the first, without delays and events.

        Nothing may switch with time.

        States are (runs, 2 n + k), inputs (k,), held constant, and parameters (runs, parameters); `tolerance` is the
        local relative error of a step, and `threads` share the runs. Raises an `IntegrationError` where times are none,
        or not in order.
        """
        times, y = in_order(times), np.array(states, dtype=float, order="C")
        p, out = np.ascontiguousarray(parameters), np.empty((len(y), len(times), y.shape[1]))
        begin, errors = float(times[0]), dict[int, str]()
        if "solve_in_lanes" in self.meta["functions"]:
            found = np.full((len(y), 3), np.nan)
            for solve in self._solvers("in_lanes", tolerance):  # what one is not precise enough for, the next makes
                left = np.flatnonzero(found[:, 0] != REACHED)
                if len(left) == len(y):
                    y[:] = states
                    _share(solve, (begin, y, times, inputs, p, tolerance, found, out), threads)
                elif len(left):
                    given = begin, np.array(states[left], dtype=float), times, inputs, p[left], tolerance
                    ends, made = found[left], out[left]
                    _share(solve, (*given, ends, made), threads)
                    found[left], out[left] = ends, made
        else:
            solve = self._solver(self.meta["method"], tolerance)
            found = solve.each(len(y), begin, y, times, inputs, p, tolerance, 0.0, out, threads=threads)
        for run in np.flatnonzero(found[:, 0] != REACHED).tolist():  # alone it goes on, or says why it cannot
            try:
                alone = self.integrate(times, states[run], inputs, p[run], tolerance=tolerance)
            except (IntegrationError, SingularityError) as error:
                errors[run], out[run] = str(error), np.nan
            else:
                out[run], found[run, 2] = alone.states, alone.steps
        names, internal = tuple(self.meta["coordinates"]), tuple(self.meta.get("states", ()))
        return Trajectory(times, out, names, int(found[:, 2].sum()), internal, errors=errors)

    def stop(self, status: int, time: float, state: Sequence[float] | Array, remedy: str = "") -> None:
        """Raise the error that a kernel's status, one of `stop_codes`, stands for, with the time and the state there.

        A `SingularityError` holds the state and `remedy`, what to do about a singular matrix; all else is an
        `IntegrationError`.
        """
        names = self.meta["coordinates"]
        internal = self.meta.get("states", ())
        at = dict(zip([*names, *(f"{n}'" for n in names), *internal], map(float, state), strict=True))
        if status == SINGULAR:
            raise SingularityError(MESSAGES[status], time, at, remedy)
        where = ", ".join(f"{name} = {value:.6g}" for name, value in at.items())
        if unsolved := self.unsolved(status, state):
            raise UnreachableError(f"{unsolved}, at t = {time:.6g} ({where})")
        raise IntegrationError(f"{MESSAGES[status]}, at t = {time:.6g} ({where})")

    def unsolved(self, status: int, state: Sequence[float] | Array) -> str:
        """Cause of a status, in words, where no input gives what is wanted; '' where that is not the cause."""
        cause = self.meta.get("unsolved") if status == NOT_FINITE and np.isfinite(state).all() else ""
        return f"{cause}: the rig cannot do what is wanted of it" if cause else ""


class Compiled(ABC):
    """What has compiled functions of its own, which are kept on disk."""

    @property
    @abstractmethod
    def _made_from(self) -> Mapping[str, object]:
        """All that the functions depend on, apart from values; json can write it."""

    @abstractmethod
    def _build(self) -> Module:
        """Module of the functions."""

    @cached_property
    def kernels(self) -> Kernels:
        """Compiled functions; from the cache on disk where they have been made before."""
        return Kernels(module_store.load(module_store.key(self._made_from), self._build))

    @property
    def is_compiled(self) -> bool:
        """Whether the functions are in the cache on disk."""
        return module_store.exists(module_store.key(self._made_from))


def _share(solve: NativeFunction, given: tuple[Any, ...], threads: int) -> None:
    """Let threads share the runs of an integrator in lanes."""
    begin, y, times, inputs, p, tolerance, found, out = given
    solve.prepare()  # before threads do

    def part(first: int, last: int) -> None:
        some, rows = slice(first, last), out[first:last].reshape(-1, y.shape[1])
        solve(begin, y[some], times, inputs, p[some], tolerance, found[some], rows)

    machine_code.share(part, len(y), min(threads, len(y)))


def every(truths: NDArray[np.bool_]) -> bool:
    """Whether all of some truths hold; measured: a third of the time that `all` takes."""
    return b"\0" not in truths.tobytes()


def _span(times: Array) -> tuple[float, float]:
    return float(min(times[0], times[-1])), float(max(times[0], times[-1]))


def in_order(times: Array) -> Array:
    """Times as the kernels take them; raises an `IntegrationError` if they are none, or not in order."""
    times = np.ascontiguousarray(times, dtype=float)
    before, after = times[:-1], times[1:]
    if times.ndim != 1 or len(times) == 0 or not (every(after >= before) or every(after <= before)):
        raise IntegrationError(f"times must be one row of at least one time, in order; got shape {times.shape}")
    return times


def linked(
    name: str,
    factories: Callable[[], Mapping[str, tuple[Any, ...]]],
    links: Mapping[str, NativeFunction],
    work: tuple[int, int],
) -> Kernels:
    """Kernels that are compiled once for all models, with functions of one model linked to them.

    `factories` returns for each kernel what `Module.add_factory` is given after its name; it is called, and numba
    imported with it, only if the kernels are not on disk yet. `links` are functions of the model by their signatures,
    as `Module.add_link` takes them; `work` is the shape of the kernels' work space.
    """

    def build() -> Module:
        module = Module(f"{name}, of any model", {})
        for signature in links:
            module.add_link(signature)
        for kernel, given in factories().items():
            module.add_factory(kernel, *given)
        return module

    by_name = {signature.partition("(")[0]: function for signature, function in links.items()}
    return Kernels(module_store.load(module_store.key({"kernels": name, "links": list(links)}), build, by_name, work))


def steps_between(slope: Callable[[Array, Array], None], state: Array, lengths: Array, rate: float) -> int:
    """Steps of the classical Runge-Kutta method between samples that resolve the fastest motion at a state.

    What is over long before the next sample, such as the slip of a contact that sticks, takes steps that are stable.
    `slope` writes dy/dt of a state (n,) into its second argument; `lengths` (n,) are sizes of the states, for
    differences; `rate` is samples per second.
    """
    size = len(state)
    if not size:
        return 1
    jacobian, ahead, behind = np.empty((size, size)), np.empty(size), np.empty(size)
    for i, step in enumerate(1e-6 * lengths):
        change = step * np.eye(size)[i]
        slope(state + change, ahead)
        slope(state - change, behind)
        jacobian[:, i] = (ahead - behind) / (2.0 * step)
    if not np.all(np.isfinite(jacobian)):
        return 1
    modes = np.linalg.eigvals(jacobian) / rate
    needed = np.where(modes.real > -GONE, STEPS_PER_RADIAN, STABLE) * np.abs(modes)
    return max(1, int(np.ceil(float(np.max(needed)))))
