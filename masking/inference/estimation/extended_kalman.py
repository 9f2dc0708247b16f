"""Extended Kalman filter: parameters of a twin as states that stay constant, found in one pass over a record.

Its result says whether the innovations are as white as it assumed.

The state of the twin and the parameters are estimated together. Between samples both are carried by the equations of
the twin, their covariance by the derivatives of these; at each sample the readings correct them, one by one.
Source: Gelb, Applied Optimal Estimation (1974), table 6.1-1, and section 6.1 for the iterated filter; Rijlaarsdam
(2008), section 4.2.2, for the settings; Bierman, Factorization Methods for Discrete Sequential Estimation (1977),
chapters V to VII, for the square root of Carlson (1973).

The filter is not the least-squares fit of `identification.fit`: with noise of the process, or with states that are
poorly known, its parameters may settle off the truth, since its gain does not know how it depends on them (Ljung, IEEE
Trans. Autom. Control 24 (1979), 36-50). Begun far off with the noise alone as R and no Q, it becomes sure of values
that are wrong, for it takes its first derivatives as true: the settings of section 4.2.2 are wide for that reason. A
second pass from `KalmanFit.twin`, with R and P0 as they then are, is consistent. One pass starts a fit well.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from masking.compile.codegen import column_step
from masking.compile.codegen.compiled_functions import Kernels, linked
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.kernel_arguments import Filtered, FilteredTwin, FilterRecord, FilterSteps
from masking.compile.numerics.rig_sizes import COLUMN_ROWS, whole_lanes
from masking.compile.numerics.stop_codes import LINEARISE, NOT_FINITE, NOT_POSITIVE
from masking.control.rig.twin import Twin
from masking.errors import IntegrationError, ModelError, RecordError
from masking.inference.estimation.fit import Estimate
from masking.inference.estimation.identification_data import Data, is_first_order
from masking.inference.estimation.sensitivity import SENSED, SLOPES, Sensitivity, terms
from masking.inference.estimation.simulation import first_start, nearest, noise_alone, relative, validated
from masking.inference.estimation.whiteness import autocorrelation, ljung_box
from masking.lazy_imports import kalman_kernels

Progress = Callable[[float], None]
Variances = float | Sequence[float] | Array

MEASUREMENT = 1e-4  # R, section 4.2.2
PROCESS = 1e-4  # Q of the states, section 4.2.2
PARAMETERS = 1e-2  # P0 of the parameters, section 4.2.2
INITIAL = 1e-4  # P0 of the states; section 4.2.2 gives no number, only that it is small and not 0

PIECES = 20  # that a record is filtered in, with progress reported after each
INSIDE = 1e-4  # of its scale: how far a parameter stays inside its bounds
MOVED = 0.02  # relative change of a parameter after which the dependence of others on it is found anew
AFFINE = 1e-7  # relative change of that dependence that is rounding
DOUBTED = 1e-3  # probability below which innovations are said not to be white
FARTHER = 5.0  # initial deviations that a parameter may move before a note says so
LAGS = 20  # of the autocorrelation of the innovations


@dataclass(frozen=True, kw_only=True)
class FilterSettings:
    """Variances that a filter assumes, and its form.

    Variances are given without unit, in the scales of the twin's model at the values to begin from, such as time
    1/wbar, length l and voltage nu of Table 4.1; in SI units where the model declares none. Then
    a displacement counts in l, a velocity in l wbar, a parameter in what the scales make of its unit, and a reading in
    what the sensor gives when one state, the one that it sees best, is 1: 1 V, the stroke, on the rig.
    Each variance is one number for all, or one for each.

    Args:
        measurement: R, variance of the noise of a reading (sensors,).
        process: Q, variance per unit of scaled time of white noise on the rates of coordinates and velocities
            (2 coordinates,); internal states have none, and parameters have none.
        parameters: variance of the initial values of the parameters (k,).
        initial: variance of the initial coordinates and velocities (2 coordinates,); internal states are known.
        square_root: carry a triangular square root of the covariance, which cannot lose its sign or symmetry; by
            default the covariance itself, in the form of Joseph.
        iterated: times that the readings of a sample are made linear, each about the estimate before.

    Raises:
        ModelError: `iterated` is no count.
    """

    measurement: Variances = MEASUREMENT
    process: Variances = PROCESS
    parameters: Variances = PARAMETERS
    initial: Variances = INITIAL
    square_root: bool = False
    iterated: int = 1

    def __post_init__(self) -> None:
        if self.iterated < 1:
            raise ModelError(f"iterated is {self.iterated}: give the times that readings are made linear, 1 or more")


def extended_kalman(
    twin: Twin,
    record: Data,
    names: Sequence[str],
    settings: FilterSettings | None = None,
    *,
    validation: Sequence[Data] = (),
    start: Array | None = None,
    progress: Progress | None = None,
) -> KalmanFit:
    """Estimate parameters of a twin from a record, together with its state.

    Parameters on which others depend by an expression act through its derivatives, which are found anew wherever a
    parameter has moved by 2 %. A parameter with bounds is held inside them.

    Args:
        twin: the plant, with the values to begin from.
        record: commands and readings.
        names: of the parameters, as `Twin.parameter_names` has them; none to estimate the state only.
        settings: variances and form of the filter; those of section 4.2.2 by default.
        validation: records that the final values are validated on.
        start: the twin's state at the first sample, in SI units (states,); by default coordinates and velocities from
            a parabola through the first readings, internal states at rest.
        progress: called with the part done.

    Returns:
        Final values, their course over time, and the innovations.

    Raises:
        ModelError: a parameter is not known, named twice or a dead time, a variance is not positive (0 is allowed for
            `process` and `initial`) or their number is wrong, or `start` has the wrong length.
        RecordError: the record has other channels than the plant, or fewer than 4 samples.
        IntegrationError: the estimate diverged, or the covariance lost its sign; says when, and what to change.
    """
    settings = settings or FilterSettings()
    _check(twin, record)
    if not twin.model.coordinates:
        raise ModelError(
            f"{twin.base.name} has no coordinates, whose motion the filter follows; take the method least-squares"
        )
    sensing = Sensitivity(twin, tuple(names))
    if sensing.dead_times:
        late = ", ".join(names[i] for i in sensing.dead_times)
        raise ModelError(f"{late}: a filter cannot follow a dead time; take the method least-squares")
    scales, moving = _Scales.of(sensing), 2 * len(twin.model.coordinates)
    none = np.zeros(sensing.states - moving)
    r = _variances("measurement", settings.measurement, len(twin.sensors)) * scales.readings**2
    q = _variances("process", settings.process, moving, least=0.0) * scales.states[:moving] ** 2 / scales.time
    initial = _variances("initial", settings.initial, moving, least=0.0) * scales.states[:moving] ** 2
    parameters = _variances("parameters", settings.parameters, len(names)) * scales.parameters**2
    p0 = np.concatenate([initial, none, parameters])
    y = first_start(sensing, record) if start is None else np.array(start, dtype=float)
    if y.shape != (sensing.states,) or not np.isfinite(y).all():
        names_of_states = ", ".join(twin.state_names)
        raise ModelError(f"start must be {sensing.states} finite numbers, {names_of_states}; got shape {y.shape}")
    run = _Run(sensing, record, scales, r, np.concatenate([q, none]), settings)
    theta, covariance = run.filter(y.copy(), sensing.start(), p0, progress)
    result = run.result(theta, covariance, p0)
    return replace(result, validation=validated(sensing, theta, validation, 1.0 / r)) if validation else result


def _check(twin: Twin, record: Data) -> None:
    tables = ("commands", record.commands, twin.actuators), ("readings", record.readings, twin.sensors)
    for what, found, wanted in tables:
        if found.ndim != 2 or found.shape[1] != len(wanted):
            raise RecordError(f"{record.name}: {what} have shape {found.shape}; they must be of {', '.join(wanted)}")
        wrong = np.flatnonzero(~np.isfinite(found).all(axis=1))
        if len(wrong):
            raise RecordError(
                f"{record.name}: {what} are not finite at sample {wrong[0]}, and at {len(wrong)} samples in all; cut "
                "these out, and give the parts as records of their own"
            )
    if len(record) < 4:
        raise RecordError(f"{record.name}: it has {len(record)} samples; give a longer record")


def _variances(name: str, values: Variances, count: int, least: float | None = None) -> Array:
    """Variances (count,), each at least `least`, or else positive."""
    found = np.asarray(values, dtype=float)
    if found.ndim > 1 or (found.ndim == 1 and len(found) != count):
        raise ModelError(f"{name}: one variance, or {count}, are needed; got shape {found.shape}")
    wrong = ~np.isfinite(found) | (found <= 0.0 if least is None else found < least)
    if wrong.any():
        bound = "positive" if least is None else "0 or positive"
        raise ModelError(f"{name} is {np.atleast_1d(found)[np.atleast_1d(wrong)][0]:g}: a variance must be {bound}")
    return np.full(count, found) if found.ndim == 0 else found


@dataclass(frozen=True)
class _Scales:
    """What counts as 1: of time in s, states in SI units (states,), readings and parameters in declared units."""

    time: float
    states: Array
    readings: Array
    parameters: Array

    @classmethod
    def of(cls, sensing: Sensitivity) -> _Scales:
        """Scales of a twin with the values that it has."""
        twin = sensing.twin
        model, overrides = twin.model, twin.model.overrides
        time = model.units.size("s", overrides)
        lengths = [model.units.size(c.unit, overrides) for c in model.declaration.coordinates.values()]
        internal = [model.units.size(s.unit, overrides) for s in model.declaration.states.values()]
        speeds = [length / time for length in lengths]
        states = np.array([*lengths, *speeds, *internal, *(1.0,) * len(twin.chain_states)])
        _, jacobian = sensing.sensed(twin.rest(np.zeros(len(lengths))))
        seen = np.abs(jacobian * states).max(axis=1)
        readings = np.where(seen > 0.0, seen, 1.0)
        parameters = [cls._parameter(twin, name, time, readings) for name in sensing.names]
        return cls(time, states, readings, np.array(parameters))

    @staticmethod
    def _parameter(twin: Twin, name: str, time: float, readings: Array) -> float:
        model, found = twin.model, twin.parameter_names[name]
        if found is None:
            unit = model.declaration.parameters[name].unit
            return model.units.size(unit, model.overrides) / model.units.conversions[unit].factor
        effect, parameter = found
        unit = effect.entry.parameters[parameter].unit
        if unit == "S":
            return float(readings[twin.sensors.index(effect.at)])
        return time if unit == "s" else 1.0


def _filters(sensing: Sensitivity) -> Kernels:
    sizes, size = sensing.sizes, sensing.states + len(sensing.names)
    rows = 3 * sizes.sensors + size + 12 + 2 * sizes.states + sizes.moving_rows
    work = rows, max(3 * sizes.states, size, *sensing.widths)

    def factories() -> dict[str, tuple[Any, ...]]:
        return {
            "filter_full": (kalman_kernels.extended_filter, "slopes", "sensed", "carry", False),
            "filter_root": (kalman_kernels.extended_filter, "slopes", "sensed", "carry", True),
        }

    links = {**sensing.equations.by_signature(SLOPES, SENSED), **column_step.link(sizes.states, sizes.coordinates)}
    return linked("Kalman filters", factories, links, work)


def _is_affine(sensing: Sensitivity) -> bool:
    """Whether the twin depends on the parameters through sums and constant factors only."""
    twin, theta = sensing.twin, sensing.start()
    farther = np.clip(1.05 * theta + 0.01 * (theta == 0.0), *sensing.bounds())
    disabled = (effect for effect in twin.effects if not effect.enabled and effect.entry.where == "element")
    off = {f"{effect.label}_{name}" for effect in disabled for name in effect.entry.parameters}
    idle = {i for i, name in enumerate(twin.model.parameters) if name in off}
    acting = [row for row, index in enumerate(sensing.affected) if index not in idle]
    here, there = (sensing.basis(at)[1][acting] for at in (theta, farther))
    return bool(np.allclose(here, there, rtol=AFFINE, atol=AFFINE * float(np.abs(here).max(initial=0.0))))


@dataclass
class _Run:
    """A pass over a record: `r` (sensors,) and `q` (states,) per second are variances in the twin's own units."""

    sensing: Sensitivity
    record: Data
    scales: _Scales
    r: Array
    q: Array
    settings: FilterSettings

    def __post_init__(self) -> None:
        m, n, sensors, k = len(self.record), self.sensing.states, len(self.r), len(self.sensing.names)
        self.states, self.estimates, self.noises = np.empty((m, n)), np.empty((m, 2 * k)), np.empty((m, 2 * sensors))

    def filter(self, y: Array, theta: Array, p0: Array, progress: Progress | None) -> tuple[Array, Array]:
        """Parameters (k,) in declared units, and the covariance of state and parameters; writes their course.

        It begins from a state (states,), parameters (k,) and variances of both (states + k,). An IntegrationError says
        that the estimate diverged, or the covariance lost its sign.
        """
        sensing, record, m, is_root = self.sensing, self.record, len(self.record), self.settings.square_root
        matrix, is_affine = np.diag(np.sqrt(p0) if is_root else p0), _is_affine(sensing)
        filters = _filters(sensing)
        kernel = filters.filter_root if is_root else filters.filter_full
        low, high = (
            bound + sign * (INSIDE * self.scales.parameters + 4e-6 * np.where(np.isfinite(bound), np.abs(bound), 0.0))
            for sign, bound in zip((1.0, -1.0), sensing.bounds(), strict=True)
        )
        theta = np.clip(theta, low, high)
        acting, readings = np.ascontiguousarray(record.acting), np.ascontiguousarray(record.readings)
        substeps, is_linear = sensing.twin.resolving(record.rate), is_first_order(record.hold)
        derivatives = np.zeros((COLUMN_ROWS * sensing.states, whole_lanes(len(theta) + sensing.states)))
        p, basis = self._basis(theta)
        affected, at = np.array(sensing.affected or (0,), dtype=np.int64), 0
        found = Filtered(self.states, self.estimates, self.noises)
        for piece in range(1, PIECES + 1):
            end = m * piece // PIECES
            if not is_affine:
                p, basis = self._basis(theta)
            while at < end:
                moved = MOVED * np.maximum(np.abs(theta), 0.1 * self.scales.parameters)
                moved_by = terms(sensing.equations, basis)[:2]
                table = np.array([low, high, np.full_like(theta, np.inf) if is_affine else moved])
                steps = FilterSteps(at, end - at, 1.0 / record.rate, substeps, is_linear, self.settings.iterated)
                twin = FilteredTwin(sensing.sizes.coordinates, affected, y, theta, p, basis, *moved_by)
                given = FilterRecord(acting, readings, self.r, self.q, table)
                status, at = kernel(steps, twin, matrix, derivatives, given, found)
                if status in (NOT_FINITE, NOT_POSITIVE):
                    raise IntegrationError(self._remedy(status, at, len(theta)))
                if status == LINEARISE:
                    p, basis = self._basis(theta)
            if progress is not None:
                progress(piece / PIECES)
        return theta, matrix @ matrix.T if is_root else matrix

    def _basis(self, theta: Array) -> tuple[Array, Array]:
        p, basis = self.sensing.basis(theta)
        # The machine code wants an address, of which an array without any element has none to give.
        return p, basis if basis.size else np.zeros((max(1, basis.shape[0]), basis.shape[1]))

    def _remedy(self, status: int, at: int, k: int) -> str:
        when = f"at t = {at / self.record.rate:.6g} s, sample {at} of {self.record.name}"
        if status == NOT_POSITIVE:
            other = "raise measurement" if self.settings.square_root else "give square_root=True, raise measurement"
            return f"the covariance of the filter is not positive any more {when}; {other}, or lower parameters"
        lower = "lower parameters, or raise measurement" if k else "raise process or measurement"
        return f"the filter diverged {when}: its estimate is no longer finite; {lower}, or begin closer"

    def result(self, theta: Array, covariance: Array, p0: Array) -> KalmanFit:
        sensing, record, n, k = self.sensing, self.record, self.sensing.states, len(self.sensing.names)
        sensors = sensing.twin.sensors
        try:
            squares = nearest(sensing, theta, record, 1.0 / self.r)[1].squares
        except IntegrationError:
            squares = np.full(len(sensors), np.nan)
        found = KalmanFit(
            twin=sensing.twin_at(theta), names=sensing.names, values=theta, covariance=covariance[n:, n:],
            chi=relative(sensors, [record], squares), floor=noise_alone(sensors, [record]),
            times=np.arange(len(record)) / record.rate, trajectory=self.estimates[:, :k].copy(),
            deviations=self.estimates[:, k:].copy(), states=self.states,
            innovations=self.noises[:, : len(sensors)].copy(), normalised=self.noises[:, len(sensors) :].copy(),
            final=covariance,
        )  # fmt: skip
        return replace(found, notes=tuple(self._notes(found, p0[n:])))

    def _notes(self, found: KalmanFit, p0: Array) -> list[str]:
        notes = []
        mean, low, high = found.consistency
        expected = len(self.r)
        if mean > 1.5 * expected:
            notes.append(
                f"the innovations are {np.sqrt(mean / expected):.2g} times as large as the filter expects: the values "
                "are less sure than is said; raise measurement or process, or correct the model"
            )
        elif mean < expected / 1.5:
            notes.append(
                f"the innovations are {np.sqrt(expected / max(mean, 1e-300)):.2g} times as small as the filter "
                "expects: the values may be surer than is said; lower measurement or process"
            )
        coloured = [name for name, chance in found.whiteness.items() if chance < DOUBTED]
        if coloured and mean > low:
            notes.append(f"the innovations of {', '.join(coloured)} are not white: something is left to be modelled")
        far = (np.abs(found.values - self.sensing.start()) > FARTHER * np.sqrt(p0)) & (mean > high)
        notes += [
            f"{name} moved by more than {FARTHER:g} of its initial deviations; raise parameters, or begin closer"
            for name in itertools.compress(found.names, far)
        ]
        low_bound, high_bound = self.sensing.bounds()
        near = 2.0 * INSIDE * self.scales.parameters
        at_bound = (found.values < low_bound + near) | (found.values > high_bound - near)
        return [*notes, *(f"{name} is held at its bound" for name in itertools.compress(found.names, at_bound))]


@dataclass(frozen=True, repr=False, kw_only=True)
class KalmanFit(Estimate):
    """Final values of parameters that a filter found, how sure it is of them, and whether its assumptions hold.

    The covariance is that of the values if the noise is as assumed by the filter.
    """

    times: Array  # of the samples, s (m,)
    trajectory: Array  # values after each sample (m, k)
    deviations: Array  # standard deviations after each sample (m, k)
    states: Array  # the twin's state after each sample (m, states), in SI units
    innovations: Array  # readings less what was expected of them, in their units (m, sensors)
    normalised: Array  # innovations made independent with deviation 1, if the filter's assumptions hold (m, sensors)
    final: Array  # covariance of state and parameters after the last sample (states + k, states + k)

    @property
    def nis(self) -> Array:
        """Normalised innovation squared e^T S^-1 e of each sample (m,).

        Chi-squared with as many degrees of freedom as there are sensors, if the filter's assumptions hold.
        Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), 5.4.2.
        """
        return np.asarray((self.normalised**2).sum(axis=1))

    @property
    def consistency(self) -> tuple[float, float, float]:
        """Mean of the normalised innovation squared, and the 95 % interval that it should be in."""
        m, sensors = self.normalised.shape
        low, high = 2.0 * special.gammaincinv(0.5 * m * sensors, [0.025, 0.975]) / m
        return float(self.nis.mean()), float(low), float(high)

    @property
    def autocorrelation(self) -> Array:
        """Correlation of each normalised innovation with itself 1, 2, ... samples later (lags, sensors).

        About 1 / sqrt(m) and no more where innovations are white. The mean is not taken off: it should be 0.
        """
        lags = min(LAGS, len(self.normalised) - 1)
        return np.column_stack([autocorrelation(e, lags) for e in self.normalised.T])

    @property
    def whiteness(self) -> dict[str, float]:
        """Probability of innovations at least as correlated as these if they were white, by sensor."""
        chances = ljung_box(self.autocorrelation, len(self.normalised))
        return dict(zip(self.twin.sensors, map(float, chances), strict=True))

    def as_dict(self) -> dict[str, Any]:
        """Fit as JSON can hold it; what is over time is left out."""
        mean, low, high = self.consistency
        train = {name: value if np.isfinite(value) else None for name, value in self.chi.items()}
        return {
            "parameters": self.parameters(),
            "chi": {"train": train, "validation": self.validation},
            "floor": self.floor,
            "nis": {"mean": mean, "low": low, "high": high},
            "whiteness": self.whiteness,
            "notes": list(self.remarks),
        }

    def __str__(self) -> str:
        mean, low, high = self.consistency
        return "\n".join([*self.lines(), f"NIS {mean:.3g}, expected {low:.3g} to {high:.3g}", *self.remarks])
