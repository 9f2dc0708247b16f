"""Flow: how a rig with effects at its places moves, and how that depends on parameters, as text of kernels.

What effects do at an instant comes first: forces, commands and rates of inner states. Then the equations of the rig
follow. Sensors that read a force or a command at once see what effects do, too.
"""

from __future__ import annotations

from masking.discovery.inertia import INERTIAS

FLOW = (
    INERTIAS
    + """
@compiled
def _act(t, y, sens, u, lead, p, basis, slots, columns, theta, dy, ds, jd, df, dv, heavier, v, acc, on, w):
    # Forces of effects into p, commands into v, inertias into acc, rates of inner states into dy, and derivatives of
    # all of these into df, dv, heavier and ds. Returns whether there is an inertia. Rows of df, dv and heavier are
    # touched where something acts (on): of places, then of channels.
    n, places, channels, sensors, affected = {n}, {places}, {channels}, {sensors}, {affected}
    width, k = sens.shape[1], basis.shape[1]
    js, jps, rows = w[:sensors], w[sensors : 2 * sensors], w[2 * sensors : 2 * sensors + 2]
    d, s, noise = w[2 * sensors + 2], w[2 * sensors + 3], w[2 * sensors + 4]
    for e in range(places):
        p[{force_p}[e]] = 0.0
        acc[e] = 0.0
        on[e] = 0.0
    for a in range(channels):
        v[a] = u[a]
        on[places + a] = 1.0 if lead[1, a] >= 0.0 else 0.0
    elements, inner, inertias = False, False, False
    for i in range(slots.shape[0]):
        at = int(slots[i, 2])
        if slots[i, 0] >= 0.0 and slots[i, 1] != 2.0:
            on[places + at if slots[i, 1] == 1.0 else at] = 1.0
        if slots[i, 1] == 0.0:
            elements = True
        if slots[i, 1] == 3.0:
            inertias = True
        if slots[i, 1] == 2.0 and slots[i, 4] >= 0.0:
            inner = True
    for e in range(places):
        if on[e] != 0.0:
            for j in range(width):
                df[e, j] = 0.0
                heavier[e, j] = 0.0
    for a in range(channels):
        if on[places + a] != 0.0:
            for j in range(width):
                dv[a, j] = 0.0
            if lead[1, a] >= 0.0:
                dv[a, int(lead[1, a])] = lead[0, a]
    if elements or inertias:
        placed(t, y, v, p, d, jd)
    for turn in range(2 * slots.shape[0]):  # sensors last: they may read what the others do
        i = turn % slots.shape[0]
        kind, where, at = int(slots[i, 0]), int(slots[i, 1]), int(slots[i, 2])
        first, z = int(slots[i, 3]), int(slots[i, 4])
        if kind < 0 or (where == 2 and z < 0) or (where == 2) != (turn >= slots.shape[0]):
            continue
        if where == 2 and inner:
            sensed(t, y, v, p, noise, s, js, jps)
            inner = False
        x, moved = 1.0, 0.0  # a unit of acceleration
        if where == 0:
            x, moved = d[at], d[places + at]
        elif where == 1:
            x = v[at]
        elif where == 2:
            x = s[at]
        _law(kind, t, x, moved, y[z] if z >= 0 else 0.0, theta[first:], rows)
        if where == 0:
            p[{force_p}[at]] += rows[0, 0]
        elif where == 1:
            v[at] = rows[0, 0]
        elif where == 3:
            acc[at] += rows[0, 0]
        if z >= 0:
            dy[z] = rows[1, 0]
        for j in range(width if where < 3 else 0):
            by = 0.0
            rate = 0.0
            if where == 0:
                for l in range(n):
                    by += jd[at, l] * sens[l, j]
                    rate += jd[places + at, l] * sens[l, j]
            elif where == 1:
                by = dv[at, j]
            else:
                for l in range(n):
                    by += js[at, l] * sens[l, j]
                if j < k:
                    for l in range(affected):
                        by += jps[at, l] * basis[l, j]
                by += _fed(jps[at], df, dv, j)
            inside = sens[z, j] if z >= 0 else 0.0
            total = rows[0, 1] * by + rows[0, 2] * rate + rows[0, 3] * inside
            if where == 0:
                df[at, j] += total
            elif where == 1:
                dv[at, j] = total
            if z >= 0:
                ds[z, j] = rows[1, 1] * by + rows[1, 2] * rate + rows[1, 3] * inside
        for l in range(columns.shape[1]):
            j = int(columns[i, l])
            if j >= 0:
                if where == 0:
                    df[at, j] += rows[0, 4 + l]
                elif where == 1:
                    dv[at, j] += rows[0, 4 + l]
                elif where == 3:
                    heavier[at, j] += rows[0, 4 + l]
                if z >= 0:
                    ds[z, j] += rows[1, 4 + l]
    return inertias


@compiled
def _fed(jps, df, dv, j):
    # What forces and commands do to a reading at once, by column j.
    total = 0.0
    if {fed}:
        for e in range({places}):
            total += jps[{force_column}[e]] * df[e, j]
        for a in range({channels}):
            total += jps[{command_column}[a]] * dv[a, j]
    return total


@compiled
def _chained(by_state, by_entry, sens, basis, spans, row):
    # Add what states and entries of the parameter array do, by column; an entry depends on the columns of its span.
    for l in range({n}):
        by = by_state[l]
        if by != 0.0:
            for j in range(sens.shape[1]):
                row[j] += by * sens[l, j]
    for l in range({affected}):
        by = by_entry[l]
        if by != 0.0:
            for j in range(int(spans[0, l]), int(spans[1, l])):
                row[j] += by * basis[l, j]


@compiled
def _flow(t, y, sens, u, lead, p, basis, spans, slots, columns, theta, dy, ds, w):
    n, moving, places, channels = {n}, {moving}, {places}, {channels}
    width = sens.shape[1]
    jy, jp, top = w[0:n], w[n : 2 * n], 2 * n
    jd, top = w[top : top + 2 * places], top + 2 * places
    df, dv, top = w[top : top + places], w[top + places : top + places + channels], top + places + channels
    share, acc, v, on, top = w[top], w[top + 1], w[top + 2], w[top + 3], top + 4
    pushed, heavier, top = w[top : top + places], w[top + places : top + 2 * places], top + 2 * places
    inertias = _act(
        t, y, sens, u, lead, p, basis, slots, columns, theta, dy, ds, jd, df, dv, heavier, v, acc, on, w[top:]
    )
    for again in range(2 if inertias else 1):
        if again:
            _inertias(width, jp, jd, share, pushed, acc, heavier, p, dy, df)
        slopes(t, y, v, p, dy, jy, jp)
    for i in range(moving):
        for j in range(width):
            ds[i, j] = sens[moving + i, j]
    for i in range(moving, n):
        for j in range(width):
            ds[i, j] = 0.0
        _chained(jy[i], jp[i], sens, basis, spans, ds[i])
        for e in range(places):
            by = jp[i, {force_column}[e]]
            if by != 0.0 and on[e] != 0.0:
                for j in range(width):
                    ds[i, j] += by * df[e, j]
        for a in range(channels):
            by = jp[i, {command_column}[a]]
            if by != 0.0 and on[places + a] != 0.0:
                for j in range(width):
                    ds[i, j] += by * dv[a, j]
    if inertias:
        for e in range(places):
            for j in range(width):
                _drawn(share[e], jd[e], pushed[e], ds[:, j])


@compiled
def _go(t, y, sens, u, end, lead, p, basis, spans, slots, columns, theta, h, work):
    # One step of Runge and Kutta, with commands that go straight from u to end.
    size, width = y.shape[0], sens.shape[1]
    ks, ss, top = work[: 4 * size], work[4 * size : 5 * size], 5 * size
    ky, state, now, w = work[top : top + 4], work[top + 4], work[top + 5], work[top + 6 :]
    for stage in range(4):
        c = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        for a in range({channels}):
            now[a] = u[a] + c * (end[a] - u[a])
        for i in range(size):
            state[i] = y[i] + (c * h * ky[stage - 1, i] if stage > 0 else 0.0)
            for j in range(width):
                ss[i, j] = sens[i, j] + (c * h * ks[(stage - 1) * size + i, j] if stage > 0 else 0.0)
        _flow(
            t + c * h, state[:size], ss[:size, :width], now, lead, p, basis, spans, slots, columns, theta, ky[stage],
            ks[stage * size : (stage + 1) * size], w,
        )
    for i in range(size):
        y[i] += h / 6.0 * (ky[0, i] + 2.0 * (ky[1, i] + ky[2, i]) + ky[3, i])
        for j in range(width):
            sens[i, j] += h / 6.0 * (ks[i, j] + 2.0 * (ks[size + i, j] + ks[2 * size + i, j]) + ks[3 * size + i, j])


@compiled
def _command(commands, index, a, samples, part, straight):
    # The command of a sample, `samples` late; part: of the sample that has gone by.
    last = commands.shape[0] - 1
    at = index + (part if straight else 0.0) - samples
    # Held, it is the mean over the sample.
    low = int(math.floor(at))
    share = at - low
    return (1.0 - share) * commands[min(max(low, 0), last), a] + share * commands[min(max(low + 1, 0), last), a]
"""
)
