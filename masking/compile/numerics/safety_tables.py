"""Columns of the tables that kernels of `numerics.safety_kernels` read and write, and numbers of what they find."""

from __future__ import annotations

from typing import Final

# What is found: numbers of `masking.lab.plants.safety_chain.Cause`.
NONFINITE, STUCK, JUMP, RANGE, POSITION, VELOCITY, THERMAL, COMMAND, NO_RESPONSE, WRONG_SIGN = range(1, 11)
COMMAND_RATE: Final = 19

# Columns of the table of sensors (sensors, 8): least and largest reading; largest change in a sample; what a sound
# reading may be off, by noise and rounding; standard deviation of the noise; acceleration that no model explains;
# samples over which a speed is taken, 0 where no model says how the reading moves; the reading at coordinates of zero.
LEAST, MOST, STEP, OFF, NOISE, UNEXPLAINED, SPAN, ORIGIN = range(8)
SENSOR_COLUMNS: Final = 8
# What is remembered of each sensor (sensors, 11): its last three readings; how many equal ones came, the mean third
# difference, the smallest change seen. Since readings are equal: the predicted motion and its speed, what these may be
# off, and whether there is such a prediction (1) that is clearly not met (2).
FIRST, SECOND, THIRD, EQUAL, ROUGH, FINEST, MOTION, SPEED, MOTION_OFF, SPEED_OFF, MOVES = range(11)
SEEN_COLUMNS: Final = 11
# Columns of the table of what is limited (limits, 4): its limit, its value at readings of zero, the samples over which
# its rate is taken (0 for a position), whether the estimate gives it.
BOUND, AT_ZERO, OVER, ESTIMATED = range(4)
LIMIT_COLUMNS: Final = 4
# Columns of the table of actuators (actuators, 6): those of `controller_sizes`, the largest change per s, and the
# command where the other side is silent.
RATE, EXPIRY = 4, 5
ACTUATOR_COLUMNS: Final = 6
# Counts (7): samples since the last gap and since the beginning; the row of the latest reading and command; commands
# that were cut for their mean power, and that were clamped; samples in the buckets of energy; commands that were
# slowed.
WHOLE, TOTAL, ROW, CUT, CLAMPED, BUCKET, SLOWED = range(7)
COUNTS: Final = 7
# Settings (6), in samples: half the window of a response, the delay, readings that are equal for too long, a second,
# commands that may be cut or slowed, a bucket of energy.
HALF, DELAY, HELD, SECOND_OF, CUTS, PER_BUCKET = range(6)
SETTINGS: Final = 6
# What a response needs to be compared, beside what no model explains, and its ratio where it fails.
CLEAR, WEIGHT, DEAD, REVERSED = 2.0, 200.0, 0.15, -0.3
