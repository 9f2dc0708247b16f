"""NI-DAQmx: voltages of a card of National Instruments, read and written at each edge of its own sample clock.

Not tested on hardware: the tests have a stub of the few calls of `nidaqmx` that are used here. The card must be able
to do hardware-timed single point, as those of PCI and PXI are; its driver is NI-DAQmx.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any, Final, final

import nidaqmx
import numpy as np
from nidaqmx.constants import AcquisitionType
from nidaqmx.errors import Error
from nidaqmx.stream_readers import AnalogMultiChannelReader
from nidaqmx.stream_writers import AnalogMultiChannelWriter

from masking.compile.numerics.arrays import Array
from masking.errors import PlantLostError, PlantMismatchError
from masking.lab.plants import address as addresses
from masking.lab.plants.interface import APPLIED, LifeCycle, Sample, Settings, check_command

FORM: Final = "nidaqmx://Dev1?sensors=s1:ai0,s2:ai1&actuators=V1:ao0&range=10"
_OPTIONS: Final = ("sensors", "actuators", "range")
_RANGE: Final = 10.0  # V
_PERIODS: Final = 20  # samples of silence after which the card is lost


@final
class NidaqmxPlant:
    """The analogue channels of a card, at `nidaqmx://Dev1?sensors=s1:ai0,s2:ai1&actuators=V1:ao0`.

    Its clock is that of the analogue inputs, which times the outputs, too: a command acts at the next sample. Voltages
    are limited to `range`, 10 V unless the address says otherwise. Outputs are zero before, and after by a write of its
    own. Where the controller comes back only after the time of the watchdog, the outputs go to zero and the run ends;
    where it is killed, a process beside it sets them to zero; where it stands still they hold, and only hardware helps.
    """

    owns_clock = True

    def __init__(self, address: str) -> None:
        where = addresses.parse(address, _OPTIONS, FORM)
        for name in ("sensors", "actuators"):
            if name not in where.options:
                raise PlantMismatchError(f"{address}: name the {name}, as in {FORM}")
        self.address = address
        self._device = where.place.strip("/")
        inputs, outputs = (where.channels(name, (), ()) for name in ("sensors", "actuators"))
        self._inputs, self._outputs = list(inputs.values()), list(outputs.values())
        self.sensors, self.actuators = tuple(inputs), tuple(outputs)
        self._largest = where.number("range", _RANGE)
        self._applied = np.zeros(len(outputs))
        self._life = LifeCycle()
        self._tasks: list[Any] = []

    def configure(self, settings: Settings) -> None:
        """Set the outputs to zero, and reserve channels and clock.

        A PlantMismatchError where lockstep is asked for, or the card cannot do what the address or the rate say.
        """
        if settings.lockstep:
            raise PlantMismatchError(f"{self._device} keeps its own time; leave out lockstep")
        self._life.configure()
        self.deactivate()
        try:
            self.rest()
            reading, writing = self._task(), self._task()
            for name in self._inputs:
                reading.ai_channels.add_ai_voltage_chan(
                    self._named(name), min_val=-self._largest, max_val=self._largest
                )
            self._add_outputs(writing)
            timed = {"rate": settings.rate, "sample_mode": AcquisitionType.HW_TIMED_SINGLE_POINT}
            reading.timing.cfg_samp_clk_timing(**timed)
            writing.timing.cfg_samp_clk_timing(source=f"/{self._device}/ai/SampleClock", **timed)
        except Error as error:
            self.deactivate()
            reason = " ".join(str(error).split())
            raise PlantMismatchError(f"{self._device}: {reason}; correct the address or controller.rate") from error
        self._reader = AnalogMultiChannelReader(reading.in_stream)
        self._writer = AnalogMultiChannelWriter(writing.out_stream, auto_start=False)
        self._silence = max(0.2, _PERIODS / settings.rate)
        self._allowed, self._answered = settings.watchdog * settings.rate, -1
        self._life.configure()

    def activate(self) -> None:
        """Start the clock, with the outputs at zero."""
        self._life.activate()
        reading, writing = self._tasks
        with self._errors():
            self._writer.write_one_sample(self._applied)
            writing.start()
            reading.start()

    def read(self) -> Sample:
        """Wait for the next edge of the clock.

        A PlantLostError where the card stopped, a sample was too late, or no command came for the watchdog's time.
        """
        self._life.need_active("read")
        values = np.empty(len(self.sensors))
        with self._errors():
            self._reader.read_one_sample(values, timeout=self._silence)
            index = int(self._tasks[0].in_stream.total_samp_per_chan_acquired) - 1
        if self._answered >= 0 and index - self._answered > self._allowed + 1.0:
            self.deactivate()
            late = index - self._answered
            raise PlantLostError(f"{self._device}: no command for {late} samples; its outputs are zero, start anew")
        return Sample(index, values)

    def write(self, index: int, command: Array) -> None:
        """Set the outputs (actuators,) from the next edge of the clock on, within the range."""
        self._life.need_active("write")
        check_command(command, self.actuators)
        np.clip(command, -self._largest, self._largest, out=self._applied)
        with self._errors():
            self._writer.write_one_sample(self._applied)
        self._answered = index

    def deactivate(self) -> None:
        """Stop the clock and set the outputs to zero."""
        self._life.deactivate()
        self._applied = np.zeros(len(self.actuators))
        is_taken, tasks, self._tasks = bool(self._tasks), self._tasks, []
        for task in tasks:
            with contextlib.suppress(Error):
                task.close()
        if is_taken:
            with contextlib.suppress(Error):
                self.rest()

    def telemetry(self) -> dict[str, float]:
        """Outputs in force."""
        return {APPLIED + name: float(value) for name, value in zip(self.actuators, self._applied, strict=True)}

    def rest(self) -> None:
        """Write zeros at once, without a clock."""
        with nidaqmx.Task() as task:
            self._add_outputs(task)
            AnalogMultiChannelWriter(task.out_stream, auto_start=True).write_one_sample(np.zeros(len(self.actuators)))

    def _task(self) -> Any:  # noqa: ANN401  # nidaqmx need not be there
        self._tasks.append(nidaqmx.Task())
        return self._tasks[-1]

    def _add_outputs(self, task: Any) -> None:  # noqa: ANN401
        for name in self._outputs:
            task.ao_channels.add_ao_voltage_chan(self._named(name), min_val=-self._largest, max_val=self._largest)

    def _named(self, channel: str) -> str:
        return f"{self._device}/{channel}"

    @contextlib.contextmanager
    def _errors(self) -> Iterator[None]:
        """Turn an error of the driver into one of a plant."""
        try:
            yield
        except Error as error:
            raise PlantLostError(f"{self._device}: {' '.join(str(error).split())}; look at the card") from error
