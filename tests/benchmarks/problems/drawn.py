"""One random problem: chains of one to four masses, or one to three levels, of which one or two laws are not declared.

Nothing of the package is used. Frequencies span 0.1 Hz to 1 kHz, sampling 1.5 Hz to 100 kHz, lengths micrometres to
decimetres, masses grams to hundreds of kilograms, noise 1e-4 to 1e-2 of the readings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tests.benchmarks.independent import cases, machine
from tests.benchmarks.independent.cases import LIKE, Drawn, Rig
from tests.benchmarks.independent.machine import Array, Contact, Machine, Motion

Key = tuple[str, str]

FRICTION = ("dry_friction", "stribeck_friction")
STICKING = (*FRICTION, "play_with_friction")
AT_ELEMENTS = (*cases.LAWS, *FRICTION, *cases.OUTSIDE)
AT_SENSORS = ("sensor_offset", "sensor_saturation", "sensor_magnitude")
AT_ACTUATORS = ("saturation", "dead_zone", "delay", "actuator_offset")
CLASSES: Mapping[str, tuple[str, ...]] = {
    **{name: (name,) for name in (*AT_SENSORS, *AT_ACTUATORS, "overflow")},
    **LIKE,
    "actuator_offset": ("actuator_offset", "constant_force"),
    "square_flow": ("polynomial_spring",),
}
# Steps of integration in a sample. measured: with 4 where a slider sticks, readings err by up to 5 times their noise.
PIECES, WHERE_IT_STICKS = 4, 16
OFF = 0.01  # standard deviation of the parameters about what the model declares


@dataclass(frozen=True)
class Problem:
    """What is given, and what is hidden.

    Args:
        model: model file.
        plant: plant file.
        columns: of the record, by name.
        truth: each hidden law with its places: those that are the same.
        words: what it is.
    """

    model: str
    plant: str
    columns: Mapping[str, Array]
    truth: Sequence[tuple[str, tuple[str, ...]]]
    words: str

    @property
    def has_name(self) -> bool:
        """Return whether the dictionary has all that is hidden."""
        return all(name in CLASSES for name, _ in self.truth)

    def is_right(self, answer: Sequence[Key]) -> bool:
        """Return whether each hidden law is answered by one of its class at its place, and nothing else is."""
        left = [*answer]
        for name, places in self.truth:
            hits = [one for one in left if one[0] in CLASSES.get(name, ()) and one[1] in places]
            if not hits:
                return False
            left.remove(hits[0])
        return not left


def drawn(seed: int) -> Problem:
    """Return the problem of a seed; one whose motion is not finite is drawn again."""
    for attempt in range(20):
        rng = np.random.default_rng([seed, attempt])
        with np.errstate(all="ignore"):
            try:
                made = _process(rng) if rng.random() < 0.15 else _chain(rng)
            except (ArithmeticError, np.linalg.LinAlgError):
                continue
        if all(np.isfinite(column).all() for column in made.columns.values()):
            return made
    raise ArithmeticError(f"no finite motion for seed {seed}")


def _count(rng: np.random.Generator) -> int:
    return int(rng.choice(3, p=[0.05, 0.7, 0.25]))


def _chain(rng: np.random.Generator) -> Problem:
    n, speed = int(rng.integers(1, 5)), 2.0 * np.pi * 10.0 ** rng.uniform(-1.0, 3.0)
    rate = float(f"{rng.uniform(15.0, 60.0) * speed / (2.0 * np.pi) * (1.5 if n > 1 else 1.0):.2g}")
    samples, pushed = int(10.0 ** rng.uniform(3.2, 3.85)), rng.random() < 0.8
    known = _values(rng, n, speed)
    if not pushed:  # it still moves in the end
        known[2] *= np.minimum(1.0, 3.0 * rate / samples / (known[2] / known[0]).max())
    rig = Rig(*(known * (1.0 + OFF * rng.standard_normal(known.shape))), known, 1.0, str(rng.choice(["m", "1"])))
    times, size = np.arange(samples) / rate, 10.0 ** rng.uniform(-6.0, -1.0)
    u, start = np.zeros((samples, n)), np.zeros(n)
    if pushed:
        u = rig.excitation(rng, times)
        u *= size / rig.linear(u, rate).std()
        d = rig.linear(u, rate) @ rig.rows.T
        speeds = (np.gradient(d, axis=0) * rate).std(axis=0)
    else:
        start = 3.0 * size * rng.uniform(-1.0, 1.0, n)
        d = np.outer([1.0, 0.3], rig.rows @ start)
        speeds = d.std(axis=0) * speed
    inputs = sorted(rng.choice(n, int(rng.integers(1, n + 1)), replace=False).tolist()) if pushed else []
    u[:, [i for i in range(n) if i not in inputs]] = 0.0
    read = sorted(rng.choice(n, int(rng.integers(max(1, n - 1), n + 1)), replace=False).tolist())
    hidden = _hidden(rng, n, inputs, read)
    elements, contacts, late, acting = [rig.element(i) for i in range(n)], list[Contact](), [0.0] * n, u.copy()
    for kind, i in hidden:
        if kind in AT_ELEMENTS:
            k, c, size_of, speed_of = (float(x[i]) for x in (rig.stiffness, rig.damping, d.std(axis=0), speeds))
            reach = (float(-d[:, i].min()), float(d[:, i].max())) if pushed else (float(np.abs(d[:, i]).max()),) * 2
            own = Drawn(rig.rows[i], k, c, size_of, speed_of, reach, rng)
            if kind in FRICTION:
                contacts.append(_contact(kind, own))
            else:
                elements[i] = cases.LAWS[kind](own) if kind in cases.LAWS else cases.nameless(kind, own)
        elif kind == "delay":
            late[i] = float(rng.integers(1, 9)) / rate
        elif kind in AT_ACTUATORS:
            acting[:, i] = _acted(kind, u[:, i], rng)
    rigged = Machine(rig.masses, elements, np.eye(n), contacts)
    pieces = WHERE_IT_STICKS if any(kind in STICKING for kind, _ in hidden) else PIECES
    made = machine.simulated(rigged, acting, rate, start=start, late=late, pieces=pieces)
    plant, columns, noise = _readings(rng, rig, made, read, {i: kind for kind, i in hidden if kind in AT_SENSORS})
    columns = {"t": times} | {f"u{i + 1}": u[:, i] for i in inputs} | columns
    words = f"{n} masses, {'forced' if pushed else 'free'}, {samples} samples, noise {noise:.0e}"
    truth = [(kind, _places(kind, i, n, len(inputs))) for kind, i in hidden]
    return Problem(rig.model(inputs), plant, columns, truth, words)


def _places(kind: str, i: int, n: int, inputs: int) -> tuple[str, ...]:
    """Return the places of a law that are the same."""
    if kind in AT_SENSORS:
        return (f"s{i + 1}",)
    if kind in AT_ACTUATORS:
        return (f"u{i + 1}", f"x{i + 1}", *([f"spring{n}"] if i == n - 1 else []), *([""] if inputs == 1 else []))
    return (f"spring{i + 1}", *([f"x{n}"] if i == n - 1 else []))


def _readings(
    rng: np.random.Generator, rig: Rig, made: Motion, read: Sequence[int], hidden: Mapping[int, str]
) -> tuple[str, dict[str, Array], float]:
    """Return the plant file, the readings by name, and their noise, of sensors of displacement or rate."""
    fast = {i: bool(rng.random() < 0.15) for i in read}
    noise = 10.0 ** rng.uniform(-4.0, -2.0)
    is_plain, prefix = rig.unit == "1", "m" if rng.random() < 0.3 else ""
    lines, columns = ["name: rig", "model: model.yaml", "sensors:"], {}
    for i in read:
        y = (made.rate if fast[i] else made.displacement)[:, i]
        y = _read(hidden[i], y, rng) if i in hidden else y
        y = y + noise * y.std() * rng.standard_normal(len(y))
        unit = "1" if is_plain else f"{prefix}m" + ("/s" if fast[i] else "")
        what = f"x{i + 1}'" if fast[i] else f"x{i + 1}"
        lines.append(f'  s{i + 1}: {{measures: "{what}", unit: {unit!r}}}')
        columns[f"s{i + 1}"] = y * (1e3 if prefix and not is_plain else 1.0)
    return "\n".join(lines) + "\n", columns, noise


def _values(rng: np.random.Generator, n: int, speed: float) -> Array:
    """Return masses, stiffnesses and dampings (3, n)."""
    m = 10.0 ** rng.uniform(-3.0, 2.0) * rng.uniform(0.5, 2.0, n)
    k = m.mean() * speed**2 * rng.uniform(0.5, 2.0, n)
    return np.array([m, k, 2.0 * rng.uniform(0.01, 0.2, n) * np.sqrt(m * k)])


def _hidden(rng: np.random.Generator, n: int, inputs: Sequence[int], at: Sequence[int]) -> list[tuple[str, int]]:
    """Return hidden laws, each with the number of its element, input or sensor, no two of them in one."""
    found = dict[tuple[str, int], str]()
    for _ in range(_count(rng)):
        where = str(
            rng.choice(["element", "actuator", "sensor"], p=[0.7, 0.2 * bool(inputs), 0.3 - 0.2 * bool(inputs)])
        )
        every = {"element": AT_ELEMENTS, "actuator": AT_ACTUATORS, "sensor": AT_SENSORS}[where]
        i = int(rng.choice({"element": [*range(n)], "actuator": [*inputs], "sensor": [*at]}[where]))
        found.setdefault((where, i), str(rng.choice(every)))
    return [(kind, i) for (_, i), kind in found.items()]


def _contact(kind: str, e: Drawn) -> Contact:
    sliding = float(e.random.uniform(0.05, 0.5)) * e.k * e.size
    more = float(e.random.uniform(0.5, 1.5)) if kind == "stribeck_friction" else 0.0
    return Contact(
        e.row, lambda d, v: sliding * (1.0 + more * float(np.exp(-((5.0 * v / e.speed) ** 2)))), sliding * (1.0 + more)
    )


def _acted(kind: str, u: Array, rng: np.random.Generator) -> Array:
    """Return what an actuator does of its command."""
    if kind == "saturation":
        most = float(rng.uniform(0.4, 0.8)) * np.abs(u).max()
        return np.clip(u, -most, most)
    if kind == "dead_zone":
        half = float(rng.uniform(0.1, 0.5)) * u.std()
        return u - np.clip(u, -half, half)
    return u + float(rng.uniform(0.1, 0.5)) * u.std() if kind == "actuator_offset" else u


def _read(kind: str, y: Array, rng: np.random.Generator) -> Array:
    """Return what a sensor reads."""
    if kind == "sensor_saturation":
        most = float(rng.uniform(0.4, 0.8)) * np.abs(y).max()
        return np.clip(y, -most, most)
    return np.abs(y) if kind == "sensor_magnitude" else y + float(rng.uniform(0.1, 0.5)) * y.std()


def _process(rng: np.random.Generator) -> Problem:
    """Return levels in a row, each of which runs into the next: one lag after the other."""
    n, tau = int(rng.integers(1, 4)), 10.0 ** rng.uniform(-2.0, 3.0)
    known, b = rng.uniform(0.5, 2.0, n) / tau, 1.0 / tau
    a = known * (1.0 + OFF * rng.standard_normal(n))
    rate, samples = float(f"{rng.uniform(8.0, 40.0) / tau:.2g}"), int(10.0 ** rng.uniform(3.2, 3.6))
    held = max(1, round(rng.uniform(0.3, 2.0) * tau * rate))
    u = 1.0 + np.repeat(rng.uniform(-0.8, 0.8, samples // held + 1), held)[:samples]
    kind, i = str(rng.choice(["none", "square_flow", "overflow", "saturation", "dead_zone"])), int(rng.integers(n))
    edge = float(rng.uniform(1.1, 1.4)) / a[i] * b
    acting = _acted(kind, u, rng) if kind in AT_ACTUATORS else u

    def rates(x: Array, command: float) -> Array:
        out = a * x
        if kind == "square_flow":
            out[i] += 0.4 * a[i] * a[i] / b * x[i] ** 2
        made = np.append(b * command, out[:-1]) - out
        if kind == "overflow":
            made[i] -= 3.0 * a[i] * max(x[i] - edge, 0.0)
        return np.asarray(made)

    x, h, y = b / a * u[0], 1.0 / rate / PIECES, np.empty((samples, n))
    for j in range(samples):
        y[j] = x
        for _ in range(PIECES):
            k1 = rates(x, acting[j])
            k2 = rates(x + 0.5 * h * k1, acting[j])
            k3 = rates(x + 0.5 * h * k2, acting[j])
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rates(x + h * k3, acting[j]))
    noise = 10.0 ** rng.uniform(-4.0, -2.0)
    y += noise * y.std(axis=0) * rng.standard_normal(y.shape)
    sensors = [f"  s{j + 1}: {{measures: x{j + 1}, unit: m}}" for j in range(n)]
    places = {"square_flow": (f"flow{i + 1}" if i + 1 < n else f"lost{i + 1}",), "overflow": (f"lost{i + 1}",)}
    truth = [] if kind == "none" else [(kind, places.get(kind, ("u", "")))]
    columns = {"t": np.arange(samples) / rate, "u": u} | {f"s{j + 1}": y[:, j] for j in range(n)}
    plant = "\n".join(["name: rig", "model: model.yaml", "sensors:", *sensors]) + "\n"
    words = f"{n} levels, {samples} samples, noise {noise:.0e}"
    return Problem(_levels(known.tolist(), b, y[0].tolist()), plant, columns, truth, words)


def _levels(known: Sequence[float], b: float, initial: Sequence[float]) -> str:
    """Return the model file of levels."""
    n = len(known)
    lines = ["name: levels", "states:", *(f"  x{j + 1}: {{unit: m, initial: {initial[j]:.6g}}}" for j in range(n))]
    lines += ["inputs: {u: {unit: V}}", "parameters:", f"  b: {{value: {b!r}, unit: m/s/V}}"]
    lines += [f"  a{j + 1}: {{value: {value!r}, unit: 1/s}}" for j, value in enumerate(known)]
    lines += ["equations:", *(f"  x{j + 1}': {f'a{j}*x{j}' if j else 'b*u'} - a{j + 1}*x{j + 1}" for j in range(n))]
    lines += ["elements:"]
    for j in range(n):
        lines.append(f"  lost{j + 1}: {{displacement: x{j + 1}, unit: m/s, acts: {{x{j + 1}: -1}}}}")
        if j + 1 < n:
            lines.append(f"  flow{j + 1}: {{displacement: x{j + 1}, unit: m/s, acts: {{x{j + 1}: -1, x{j + 2}: 1}}}}")
    return "\n".join(lines) + "\n"
