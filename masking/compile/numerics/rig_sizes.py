"""Sizes of a rig: work space of its kernels, and the table of sizes and indices that kernels of any rig read."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from masking.compile.numerics.arrays import IntMatrix
from masking.compile.numerics.effect_table import LAW_ROWS

# Rows of the table, and the entries of its first row.
SIZES, FORCE_ENTRIES, INPUT_COLUMNS = range(3)
STATES, COORDINATES, SENSORS, PLACES, CHANNELS, IS_FED, READ_ROWS = range(7)


COLUMN_ROWS = 5  # of the columns of each state: its own, and those of the four stages of a step
TOGETHER = 4  # samples whose rows are added to the normal equations at once: measured, a matrix waits for its memory
# Columns that a loop takes at once, and runs of an ensemble side by side; a processor whose vectors are shorter takes
# several for each. measured: columns that remain, one by one, take longer; pendula take as long in 4 lanes as in 8, and
# 5 % longer in 16.
LANES = 8


def whole_lanes(columns: int) -> int:
    """Number of columns, rounded up to those that loops take at once; what is added stays 0."""
    return -(-columns // LANES) * LANES


@dataclass(frozen=True)
class RigSizes:
    """Sizes of a rig."""

    states: int  # n
    coordinates: int  # how many of the states are coordinates, whose rates are the states that follow them
    sensors: int  # readings of a sample

    @property
    def moved(self) -> int:
        """Number of states that are integrated."""
        return self.states

    @property
    def read_rows(self) -> int:
        """Rows of work space of readings with derivatives."""
        return self.sensors + 2

    @property
    def flow_rows(self) -> int:
        """Rows of work space of rates with derivatives."""
        return self.states

    @property
    def moving_rows(self) -> int:
        """Rows of work space of an integration step with derivatives."""
        return 4 * self.moved + 6 + self.flow_rows

    @property
    def added_rows(self) -> int:
        """Rows of readings that are added to the normal equations at once."""
        return TOGETHER * self.sensors

    @property
    def work_rows(self) -> int:
        """Rows of work space of the normal equations."""
        return 1 + self.read_rows + self.sensors + self.added_rows + 5 + 1 + self.moving_rows


@dataclass(frozen=True)
class PortSizes(RigSizes):
    """Sizes of a rig with ports."""

    force_entries: tuple[int, ...]  # index of each place's force in the parameter array
    force_columns: tuple[int, ...]  # the same, among the affected entries
    command_columns: tuple[int, ...]  # index of each actuator's offset among the affected entries
    is_fed: bool  # whether a sensor reads what a command or a force changes at once
    most_states: int  # of effects together

    @property
    def moved(self) -> int:
        """Number of states that are integrated, those of effects included."""
        return self.states + self.most_states

    @property
    def port_rows(self) -> int:
        """Rows of work space of the ports and of the effects that drive them."""
        return 7 * len(self.force_entries) + 2 * len(self.command_columns) + 6 + LAW_ROWS + 3 * self.sensors

    @property
    def read_rows(self) -> int:
        """Rows of work space of readings with derivatives."""
        return self.sensors + 3 + LAW_ROWS + 2 * self.moved + self.port_rows

    @property
    def flow_rows(self) -> int:
        """Rows of work space of rates with derivatives."""
        return self.states + self.port_rows + 1

    @cached_property
    def table(self) -> IntMatrix:
        """Sizes and indices as kernels read them."""
        places, channels = len(self.force_entries), len(self.command_columns)
        sizes = self.states, self.coordinates, self.sensors, places, channels, self.is_fed, self.read_rows
        rows = sizes, self.force_entries, (*self.force_columns, *self.command_columns)
        made = np.zeros((len(rows), max(map(len, rows))), dtype=np.int64)
        for target, row in zip(made, rows, strict=True):
            target[: len(row)] = row
        return made
