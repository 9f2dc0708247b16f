"""The virtual systems: chapters 7, 8 and 9, the ENOC paper, and their errata, with numpy and scipy alone."""

import math

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from tests.second_implementation.motions import (
    MU,
    STROKE,
    VOLTS,
    WITHIN_1_PERCENT,
    C,
    W,
    Z,
    after,
    amplitudes,
    anti_phase,
    differing,
    folded,
    largest,
    moved,
    moved_linearly,
    on_a_beam,
    peaks,
    phase,
    settled,
    sum_of_discs,
    upsilon,
)

# Chapter 7.

TH, W3 = 4.4728e6 * STROKE**2 / 18.3157**2, 9.7369 / 18.3157
PRINTED_TH = 7.4524e-7


def duffing(mu):
    def rate(_, y):
        x1, x2, x3, v1, v2, v3 = y
        f1, f2 = ((x - x3) * (1.0 + TH * (x - x3) ** 2) for x in (x1, x2))
        return v1, v2, v3, -f1, -f2, mu[0] * f1 + mu[1] * f2 - W3**2 * x3 - 2 * Z[2] * W3 * v3

    return rate


def table_7_2():
    return {"w (both)": 1.0, "th (both), beta l^2/wbar^2": TH, "w3, that of the beam, in the new time": W3}


def table_7_3():
    return {"th (both)": TH}


def fig_7_2():
    t, y = moved(duffing((0.0495, 0.0495)), (-0.6, -0.5, 0, 0, 0, 0), 2600.0)
    angle, whole = phase(y[0], y[1]), t <= 2500.0
    t, (a, b) = t[whole], y[:2, whole]
    return {
        **peaks(t, a, b, 20.0, (625, 1250, 1875, 2500)),
        WITHIN_1_PERCENT: settled(t, a, b),
        "phase / pi at the end": folded(angle[whole][-400:]),
    }


def fig_7_3():
    def made(f1, f2, e1, e2):
        return on_a_beam((f1, f2, W3), (0, 0, Z[2]), MU, e=(e1, e2))

    found = differing(made, amplitudes(2.22, 1.0), 1.0)
    f = found["difference in frequency, % to either side"] / 100
    matrix = made(1 + f, 1 - f, found["over-compensation e1"], found["over-compensation e2"])

    def rate(_, y):
        rates, cubes = matrix @ y, TH * (y[:2] - y[2]) ** 3
        return rates + np.concatenate([[0, 0, 0], -cubes, [np.dot(MU, cubes)]])

    t, y = moved(rate, (-0.6, -0.5, 0, 0, 0, 0), 600.0)
    return {**found, "alpha, differing (fitted), the virtual system by itself": anti_phase(t, y[0], y[1])[0]}


# Chapter 8.

PLAIN = {"w3": 0.4472, "z3": 0.0707, "mu": 0.1, "nu": 0.0, "nu3": 0.0}
ECCENTRIC = {"w3": 0.4568, "z3": 0.1523, "mu": 0.1043, "nu": 0.7004, "nu3": 0.3577}


def discs(w3, z3, mu, nu, nu3):
    def rate(_, y):
        a, b, c, va, vb, vc = y
        turned = mu * (a + b - 2 * c) - w3**2 * c - 2 * z3 * w3 * vc - nu3**2 * math.sin(c)
        return va, vb, vc, -(a - c) - nu**2 * math.sin(a), -(b - c) - nu**2 * math.sin(b), turned

    return rate


def small_discs(p):
    def made(f1, f2, e1, e2):
        mu, nu = (p["mu"], p["mu"]), (p["nu"], p["nu"], p["nu3"])
        return on_a_beam((f1, f2, p["w3"]), (0, 0, p["z3"]), mu, nu, (e1, e2))

    return made


def table_8_2():
    return {"w3 / wbar": 3.1623 / 7.0711}


def table_8_3():
    return {"w3 / wbar": 4.5564 / 6.2832}


def fig_8_2():
    t, y = moved_linearly(small_discs(PLAIN)(1, 1, 0, 0), (-0.05, -0.04, 0, 0, 0, 0), 1000.0)
    angle, whole = phase(y[0], y[1]), t <= 900.0
    t, (a, b) = t[whole], y[:2, whole]
    return {
        **peaks(t, a, b, 10.0, (112, 225, 337, 450)),
        "tau from which the phase stays within 0.2 pi of pi": after(t, angle[whole] - np.pi, 0.2 * np.pi),
    }


def fig_8_3():
    return differing(small_discs(PLAIN), amplitudes(1.3333, 0.95), 0.95)


def fastest(factor=1.0):
    return minimize_scalar(
        lambda z3: upsilon(factor * z3), bounds=(0.01, 0.8), method="bounded", options={"xatol": 1e-9}
    )


def sum_settled(z3):
    t, y = moved_linearly(sum_of_discs(z3), (-0.09, 0, 0, 0), 800.0, 0.025)
    return after(t, y[0], 1e-4)


def fig_8_4():
    best, grid = fastest(), np.linspace(0.28, 0.44, 81)
    times = [sum_settled(z3) for z3 in grid]
    return {
        "fastest z3, by eigenvalues": best.x,
        "upsilon there": best.fun,
        "fastest z3, simulated (definition 8.1, eps = 1e-4)": grid[np.argmin(times)],
        "tau_s there": min(times),
        "tau_s at the optimum of the eigenvalues": sum_settled(best.x),
    }


def fig_8_5():
    t, y = moved(discs(**ECCENTRIC), (-0.05, -0.04, 0, 0, 0, 0), 900.0)
    return {**peaks(t, y[0], y[1], 10.0, (225, 450, 675, 900)), WITHIN_1_PERCENT: settled(t, y[0], y[1])}


def fig_8_6():
    return differing(small_discs(ECCENTRIC), amplitudes(1.4068, 0.8), 0.8)


# Chapter 9.


def clocks(om=1.3034, z=0.2041, mu=0.25):
    """Return the rates of (9.4), (9.5) and (9.10)."""

    def rate(_, y):
        a, b, x, va, vb, vx = y
        push = mu / 3 * sum(math.sin(2 * th) / 2 + v**2 * math.sin(th) for th, v in ((a, va), (b, vb)))
        whole = 1 - mu / 3 * (math.cos(a) ** 2 + math.cos(b) ** 2)
        beam = (push - 2 * z * om * vx - om**2 * x) / whole
        return va, vb, vx, *(-(beam * math.cos(th) + math.sin(th)) for th in (a, b)), beam

    return rate


def table_9_2():
    return {"Om = w3 / wbar": 4.0825 / 3.1321, "w = sqrt(g / 1 m), rad/s": math.sqrt(9.81)}


def fig_9_2():
    t, y = moved(clocks(), (-math.pi / 4, -0.9 * math.pi / 4, 0, 0, 0, 0), 440.0)
    angle, whole = phase(y[0], y[1]), t <= 400.0
    t, (a, b) = t[whole], y[:2, whole]
    return {
        **peaks(t, a, b, 10.0, (100, 200, 300, 350, 400)),
        WITHIN_1_PERCENT: settled(t, a, b),
        "phase / pi at the end": folded(angle[whole][-400:]),
    }


def demanded(motion, accelerations):
    """Return the largest voltage of an actuator over 0.42 V that moves the linear rig as wanted.

    Args:
        motion: displacements and velocities (6, m), SI.
        accelerations: the wanted ones (3, m), SI.
    """
    x, v = motion[:3], motion[3:]
    f = [W[i] ** 2 * (x[i] - x[2]) + 2 * Z[i] * W[i] * (v[i] - v[2]) for i in (0, 1)]
    u1, u2 = ((accelerations[i] + f[i]) / C[i] for i in (0, 1))
    left = accelerations[2] - MU[0] * f[0] - MU[1] * f[1] + W[2] ** 2 * x[2] + 2 * Z[2] * W[2] * v[2]
    # Newton's third law: what actuator i adds to oscillator i it takes from the beam, by the ratio of their masses.
    u3 = (left + MU[0] * C[0] * u1 + MU[1] * C[1] * u2) / C[2]
    return max(np.abs(u).max() for u in (u1, u2, u3)) / VOLTS


def pendulum_demand(length, swing, angles, beam):
    """Return the demand of pendula of a length, m, whose `swing` and `beam` (in lengths) the stroke stands for.

    And their largest displacement from the beam, in strokes.
    """
    mass, w = 0.9, math.sqrt(9.81 / length)
    om = math.sqrt(70.0 / mass) / w
    rate = clocks(om, 10.0 / (2 * mass * om * w), 3 * 0.05 / mass)
    _, y = moved(rate, (*angles, 0, 0, 0, 0), 400.0, 0.02, 1e-9)
    rates = np.array([rate(0, column) for column in y.T]).T
    size = STROKE * np.array([1 / swing, 1 / swing, 1 / beam])[:, None]
    demand = demanded(np.vstack([size * y[:3], w * size * y[3:]]), w**2 * size * rates[3:])
    return demand, np.abs(size[:2] * y[:2] - size[2] * y[2]).max() / STROKE


def section_9_2():
    wide, travel = pendulum_demand(0.25, 0.785398, (0.785398, 0.706858), 0.02)
    return {
        "demand over limit, 1 Hz and 1 degree": pendulum_demand(0.25, 0.02, (0.02, 0.018), 0.02)[0],
        "demand over limit, 5 Hz": pendulum_demand(0.0099396, 0.503039, (0.503039, 0.452735), 0.503039)[0],
        "demand over limit, 45 degrees": wide,
        "travel over the stroke, 45 degrees": travel,
    }


# The ENOC paper.


def enoc_duffing(_, y):
    x1, x2, x3, v1, v2, v3 = y
    k1, k2 = ((15.26**2 + 8.14 * (x - x3) ** 2) * (x - x3) for x in (x1, x2))
    return v1, v2, v3, -k1, -k2, (k1 + k2 - x3 - 5 * v3) / 0.8


def enoc_fig_6_7():
    t, y = moved(enoc_duffing, (-3, -2.5, 0, 0, 0, 0), 50.0, 0.005)
    angle, whole = phase(y[0], y[1]), t <= 47.0
    t, y = t[whole], y[:, whole]
    last, start = t > 45.0, t <= 1.0
    rates = np.array([enoc_duffing(0, column) for column in y[:, start].T]).T
    demand = demanded(1e-3 * y[:, start], 1e-3 * rates[3:])
    return {
        "largest |x1 + x2| in the last 2 s, mm": np.abs(y[0] + y[1])[last].max(),
        "largest |x3| in the last 2 s, mm": np.abs(y[2])[last].max(),
        "amplitude in the last 2 s, mm": max(largest(t, y[i], 0.04 * 47.0) for i in (0, 1)),
        "phase / pi at the end": folded(angle[whole][-1000:]),
        "demand of the actuators over their limit, masked on the rig": demand,
    }


def enoc_fig_9_10():
    return {
        "damping of the middle disc, 2 z3 w3, 1/s": 2 * 0.1308 * 0.4568 * 6.6667,
        "damping of the rig's beam, 2 z3 w3, 1/s": 2 * Z[2] * W[2],
    }


# Errata.


def erratum_cubic():
    scale = (STROKE / 18.3157) ** 2
    return {
        "th = beta l^2/wbar^2": TH,
        "10 (l/wbar)^2, in SI units": 10 * scale,
        "beta that the printed th would belong to, 1/(m^2 s^2)": PRINTED_TH / scale,
    }


def erratum_inertia():
    def swings(inertia):
        def bottom(_, y):
            return y[0]

        rate = 9.81 * 0.25 / inertia
        run = solve_ivp(lambda _, y: (y[1], -rate * y[0]), (0, 10), (1.0, 0.0), "DOP853", events=bottom, rtol=1e-10)
        return 0.5 / (run.t_events[0][1] - run.t_events[0][0])

    return {
        "point mass on 0.25 m, Hz, with J = m l^2": swings(0.25**2),
        "point mass on 0.25 m, Hz, with J = m l": swings(0.25),
    }


def erratum_power():
    p, found = ECCENTRIC, {}
    y = moved(discs(**p), (-0.05, -0.04, 0, 0, 0, 0), 50.0)[1]
    (a, b, c), v = y[:3], y[3:]
    acceleration = np.array([discs(**p)(0, column)[3:] for column in y.T]).T
    inertia = (p["mu"], p["mu"], 1.0)
    rest = p["mu"] * ((a - c) * (v[0] - v[2]) + (b - c) * (v[1] - v[2])) + p["w3"] ** 2 * c * v[2]
    rest += p["mu"] * p["nu"] ** 2 * (np.sin(a) * v[0] + np.sin(b) * v[1]) + p["nu3"] ** 2 * np.sin(c) * v[2]
    power = -2 * p["z3"] * p["w3"] * v[2] ** 2
    for name, n in (("theta'' theta'", 1), ("theta''^2 theta', as printed", 2)):
        kinetic = sum(j * x**n * u for j, x, u in zip(inertia, acceleration, v, strict=True))
        found[f"largest error of dV/dt over its largest value, with {name}"] = np.abs(kinetic + rest - power).max()
    return {what: x / np.abs(power).max() for what, x in found.items()}


def erratum_sum():
    return {"a third term of the sum, with x3 - x3 = 0": 0.0}


def erratum_damping_entry():
    return {
        "fastest z3 with dimensionless w3": fastest().x,
        "fastest z3 with w3 in rad/s, as printed": fastest(4.5564 / 0.7252).x,
    }
