"""Next experiment: the excitation that separates two explanations best, found by simulation.

The rig with the one explanation is simulated under excitations within its limits; the other is fitted to what its
sensors would read. The residual, in standard deviations of the noise, is how well the excitation separates them.
Source: Hunter and Reiner (1965), Technometrics 7(3), 307-323: designs for discriminating between two rival models.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.display.json_text import Result
from masking.errors import IntegrationError
from masking.inference.discovery import fitting
from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.rules import RULES
from masking.inference.discovery.smoothing import modes
from masking.inference.estimation.identification_data import Data
from masking.lab import signals
from masking.lab.records.input_hold import Hold

# Times and frequencies of a rig whose slowest mode is between 0.5 and 5 Hz; they go with its decade.
SECONDS = 30.0
BANDS = ((0.05, 0.5), (0.5, 3.0), (3.0, 12.0))  # Hz
PERIOD = 10.0  # s
USUAL = 1.6  # Hz
FACTORS = (1.0, 3.0)  # of the record's own size, as far as limits allow
STEPS = "row of growing steps"


@dataclass(frozen=True)
class NextExperiment(Result):
    """An excitation that separates two explanations."""

    excitation: str  # what it is, such as "ramp"
    settings: dict[str, Any]  # peak of each actuator in its unit, and what else it takes
    separation: float  # of the two explanations, as a difference of -2 log likelihood; the smaller of both ways
    between: tuple[str, str]  # their names
    commands: Array  # of the actuators (m, actuators)
    threshold: float = RULES.separation  # separation from which they are separated
    json_names = ("excitation", "settings", "separation", "separates", "between")

    @property
    def separates(self) -> bool:
        """Whether it separates them."""
        return self.separation > self.threshold

    @property
    def peaks(self) -> dict[str, float]:
        """Peak of each actuator in its unit."""
        return dict(self.settings["peak"])

    @property
    def pace(self) -> str:
        """Frequencies and length as text: '3 to 12 Hz, 30 s long'."""
        length = f"{self.settings['seconds']:g} s long"
        if "lowest" not in self.settings:
            return length
        return f"{self.settings['lowest'].removesuffix(' Hz')} to {self.settings['highest']}, {length}"


def next_experiment(
    problem: EstimationProblem, first: Hypothesis, second: Hypothesis, names: tuple[str, str], limits: Array | None
) -> NextExperiment | None:
    """Excitation, of those that are tried, that separates two explanations best, with their names.

    A component is moved as far, and its rate is that of this displacement; None of a rig without inputs, and where it
    is not known which measured input is the rate of which. Limits are the largest command of each actuator
    (actuators,); three times the record's where there are none.
    """
    rates = _rates(problem.rig)
    if rates is None or not problem.rig.twin.actuators:
        return None
    size = np.abs(problem.record.commands).max(axis=0)
    most = np.maximum(FACTORS[-1] * size, 1e-12) if limits is None else limits

    def tried(name: str, settings: dict[str, Any], commands: Array) -> NextExperiment:
        both = ((first, second), (second, first))
        separation = min(_left(problem, commands, truth, other) for truth, other in both)
        return NextExperiment(name, settings, separation, names, commands, problem.rules.separation)

    return max((tried(*one) for one in _possible(problem, size, most, rates)), key=lambda one: one.separation)


def declared_limits(twin: Twin) -> Array | None:
    """Largest command of each actuator that the plant file declares (actuators,); None where it does not."""
    declared = twin.declaration.limits.inputs
    if any(name not in declared for name in twin.actuators):
        return None
    ports = twin.declaration.actuators or twin.base.inputs
    return np.array([declared[n].max * twin.size(declared[n].unit) / twin.size(ports[n].unit) for n in twin.actuators])


def _left(problem: EstimationProblem, commands: Array, truth: Hypothesis, other: Hypothesis) -> float:
    """Cost of one explanation on readings that the other one simulates."""
    hold: Hold = "first-order" if problem.rig.twin.measured_actuators else "zero-order"
    nothing = np.zeros((len(commands), len(problem.sigma)))
    record = Data("simulated", problem.record.rate, commands, nothing, hold=hold)
    state = problem.rig.rest[None]
    free = replace(problem, record=record, interval=0)
    try:
        made = free.equations(truth.theta, state, truth.instances, truth.added)
        pretended = replace(free, record=replace(record, readings=made.simulated))
        return fitting.fit(pretended, other.instances, theta=other.theta, start=state, rounds=12).cost
    except IntegrationError:
        return 0.0


def _pace(problem: EstimationProblem) -> float:
    """Decade of the slowest mode of the rig over that of usual rigs; 1 of a rig that has no states."""
    if not problem.rig.twin.state_names:
        return 1.0
    every = modes(problem.rig, problem.prior.mean)
    speeds = np.abs(every[every.imag != 0.0] if (every.imag != 0.0).any() else every)
    slowest = float(np.min(speeds[speeds > 0.0], initial=np.inf))
    return float(10.0 ** np.round(np.log10(slowest / (2.0 * np.pi * USUAL)))) if np.isfinite(slowest) else 1.0


def _rates(rig: AugmentedModel) -> dict[int, int] | None:
    """Which measured input is the rate of which other, by their numbers; None where that is not known of all."""
    twin, found = rig.twin, dict[int, int]()
    names = {name: i for i, name in enumerate(twin.actuators)}
    for element in twin.base.elements.values():
        x, rate = (None if one is None else one.text.strip() for one in (element.displacement, element.rate))
        if x in names and rate in names:
            found[names[rate]] = names[x]
    return found if {names[name] for name in twin.measured_actuators} <= {*found, *found.values()} else None


def _possible(
    problem: EstimationProblem, size: Array, most: Array, rates: Mapping[int, int]
) -> Iterator[tuple[str, dict[str, Any], Array]]:
    """Excitations in which each rate is that of its displacement; a step would have none."""
    for name, settings, commands in _excitations(problem, size, most):
        if rates and name == STEPS:
            continue
        made, stated = commands.copy(), dict(settings)
        for rate, x in rates.items():
            made[:, rate] = np.gradient(commands[:, x]) * problem.record.rate
        if rates:
            peaks = zip(problem.rig.twin.actuators, np.abs(made).max(axis=0), strict=True)
            stated["peak"] = {actuator: float(f"{peak:.3g}") for actuator, peak in peaks}
        yield name, stated, made


def _excitations(problem: EstimationProblem, size: Array, most: Array) -> Iterator[tuple[str, dict[str, Any], Array]]:
    rate, actuators, pace = problem.record.rate, problem.rig.twin.actuators, _pace(problem)
    seconds, period = SECONDS / pace, PERIOD / pace
    t = np.arange(round(seconds * rate)) / rate
    for factor in FACTORS:
        peaks = np.minimum(factor * size, most)
        peak_of = {name: float(f"{peak:.3g}") for name, peak in zip(actuators, peaks, strict=True)}
        for low, high in ((pace * low, pace * high) for low, high in BANDS if pace * high < 0.5 * rate):
            lines = np.arange(max(1, round(low * period)), round(high * period) + 1)
            columns = []
            for i in range(len(actuators)):
                own = lines[i :: len(actuators)] if len(lines) >= len(actuators) else lines
                phases = signals.schroeder_phases(np.ones(len(own)))
                wave = signals.Multisine.harmonic(own, period, phases=phases).sample(t)
                columns.append(wave / np.abs(wave).max())
            ends = {"lowest": f"{lines[0] / period:g} Hz", "highest": f"{lines[-1] / period:g} Hz"}
            yield "multisine", {"peak": peak_of, **ends, "seconds": seconds}, np.array(columns).T * peaks
        shape = np.interp(t / seconds, [0.0, 0.25, 0.75, 1.0], [0.0, 1.0, -1.0, 0.0])
        shifted = [np.roll(shape, i * len(t) // len(actuators)) for i in range(len(actuators))]
        yield "ramp", {"peak": peak_of, "seconds": seconds}, np.array(shifted).T * peaks
        turns = np.outer(t / seconds, 6.0 + 2.0 * np.arange(len(actuators)))
        steps = np.sign(np.sin(2.0 * np.pi * turns)) * (t / seconds)[:, None]
        yield STEPS, {"peak": peak_of, "seconds": seconds}, steps * peaks
