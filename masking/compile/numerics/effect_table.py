"""Table of effect instances that an augmented model is simulated with, one row each, and its columns."""

from __future__ import annotations

MOST_STATES = 2  # of an effect: those of a mass on a spring
# Columns of what a law writes, a row for its value and one for the rate of each state: this and its derivatives.
VALUE, BY_DISPLACEMENT, BY_RATE, BY_STATE = range(4)
BY_PARAMETER = BY_STATE + MOST_STATES
RATES = 1  # the first row of rates
LAW_ROWS = RATES + MOST_STATES
NEARLY_ZERO = 1e-200  # the first state of an effect: powers of it have derivatives
