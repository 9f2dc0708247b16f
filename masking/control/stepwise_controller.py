"""Stepwise controller: one step for each sample, in a loop of one's own.

Each object has its own arrays: one object for each loop, and any number of loops side by side, in threads too.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any, NoReturn, final

import numpy as np
from numpy.typing import ArrayLike

from masking.compile.codegen.machine_code import BoundFunction
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.controller_sizes import HEATING, TIME
from masking.compile.numerics.kernel_arguments import Unit
from masking.compile.numerics.stop_codes import SINGULAR
from masking.control.cancellation import INVERTIBLE
from masking.control.closed_loop import ClosedLoop
from masking.control.sampled_controller import SampledController
from masking.errors import CommandError, PlantMismatchError
from masking.model.modelling.input_series import Schedule

MEND = "look at what it was given, and call reset to begin again"


@final
class SampledStep:
    """A controller at a fixed rate: readings in, commands out.

        step = masking.Experiment.load("huygens_rig").controller()
        commands = step(readings)

    The first readings are those of a rig at rest: from them it takes where the rig stands, in some milliseconds. Then
    come the samples before the release (rest, homing), and sample 0, at which the rig is released.

    Attributes:
        sampled: the controller.
        sensors: the names of the readings.
        actuators: the names of the commands.
        rate: samples per second.
        index: the sample that the next call answers; negative before the release.
        state: all that it remembers, as `numerics.controller_sizes.Sizes.power` says; read and written in place.
        estimate: the estimated rig state [q, v, s] at the last sample, SI units, a view of `state`.
        power: the mean power of each actuator, W, likewise.
        parameters: its parameter array.
        demanded: the last commands (actuators,) before the limits.
        applied: those after the limits, which a call returns: the same array each time.
    """

    def __init__(self, sampled: SampledController) -> None:
        sizes, known = sampled.sizes, sampled.instruments
        self.sampled, self.rate = sampled, sampled.rate
        self.sensors, self.actuators = known.sensors, known.actuators
        begun = sampled.begin(known.readings(np.zeros(sizes.coordinates)))  # compiles `still`, and has the lengths
        self.state, self.parameters = begun.x, begun.p
        self.estimate, self.power = self.state[: sizes.states], self.state[sizes.power]
        self.demanded, self.applied = np.zeros(sizes.actuators), np.zeros(sizes.actuators)
        self._readings, self._index = np.zeros(len(self.sensors)), np.zeros(1, dtype=np.int64)
        self._array, self._numbers = _buffers(self._readings)
        self._sample, self._first = self._index.data, np.zeros(1)
        self._bind()
        self.reset()

    def _bind(self) -> None:
        """Bind the compiled step to the arrays, as it is and without regard to the readings."""
        sampled, answer = self.sampled, self.sampled.kernels.answer
        gain, limits = sampled.gain, sampled.limits
        self._unsent = np.zeros_like(self.applied)
        unit = Unit(self.state, self.parameters, gain, limits)
        head = (self._index, np.array([1.0 / sampled.rate]), self._readings)
        seeing = answer.bind(*head, unit, self.demanded, self.applied, self._first)
        without, unsent = unit._replace(gain=np.zeros_like(gain)), np.zeros_like(self.applied)
        blind = answer.bind(*head, without, unsent, self._unsent, np.zeros_like(self._first))
        self._bound = (seeing, blind)
        self._unseen, self._results = blind.call, seeing.results
        if not sampled.has_model:
            sampled.kernels.skip.prepare()

    def virtual(self) -> tuple[Array, Array, BoundFunction]:
        """Computation of the virtual motion from the estimate.

        Returns an array (1,) for the time in s, the virtual coordinates and velocities (2 k,), and what computes them.
        """
        time, n = np.zeros(1), self.sampled.sizes.coordinates
        found = np.zeros(2 * len(self.sampled.controller.virtual.coordinates))
        transform = self.sampled.kernels.transform
        return time, found, transform.bind(time, self.estimate[:n], self.estimate[n:], self.parameters, found)

    def reset(self, readings: ArrayLike | None = None) -> None:
        """Begin again.

        Args:
            readings: of the rig at rest (sensors,), where it begins now; else it begins with those of the next call.

        Raises:
            PlantMismatchError: there is not one reading for each sensor.
        """
        self.index, self._is_placed, self._has_begun = -self.sampled.before, False, False
        self._first[:] = self.demanded[:] = self.applied[:] = 0.0
        self._call: Callable[[], object] = self._begin
        if readings is not None:
            _copy(readings, self._readings, "reading", self.sensors)
            self._place()

    def __call__(self, readings: ArrayLike, index: int | None = None) -> Array:
        """Commands (actuators,) that answer the readings (sensors,) of a sample.

        After an error they are zero, and it goes on only after `reset`.

        Args:
            readings: numbers or an array, in the sensors' units.
            index: the sample; the next where it is not given. Samples that were left out are predicted over.

        Raises:
            PlantMismatchError: there is not one reading for each sensor.
            CommandError: the commands are not finite.
            SingularityError: the matrix that gives the inputs became singular.
        """
        try:
            if type(readings) is np.ndarray:
                self._array[:] = readings
            else:
                self._numbers[:] = readings
        except (TypeError, ValueError):
            _copy(readings, self._readings, "reading", self.sensors)
        if index is None:
            index = self.index
        elif index != self.index and self._has_begun:
            self._pass_over(index)
        self._sample[0] = index
        self.index = index + 1
        self._call()
        if self._results[0]:
            self._stop(int(self._results[0]), index)
        return self.applied

    def _place(self) -> None:
        """Take the rig to rest where the readings say."""
        begun = self.sampled.begin(self._readings)
        self.state[:], self.parameters[:], self.applied[:] = begun.x, begun.p, begun.holding
        self._is_placed = True

    def _begin(self) -> None:
        if not self._is_placed:
            self._place()
        self._call, self._has_begun = self._bound[0].call, True
        self._call()

    def _pass_over(self, index: int) -> None:
        """Step over the samples before this one that were missed, with its readings.

        The observer is propagated with the command that it would have sent. In fact the previous command was held; the
        observer sees the difference as a short disturbance and rejects it. measured: ten times 15 samples missed in
        7000 cost 0.003 of masking error; propagated with the command that was held, 0.39.
        """
        sampled, h, limits, command = self.sampled, 1.0 / self.rate, self.sampled.limits, self.applied
        for missed in range(self.index, index):
            if not sampled.has_model:
                sampled.kernels.skip(missed * h, h, self.state, self.parameters, limits, command)
                continue
            before = self.power.copy()
            self._sample[0] = missed
            self._unsent[:] = command
            self._unseen()
            part = -np.expm1(-h / limits[:, TIME])
            self.power[:] = before + part * (limits[:, HEATING] * command**2 - before)

    def _stop(self, status: int, index: int) -> NoReturn:
        """Raise what a status stands for; from now on each call does, until `reset`."""
        bad = [name for name, value in zip(self.actuators, self.applied, strict=True) if not np.isfinite(value)]
        self.applied[:] = 0.0
        self._call = _stopped(f"sample {index}")
        if status == SINGULAR:
            known = 2 * self.sampled.sizes.coordinates
            self.sampled.kernels.stop(status, index / self.rate, self.estimate[:known], INVERTIBLE)
        names = ", ".join(bad or self.actuators)
        unsolved = self.sampled.kernels.unsolved(status, self.estimate)
        message = unsolved or f"the controller's command of {names} is no longer finite"
        raise CommandError(f"{message}, at sample {index}; {MEND}")


@final
class LawStep:
    """A control law that is given the rig's state: state in, commands out. It has no observer and no limits.

        step = masking.Experiment.load("duffing").controller()
        commands = step(t, state)

    Attributes:
        loop: controller and plant.
        states: the names of the state: the rig's [q, v, s], then what the virtual system remembers, if anything.
        actuators: the names of the commands.
        state: the rig's state at the last call, SI units.
        estimate: the same: this law knows the true state.
        inputs: of the plant's model at the last call, in its units.
        applied: the last commands (actuators,), which a call returns: the same array each time.

    Args:
        loop: controller and plant, compiled together.
        inverse: the commands for each input (actuators, inputs), as `Instruments.allocation_inverse`.
        actuators: their names.
        schedule: parameters that change at instants, as inputs of the virtual system do; none by default.
    """

    def __init__(
        self, loop: ClosedLoop, inverse: Array, actuators: Sequence[str], schedule: Schedule | None = None
    ) -> None:
        names = loop.plant.coordinates
        self.loop, self.actuators = loop, tuple(actuators)
        self.states = (*names, *(f"{name}'" for name in names), *loop.internal)
        self.state, self.inputs = np.zeros(len(self.states)), np.zeros(len(loop.plant.inputs))
        self.estimate, self.applied = self.state, np.zeros(len(self.actuators))
        self._array, self._numbers = _buffers(self.state)
        time, self._first = np.zeros(1), np.zeros(1)
        self._time, _ = _buffers(time)
        self._schedule, self._parameters = schedule, loop.values()
        given = (time, self.state, self._parameters, np.ascontiguousarray(inverse))
        self._bound = loop.kernels.answer.bind(*given, self.inputs, self.applied, self._first)
        self._results = self._bound.results
        self.reset()

    def reset(self) -> None:
        """Begin again."""
        self._first[:] = self.state[:] = self.inputs[:] = self.applied[:] = 0.0
        self._call = self._bound.call

    def __call__(self, t: float, state: ArrayLike) -> Array:
        """Commands (actuators,) for a state of the rig.

        After an error they are zero, and it goes on only after `reset`.

        Args:
            t: time of the rig, s.
            state: numbers or an array [q, v, s], SI units.

        Raises:
            PlantMismatchError: there is not one number for each state.
            CommandError: the inputs are not finite.
            SingularityError: the matrix that gives the inputs became singular.
        """
        try:
            if type(state) is np.ndarray:
                self._array[:] = state
            else:
                self._numbers[:] = state
        except (TypeError, ValueError):
            _copy(state, self.state, "state", self.states)
        self._time[0] = t
        if self._schedule is not None:
            self._schedule.set(t, self._parameters)
        self._call()
        if self._results[0]:
            self._stop(int(self._results[0]), t)
        return self.applied

    def _stop(self, status: int, t: float) -> NoReturn:
        self.inputs[:] = self.applied[:] = 0.0
        self._call = _stopped(f"t = {t:g}")
        if status == SINGULAR:
            self.loop.kernels.stop(status, t, self.state[: 2 * len(self.loop.plant.coordinates)], INVERTIBLE)
        message = self.loop.kernels.unsolved(status, self.state) or "the control law's inputs are no longer finite"
        raise CommandError(f"{message}, at t = {t:g} s; {MEND}")


def _buffers(array: Any) -> tuple[Any, Any]:  # noqa: ANN401  (what ctypes takes)
    """Array as what another array is copied into fastest, and as what a list is.

    measured: 6 numbers take 0.09 us and 0.15 us; a list into the array itself takes 0.7 us. Each step copies in place:
    a function that both kinds of steps share costs another 0.06 to 0.1 us, a tenth of a step.
    """
    return array.data, (ctypes.c_double * len(array)).from_buffer(array)


def _copy(given: ArrayLike, target: Array, what: str, names: Sequence[str]) -> None:
    """Copy one number for each name, and a single number where one is wanted; refuse anything else."""
    if len(names) == 1 and isinstance(given, int | float | np.number):
        target[0] = given
        return
    try:
        array = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        found = f"{given!r}, which are not numbers"
    else:
        if array.shape == (len(names),):
            target[:] = array
            return
        found = f"shape {array.shape}"
    raise PlantMismatchError(f"got {found}; give ({len(names)},), one {what} for each of {', '.join(names)}")


def _stopped(where: str) -> Callable[[], NoReturn]:
    def refuse() -> NoReturn:
        raise CommandError(f"the controller stopped at {where}; call reset to begin again")

    return refuse
