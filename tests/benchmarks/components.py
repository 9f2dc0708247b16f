"""Records of components and first-order systems with something hidden in them, by closed forms and numpy alone.

Nothing of the package is used. A component is moved by a multisine; its force follows from displacement and velocity.
Memories depend on the path only, so that their differential equations are solved in closed form over each piece of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RATE = 1000.0  # Hz, of components and motors
NOISE = 1e-3  # of the rms
KT, B, J = 0.1005, 0.0198, 0.0101  # of the motor, N m/A, N m s/rad, kg m^2
PIECES = 8  # of a sample: the way turns round within one of them, not within a sample


@dataclass(frozen=True)
class Motion:
    """A multisine: amplitudes in m, frequencies in Hz, phases in rad (lines,)."""

    amplitudes: Array
    frequencies: Array
    phases: Array

    @classmethod
    def of(cls, seed: int, largest: float, low: float = 0.2, high: float = 8.0, lines: int = 25) -> Motion:
        """Return a multisine whose amplitudes fall with the frequency; `largest` is what it reaches in 100 s."""
        frequencies = np.linspace(low, high, lines)
        phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, lines)
        made = cls(1.0 / (1.0 + frequencies), frequencies, phases)
        size = largest / np.abs(made.at(np.arange(100_000) / RATE)).max()
        return cls(size * made.amplitudes, frequencies, phases)

    def at(self, t: Array) -> Array:
        """Return the displacement at times (m,)."""
        return self._sum(t, np.sin, self.amplitudes)

    def rate(self, t: Array) -> Array:
        """Return its rate at times (m,)."""
        return self._sum(t, np.cos, 2.0 * np.pi * self.frequencies * self.amplitudes)

    def _sum(self, t: Array, function: Callable[[Array], Array], amplitudes: Array) -> Array:
        found = np.zeros(len(t))
        for a, f, phase in zip(amplitudes, self.frequencies, self.phases, strict=True):
            found += a * function(2.0 * np.pi * f * t + phase)
        return found


def dahl(way: Array, x0: float) -> Array:
    """Return the part of Dahl's friction that has built up along a way (m,): z' = (v - |v| z)/x0, from 0.

    Over a piece dx in one direction, z goes from where it is to the direction's sign as exp(-|dx|/x0).
    """
    found = np.zeros(len(way))
    for i, dx in enumerate(np.diff(way)):
        sign = math.copysign(1.0, dx)
        found[i + 1] = sign + (found[i] - sign) * math.exp(-abs(dx) / x0)
    return found


def bouc_wen(way: Array, zmax: float) -> Array:
    """Return the elastic part of a displacement along a way (m,): z' = v - (|v| z |z| + v z^2)/(2 zmax^2), from 0.

    Against the motion it unloads in a straight line, and with it z is zmax times a hyperbolic tangent.
    """
    found = np.zeros(len(way))
    for i, dx in enumerate(np.diff(way)):
        sign = math.copysign(1.0, dx)
        z, left = sign * found[i], abs(dx)
        straight = min(left, max(-z, 0.0))
        z, left = z + straight, left - straight
        found[i + 1] = sign * (zmax * math.tanh(math.atanh(min(z / zmax, 1.0 - 1e-15)) + left / zmax) if left else z)
    return found


Law = Callable[[Array, Array], Array]  # of the way and its rate, at pieces of samples


def dragged(d: Array, gap: float, reach: float) -> Array:
    """Return the force over friction of a slider that a pin drags with play, from rest in the middle, by its motion.

    The pin is free within half a gap on both sides of the slider; beyond, the force builds up over a reach, and the
    slider is then taken along.
    """
    force, slider = np.empty(len(d)), 0.0
    for n, at in enumerate(d.tolist()):
        slider = min(max(slider, at - 0.5 * gap - reach), at + 0.5 * gap + reach)
        beyond = at - slider - min(max(at - slider, -0.5 * gap), 0.5 * gap)
        force[n] = beyond / reach
    return force


def component(hidden: Law, seconds: float, seed: int, k: float = 1010.0, c: float = 19.8) -> dict[str, Array]:
    """Return a record of a damper: time in s, displacement in m, velocity in m/s, force in N."""
    motion = Motion.of(seed, 5e-3)
    t = np.arange(round(seconds * RATE) * PIECES) / (RATE * PIECES)
    d, v = motion.at(t), motion.rate(t)
    force = (k * d + c * v + hidden(d, v))[::PIECES]
    return {"t": t[::PIECES], "d": d[::PIECES], "v": v[::PIECES], "F": noisy(force, seed)}


def motor(fc: float, seconds: float, seed: int) -> dict[str, Array]:
    """Return a record of a motor with Coulomb's friction, which sticks: time in s, current in A, speed in rad/s.

    The current is held from sample to sample, over which J w' = kt i - b w - fc sign(w) is solved in closed form, from
    one change of direction to the next; fc is in N m.
    """
    t = np.arange(round(seconds * RATE)) / RATE
    current = Motion.of(seed, 4.0, 0.1, 10.0).at(t)
    w, speed = 0.7, np.empty(len(t))
    for n, i in enumerate(current):
        speed[n] = w
        w = _turned(w, KT * float(i), fc, 1.0 / RATE)
    return {"t": t, "i": current, "speed": noisy(speed, seed)}


def _turned(w: float, torque: float, fc: float, left: float) -> float:
    """Return the speed after some time under a constant torque."""
    while left > 0.0:
        if w == 0.0 and abs(torque) <= fc:
            return 0.0
        sign = math.copysign(1.0, w if w != 0.0 else torque)
        end = (torque - sign * fc) / B
        then = end + (w - end) * math.exp(-B / J * left)
        if w == 0.0 or then * sign >= 0.0:
            return then
        left -= J / B * math.log((w - end) / -end)
        w = 0.0
    return w


def tank(k3: float, seconds: float, seed: int, area: float = 0.505, r: float = 0.0495) -> dict[str, Array]:
    """Return a record of a tank whose outflow is r h + k3 h^3: time in s, inflow in m^3/s and level in m, at 10 Hz.

    The inflow is held; the method is the classical one of Runge and Kutta with steps of 25 ms, 400 times as fast as the
    tank.
    """
    rate, steps = 10.0, 4
    t = np.arange(round(seconds * rate)) / rate
    inflow = 0.05 + 0.045 * Motion.of(seed, 1.0, 1e-3, 0.3).at(t)
    h, level, dt = 0.8, np.empty(len(t)), 1.0 / (rate * steps)
    for n, q in enumerate(inflow):
        level[n] = h
        for _ in range(steps):

            def slope(h: float, q: float = float(q)) -> float:
                return (q - r * h - k3 * h**3) / area

            a = slope(h)
            second = slope(h + 0.5 * dt * a)
            third = slope(h + 0.5 * dt * second)
            h += dt / 6.0 * (a + 2.0 * second + 2.0 * third + slope(h + dt * third))
    return {"t": t, "q": inflow, "level": noisy(level, seed)}


def noisy(values: Array, seed: int) -> Array:
    """Return values with white noise."""
    noise = np.random.default_rng(1000 + seed).standard_normal(len(values))
    found: Array = values + NOISE * np.sqrt((values**2).mean()) * noise
    return found


def save(record: dict[str, Array], path: str, names: dict[str, str] | None = None) -> None:
    """Write a record as CSV, under other names where these are given."""
    header = ",".join((names or {}).get(name, name) for name in record)
    np.savetxt(path, np.column_stack([*record.values()]), fmt="%.9g", delimiter=",", header=header, comments="")
