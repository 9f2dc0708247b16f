"""Records of one or two masses with a law between them or to the ground that no dictionary has.

Nothing of the package is used. Laws are written in displacement and rate over their typical sizes, s and w, and scaled
to a rig of random size: lengths from tenths of a millimetre to metres, masses from grams to tonnes.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from math import atan, exp, fabs, sin, sinh, tan, tanh

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]
Law = Callable[[float, float], float]

PERIODS, NOISE, OFF = 60, 1e-3, 0.01
SAMPLES = 60  # of a period of the slowest mode
BESIDE = 0.005  # of the spring, in every second record: what imperfect rigs have beside
SHARP = 1e-3  # of the typical rate: width of the sign of a friction


def sign(x: float) -> float:
    """Return the sign of a number, smooth where it is small."""
    return tanh(x / SHARP)


LAWS: dict[str, Law] = {
    "power 1.5": lambda s, w: 0.5 * s * fabs(s) ** 0.5,
    "power 3.4": lambda s, w: 0.15 * s * fabs(s) ** 2.4,
    "one side": lambda s, w: 0.5 * max(s, 0.0) ** 1.5,
    "van der Pol": lambda s, w: 0.12 * s * s * w,
    "tangent": lambda s, w: 1.2 * tan(0.3 * s),
    "exponential": lambda s, w: 0.8 * (exp(0.5 * s) - 1.0),
    "sinh": lambda s, w: 0.3 * sinh(0.8 * s),
    "cosine": lambda s, w: 0.5 * (sin(2.2 * s + 0.9) - sin(0.9)),
    "magnet": lambda s, w: 1.5 * (1.0 / (1.0 - s / 7.0) ** 2 - 1.0),
    "soft": lambda s, w: 0.9 * s / (1.0 + s * s),
    "fluid 1.7": lambda s, w: 0.15 * w * fabs(w) ** 0.7,
    "thinning": lambda s, w: 0.25 * w / fabs(w + 1e-9) ** 0.4,
    "eddy current": lambda s, w: 0.4 * w / (1.0 + w * w),
    "worn guide": lambda s, w: (0.06 + 0.06 * s * s) * sign(w),
    "valve": lambda s, w: 0.15 * exp(0.4 * s) * w,
    "hydraulic bump": lambda s, w: 0.12 * s * s * w * fabs(w),
    "saturated": lambda s, w: 0.6 * atan(2.0 * s),
    "cubic": lambda s, w: 0.15 * s**3,
    "drag": lambda s, w: 0.15 * w * fabs(w),
    "rubbing": lambda s, w: 0.12 * sign(w),
    "weight": lambda s, w: 0.5 * sin(1.5 * s),
    "play": lambda s, w: 0.8 * (s - min(max(s, -0.6), 0.6)),
    "square": lambda s, w: 0.2 * s**2,
}  # fmt: skip
# What the dictionary calls those laws that it has.
NAMES = {
    "van der Pol": "displacement_damping",
    "eddy current": "eddy_current_drag",
    "cubic": "hardening_spring",
    "drag": "quadratic_damping",
    "rubbing": "dry_friction",
    "weight": "gravity_force",
    "play": "backlash",
    "square": "polynomial_spring",
}


@dataclass(frozen=True)
class Case:
    """A law in a rig: its name, a seed, and whether it sits between two masses."""

    law: str
    seed: int
    masses: int = 1

    @property
    def name(self) -> str:
        """Return what the case is called."""
        return f"{self.law.replace(' ', '_')}-{self.masses}-{self.seed}"


@dataclass(frozen=True)
class Rig:
    """A rig of one or two masses on springs, in a row from the ground; the law sits in the last spring.

    Args:
        m, k, c: masses, stiffnesses and dampings (n,).
        size: typical displacement of the last spring in m.
        speed: rad/s of the slowest mode.
        law: force of the last spring over k size, of displacement over size and rate over speed size.
        strength: factor of the law.
        beside: factor of a small further force, which is no part of any law.
    """

    m: Array
    k: Array
    c: Array
    size: float
    speed: float
    law: Law
    strength: float
    beside: float = 0.0

    @classmethod
    def of(cls, case: Case) -> Rig:
        """Return the rig of a case."""
        draw = np.random.default_rng([case.seed, case.masses, *case.law.encode()])
        m = 10.0 ** draw.uniform(-2.0, 2.0) * draw.uniform(0.7, 1.4, case.masses)
        speed = 2.0 * np.pi * 10.0 ** draw.uniform(-0.3, 0.7)
        k = m.mean() * speed**2 * draw.uniform(0.8, 1.5, case.masses) * (1.0 if case.masses == 1 else 2.0)
        c = draw.uniform(0.02, 0.06, case.masses) * np.sqrt(m.mean() * k)
        return cls(m, k, c, 10.0 ** draw.uniform(-4.0, 0.0), speed, LAWS[case.law], draw.uniform(0.5, 1.5),
                   BESIDE * (case.seed % 2 == 0))  # fmt: skip

    def hidden(self, d: float, v: float) -> float:
        """Return the hidden force at a displacement and a rate of the last spring."""
        s, w = d / self.size, v / (self.speed * self.size)
        return float(self.k[-1]) * self.size * (self.strength * self.law(s, w) + self.beside * s * fabs(s) ** 0.5)

    def forces(self, q: list[float], v: list[float], law: float) -> list[float]:
        """Return accelerations without input; the law counts `law` times."""
        passed, n = [], len(q)
        for i in range(n):
            d, r = (q[0], v[0]) if i == 0 else (q[i] - q[i - 1], v[i] - v[i - 1])
            extra = self.hidden(d, r) if i == n - 1 and law else 0.0
            passed.append(float(self.k[i]) * d + float(self.c[i]) * r + extra)
        return [(-passed[i] + (passed[i + 1] if i + 1 < n else 0.0)) / float(self.m[i]) for i in range(n)]

    def simulated(self, push: Callable[[float], float], times: Array) -> Array:
        """Return coordinates and velocities (2 n, m) under a force on the last mass, infinite if they run away."""
        n = len(self.m)

        def rates(t: float, y: Array) -> list[float]:
            state = y.tolist()
            a = self.forces(state[:n], state[n:], 1.0)
            a[-1] += push(t) / float(self.m[-1])
            return [*state[n:], *a]

        step, scale = 2.0 * np.pi / self.speed / SAMPLES, 1e-8 * self.size
        with suppress(OverflowError):
            found = solve_ivp(
                rates, (0.0, times[-1]), np.zeros(2 * n), "LSODA", t_eval=times, rtol=1e-7, max_step=step,
                atol=[scale] * n + [scale * self.speed] * n,
            )  # fmt: skip
            if found.success:
                return np.asarray(found.y)
        return np.full((2 * n, len(times)), np.inf)


@dataclass(frozen=True)
class Record:
    """Force and displacements over time, with noise, and without it."""

    t: Array
    u: Array
    read: Array
    true: Array
    rate: Array


def record(rig: Rig, seed: int) -> Record:
    """Return a record of a rig under a multisine that moves the last spring by about its typical size."""
    draw, period = np.random.default_rng([7, seed]), 2.0 * np.pi / rig.speed
    times = np.arange(PERIODS * SAMPLES) * period / SAMPLES  # of the slowest mode
    lines = np.linspace(0.15, 2.2, 24) + draw.uniform(-0.02, 0.02, 24)
    phases, speeds = draw.uniform(0.0, 2.0 * np.pi, 24), lines * rig.speed

    size = float(rig.k[-1]) * rig.size * 0.1
    u = size * np.sin(np.outer(times, speeds) + phases).sum(axis=1)

    def push(t: float) -> float:
        i = min(int(t / times[1]), len(u) - 2)
        return float(u[i] + (u[i + 1] - u[i]) * (t / times[1] - i))

    while not np.isfinite(y := rig.simulated(push, times)).all():  # it has run away, as along a square law
        u *= 0.5
    n = len(rig.m)
    noise = NOISE * y[:n].std(axis=1, keepdims=True)
    return Record(times, u, y[:n] + noise * draw.normal(size=y[:n].shape), y[:n], y[n:])


def model(rig: Rig, seed: int) -> str:
    """Return the model of a rig without its law, its parameters a little off, as YAML."""
    draw, n = np.random.default_rng([11, seed]), len(rig.m)
    names = [f"{kind}{i + 1}" for kind in "mkc" for i in range(n)]
    units = {"m": "kg", "k": "N/m", "c": "N*s/m"}
    off = 1.0 + OFF * draw.normal(size=3 * n).clip(-2.0, 2.0)
    values = dict(zip(names, np.concatenate([rig.m, rig.k, rig.c]) * off, strict=True))
    lines = [
        "name: masses in a row",
        f"coordinates: {{{', '.join(f'q{i + 1}: {{unit: m}}' for i in range(n))}}}",
        "inputs: {u: {unit: N}}",
        "parameters:",
        *(f"  {name}: {{value: {value:.8g}, unit: {units[name[0]]}}}" for name, value in values.items()),
        "equations:",
    ]
    for i in range(1, n + 1):
        own = f"-k{i}*{_stretch(i)} - c{i}*{_stretch(i, True)}"
        further = f" + k{i + 1}*{_stretch(i + 1)} + c{i + 1}*{_stretch(i + 1, True)}" if i < n else " + u"
        lines.append(f"  m{i}*q{i}'': {own}{further}")
    lines.append("elements:")
    for i in range(1, n + 1):
        acts = f"{{q{i}: -1}}" if i == 1 else f"{{q{i - 1}: 1, q{i}: -1}}"
        lines.append(f"  spring{i}: {{displacement: {_stretch(i).strip('()')}, unit: N, acts: {acts}}}")
    return "\n".join(lines) + "\n"


def _stretch(i: int, is_rate: bool = False) -> str:
    prime = "'" if is_rate else ""
    return f"q1{prime}" if i == 1 else f"(q{i}{prime} - q{i - 1}{prime})"


def table(made: Record) -> str:
    """Return a record as CSV, with inputs in straight lines between samples."""
    names = ["t", "u", *(f"q{i + 1}" for i in range(len(made.read)))]
    rows = np.column_stack([made.t, made.u, made.read.T])
    return "\n".join([",".join(names), *(",".join(f"{x:.9g}" for x in row) for row in rows)]) + "\n"
