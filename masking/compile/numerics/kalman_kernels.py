"""Extended Kalman filter of a twin's state and parameters, and the fixed-gain filter and smoother of a latent force.

The covariance of (y, theta) is carried and corrected as a whole (`FULL`, in Joseph's form) or by its upper triangular
root (`ROOT`). Readings of a sample correct it one by one.
Source: Gelb (ed.), Applied Optimal Estimation (1974), table 6.1-1; Bierman, Factorization Methods for Discrete
Sequential Estimation (1977), chapters II, V and VII; Rauch, Tung and Striebel (1965), AIAA Journal 3(8), 1445-1450.
"""
# ruff: noqa: ANN001, ANN201, ANN202, PLR0912, PLR0915, PLR0917
# The types are numba's to infer, and a filter is one long function.

from __future__ import annotations

import math
from dataclasses import dataclass

from masking.compile.numerics.arrays import Kernel, Matrix
from masking.compile.numerics.compilation import compiled, requires
from masking.compile.numerics.kernel_arguments import (
    Filtered,
    FilteredTwin,
    FilterRecord,
    FilterSteps,
    LatentRig,
    Steps,
    TwinArrays,
)
from masking.compile.numerics.motion_sensitivities import (
    Derivatives,
    command_at,
    drive,
    driven_step,
    motion_alone,
    motion_with_derivatives,
    take,
)
from masking.compile.numerics.rig_sizes import LANES
from masking.compile.numerics.runge_kutta import copy
from masking.compile.numerics.stop_codes import LINEARISE, NOT_FINITE, NOT_POSITIVE, REACHED

# Rows of the table of the parameters' limits: bounds, and the change after which derivatives are found anew.
LOW, HIGH, CHANGE = range(3)


@dataclass(frozen=True)
class Covariance:
    """How a covariance P (size, size) is held."""

    # `carry(matrix, columns, q, dt, k, work)`: P <- F (P + Q/2) F^T + Q/2 over a sample, with derivatives of the state
    # by (theta, y) in `columns` (n, k + n) and Q dt of intensity q (n,)
    carry: Kernel
    # `correct(matrix, h, variance, gain, seen) -> spread`: by a reading h^T (y, theta) of given variance; returns that
    # of its innovation, negative if P is not positive, with the gain in `gain`
    correct: Kernel
    variance: Kernel  # `variance(matrix, i)` of an entry of (y, theta)


@compiled
def carry_full(matrix, columns, q, dt, k, work):
    """Carry a covariance over a sample."""
    n, size = columns.shape[0], matrix.shape[0]
    for i in range(n):
        matrix[i, i] += 0.5 * dt * q[i]
    for i in range(n):
        for j in range(size):
            work[i, j] = 0.0
        for m in range(size):
            by = columns[i, k + m] if m < n else columns[i, m - n]
            if by != 0.0:
                for j in range(size):
                    work[i, j] += by * matrix[m, j]
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for m in range(n):
                total += work[i, m] * columns[j, k + m]
            for m in range(k):
                total += work[i, n + m] * columns[j, m]
            matrix[i, j] = total
            matrix[j, i] = total
        for j in range(n, size):
            matrix[i, j] = work[i, j]
            matrix[j, i] = work[i, j]
        matrix[i, i] += 0.5 * dt * q[i]


@compiled
def carry_root(matrix, columns, q, dt, k, work):
    """Carry the upper triangular root of a covariance over a sample."""
    n = columns.shape[0]
    wide, work = take(work, n)
    cross, work = take(work, n)
    for i in range(n):
        for j in range(3 * n):
            wide[i, j] = 0.0
        for m in range(n):
            by = columns[i, k + m]
            for j in range(m, n):
                wide[i, j] += by * matrix[m, j]
            wide[i, n + m] = by * math.sqrt(0.5 * dt * q[m])
        wide[i, 2 * n + i] = math.sqrt(0.5 * dt * q[i])
        for j in range(k):
            cross[i, j] = 0.0
        for m in range(n):
            by = columns[i, k + m]
            for j in range(k):
                cross[i, j] += by * matrix[m, n + j]
        for m in range(k):
            by = columns[i, m]
            for j in range(m, k):
                cross[i, j] += by * matrix[n + m, n + j]
    triangularise(wide, n)
    for i in range(n):
        for j in range(i, n):
            matrix[i, j] = wide[i, j]
        for j in range(k):
            matrix[i, n + j] = cross[i, j]


@compiled
def triangularise(wide, n):
    """Reduce (n, 3 n) to an upper triangle in its first n columns, by reflections of Householder from the last row up.

    The product of the matrix with its transpose stays as it is.
    """
    for i in range(n - 1, -1, -1):
        square = 0.0
        for j in range(3 * n):
            if j <= i or j >= n:
                square += wide[i, j] * wide[i, j]
        if square == 0.0:
            continue
        norm, head = math.sqrt(square), wide[i, i]
        end = -norm if head > 0.0 else norm
        scale = square - head * end
        wide[i, i] = head - end
        for r in range(i):
            total = 0.0
            for j in range(3 * n):
                if j <= i or j >= n:
                    total += wide[r, j] * wide[i, j]
            total /= scale
            for j in range(3 * n):
                if j <= i or j >= n:
                    wide[r, j] -= total * wide[i, j]
        for j in range(3 * n):
            if j < i or j >= n:
                wide[i, j] = 0.0
        wide[i, i] = end


@compiled
def correct_full(matrix, h, variance, gain, seen):
    """Correct a covariance by a reading, in the form of Joseph."""
    size = matrix.shape[0]
    for i in range(size):
        seen[i] = 0.0
    for m in range(size):
        by = h[m]
        if by != 0.0:
            for i in range(size):
                seen[i] += by * matrix[m, i]
    spread = 0.0
    for i in range(size):
        spread += h[i] * seen[i]
    total = spread + variance
    for i in range(size):
        gain[i] = seen[i] / total
    for i in range(size):
        corrected = seen[i] - gain[i] * spread
        for j in range(i + 1):
            matrix[i, j] += (variance * gain[i] - corrected) * gain[j] - gain[i] * seen[j]
            matrix[j, i] = matrix[i, j]
    return total if spread >= 0.0 else -1.0


@compiled
def correct_root(matrix, h, variance, gain, seen):
    """Correct the upper triangular root of a covariance by a reading, after Carlson (1973)."""
    size = matrix.shape[0]
    total = variance
    for i in range(size):
        gain[i] = 0.0
    for j in range(size):
        f = 0.0
        for i in range(j + 1):
            f += h[i] * matrix[i, j]
        before = total
        total += f * f
        keep, lose = math.sqrt(before / total), f / math.sqrt(before * total)
        for i in range(j + 1):
            entry = matrix[i, j]
            matrix[i, j] = entry * keep - gain[i] * lose
            gain[i] += entry * f
    for i in range(size):
        gain[i] /= total
    return total


@compiled
def variance_full(matrix, i):
    """Variance of an entry."""
    return matrix[i, i]


@compiled
def variance_root(matrix, i):
    """Variance of an entry, of the upper triangular root."""
    total = 0.0
    for j in range(i, matrix.shape[0]):
        total += matrix[i, j] * matrix[i, j]
    return total


FULL = Covariance(carry_full, correct_full, variance_full)
ROOT = Covariance(carry_root, correct_root, variance_root)


def extended_filter(slopes: Kernel, sensed: Kernel, carry: Kernel, has_root: bool) -> Kernel:
    """Make the extended Kalman filter of a twin's state and parameters.

    `slopes` writes the rates of the state, `sensed` readings, both with derivatives, and `carry` moves derivatives of
    the state over a step; the covariance is held by its triangular root, or as a whole.

    Returns `follow(steps, twin, matrix, columns, record, filtered, work) -> (status, next sample)`, which follows
    samples from `begin` on, linearising the readings of a sample `updates` times, each about the estimate before. The
    state, the parameters, p and the covariance `matrix` are those of the next sample afterwards.
    """
    advance = driven_step(motion_with_derivatives(slopes))
    form = ROOT if has_root else FULL
    carry_covariance, correct, variance_of = form.carry, form.correct, form.variance

    @compiled
    def place(theta, since, origin, affected, basis, p):
        for i in range(affected.size):
            total = 0.0
            for j in range(basis.shape[1]):
                total += basis[i, j] * (theta[j] - since[j])
            p[affected[i]] = origin[i] + total

    @compiled
    def linearise(by_state, by_entry, basis, n, row):
        for i in range(n):
            row[i] = by_state[i]
        for j in range(basis.shape[1]):
            total = 0.0
            for i in range(basis.shape[0]):
                total += by_entry[i] * basis[i, j]
            row[n + j] = total

    @compiled
    @requires(
        "(n := len(twin.y)) >= max(linked.y, linked.rate, linked.columns) and len(twin.p) >= linked.p",
        "(channels := record.commands.shape[1]) >= linked.u and (sensors := len(record.r)) >= linked.s",
        "(size := n + (k := len(twin.theta))) == len(matrix) and size <= matrix.shape[1]",
        "(wide := work.shape[1]) >= max(linked.width, 3 * n, size, channels, len(twin.affected))",
        "len(work) >= 7 * n + 3 * sensors + size + 18 and len(columns) >= 5 * n",
        f"size <= (many := columns.shape[1]) and many % {LANES} == 0",
        "0 <= steps.begin and (end := min(steps.begin + steps.samples, len(record.readings))) <= len(record.commands)",
        "sensors <= record.readings.shape[1] and end <= min(map(len, (filtered.states, filtered.estimates)))",
        "end <= len(filtered.innovations) and 2 * sensors <= filtered.innovations.shape[1]",
        "n <= filtered.states.shape[1] and 2 * k <= filtered.estimates.shape[1] and n <= len(record.q)",
        "len(twin.affected) <= len(twin.basis) <= wide and twin.basis.shape[1] <= k",
        "within(twin.affected, len(twin.p)) and len(record.limits) > 2 and record.limits.shape[1] >= k",
        "0 <= twin.coordinates <= n and are_terms(twin.moved, twin.moved_by, n, wide, many)",
    )
    def follow(
        steps: FilterSteps, twin: FilteredTwin, matrix: Matrix, columns: Matrix, record: FilterRecord,
        filtered: Filtered, work: Matrix,
    ) -> tuple[int, int]:  # fmt: skip
        begin, count, dt, substeps, _, updates = steps
        coordinates, affected, y, theta, p, basis, moved, moved_by = twin
        commands, readings, r, q, limits = record
        states, estimates, innovations = filtered
        k, channels, h, last = theta.size, commands.shape[1], dt / substeps, readings.shape[0] - 1
        n, sensors = y.size, r.size
        columns, of_columns = take(columns, n)
        size = n + k
        work[:] = 0.0
        of_stages, work = take(work, 4 * n)
        stages = Derivatives(of_stages, of_columns)
        by_state, work = take(work, sensors)
        by_entry, work = take(work, sensors)
        rows, work = take(work, sensors)
        prior, work = take(work, size)
        vectors, work = take(work, 12)
        noise, s, residual, before, change = vectors[0], vectors[1], vectors[2], vectors[3], vectors[4]
        gain, seen, since, origin = vectors[5], vectors[6], vectors[7], vectors[8]
        u, end = vectors[9][:channels], vectors[10][:channels]
        none = vectors[11][:channels]  # the commands are those that act
        given = TwinArrays(p, moved, moved_by, moved, moved_by, coordinates, none, 0, affected[:0], none[:0])
        carried, work = take(work, 2 * n)
        copy(theta, since, k)
        for i in range(affected.size):
            origin[i] = p[affected[i]]
        for index in range(begin, begin + count):
            t = index * dt
            copy(y, before, n)
            for j in range(k):
                before[n + j] = theta[j]
            for update in range(updates):
                if updates > 1:
                    for i in range(size):
                        if update == 0:
                            copy(matrix[i], prior[i], size)
                        else:
                            copy(prior[i], matrix[i], size)
                sensed(t, y, commands[index], p, noise, s, by_state, by_entry)
                for o in range(sensors):
                    linearise(by_state[o], by_entry[o], basis, n, rows[o])
                    residual[o] = readings[index, o] - s[o]
                    for i in range(n):
                        residual[o] -= rows[o, i] * (before[i] - y[i])
                    for j in range(k):
                        residual[o] -= rows[o, n + j] * (before[n + j] - theta[j])
                    if update == 0:
                        innovations[index, o] = residual[o]
                for i in range(size):
                    change[i] = 0.0
                for o in range(sensors):
                    innovation = residual[o]
                    for i in range(size):
                        innovation -= rows[o, i] * change[i]
                    spread = correct(matrix, rows[o], r[o], gain, seen)
                    if not math.isfinite(innovation) or not math.isfinite(spread):
                        return NOT_FINITE, index
                    if spread <= 0.0:
                        return NOT_POSITIVE, index
                    for i in range(size):
                        change[i] += gain[i] * innovation
                    if update == 0:
                        innovations[index, sensors + o] = innovation / math.sqrt(spread)
                for i in range(n):
                    y[i] = before[i] + change[i]
                for j in range(k):
                    theta[j] = min(max(before[n + j] + change[n + j], limits[LOW, j]), limits[HIGH, j])
                place(theta, since, origin, affected, basis, p)
            has_moved = False
            copy(y, states[index], n)
            for j in range(k):
                variance = variance_of(matrix, n + j)
                if not variance >= 0.0:
                    return NOT_POSITIVE, index
                estimates[index, j] = theta[j]
                estimates[index, k + j] = math.sqrt(variance)
                if abs(theta[j] - since[j]) > limits[CHANGE, j]:
                    has_moved = True
            if index == last:
                return REACHED, index + 1
            for i in range(n):
                for j in range(size):
                    columns[i, j] = 1.0 if j == k + i else 0.0
            for step in range(substeps):
                drive(commands, index, step, steps, given, u, end)
                advance(t + step * h, y, u, end, given, h, stages, work)
                carry(of_stages, of_columns, columns, h)
            carry_covariance(matrix, columns, q, dt, k, carried)
            if has_moved:
                return LINEARISE, index + 1
        return REACHED, begin + count

    return follow


def fixed_gain_filter(derivative: Kernel, sensed: Kernel) -> Kernel:
    """Make the filter of a rig's state and of latent forces, which walk at random, with a constant gain.

    Returns `follow(steps, rig, commands, readings, filtered, predicted, work) -> status` for x = (y, forces), which is
    written before (`predicted`) and after (`filtered`) each correction by `gain` (n + forces, sensors). The part `kept`
    of the forces goes on to the next sample.
    """
    advance = driven_step(motion_alone(derivative))

    @compiled
    @requires(
        "(n := len(rig.x) - len(rig.ports)) >= max(linked.y, linked.rate) and len(rig.p) >= linked.p",
        "(channels := commands.shape[1]) >= linked.u and (sensors := readings.shape[1]) >= linked.s",
        "len(commands) > 0 and steps.samples <= min(len(readings), len(filtered), len(predicted))",
        "len(rig.x) <= min(len(rig.gain), filtered.shape[1], predicted.shape[1]) and sensors <= rig.gain.shape[1]",
        "within(rig.ports, len(rig.p)) and len(work) >= 2 * sensors + 9",
        "work.shape[1] >= max(linked.width, n, channels, sensors)",
    )
    def follow(
        steps: Steps, rig: LatentRig, commands: Matrix, readings: Matrix, filtered: Matrix, predicted: Matrix,
        work: Matrix,
    ) -> int:  # fmt: skip
        count, dt, substeps, is_linear = steps
        ports, x, p, gain, kept = rig
        n, forces, sensors = x.size - ports.size, ports.size, readings.shape[1]
        channels, h = commands.shape[1], dt / substeps
        work[:] = 0.0
        by_state, work = take(work, sensors)
        by_entry, work = take(work, sensors)
        vectors, work = take(work, 3)
        s, noise, u = vectors[0], vectors[1], vectors[2][:channels]
        none = Derivatives(work, work)
        for index in range(count):
            t = index * dt
            copy(x, predicted[index], n + forces)
            for i in range(forces):
                p[ports[i]] = x[n + i]
            for a in range(channels):
                u[a] = command_at(commands, index, a, 0.0, 0.0, is_linear)
            sensed(t, x, u, p, noise, s, by_state, by_entry)
            for o in range(sensors):
                residual = readings[index, o] - s[o]
                if not math.isfinite(residual):
                    return NOT_FINITE
                for i in range(n + forces):
                    x[i] += gain[i, o] * residual
            copy(x, filtered[index], n + forces)
            for i in range(forces):
                p[ports[i]] = x[n + i]
            for step in range(substeps):
                for a in range(channels):
                    u[a] = command_at(commands, index, a, 0.0, (step + 0.5) / substeps, is_linear)
                advance(t + step * h, x[:n], u, u, p, h, none, work)
            for i in range(forces):
                x[n + i] *= kept
        return REACHED

    return follow


@compiled
@requires("count <= min(len(states), len(predicted))", "states.shape[1] <= min(predicted.shape[1], *gain.shape)")
def smooth_backward(count: int, gain: Matrix, states: Matrix, predicted: Matrix) -> None:
    """Make filtered states (count, size) the smoothed ones, by the pass of Rauch, Tung and Striebel."""
    size = states.shape[1]
    for index in range(count - 2, -1, -1):
        for i in range(size):
            total = 0.0
            for j in range(size):
                total += gain[i, j] * (states[index + 1, j] - predicted[index + 1, j])
            states[index, i] += total
