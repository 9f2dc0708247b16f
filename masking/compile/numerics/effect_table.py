"""Table of effect instances that an augmented model is simulated with, one row each, and its columns."""

from __future__ import annotations

# Columns: number of the law, kind of place, index of the place, index of the first parameter, index of the state or -1.
COLUMNS = LAW, KIND, PLACE, FIRST, STATE = range(5)
# Kinds of place. An inertia is an effect in an element that follows its acceleration.
ELEMENT, ACTUATOR, SENSOR, INERTIA = range(4)
# Columns of what a law writes, a row for its value and one for the rate of its state: this and its derivatives.
VALUE, BY_DISPLACEMENT, BY_RATE, BY_STATE, BY_PARAMETER = range(5)
NEARLY_ZERO = 1e-200  # the first state of an effect: powers of it have derivatives
