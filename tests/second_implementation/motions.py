"""Motions of oscillators on a beam and of other systems, and what is read off them, with numpy and scipy alone."""

import itertools
import math

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import eig
from scipy.optimize import fsolve, minimize_scalar
from scipy.signal import hilbert
from scipy.signal.windows import hann

# Tables B.1, 4.2, 4.4, B.4 and (4.3): SI units, then dimensionless.
W, Z, C = (12.5521, 14.0337, 9.7369), (0.3362, 0.4296, 0.0409), (20.9218, 23.2465, 1.2589)
MU, STROKE, VOLTS = (0.0411, 0.0578), 5e-3, 0.42
WBAR = 0.5 * (W[0] + W[1])
RHO = (0.091796394850297, 0.084268742935300, 0.680504615284765)
LAM = tuple(VOLTS * c / (STROKE * WBAR**2) for c in C)
GAINS = (3.1054e5, 3.4505e5, 1.8686e4)
SAMPLE = 0.05


# Motions and what is read off them.


def moved(rate, start, end, sample=SAMPLE, tolerance=1e-11):
    """Return times (m,) and states (2 n, m) of a motion."""
    t = np.linspace(0.0, end, round(end / sample) + 1)
    return t, solve_ivp(rate, (0.0, end), start, "DOP853", t, rtol=tolerance, atol=1e-3 * tolerance).y


def moved_linearly(matrix, start, end, sample=SAMPLE):
    """Return times (m,) and states (2 n, m) of y' = matrix y, by its eigenvalues."""
    t = np.linspace(0.0, end, round(end / sample) + 1)
    values, vectors = eig(matrix)
    weights = np.linalg.solve(vectors, np.array(start, dtype=complex))
    return t, ((vectors * weights) @ np.exp(np.outer(values, t))).real


def on_a_beam(w, z, mu, nu=(0.0, 0.0, 0.0), e=(0.0, 0.0)):
    """Return the matrix (6, 6) of two oscillators on a beam, (4.4)-(4.6) and (8.4)-(8.6) for small angles."""
    k = np.array([[w[0] ** 2, 0, -(w[0] ** 2)], [0, w[1] ** 2, -(w[1] ** 2)]])
    b = np.array([[1, 0, -1], [0, 1, -1]]) * np.array([[2 * (z[i] - e[i]) * w[i]] for i in (0, 1)])
    stiff = np.vstack([k, -mu[0] * k[0] - mu[1] * k[1]]) + np.diag([nu[0] ** 2, nu[1] ** 2, w[2] ** 2 + nu[2] ** 2])
    damp = np.vstack([b, -mu[0] * b[0] - mu[1] * b[1]]) + np.diag([0, 0, 2 * z[2] * w[2]])
    return np.block([[np.zeros((3, 3)), np.eye(3)], [-stiff, -damp]])


def phase(a, b):
    """Return the phase difference (m,), in [-pi/2, 3 pi/2)."""
    return np.mod(np.angle(hilbert(a) * np.conj(hilbert(b))) + np.pi / 2, 2 * np.pi) - np.pi / 2


def folded(angles):
    return abs(np.angle(np.mean(np.exp(1j * angles)))) / np.pi


def period(t, a):
    """Return the mean period: the frequency of the largest line under a Hann window."""
    window = hann(len(a) + 2)[1:-1] * (a - a.mean())
    first = 2 * np.pi * (np.argmax(np.abs(np.fft.rfft(window))[1:]) + 1) / (t[-1] - t[0])
    found = minimize_scalar(
        lambda w: -abs(np.exp(-1j * w * (t - t.mean())) @ window),
        bounds=(first - 2 * np.pi / (t[-1] - t[0]), first + 2 * np.pi / (t[-1] - t[0])),
        method="bounded",
        options={"xatol": 1e-12},
    )
    return 2 * np.pi / found.x


def anti_phase(t, a, b, fraction=0.2):
    """Return alpha and eps of (5.3) over the last part, with <a z>/<b z>, z = b a period away."""
    part = t >= t[-1] - fraction * (t[-1] - t[0]) - 1e-9
    t, a, b = t[part], a[part], b[part]
    whole, other = period(t, max(a, b, key=np.linalg.norm)), CubicSpline(t, b)
    inside = t + whole / 2 <= t[-1]
    a, at = a[inside], t[inside] + whole / 2
    shifted, z = other(at), other(np.where(at - whole >= t[0], at - whole, at + whole))
    alpha = (a @ z) / (shifted @ z)
    return alpha, np.abs(a - alpha * shifted).max()


def largest(t, x, window, end=None):
    end = t[-1] if end is None else end
    return np.abs(x[(t >= end - window - 1e-9) & (t <= end + 1e-9)]).max()


def after(t, g, eps):
    """Return the time after which |g| stays below eps."""
    g = np.abs(g)
    last = np.flatnonzero(g >= eps)[-1]
    return t[last] + (g[last] - eps) / (g[last] - g[last + 1]) * (t[last + 1] - t[last])


def settled(t, a, b, part=0.01):
    return after(t, a + b, part * max(largest(t, x, 0.1 * t[-1]) for x in (a, b)))


def peaks(t, a, b, window, times):
    return {f"peak of the sum over {window:g} before tau = {tau}": largest(t, a + b, window, tau) for tau in times}


WITHIN_1_PERCENT = "tau from which the sum stays within 1 % of the amplitude"


SCALED = tuple(w / WBAR for w in W)
RELEASED = (-1.0, -0.8, 0.0, 0.0, 0.0, 0.0)


def differing(made, ratio, angle):
    """Return how oscillators differ that end in a ratio and a phase, and how fast their in-phase mode decays.

    Args:
        made: the matrix (6, 6) of the two factors of frequency and e1, e2.
        ratio: of the amplitudes.
        angle: between them, over pi.
    """

    def pair(matrix):
        values, vectors = np.linalg.eig(matrix)
        found = sorted((i for i in range(6) if values[i].imag > 0), key=lambda i: -values[i].real)[:2]
        modes = [(values[i], vectors[0, i] / vectors[1, i]) for i in found]
        return sorted(modes, key=lambda mode: mode[1].real / abs(mode[1]))  # anti-phase, in-phase

    best = None
    wanted = [ratio * np.exp(s * 1j * np.pi * angle) for s in (1, -1)]
    for target, start, supply in itertools.product(wanted, np.linspace(-0.05, 0.05, 21), (0.002, -0.002)):

        def missed(x, target=target):
            value, shape = pair(made(1 + x[0], 1 - x[0], x[1], x[2]))[0]
            return [100 * value.real, math.log(abs(shape / target)), np.angle(shape / target)]

        x, _, status, _ = fsolve(missed, [start, 0.003 + supply, 0.003 - supply], full_output=True, xtol=1e-12)
        matrix = made(1 + x[0], 1 - x[0], x[1], x[2])
        if status != 1 or max(map(abs, missed(x))) > 1e-6 or np.linalg.eigvals(matrix).real.max() > 1e-6:
            continue
        decay = -pair(matrix)[1][0].real
        if best is None or decay > best["decay of the in-phase mode, differing"]:
            best = {
                "difference in frequency, % to either side": 100 * x[0],
                "over-compensation e1": x[1],
                "over-compensation e2": x[2],
                "decay of the in-phase mode, alike and not driven": -pair(made(1, 1, 0, 0))[1][0].real,
                "decay of the in-phase mode, differing": decay,
            }
    return best


def amplitudes(alpha, angle):
    """Return the ratio of amplitudes of an alpha of (5.3) and a phase over pi."""
    return alpha / math.cos(math.pi * (1.0 - min(angle, 2.0 - angle)))


def alike(mu, w3=SCALED[2], z3=Z[2]):
    return on_a_beam((1.0, 1.0, w3), (0, 0, z3), (mu, mu))


def sum_of_discs(z3, w3=0.7252, mu=0.0256):
    """Return the matrix (4, 4) of (8.11)."""
    return np.array([[0, 1, 0, 0], [-1, 0, 2, 0], [0, 0, 0, 1], [mu, 0, -(2 * mu + w3**2), -2 * z3 * w3]], dtype=float)


def upsilon(z3, w3=0.7252, mu=0.0256):
    return -1.0 / np.linalg.eigvals(sum_of_discs(z3, w3, mu)).real.max()
