"""Why a kernel stopped."""

from __future__ import annotations

REACHED, TOO_SMALL_STEP, SINGULAR, NOT_FINITE, TOO_MANY_STEPS = 0, 1, 2, 3, 4
# Of a Kalman filter: its covariance is not positive; a parameter has moved so far that derivatives are found anew.
NOT_POSITIVE, LINEARISE = 5, 6
NOT_PRECISE = 9  # single precision is not enough
EVENT = 8  # not an end: what jumps there, jumps; 7 is that of an exported unit's watchdog

MOST_STEPS = 100_000_000  # of an integration
SMALLEST_STEP = 1e-14  # relative to the time; and the smallest state that steps are measured by
ALL_BUT_ROUNDING = 1.0 - 1e-12  # a step of this part of what remains is the last
SINGULAR_PART = 1e-9  # of its first value: where its health has fallen to that, a matrix counts as singular
STEPS_AT_ONCE = 200_000  # after which somebody looks whether a motion gets on

MESSAGES = {
    SINGULAR: "the matrix that gives the accelerations or the inputs became singular",
    TOO_SMALL_STEP: "the step fell below what time can resolve: the solution ends in finite time or jumps",
    NOT_FINITE: "the state or the inputs are no longer finite numbers",
    TOO_MANY_STEPS: "more than 100 million steps were taken",
}
