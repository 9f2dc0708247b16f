"""Machines of masses, elements and set-valued friction, integrated from event to event.

Steps are those of the classical Runge-Kutta method. A step in which a sliding contact would turn round ends where its
rate is 0, which bisection finds; there it sticks where the force that holds it is within its limit, or slides on. One
in which an element passes an edge of its law ends just beyond that edge.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Force = Callable[[float, float, float, float], float]  # (displacement, rate, state, time) -> force

PIECES = 4  # steps of integration in a sample at least
HALVINGS = 50
NEAR = 1e-12  # of an edge, within which a law is that of one side


@dataclass(frozen=True)
class Element:
    """What resists a displacement: a force, with a state of its own where it remembers.

    Args:
        row: displacement by the coordinates (n,).
        force: of displacement, rate, state and time.
        rate: of the state, by the same.
        moved: the state once the displacement has changed, for what does not depend on time: (displacement, state).
        edges: displacements at which the law has a kink or a jump, in rising order.
    """

    row: Array
    force: Force
    rate: Force | None = None
    moved: Callable[[float, float], float] | None = None
    edges: Sequence[float] = ()


@dataclass(frozen=True)
class Contact:
    """Set-valued friction: `level` (displacement, rate) is the force while it slides, and `static` what it can hold."""

    row: Array
    level: Callable[[float, float], float]
    static: float


@dataclass(frozen=True)
class Machine:
    """Masses (n,), elements, contacts, and how the inputs push (n, a)."""

    masses: Array
    elements: Sequence[Element]
    push: Array
    contacts: Sequence[Contact] = field(default=())


@dataclass(frozen=True)
class Motion:
    """What happened at each sample: coordinates (m, n), their rates (m, n), and how many contacts stuck (m,)."""

    displacement: Array
    rate: Array
    stuck: Array


class _Moving:
    """A machine on its way."""

    def __init__(self, machine: Machine, start: Array, rate: Array) -> None:
        self.machine, self.n = machine, len(machine.masses)
        self.y = np.concatenate([start, rate, np.zeros(len(machine.elements))])
        self.modes = [int(np.sign(c.row @ rate)) for c in machine.contacts]  # 0: it sticks
        self.inertia = 1.0 / machine.masses
        self.rows = np.array([c.row for c in machine.contacts]).reshape(-1, self.n)
        self.sides = self.passed(self.y)

    def passed(self, y: Array) -> list[int]:
        """Return how many of its edges each element is beyond."""
        return [sum(float(e.row @ y[: self.n]) > edge for edge in e.edges) for e in self.machine.elements]

    def within(self, i: int, d: float) -> float:
        """Return a displacement of an element between the edges that a step begins between."""
        edges = (-1e300, *self.machine.elements[i].edges, 1e300)
        low, high = edges[self.sides[i]], edges[self.sides[i] + 1]
        return min(max(d, low + NEAR * abs(low)), high - NEAR * abs(high))

    def rates(self, t: float, y: Array, u: Array) -> tuple[Array, Array]:
        """Return the rates of the state, and the forces that hold the contacts which stick."""
        n, machine = self.n, self.machine
        q, v, z, dz = y[:n], y[n : 2 * n], y[2 * n :], np.zeros(len(machine.elements))
        total = machine.push @ u
        for i, element in enumerate(machine.elements):
            d, d_rate = float(element.row @ q), float(element.row @ v)
            d = self.within(i, d) if element.edges else d
            inner = float(z[i]) if element.moved is None else element.moved(d, float(z[i]))
            total = total - element.row * element.force(d, d_rate, inner, t)
            if element.rate is not None:
                dz[i] = element.rate(d, d_rate, inner, t)
        for contact, mode in zip(machine.contacts, self.modes, strict=True):
            if mode:
                total = total - contact.row * mode * contact.level(float(contact.row @ q), float(contact.row @ v))
        held = np.zeros(len(self.modes))
        stuck = [i for i, mode in enumerate(self.modes) if mode == 0]
        if stuck:
            rows = self.rows[stuck]
            held[stuck] = np.linalg.solve(rows * self.inertia @ rows.T, rows @ (self.inertia * total))
            total = total - held @ self.rows
        return np.concatenate([v, self.inertia * total, dz]), held

    def stepped(self, t: float, h: float, u: Array) -> Array:
        """Return the state after a step with the contacts as they are."""
        y = self.y
        k1, _ = self.rates(t, y, u)
        k2, _ = self.rates(t + h / 2.0, y + h / 2.0 * k1, u)
        k3, _ = self.rates(t + h / 2.0, y + h / 2.0 * k2, u)
        k4, _ = self.rates(t + h, y + h * k3, u)
        return np.asarray(y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4))

    def turned(self, y: Array) -> list[int]:
        """Return the contacts that would slide back in a state."""
        rates = self.rows @ y[self.n : 2 * self.n]
        return [i for i, mode in enumerate(self.modes) if mode * rates[i] < 0.0]

    def settle(self, t: float, u: Array) -> None:
        """Let go what is held by more than its limit, in the direction of the force."""
        for _ in self.modes:
            _, held = self.rates(t, self.y, u)
            over = [abs(force) - c.static for force, c in zip(held, self.machine.contacts, strict=True)]
            worst = int(np.argmax(over))
            if over[worst] <= 0.0:
                return
            self.modes[worst] = int(np.sign(held[worst]))

    def advance(self, t: float, length: float, u: Array) -> None:
        """Go on for a time in which the inputs are constant."""
        if self.machine.contacts:
            self.settle(t, u)
        while length > 0.0:
            tried = self.stepped(t, length, u)
            back = self.turned(tried)
            if not back and self.passed(tried) == self.sides:
                self.take(tried)
                if self.machine.contacts:
                    self.settle(t + length, u)
                return
            low, high = 0.0, length
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                there = self.stepped(t, middle, u)
                if self.turned(there) or self.passed(there) != self.sides:
                    high, tried = middle, there
                else:
                    low = middle
            back = self.turned(tried)
            if not back:
                self.take(tried)
                self.sides, t, length = self.passed(tried), t + high, length - high
                continue
            self.take(self.stepped(t, low, u))
            rates = np.abs(self.rows @ self.y[self.n : 2 * self.n])
            for i in back:
                self.stop(i, rates)
            t, length = t + low, length - low
            self.settle(t, u)
            if low == 0.0 and length > 0.0 and self.turned(self.stepped(t, 1e-3 * length, u)):
                raise ArithmeticError("a contact can neither slide nor stick")

    def stop(self, i: int, rates: Array) -> None:
        """Stop a contact whose rate has come to 0."""
        row = self.rows[i]
        v = self.y[self.n : 2 * self.n]
        if rates[i] == np.abs(self.rows @ v)[i]:
            self.y[self.n : 2 * self.n] = v - self.inertia * row * (row @ v) / (row @ (self.inertia * row))
        self.modes[i] = 0

    def take(self, y: Array) -> None:
        """Take a state, and move what follows the displacement alone."""
        for i, element in enumerate(self.machine.elements):
            if element.moved is not None:
                y[2 * self.n + i] = element.moved(float(element.row @ y[: self.n]), float(y[2 * self.n + i]))
        self.y = y


def simulated(
    machine: Machine, inputs: Array, rate: float, *, start: Array, late: Sequence[float] = (), pieces: int = PIECES
) -> Motion:
    """Return the motion under inputs (m, a) that are held over each sample, from rest at `start` (n,).

    Args:
        machine: the machine.
        inputs: what is commanded.
        rate: samples per second.
        start: coordinates at first.
        late: delay of each input in s, in whole steps of integration.
        pieces: steps of integration in a sample.
    """
    moving, n, step = _Moving(machine, start, np.zeros_like(start)), len(machine.masses), 1.0 / (rate * pieces)
    shifts = [round(seconds / step) for seconds in late] or [0] * inputs.shape[1]
    q, v, stuck = np.empty((len(inputs), n)), np.empty((len(inputs), n)), np.zeros(len(inputs))
    u = np.empty(inputs.shape[1])
    for k in range(len(inputs)):
        q[k], v[k] = moving.y[:n], moving.y[n : 2 * n]
        stuck[k] = sum(mode == 0 for mode in moving.modes)
        for j in range(pieces):
            for a, shift in enumerate(shifts):
                at = k * pieces + j - shift
                u[a] = inputs[at // pieces, a] if at >= 0 else 0.0
            moving.advance((k * pieces + j) * step, step, u)
    return Motion(q, v, stuck)
