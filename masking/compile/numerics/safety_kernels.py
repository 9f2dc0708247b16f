"""Safety kernels: are the readings of a sample those of a sound rig, and which command may be written.

`plants.safety_chain` binds them to its tables, whose columns `safety_tables` names. Everything is in the units of the
plant's channels, in arrays that are made ahead. A kernel returns 0, or the number of a cause, as
`plants.safety_chain.Cause` has it, and writes the channel, the value and the limit into `report`.
"""
# ruff: noqa: ANN001, ANN201, PLR0912, PLR0917
# The types are numba's to infer.

from __future__ import annotations

import math

from masking.compile.numerics import safety_tables as tables
from masking.compile.numerics.arrays import Matrix, Vector
from masking.compile.numerics.compilation import compiled, requires
from masking.compile.numerics.controller_sizes import HEATING, LARGEST, POWER
from masking.compile.numerics.kernel_arguments import Guarded, Watched

# The mean third difference of normal noise is 3.57 times its standard deviation, sqrt(20) sqrt(2/pi).
THIRD_DIFFERENCE = math.sqrt(40.0 / math.pi)
# A reading that was the same so often says nothing of noise, nor of a response.
SAME = 5.0
# Of the acceleration that a model gives, this part may be wrong.
WRONG = 0.5


@compiled
def tell(report, channel, value, limit):
    """Write the channel, value and limit of a cause."""
    report[0], report[1], report[2] = channel, value, limit


@compiled
def plausible(s, missed, known):
    """Why a reading cannot be that of a sound sensor, 0 where each can; `missed` samples came before it."""
    sensors, seen, counts, report = known.sensors, known.seen, known.counts, known.report
    for i in range(s.size):
        if not math.isfinite(s[i]):
            tell(report, i, s[i], 0.0)
            return tables.NONFINITE
    for i in range(s.size):
        if s[i] <= sensors[i, tables.LEAST] or s[i] >= sensors[i, tables.MOST]:
            bound = tables.LEAST if s[i] <= sensors[i, tables.LEAST] else tables.MOST
            tell(report, i, s[i], sensors[i, bound])
            return tables.RANGE
    if counts[tables.TOTAL] > 0:
        for i in range(s.size):
            change, most = abs(s[i] - seen[i, tables.FIRST]), sensors[i, tables.STEP] * (1.0 + missed)
            if change > most:
                tell(report, i, change, most)
                return tables.JUMP
    return 0


@compiled
def remember(s, missed, known):
    """Keep the readings of a sample, and how rough each is."""
    seen, past, counts, settings = known.seen, known.past, known.counts, known.settings
    if missed > 0:
        counts[tables.WHOLE] = 0
    part = 1.0 / min(counts[tables.TOTAL] + 1.0, float(settings[tables.SECOND_OF]))
    for i in range(s.size):
        change = abs(s[i] - seen[i, tables.FIRST])
        if change > 0.0 and counts[tables.TOTAL] > 0:
            seen[i, tables.FINEST] = min(seen[i, tables.FINEST], change)
        if change > 0.0 or counts[tables.TOTAL] == 0:
            seen[i, tables.EQUAL] = 0.0
        else:
            seen[i, tables.EQUAL] += 1.0 + missed
        if counts[tables.WHOLE] >= 3 and seen[i, tables.EQUAL] < SAME:
            third = abs(s[i] - 3.0 * seen[i, tables.FIRST] + 3.0 * seen[i, tables.SECOND] - seen[i, tables.THIRD])
            seen[i, tables.ROUGH] += part * (third - seen[i, tables.ROUGH])
        seen[i, tables.THIRD], seen[i, tables.SECOND], seen[i, tables.FIRST] = (
            seen[i, tables.SECOND],
            seen[i, tables.FIRST],
            s[i],
        )
    counts[tables.ROW] = (counts[tables.ROW] + 1) % past.shape[0]
    for i in range(s.size):
        past[counts[tables.ROW], i] = s[i]
    counts[tables.WHOLE] += 1
    counts[tables.TOTAL] += 1


@compiled
def stuck(h, s, known):
    """STUCK where a reading stays the same to the last bit although it would change, else 0.

    It would change where its noise is more than its steps, as declared and as it was seen: what is seen may be a knob
    that is set now and then. And where the speed that it had, and the acceleration that readings and commands give
    it, would have moved it by more than all that they may be off.
    """
    sensors, seen, model, past, sent = known.sensors, known.seen, known.model, known.past, known.sent
    counts, settings = known.counts, known.settings
    rows, sensed = past.shape[0], s.size
    acting = (counts[tables.ROW] - settings[tables.DELAY] - 1) % rows
    for i in range(sensed):
        if seen[i, tables.EQUAL] == 0.0:
            seen[i, tables.MOVES] = 0.0
            continue
        span = int(sensors[i, tables.SPAN])
        if span > 0:
            acceleration, off = 0.0, sensors[i, tables.UNEXPLAINED]
            for j in range(sensed):
                pulled = model[i, j] * (s[j] - sensors[j, tables.ORIGIN])
                acceleration += pulled
                off += WRONG * abs(pulled)
            for j in range(sent.shape[1]):
                pushed = model[i, sensed + j] * sent[acting, j]
                acceleration += pushed
                off += WRONG * abs(pushed)
            if seen[i, tables.MOVES] == 0.0 and counts[tables.WHOLE] > span + 1:  # the first of the equal ones
                before, last = past[(counts[tables.ROW] - 1 - span) % rows, i], past[(counts[tables.ROW] - 1) % rows, i]
                half = 0.5 * span * h
                seen[i, tables.MOVES], seen[i, tables.MOTION], seen[i, tables.MOTION_OFF] = 1.0, 0.0, 0.0
                seen[i, tables.SPEED] = (last - before) / (span * h) + half * acceleration
                seen[i, tables.SPEED_OFF] = 2.0 * sensors[i, tables.OFF] / (span * h) + half * off
            if seen[i, tables.MOVES] > 0.0:
                seen[i, tables.SPEED] += h * acceleration
                seen[i, tables.SPEED_OFF] += h * off
                seen[i, tables.MOTION] += h * seen[i, tables.SPEED]
                seen[i, tables.MOTION_OFF] += h * seen[i, tables.SPEED_OFF]
                if abs(seen[i, tables.MOTION]) > seen[i, tables.MOTION_OFF] + 2.0 * sensors[i, tables.OFF]:
                    seen[i, tables.MOVES] = 2.0
        noise = seen[i, tables.ROUGH] / THIRD_DIFFERENCE
        is_noisy = (
            counts[tables.TOTAL] > settings[tables.SECOND_OF]
            and noise > 0.5 * sensors[i, tables.NOISE]
            and min(noise, sensors[i, tables.NOISE]) > seen[i, tables.FINEST]
        )
        if seen[i, tables.EQUAL] >= settings[tables.HELD] and (is_noisy or seen[i, tables.MOVES] == 2.0):
            tell(known.report, i, s[i], settings[tables.HELD] * h)
            return tables.STUCK
    return 0


@compiled
def within(h, s, estimate, known):
    """POSITION or VELOCITY where one is beyond its limit, else 0."""
    limits, weights, past, counts = known.limits, known.weights, known.past, known.counts
    rows = past.shape[0]
    for i in range(limits.shape[0]):
        value, over = limits[i, tables.AT_ZERO], int(limits[i, tables.OVER])
        if limits[i, tables.ESTIMATED] > 0.0:
            for j in range(estimate.size):
                value += known.by_estimate[i, j] * estimate[j]
        elif over == 0:
            for j in range(s.size):
                value += weights[i, j] * s[j]
        elif counts[tables.WHOLE] > over:
            before = (counts[tables.ROW] - over) % rows
            for j in range(s.size):
                value += weights[i, j] * (s[j] - past[before, j]) / (over * h)
        if not abs(value) <= limits[i, tables.BOUND]:
            tell(known.report, i, value, limits[i, tables.BOUND])
            return tables.POSITION if over == 0 else tables.VELOCITY
    return 0


@compiled
def respond(h, s, known, work):
    """NO_RESPONSE or WRONG_SIGN where readings do not follow a command as the model says, else 0.

    A second difference of readings over 2 n samples is the sum of the accelerations in between, weighted by a triangle.
    Where an actuator's part in it is clear, the rest without the parts of readings and of other actuators is
    compared with it: their ratio, least squares over about a second, is 1 where it answers, 0 where not.
    """
    sensors, seen, model, past, sent = known.sensors, known.seen, known.model, known.past, known.sent
    reaction, counts, settings = known.reaction, known.counts, known.settings
    n, rows, sensed, channels = settings[tables.HALF], past.shape[0], s.size, sent.shape[1]
    if n == 0 or counts[tables.WHOLE] <= 2 * n + settings[tables.DELAY] + 1:
        return 0
    now = counts[tables.ROW]
    pulled, pushed = work[0], work[1]
    for j in range(sensed):
        pulled[j] = 0.0
    for j in range(channels):
        pushed[j] = 0.0
    for k in range(1, 2 * n):
        part = h * h * (n - abs(n - k))
        row, acting = now - k, now - k - settings[tables.DELAY]
        row, acting = row + rows * (row < 0), acting + rows * (acting < 0)
        for j in range(sensed):
            pulled[j] += part * (past[row, j] - sensors[j, tables.ORIGIN])
        for j in range(channels):
            pushed[j] += part * sent[acting, j]
    forget = 1.0 / settings[tables.SECOND_OF]
    for j in range(channels):
        reaction[j, 0] -= forget * reaction[j, 0]
        reaction[j, 1] -= forget * reaction[j, 1]
    for i in range(sensed):
        if sensors[i, tables.SPAN] == 0.0 or seen[i, tables.EQUAL] >= SAME:
            continue
        moved = s[i] - 2.0 * past[(now - n) % rows, i] + past[(now - 2 * n) % rows, i]
        off = 4.0 * sensors[i, tables.OFF] + n * n * h * h * sensors[i, tables.UNEXPLAINED]
        left = moved
        for j in range(sensed):
            left -= model[i, j] * pulled[j]
            off += WRONG * abs(model[i, j] * pulled[j])
        for j in range(channels):
            left -= model[i, sensed + j] * pushed[j]
        for j in range(channels):
            own = model[i, sensed + j] * pushed[j]
            if abs(own) > tables.CLEAR * off:
                reaction[j, 0] += own * (left + own) / (off * off)
                reaction[j, 1] += own * own / (off * off)
    for j in range(channels):
        if reaction[j, 1] > tables.WEIGHT * tables.CLEAR * tables.CLEAR:
            ratio = reaction[j, 0] / reaction[j, 1]
            if ratio < tables.DEAD:
                tell(known.report, j, ratio, 1.0)
                return tables.WRONG_SIGN if ratio < tables.REVERSED else tables.NO_RESPONSE
    return 0


@compiled
@requires(
    f"len(known.counts) >= {tables.COUNTS} and len(known.settings) >= {tables.SETTINGS} and len(known.report) > 2",
    f"known.sensors.shape[1] >= {tables.SENSOR_COLUMNS} and known.seen.shape[1] >= {tables.SEEN_COLUMNS}",
    f"known.limits.shape[1] >= {tables.LIMIT_COLUMNS} and known.reaction.shape[1] > 1 and len(work) > 1",
    "(n := len(s)) <= min(len(known.sensors), len(known.seen), len(known.model), known.past.shape[1])",
    "n + (channels := known.sent.shape[1]) <= known.model.shape[1] and channels <= len(known.reaction)",
    "0 < (rows := len(known.past)) <= len(known.sent) and max(n, channels) <= work.shape[1]",
    f"within(known.counts[{tables.ROW}], rows) and known.settings[{tables.DELAY}] >= 0",
    f"2 * known.settings[{tables.HALF}] + known.settings[{tables.DELAY}] <= rows",
    "(limits := len(known.limits)) <= len(known.weights) and (limits == 0 or n <= known.weights.shape[1])",
    f"not any(known.limits[:, {tables.ESTIMATED}] > 0.0) or limits <= len(known.by_estimate)",
    f"not any(known.limits[:, {tables.ESTIMATED}] > 0.0) or len(estimate) <= known.by_estimate.shape[1]",
)
def watch(missed: int, h: float, s: Vector, estimate: Vector, known: Watched, work: Matrix) -> int:
    """Check a sample's readings, before the controller gets them."""
    cause = plausible(s, missed, known)
    if cause == 0:
        remember(s, missed, known)
        cause = stuck(h, s, known)
    if cause == 0:
        cause = within(h, s, estimate, known)
    if cause == 0:
        cause = respond(h, s, known, work)
    return cause


@compiled
@requires(
    "(channels := len(applied)) <= min(len(demanded), len(known.table), len(known.energy), known.sent.shape[1])",
    f"known.table.shape[1] >= {tables.ACTUATOR_COLUMNS} and len(known.counts) >= {tables.COUNTS}",
    f"within(known.counts[{tables.ROW}], len(known.sent)) and known.settings[{tables.PER_BUCKET}] > 0",
    f"within(known.counts[{tables.BUCKET}] // known.settings[{tables.PER_BUCKET}], known.energy.shape[1] - 1)",
)
def guard(h: float, demanded: Vector, applied: Vector, known: Guarded) -> int:
    """Check a sample's command, before it is written: finite, clamped, not too fast, and not too warm.

    `applied` is the command of the sample before, whose change is limited; less power may take a larger change.
    The energy of an actuator in buckets of equal time, the one in use included, never exceeds the largest mean power
    over all of them: no mean over the declared time exceeds it by more than a bucket's part.
    """
    table, energy, sent, counts, settings, report = known
    buckets, is_clamped, is_cut, is_slowed, cause, asked = energy.shape[1] - 1, False, -1, -1, 0, 0.0
    at = counts[tables.BUCKET] // settings[tables.PER_BUCKET]
    if counts[tables.BUCKET] % settings[tables.PER_BUCKET] == 0:
        for i in range(applied.size):
            energy[i, at] = energy[i, buckets] = 0.0
            for k in range(buckets):
                energy[i, buckets] += energy[i, k]
    counts[tables.BUCKET] = (counts[tables.BUCKET] + 1) % (buckets * settings[tables.PER_BUCKET])
    for i in range(applied.size):
        if not math.isfinite(demanded[i]):
            tell(report, i, demanded[i], 0.0)
            cause = tables.COMMAND
    for i in range(applied.size):
        if cause != 0:
            continue
        before, change = applied[i], table[i, tables.RATE] * h
        applied[i] = min(max(demanded[i], -table[i, LARGEST]), table[i, LARGEST])
        if abs(applied[i] - before) > change:
            asked, is_slowed = (applied[i] - before) / h, i
            applied[i] = before + math.copysign(change, asked)
        is_clamped = is_clamped or applied[i] != demanded[i]
        heating = table[i, HEATING]
        if heating > 0.0:
            full = table[i, POWER] * buckets * settings[tables.PER_BUCKET] * h
            free = max(0.0, full * (1.0 + 1e-9) - energy[i, buckets]) / h
            if heating * applied[i] * applied[i] > free:
                applied[i] = math.copysign(math.sqrt(free / heating), applied[i])
                is_clamped, is_cut = True, i
            spent = heating * applied[i] * applied[i] * h
            energy[i, at] += spent
            energy[i, buckets] += spent
    if is_clamped:
        counts[tables.CLAMPED] += 1
    counts[tables.CUT] = counts[tables.CUT] + 1 if is_cut >= 0 else max(0, counts[tables.CUT] - 1)
    counts[tables.SLOWED] = counts[tables.SLOWED] + 1 if is_slowed >= 0 else max(0, counts[tables.SLOWED] - 1)
    if counts[tables.CUT] > settings[tables.CUTS]:
        tell(report, is_cut, table[is_cut, POWER], table[is_cut, POWER])
        cause = tables.THERMAL
    elif counts[tables.SLOWED] > settings[tables.CUTS]:
        tell(report, is_slowed, asked, table[is_slowed, tables.RATE])
        cause = tables.COMMAND_RATE
    for i in range(applied.size):
        applied[i] = 0.0 if cause != 0 else applied[i]
        sent[counts[tables.ROW], i] = applied[i]
    return cause
