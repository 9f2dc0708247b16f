"""Sizes of a rig: work space of its kernels, and the table of sizes and indices that kernels of any rig read."""

from __future__ import annotations

from dataclasses import dataclass

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
    def moving_rows(self) -> int:
        """Rows of work space of an integration step with derivatives."""
        return 5 * self.states + 6

    @property
    def added_rows(self) -> int:
        """Rows of readings that are added to the normal equations at once."""
        return TOGETHER * self.sensors

    @property
    def response_rows(self) -> int:
        """Rows of work space of responses along a known motion."""
        return 6 * self.states + 2 * self.sensors + 3

    @property
    def work_rows(self) -> int:
        """Rows of work space of the normal equations."""
        return 2 * self.sensors + self.added_rows + 8 + self.moving_rows
