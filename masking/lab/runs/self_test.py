"""Self-test of a rig before it is armed: a small pulse of each actuator, compared with the readings of the twin.

As much follows in the other direction, so that a rig that nothing holds is left without a momentum.

It runs by `runs.realtime` under the rules of `runs.safety_limits`, with the pulse as the largest command: more never
reaches the plant. The twin is at rest when the test begins; so must the rig be.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from masking.compile.numerics import safety_tables
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.controller_sizes import LARGEST
from masking.control.known_instruments import Instruments
from masking.control.rig.twin import Twin
from masking.display.json_text import Result
from masking.display.printed_result import Printed
from masking.errors import MaskingError, ModelError, PlantError, PlantMismatchError
from masking.lab.plants.interface import Plant, Settings
from masking.lab.plants.safety_chain import Rules, Trip
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.runs import safety_limits
from masking.lab.runs.realtime import Hooks, Look, check_channels, run_rig
from masking.model.declaration.schema import EffectChange

SIZE: Final = 0.05  # of the largest command
RATE: Final = 500.0  # Hz
_QUIET: Final = 0.3  # s before a pulse, in which the noise is measured
_PULSE: Final = (
    0.1  # s in each direction, at most: shorter where the twin moves by more than the next part of a limited coordinate
)
_MOVED: Final = 0.1
_AFTER: Final = 0.2  # s of the answer that are compared
_LONG: Final = _QUIET + 2.0 * _PULSE + _AFTER  # s that are compared, and what is before
_REST: Final = 20.0  # s at most until the rig is at rest again
_CLEAR: Final = 6.0  # times the noise that an answer must be
_DEAD: Final = 0.2  # of the predicted answer
_GAIN: Final = (0.5, 2.0)  # of the predicted answer
_NOISY: Final = 5.0  # times the declared noise


@dataclass(frozen=True, repr=False)
class Answer(Printed):
    """How one sensor answered the pulse of one actuator."""

    actuator: str  # which was moved
    sensor: str  # which is looked at
    predicted: float  # the largest change that the twin reads, in the sensor's unit
    noise: float  # of the sensor, standard deviation: that at rest, or what is declared where that is more
    at_rest: float  # standard deviation of what was read before the pulse
    gain: float  # what was read per what was predicted, least squares

    @property
    def is_clear(self) -> bool:
        """Whether the prediction stands out of the noise, so that the gain says something."""
        return self.predicted > _CLEAR * self.noise

    def __str__(self) -> str:
        if not self.is_clear:
            return f"{self.actuator} -> {self.sensor}: {self.predicted:.3g} predicted, within noise of {self.noise:.2g}"
        return f"{self.actuator} -> {self.sensor}: {self.gain:.2f} of {self.predicted:.3g}, noise {self.noise:.2g}"


@dataclass(frozen=True, repr=False)
class SelfTest(Printed, Result):
    """Outcome of a self-test."""

    answers: tuple[Answer, ...]  # of each sensor to each actuator
    findings: tuple[str, ...]  # why the rig must not be armed, a sentence each; none where it may

    @property
    def is_answered(self) -> bool:
        """Whether a sensor answers each actuator, in the right direction, and none with noise alone."""
        clear = [one for one in self.answers if one.is_clear]
        moved = {one.actuator for one in clear if one.gain > _DEAD}
        return bool(moved) and moved == {one.actuator for one in self.answers} and all(x.gain > -_DEAD for x in clear)

    @property
    def headline(self) -> str:
        """Whether the rig may be armed, and why not."""
        return "; ".join(["fails", *self.findings] if self.findings else ["passes"])

    def __str__(self) -> str:
        return "\n".join([*map(str, self.answers), *self.findings, "fails" if self.findings else "passes"])

    def check(self) -> None:
        """Refuse a rig that must not be armed, with a PlantError that says what was found."""
        if self.findings:
            raise PlantError(f"the self-test refuses to arm: {'; '.join(self.findings)}")


def self_test(
    twin: Twin,
    plant: Plant,
    *,
    size: float = SIZE,
    rate: float = RATE,
    lockstep: bool = False,
    acknowledge: bool = False,
    look: Look | None = None,
) -> SelfTest:
    """Pulse each actuator in turn, and compare what the sensors read with what those of the twin do.

    The plant is at rest and not active; it is deactivated on every way out. A pulse is a part of at most 1, `size`, of
    the largest command. `acknowledge` says that somebody has looked at why the plant tripped in the last run;
    `look` is called with the safety chain, which it may stop, and the tick of each sample.

    A ModelError where an actuator has no largest command, there is no sensor, or the twin does not rest, a
    PlantMismatchError where the plant has other channels or the size is none, a PlantError where it is lost or refuses,
    and a MaskingError where the test was interrupted.
    """
    if not 0.0 < size <= 1.0:
        raise PlantMismatchError(f"the size of a pulse is {size:g} of the largest command; give a part up to 1")
    if not twin.sensors:
        raise ModelError(f"{twin.declaration.name}: no sensor shows what an actuator does; declare some under sensors")
    rules = safety_limits.rules(Instruments.of(twin), rate, twin)
    held = replace(safety_limits.without_model(rules), commands=rules.commands.copy())  # answers are compared here
    held.commands[:, LARGEST] *= size
    quiet = {e.path.removeprefix("effects.") for e in twin.effects if e.entry.where == "sensor" and e.entry.deviation}
    ideal = twin.changed({**twin.changes, **dict.fromkeys(quiet, EffectChange(enabled=False))})
    answers = list[Answer]()
    for j in range(len(twin.actuators)):
        seconds, (predicted, fault) = _PULSE, _predicted(ideal, held, j, _PULSE)
        while seconds * rate > 2.0 and (fault is not None or part_moved(held, predicted) > _MOVED):
            seconds *= 0.5
            predicted, fault = _predicted(ideal, held, j, seconds)
        if fault is not None:
            raise ModelError(
                f"{twin.declaration.name}: its twin does not stay within its limits, without commands or under a pulse "
                f"of {size:.0%} of {twin.actuators[j]} ({fault}); a rig that is tested must rest without commands: "
                "correct the plant file, or find what is missing in a record of its closed loop by 'masking discover'"
            )
        read, trip = _Pulse(held, j, seconds).run(plant, twin, lockstep=lockstep, acknowledge=acknowledge, look=look)
        if trip is not None:
            return SelfTest(tuple(answers), (f"{twin.actuators[j]}: {trip}",))
        answers += _answers(twin, j, predicted, read)
    return SelfTest(tuple(answers), tuple(_findings(twin, tuple(answers), size)))


def allowed(twin: Twin) -> float:
    """Command that every actuator of a plant file may be given; a ModelError where one has no largest command."""
    return float(Instruments.of(twin).limits()[:, LARGEST].min())


def part_moved(rules: Rules, read: Array) -> float:
    """Largest part of a limited coordinate over which readings (samples, sensors) went."""
    far = np.ptp(read @ rules.weights.T, axis=0) if len(rules.weights) else np.zeros(0)
    is_position = rules.limits[:, safety_tables.OVER] == 0.0
    return float(np.max((far / rules.limits[:, safety_tables.BOUND])[is_position], initial=0.0))


def _predicted(ideal: Twin, rules: Rules, at: int, seconds: float) -> tuple[Array, Trip | None]:
    return _Pulse(rules, at, seconds).run(SimulatedPlant(ideal), None, lockstep=True)


class _Pulse:
    """A pulse of one actuator, as a controller, with the largest command of the rules."""

    def __init__(self, rules: Rules, at: int, seconds: float) -> None:
        self.rules, self.at, rate = rules, at, rules.rate
        self.begin, self.stop = round(_QUIET * rate), round(_LONG * rate)
        self.end = self.begin + max(1, round(seconds * rate))
        self.first: int | None = None
        self.read, self.command = list[Array](), np.zeros(len(rules.actuators))
        self.is_over = False

    def step(self, tick: int, readings: Array) -> Array:
        """Command; look now and then whether the rig is at rest again."""
        self.first = tick if self.first is None else self.first
        k = tick - self.first
        self.read.append(readings.copy())
        if len(self.read) > self.stop and not len(self.read) % self.begin:
            read = np.array(self.read)
            last, first = np.ptp(read[-self.begin :], axis=0), np.ptp(read[: self.begin], axis=0)
            self.is_over = bool(np.all(last <= np.maximum(2.0 * first, 0.05 * np.ptp(read, axis=0))))
        largest, back = self.rules.commands[self.at, LARGEST], 2 * self.end - self.begin
        self.command[self.at] = largest if self.begin <= k < self.end else -largest if self.end <= k < back else 0.0
        return self.command

    def run(
        self, plant: Plant, twin: Twin | None, *, lockstep: bool, acknowledge: bool = False, look: Look | None = None
    ) -> tuple[Array, Trip | None]:
        """Readings before and after the pulse (samples, sensors), once a real rig is at rest again."""
        rate, rest = self.rules.rate, 0 if twin is None else round(_REST * self.rules.rate)

        def accept(found: Plant) -> None:
            if twin is not None:
                stem = Path(next(iter(twin.declaration.files), twin.declaration.name)).stem
                whose, remedy = f"the plant file is that of {stem}", "give the plant file of the rig that is there"
                check_channels(found, twin.sensors, twin.actuators, whose, remedy)

        ran = run_rig(
            self.step, plant, Settings(rate, lockstep=lockstep, acknowledge=acknowledge), samples=self.stop + rest,
            limits=self.rules, hooks=Hooks(accept, stop=lambda: self.is_over, look=look),
        )  # fmt: skip
        every = np.arange(self.stop)
        if ran.trip is None and len(ran.sensors) < self.stop:
            raise MaskingError(f"the self-test was {ran.reason}; nothing is known of the rig")
        index = ran.index - ran.index[0]
        return np.stack([np.interp(every, index, column) for column in ran.sensors.T], axis=1), ran.trip


def _answers(twin: Twin, at: int, predicted: Array, read: Array) -> Iterator[Answer]:
    begin = round(len(read) * _QUIET / _LONG)
    for i, sensor in enumerate(twin.sensors):
        wanted = predicted[begin:, i] - predicted[begin - 1, i]
        noise = float(np.std(read[:begin, i]))
        found = read[begin:, i] - np.mean(read[:begin, i])
        power = float(wanted @ wanted)
        yield Answer(
            twin.actuators[at], sensor, float(np.abs(wanted).max()), max(noise, twin.noise().get(sensor, 0.0)), noise,
            float(wanted @ found) / power if power > 0.0 else 0.0,
        )  # fmt: skip


def _findings(twin: Twin, answers: tuple[Answer, ...], size: float) -> Iterator[str]:
    """Reasons against arming the rig: faults of sensors, then of actuators."""
    for sensor, declared in twin.noise().items():
        at_rest = min((x.at_rest for x in answers if x.sensor == sensor), default=0.0)
        if at_rest > _NOISY * declared > 0.0:
            ratio = f"{at_rest / declared:.0f} times what is declared"
            yield f"{sensor} reads {at_rest:.2g} of noise at rest, {ratio}: look at its cable, and what shakes the rig"
    clear = [answer for answer in answers if answer.is_clear]
    by_sensor = {a.sensor: [x for x in clear if x.sensor == a.sensor] for a in answers}
    reversed_sensors = {
        sensor
        for sensor, own in by_sensor.items()
        if own
        and all(x.gain < -_DEAD for x in own)
        and any(y.gain > _DEAD for x in own for y in clear if y.actuator == x.actuator and y.sensor != sensor)
    }
    for sensor in sorted(reversed_sensors):
        yield f"{sensor} has the wrong sign: {_shown(by_sensor[sensor][:1])}; look at its polarity"
    for actuator in twin.actuators:
        own = [x for x in clear if x.actuator == actuator and x.sensor not in reversed_sensors]
        if not own:
            remedy = "look at its supply, or give a larger pulse by 'masking rig check --pulse'"
            yield f"{actuator}: no answer to {size:.0%} of its limit stands out of the noise; {remedy}"
        elif all(abs(x.gain) < _DEAD for x in own):
            yield f"{actuator} is dead: {_shown(own)}; look at its amplifier, its cable and its supply"
        elif all(x.gain < -_DEAD for x in own):
            alone = ", or the sensor" if len(own) == 1 else ""
            yield f"{actuator}{alone} has the wrong sign: {_shown(own)}; look at its polarity"
        else:
            for x in own:
                if abs(x.gain) < _DEAD:
                    yield f"{x.sensor} does not answer {actuator}: {_shown([x])}; look at the sensor and its cable"
                elif not _GAIN[0] <= x.gain <= _GAIN[1]:
                    yield f"{x.sensor} answers {actuator} wrongly: {_shown([x])}; look at both and the plant file"


def _shown(answers: list[Answer]) -> str:
    return ", ".join(f"{x.sensor} reads {x.gain:.2f} of what is predicted" for x in answers)
