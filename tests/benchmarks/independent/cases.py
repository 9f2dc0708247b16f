"""Random machines with one hidden effect each, and the model that an engineer would write of them.

Laws are written from their texts: Coulomb's friction is set-valued, play stands in series with a spring,
a stop is that of Hunt and Crossley, relaxation is a spring behind a dashpot, and one actuator may be late.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import signal

from tests.benchmarks.independent.machine import Array, Contact, Element, Machine, simulated
from tests.benchmarks.laws import records

PIECES = 4
Key = tuple[str, str]

FRICTION = ("dry_friction", "stribeck_friction", "asymmetric_friction", "dahl_friction", "lugre_friction")
LIKE: dict[str, tuple[str, ...]] = {  # names of one class
    "dry_friction": FRICTION,
    "stribeck_friction": FRICTION,
    "play": ("play", "backlash"),
    "play_with_friction": ("play_with_friction", *FRICTION),
    "stop": ("stop", "bilinear_spring"),
    "bilinear_spring": ("bilinear_spring", "stop"),
    "relaxation": ("relaxation", "maxwell_element"),
    "maxwell_element": ("maxwell_element", "relaxation"),
    "delay": ("delay", "actuator_delay", "actuator_lag"),
    "hardening_spring": ("hardening_spring", "polynomial_spring"),
    "quadratic_damping": ("quadratic_damping",),
    "asymmetric_damping": ("asymmetric_damping",),
}
EFFECTS = tuple(LIKE)
NOTHING = "nothing"
# Laws that the dictionary has not; those that are left out have poles.
OUTSIDE = tuple(name for name in records.LAWS if name not in (*records.NAMES, "tangent", "magnet"))
HIDDEN = (*EFFECTS, NOTHING, *OUTSIDE)


@dataclass(frozen=True)
class Quality:
    """How well a rig is known, driven and read; all but the converter and the delay are standard deviations.

    Args:
        off: of its parameters about what the model declares, relative.
        noise: of the readings, in parts of their rms.
        gain: of the gain of each sensor, relative.
        offset: of the zero of each sensor and actuator, in parts of its rms.
        bits: of the converter that reads the range of each sensor; none if 0.
        late: least and largest steps of integration by which all inputs act later than the model says.
    """

    off: float = 0.01
    noise: float = 1e-3
    gain: float = 0.0
    offset: float = 0.0
    bits: int = 0
    late: tuple[int, int] = (0, 0)


GOOD = Quality()
REAL = Quality(off=0.03, noise=3e-3, gain=0.01, offset=0.01, bits=16, late=(PIECES // 2, PIECES))
# Beside the effect that is sought, these are in a real rig, or do the same where it is linear or slow.
IMPERFECT = (
    *("sensor_offset", "actuator_offset", "constant_force", "sensor_gain", "actuator_gain"),
    *("delay", "actuator_lag", "sensor_lag", "sensor_delay"),
)


@dataclass(frozen=True)
class Case:
    """One machine.

    Args:
        seed: of all that is random.
        effect: its name.
        quality: of the rig.
        rate: samples per second.
        seconds: length of the record.
    """

    seed: int
    effect: str
    quality: Quality = GOOD
    rate: float = 500.0
    seconds: float = 20.0

    @property
    def times(self) -> Array:
        """Return the times of the samples (m,)."""
        return np.arange(round(self.rate * self.seconds)) / self.rate

    @cached_property
    def random(self) -> np.random.Generator:
        """Return its random numbers."""
        return np.random.default_rng([self.seed, HIDDEN.index(self.effect)])

    @cached_property
    def rig(self) -> Rig:
        """Return the machine as it is declared, and as it is."""
        return Rig.drawn(self.random, self.quality.off)

    @cached_property
    def told(self) -> tuple[Array, Array]:
        """Return inputs (m, n) and the readings of each coordinate (m, n), in the unit of the record."""
        rig, rng, quality = self.rig, self.random, self.quality
        u = rig.excitation(rng, self.times)
        machine, late = self._machine(u)
        flaws = np.random.default_rng([self.seed, HIDDEN.index(self.effect), 1])
        shift = float(flaws.integers(*quality.late, endpoint=True)) / (self.rate * PIECES)
        pushed = u + quality.offset * u.std(axis=0) * flaws.standard_normal(rig.size)
        late = [shift + own for own in late]
        motion = simulated(machine, pushed, self.rate, start=np.zeros(rig.size), late=late, pieces=PIECES)
        x = motion.displacement
        size = x.std(axis=0)
        x = x * (1.0 + quality.gain * flaws.standard_normal(rig.size))
        x = x + quality.offset * size * flaws.standard_normal(rig.size)
        x = x + quality.noise * size * rng.standard_normal(x.shape)
        if quality.bits:
            step = 2.0 * np.abs(x).max(axis=0) / 2**quality.bits
            x = step * np.round(x / step)
        return u, rig.scale * x

    @cached_property
    def at(self) -> int:
        """Return the number of the element or input where it sits."""
        return int(self.random.integers(self.rig.size))

    @property
    def truth(self) -> Key:
        """Return effect and place."""
        return self.effect, f"u{self.at + 1}" if self.effect == "delay" else f"spring{self.at + 1}"

    def _machine(self, u: Array) -> tuple[Machine, list[float]]:
        rig, rng, i = self.rig, self.random, self.at
        k, c, row = rig.stiffness[i], rig.damping[i], rig.rows[i]
        d = rig.linear(u, self.rate) @ row
        v = np.gradient(d) * self.rate
        size, speed, reach = float(d.std()), float(v.std()), (float(-d.min()), float(d.max()))
        force = float((k * d + c * v).std())
        elements = [rig.element(j) for j in range(rig.size)]
        contacts, late = list[Contact](), [0.0] * rig.size
        own = Drawn(row, k, c, size, speed, reach, rng)
        if self.effect in LAWS:
            elements[i] = LAWS[self.effect](own)
        elif self.effect in OUTSIDE:
            elements[i] = nameless(self.effect, own)
        elif self.effect == "delay":
            late[i] = float(rng.integers(2, 9)) / (self.rate * PIECES) * 2.0
        elif self.effect != NOTHING:
            sliding = float(rng.uniform(0.05, 0.5)) * force
            more, fall = (
                (float(rng.uniform(0.5, 1.5)), 0.2 * speed) if self.effect == "stribeck_friction" else (0.0, 1.0)
            )

            def level(_: float, rate: float) -> float:
                return sliding * (1.0 + more * float(np.exp(-((rate / fall) ** 2))))

            contacts.append(Contact(row, level, sliding * (1.0 + more)))
        return Machine(rig.masses, elements, np.eye(rig.size), contacts), late


@dataclass(frozen=True)
class Drawn:
    """What the law of an element is drawn for: the element, and its motion while it is linear.

    Args:
        row, k, c: of the element: its displacement by the coordinates (n,), stiffness and damping.
        size, speed: rms of its displacement and rate.
        reach: how far it moves to the negative and to the positive side.
        random: numbers.
    """

    row: Array
    k: float
    c: float
    size: float
    speed: float
    reach: tuple[float, float]
    random: np.random.Generator


def _beyond(x: float, half: float) -> float:
    return x - min(max(x, -half), half)


def _play(e: Drawn) -> Element:
    half = 0.5 * float(e.random.uniform(0.2, 1.0)) * e.size
    return Element(
        e.row, lambda d, v, z, t: e.k * _beyond(d, half) + (e.c * v if abs(d) > half else 0.0), edges=(-half, half)
    )


def _dragged(e: Drawn) -> Element:
    half, level = 0.5 * float(e.random.uniform(0.2, 1.0)) * e.size, float(e.random.uniform(0.1, 0.4)) * e.k * e.size
    yielding = 2e-3 * e.size  # the pin bends by so much before the slider moves

    def force(d: float, v: float, z: float, t: float) -> float:
        return e.k * d + e.c * v + level / yielding * _beyond(d - z, half)

    def moved(d: float, z: float) -> float:
        return min(max(z, d - half - yielding), d + half + yielding)

    return Element(e.row, force, moved=moved)


def _stop(e: Drawn) -> Element:
    part, side = float(e.random.uniform(0.4, 0.8)), float(e.random.choice([-1.0, 1.0]))
    edge = part * e.reach[side > 0.0]
    stiff, loss = float(e.random.uniform(3.0, 20.0)) * e.k, float(e.random.uniform(0.1, 1.0)) / e.speed

    def force(d: float, v: float, z: float, t: float) -> float:
        contact = stiff * max(side * d - edge, 0.0) * max(1.0 + loss * side * v, 0.0)
        return e.k * d + e.c * v + side * contact

    return Element(e.row, force, edges=(side * edge,))


def _bilinear(e: Drawn) -> Element:
    more = float(e.random.uniform(0.1, 0.5)) * e.k
    return Element(e.row, lambda d, v, z, t: e.k * d + e.c * v + more * max(d, 0.0), edges=(0.0,))


def _relaxing(e: Drawn) -> Element:
    k, tau = float(e.random.uniform(0.1, 0.5)) * e.k, float(e.random.uniform(0.3, 3.0)) * e.size / e.speed
    return Element(e.row, lambda d, v, z, t: e.k * d + e.c * v + k * z, rate=lambda d, v, z, t: v - z / tau)


def _maxwell(e: Drawn) -> Element:
    k, tau = float(e.random.uniform(0.8, 1.5)) * e.k, float(e.random.uniform(1.0, 5.0)) * e.size / e.speed
    return Element(e.row, lambda d, v, z, t: k * z, rate=lambda d, v, z, t: v - z / tau)


def _cubic(e: Drawn) -> Element:
    more = float(e.random.uniform(0.05, 0.3)) * e.k / e.size**2
    return Element(e.row, lambda d, v, z, t: e.k * d + e.c * v + more * d**3)


def _drag(e: Drawn) -> Element:
    more = float(e.random.uniform(0.05, 0.3)) * e.k * e.size / e.speed**2
    return Element(e.row, lambda d, v, z, t: e.k * d + e.c * v + more * v * abs(v))


def _rebound(e: Drawn) -> Element:
    more = float(e.random.uniform(0.05, 0.3)) * e.k * e.size / e.speed
    return Element(e.row, lambda d, v, z, t: e.k * d + e.c * v + more * max(v, 0.0))


def nameless(kind: str, e: Drawn) -> Element:
    """Return an element with a law that the dictionary has not."""
    law, strength = records.LAWS[kind], e.k * e.size * float(e.random.uniform(0.5, 1.5))
    return Element(e.row, lambda d, v, z, t: e.k * d + e.c * v + strength * law(d / e.size, v / e.speed))


LAWS: Mapping[str, Callable[[Drawn], Element]] = {
    "play": _play,
    "play_with_friction": _dragged,
    "stop": _stop,
    "bilinear_spring": _bilinear,
    "relaxation": _relaxing,
    "maxwell_element": _maxwell,
    "hardening_spring": _cubic,
    "quadratic_damping": _drag,
    "asymmetric_damping": _rebound,
}


@dataclass(frozen=True)
class Rig:
    """One or two masses in a row, the last one held from the ground; each is pushed and measured.

    Args:
        masses, stiffness, damping: as they are (n,).
        declared: the same as the model has them (3, n).
        scale: units of the record per metre.
        unit: how the model calls them; plain numbers where it is '1'.
    """

    masses: Array
    stiffness: Array
    damping: Array
    declared: Array
    scale: float
    unit: str

    @classmethod
    def drawn(cls, rng: np.random.Generator, off: float) -> Rig:
        """Return a random machine, with the standard deviation of its parameters about what the model declares."""
        n = int(rng.integers(1, 3))
        w = 2.0 * np.pi * rng.uniform(1.0, 5.0, n)
        m = rng.uniform(0.5, 5.0, n)
        k, c = m * w**2, 2.0 * rng.uniform(0.02, 0.15, n) * m * w
        scale, unit = ((1.0, "m"), (1e3, "1"), (1.0, "1"))[int(rng.integers(3))]
        known = np.array([m, k, c])
        m, k, c = known * (1.0 + off * rng.standard_normal(known.shape))
        return cls(m, k, c, known, scale, unit)

    @property
    def size(self) -> int:
        """Return the number of masses."""
        return len(self.masses)

    @property
    def rows(self) -> Array:
        """Return the displacement of each spring by the coordinates (n, n)."""
        found = np.eye(self.size)
        for i in range(self.size - 1):
            found[i, i + 1] = -1.0
        return found

    def element(self, i: int) -> Element:
        """Return a spring with its damper."""
        k, c = float(self.stiffness[i]), float(self.damping[i])
        return Element(self.rows[i], lambda d, v, z, t: k * d + c * v)

    def excitation(self, rng: np.random.Generator, t: Array) -> Array:
        """Return multisines (m, n) around the resonances, with displacements of some millimetres."""
        seconds = len(t) * t[1]
        w = np.sqrt(self.declared[1] / self.declared[0]) / (2.0 * np.pi)
        lines = np.arange(max(1, int(0.2 * w.min() * seconds)), int(2.5 * w.max() * seconds))
        u = np.empty((len(t), self.size))
        for i in range(self.size):
            own = lines[i :: self.size]
            phases = rng.uniform(0.0, 2.0 * np.pi, len(own))
            wave = np.cos(2.0 * np.pi * np.outer(t, own) / seconds + phases).sum(axis=1)
            u[:, i] = wave / wave.std()
        u *= 3e-3 * self.declared[1].max() * 0.5
        return np.asarray(u)

    def linear(self, u: Array, rate: float) -> Array:
        """Return the coordinates (m, n) without any effect."""
        n, rows = self.size, self.rows
        inverse = np.diag(1.0 / self.masses)
        stiffness, damping = (rows.T @ np.diag(x) @ rows for x in (self.stiffness, self.damping))
        a = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]])
        b = np.vstack([np.zeros((n, n)), inverse])
        system = signal.cont2discrete((a, b, np.eye(n, 2 * n), np.zeros((n, n))), 1.0 / rate)
        return np.asarray(signal.dlsim((*system[:4], 1.0 / rate), u)[1])

    def model(self, pushed: Sequence[int] | None = None) -> str:
        """Return the model file that an engineer would write; inputs are forces in the unit of the record.

        Args:
            pushed: numbers of the masses that are pushed; by default all.
        """
        pushed = range(self.size) if pushed is None else pushed
        plain = self.unit == "1"
        units = ("1", "1", "1", "1") if plain else ("kg", "N/m", "N*s/m", "N")
        lines = ["name: machine", "coordinates:"]
        lines += [f"  x{i + 1}: {{unit: {self.unit!r}}}" for i in range(self.size)]
        if pushed:
            lines += ["inputs:", *(f"  u{i + 1}: {{unit: {units[3]!r}}}" for i in pushed)]
        lines += ["parameters:"]
        for name, values, unit in zip("mkc", self.declared, units, strict=False):
            lines += [
                f"  {name}{i + 1}: {{value: {value!r}, unit: {unit!r}}}" for i, value in enumerate(values.tolist())
            ]
        lines += ["equations:"]
        lines += [f"  \"m{i + 1}*x{i + 1}''\": {f'u{i + 1}' if i in pushed else 0}" for i in range(self.size)]
        lines += ["elements:"]
        for i, row in enumerate(self.rows):
            other = [f"x{j + 1}" for j in range(self.size) if row[j] < 0.0]
            moved, acts = " - ".join([f"x{i + 1}", *other]), ", ".join([f"x{i + 1}: -1", *(f"{x}: 1" for x in other)])
            law = f"k{i + 1}*d + c{i + 1}*d_rate"
            lines.append(
                f"  spring{i + 1}: {{displacement: {moved}, unit: {units[3]!r}, force: {law}, acts: {{{acts}}}}}"
            )
        return "\n".join(lines) + "\n"

    def columns(self, t: Array, u: Array, x: Array) -> dict[str, Array]:
        """Return the record, by columns."""
        found = {"t": t}
        found |= {f"u{i + 1}": self.scale * u[:, i] for i in range(self.size)}
        return found | {f"x{i + 1}": x[:, i] for i in range(self.size)}
