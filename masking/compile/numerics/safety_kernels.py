"""Safety kernels: are the readings of a sample those of a sound rig, and which command may be written.

`plants.safety_chain` binds them to its tables, whose columns `safety_tables` names. Everything is in the units of the
plant's channels, in arrays that are made ahead. A kernel returns 0, or the number of a cause, as
`plants.safety_chain.Cause` has it, and writes the channel, the value and the limit into `report`.
"""
# ruff: noqa: ANN001, ANN201, PLR0912, PLR0917
# The types are numba's to infer.

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from masking.compile.numerics.arrays import IntVector, Matrix, Vector
from masking.compile.numerics.compilation import compiled
from masking.compile.numerics.controller_sizes import HEATING, LARGEST, POWER
from masking.compile.numerics.safety_tables import (
    AT_ZERO,
    BOUND,
    BUCKET,
    CLAMPED,
    CLEAR,
    COMMAND,
    CUT,
    CUTS,
    DEAD,
    DELAY,
    EQUAL,
    ESTIMATED,
    FINEST,
    FIRST,
    HALF,
    HELD,
    JUMP,
    LEAST,
    MOST,
    MOTION,
    MOTION_OFF,
    MOVES,
    NO_RESPONSE,
    NOISE,
    NONFINITE,
    OFF,
    ORIGIN,
    OVER,
    PER_BUCKET,
    POSITION,
    RANGE,
    REVERSED,
    ROUGH,
    ROW,
    SECOND,
    SECOND_OF,
    SPAN,
    SPEED,
    SPEED_OFF,
    STEP,
    STUCK,
    THERMAL,
    THIRD,
    TOTAL,
    UNEXPLAINED,
    VELOCITY,
    WEIGHT,
    WHOLE,
    WRONG_SIGN,
)

Kernel = Callable[..., Any]

# The mean third difference of normal noise is 3.57 times its standard deviation, sqrt(20) sqrt(2/pi).
THIRD_DIFFERENCE = math.sqrt(40.0 / math.pi)
# A reading that was the same so often says nothing of noise, nor of a response.
SAME = 5.0
# Of the acceleration that a model gives, this part may be wrong.
WRONG = 0.5


@compiled
def tell(report, channel, value, limit):
    """Write what was found."""
    report[0], report[1], report[2] = channel, value, limit


@compiled
def plausible(s, missed, sensors, seen, counts, report):
    """Return why a reading cannot be that of a sound sensor, 0 where each can; `missed` samples came before it."""
    for i in range(s.size):
        if not math.isfinite(s[i]):
            tell(report, i, s[i], 0.0)
            return NONFINITE
    for i in range(s.size):
        if s[i] <= sensors[i, LEAST] or s[i] >= sensors[i, MOST]:
            tell(report, i, s[i], sensors[i, LEAST] if s[i] <= sensors[i, LEAST] else sensors[i, MOST])
            return RANGE
    if counts[TOTAL] > 0:
        for i in range(s.size):
            change, most = abs(s[i] - seen[i, FIRST]), sensors[i, STEP] * (1.0 + missed)
            if change > most:
                tell(report, i, change, most)
                return JUMP
    return 0


@compiled
def remember(s, missed, seen, past, counts, settings):
    """Keep the readings of a sample, and how rough each is."""
    if missed > 0:
        counts[WHOLE] = 0
    part = 1.0 / min(counts[TOTAL] + 1.0, float(settings[SECOND_OF]))
    for i in range(s.size):
        change = abs(s[i] - seen[i, FIRST])
        if change > 0.0 and counts[TOTAL] > 0:
            seen[i, FINEST] = min(seen[i, FINEST], change)
        if change > 0.0 or counts[TOTAL] == 0:
            seen[i, EQUAL] = 0.0
        else:
            seen[i, EQUAL] += 1.0 + missed
        if counts[WHOLE] >= 3 and seen[i, EQUAL] < SAME:
            third = abs(s[i] - 3.0 * seen[i, FIRST] + 3.0 * seen[i, SECOND] - seen[i, THIRD])
            seen[i, ROUGH] += part * (third - seen[i, ROUGH])
        seen[i, THIRD], seen[i, SECOND], seen[i, FIRST] = seen[i, SECOND], seen[i, FIRST], s[i]
    counts[ROW] = (counts[ROW] + 1) % past.shape[0]
    for i in range(s.size):
        past[counts[ROW], i] = s[i]
    counts[WHOLE] += 1
    counts[TOTAL] += 1


@compiled
def stuck(h, s, sensors, seen, model, past, sent, counts, settings, report):
    """STUCK where a reading stays the same to the last bit although it would change, else 0.

    It would change where its noise is more than its steps, as declared and as it was seen: what is seen may be a knob
    that is set now and then. And where the speed that it had, and the acceleration that readings and commands give
    it, would have moved it by more than all that they may be off.
    """
    rows, sensed = past.shape[0], s.size
    acting = (counts[ROW] - settings[DELAY] - 1) % rows
    for i in range(sensed):
        if seen[i, EQUAL] == 0.0:
            seen[i, MOVES] = 0.0
            continue
        span = int(sensors[i, SPAN])
        if span > 0:
            acceleration, off = 0.0, sensors[i, UNEXPLAINED]
            for j in range(sensed):
                pulled = model[i, j] * (s[j] - sensors[j, ORIGIN])
                acceleration += pulled
                off += WRONG * abs(pulled)
            for j in range(sent.shape[1]):
                pushed = model[i, sensed + j] * sent[acting, j]
                acceleration += pushed
                off += WRONG * abs(pushed)
            if seen[i, MOVES] == 0.0 and counts[WHOLE] > span + 1:  # the first of the equal ones
                before, last = past[(counts[ROW] - 1 - span) % rows, i], past[(counts[ROW] - 1) % rows, i]
                half = 0.5 * span * h
                seen[i, MOVES], seen[i, MOTION], seen[i, MOTION_OFF] = 1.0, 0.0, 0.0
                seen[i, SPEED] = (last - before) / (span * h) + half * acceleration
                seen[i, SPEED_OFF] = 2.0 * sensors[i, OFF] / (span * h) + half * off
            if seen[i, MOVES] > 0.0:
                seen[i, SPEED] += h * acceleration
                seen[i, SPEED_OFF] += h * off
                seen[i, MOTION] += h * seen[i, SPEED]
                seen[i, MOTION_OFF] += h * seen[i, SPEED_OFF]
                if abs(seen[i, MOTION]) > seen[i, MOTION_OFF] + 2.0 * sensors[i, OFF]:
                    seen[i, MOVES] = 2.0
        noise = seen[i, ROUGH] / THIRD_DIFFERENCE
        is_noisy = (
            counts[TOTAL] > settings[SECOND_OF]
            and noise > 0.5 * sensors[i, NOISE]
            and min(noise, sensors[i, NOISE]) > seen[i, FINEST]
        )
        if seen[i, EQUAL] >= settings[HELD] and (is_noisy or seen[i, MOVES] == 2.0):
            tell(report, i, s[i], settings[HELD] * h)
            return STUCK
    return 0


@compiled
def within(h, s, estimate, limits, weights, by_estimate, past, counts, report):
    """POSITION or VELOCITY where one is beyond its limit, else 0."""
    rows = past.shape[0]
    for i in range(limits.shape[0]):
        value, over = limits[i, AT_ZERO], int(limits[i, OVER])
        if limits[i, ESTIMATED] > 0.0:
            for j in range(estimate.size):
                value += by_estimate[i, j] * estimate[j]
        elif over == 0:
            for j in range(s.size):
                value += weights[i, j] * s[j]
        elif counts[WHOLE] > over:
            before = (counts[ROW] - over) % rows
            for j in range(s.size):
                value += weights[i, j] * (s[j] - past[before, j]) / (over * h)
        if not abs(value) <= limits[i, BOUND]:
            tell(report, i, value, limits[i, BOUND])
            return POSITION if over == 0 else VELOCITY
    return 0


@compiled
def respond(h, s, sensors, seen, model, past, sent, reaction, counts, settings, work, report):
    """NO_RESPONSE or WRONG_SIGN where readings do not follow a command as the model says, else 0.

    A second difference of readings over 2 n samples is the sum of the accelerations in between, weighted by a triangle.
    Where an actuator's part in it is clear, the rest without the parts of readings and of other actuators is
    compared with it: their ratio, least squares over about a second, is 1 where it answers, 0 where not.
    """
    n, rows, sensed, channels = settings[HALF], past.shape[0], s.size, sent.shape[1]
    if n == 0 or counts[WHOLE] <= 2 * n + settings[DELAY] + 1:
        return 0
    now = counts[ROW]
    pulled, pushed = work[0], work[1]
    for j in range(sensed):
        pulled[j] = 0.0
    for j in range(channels):
        pushed[j] = 0.0
    for k in range(1, 2 * n):
        part = h * h * (n - abs(n - k))
        row, acting = now - k, now - k - settings[DELAY]
        row, acting = row + rows * (row < 0), acting + rows * (acting < 0)
        for j in range(sensed):
            pulled[j] += part * (past[row, j] - sensors[j, ORIGIN])
        for j in range(channels):
            pushed[j] += part * sent[acting, j]
    forget = 1.0 / settings[SECOND_OF]
    for j in range(channels):
        reaction[j, 0] -= forget * reaction[j, 0]
        reaction[j, 1] -= forget * reaction[j, 1]
    for i in range(sensed):
        if sensors[i, SPAN] == 0.0 or seen[i, EQUAL] >= SAME:
            continue
        moved = s[i] - 2.0 * past[(now - n) % rows, i] + past[(now - 2 * n) % rows, i]
        off = 4.0 * sensors[i, OFF] + n * n * h * h * sensors[i, UNEXPLAINED]
        left = moved
        for j in range(sensed):
            left -= model[i, j] * pulled[j]
            off += WRONG * abs(model[i, j] * pulled[j])
        for j in range(channels):
            left -= model[i, sensed + j] * pushed[j]
        for j in range(channels):
            own = model[i, sensed + j] * pushed[j]
            if abs(own) > CLEAR * off:
                reaction[j, 0] += own * (left + own) / (off * off)
                reaction[j, 1] += own * own / (off * off)
    for j in range(channels):
        if reaction[j, 1] > WEIGHT * CLEAR * CLEAR:
            ratio = reaction[j, 0] / reaction[j, 1]
            if ratio < DEAD:
                tell(report, j, ratio, 1.0)
                return WRONG_SIGN if ratio < REVERSED else NO_RESPONSE
    return 0


def watch() -> Kernel:
    """Make what is done with the readings of a sample before the controller gets them."""

    @compiled
    def watch(
        missed: int, h: float, s: Vector, estimate: Vector, sensors: Matrix, seen: Matrix, model: Matrix, past: Matrix,
        sent: Matrix, limits: Matrix, weights: Matrix, by_estimate: Matrix, reaction: Matrix, counts: IntVector,
        settings: IntVector, report: Vector, work: Matrix,
    ) -> int:  # fmt: skip
        cause = plausible(s, missed, sensors, seen, counts, report)
        if cause == 0:
            remember(s, missed, seen, past, counts, settings)
            cause = stuck(h, s, sensors, seen, model, past, sent, counts, settings, report)
        if cause == 0:
            cause = within(h, s, estimate, limits, weights, by_estimate, past, counts, report)
        if cause == 0:
            cause = respond(h, s, sensors, seen, model, past, sent, reaction, counts, settings, work, report)
        return cause

    return watch


def guard() -> Kernel:
    """Make what is done with the command of a sample before it is written: finite, clamped, and not too warm.

    The energy of an actuator in buckets of equal time, the one in use included, never exceeds the largest mean power
    over all of them: no mean over the declared time exceeds it by more than a bucket's part.
    """

    @compiled
    def guard(
        h: float, demanded: Vector, applied: Vector, table: Matrix, energy: Matrix, sent: Matrix, counts: IntVector,
        settings: IntVector, report: Vector,
    ) -> int:  # fmt: skip
        buckets, is_clamped, is_cut, cause = energy.shape[1] - 1, False, -1, 0
        at = counts[BUCKET] // settings[PER_BUCKET]
        if counts[BUCKET] % settings[PER_BUCKET] == 0:
            for i in range(applied.size):
                energy[i, at] = energy[i, buckets] = 0.0
                for k in range(buckets):
                    energy[i, buckets] += energy[i, k]
        counts[BUCKET] = (counts[BUCKET] + 1) % (buckets * settings[PER_BUCKET])
        for i in range(applied.size):
            if not math.isfinite(demanded[i]):
                tell(report, i, demanded[i], 0.0)
                cause = COMMAND
        for i in range(applied.size):
            applied[i] = 0.0
            if cause != 0:
                continue
            applied[i] = min(max(demanded[i], -table[i, LARGEST]), table[i, LARGEST])
            is_clamped = is_clamped or applied[i] != demanded[i]
            heating = table[i, HEATING]
            if heating > 0.0:
                full = table[i, POWER] * buckets * settings[PER_BUCKET] * h
                free = max(0.0, full * (1.0 + 1e-9) - energy[i, buckets]) / h
                if heating * applied[i] * applied[i] > free:
                    applied[i] = math.copysign(math.sqrt(free / heating), applied[i])
                    is_clamped, is_cut = True, i
                spent = heating * applied[i] * applied[i] * h
                energy[i, at] += spent
                energy[i, buckets] += spent
        if is_clamped:
            counts[CLAMPED] += 1
        counts[CUT] = counts[CUT] + 1 if is_cut >= 0 else max(0, counts[CUT] - 1)
        if counts[CUT] > settings[CUTS]:
            tell(report, is_cut, table[is_cut, POWER], table[is_cut, POWER])
            cause = THERMAL
            for i in range(applied.size):
                applied[i] = 0.0
        for i in range(applied.size):
            sent[counts[ROW], i] = applied[i]
        return cause

    return guard
