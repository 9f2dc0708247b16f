"""Sizes of a sampled controller, and the columns of its tables."""

from __future__ import annotations

from dataclasses import dataclass

# Columns of the table of limits, one row for each actuator.
LARGEST, HEATING, POWER, TIME = range(4)


@dataclass(frozen=True)
class Sizes:
    """Sizes of a sampled controller.

    Args:
        coordinates: n.
        states: length of [q, v, s].
        inputs: of the rig's model.
        actuators: channels that are commanded.
        order: derivatives of a disturbance that are estimated: 0 for none, 1 for a constant one, 2 for a straight line.
    """

    coordinates: int
    states: int
    inputs: int
    actuators: int
    order: int

    @property
    def estimate(self) -> int:
        """Return the length of the estimate z = [q, v, s, d, d', ...]."""
        return self.states + self.order * self.coordinates

    @property
    def power(self) -> slice:
        """Return where the mean powers of the actuators are in the memory.

        The memory holds the estimate at the last sample, these, the estimate for the next sample, and the inputs under
        way, oldest first: as many as there are samples of delay, which its length gives.
        """
        return slice(self.estimate, self.estimate + self.actuators)

    @property
    def fixed(self) -> int:
        """Return the length of the memory without inputs under way."""
        return 2 * self.estimate + self.actuators

    @property
    def work(self) -> tuple[int, int]:
        """Return the shape of the work space, whose rows must also hold the readings and the rig's states."""
        return 24, max(self.estimate, self.inputs, self.actuators)
