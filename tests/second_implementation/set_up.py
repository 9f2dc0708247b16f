"""The set-up: chapters 4 and 5, sections 3.1 and 10.2, and their errata, with numpy and scipy alone."""

import math

import numpy as np
from scipy.integrate import cumulative_simpson, solve_ivp
from scipy.optimize import brentq, minimize

from tests.second_implementation.motions import (
    LAM,
    MU,
    RELEASED,
    RHO,
    SCALED,
    STROKE,
    VOLTS,
    WBAR,
    C,
    W,
    Z,
    alike,
    amplitudes,
    anti_phase,
    differing,
    folded,
    largest,
    moved,
    moved_linearly,
    on_a_beam,
    phase,
    upsilon,
)

# Chapter 4.

PHASES = np.pi * np.array(
    [
        *(1.5706, 0.1425, 1.2977, 1.7042, 1.4277, 1.8201, 1.0641, 0.0000, 0.7113, 0.6608, 0.6606, 1.4765, 1.7126),
        *(1.8925, 1.5232, 0.8378, 1.9196, 1.9680, 0.0724, 1.2242, 0.1689, 0.0000, 1.3600, 0.1597, 0.6171),
    ]
)
LINES = np.linspace(0.01, 25.0, 25)
BEAT = 1.0 / (LINES[1] - LINES[0])


def table_b_2(t):
    return sum(np.cos(2 * np.pi * f * t + p) for f, p in zip(LINES, PHASES, strict=True))


def crest(duration, samples):
    v = table_b_2(np.linspace(0.0, duration, samples, endpoint=False))
    return np.abs(v).max() / np.sqrt(np.mean(v**2))


def least_crest():
    """Return the crest factor of 25 harmonics whose phases minimise norms of growing order (4.9)-(4.11)."""
    angles = 2 * np.pi * np.outer(np.arange(1, 26), np.arange(400) / 400)

    def norm(phases, p):
        v = np.cos(angles + phases[:, None]).sum(axis=0)
        most = np.abs(v).max()
        mean = np.mean((v / most) ** (2 * p))
        slopes = -np.sin(angles + phases[:, None]) * (v / most) ** (2 * p - 1)
        return most * mean ** (1 / (2 * p)), slopes.mean(axis=1) * mean ** (1 / (2 * p) - 1)

    found = np.random.default_rng(2).uniform(0, 2 * np.pi, 25)
    for p in (2, 4, 8, 16, 32, 64, 128, 256):
        found = minimize(norm, found, args=(p,), jac=True, method="L-BFGS-B", options={"maxiter": 300}).x
    fine = np.outer(np.arange(1, 26), np.linspace(0, 2 * np.pi, 20_000))
    return np.abs(np.cos(fine + found[:, None]).sum(axis=0)).max() / math.sqrt(12.5)


def time_factor(duration, samples):
    return np.abs(table_b_2(np.linspace(0.0, duration, samples))).max() ** 2


def fig_4_2():
    return {
        "crest factor of Table B.2 over a beat of 0.96 s": crest(BEAT, 1000),
        "crest factor of Table B.2 over 200 s": crest(200.0, 1_000_000),
        "crest factor of our 25 harmonics of 0.96 s": least_crest(),
        "time factor of Table B.2 over a beat, s": time_factor(BEAT, 200_000),
        "time factor of Table B.2 over 200 s, s": time_factor(200.0, 1_000_000),
    }


def fig_4_3():
    return {"w3 with the oscillators fixed to the beam, rad/s": W[2] / math.sqrt(1.0 + sum(MU))}


def fig_4_6():
    return {f"w{i + 1}^2/lam{i + 1}, linear": (W[i] / WBAR) ** 2 / LAM[i] for i in range(3)}


def erratum_gains():
    return {
        **{f"lam{i + 1} = nu c{i + 1}/(l wbar^2)": LAM[i] for i in range(3)},
        **{f"nu wbar^2 c{i + 1}/l, as printed": VOLTS * WBAR**2 * C[i] / STROKE for i in range(3)},
        **{f"w{i + 1}^2/lam{i + 1}, against rho_{i + 1}1": (W[i] / WBAR) ** 2 / LAM[i] for i in range(3)},
    }


def erratum_crest():
    return {
        "crest factor over one beat of 0.96 s, 1000 samples": crest(BEAT, 1000),
        "crest factor over one beat, with the peaks between samples": crest(BEAT, 200_000),
        "crest factor over the record of 200 s": crest(200.0, 1_000_000),
    }


def erratum_oscillator():
    right, printed = ([[0, 1], [-(0.9443**2), s * 2 * 0.3362 * 0.9443]] for s in (-1, 1))
    return {
        "largest real part of an eigenvalue, as it should be": np.linalg.eigvals(right).real.max(),
        "largest real part of an eigenvalue, as printed": np.linalg.eigvals(printed).real.max(),
    }


def erratum_reaction():
    return {"centre of mass under an internal u2 = 1, with u3 - u1 + u2": 2.0 / (0.0411 + 0.0578 + 1.0)}


def erratum_momentum():
    found = {}
    for i in (0, 1):
        found[f"sum of m x'' per m3 under u{i + 1} = 1 V, as printed, m/s^2"] = MU[i] * C[i] - C[2]
        found[f"mu{i + 1} with which (4.3) would hold, c3/c{i + 1}"] = C[2] / C[i]
    return found


def erratum_excitation():
    return {
        "the axis of Fig. C.6, 12 mm, strokes": 0.012 / STROKE,
        **{
            f"oscillator {i + 1} under a static {volts:g} V, strokes": C[i] * volts / W[i] ** 2 / STROKE
            for i in (0, 1)
            for volts in (0.42, 0.105)
        },
    }


TABLE_B_4 = (
    (
        0.000234722612437,
        0.091796394850297,
        -0.005071505003798,
        0.001755823061963,
        -0.000495321921394,
        0.000455358409592,
    ),
    (0.005243242423923, 0.084268742935300, -0.052699540025315, 0.015739329106770, 0.063153998888216, 0.0202717963219),
)


def erratum_red_spring():
    return {
        f"static input at full stroke over the linear one, {name}": sum(TABLE_B_4[i]) * LAM[i] / (W[i] / WBAR) ** 2
        for i, name in enumerate(("blue", "red"))
    }


def erratum_air():
    # Plane Poiseuille flow: mean velocity v, slit t, gradient at the wall 6 v/t.
    mean, slit, wall = 0.03 * 0.15 / (2 * 0.5e-3), 0.5e-3, 2 * math.pi * 0.03 * 4.83e-2
    drag = 1.813e-5 * wall * 6 * mean / slit
    return {
        "volume transported, factor 3/2": 1.0,
        "volume transported, factor 12/11": 8 / 11,
        "drag, as printed, N": 13.30e-6 * wall * 12 / 11 * mean / slit,
        "drag, ours, N": drag,
        "deceleration of an oscillator by that, m/s^2": drag / 0.6,
        "deceleration that is observed, 2 z1 w1 v, m/s^2": 2 * Z[0] * W[0] * 0.15,
    }


PHASES_50 = np.pi * np.array(
    [
        *(0.5160, 1.0146, 1.2792, 0.1630, 0.2704, 0.6175, 1.8581, 0.4419, 1.4532, 0.3311, 2.9592, 0.8852, 1.2443),
        *(1.6920, 1.3122, 1.5676, 0.7970, 0.4583, 0.0768, 0.1754, 2.0268, 0.1898, 1.3690, 0.5438, 1.6525, 0.7727),
        *(0.3312, 0.1863, 1.2465, 0.9476, 0.3167, 1.2186, 1.5124, 1.1894, 0.7794, 0.3178, 0.8564, 0.7474, 1.0013),
        *(1.0380, 0.0072, 0.6064, 0.8849, 1.7063, 0.9052, 0.5380, 0.8555, 1.7034, 1.8075, 0.4661),
    ]
)


def fig_b_1():
    """Phases of Schroeder, then those that minimise norms of growing order over a beat."""
    k = np.arange(25)
    angles = 2 * np.pi * np.outer(LINES, np.linspace(0.0, BEAT, 1601))

    def norm(phases, p):
        turned = angles + phases[:, None]
        v = np.cos(turned).sum(axis=0)
        most = np.abs(v).max()
        mean = np.mean((v / most) ** (2 * p))
        slopes = (-np.sin(turned) * (v / most) ** (2 * p - 1)).mean(axis=1) / mean / most
        return np.log(most) + np.log(mean) / (2 * p), slopes

    found, fine, crests = -np.pi * k * (k + 1) / 25, np.linspace(0.0, BEAT, 20_001), {}
    for p in (2, 4, 8, 10):
        found = minimize(norm, found, args=(p,), jac=True, method="BFGS", options={"gtol": 1e-9}).x
        v = np.cos(2 * np.pi * np.outer(LINES, fine) + found[:, None]).sum(axis=0)
        crests[p] = np.abs(v).max() / np.sqrt(np.mean(v**2))
    return {"crest factor, phases of 2p = 4": crests[2], "crest factor, phases of 2p = 20": crests[10]}


def table_c_1():
    oscillator = (208.85 + 56.03 + 2 * 140.50 + 1.5 * 42.53) / 1000
    beam = (2344.75 + (341.84 + 323.48) / 2 + 2 * 363.42 + 2 * 326.99) / 1000
    return {
        "mass that moves with an oscillator, kg": oscillator,
        "mass that moves with the beam, kg": beam,
        **{f"mu{i} of these masses": oscillator / beam for i in (1, 2)},
        **{f"mass of the beam for mu{i + 1} of Table 4.4, kg": oscillator / MU[i] for i in (0, 1)},
    }


def fig_c_3():
    pairs = ((0, "blue", 1.078), (1, "red", 1.109))
    return {f"gain at which the beam rests, {name}": g * C[2] / (MU[i] * C[i]) for i, name, g in pairs}


def table_b_3():
    lines = np.linspace(0.01, 25.0, 50)
    t = np.linspace(0.0, 1 / (lines[1] - lines[0]), 200_000, endpoint=False)
    v = sum(np.cos(2 * np.pi * f * t + p) for f, p in zip(lines, PHASES_50, strict=True))
    return {
        "crest factor of Table B.3 over a beat of 1.96 s": np.abs(v).max() / np.sqrt(np.mean(v**2)),
        "largest phase that is printed, of pi": 2.9592,
        "phases printed beyond 2 pi": 2.0,
    }


def table_c_2():
    hertz = [w / (2 * math.pi) for w in W]
    return {
        "w3/(2 pi), Hz": hertz[2],
        "w1/(2 pi), Hz": hertz[0],
        "mass of the rig's beam per that of Table C.2's, of one spring": (1.92 / hertz[2]) ** 2,
        "mass of oscillator 1 per that of Table C.2's, of one spring": (3.64 / hertz[0]) ** 2,
    }


# Chapter 5.


def table_4_2():
    return {
        **{f"w{i + 1}": SCALED[i] for i in range(3)},
        **{f"lam{i + 1}": LAM[i] for i in range(3)},
    }


def fig_5_1():
    t, y = moved_linearly(alike(0.04945), RELEASED, 1600.0)
    angle, whole = phase(y[0], y[1]), t <= 1500.0
    t, (a, b, beam) = t[whole], y[:3, whole]
    alpha, eps = anti_phase(t, a, b)
    tail = np.flatnonzero(t >= 1200.0)[:-63]  # T/2 = 62.83 samples
    one, other = a[tail], b[tail + 63]
    early = t <= 600.0
    early_alpha, early_eps = anti_phase(t[early], a[early], b[early], 0.1)
    return {
        "alpha, last fifth of tau = 1500": alpha,
        "eps, T/2 rounded to whole samples": np.abs(one - (one @ other) / (other @ other) * other).max(),
        "eps, T/2 as it is": eps,
        "phase / pi at 95 % of the record": folded(angle[round(0.95 * 30001)]),
        "largest beam in the last tenth": largest(t, beam, 150.0),
        "alpha, last tenth of tau = 600": early_alpha,
        "eps, last tenth of tau = 600": early_eps,
    }


def slowest(matrix):
    """Return the least damped oscillation: its eigenvalue and a/b."""
    values, vectors = np.linalg.eig(matrix)
    i = max((i for i in range(6) if values[i].imag > 0), key=lambda i: values[i].real)
    return values[i], vectors[0, i] / vectors[1, i]


def undamped(e=0.0):
    return on_a_beam(SCALED, (0, 0, Z[2]), MU, e=(e, e))


def fig_5_2():
    t, y = moved_linearly(undamped(), RELEASED, 1200.0)
    value, ratio = slowest(undamped())
    return {
        **{f"largest x{i + 1}, last 100 of tau = 1200": largest(t, y[i], 100.0) for i in range(3)},
        "slowest mode, real part": value.real,
        "slowest mode, |x1/x2|": abs(ratio),
        "slowest mode, phase / pi": abs(np.angle(ratio)) / np.pi,
    }


def fig_5_3():
    e = brentq(lambda x: slowest(undamped(x))[0].real, 0.0, 0.05, xtol=1e-14)
    ratio = slowest(undamped(e))[1]
    t, y = moved_linearly(undamped(e), RELEASED, 1100.0)
    angle, whole = phase(y[0], y[1]) / np.pi, t <= 1000.0
    angle, t, (a, b) = angle[whole], t[whole], y[:2, whole]
    last = angle[t >= 800.0]
    frequencies = sorted((v for v in np.linalg.eigvals(undamped(e)) if v.imag > 0), key=lambda v: -v.real)
    tenths = {end: anti_phase(t[t <= end], a[t <= end], b[t <= end], 0.1) for end in np.arange(700.0, 1001.0, 5.0)}
    end = min(end for end, (_, eps) in tenths.items() if eps <= 0.1544)
    return {
        "tau up to which eps over the last tenth is more than 0.1544": end,
        "alpha over the last tenth, up to that tau": tenths[end][0],
        "phase / pi, mean of the last fifth of tau = 1000": last.mean(),
        "phase / pi, least in the last fifth": last.min(),
        "phase / pi, largest in the last fifth": last.max(),
        "tau at which the phase is 0.91 pi for the last time": t[np.flatnonzero(angle < 0.91)[-1] + 1],
        "period of the beat": 2 * np.pi / (frequencies[1] - frequencies[0]).imag,
        "decay of the beat": -frequencies[1].real,
        "slowest mode, |x1/x2|": abs(ratio),
        "slowest mode, phase / pi": abs(np.angle(ratio)) / np.pi,
    }


def fig_5_4():
    w = [math.sqrt(LAM[i] * RHO[0]) for i in (0, 1)]  # Fig. 4.6: spring 2 is nearly that of spring 1

    def made(f1, f2, e1, e2):
        own = (f1 * w[0], f2 * w[1])
        scale = 0.5 * (own[0] + own[1])  # half the sum of the frequencies is the unit of frequency
        return on_a_beam((own[0] / scale, own[1] / scale, W[2] / WBAR / scale), (0, 0, Z[2]), MU, e=(e1, e2))

    return {
        **differing(made, amplitudes(1.2927, 1.065), 1.065),
        "w1 of the spring of Fig. 4.6, (lam1 rho_11)^(1/2)": w[0],
        "w2 of the spring of Fig. 4.6, (lam2 rho_11)^(1/2)": w[1],
    }


# What the document leaves open.


def section_3_1():
    found = {}
    for name, mass in (("beam as it is", 1.0), ("beam ten times as heavy", 10.0)):
        mu, w3, z3 = 0.04945 / mass, SCALED[2] / math.sqrt(mass), Z[2] / math.sqrt(mass)
        found[f"synchronisation time upsilon (8.13), {name}"] = upsilon(z3, w3, mu)
        found[f"largest displacement of the {name}"] = np.abs(
            moved_linearly(alike(mu, w3, z3), RELEASED, 600.0)[1][2]
        ).max()
    return found


def section_10_2():
    low, high = 0.0, 0.04945
    for _ in range(6):
        mu = 0.5 * (low + high)
        t, y = moved_linearly(alike(mu), RELEASED, 1600.0)
        last = phase(y[0], y[1])[(t >= 1200.0) & (t <= 1500.0)]
        low, high = (low, mu) if np.abs(last - np.pi).max() < 0.2 * np.pi else (mu, high)
    return {"least mu that synchronises by tau = 1500, the virtual system by itself": high}


def with_law(spring=0.0, of_sum=0.0, of_difference=0.0):
    """Return the matrix (6, 6) of the identical set-up with a coupling law beside the beam."""
    matrix = alike(0.04945)
    apart, together = np.array([[1, -1], [-1, 1]]), np.array([[1, 1], [1, 1]])
    matrix[3:5, 0:2] -= spring * apart
    matrix[3:5, 3:5] -= 2 * of_sum * together + 2 * of_difference * apart
    return matrix


LAWS = {
    "the beam alone": {},
    "a spring between the oscillators, 0.1": {"spring": 0.1},
    "a damper of the sum, 0.05": {"of_sum": 0.05},
    "a damper of the difference, 0.05": {"of_difference": 0.05},
}


def section_10_2_laws():
    # The sum x1 + x2 moves with the beam, the difference by itself.
    take, give = np.array([[1, 1, 0], [0, 0, 1]]), np.array([[0.5, 0], [0.5, 0], [0, 1]])
    found, both = {}, np.eye(2)
    for name, law in LAWS.items():
        total = np.kron(both, take) @ with_law(**law) @ np.kron(both, give)
        apart = np.kron(both, [[1, -1, 0]]) @ with_law(**law) @ np.kron(both, [[0.5], [-0.5], [0]])
        found[f"decay of the sum, {name}"] = -np.linalg.eigvals(total).real.max()
        found[f"decay of the difference, {name}"] = -np.linalg.eigvals(apart).real.max()
    return found


def section_10_2_control():
    found = {}
    for name, law in (("anti-phase", {"of_sum": 0.05}), ("in phase", {"of_difference": 0.05})):
        matrix = with_law(**law)

        def rate(_, y, matrix=matrix):
            rates = matrix @ y
            x, v = y[:2] - y[2], y[3:5] - y[5]
            rates[3:5] -= 2 * 0.1 * ((x @ x + v @ v) / (2 * 0.4**2) - 1) * v
            return rates

        t, y = moved(rate, RELEASED, 440.0)
        last = (t >= 360.0) & (t <= 400.0)
        found[f"phase / pi at tau = 400, {name}, the virtual system by itself"] = folded(phase(y[0], y[1])[last])
        found[f"amplitude at tau = 400, {name}, the virtual system by itself"] = np.abs(y[:2, last]).max()
    return found


# Errata.


def erratum_shape_functions():
    def far(_, y):
        return y[0] + 10

    odd = solve_ivp(lambda _, y: (y[1], -(y[0] ** 2)), (0, 3.45), (-0.5, 0), "DOP853", events=far, rtol=1e-9, atol=1e-9)
    return {
        "restoring force at -0.5, eta(x) = x": -(0.5**2),
        "restoring force at -0.5, eta(x) = 1 + x^2/3": 0.5 + 0.5**3 / 3,
        "integral of condition 2 at x = -10, eta(x) = x": -(10.0**3) / 3,
        "integral of condition 2 at x = -10, eta(x) = 1 + x^2/3": 10.0**2 / 2 + 10.0**4 / 12,
        "tau at which an oscillator released at -0.5 passes -10, eta(x) = x": odd.t_events[0][0],
    }


def erratum_index():
    right, printed = (MU[1] * 2 * Z[1] * SCALED[1] * (1 - x) for x in (1.0, 0.0))
    return {
        "internal forces of damper 2 in sum, with x2' - x3'": right,
        "internal forces of damper 2 in sum, with x1' - x3', as printed": printed,
    }


def erratum_eps():
    return {
        "eps over the stroke of 5 mm": 5e-4 / 5e-3,
        "phase / pi nearest to 1 that (5.3) allows with an amplitude of 0.4": 1 - math.asin(5e-4 / 0.4) / math.pi,
        "phase / pi nearest to 1 that (5.3) allows with eps = 0.1": 1 - math.asin(0.1 / 0.4) / math.pi,
    }


def erratum_stiffness_power():
    w3, mu, z3 = SCALED[2], 0.04945, Z[2]
    t, y = moved_linearly(on_a_beam((1, 1, w3), (0, 0, z3), (mu, mu)), RELEASED, 100.0, 0.025)
    x, v = y[:3], y[3:]
    found = {}
    for name, stiffness in (("w3^2", w3**2), ("w3", w3)):
        energy = 0.5 * (mu * (v[0] ** 2 + v[1] ** 2 + (x[0] - x[2]) ** 2 + (x[1] - x[2]) ** 2) + v[2] ** 2)
        energy += 0.5 * stiffness * x[2] ** 2
        balance = energy + cumulative_simpson(2 * z3 * w3 * v[2] ** 2, x=t, initial=0)
        found[f"energy that is not accounted for, over the first, with {name}"] = np.ptp(balance) / balance[0]
    return found
