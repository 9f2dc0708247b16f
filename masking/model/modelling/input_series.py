"""Series: inputs that are known at points of time, as polynomials between these, and integration along them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal, Protocol, Self, TypeAlias

import numpy as np

from masking.compile.codegen.compiled_functions import WHOLE, InPieces, Kernels, every
from masking.compile.codegen.trajectory import Trajectory
from masking.compile.numerics.arrays import Array
from masking.errors import ModelError
from masking.lazy_imports import interpolate
from masking.model.declaration import schema
from masking.model.declaration.input_definitions import CELLS, cell, with_inputs
from masking.model.declaration.input_source import InputSource
from masking.model.modelling.scales import Units

Inputs: TypeAlias = "Sequence[float] | Mapping[str, float | Series | Sequence[float]] | None"  # of a simulation
Interpolation = Literal["linear", "previous", "cubic"]
FEWEST = {"linear": 1, "previous": 1, "cubic": 4}  # points


def row_of_times(times: Array) -> Array:
    """Times (m,) as floats; raises a `ModelError` if they are none, or not finite."""
    times = np.array(times, dtype=float, ndmin=1, copy=None)
    if times.ndim != 1 or len(times) == 0 or not every(np.isfinite(times)):
        raise ModelError(f"times must be finite, in one row, such as np.linspace(0, 10, 101); got shape {times.shape}")
    return times


@dataclass(frozen=True, eq=False)
class Series:
    """An input that is known at points of time; before the first and after the last it stays as it is there.

    Args:
        times: of the points, increasing (m,).
        values: at them (m,).
        interpolation: what it is between two points: a straight line, the value of the previous one, or a cubic spline
            without a jump of the third derivative at the second point and the last but one.

    Raises:
        ModelError: times and values do not fit, or are too few.
    """

    times: Array
    values: Array
    interpolation: Interpolation = "linear"

    def __post_init__(self) -> None:
        times, values = np.array(self.times, dtype=float), np.array(self.values, dtype=float)
        fewest = FEWEST.get(self.interpolation)
        if fewest is None:
            raise ModelError(f"interpolation is {self.interpolation!r}; give one of {', '.join(FEWEST)}")
        if times.ndim != 1 or times.shape != values.shape or len(times) < fewest:
            raise ModelError(
                f"a series has {fewest} or more points with a time and a value each ({self.interpolation}); got times "
                f"of shape {times.shape} and values of shape {values.shape}"
            )
        if not (np.isfinite(times).all() and np.isfinite(values).all() and np.all(np.diff(times) > 0.0)):
            raise ModelError("a series has finite values at finite times that increase; look for gaps and doublets")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "values", values)

    @cached_property
    def pieces(self) -> Array:
        """C0 to c3 and the instant that they count from, before, between and after the points (m + 1, 5)."""
        x, y, m = self.times, self.values, len(self.times)
        found = np.zeros((m + 1, 5))
        found[0, 0], found[0, 4] = y[0], x[0]
        found[1:, 0], found[1:, 4] = y, x
        if self.interpolation == "linear":
            found[1:m, 1] = np.diff(y) / np.diff(x)
        elif self.interpolation == "cubic":
            spline = interpolate.CubicSpline(x, y, bc_type="not-a-knot")
            found[1:m, 1:4] = spline.c[2::-1].T
        return found

    def at(self, times: Array) -> Array:
        """Values at times (m,)."""
        c = self.pieces[np.searchsorted(self.times, times, side="right")]
        d = np.asarray(times) - c[:, 4]
        return np.asarray(c[:, 0] + d * (c[:, 1] + d * (c[:, 2] + d * c[:, 3])), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Schedule:
    """Parameters that change at instants."""

    instants: Array  # (b,), increasing
    rows: Array  # values before the first instant, between and after (b + 1, k)
    where: Array  # which entries of a parameter array they are (k,)

    @classmethod
    def of(cls, series: Sequence[tuple[Series, Sequence[int]]], time_scale: float = 1.0) -> Schedule:
        """Schedule of series, each with the indices of the five parameters of its polynomials.

        `time_scale` is units of time of the schedule per unit of time of the series.
        """
        knots = [one.times for one, _ in series]
        instants = np.unique(np.concatenate(knots)) if knots else np.empty(0)
        middles = np.append(-np.inf, instants)
        rows = [one.pieces[np.searchsorted(one.times, middles, side="right")] for one, _ in series]
        where = np.array([i for _, places in series for i in places], dtype=int)
        return cls(instants * time_scale, np.hstack(rows) if rows else np.empty((1, 0)), where)

    def set(self, t: float, p: Array) -> None:
        """Write the values at a time into a parameter array."""
        p[self.where] = self.rows[np.searchsorted(self.instants, t, side="right")]

    def moved(self, offset: int) -> Schedule:
        """Schedule for a longer array, in which the entries stand further behind."""
        return replace(self, where=self.where + offset)

    def spans(self, times: Array) -> list[tuple[int, int]]:
        """Ranges of rows of increasing times (m,) in which nothing changes: first, and one after last."""
        cuts = np.searchsorted(times, self.instants, side="left")
        edges = np.unique(np.concatenate([[0, len(times)], cuts]))
        return [(int(a), int(b)) for a, b in pairwise(edges)]


def integrate(
    kernels: Kernels,
    times: Array,
    state: Array,
    inputs: Array,
    parameters: Array,
    *,
    schedule: Schedule | None,
    tolerance: float,
    pieces: InPieces = WHOLE,
) -> Trajectory:
    """Integrate compiled dynamics whose parameters change at instants, as `Kernels.integrate` does others.

    Raises a `ModelError`, too, where times go backwards along a schedule, or there are delays.
    """
    times = np.ascontiguousarray(times, dtype=float)
    if schedule is None or not len(schedule.where):
        return kernels.integrate(times, state, inputs, parameters, tolerance=tolerance, pieces=pieces)
    if np.any(np.diff(times) < 0.0):
        raise ModelError("inputs that are series are followed forwards in time; give times that increase")
    p, y, steps = parameters.copy(), np.array(state, dtype=float), 0
    states = np.empty((len(times), len(y)))
    inner = schedule.instants[(schedule.instants > times[0]) & (schedule.instants < times[-1])]
    if len(inner) and kernels.meta.get("lags", 0):
        raise ModelError(
            "what depends on the past by a delay is not integrated with inputs that are series; give an expression "
            "of the time, or leave the delays out"
        )
    ends, begin, row, events = np.append(inner, times[-1]), float(times[0]), 0, list[tuple[float, str]]()
    for done, end in enumerate(ends, 1):
        last = int(np.searchsorted(times, end, side="right"))
        schedule.set(begin, p)
        grid = np.concatenate([[begin], times[row:last], [end]])
        found = kernels.integrate(grid, y, inputs, p, tolerance=tolerance)
        states[row:last] = found.states[1:-1]
        events += found.events
        y, begin, row, steps = found.states[-1].copy(), float(end), last, steps + found.steps
        if pieces.progress is not None:
            pieces.progress(done / len(ends))
    names, internal = kernels.meta["coordinates"], kernels.meta.get("states", ())
    return Trajectory(times, states, tuple(names), steps, tuple(internal), tuple(events))


class _Simulated(Protocol):
    """What of a `Model` integrates it: they cannot import each other."""

    @property
    def overrides(self) -> Mapping[str, float]: ...
    @property
    def is_dimensionless(self) -> bool: ...
    @property
    def units(self) -> Units: ...
    @property
    def name(self) -> str: ...
    @property
    def inputs(self) -> tuple[str, ...]: ...
    @property
    def parameters(self) -> tuple[str, ...]: ...
    @property
    def state_names(self) -> list[str]: ...
    @property
    def declaration(self) -> schema.ModelDeclaration: ...
    @property
    def kernels(self) -> Kernels: ...
    def values(self) -> Array: ...
    def with_parameters(self, /, **values: float) -> Self: ...
    def initial_state(self, given: Mapping[str, float | Array]) -> Array: ...
    def simulate(self, times: Array, initial: Mapping[str, float], inputs: Inputs, tolerance: float) -> Trajectory: ...
    def declared_as(self, declaration: schema.ModelDeclaration) -> Self: ...


Simulated = _Simulated


def driven(
    model: Simulated,
    times: Array,
    initial: Mapping[str, float],
    inputs: Mapping[str, float | Series | Sequence[float]],
    tolerance: float,
) -> Trajectory:
    """Integrate a model whose inputs are given by name, as `Model.simulate` does, over increasing times (m,).

    Each input is a number, a series, or values at the times. Raises a `ModelError` where one is missing, or there is
    none of a name.
    """
    times = np.atleast_1d(np.asarray(times, dtype=float))
    unknown, missing = [n for n in inputs if n not in model.inputs], [n for n in model.inputs if n not in inputs]
    if unknown or missing:
        what = f"has no input '{unknown[0]}'" if unknown else f"has inputs that are not given: {', '.join(missing)}"
        raise ModelError(f"{model.name} {what}; its inputs are {', '.join(model.inputs) or 'none'}")
    series = {name: one for name, one in inputs.items() if isinstance(one, Series)}
    rest = {name: np.asarray(one, float) for name, one in inputs.items() if not isinstance(one, Series)}
    series |= {name: Series(times, values) for name, values in rest.items() if values.ndim}
    made = model.declared_as(with_inputs(model.declaration, dict.fromkeys(series, InputSource())))
    constant = np.array([float(rest[name]) for name in made.inputs])
    cells = [(one, [made.parameters.index(cell(name, part)) for part in CELLS]) for name, one in series.items()]
    schedule = Schedule.of(cells) if cells else None
    state = made.initial_state(initial)
    return integrate(made.kernels, times, state, constant, made.values(), schedule=schedule, tolerance=tolerance)
