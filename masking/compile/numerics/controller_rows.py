"""Rows of the work space of a sampled controller."""

from __future__ import annotations

# A state, the unmodelled accelerations, and at the beginning, the middle and the end of a sample the inputs
# and the accelerations, and the parts of these that inputs give; the desired velocities.
STATE, DISTURBANCE, EARLY_INPUTS, MIDDLE_INPUTS, LATE_INPUTS = range(5)
EARLY, MIDDLE, LATE, EARLY_PART, MIDDLE_PART, LATE_PART, DESIRED = range(5, 12)
# The estimate when the inputs begin to act, inputs, the four slopes of a step and the state of one, expected readings.
AHEAD, INPUTS, SLOPES, STAGE, EXPECTED = 12, 13, 14, 18, 19
# Between steps: rates at the middle of a sample, those without inputs and by others, and the state that is wanted.
MIDDLE_RATES, FREE_RATES, PUSHED, SMOOTH = *range(SLOPES, SLOPES + 3), STAGE
AT_FIRST = SLOPES  # before a step: readings of the estimate at the time of the first reading
SENSED, DEMANDED, APPLIED = range(20, 23)  # of the rig
# Rates of the state at the beginning and the end of a sample; the balance's motion and its momentum.
EARLY_RATES, LATE_RATES, BALANCED, MOMENTUM = range(23, 27)
WITHOUT_MEMORY = 27
# With internal states or delays of the virtual system: the state before, then the rows of `virtual_memory`.
BEFORE, MEMORY = 27, 28
MEMORY_SLOPES, MEMORY_STAGE, MEMORY_BEFORE, CONDITIONS, BELOW, COUNTS, TOTAL = 1, 5, 6, 7, 8, 9, 10
WITH_MEMORY = MEMORY + MEMORY_STAGE + 1
# With events: these, and the mean jump.
JUMPED = MEMORY + TOTAL + 1
WITH_EVENTS = JUMPED + 1
