"""Rigs whose actuators have dynamics, by our controller and by two others: `python -m tests.benchmarks.by_hand`.

The controller that is written by hand knows what ours knows: the equations, the noise, the sample of delay. A Kalman
filter of the linear rig and of an input that the model lacks is propagated with the commands, the state is predicted to
the middle of the sample in which the command acts, and the first derivative of the displacement in which the input
appears is made that of the oscillator, approached with a bandwidth. The best of several bandwidths counts. The other
one is ours with a model in which the states of the actuator follow at once.
"""

from __future__ import annotations

import itertools
import math
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import sympy as sp
import yaml
from numpy.polynomial import Polynomial
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_discrete_are

from masking import Experiment
from masking.analysis.masking_error import masking_error
from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.errors import MaskingError, ModelError
from masking.lab.plants.interface import Settings
from masking.lab.plants.simulated import SimulatedPlant
from tests.control import test_relative_degree as rigs

H, STEPS, HOMING, START = 1e-3, 5000, 1.0, 0.01
BANDWIDTHS, DRIFTS = (40.0, 75.0, 150.0, 340.0), (30.0, 300.0, 3000.0)  # rad/s; of the largest command in a second
NOISE, OFF = 1e-6, 0.05  # of the encoder, m; how much the parameters are off
SETTLED = 60.0  # rad/s with which a homing by hand follows its path


@dataclass(frozen=True)
class Rig:
    """A linear rig: x is the first of its states."""

    name: str
    text: str  # of the model
    largest: tuple[float, str]  # command
    states: str  # in the order of the equations
    rates: dict[str, str]
    known: dict[str, float]  # parameters
    doubtful: tuple[str, ...]  # parameters that are off, the first upwards, the next downwards, ...
    neglected: str  # the same rig with an actuator that follows at once

    def matrices(self, known: dict[str, float]) -> tuple[Array, Array]:
        """Rates per unit of each state (n, n), and of the input (n, 1)."""
        x, u = sp.symbols(self.states.split()), sp.Symbol("u")
        local = {str(s): s for s in (*x, u)} | known
        rates = sp.Matrix([sp.sympify(self.rates[name], locals=local) for name in self.states.split()])
        return tuple(np.array(rates.jacobian(by), dtype=float) for by in (x, [u]))

    @property
    def wrong(self) -> dict[str, float]:
        """Parameters that are off."""
        return {name: self.known[name] * (1 + OFF * (-1) ** i) for i, name in enumerate(self.doubtful)}


RIGS = (
    Rig(
        "voice coil driven by voltage", rigs.RIGS["voice coil driven by voltage"], (24.0, "V"), "x v i",
        {"x": "v", "v": "(K*i - k*x - b*v)/m", "i": "(u - R*i - K*v)/L"},
        {"m": 0.5, "k": 200.0, "b": 1.5, "K": 8.0, "R": 4.0, "L": 0.02}, ("R", "K", "L"), rigs.NEGLECTED,
    ),
    Rig(
        "force behind a current loop that lags", rigs.RIGS["force behind a current loop that lags"], (5.0, "A"),
        "x v i", {"x": "v", "v": "(K*i - k*x)/m", "i": "(u - i)/tau"},
        {"m": 0.5, "k": 200.0, "K": 8.0, "tau": 0.01}, ("K", "tau"),
        """
name: force without lag
coordinates: {x: {unit: m}}
inputs: {u: {unit: A}}
parameters: {m: {value: 0.5, unit: kg}, k: {value: 200, unit: N/m}, K: {value: 8, unit: N/A}}
equations: {x'': (K*u - k*x)/m}
""",
    ),
    Rig(
        "hydraulic cylinder", rigs.RIGS["hydraulic cylinder"], (1.0, "m"), "x v f q r",
        {"x": "v", "v": "(f - k*x - c*v)/m", "f": "q - a3*f - a2*v", "q": "r", "r": "g*(u - x) - b1*r - b2*q"},
        {"m": 29.13, "k": 1190e3, "c": 114.2, "a2": 4.2297e6, "a3": 3.3, "b1": 425.0, "b2": 9.9976e4, "g": 2.1283e13},
        ("a3", "b1", "b2", "g"),
        """
name: cylinder whose flow and pressure follow at once
coordinates: {x: {unit: m}}
inputs: {u: {unit: m}}
parameters:
  m: {value: 29.13, unit: kg}
  k: {value: 1190e3, unit: N/m}
  c: {value: 114.2, unit: N*s/m}
  a2: {value: 4.2297e6, unit: N/m}
  a3: {value: 3.3, unit: 1/s}
  b2: {value: 9.9976e4, unit: 1/s**2}
  g: {value: 2.1283e13, unit: N/m/s**3}
equations: {x'': ((g*(u - x)/b2 - a2*x')/a3 - k*x - c*x')/m}
""",
    ),
    Rig(
        "mass behind a spring", rigs.ELASTIC, (24.0, "N"), "x v y w",
        {"x": "v", "v": "(-k*(x - y) - b*v)/m", "y": "w", "w": "(u - k*(y - x) - b*w)/m"},
        {"m": 0.5, "k": 2000.0, "b": 1.5}, ("k", "m"),
        """
name: two masses in one
coordinates: {x: {unit: m}}
inputs: {u: {unit: N}}
parameters: {m: {value: 0.5, unit: kg}, b: {value: 1.5, unit: N*s/m}}
equations: {x'': (u - 2*b*x')/(2*m)}
""",
    ),
)  # fmt: skip


class ByHand:
    """The controller: readings in m, commands in the unit of the input."""

    def __init__(self, rig: Rig, known: dict[str, float], kind: dict[str, float], tuned: tuple[float, float]) -> None:
        (a, b), (self.bandwidth, drift), self.largest = rig.matrices(known), tuned, rig.largest[0]
        n, rows = len(a), [np.eye(1, len(a))]
        while abs(slope := (rows[-1] @ b).item()) <= 1e-9 * (np.abs(rows[-1]) @ np.abs(b)).item():
            rows.append(rows[-1] @ a)
        self.degree, self.jet, self.highest, self.slope = len(rows), np.vstack(rows), rows[-1] @ a, slope
        flow = np.zeros((n + 2, n + 2))  # of the state, what adds to the input, and the input
        flow[:n, :n], flow[:n, n:] = a, b
        whole, half = expm(H * flow)[:-1], expm(0.5 * H * flow)[:-1]
        self.step, self.half = (whole[:, :-1], whole[:, -1]), (half[:, :-1], half[:, -1])
        sizes = self.largest * np.append(np.abs(np.linalg.solve(60j * np.eye(n) - a, b)), 1.0)
        scaled, sensing = self.step[0] * sizes / sizes[:, None], np.eye(1, n + 1) * sizes[0] / NOISE
        spread = solve_discrete_are(scaled.T, sensing.T, np.diag([1e-12] * n + [(drift * H) ** 2]), np.eye(1))
        self.gain = (spread @ sensing.T / (sensing @ spread @ sensing.T + 1.0)).ravel() * sizes / NOISE
        self.wanted, self.state, self.last = wanted_derivatives(self.degree - 1, kind), np.zeros(n + 1), 0.0
        ends = [0.0, 0.0, 0.0, START, 0.0, self.wanted(0.0, [START] + [0.0] * self.degree)[0] * HOMING**2]
        powers = [[math.perm(k, d) * s ** max(k - d, 0) for k in range(6)] for s in (0.0, 1.0) for d in range(3)]
        self.path = Polynomial(np.linalg.solve(powers, ends), domain=[-HOMING, 0.0], window=[0.0, 1.0])

    def __call__(self, t: float, reading: float) -> float:
        """Return the command that acts from t + H on."""
        z = self.state + self.gain * (reading - self.state[0])
        ahead = self.step[0] @ z + self.step[1] * self.last
        middle = self.half[0] @ ahead + self.half[1] * self.last
        jet, now, more = [*(self.jet @ middle[:-1])], t + 1.5 * H, self.degree - 2
        wanted = self.wanted(now, jet) if t >= 0.0 else self.homing(now, jet)
        behind = (math.comb(more, k) * self.bandwidth ** (more - k) * (jet[k + 2] - wanted[k]) for k in range(more))
        command = (wanted[more] - sum(behind) - (self.highest @ middle[:-1]).item()) / self.slope - middle[-1]
        self.state, self.last = ahead, float(np.clip(command, -self.largest, self.largest))
        return self.last

    def homing(self, t: float, jet: list[float]) -> list[float]:
        """Return the acceleration along a path to the start, and its derivatives."""
        path, a = [self.path.deriv(k)(min(t, 0.0)) for k in range(self.degree + 1)], min(SETTLED, self.bandwidth / 4)
        errors = [wanted - x for wanted, x in zip(path, jet, strict=False)]
        return [path[k + 2] + 2 * a * errors[k + 1] + a * a * errors[k] for k in range(self.degree - 1)]


def wanted_derivatives(count: int, kind: dict[str, float]) -> Callable[[float, list[float]], list[float]]:
    """Return a function of t and of x and its derivatives: the wanted acceleration and its derivatives, `count`."""
    t, x = sp.Symbol("t"), sp.symbols(f"x:{count + 2}")
    a, b, c, d, f = (kind.get(name, 0) for name in "abcdf")
    size = sp.Rational(1, 50)
    turn = c * ((x[0] / size) ** 2 - 1) * x[1] + d * sp.sin(x[0] / size)
    found = [-a * x[0] - b * x[0] ** 3 - turn + f * sp.cos(7 * t)]
    while len(found) < count:
        last = found[-1]
        found.append(last.diff(t) + sum(last.diff(one) * rate for one, rate in itertools.pairwise(x)))
    made = sp.lambdify((t, x), found)
    return lambda at, jet: made(at, [*jet, 0.0, 0.0][: len(x)])


def error(twin: Twin, controller: ByHand, kind: dict[str, float]) -> float:
    """Return the masking error of a controller on a twin over 5 s."""
    plant, places = SimulatedPlant(twin), []
    plant.configure(Settings(1.0 / H))
    plant.activate()
    for n in range(-round(HOMING / H), STEPS):
        sample = plant.read()
        places.append(plant.telemetry()["x"])
        plant.write(sample.index, np.array([controller(n * H, sample.values[0] / 1000.0)]))
    t = H * np.arange(STEPS)
    settings = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-14, "t_eval": t}
    ideal = solve_ivp(lambda t, y: rigs.wanted(t, y, **kind), (0, t[-1]), [START, 0], **settings).y[0]
    return masking_error(np.array(places[-STEPS:]), ideal)


def ours(experiment: Experiment, **controller: object) -> str:
    """Masking error of a run, or how it ended."""
    settings = {"rate": "1 kHz", "homing": HOMING, **controller}
    try:
        made = experiment.changed(controller=settings, initial={"x": START, "x'": 0}).run()
    except ModelError:
        return "refused"
    except MaskingError:
        return "stopped"
    return f"{made.manifest['masking_error']['x']:.2g}"


def table() -> Iterator[str]:
    """Give the lines of a table of masking errors, each as Van der Pol, Duffing and pendulum."""
    yield "| rig | parameters | ours | by hand | actuator neglected |\n|---|---|---|---|---|"
    tunings = [*itertools.product(BANDWIDTHS, DRIFTS)]
    for rig in RIGS:
        with tempfile.TemporaryDirectory() as name:
            folder, (largest, unit) = Path(name), rig.largest
            rigs.written(folder, rig.text)
            sensing = rigs.SENSING.replace("max: 24, unit: V", f"max: {largest}, unit: {unit}")
            (folder / "plant.yaml").write_text("\n".join(line[8:] for line in sensing.splitlines()))
            (folder / "neglected.yaml").write_text(rig.neglected)
            had = yaml.safe_load(rig.neglected)["parameters"]
            for label, known in (("known", {}), ("5 % off", rig.wrong)):
                kept = {name: value for name, value in known.items() if name in had}
                cells: list[tuple[str, str, str]] = []
                for kind in rigs.KINDS.values():
                    made = Experiment.load(folder / "run.yaml", changes=kind)
                    hand = [error(made.twin, ByHand(rig, rig.known | known, kind, one), kind) for one in tunings]
                    without = ours(made, model="neglected.yaml", parameters=kept)
                    cells.append((ours(made, parameters=known), f"{np.nanmin(hand):.2g}", without))
                columns = (" / ".join(dict.fromkeys(of) if len({*of}) == 1 else of) for of in zip(*cells, strict=True))
                yield f"| {rig.name} | {label} | {' | '.join(columns)} |"


def main() -> int:
    """Print the table."""
    for line in table():
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
