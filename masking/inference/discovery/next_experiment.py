"""Next experiment: the excitation that separates two explanations best, found by simulation.

The rig with the one explanation is simulated under excitations within its limits; the other is fitted to what its
sensors would read. The residual, in standard deviations of the noise, is how well the excitation separates them. What
a fit would leave follows to first order from the derivatives of one simulation: the excitations that separate most by
these are fitted, until none separates more than the best fit does, or as much is simulated as the searches took.
Source: Hunter and Reiner (1965), Technometrics 7(3), 307-323: designs for discriminating between two rival models.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from heapq import heappop, heappush
from typing import Any

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.display.json_text import Result
from masking.errors import IntegrationError
from masking.inference.discovery import continuation, fitting
from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.decision_rules import RULES
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.fitting import Begun, Hypothesis
from masking.inference.estimation.identification_data import Data
from masking.lab.records.record_form import Hold
from masking.lab.signals import multisines

FACTORS = (3.0, 1.0)  # of the record's own size, as far as limits allow
PERIODS, BANDS = 3, 3  # of a multisine in an experiment; of one kind, over all frequencies together
FASTEST = 0.1  # highest frequency, of the rate of samples
STEPS = "row of growing steps"

Excitation = tuple[str, dict[str, Any], Array]  # what it is, its settings, and commands (m, actuators)


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
    problem = replace(problem, work=problem.work.again())
    size = np.abs(problem.record.commands).max(axis=0)
    most = np.maximum(FACTORS[0] * size, 1e-12) if limits is None else limits
    peaks = np.unique([np.minimum(factor * size, most) for factor in FACTORS], axis=0)[::-1]

    def separation(excitation: Excitation, way: int, *, fitted: bool) -> float:
        truth, other = (second, first) if way else (first, second)
        return _left(problem, excitation[2], truth, other, fitted=fitted)

    every, best, queue = list[Excitation](), None, list[tuple[float, int, int]]()
    for i, one in enumerate(_excitations(problem, peaks, rates)):
        if not every or not problem.work.is_over:
            every.append(one)
            heappush(queue, (-separation(one, 0, fitted=False), 1, i))
    while queue:  # the one that may separate most: one way is the most that the smaller of both may be
        foreseen, ways, i = heappop(queue)
        if best is not None and (-foreseen <= best.separation or problem.work.is_over):
            break
        if ways == 1:
            heappush(queue, (max(foreseen, -separation(every[i], 1, fitted=False)), 2, i))
            continue
        parted = min(separation(every[i], way, fitted=True) for way in range(ways))
        if best is None or parted > best.separation:
            name, settings, commands = every[i]
            best = NextExperiment(name, settings, parted, names, commands, problem.rules.separation)
    return best


def declared_limits(twin: Twin) -> Array | None:
    """Largest command of each actuator that the plant file declares (actuators,); None where it does not."""
    declared = twin.declaration.limits.inputs
    if any(name not in declared for name in twin.actuators):
        return None
    ports = twin.declaration.actuators or twin.base.inputs
    return np.array([declared[n].max * twin.size(declared[n].unit) / twin.size(ports[n].unit) for n in twin.actuators])


def _left(problem: EstimationProblem, commands: Array, truth: Hypothesis, other: Hypothesis, *, fitted: bool) -> float:
    """Cost of one explanation beyond that of another on readings that this simulates; 0 if the motion is not finite.

    It is that of a fit, or of what derivatives foresee of it.
    """
    hold: Hold = "first-order" if problem.rig.twin.measured_actuators else "zero-order"
    nothing, start = np.zeros((len(commands), len(problem.sigma))), problem.rig.rest[None]
    record = Data("simulated", problem.record.rate, commands, nothing, hold=hold)
    free = replace(problem, record=record, interval=0)
    try:
        made = free.equations(truth.theta, start, truth.instances, truth.added, frozen=True)
        pretended = replace(free, record=replace(record, readings=made.simulated))
        if not fitted:
            return fitting.foreseen(pretended, Begun(other.instances, other.theta, start)) - truth.pull
        rounds = continuation.ROUNDS
        found = fitting.fit(pretended, other.instances, theta=other.theta, start=start, rounds=rounds)
    except IntegrationError:
        return 0.0
    return found.cost - truth.pull


def _rates(rig: AugmentedModel) -> dict[int, int] | None:
    """Which measured input is the rate of which other, by their numbers; None where that is not known of all."""
    twin, found = rig.twin, dict[int, int]()
    names = {name: i for i, name in enumerate(twin.actuators)}
    for element in twin.base.elements.values():
        x, rate = (None if one is None else one.text.strip() for one in (element.displacement, element.rate))
        if x in names and rate in names:
            found[names[rate]] = names[x]
    return found if {names[name] for name in twin.measured_actuators} <= {*found, *found.values()} else None


def _excitations(problem: EstimationProblem, peaks: Array, rates: Mapping[int, int]) -> Iterator[Excitation]:
    """Excitations with each row of peaks, in which each rate is that of its displacement; a step would have none."""
    actuators, t = problem.rig.twin.actuators, np.arange(len(problem.record)) / problem.record.rate
    for row in peaks:
        for name, ends, waves in _waves(t, len(actuators)):
            commands, stated = waves * row, row.copy()
            for rate, x in rates.items():
                commands[:, rate] = np.gradient(commands[:, x]) * problem.record.rate
                stated[rate] = np.abs(commands[:, rate]).max()
            if not (rates and name == STEPS):
                peak = {actuator: float(f"{value:.3g}") for actuator, value in zip(actuators, stated, strict=True)}
                yield name, {"peak": peak, **ends, "seconds": len(t) / problem.record.rate}, commands


def _waves(t: Array, many: int) -> Iterator[Excitation]:
    """Shapes of excitations of some actuators (m, many) over time, whose peak is 1, and their frequencies."""
    seconds = len(t) * t[1]
    period = seconds / PERIODS
    ends = np.geomspace(1.0, max(FASTEST * period / t[1], 2.0), BANDS + 1).round().astype(int)
    for low, high in itertools.pairwise(ends):
        lines, columns = np.arange(low, high + 1), []
        for i in range(many):
            own = lines[i::many] if len(lines) >= many else lines
            phases = multisines.schroeder_phases(np.ones(len(own)))
            wave = multisines.wave((PERIODS * own).tolist(), np.exp(1j * phases), len(t))
            columns.append(wave / np.abs(wave).max())
        stated = {"lowest": f"{low / period:.2g} Hz", "highest": f"{high / period:.2g} Hz"}
        yield "multisine", stated, np.array(columns).T
    shape = np.interp(t / seconds, [0.0, 0.25, 0.75, 1.0], [0.0, 1.0, -1.0, 0.0])
    yield "ramp", {}, np.array([np.roll(shape, i * len(t) // many) for i in range(many)]).T
    turns = np.outer(t / seconds, 6.0 + 2.0 * np.arange(many))
    yield STEPS, {}, np.sign(np.sin(2.0 * np.pi * turns)) * (t / seconds)[:, None]
