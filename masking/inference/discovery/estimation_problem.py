"""Problem: a record, the augmented model of its rig, the prior of the parameters and the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.compile.numerics.effect_table import NEARLY_ZERO
from masking.compile.numerics.kernel_arguments import Readings, Shooting, Steps, Sums, TwinArrays
from masking.compile.numerics.rig_sizes import COLUMN_ROWS, whole_lanes
from masking.errors import IntegrationError
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance, Equations
from masking.inference.discovery.decision_rules import RULES, DecisionRules
from masking.inference.discovery.discrepancy import independent
from masking.inference.discovery.parameter_prior import Prior
from masking.inference.discovery.trace import Trace
from masking.inference.discovery.work_budget import Work
from masking.inference.estimation.identification_data import Data, is_first_order
from masking.inference.estimation.initial_states import FIRST_READINGS, guessed_state
from masking.inference.estimation.sensitivity import symmetric, terms
from masking.inference.estimation.simulation import relative


@dataclass(frozen=True)
class EstimationProblem:
    """A record and the rig that is fitted to it."""

    rig: AugmentedModel  # the rig
    record: Data  # commands and readings
    prior: Prior  # of the rig's parameters
    sigma: Array  # standard deviation of the noise of each reading (sensors,)
    substeps: int  # integration steps between samples
    interval: int = 0  # samples of a shooting interval; 0 for one interval that is the whole record
    rules: DecisionRules = RULES  # the thresholds of all decisions
    # simulation that was done for it; problems that are made of it share that
    work: Work = field(default_factory=partial(Work, np.inf), compare=False)
    trace: Trace = field(default_factory=Trace, compare=False)  # what was fitted, in any reading of the record

    def under(self, reading: str) -> EstimationProblem:
        """Problem whose fits are noted as of another reading of the record."""
        return replace(self, trace=self.trace.under(reading))

    def apart(self, part: float = 1.0) -> EstimationProblem:
        """Problem with a count of work of its own, which may be a part of what this one may do."""
        return replace(self, work=self.work.another(part))

    @property
    def interval_samples(self) -> int:
        """Samples of a shooting interval, which may be the whole record."""
        return self.interval or len(self.record)

    @property
    def intervals(self) -> int:
        """Number of shooting intervals."""
        return -(-len(self.record) // self.interval_samples)

    @property
    def weights(self) -> Array:
        """Weights of squared residuals (sensors,)."""
        return np.asarray(self.sigma**-2.0)

    def spreads(self, instance: EffectInstance) -> list[float]:
        """Standard deviation among instruments of each estimated parameter of an effect; infinite without one."""
        tables = {"sensor": self.record.readings, "actuator": self.record.commands}
        if not instance.at or instance.where not in tables:  # a delay of all actuators has none
            return [np.inf] * len(instance.free)
        largest = float(np.abs(tables[instance.where][:, self.rig.index(instance)]).max())
        return [instance.entry.parameters[name].deviation(largest) for name in instance.names]

    def independent(self, residuals: Array) -> Array:
        """Number of independent samples that residuals (m, sensors) are worth, of each sensor (sensors,)."""
        return independent(residuals, self.record.readings, self.sigma, self.rules.chance_deviations)

    @property
    def noise_floor(self) -> dict[str, float]:
        """Relative error of each sensor that the noise alone makes."""
        return self.errors(len(self.record) * self.sigma**2)

    def errors(self, squares: Array) -> dict[str, float]:
        """Relative error of each sensor, by name, from squared residuals (sensors,)."""
        return relative(self.rig.twin.sensors, [self.record], squares)

    @property
    def dt(self) -> float:
        """Time between samples in s."""
        return 1.0 / self.record.rate

    def first_states(self, theta: Array, samples: int = FIRST_READINGS) -> Array:
        """Guess of initial states (w, states), from straight lines through some samples of the first readings."""
        rig, record, acting = self.rig, self.record, self.record.acting
        found = []
        for begin in range(0, len(record), self.interval_samples):
            early = min(begin, max(len(record) - samples, 0))  # the line of a short last interval begins before it
            read = record.readings[early:][:samples]
            times = (np.arange(len(read)) + early - begin) / record.rate
            at_rest = rig.reading(theta, rig.rest, acting[begin])
            found.append(guessed_state(rig.rest, at_rest, rig.twin.free, times, read, n=len(rig.coordinates), degree=1))
        return np.array(found)

    def in_steps(self, instance: EffectInstance, *, sticks: bool | None = None) -> EffectInstance:
        """Instance with the parameters that follow the step of integration, if it sticks; by default as it does."""
        if not (instance.sticks if sticks is None else sticks):
            return instance
        return instance.at_step(self.rig.mobilities[instance.at], self.dt / self.substeps)

    def equations(
        self,
        theta: Array,
        start: Array,
        instances: Sequence[EffectInstance] = (),
        added: Array | None = None,
        *,
        inner: Array | None = None,
        weights: Array | None = None,
        frozen: bool = False,
    ) -> Equations:
        """Normal equations of the record at values of the parameters.

        Args:
            theta: parameters of the rig (k,), in declared units.
            start: initial states of the shooting intervals (w, states).
            instances: effects, one after the other.
            added: their free parameters (f,).
            inner: where their states begin (s,); at 0 where this is not given.
            weights: of squared residuals in the equations (sensors,); those of the noise by default.
            frozen: whether the parameters are known: their rows and columns are 0, which takes less time.

        Raises:
            IntegrationError: the motion is no longer finite.
        """
        rig, record = self.rig, self.record
        given = rig.given(instances, np.concatenate([theta, np.empty(0) if added is None else added]))
        n, moving, intervals = len(rig.twin.state_names), len(rig.twin.free), self.intervals
        states = given.trial.states - n
        basis, late_columns, every = given.basis, given.late_columns, given.basis.shape[1] + states
        if frozen:
            basis, late_columns = np.zeros((len(basis), 0)), np.full_like(late_columns, -1)
        k = basis.shape[1] + states
        width = k + moving
        y = np.full(n + states, NEARLY_ZERO)
        derivatives = np.zeros((COLUMN_ROWS * (n + states), whole_lanes(width)))
        y[n:] += 0.0 if inner is None else inner
        self.work.add(len(record) * self.substeps, len(y) + width)
        derivatives[n : n + states, k - states : k] = np.eye(states)
        matrices, gradients = np.zeros((intervals * width, whole_lanes(width))), np.zeros(intervals * width)
        squares, simulated = np.zeros(len(rig.twin.sensors)), np.empty_like(record.readings)
        late = given.late / self.dt
        steps = Steps(len(record), self.dt, self.substeps, is_first_order(record.hold))
        shooting = Shooting(k, np.array(rig.twin.free, dtype=np.int64), np.ascontiguousarray(start), y, derivatives)
        delayed = record.late + late, len(basis), late_columns, np.empty(len(late))
        arrays = TwinArrays(given.p, *terms(given.trial.equations, basis), given.trial.sizes.coordinates, *delayed)
        readings = Readings(record.commands, record.counted(late), self.weights if weights is None else weights)
        sums = Sums(matrices, gradients, squares, simulated)
        status = given.trial.kernels.normal(steps, self.interval_samples, shooting, arrays, readings, sums)
        if status or not np.isfinite(squares).all() or not np.isfinite(matrices).all():
            raise IntegrationError("the simulated motion is no longer finite")
        matrix, gradient = np.zeros((every + intervals * moving,) * 2), np.zeros(every + intervals * moving)
        for i in range(intervals):
            own = np.concatenate([np.arange(every - k, every), every + i * moving + np.arange(moving)])
            matrix[np.ix_(own, own)] += matrices[i * width : (i + 1) * width, :width]
            gradient[own] += gradients[i * width : (i + 1) * width]
        return Equations(symmetric(matrix), gradient, squares, simulated, record.residuals(simulated, late))
