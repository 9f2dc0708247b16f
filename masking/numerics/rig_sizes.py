"""Sizes of a rig that kernels are made for."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RigSizes:
    """Sizes of a rig.

    Args:
        states: n.
        coordinates: how many of the states are coordinates, whose rates are the states that follow them.
        affected: entries of the parameter array that depend on parameters.
        sensors: readings of a sample.
        free: states that each shooting interval may begin with at any value, each with a column of S at the end.
    """

    states: int
    coordinates: int
    affected: int
    sensors: int
    free: tuple[int, ...] = ()

    @property
    def read_rows(self) -> int:
        """Return the rows of work space of readings with derivatives."""
        return 2 * self.sensors + 1

    @property
    def moving_rows(self) -> int:
        """Return the rows of work space of an integration step with derivatives."""
        return 7 * self.states + 6

    @property
    def work_rows(self) -> int:
        """Return the rows of work space of the normal equations."""
        return 1 + self.sensors + 3 + self.read_rows + self.moving_rows


@dataclass(frozen=True)
class PortSizes(RigSizes):
    """Sizes of a rig with ports.

    Args:
        places: where forces may act.
        channels: actuators.
        force_entries: index of each place's force in the parameter array.
        force_columns: the same, among the affected entries.
        command_columns: index of each actuator's offset among the affected entries.
        is_fed: whether a sensor reads what a command or a force changes at once.
        most_states: of effects together.
    """

    places: int = 0
    channels: int = 0
    force_entries: tuple[int, ...] = ()
    force_columns: tuple[int, ...] = ()
    command_columns: tuple[int, ...] = ()
    is_fed: bool = False
    most_states: int = 0

    @property
    def port_rows(self) -> int:
        """Return the rows of work space of the ports and of the effects that drive them."""
        return 6 * self.places + self.channels + 4 + 2 * self.sensors + 6

    @property
    def read_rows(self) -> int:
        """Return the rows of work space of readings with derivatives."""
        return 2 * self.sensors + 5 + self.states + self.most_states + self.port_rows

    @property
    def moving_rows(self) -> int:
        """Return the rows of work space of an integration step with derivatives."""
        return 7 * self.states + 5 * self.most_states + 6 + self.port_rows
