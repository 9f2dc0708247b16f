"""A stub of the calls of `nidaqmx` that the adapter uses, before a card with a cart on it. It is no test of hardware.

The card refuses what NI-DAQmx refuses: a channel that another task has, a clock of another rate, a write to a task
that was closed. Its outputs hold what was written last, also once a task is closed. An edge of its clock comes
with each read, and `skipped` more with the next one.
"""

import types
from enum import Enum

import numpy as np
import scipy.linalg


class Error(Exception):
    pass


class AcquisitionType(Enum):
    HW_TIMED_SINGLE_POINT = 12522


class Card:
    """A card Dev1 with the position of a cart, in V, at ai0, and its force, in V, at ao0: 1 V is 1 m or 1 N."""

    def __init__(self, mass, stiffness, damping):
        self.matrix = np.array([[0.0, 1.0, 0.0], [-stiffness / mass, -damping / mass, 1.0 / mass], [0.0, 0.0, 0.0]])
        self.state, self.outputs, self.pending = np.zeros(2), {"ao0": 0.0, "ao1": 0.0}, {}
        self.taken, self.rate, self.edges, self.skipped = set(), None, 0, 0
        self.written, self.broken = [], ""

    def edge(self):
        """Move to the next edge, at which inputs are sampled and outputs take what was written before."""
        if self.edges:
            moved = scipy.linalg.expm(self.matrix / self.rate) @ [*self.state, self.outputs["ao0"]]
            self.state = moved[:2]
        self.edges += 1
        self.outputs |= self.pending
        self.written.append(self.outputs["ao0"])


def stub(card):
    """Return modules by the names under which the adapter imports them."""

    class Channels:
        def __init__(self, task, kind):
            self.task, self.kind = task, kind

        def add(self, physical, *, min_val, max_val):
            device, _, name = physical.partition("/")
            if device != "Dev1" or name not in {f"{self.kind}0", f"{self.kind}1"}:
                raise Error(f"Physical channel specified does not exist on this device: {physical}")
            if name in card.taken:
                raise Error(f"The specified resource is reserved: {physical}")
            assert -10.0 <= min_val < max_val <= 10.0
            card.taken.add(name)
            self.task.channels.append(name)

        add_ai_voltage_chan = add_ao_voltage_chan = add

    class Timing:
        def __init__(self, task):
            self.task = task

        def cfg_samp_clk_timing(self, rate, source="", *, sample_mode):
            assert sample_mode is AcquisitionType.HW_TIMED_SINGLE_POINT
            assert source == ("" if "ai0" in self.task.channels else "/Dev1/ai/SampleClock")
            if rate > 20_000.0:
                raise Error("Requested sample rate is\ntoo high.")
            card.rate, self.task.is_timed = rate, True

    class InStream:
        def __init__(self, task):
            self.task = task

        @property
        def total_samp_per_chan_acquired(self):
            return card.edges

    class Task:
        def __init__(self):
            self.channels, self.is_timed, self.is_started, self.is_closed = [], False, False, False
            self.ai_channels, self.ao_channels = Channels(self, "ai"), Channels(self, "ao")
            self.timing, self.in_stream, self.out_stream = Timing(self), InStream(self), self

        def start(self):
            self.is_started = True
            if "ai0" in self.channels:
                card.edges, card.state = 0, np.zeros(2)

        def close(self):
            card.taken -= set(self.channels)
            card.pending, self.is_closed = {}, True

        def __enter__(self):
            return self

        def __exit__(self, *_):
            self.close()

    class Reader:
        def __init__(self, stream):
            self.task = stream.task

        def read_one_sample(self, data, timeout):
            assert self.task.is_started
            assert timeout > 0.0
            if card.broken or self.task.is_closed:
                raise Error(card.broken or "Specified task is invalid.")
            for _ in range(1 + card.skipped):
                card.edge()
            card.skipped = 0
            data[:] = [card.state[0] if name == "ai0" else 0.0 for name in self.task.channels]

    class Writer:
        def __init__(self, stream, auto_start):
            self.task, self.auto_start = stream, auto_start

        def write_one_sample(self, data):
            if self.task.is_closed:
                raise Error("Specified task is invalid.")
            assert data.dtype == np.float64
            values = dict(zip(self.task.channels, data.tolist(), strict=True))
            if self.task.is_timed:
                assert not self.auto_start
                card.pending |= values
            else:  # on demand
                assert self.auto_start
                card.outputs |= values

    modules = {
        "nidaqmx": {"Task": Task},
        "nidaqmx.constants": {"AcquisitionType": AcquisitionType},
        "nidaqmx.errors": {"Error": Error},
        "nidaqmx.stream_readers": {"AnalogMultiChannelReader": Reader},
        "nidaqmx.stream_writers": {"AnalogMultiChannelWriter": Writer},
    }
    found = {name: types.ModuleType(name) for name in modules}
    for name, content in modules.items():
        vars(found[name]).update(content)
    return found
