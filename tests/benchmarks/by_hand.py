"""A voice coil driven by voltage as a Van der Pol oscillator, by hand: `python -m tests.benchmarks.by_hand`.

The controller that is written by hand knows what ours knows: the equations, the noise, the sample of delay. A Kalman
filter of the linear rig and of a voltage that the model lacks is propagated with the commands, the state is predicted
to the middle of the sample in which the command acts, and the third derivative of the displacement is made that of the
oscillator, approached with a bandwidth.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_discrete_are

from masking import Experiment
from masking.analysis.masking_error import masking_error
from masking.control.rig.twin import Twin
from masking.lab.plants.interface import Settings
from masking.lab.plants.simulated import SimulatedPlant
from tests.control import test_relative_degree as rigs

NAME, H, STEPS, HOMING = "voice coil driven by voltage", 1e-3, 5000, 1.0
KIND = rigs.KINDS["Van der Pol"]
TRUE, WRONG = {"R": 4.0, "L": 0.02, "K": 8.0}, {"R": 4.2, "L": 0.021, "K": 7.6}
M, STIFFNESS, DAMPING, LIMIT, START = 0.5, 200.0, 1.5, 24.0, 0.01


class ByHand:
    """The controller: readings in m, commands in V."""

    def __init__(self, known: dict[str, float], bandwidth: float, drift: float) -> None:
        resistance, self.inductance, self.motor = (known[name] for name in ("R", "L", "K"))
        self.resistance, self.bandwidth = resistance, bandwidth
        k, b, inductance, motor = STIFFNESS, DAMPING, self.inductance, self.motor
        flow = np.zeros((5, 5))
        flow[0, 1] = 1.0
        flow[1, :3] = -k / M, -b / M, motor / M
        flow[2, 1:] = -motor / inductance, -resistance / inductance, 1.0 / inductance, 1.0 / inductance
        whole, half = expm(H * flow), expm(0.5 * H * flow)
        self.step, self.half = (whole[:4, :4], whole[:4, 4]), (half[:4, :4], half[:4, 4])
        sensing, noise = np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[1e-12]])
        spread = solve_discrete_are(whole[:4, :4].T, sensing.T, np.diag([1e-14, 1e-9, 1e-8, (drift * H) ** 2]), noise)
        self.gain = (spread @ sensing.T / (sensing @ spread @ sensing.T + noise)).ravel()
        self.state, self.last = np.zeros(4), 0.0

    def __call__(self, t: float, reading: float) -> float:
        """Return the command that acts from t + H on."""
        z = self.state + self.gain * (reading - self.state[0])
        ahead = self.step[0] @ z + self.step[1] * self.last
        x, v, i, disturbance = self.half[0] @ ahead + self.half[1] * self.last
        a = (self.motor * i - STIFFNESS * x - DAMPING * v) / M
        wanted, rate = self.wanted(t + 1.5 * H, x, v, a)
        jerk = rate - self.bandwidth * (a - wanted)
        slope = (M * jerk + STIFFNESS * v + DAMPING * a) / self.motor
        command = self.inductance * slope + self.resistance * i + self.motor * v - disturbance
        self.state, self.last = ahead, float(np.clip(command, -LIMIT, LIMIT))
        return self.last

    @staticmethod
    def wanted(t: float, x: float, v: float, a: float) -> tuple[float, float]:
        """Return the acceleration that is wanted, and its rate: of a path to the start, then of the oscillator."""
        if t >= 0.0:
            c, size = KIND["c"], 0.02
            drag = c * ((x / size) ** 2 - 1.0)
            return -KIND["a"] * x - drag * v, -KIND["a"] * v - 2.0 * c * x * v * v / size**2 - drag * a
        over, fast = 0.7 * HOMING, 60.0
        s = min(1.0, max(0.0, (t + HOMING) / over))
        path = START * np.array([s**3 * (10 - 15 * s + 6 * s * s), 30 * (s * (1 - s)) ** 2 / over])
        bend = START * 60 * s * (1 - s) * (1 - 2 * s) / over**2
        pulled = bend + 2 * fast * (path[1] - v) + fast**2 * (path[0] - x)
        return pulled, fast**2 * (path[1] - v) + 2 * fast * (bend - a)


def error(twin: Twin, controller: ByHand) -> float:
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
    ideal = solve_ivp(lambda t, y: rigs.wanted(t, y, **KIND), (0, t[-1]), [START, 0], **settings).y[0]
    return masking_error(np.array(places[-STEPS:]), ideal)


def main() -> int:
    """Print the masking errors of both, with the rig's own parameters and with some that are 5 % off."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rigs.written(folder, rigs.RIGS[NAME])
        (folder / "plant.yaml").write_text("\n".join(line[8:] for line in rigs.SENSING.splitlines()))
        experiment = Experiment.load(folder / "run.yaml", changes=KIND)
        for label, known in (("known", TRUE), ("5 % off", WRONG)):
            settings = {"rate": "1 kHz", "homing": 1, "parameters": known}
            made = experiment.changed(controller=settings, initial={"x": START, "x'": 0}).run()
            tuned = [(w, d) for w in (75.0, 150.0, 340.0) for d in (300.0, 3000.0)]
            hand = min(error(experiment.twin, ByHand(known, *one)) for one in tuned)
            ours = made.manifest["masking_error"]["x"]
            print(f"{label}: ours {ours:.4f}, by hand, the best of {len(tuned)}: {hand:.4f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
