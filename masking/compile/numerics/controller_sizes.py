"""Sizes of a sampled controller, and the columns of its tables."""

from __future__ import annotations

from dataclasses import dataclass

from masking.compile.numerics import controller_rows as rows

# Columns of the table of limits, one row for each actuator.
LARGEST, HEATING, POWER, TIME = range(4)


@dataclass(frozen=True)
class Sizes:
    """Sizes of a sampled controller."""

    coordinates: int  # n
    states: int  # length of [q, v, s]; at the end of s are what a virtual system remembers, and the balance's damping
    inputs: int  # of the rig's model
    actuators: int  # channels that are commanded
    # derivatives of a disturbance that are estimated: 0 for none, 1 for a constant one, 2 for a straight line
    order: int
    balanced: int = 0  # virtual coordinates whose energy balance is held; 0 where none is
    offsets: int = 0  # sensors whose offset and noise are measured at rest; 0 where none is
    remembered: int = 0  # internal states of the virtual system
    lags: int = 0  # its delayed expressions
    kept: int = 0  # samples of them that are kept; 0 where there are none
    events: int = 0  # of the virtual system
    # for each value that jumps in them, the index of its event and that of the state in [q, v, s]
    targets: tuple[tuple[int, int], ...] = ()
    at_masses: bool = True  # whether a disturbance adds to the accelerations
    at_inputs: bool = False  # whether one adds to the inputs; those of accelerations stand before it
    steps: int = 4  # of the integration of the virtual system's internal states over a sample

    @property
    def disturbed(self) -> int:
        """Number of accelerations and of inputs to which a disturbance adds."""
        return self.coordinates * self.at_masses + self.inputs * self.at_inputs

    @property
    def memory(self) -> slice:
        """Where the virtual system's internal states are in the rig's state; its delayed expressions follow."""
        stop = self.states - (self.balanced > 0) - self.lags
        return slice(stop - self.remembered, stop)

    @property
    def estimate(self) -> int:
        """Length of the estimate z = [q, v, s, d, d', ...]."""
        return self.states + self.order * self.disturbed

    @property
    def power(self) -> slice:
        """Where the mean powers of the actuators are in the memory.

        The memory holds the estimate at the last sample, these, the estimate for the next sample, what the energy
        balance and the offsets remember, and the inputs under way, oldest first: as many as there are samples of delay,
        which its length gives.
        """
        return slice(self.estimate, self.estimate + self.actuators)

    @property
    def next(self) -> slice:
        """Where the estimate for the next sample is in the memory."""
        return slice(self.power.stop, self.power.stop + self.estimate)

    @property
    def balance(self) -> slice:
        """Where the memory of the energy balance is."""
        return slice(self.next.stop, self.next.stop + (6 * self.balanced + 2 if self.balanced else 0))

    @property
    def rest(self) -> slice:
        """Where what is measured at rest is, as `sampled_loop.stand_still` says."""
        return slice(self.balance.stop, self.balance.stop + (5 * self.offsets + 3 if self.offsets else 0))

    @property
    def past(self) -> slice:
        """Where the past of the delayed expressions is.

        It holds the latest sample, the seconds between samples, the delays in samples, and a row for each kept sample.
        """
        return slice(self.rest.stop, self.rest.stop + (2 + self.lags * (1 + self.kept) if self.lags else 0))

    @property
    def change(self) -> slice:
        """Where the change of inputs in a sample is, which those that act through dynamics of their own are held by."""
        return slice(self.past.stop, self.past.stop + self.inputs * self.at_inputs)

    @property
    def fixed(self) -> int:
        """Length of the memory without inputs under way."""
        return self.change.stop

    @property
    def work(self) -> tuple[int, int]:
        """Shape of the work space, whose rows must also hold the readings and the rig's states."""
        count = rows.WITH_MEMORY if self.remembered + self.lags else rows.WITHOUT_MEMORY
        count = rows.WITH_EVENTS if self.events else count
        switched = self.events + len(self.targets)
        return count, max(self.estimate, self.inputs, self.actuators, 3 * self.balanced + 2, switched)


def lane_work(doubles: int, singles: int, size: int, *others: int) -> tuple[int, int]:
    """Shape of the work space of `masking.compile.numerics.lanes`, by the numbers that the kernel is made of."""
    inputs, parameters, held, lanes = others
    return 19 + (doubles + singles + 2) * size + inputs + parameters + 2 * held, lanes
