"""Steps: the kernels of discovery as text, compiled behind the equations of a rig whose places are open for effects.

A slot is an effect at a place: a row of `slots` (number of the effect, kind of place, place, first of its parameters in
`theta`, index of its state or -1) and a row of `columns` (where each of its parameters is estimated, or -1).
"""

from __future__ import annotations

from masking.discovery.flow import FLOW

ELEMENT, ACTUATOR, SENSOR, INERTIA = range(4)

RUN = """
@compiled
def run(
    count, dt, substeps, begin, straight, states, y, sens, p, basis, slots, columns, theta, commands, readings, weights,
    matrix, gradient, squares, estimates, work
):
    # Every `begin` samples the motion begins anew, at a row of states; each such window has width rows of the matrix.
    n, places, channels, sensors, affected = {n}, {places}, {channels}, {sensors}, {affected}
    size, width, k = y.shape[0], sens.shape[1], basis.shape[1]
    work[:] = 0.0
    u, s, row = work[0], work[1], work[2 : 2 + sensors]
    js, jps = work[2 + sensors : 2 + 2 * sensors], work[2 + 2 * sensors : 2 + 3 * sensors]
    top = 2 + 3 * sensors
    rows, late, noise = work[top : top + 2], work[top + 2], work[top + 3]
    lead, end, v, acc, top = work[top + 4 : top + 6], work[top + 6], work[top + 7], work[top + 8], top + 9
    df, dv, top = work[top : top + places], work[top + places : top + places + channels], top + places + channels
    jd, heavier, top = work[top : top + 2 * places], work[top + 2 * places : top + 3 * places], top + 3 * places
    dy, on, spans, top = work[top], work[top + 1], work[top + 2 : top + 4], top + 4
    ds, rest = work[top : top + size], work[top + size :]
    h = dt / substeps
    for l in range(affected):  # the columns that depend on an entry: from, until
        spans[0, l] = k
        for j in range(k):
            if basis[l, j] != 0.0:
                spans[0, l] = min(spans[0, l], j)
                spans[1, l] = j + 1
    for a in range(channels):
        late[a] = 0.0
        lead[1, a] = -1.0
    for i in range(slots.shape[0]):
        if slots[i, 0] < 0.0:
            for a in range(channels):
                if slots[i, 2] < 0.0 or int(slots[i, 2]) == a:
                    late[a] += theta[int(slots[i, 3])] / dt
                    lead[1, a] = columns[i, 0]
    for index in range(count):
        t = index * dt
        window = index // begin
        if index == window * begin:
            for i in range(size):
                for j in range(k, width):
                    sens[i, j] = 0.0
            for i in range(n):
                if window == 0 or {is_free}[i]:  # states inside of effects go on
                    y[i] = states[window, i]
                    for j in range(k):
                        sens[i, j] = 0.0
            for i in range({begins}):
                sens[{free}[i], k + i] = 1.0
        for a in range(channels):
            u[a] = _command(commands, index, a, late[a], 0.0, straight)
            v[a] = u[a]
        if {fed}:
            for a in range(channels):
                before = _command(commands, index, a, late[a] + 0.5, 0.0, straight)
                after = _command(commands, index, a, late[a] - 0.5, 0.0, straight)
                lead[0, a] = (before - after) / dt
            _act(
                t, y, sens, u, lead, p, basis, slots, columns, theta, dy, ds[:, :width], jd, df, dv, heavier, v, acc,
                on, rest,
            )
        sensed(t, y, v, p, noise, s, js, jps)
        for o in range(sensors):
            for j in range(width):
                row[o, j] = _fed(jps[o], df, dv, j)
            _chained(js[o], jps[o], sens, basis, spans, row[o])
        for i in range(slots.shape[0]):
            if slots[i, 1] == 2.0:
                at, z, first = int(slots[i, 2]), int(slots[i, 4]), int(slots[i, 3])
                _law(int(slots[i, 0]), t, s[at], 0.0, y[z] if z >= 0 else 0.0, theta[first:], rows)
                s[at] = rows[0, 0]
                for j in range(width):
                    row[at, j] = rows[0, 1] * row[at, j] + (rows[0, 3] * sens[z, j] if z >= 0 else 0.0)
                for l in range(columns.shape[1]):
                    j = int(columns[i, l])
                    if j >= 0:
                        row[at, j] += rows[0, 4 + l]
        for o in range(sensors):
            estimates[index, o] = s[o]
            residual = readings[index, o] - s[o]
            if not math.isfinite(residual):
                return 1
            squares[o] += residual * residual
            for i in range(width):
                weighted = weights[o] * row[o, i]
                if weighted != 0.0:
                    at = window * width + i
                    gradient[at] += weighted * residual
                    for j in range(i + 1):
                        matrix[at, j] += weighted * row[o, j]
        if index == count - 1:
            break
        for step in range(substeps):
            part = (step + 0.5) / substeps
            for a in range(channels):
                u[a] = _command(commands, index, a, late[a], step / substeps, straight)
                end[a] = _command(commands, index, a, late[a], (step + 1.0) / substeps, straight)
                before = _command(commands, index, a, late[a] + 0.5, part, straight)
                after = _command(commands, index, a, late[a] - 0.5, part, straight)
                lead[0, a] = (before - after) / dt
            _go(t + step * h, y, sens, u, end, lead, p, basis, spans, slots, columns, theta, h, rest)
    return 0
"""

FOLLOW = """
@compiled
def follow(count, dt, substeps, straight, x, p, gain, commands, readings, states, estimates, work):
    # A filter with a constant gain (n + forces, sensors); states: filtered, estimates: predicted.
    n, forces, sensors, channels = {n}, {forces}, {sensors}, {channels}
    work[:] = 0.0
    s, noise, u = work[0], work[1], work[2]
    js, jps = work[3 : 3 + sensors], work[3 + sensors : 3 + 2 * sensors]
    jy, jp = work[3 + 2 * sensors : 3 + 2 * sensors + n], work[3 + 2 * sensors + n : 3 + 2 * sensors + 2 * n]
    top = 3 + 2 * sensors + 2 * n
    ky, state = work[top : top + 4], work[top + 4]
    h = dt / substeps
    for index in range(count):
        t = index * dt
        for i in range(n + forces):
            estimates[index, i] = x[i]
        for i in range(forces):
            p[{degree_ports}[i]] = x[n + i]
        for a in range(channels):
            u[a] = _command(commands, index, a, 0.0, 0.0, straight)
        sensed(t, x, u, p, noise, s, js, jps)
        for o in range(sensors):
            residual = readings[index, o] - s[o]
            if not math.isfinite(residual):
                return 1
            for i in range(n + forces):
                x[i] += gain[i, o] * residual
        for i in range(n + forces):
            states[index, i] = x[i]
        for i in range(forces):
            p[{degree_ports}[i]] = x[n + i]
        for step in range(substeps):
            for a in range(channels):
                u[a] = _command(commands, index, a, 0.0, (step + 0.5) / substeps, straight)
            for stage in range(4):
                c = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
                for i in range(n):
                    state[i] = x[i] + (c * h * ky[stage - 1, i] if stage > 0 else 0.0)
                slopes(t + step * h + c * h, state, u, p, ky[stage], jy, jp)
            for i in range(n):
                x[i] += h / 6.0 * (ky[0, i] + 2.0 * (ky[1, i] + ky[2, i]) + ky[3, i])
    return 0
"""

BACK = """
@compiled
def back(count, gain, states, estimates):
    # Backward pass: states become the smoothed ones.
    size = states.shape[1]
    for index in range(count - 2, -1, -1):
        for i in range(size):
            total = 0.0
            for j in range(size):
                total += gain[i, j] * (states[index + 1, j] - estimates[index + 1, j])
            states[index, i] += total
"""

PLACES = """
@compiled
def motions(count, dt, p, states, commands, estimates, work):
    # Displacement, rate and acceleration of each place along states with forces on the degrees
    # (count, n + forces): estimates (count, 3 places).
    n, forces, moving, places = {n}, {forces}, {moving}, {places}
    work[:] = 0.0
    d, dy, jd = work[0], work[1], work[2 : 2 + 2 * places]
    jy, jp = work[2 + 2 * places : 2 + 2 * places + n], work[2 + 2 * places + n : 2 + 2 * places + 2 * n]
    for index in range(count):
        for i in range(forces):
            p[{degree_ports}[i]] = states[index, n + i]
        placed(index * dt, states[index], commands[index], p, d, jd)
        slopes(index * dt, states[index], commands[index], p, dy, jy, jp)
        for e in range(places):
            estimates[index, e] = d[e]
            estimates[index, places + e] = d[places + e]
            total = 0.0
            for i in range(moving):
                total += jd[e, i] * dy[moving + i]
            estimates[index, 2 * places + e] = total
"""

ALONG = """
@compiled
def along(count, dt, kind, state, x, rate, columns, theta, features, work):
    # An effect along a known motion: features[:, 0] its value, then its derivatives by the parameters in `columns`.
    rows, later = work[:2], work[2:4]
    many = features.shape[1]
    z = 1e-200
    dz = work[4]
    dz[:] = 0.0
    for index in range(count):
        t = index * dt
        _law(kind, t, x[index], rate[index], z, theta, rows)
        features[index, 0] = rows[0, 0]
        for j in range(1, many):
            features[index, j] = rows[0, 3] * dz[j] + rows[0, 4 + int(columns[0, j - 1])]
        if state > 0 and index < count - 1:
            # The middle of the sample, by Heun's half step, then a whole one: second order, and stable where it decays.
            middle_x, middle_rate = 0.5 * (x[index] + x[index + 1]), 0.5 * (rate[index] + rate[index + 1])
            pieces = 4
            h = dt / pieces
            for piece in range(pieces):
                share = (piece + 0.5) / pieces
                px = x[index] + share * (x[index + 1] - x[index])
                pr = rate[index] + share * (rate[index + 1] - rate[index])
                _law(kind, t + share * dt, px, pr, z, theta, later)
                half = z + 0.5 * h * later[1, 0]
                _law(kind, t + share * dt, px, pr, half, theta, later)
                for j in range(1, many):
                    dz[j] += h * (later[1, 3] * dz[j] + later[1, 4 + int(columns[0, j - 1])])
                z += h * later[1, 0]
"""

SPREAD = """
@compiled
def spread(count, dt, every, begin, x, states, commands, p, features, estimates, work):
    # What forces (count, M) at the columns x (M,) of the equations, or initial states -1 - x, do to the sensors, from
    # rest, anew after every `begin` samples, to first order along a motion (count, n): means over `every` samples,
    # (count / every, sensors M).
    n, sensors = {n}, {sensors}
    many = features.shape[1]
    js, jps = work[:sensors], work[sensors : 2 * sensors]
    jy, jp = work[2 * sensors : 2 * sensors + n], work[2 * sensors + n : 2 * sensors + 2 * n]
    top = 2 * sensors + 2 * n
    phi, a2 = work[top : top + n], work[top + n : top + 2 * n]
    e, f, top = work[top + 2 * n : top + 3 * n], work[top + 3 * n : top + 4 * n], top + 4 * n
    dy, s, noise = work[top], work[top + 1], work[top + 2]
    work[:] = 0.0
    estimates[:] = 0.0
    for index in range(count):
        t = index * dt
        first = index % begin == 0
        if first:
            for m in range(many):
                for i in range(n):
                    e[i, m] = 0.0
                if x[m] < 0.0:  # the initial state, instead of a force
                    e[int(-x[m]) - 1, m] = 1.0
        slopes(t, states[index], commands[index], p, dy, jy, jp)
        sensed(t, states[index], commands[index], p, noise, s, js, jps)
        # The half of the force that comes with this sample.
        if not first:
            for i in range(n):
                for m in range(many):
                    e[i, m] += 0.5 * dt * jp[i, max(int(x[m]), 0)] * features[index, m]
        block = index // every
        if block < estimates.shape[0]:
            for o in range(sensors):
                for l in range(n):
                    by = js[o, l] / every
                    if by != 0.0:
                        for m in range(many):
                            estimates[block, o * many + m] += by * e[l, m]
                if {direct}:
                    for m in range(many):
                        if x[m] >= 0.0:
                            estimates[block, o * many + m] += jps[o, int(x[m])] * features[index, m] / every
        for i in range(n):
            for m in range(many):
                e[i, m] += 0.5 * dt * jp[i, max(int(x[m]), 0)] * features[index, m]
        # exp(A dt) - 1: of a quarter of the time to the third order, doubled twice
        h = 0.25 * dt
        for i in range(n):
            for j in range(n):
                total = 0.0
                for l in range(n):
                    total += jy[i, l] * jy[l, j]
                a2[i, j] = total
        for i in range(n):
            for j in range(n):
                total = 0.0
                for l in range(n):
                    total += jy[i, l] * a2[l, j]
                phi[i, j] = h * jy[i, j] + 0.5 * h * h * a2[i, j] + h * h * h / 6.0 * total
        for doubling in range(2):
            for i in range(n):
                for j in range(n):
                    total = 2.0 * phi[i, j]
                    for l in range(n):
                        total += phi[i, l] * phi[l, j]
                    a2[i, j] = total
            for i in range(n):
                for j in range(n):
                    phi[i, j] = a2[i, j]
        for i in range(n):
            for m in range(many):
                f[i, m] = e[i, m]
            for l in range(n):
                by = phi[i, l]
                if by != 0.0:
                    for m in range(many):
                        f[i, m] += by * e[l, m]
        for i in range(n):
            for m in range(many):
                e[i, m] = f[i, m]
"""

READ = """
@compiled
def read(count, dt, p, states, commands, readings, work):
    # What the sensors read along states with forces on the degrees (count, n + forces).
    noise, s, js, jps = work[0], work[1], work[2 : 2 + {sensors}], work[2 + {sensors} : 2 + 2 * {sensors}]
    work[:] = 0.0
    for index in range(count):
        for i in range({forces}):
            p[{degree_ports}[i]] = states[index, {n} + i]
        sensed(index * dt, states[index], commands[index], p, noise, s, js, jps)
        for o in range({sensors}):
            readings[index, o] = s[o]
"""
__all__ = ["ACTUATOR", "ELEMENT", "FLOW", "INERTIA", "OTHERS", "RUN", "SENSOR"]
OTHERS = (FOLLOW, BACK, PLACES, ALONG, SPREAD, READ)
