"""Ensembles: many runs of one model, each with its own parameters and initial state."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import itemgetter

import numpy as np

from masking.compile.codegen.compiled_functions import in_order
from masking.compile.codegen.trajectory import Trajectory
from masking.compile.numerics.arrays import Array
from masking.errors import DeclarationError, IntegrationError, ModelError, SingularityError, nearest
from masking.model.declaration.expression import Expression
from masking.model.modelling.input_series import Inputs, Simulated, row_of_times


def simulate(
    model: Simulated,
    times: Array,
    ensemble: Mapping[str, Sequence[float] | Array],
    *,
    initial: Mapping[str, float],
    inputs: Inputs,
    tolerance: float,
    threads: int | None = None,
) -> Trajectory:
    """Integrate a model once for each run of an ensemble, as `Model.simulate` does.

    Times (m,) are monotone; `ensemble` has values of each run (runs,) by the name of a parameter or a state, in the
    declared units, `initial` values of states that all runs have. Threads are as many as there are cores by default.

    Raises:
        ModelError: a name is no parameter or state, or the values are not as many for each.
        IntegrationError: the times are not in order.
        DeclarationError: a parameter is out of its bounds.
    """
    times, columns = in_order(row_of_times(times)), _columns(model, ensemble)
    runs = len(next(iter(columns.values())))
    parameters = {name: values for name, values in columns.items() if name in model.parameters}
    states = {name: values for name, values in columns.items() if name not in model.parameters}
    for _, error in refused(model, columns):
        raise error

    def one(changed: Simulated, start: Mapping[str, float]) -> Trajectory:
        return changed.simulate(times, {**initial, **start}, inputs, tolerance)

    if isinstance(inputs, Mapping) or not _is_separable(model, parameters):
        return _one_by_one(model, times, parameters, states, one)
    y = np.broadcast_to(model.initial_state({**initial, **states}), (runs, len(model.state_names)))
    u = np.zeros(len(model.inputs)) if inputs is None else np.asarray(inputs, dtype=float)
    share = max(1, min(threads or os.cpu_count() or 1, runs))
    p = _parameters(model, parameters, runs)
    if model.kernels.may_switch(times, u, p):
        return _one_by_one(model, times, parameters, states, one)
    return model.kernels.integrate_each(times, y, u, p, tolerance=tolerance, threads=share)


def refused(model: Simulated, ensemble: Mapping[str, Array]) -> Iterator[tuple[int, DeclarationError]]:
    """Give the runs of an ensemble that cannot be made, by their number, and why: a parameter is out of its bounds."""
    columns = {name: values for name, values in ensemble.items() if name in model.parameters}

    def why(pick: Callable[[Array], float]) -> DeclarationError | None:
        try:
            model.with_parameters(**{name: float(pick(values)) for name, values in columns.items()})
        except DeclarationError as error:
            return error
        return None

    if why(np.min) or why(np.max):  # bounds are intervals
        for i in range(len(next(iter(columns.values())))):
            if error := why(itemgetter(i)):
                yield i, error


def _columns(model: Simulated, ensemble: Mapping[str, Sequence[float] | Array]) -> dict[str, Array]:
    columns = {name: np.atleast_1d(np.asarray(values, dtype=float)) for name, values in ensemble.items()}
    known = [*model.parameters, *model.state_names]
    for name, values in columns.items():
        if name not in known:
            raise ModelError(f"ensemble: {model.name} has no parameter or state '{name}'; {nearest(name, known)}")
        if values.ndim != 1 or not len(values) or not np.isfinite(values).all():
            raise ModelError(f"ensemble: {name} has one finite value for each run, in one row; got {values.shape}")
    if len({len(values) for values in columns.values()}) != 1:
        sizes = ", ".join(f"{name} {len(values)}" for name, values in columns.items())
        raise ModelError(f"ensemble: give as many values for each name, one for each run; got {sizes or 'none'}")
    return columns


def _is_separable(model: Simulated, varied: Mapping[str, Array]) -> bool:
    """Whether what varies changes nothing but its own entry, and a run needs no Python on its way."""
    declared = [p.value for p in model.declaration.parameters.values()]
    declared += [scale.value for scale in model.declaration.scales.values()] if model.is_dimensionless else []
    meta = model.kernels.meta
    depends = any(isinstance(value, Expression) and value.names & varied.keys() for value in declared)
    return not (depends or meta["lags"] or meta["events"])


def _parameters(model: Simulated, varied: Mapping[str, Array], runs: int) -> Array:
    """Parameter arrays (runs, parameters)."""
    found = np.tile(model.values(), (runs, 1))
    scales = model.units.scale_values(model.overrides) if model.is_dimensionless else {}
    for name, values in varied.items():
        unit = model.units.conversions[model.declaration.parameters[name].unit]
        column = values * unit.factor
        found[:, model.parameters.index(name)] = column / unit.scale(scales) if model.is_dimensionless else column
    return found


def _one_by_one(
    model: Simulated,
    times: Array,
    parameters: Mapping[str, Array],
    states: Mapping[str, Array],
    run: Callable[..., Trajectory],
) -> Trajectory:
    """Integrate runs that need Python on their way: events, delays, switches with time, inputs that are series."""
    meta, runs = model.kernels.meta, len(next(iter({**parameters, **states}.values())))
    out = np.full((runs, len(times), len(model.state_names) + meta["lags"]), np.nan)
    steps, errors = 0, dict[int, str]()
    for i in range(runs):
        changed = model.with_parameters(**{name: float(values[i]) for name, values in parameters.items()})
        try:
            found = run(changed, {name: float(values[i]) for name, values in states.items()})
        except (IntegrationError, SingularityError) as error:
            errors[i] = str(error)
        else:
            out[i], steps = found.states, steps + found.steps
    return Trajectory(times, out, tuple(meta["coordinates"]), steps, tuple(meta["states"]), errors=errors)
