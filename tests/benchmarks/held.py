"""Error of a held output over the controller's rate: `python -m tests.benchmarks.held [--picture FILE]`.

A cart with a spring and a damper, which the controller knows, is released at rest and moves as one of three systems,
for 2 s. Its positions at the samples are compared with the wanted motion by scipy's DOP853: from rest, as it was
released, and from the velocity h^2/12 g' that the held output makes of that, g being the acceleration by the input.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Final

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

from masking.lab.runs.experiment import Experiment

RATES: Final = (250, 500, 1000, 2000, 4000)
DURATION: Final = 2.0
RIG: Final = {
    "cart.yaml": "name: cart\ncoordinates: {x: {unit: m}}\ninputs: {F: {unit: N}}\n"
    "parameters: {m: {value: 1, unit: kg}, c: {value: 1, unit: N*s/m}, k: {value: 40, unit: N/m}}\n"
    "equations: {m*x'': F - c*x' - k*x}\n",
    "rig.yaml": "name: rig\nmodel: cart.yaml\nsensors: {s: {measures: x, unit: m}}\n"
    "limits: {inputs: {F: {max: 1000, unit: N}}}\n",
}
# Each as the declaration has it, as a function of position and velocity, and the position at the release, m.
SYSTEMS: Final[dict[str, tuple[str, Callable[[float, float], float], float]]] = {
    "damped oscillator": ("-2*x' - 100*x", lambda x, v: -2.0 * v - 100.0 * x, 1.0),
    "van der Pol": ("6*(1 - (x/0.1)**2)*x' - 36*x", lambda x, v: 6.0 * (1.0 - (x / 0.1) ** 2) * v - 36.0 * x, 0.05),
    "damped Duffing": ("-3*x' - 25*x - 50*x**3", lambda x, v: -3.0 * v - 25.0 * x - 50.0 * x**3, 1.0),
}


def declared(equation: str, start: float, rate: float) -> dict[str, str]:
    """Return the files of the experiment by name."""
    return RIG | {
        "wanted.yaml": f"name: wanted\ncoordinates: {{x: {{initial: {start}}}}}\nequations: {{x'': {equation}}}\n",
        "experiment.yaml": f"name: released\nplant: rig.yaml\nvirtual: wanted.yaml\nduration: {DURATION}\n"
        f"controller: {{rate: {rate} Hz, observer: {{kind: disturbance, noise: 1e-9}}}}\n",
    }


def errors(system: str, rate: float) -> tuple[float, float]:
    """Return the relative error of the positions (4.12) against the motion from rest, and from the velocity above."""
    equation, wanted, start = SYSTEMS[system]
    with tempfile.TemporaryDirectory() as folder:
        for name, text in declared(equation, start, rate).items():
            Path(folder, name).write_text(text, encoding="utf-8")
        made = Experiment.load(Path(folder, "experiment.yaml")).run()
    slope = (wanted(start, 1e-6) - wanted(start, -1e-6)) / 2e-6 + 1.0  # of g by the velocity: the rig's damping is 1/s
    found = []
    for velocity in (0.0, slope * wanted(start, 0.0) / 12.0 / rate**2):
        truth = solve_ivp(
            lambda _, y: [y[1], wanted(*y)],
            (0.0, made.t[-1]),
            [start, velocity],
            "DOP853",
            made.t,
            rtol=1e-13,
            atol=1e-15,
        ).y[0]
        found.append(float(np.linalg.norm(made["rig.x"] - truth) / np.linalg.norm(truth)))
    return found[0], found[1]


@cache
def measured() -> dict[str, np.ndarray]:
    """Return the errors of each system over the rates (5, 2)."""
    return {name: np.array([errors(name, rate) for rate in RATES]) for name in SYSTEMS}


def table() -> str:
    """Return the errors as a table of Markdown, with the order of each column between the first and the last rate."""
    lines = ["| rate, Hz |" + "".join(f" {name} | from h²/12 g' |" for name in SYSTEMS), "|---" * 7 + "|"]
    columns = np.hstack([*measured().values()])
    lines += [f"| {rate} | {' | '.join(f'{x:.1e}' for x in row)} |" for rate, row in zip(RATES, columns, strict=True)]
    orders = np.log2(columns[0] / columns[-1]) / np.log2(RATES[-1] / RATES[0])
    return "\n".join([*lines, f"| order | {' | '.join(f'{x:.1f}' for x in orders)} |"])


def draw(path: str) -> None:
    """Draw the errors over the rates."""
    figure, axis = plt.subplots(figsize=(6.0, 3.2), layout="constrained")
    for colour, (name, found) in zip(("C0", "C1", "C2"), measured().items(), strict=True):
        axis.loglog(RATES, found[:, 0], f"{colour}o-", label=name)
        axis.loglog(RATES, found[:, 1], f"{colour}s--")
    axis.set(xlabel="rate of the controller, Hz", ylabel="relative error of the positions")
    axis.set_xticks(RATES, [f"{rate}" for rate in RATES])
    axis.minorticks_off()
    axis.legend(frameon=False)
    figure.savefig(path, dpi=120)


def main() -> None:
    """Print the table, and draw the picture if one is wanted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--picture", help="file to draw the errors into")
    given = parser.parse_args()
    print(table())
    if given.picture:
        draw(given.picture)


if __name__ == "__main__":
    main()
