"""A controller as a member of a lab would write it in an afternoon, with the rigs and virtual systems typed out."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rig = Callable[[Array, Array, float], tuple[Array, Array]]
Virtual = Callable[[float, Array, Array, float], Array]

FILE = Path(__file__).parents[2] / "examples" / "carts" / "cart_reference.csv"
RATE, SAMPLES, CUTOFF = 500.0, 2, 100.0  # Hz, samples of delay, Hz of the filter of differences


class HandWritten:
    """A controller as a member of a lab would write it in an afternoon.

    Positions from encoders, filtered differences as velocities, a nominal model, a prediction of the state over the
    commands that are under way, feedback linearisation. It has no observer.

    Args:
        rig: free accelerations (n,) and gains (n, inputs) at coordinates, velocities, and a measured force.
        virtual: accelerations (m,) of the first m coordinates, at time, coordinates, velocities, and the same force; it
            is called once in each sample.
        start: where the first m coordinates begin, SI units.
        positions: coordinates (n,) from readings.
        largest: commands (actuators,).
        rest: samples in which offsets are measured.
        homing: samples in which the rig is brought to its start.
        force: index of the reading of a measured force.
    """

    def __init__(
        self,
        *,
        rig: Rig,
        virtual: Virtual,
        start: Array,
        positions: Array,
        largest: Array,
        rest: int,
        homing: int,
        force: int | None,
    ) -> None:
        self.rig, self.virtual, self.start, self.positions, self.largest = rig, virtual, start, positions, largest
        self.rest, self.homing, self.force = rest, homing, force
        self.h, self.index, self.keep = 1.0 / RATE, -rest - homing, np.exp(-2.0 * np.pi * CUTOFF / RATE)
        n, inputs = len(positions), rig(np.zeros(len(positions)), np.zeros(len(positions)), 0.0)[1].shape[1]
        self.last, self.v, self.offset = np.zeros(n), np.zeros(n), np.zeros(n)
        self.sent: deque[Array] = deque([np.zeros(inputs)] * SAMPLES, SAMPLES)
        self.is_first = True

    def __call__(self, readings: Array) -> Array:
        """Return the commands for the readings of a sample."""
        pushed = 0.0 if self.force is None else float(readings[self.force])
        q = self.positions @ readings - self.offset
        if self.is_first:
            self.last, self.is_first = q, False
        self.v = self.keep * self.v + (1.0 - self.keep) * (q - self.last) / self.h
        self.last = q
        if self.index < -self.homing:
            self.offset += q / self.rest
            self.last = np.zeros_like(q) if self.index == -self.homing - 1 else q
            command = np.zeros_like(self.sent[0])
            if self.index == -self.homing - 1:
                self.v[:] = 0.0
        else:
            command = self.command(q, self.v, pushed)
        self.index += 1
        self.sent.append(command)
        return command

    def command(self, q: Array, v: Array, pushed: float) -> Array:
        """Return the commands that give the wanted accelerations when they act."""
        for under_way in self.sent:
            free, gain = self.rig(q, v, pushed)
            a = free + gain @ under_way
            q, v = q + self.h * v + 0.5 * self.h**2 * a, v + self.h * a
        free, gain = self.rig(q, v, pushed)
        m, ahead = len(self.start), self.index + SAMPLES
        wanted = self.virtual(ahead * self.h, q, v, pushed) if self.index >= 0 else self.home(ahead, q[:m], v[:m])
        command = np.linalg.lstsq(gain[:m], wanted - free[:m], rcond=None)[0]
        return np.clip(command, -self.largest, self.largest)

    def home(self, index: int, q: Array, v: Array) -> Array:
        """Return accelerations along a smooth way to the start."""
        end = self.homing * self.h
        s = min(1.0, 1.0 + index / self.homing)
        way, speed = s**3 * (10 - 15 * s + 6 * s * s), 30 * s * s * (1 - s) ** 2 / end
        bend = 60 * s * (1 - s) * (1 - 2 * s) / end**2
        w = 20.0
        return self.start * bend + 2 * w * (self.start * speed - v) + w * w * (self.start * way - q)


def cart(q: Array, v: Array, _: float) -> tuple[Array, Array]:
    """Return the cart, or several."""
    return (-20.0 * q - 0.4 * v) / 0.5, 16.0 * np.eye(len(q))


def cart_pendulum(q: Array, v: Array, pushed: float) -> tuple[Array, Array]:
    """Return cart and pendulum."""
    c, s = np.cos(q[1]), np.sin(q[1])
    mass = np.array([[0.6, 0.02 * c], [0.02 * c, 0.004]])
    force = np.array([pushed - 40 * q[0] - 0.4 * v[0] + 0.02 * v[1] ** 2 * s, -0.981 * 0.2 * s - 0.001 * v[1]])
    return np.linalg.solve(mass, force), np.linalg.solve(mass, [[10.0], [0.0]])


GAINS = np.array([20.9218, 23.2465, 1.2589])
SPRINGS = np.array(
    [
        [
            0.000234722612437,
            0.091796394850297,
            -0.005071505003798,
            0.001755823061963,
            -0.000495321921394,
            0.000455358409592,
        ]
    ]
    * 2
    + [
        [
            -0.003305403062789,
            0.680504615284765,
            0.089803957869115,
            0.203236186622692,
            -0.064473933604213,
            0.017105175330557,
        ]
    ]
)
DAMPING = 2 * np.array([0.3362 * 12.5521, 0.4296 * 14.0337, 0.0409 * 9.7369])
ACTS = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.0411, -0.0578, 1.0]])  # of what acts in a spring


def setup(q: Array, v: Array, _: float) -> tuple[Array, Array]:
    """Return the set-up with measured springs, with volts as commands."""
    stretch, rate = np.array([q[0] - q[2], q[1] - q[2], q[2]]), np.array([v[0] - v[2], v[1] - v[2], v[2]])
    powers = (stretch / 0.005)[:, None] ** np.arange(6)
    force = GAINS * 0.42 * (SPRINGS * powers).sum(axis=1) + DAMPING * rate
    return -ACTS @ force, ACTS @ np.diag(GAINS / [1.078, 1.109, 1.0])


def van_der_pol(_: float, q: Array, v: Array, __: float) -> Array:
    """Return the oscillator of Van der Pol, of which 1 is 5 mm and 0.1 s."""
    x, y = q[0] / 0.005, v[0] / 0.05
    return np.array([0.5 * ((1 - x * x) * y - x)])


def stop(frequency: float = 14.0, damping: float = 0.05, edge: float = 0.002) -> Virtual:
    """Return the mass with a one-sided stop."""
    return lambda t, q, v, _: (
        0.4 * np.cos(frequency * t) - 64 * q[:1] - 16 * damping * v[:1] - 1600 * np.maximum(q[:1] - edge, 0.0)
    )


def bouncing_ball(_: float, q: Array, v: Array, __: float) -> Array:
    """Return the ball with the contact law of Hunt and Crossley, of which 1 is 10 mm and 0.1 s."""
    pressed, speed = np.maximum(-q[:1] / 0.01, 0.0), v[:1] / 0.1
    return np.asarray(200.0 * pressed**1.5 * np.maximum(1.0 - 0.1 * speed, 0.0) - 1.0)


def light_cart(_: float, q: Array, v: Array, pushed: float) -> Array:
    """Return the cart of half the inertia."""
    return (pushed - 40 * q[:1] - 2 * v[:1]) / 0.3


def two_masses(_: float, q: Array, __: Array, ___: float) -> Array:
    """Return two masses with a spring between them."""
    return -100 * q - 9 * (q - q[::-1])


SECOND = 18.3157  # units of time of the set-up's virtual systems in a second


def bouc_wen() -> Virtual:
    """Return the oscillators on hysteretic springs."""
    z, w = np.zeros(2), np.array([1.0, 1.1])

    def slope(t: float, q: Array, v: Array, _: float) -> Array:
        nonlocal z
        x, y = q / 0.005, v / (0.005 * SECOND)
        d, rate = x[:2] - x[2], y[:2] - y[2]
        f = w**2 * (0.6 * d + 0.4 * z)
        z = z + SECOND / RATE * (rate - 3 * abs(rate) * abs(z) ** 0.5 * z - 1.5 * rate * abs(z) ** 1.5)
        beam = 0.05 * f.sum() - 0.64 * x[2] - 0.08 * y[2] + 0.05 * np.sin(0.9 * SECOND * t)
        return 0.005 * SECOND**2 * np.append(-f, beam)

    return slope


def clocks() -> Virtual:
    """Return the clocks with escapements."""
    last, drive, w = np.zeros(2), np.zeros(2), np.array([1.0, 1.02])

    def slope(t: float, q: Array, v: Array, _: float) -> Array:
        nonlocal last
        x, y = q / 0.005, v / (0.005 * SECOND)
        d, rate = x[:2] - x[2], y[:2] - y[2]
        for sign in (1.0, -1.0):
            drive[(sign * last < 0.0) & (sign * d >= 0.0)] = sign * 0.12
            drive[(sign * last < 0.2) & (sign * d >= 0.2)] = 0.0
        last = d
        f = w**2 * d + 0.06 * w * rate - drive
        beam = 0.05 * f.sum() - 0.64 * x[2] - 0.16 * y[2] + 0.15 * np.sin(0.3 * SECOND * t)
        return 0.005 * SECOND**2 * np.append(-f, beam)

    return slope


def delayed() -> Virtual:
    """Return the oscillators with delayed feedback."""
    w, late = np.array([1.0, 1.15]), np.round(np.array([4.0, 3.0]) / SECOND * RATE).astype(int)
    past: list[Array] = []

    def slope(t: float, q: Array, v: Array, _: float) -> Array:
        x, y = q / 0.005, v / (0.005 * SECOND)
        d, rate = x[:2] - x[2], y[:2] - y[2]
        past.append(d)
        then = np.array([past[max(0, len(past) - 1 - n)][i] for i, n in enumerate(late)])
        f = w**2 * d + 0.4 * w * rate - 0.6 * then / (1 + (then / 0.4) ** 4)
        drive = 0.35 * np.sin(SECOND * t)
        return 0.005 * SECOND**2 * np.append(drive - f, 0.05 * f.sum() - 0.64 * x[2] - 0.32 * y[2])

    return slope


def relaxing() -> Virtual:
    """Return the mass on a relaxing spring, which a sine and a force from a file drive."""
    given, f = np.loadtxt(FILE, delimiter=",", skiprows=1), 0.0

    def slope(t: float, q: Array, v: Array, _: float) -> Array:
        nonlocal f
        now = f
        f += (16 * v[0] - f / 0.3) / RATE
        return np.array([0.2 * np.sin(5 * t) + np.interp(t, *given.T) - 36 * q[0] - now])

    return slope
