"""Events: crossings that are found in the dense output of the steps that an integrator has taken, and jumps there.

For the state y = [q, v, s], `conditions(t, y, p, w)` writes the conditions of the events, and then the values that
jump. An event is where its condition, from below, crosses zero: it is looked for at points of each step and where the
condition turns between them, and found on the far side by bisection, to the last digit of the time.
"""
# ruff: noqa: ANN001, ANN202, ANN401, PLR0915, PLR0917
# The types are numba's to infer, and what a kernel calls stands before it.

from __future__ import annotations

import math
from typing import Any, NamedTuple

from masking.compile.numerics.arrays import Kernel, Matrix, Vector
from masking.compile.numerics.compilation import compiled, requires
from masking.compile.numerics.kernel_arguments import Accuracy
from masking.compile.numerics.runge_kutta import copy, dense_output, embedded_steps, forget

INTERVALS = 8  # of a step, and one more at each of its ends
EDGE = 1e-3  # the length of these
HALVINGS = 60
SEARCHES = 48  # golden sections of an interval in which a condition turns
GOLDEN = 0.6180339887498949
NONE = 2.0  # no event in a step, whose parts end at 1
AT_ONCE = 100  # events at one instant
# Rows of the work space after those of the integrator: when it began and the longest first step, inputs, which
# conditions are below zero, the conditions at three points, those that are looked at, and a state.
HEAD, INPUTS, BELOW, FIRST, SECOND, THIRD, SEEN, STATE = range(8)


class Step(NamedTuple):
    """A step of an integrator from y at a time t, with the coefficients of its dense output, work space, parameters."""

    t: float
    y: Vector
    f: Matrix
    length: float
    known: Matrix
    p: Vector


def work_shape(size: int, values: int, inputs: int) -> tuple[int, int]:
    """Shape of the work space of `runge_kutta`; `values` counts conditions and what jumps."""
    return 24 + 8, max(size, values, inputs, 2)


def first_crossing(conditions: Kernel, size: int, events: int) -> Kernel:
    """Make the search of a step for its first event; `conditions` writes `events` conditions, and values that jump.

    Returns:
        `crossing(t, y, f, length, known, p)`, as `runge_kutta.embedded_steps` takes it, with the work space `known`.
    """
    interpolate = dense_output(size)

    @compiled
    def look(step, x, into):
        state = step.known[STATE]
        interpolate(step.y, step.f, x, state)
        conditions(step.t + x * step.length, state, step.p, into)

    @compiled
    def far_side(step, e, low, high):
        """Halve an interval at whose beginning the condition is below zero, and at whose end it is not."""
        known = step.known
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            if low < middle < high:
                look(step, middle, known[SEEN])
                if known[SEEN, e] < 0.0:
                    low = middle
                else:
                    high = middle
        return high

    @compiled
    def turn(step, e, low, high, sign):
        """Point of an interval at which a condition times a sign is above 0, and NONE where its top is not."""
        known = step.known
        a, b = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        look(step, a, known[SEEN])
        at_a = sign * known[SEEN, e]
        look(step, b, known[SEEN])
        at_b = sign * known[SEEN, e]
        for _ in range(SEARCHES):
            if at_a > 0.0 or at_b > 0.0:
                break
            if at_a >= at_b:
                high, b, at_b = b, a, at_a
                a = high - GOLDEN * (high - low)
                look(step, a, known[SEEN])
                at_a = sign * known[SEEN, e]
            else:
                low, a, at_a = a, b, at_b
                b = low + GOLDEN * (high - low)
                look(step, b, known[SEEN])
                at_b = sign * known[SEEN, e]
        if at_a > 0.0:
            return a
        return b if at_b > 0.0 else NONE

    @compiled
    def point(i):
        if i == 0 or i == INTERVALS + 2:
            return 0.0 if i == 0 else 1.0
        if i == 1 or i == INTERVALS + 1:
            return EDGE if i == 1 else 1.0 - EDGE
        return (i - 1.0) / INTERVALS

    @compiled
    def crossing(t, y, f, length, known, p):
        """Part of a step after which the first event comes, and NONE where none comes."""
        step = Step(t, y, f, length, known, p)
        look(step, 0.0, known[SECOND])
        hit = NONE
        for i in range(1, INTERVALS + 3):
            before, low, high = point(max(i - 2, 0)), point(i - 1), point(i)
            look(step, high, known[THIRD])
            dipped = -1
            for e in range(events):
                a, b, c, is_below = known[FIRST, e], known[SECOND, e], known[THIRD, e], known[BELOW, e] > 0.0
                is_start, found, after_dip = i == 1 and t == known[HEAD, 0], NONE, False
                if is_below and c >= 0.0:
                    found = far_side(step, e, low, high)
                elif is_below and i > 1 and max(a, b, c) < 0.0 and b >= a and b >= c:
                    top = turn(step, e, before, high, 1.0)
                    if top < NONE:
                        found = far_side(step, e, before, top)
                elif not is_below and c >= 0.0 and (is_start or (i > 1 and min(a, b) >= 0.0 and b <= a and b <= c)):
                    bottom = turn(step, e, before, high, -1.0)
                    if bottom < NONE:
                        found, after_dip = far_side(step, e, bottom, high), True
                if found < hit:
                    hit, dipped = found, (e if after_dip else -1)
            if hit < NONE:
                if dipped >= 0:
                    known[BELOW, dipped] = 1.0
                return hit
            for e in range(events):
                if known[THIRD, e] < 0.0:
                    known[BELOW, e] = 1.0
                known[FIRST, e], known[SECOND, e] = known[SECOND, e], known[THIRD, e]
        return hit

    return crossing


def runge_kutta(derivative: Kernel, conditions: Kernel, size: int, events: int, inputs: int) -> Kernel:
    """Make the integrator of `runge_kutta.runge_kutta` for equations with events: it stops at each of them.

    Returns `solve`, as that of `runge_kutta.runge_kutta`, with `y` (size + events + 1,): the state, for each condition
    1 where it has been below zero and else 0, and the longest first step. At an event it returns `EVENT`, with the time
    on the far side of the crossing and the state before the jump, which is also what is recorded then.
    """

    @compiled
    def driven(t, y, known, p, dy):
        return derivative(t, y, known[INPUTS], p, dy)

    @compiled
    def bound(t, known):
        return known[HEAD, 1] if t == known[HEAD, 0] else math.inf

    crossing = first_crossing(conditions, size, events)
    solve_with = embedded_steps(driven, bound, forget, size, False, crossing, True)

    @compiled
    @requires("len(states) >= len(times)")
    def solve(
        t: float, y: Vector, times: Vector, u: Vector, p: Vector, accuracy: Accuracy, states: Matrix, work: Matrix
    ) -> tuple[int, float, int]:
        known = work[24:]
        copy(u, known[INPUTS], inputs)
        copy(y[size:], known[BELOW], events)
        known[HEAD, 0], known[HEAD, 1] = t, y[size + events]
        conditions(t, y, p, known[SEEN])  # here `codegen.argument_sizes` reads their sizes: below, p is in a tuple
        found = solve_with(t, y, times, known, p, accuracy, states, work[:24])
        copy(known[BELOW], y[size:], events)
        return found

    return solve


@compiled
def nothing(happening: Any, y: Any, w: Any) -> Any:
    """Assign nothing to a state."""
    return happening


def assignment(before: Kernel, event: int, state: int, value: int) -> Kernel:
    """Make `assign(happening, y, w)`, which does what stood before, and sets a state to a value if an event happens."""

    @compiled
    def assign(happening, y, w):
        before(happening, y, w)
        if happening == event:
            y[state] = w[value]

    return assign


def jumps(conditions: Kernel, events: int, targets: tuple[tuple[int, int], ...], most: int) -> Kernel:
    """Make the jumps at an instant at which conditions have crossed zero.

    The first event, in declared order, whose condition was below zero and is no longer makes its jump. This is
    repeated, with the state as it has become, until there is none, or `most` have happened. `targets` has for each
    value the index of its event and that of the state which jumps.

    Returns:
        `jump(t, y, p, below, counts, w) -> has_ended`, which writes the state y after all jumps; `below` and `counts`
        (events,) say which conditions are below zero, and how often each event happened; `w` (values,) is work space.
    """
    assign: Kernel = nothing
    for i, (event, state) in enumerate(targets):
        assign = assignment(assign, event, state, events + i)

    @compiled
    @requires(f"min(len(below), len(counts)) >= {events}")
    def jump(t: float, y: Vector, p: Vector, below: Vector, counts: Vector, w: Vector) -> int:
        has_ended = 0
        conditions(t, y, p, w)
        for _ in range(most + 1):
            if has_ended == 0:
                happening = -1
                for e in range(events):
                    if happening < 0 and below[e] > 0.0 and w[e] >= 0.0:
                        happening = e
                if happening < 0:
                    has_ended = 1
                else:
                    assign(happening, y, w)
                    below[happening] = 0.0
                    counts[happening] += 1.0
                    conditions(t, y, p, w)
                    for e in range(events):
                        if w[e] < 0.0:
                            below[e] = 1.0
        return has_ended

    return jump
