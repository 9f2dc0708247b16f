"""Motion of a batch of rigs with hidden effects: Runge and Kutta's method of order 4 at a fixed step, in numpy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tests.benchmarks.hidden.laws import COMMANDS, ELEMENT_LAWS, INERTIA, LAST, READINGS, ElementLaw, Motion, rounded
from tests.benchmarks.hidden.rig import (
    ACTUATORS,
    ALL_ACTUATORS,
    PLACES,
    RATE,
    SENSOR_GAIN,
    SENSORS,
    Array,
    Rigs,
)

SUBSTEPS = 4  # per sample of 1 ms
HEAVY = ("x1", "x2", "beam")  # what a mass may be added to


@dataclass(frozen=True)
class Hidden:
    """One hidden effect: its name, its place, and the values of its parameters in SI units."""

    effect: str
    at: str
    parameters: Mapping[str, float] = field(default_factory=dict)


@dataclass
class Group:
    """All effects of one law in a batch: where they read and push, and where their states are in the whole state."""

    law: ElementLaw
    at: NDArray[np.intp]  # place * batch + record
    values: tuple[Array, ...]
    states: slice

    def add(self, t: float, wide: tuple[Array, Array], state: Array, forces: Array, rates: Array) -> None:
        """Add the forces at time t to `forces` (places * batch,), and write the rates of the internal states.

        `wide` are the displacements of all places and their rates, both (places * batch,).
        """
        d, v = wide
        z = state[self.states].reshape(self.law.states, len(self.at))
        motion = Motion(d.take(self.at), v.take(self.at), z, t)
        forces[self.at] += self.law.force(motion, self.values)
        if self.law.rates is not None:
            rates[self.states] = self.law.rates(motion, self.values).ravel()


@dataclass
class SensorLags:
    """All sensors of a batch that follow with a lag: m' = (s - m) / tau, with s in m (the gain comes after)."""

    at: NDArray[np.intp]  # sensor * batch + record
    tau: Array
    states: slice

    def add(self, d: Array, state: Array, rates: Array) -> None:
        """Write the rates of the filtered values."""
        rates[self.states] = (d[self.at] - state[self.states]) / self.tau


class Batch:
    """A batch of rigs, each with its list of hidden effects, ready to be integrated."""

    def __init__(self, rigs: Rigs, effects: Sequence[Sequence[Hidden]]) -> None:
        self.rigs, self.effects, self.size = rigs, effects, len(effects)
        self.groups: list[Group] = []
        self.lags: SensorLags | None = None
        self.states = 6 * self.size
        self._stiffness, self._damping = rigs.stiffness.ravel(), rigs.damping.ravel()
        self._passed, self._ratio = rigs.passed_on, rigs["mu1"] / rigs["mu2"]
        self.masses = np.ones((3, self.size))  # of oscillators and beam, by those without what is added
        collected: dict[str, list[tuple[int, Hidden]]] = {}
        for row, hidden in enumerate(effects):
            seen: set[tuple[str, str]] = set()
            for one in hidden:
                if (one.effect, one.at) in seen:
                    raise ValueError(f"{one.effect} at {one.at} twice in one record")
                seen.add((one.effect, one.at))
                collected.setdefault(one.effect, []).append((row, one))
        for name, members in collected.items():
            if name in ELEMENT_LAWS:
                self._collect(ELEMENT_LAWS[name], members)
            elif name == INERTIA:
                for row, one in members:
                    self.masses[HEAVY.index(one.at), row] += one.parameters["m"]
            elif name == "sensor_lag":
                at = np.array([SENSORS.index(one.at) * self.size + row for row, one in members])
                tau = np.array([one.parameters["tau"] for _, one in members])
                self.lags = SensorLags(at, tau, slice(self.states, self.states + len(at)))
                self.states += len(at)
            elif name not in (*COMMANDS, *READINGS, LAST, "actuator_lag", "delay"):
                raise ValueError(f"no law of {name}")
        self.heavy = bool((self.masses != 1.0).any())
        self.wide = any(int(group.at.max()) >= 3 * self.size for group in self.groups)

    def _collect(self, law: ElementLaw, members: Sequence[tuple[int, Hidden]]) -> None:
        at = np.array([PLACES.index(one.at) * self.size + row for row, one in members])
        values = tuple(np.array([one.parameters[name] for _, one in members]) for name in law.parameters)
        states = slice(self.states, self.states + law.states * len(at))
        self.groups.append(Group(law, at, values, states))
        self.states = states.stop

    def rates(self, t: float, state: Array, push: Array, out: Array) -> None:
        """Write the rates of the whole state (states,) at time t into `out`.

        `push` (3, batch) is what the actuators add to d1'', d2'' and x3''. A force F at spring i adds -F to x_i'' and
        mu_i F to x3''; at beam, -F to x3''; at x1 or x2, -F to that; at x1-x2, -F to x1'' and mu1/mu2 F to x2''. More
        mass than declared gets as much force, and less acceleration.
        """
        n = self.size
        d, v = state[: 3 * n], state[3 * n : 6 * n]
        forces = np.empty((len(PLACES) if self.wide else 3) * n)
        np.multiply(self._stiffness, d, out=forces[: 3 * n])
        forces[: 3 * n] += self._damping * v
        if self.wide:
            forces[3 * n :] = 0.0
        wide = (self._wide(d), self._wide(v)) if self.wide else (d, v)
        for group in self.groups:
            group.add(t, wide, state, forces, out)
        if self.lags is not None:
            self.lags.add(d, state, out)
        f = forces.reshape(-1, n)
        if self.wide:
            f[0] += f[5]
            f[1] -= self._ratio * f[5]
        beam = (self._passed * f[:3]).sum(axis=0)
        out[: 3 * n] = v
        acceleration = out[3 * n : 6 * n].reshape(3, n)
        acceleration[:2] = -f[:2] - beam
        acceleration[2] = beam
        if self.wide:
            acceleration[:2] -= f[3:5]
        acceleration += push
        if self.heavy:
            acceleration[:2] += acceleration[2]
            acceleration /= self.masses
            acceleration[:2] -= acceleration[2]

    def _wide(self, x: Array) -> Array:
        rows = x.reshape(3, self.size)
        return np.concatenate((x, rows[0] + rows[2], rows[1] + rows[2], rows[0] - rows[1]))

    def rest(self, push: Array) -> Array:
        """Return the whole state in which the rigs rest under what the actuators add (3, batch), by Newton's method.

        Internal states are 0, but filtered values have followed; forces of time alone are off before the record.
        """
        n, small = self.size, 1e-7
        state, out, moved = np.zeros(self.states), np.empty(self.states), np.empty(self.states)
        timeless = [g for g in self.groups if g.law is not ELEMENT_LAWS["periodic_force"]]
        timed, self.groups = self.groups, timeless
        for _ in range(20):
            self.rates(0.0, state, push, out)
            left = out[3 * n : 6 * n].reshape(3, n).copy()
            if np.abs(left).max() < 1e-14:
                break
            slopes = np.empty((n, 3, 3))
            for i in range(3):
                shifted = state.copy()
                shifted[i * n : (i + 1) * n] += small
                self.rates(0.0, shifted, push, moved)
                slopes[:, :, i] = (moved[3 * n : 6 * n].reshape(3, n) - left).T / small
            state[: 3 * n] -= np.linalg.solve(slopes, left.T[:, :, None])[:, :, 0].T.ravel()
        self.groups = timed
        if self.lags is not None:
            state[self.lags.states] = state[self.lags.at]
        return state

    def motion(self, commands: Array, noise: Array | None = None, *, substeps: int = SUBSTEPS) -> Array:
        """Return what the sensors see (samples, 3, batch) in m at each sample, from rest at zero commands.

        `commands` (samples, 3, batch) are in V; `noise`, of the same shape, is added to what the actuators give.
        """
        inputs = Inputs(self, commands, noise, substeps)
        h, n = 1.0 / (RATE * substeps), self.size
        state = self.rest(self.rigs.acceleration(inputs.still))
        seen = np.empty((len(commands), 3, n))
        k1, k2, k3, k4, trial = (np.empty(self.states) for _ in range(5))
        for k in range(len(commands)):
            seen[k] = state[: 3 * n].reshape(3, n)
            if self.lags is not None:
                seen[k].reshape(-1)[self.lags.at] = state[self.lags.states]
            for j in range(substeps):
                t = k / RATE + j * h
                first, middle, last = inputs.at(k, j)
                self.rates(t, state, first, k1)
                np.multiply(k1, h / 2.0, out=trial)
                trial += state
                self.rates(t + h / 2.0, trial, middle, k2)
                np.multiply(k2, h / 2.0, out=trial)
                trial += state
                self.rates(t + h / 2.0, trial, middle, k3)
                np.multiply(k3, h, out=trial)
                trial += state
                self.rates(t + h, trial, last, k4)
                k2 += k3
                k2 *= 2.0
                k1 += k2
                k1 += k4
                k1 *= h / 6.0
                state = state + k1
        return seen

    def readings(self, seen: Array) -> Array:
        """Return what sensors give (samples, 3, batch) in V for what they see, in m: no noise, not yet quantised."""
        readings = SENSOR_GAIN * seen
        for row, hidden in enumerate(self.effects):
            for one in hidden:
                if one.effect in READINGS:
                    name, change = READINGS[one.effect]
                    i = SENSORS.index(one.at)
                    readings[:, i, row] = change(readings[:, i, row], one.parameters[name])
        return readings

    def quantised(self, readings: Array) -> Array:
        """Return readings (samples, 3, batch) in V, changed in place, as converters give them: the last effect."""
        for row, hidden in enumerate(self.effects):
            for one in hidden:
                if one.effect == LAST:
                    i = SENSORS.index(one.at)
                    readings[:, i, row] = rounded(readings[:, i, row], one.parameters["step"])
        return readings


class Inputs:
    """What the actuators add to d1'', d2'' and x3'', at the start, middle and end of each substep.

    A delay is exact for a multiple of a substep and otherwise right in the mean over the substep. A lag is exact: with
    a command u held over a sample, a(t) = u + (a(0) - u) exp(-t / tau).
    """

    def __init__(self, batch: Batch, commands: Array, noise: Array | None, substeps: int) -> None:
        acting = commands.copy()
        n, samples = batch.size, len(commands)
        self.still = np.zeros((3, n))  # what the actuators give while they are told nothing
        shaped: dict[int, tuple[Array, Array]] = {}  # row: extra (samples, 3) in V, weight (substeps, 3 stages)
        for row, hidden in enumerate(batch.effects):
            for one in hidden:
                if one.effect in COMMANDS:
                    name, change = COMMANDS[one.effect]
                    i = ACTUATORS.index(one.at)
                    acting[:, i, row] = change(acting[:, i, row], one.parameters[name])
                    self.still[i, row] = change(self.still[i, row], one.parameters[name])
            for one in hidden:
                if one.effect in ("actuator_lag", "delay"):
                    if row in shaped:
                        raise ValueError(f"record {row} has more than one of lag and delay")
                    shape = _lagged if one.effect == "actuator_lag" else _delayed
                    shaped[row] = shape(one, acting[:, :, row], self.still[:, row], substeps)
        if noise is not None:
            acting += noise
        self.held = batch.rigs.acceleration(acting)
        self.rows = np.array(sorted(shaped), dtype=np.intp)
        if shaped:
            extra = np.stack([shaped[row][0] for row in self.rows], axis=-1)
            self.extra = Rigs(batch.rigs.values[self.rows]).acceleration(extra)
            self.weights = np.stack([shaped[row][1] for row in self.rows], axis=-1)
        assert self.held.shape == (samples, 3, n)

    def at(self, k: int, j: int) -> tuple[Array, Array, Array]:
        """Return the inputs (3, batch) in sample k at the start, the middle and the end of its substep j."""
        held = self.held[k]
        if not len(self.rows):
            return held, held, held
        first, middle, last = held.copy(), held.copy(), held.copy()
        for stage, push in enumerate((first, middle, last)):
            push[:, self.rows] += self.weights[j, stage] * self.extra[k]
        return first, middle, last


def _lagged(one: Hidden, u: Array, still: Array, substeps: int) -> tuple[Array, Array]:
    """Return the part of a lagging actuator's action that fades during each sample, and how much is left of it."""
    i, tau = ACTUATORS.index(one.at), one.parameters["tau"]
    left = np.exp(-1.0 / (RATE * tau))
    behind = np.empty(len(u))
    a = still[i]
    for k, told in enumerate(u[:, i].tolist()):
        behind[k] = a - told
        a = told + behind[k] * left
    extra = np.zeros((len(u), 3))
    extra[:, i] = behind
    t = (np.arange(substeps)[:, None] + np.array([0.0, 0.5, 1.0])) / (RATE * substeps)
    return extra, np.exp(-t / tau)


def _delayed(one: Hidden, u: Array, still: Array, substeps: int) -> tuple[Array, Array]:
    """Shift the commands by whole samples, in place, and return the step back to the sample before, and its weight."""
    if one.at != ALL_ACTUATORS:
        raise ValueError(f"a delay is at {ALL_ACTUATORS}, not at {one.at}")
    whole, part = divmod(one.parameters["seconds"] * RATE, 1.0)
    late = np.vstack((np.tile(still, (int(whole) + 1, 1)), u))[: len(u) + 1]
    u[:] = late[1:]
    weight = np.clip(part * substeps - np.arange(substeps), 0.0, 1.0)
    return late[:-1] - late[1:], np.repeat(weight[:, None], 3, axis=1)
