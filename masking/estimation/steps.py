"""Steps: the kernels of the extended Kalman filter as text, which is compiled behind the equations of a twin.

The covariance is carried and corrected as a whole (`full`, in Joseph's form) or by its triangular root (`root`).
Source: Bierman, Factorization Methods for Discrete Sequential Estimation (1977), chapters II, V and VII.
"""

from __future__ import annotations

STEPS = """
@compiled
def _origin(p, origin):
{kept}


@compiled
def _place(x, since, origin, shift, basis, p):
    for l in range(basis.shape[0]):
        total = 0.0
        for j in range(basis.shape[1]):
            total += basis[l, j] * (x[j] - since[j])
        shift[l] = total
{placed}


@compiled
def _carry_full(matrix, sens, q, dt, k, work):
    n, size = sens.shape[0], matrix.shape[0]
    for i in range(n):
        matrix[i, i] += 0.5 * dt * q[i]
    for i in range(n):
        for j in range(size):
            work[i, j] = 0.0
        for l in range(size):
            by = sens[i, k + l] if l < n else sens[i, l - n]
            if by != 0.0:
                for j in range(size):
                    work[i, j] += by * matrix[l, j]
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for l in range(n):
                total += work[i, l] * sens[j, k + l]
            for l in range(k):
                total += work[i, n + l] * sens[j, l]
            matrix[i, j] = total
            matrix[j, i] = total
        for j in range(n, size):
            matrix[i, j] = work[i, j]
            matrix[j, i] = work[i, j]
        matrix[i, i] += 0.5 * dt * q[i]


@compiled
def _carry_root(matrix, sens, q, dt, k, work):
    n, size = sens.shape[0], matrix.shape[0]
    wide, cross = work[:n], work[n : 2 * n]
    for i in range(n):
        for j in range(3 * n):
            wide[i, j] = 0.0
        for l in range(n):
            by = sens[i, k + l]
            for j in range(l, n):
                wide[i, j] += by * matrix[l, j]
            wide[i, n + l] = by * math.sqrt(0.5 * dt * q[l])
        wide[i, 2 * n + i] = math.sqrt(0.5 * dt * q[i])
        for j in range(k):
            cross[i, j] = 0.0
        for l in range(n):
            by = sens[i, k + l]
            for j in range(k):
                cross[i, j] += by * matrix[l, n + j]
        for l in range(k):
            by = sens[i, l]
            for j in range(l, k):
                cross[i, j] += by * matrix[n + l, n + j]
    # Reflections of Householder from the last row up leave an upper triangle in the first n columns.
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
    for i in range(n):
        for j in range(i, n):
            matrix[i, j] = wide[i, j]
        for j in range(k):
            matrix[i, n + j] = cross[i, j]


@compiled
def _take_full(matrix, h, variance, gain, seen):
    size = matrix.shape[0]
    for i in range(size):
        seen[i] = 0.0
    for l in range(size):
        by = h[l]
        if by != 0.0:
            for i in range(size):
                seen[i] += by * matrix[l, i]
    spread = 0.0
    for i in range(size):
        spread += h[i] * seen[i]
    total = spread + variance
    for i in range(size):
        gain[i] = seen[i] / total
    for i in range(size):
        rest = seen[i] - gain[i] * spread
        for j in range(i + 1):
            matrix[i, j] += (variance * gain[i] - rest) * gain[j] - gain[i] * seen[j]
            matrix[j, i] = matrix[i, j]
    return total if spread >= 0.0 else -1.0


@compiled
def _take_root(matrix, h, variance, gain, seen):
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
def _variance_full(matrix, i):
    return matrix[i, i]


@compiled
def _variance_root(matrix, i):
    total = 0.0
    for j in range(i, matrix.shape[0]):
        total += matrix[i, j] * matrix[i, j]
    return total
"""
LOOP = """
@compiled
def filter_{form}(
    begin, count, dt, substeps, straight, y, x, p, basis, matrix, sens, commands, readings, r, q, table, states,
    estimates, noises, work
):
    n, k, sensors, affected, size = {n}, {k}, {sensors}, {affected}, {n} + {k}
    top = 7 * n + 5
    jy, jp, rows = work[top : top + sensors], work[top + sensors : top + 2 * sensors], work[top + 2 * sensors :]
    top += 3 * sensors
    prior, carried = work[top : top + size], work[top + size : top + size + 2 * n]
    top += size + 2 * n
    noise, s, residual, before, change = work[top], work[top + 1], work[top + 2], work[top + 3], work[top + 4]
    gain, seen, since, shift, origin = work[top + 5], work[top + 6], work[top + 7], work[top + 8], work[top + 9]
    u, rise = work[top + 10][: commands.shape[1]], work[top + 11][: commands.shape[1]]
    h, last = dt / substeps, readings.shape[0] - 1
    work[:] = 0.0
    for j in range(k):
        since[j] = x[j]
    _origin(p, origin)
    for index in range(begin, begin + count):
        t = index * dt
        for i in range(n):
            before[i] = y[i]
        for j in range(k):
            before[n + j] = x[j]
        for again in range({updates}):
            if {updates} > 1:
                for i in range(size):
                    for j in range(size):
                        if again == 0:
                            prior[i, j] = matrix[i, j]
                        else:
                            matrix[i, j] = prior[i, j]
            sensed(t, y, commands[index], p, noise, s, jy, jp)
            for o in range(sensors):
                residual[o] = readings[index, o] - s[o]
                for i in range(n):
                    rows[o, i] = jy[o, i]
                    residual[o] -= jy[o, i] * (before[i] - y[i])
                for j in range(k):
                    total = 0.0
                    for l in range(affected):
                        total += jp[o, l] * basis[l, j]
                    rows[o, n + j] = total
                    residual[o] -= total * (before[n + j] - x[j])
                if again == 0:
                    noises[index, o] = residual[o]
            for i in range(size):
                change[i] = 0.0
            for o in range(sensors):
                left = residual[o]
                for i in range(size):
                    left -= rows[o, i] * change[i]
                spread = _take_{form}(matrix, rows[o], r[o], gain, seen)
                if not math.isfinite(left) or not math.isfinite(spread):
                    return 1, index
                if spread <= 0.0:
                    return 2, index
                for i in range(size):
                    change[i] += gain[i] * left
                if again == 0:
                    noises[index, sensors + o] = left / math.sqrt(spread)
            for i in range(n):
                y[i] = before[i] + change[i]
            for j in range(k):
                x[j] = min(max(before[n + j] + change[n + j], table[0, j]), table[1, j])
            _place(x, since, origin, shift, basis, p)
        moved = False
        for i in range(n):
            states[index, i] = y[i]
        for j in range(k):
            variance = _variance_{form}(matrix, n + j)
            if not variance >= 0.0:
                return 2, index
            estimates[index, j] = x[j]
            estimates[index, k + j] = math.sqrt(variance)
            if abs(x[j] - since[j]) > table[2, j]:
                moved = True
        if index == last:
            return 0, index + 1
        for i in range(n):
            for j in range(n + k):
                sens[i, j] = 1.0 if j == k + i else 0.0
        _between(commands, index, substeps, straight, u, rise)
        for step in range(substeps):
            _move(t + step * h, y, sens, u, rise, p, basis, h, work)
        _carry_{form}(matrix, sens, q, dt, k, carried)
        if moved:
            return 3, index + 1
    return 0, begin + count
"""
