"""Kernels of what a virtual system remembers: its internal states, and the past of its delayed expressions.

For the rig's state y = [q, v, s, z, w], `remember(t, y, p, dz)` writes the rates of the virtual system's internal
states z, and `lagged(t, y, p, w)` what its delayed expressions are now. What they were is kept at the samples, those
that are predicted included, and read between them by a cubic: `Sizes.past` says where. Until the release they are as at
its beginning. `conditions(t, y, p, w)` writes the conditions of its events, and then the values that jump.
"""
# ruff: noqa: ANN001, ANN202, PLR0915, PLR0917
# The types are numba's to infer, and what a kernel calls stands before it.

from __future__ import annotations

import math
from typing import NamedTuple

from masking.compile.numerics import controller_rows as rows
from masking.compile.numerics.arrays import Kernel, Vector
from masking.compile.numerics.compilation import compiled
from masking.compile.numerics.controller_sizes import Sizes
from masking.compile.numerics.events import jumps
from masking.compile.numerics.runge_kutta import classical_step, copy, part_at

EVENTS = 8  # in one of these
HALVINGS = 16  # of one of these, to find an event


class Motion(NamedTuple):
    """A motion of length h from state a at time t to state b, whose internal states are on their way."""

    t: float
    h: float
    a: Vector
    b: Vector


class Piece(NamedTuple):
    """A part of a motion, from a point x of it on; the past, the parameters, and the state of a stage."""

    x: float
    part: float
    past: Vector
    p: Vector
    y: Vector


def notice_past(lagged: Kernel, sizes: Sizes) -> Kernel:
    """Make `notice(t, y, past, p, w)`, which keeps what the delayed expressions are at a sample; `w` is work space."""
    lags, kept, first = sizes.lags, sizes.kept, 2 + sizes.lags

    @compiled
    def notice(t, y, past, p, w):
        if lags > 0 and t > -0.25 * past[1]:
            index = math.floor(t / past[1] + 0.5)
            lagged(t, y, p, w)
            row = first + lags * (index % kept)
            for j in range(lags):
                past[row + j] = w[j]
            past[0] = index

    return notice


def recall_past(sizes: Sizes) -> Kernel:
    """Make `recall(t, y, past)`, which writes into y what the delayed expressions were, as seen from time t.

    The cubic passes through the four samples around it, or the last four; none of them is from before the release.
    """
    lags, kept, first, slot = sizes.lags, sizes.kept, 2 + sizes.lags, sizes.memory.stop

    @compiled
    def recall(t, y, past):
        for j in range(lags):
            newest, at = math.floor(past[0]), t / past[1] - past[2 + j]
            low = min(math.floor(at), newest - 1)
            middle = max(1, min(low, newest - 2))
            if at <= 0.0 or newest < 1:
                y[slot + j] = past[first + lags * (kept - 1) + j]
            elif newest < 3:
                a, b = past[first + lags * (low % kept) + j], past[first + lags * ((low + 1) % kept) + j]
                y[slot + j] = a + (at - low) * (b - a)
            else:
                x = at - middle
                a, b = past[first + lags * ((middle - 1) % kept) + j], past[first + lags * (middle % kept) + j]
                c, d = past[first + lags * ((middle + 1) % kept) + j], past[first + lags * ((middle + 2) % kept) + j]
                outer = (x + 1.0) * x * (x - 1.0) * d - x * (x - 1.0) * (x - 2.0) * a
                inner = (x + 1.0) * (x - 1.0) * (x - 2.0) * b - (x + 1.0) * x * (x - 2.0) * c
                y[slot + j] = outer / 6.0 + inner / 2.0

    return recall


def follow_memory(remember: Kernel, recall: Kernel, conditions: Kernel, sizes: Sizes) -> tuple[Kernel, Kernel, Kernel]:
    """Make the integration of internal states between two states of the rig.

    Between them the rig moves along the cubic that has their coordinates and velocities, so that what is integrated is
    the motion that was estimated, its corrections included. Each part is a step of the classical Runge-Kutta method; at
    an event it ends, and the states jump; of those beyond `EVENTS` in a part, none jumps. Until the release, at time 0,
    internal states stay as they are.

    Returns `follow(t, h, a, b, past, p, work)`, for a motion of length h from state a at time t to state b; reads z in
    a and writes it in b; `work` is work space from the row `MEMORY` of `controller_rows` on. `glide`, with the same
    arguments, which passes over events as if there were none. `mean_jump(t, h, a, b, past, p, work, m)`, which writes
    by how much z is further on the mean of the motion than without its events.
    """
    n, first, last, events = sizes.coordinates, sizes.memory.start, sizes.memory.stop, sizes.events
    steps = sizes.steps
    jump = jumps(conditions, events, sizes.targets, EVENTS)

    @compiled
    def place(motion, x, y):
        a, b, h = motion.a, motion.b, motion.h
        for i in range(n):
            way, early, late = b[i] - a[i], h * a[n + i], h * b[n + i]
            square, cube = 3.0 * way - 2.0 * early - late, early + late - 2.0 * way
            y[i] = a[i] + x * (early + x * (square + x * cube))
            y[n + i] = (early + x * (2.0 * square + 3.0 * x * cube)) / h

    @compiled
    def slope(t, stage, z, motion, piece, dz):
        y = piece.y
        if stage != 2:  # which is where the stage before is
            place(motion, piece.x + part_at(stage) * piece.part, y)
            recall(t, y, piece.past)
        for i in range(first, last):
            y[i] = z[i - first]
        remember(t, y, piece.p, dz)

    step = classical_step(slope, last - first)

    @compiled
    def advance(motion, x, part, past, p, work):
        piece = Piece(x, part, past, p, work[rows.STATE])
        begin, slopes = motion.t + x * motion.h, work[rows.MEMORY_SLOPES : rows.MEMORY_STAGE]
        step(begin, motion.b[first:last], motion, piece, part * motion.h, slopes, work[rows.MEMORY_STAGE])

    @compiled
    def look(motion, x, p, y, w):
        place(motion, x, y)
        for i in range(first, last):
            y[i] = motion.b[i]
        conditions(motion.t + x * motion.h, y, p, w)

    @compiled
    def has_crossed(below, w):
        found = 0
        for e in range(events):
            if below[e] > 0.0 and w[e] >= 0.0:
                found = 1
        return found

    @compiled
    def again(motion, x, end, past, p, work):
        for i in range(first, last):
            motion.b[i] = work[rows.MEMORY_BEFORE, i]
        advance(motion, x, end - x, past, p, work)
        look(motion, end, p, work[rows.STATE], work[rows.CONDITIONS])

    @compiled
    def advance_over_events(motion, x, part, past, p, work):
        b, y, before, w = motion.b, work[rows.STATE], work[rows.MEMORY_BEFORE], work[rows.CONDITIONS]
        below, counts, total = work[rows.BELOW], work[rows.COUNTS], work[rows.TOTAL]
        at, end = x, x + part
        look(motion, at, p, y, w)
        for e in range(events):
            below[e] = 1.0 if w[e] < 0.0 else 0.0
        for _ in range(EVENTS):
            if at < end:
                for i in range(first, last):
                    before[i] = b[i]
                advance(motion, at, end - at, past, p, work)
                look(motion, end, p, y, w)
                if has_crossed(below, w) == 0:
                    for i in range(first, last):
                        total[i] += 0.5 * (end - at) * (before[i] + b[i])
                    at = end
                else:
                    low, high = at, end
                    for _ in range(HALVINGS):
                        middle = 0.5 * (low + high)
                        again(motion, at, middle, past, p, work)
                        if has_crossed(below, w) == 0:
                            low = middle
                        else:
                            high = middle
                    again(motion, at, high, past, p, work)
                    jump(motion.t + high * motion.h, y, p, below, counts, w)
                    for i in range(first, last):
                        total[i] += 0.5 * (high - at) * (before[i] + b[i])
                        b[i] = y[i]
                    at = high
        if at < end:
            advance(motion, at, end - at, past, p, work)

    def in_steps(move: Kernel) -> Kernel:
        @compiled
        def follow(t, h, a, b, past, p, work):
            for i in range(first, last):
                b[i] = a[i]
            if first < last and h > 0.0 and t > -0.25 * h:
                copy(a, work[rows.STATE], first)
                for j in range(steps):
                    move(Motion(t, h, a, b), j / steps, 1.0 / steps, past, p, work)

        return follow

    glide = in_steps(advance)
    follow = in_steps(advance_over_events) if events > 0 else glide

    @compiled
    def mean_jump(t, h, a, b, past, p, work, m):
        motion, total = Motion(t, h, a, b), work[rows.TOTAL]
        for i in range(first, last):
            m[i] = 0.0
            total[i] = 0.0
        if t > -0.25 * h:
            follow(t, h, a, b, past, p, work)
            for i in range(first, last):
                m[i] = total[i]
                b[i] = a[i]
            for j in range(steps):
                for i in range(first, last):
                    m[i] -= 0.5 / steps * b[i]
                advance(motion, j / steps, 1.0 / steps, past, p, work)
                for i in range(first, last):
                    m[i] -= 0.5 / steps * b[i]

    return follow, glide, mean_jump
