"""The public benchmark of virtual real-time hybrid simulation: `python -m tests.benchmarks.rths [--perturbed N]`.

`--by c` and `--by fmu` have the commands made by the exported controller; the storeys stay those of the compiled one.

A storey of a steel frame with its hydraulic actuator, whose command acts in the fifth derivative of the displacement,
moves as the first storey of a building under an earthquake. The evaluator knows nothing of `masking`; it calls the
controller for a loop of one's own once a sample. Perturbed plants are drawn as the evaluator says; the controller knows
of them the stiffness of the storey, which the evaluator takes out of the building, and nothing of the actuator.
Source: Silva, Gomez, Maghareh, Dyke and Spencer (2020), Mechanical Systems and Signal Processing 135, 106381.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import masking
from masking.compile.numerics.arrays import Array
from masking.control.exports.controller_units import sampled_unit
from masking.control.exports.fmu_unit import write
from masking.control.stepwise_controller import SampledStep
from tests.support import compiled_unit, fmu_slave

SHARED = Path(__file__).parents[3] / "shared" / "rths"
QUAKES = ("elcentro", "kobe", "morgan")
SCALE = 0.4  # of the earthquakes
NOISE = 0.002  # V rms
RATE, LVDT, CELL = 4096, 7.89, 1096  # Hz; mm/V; N/V
CONTROLLER = {"rate": f"{RATE} Hz", "observer": {"at": "inputs"}}  # the storey is known, the actuator is not
HEAD = (
    "| case | plant | earthquake | J1 ms | J2 | J3 | J4 | J5 | J6 | J7 | J8 | J9 | noise alone |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|---|---|"
)


def evaluator() -> Any:
    """Return the module of the evaluator."""
    spec = importlib.util.spec_from_file_location("rths_benchmark", SHARED / "benchmark.py")
    if spec is None or spec.loader is None:
        raise SystemExit(f"the benchmark is not at {SHARED}")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def storey(of: Any) -> dict[str, Any]:
    """Return the model of the storey with its actuator, from the evaluator's numbers."""
    p = of.NOMINAL
    damping = 2.0 * of.ZE * float(np.sqrt(of.KE * of.ME))
    values = {
        "m": (of.ME, "kg"), "k": (p["ke"], "N/m"), "c": (damping, "N*s/m"), "a2": (of.A2, "N/m"),
        "a3": (p["a3"], "1/s"), "b1": (p["b1"], "1/s"), "b2": (p["b2"], "1/s**2"), "g": (of.A1B0, "N/m/s**3"),
        "e": (of.GAIN, "1"),
    }  # fmt: skip
    return {
        "name": "storey with its actuator",
        "coordinates": {"x1": {"unit": "m"}},
        "states": {
            "f": {"meaning": "force of the actuator", "unit": "N"},
            "q": {"meaning": "flow", "unit": "N/s"},
            "r": {"meaning": "rate of the flow", "unit": "N/s**2"},
        },
        "inputs": {"u": {"unit": "m"}},
        "parameters": {name: {"value": float(value), "unit": unit} for name, (value, unit) in values.items()},
        "equations": {
            "x1''": "(f - k*x1 - c*x1')/m",
            "f'": "q - a3*f - a2*x1'",
            "q'": "r",
            "r'": "g*(e*u - x1) - b1*r - b2*q",
        },
    }


def building(case: int) -> dict[str, Any]:
    """Return the model of the building: its first storey is a coordinate, the others are internal states."""
    matrices = json.loads((SHARED / "cases.json").read_text())[f"case{case}"]
    places, rates, parameters, accelerations = ("x1", "x2", "x3"), ("x1'", "v2", "v3"), {}, []
    for i in range(3):
        terms = []
        for j in range(3):
            for letter, unit, moved in (("c", "N*s/m", rates[j]), ("k", "N/m", places[j])):
                parameters[f"{letter}{i + 1}{j + 1}"] = {"value": matrices[letter.upper()][i][j], "unit": unit}
                terms.append(f"{letter}{i + 1}{j + 1}*{moved}")
        parameters[f"m{i + 1}"] = {"value": matrices["M"][i][i], "unit": "kg"}
        accelerations.append(f"-({' + '.join(terms)})/m{i + 1} - ground")
    floors = {"x2": "m", "x3": "m", "v2": "m/s", "v3": "m/s"}
    return {
        "name": f"building {case}",
        "coordinates": {"x1": {"unit": "m"}},
        "states": {name: {"meaning": f"{name} of an upper storey", "unit": unit} for name, unit in floors.items()},
        "inputs": {"ground": {"unit": "m/s**2"}},
        "parameters": parameters,
        "equations": {
            "x1''": accelerations[0], "x2'": "v2", "x3'": "v3", "v2'": accelerations[1], "v3'": accelerations[2],
        },
    }  # fmt: skip


def rig() -> dict[str, Any]:
    """Return the plant file: a displacement sensor, and a load cell between the actuator and the storey."""
    return {
        "name": "storey",
        "model": "storey.yaml",
        "sensors": {
            "lvdt": {"measures": "x1", "gain": {"value": 1000, "unit": "mm/m"}, "unit": "mm"},
            "cell": {"measures": "f", "unit": "N"},
        },
        "limits": {"inputs": {"u": {"max": 3.8 * LVDT / 1000, "unit": "m"}}},
        "effects": {
            f"{name}_noise": {"effect": "noise", "at": name, "parameters": {"sigma": NOISE * unit}}
            for name, unit in (("lvdt", LVDT), ("cell", CELL))
        },
    }


def experiment(folder: Path, case: int, quake: str, of: Any) -> masking.Experiment:
    """Write the files of a case into a folder, and return the experiment."""
    t, a = np.loadtxt(SHARED / f"{quake}.csv", delimiter=",", skiprows=1).T
    table = np.column_stack([t, SCALE * a])
    np.savetxt(folder / "quake.csv", table, delimiter=",", header="t,ground", comments="")
    run = {
        "name": f"building {case}, {quake}", "plant": "rig.yaml", "virtual": "building.yaml", "time_scale": 1,
        "duration": float(t[-1]), "initial": {"x1": 0}, "controller": CONTROLLER,
        "inputs": {"ground": {"file": "quake.csv", "interpolation": "linear"}},
    }  # fmt: skip
    files = {"storey": storey(of), "building": building(case), "rig": rig(), "run": run}
    for name, content in files.items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return masking.Experiment.load(folder / "run.yaml")


class Ours:
    """The controller as the evaluator calls it; it knows the earthquake as a record."""

    def __init__(self, of: masking.Experiment) -> None:
        made = of.controller()
        if not isinstance(made, SampledStep):
            raise TypeError("the benchmark's controller reads sensors")
        self.step, first = made, 2 + len(of.law.model.states)
        names = of.virtual.states
        self.floors = [0, *(first + names.index(name) for name in ("x2", "x3"))]

    def reset(self) -> None:
        """Begin again."""
        self.step.reset()

    def __call__(self, displacement: float, force: float, ground: float) -> tuple[float, Array]:
        """Return the command in m, and the storeys (3,) in m."""
        command = float(self.step([1000.0 * displacement, force])[0])
        return command, self.step.estimate[self.floors]


class OfC(Ours):
    """The same with the commands of the controller that is exported as C."""

    def __init__(self, of: masking.Experiment, folder: Path) -> None:
        super().__init__(of)
        self.unit = compiled_unit.CompiledUnit(folder, sampled_unit(of.sampled, "controller", 0.02))

    def reset(self) -> None:
        """Begin again."""
        super().reset()
        self.begun = False

    def answer(self, readings: list[float]) -> float:
        """Return the command in m to readings in mm and N."""
        if not self.begun:
            self.unit.init(readings)
            self.begun = True
        return float(self.unit.step(readings)[0])

    def __call__(self, displacement: float, force: float, ground: float) -> tuple[float, Array]:
        """Return the command in m, and the storeys (3,) in m."""
        _, storeys = super().__call__(displacement, force, ground)
        return self.answer([1000.0 * displacement, force]), storeys


class OfFmu(OfC):
    """The same with those of an FMU 2.0, which fmpy steps."""

    def __init__(self, of: masking.Experiment, folder: Path) -> None:
        Ours.__init__(self, of)
        path, *_ = write(sampled_unit(of.sampled, "controller", 0.02), folder)
        self.slave, self.index = fmu_slave.Slave(path, folder / "unpacked"), 0

    def answer(self, readings: list[float]) -> float:
        """Return the command in m to readings in mm and N."""
        if not self.begun:
            self.slave.begin(readings)
            self.begun = True
        self.slave.set(readings)
        self.slave.step(self.index / RATE, 1.0 / RATE)
        self.index += 1
        return float(self.slave.get()[0])


def table(
    cases: Sequence[int] = (1, 2, 3, 4),
    quakes: Sequence[str] = QUAKES,
    perturbed: int = 0,
    *,
    known: bool = True,
    by: str = "python",
) -> Iterator[str]:
    """Give the lines of a table: each case under each earthquake, with the nominal plant and with perturbed ones.

    Where it is known, the controller has the stiffness of the perturbed storey, as the evaluator has.
    """
    of = evaluator()
    yield HEAD
    for case, quake in itertools.product(cases, quakes):
        generator = np.random.default_rng(case)
        with tempfile.TemporaryDirectory() as name:
            made = experiment(Path(name), case, quake, of)
            called = Ours(made) if by == "python" else {"c": OfC, "fmu": OfFmu}[by](made, Path(name))
            yield row(of, called, (case, "nominal", quake), {})
            for number in range(1, perturbed + 1):
                drawn = {key: of.NOMINAL[key] + of.STD[key] * float(generator.standard_normal()) for key in of.STD}
                settings = CONTROLLER | {"parameters": {"k": drawn["ke"]} if known else {}}
                yield row(of, Ours(made.changed(controller=settings)), (case, f"perturbed {number}", quake), drawn)


def worst(perturbed: int, quake: str = "elcentro") -> Iterator[str]:
    """Give the lines of a table of the worst of several perturbed plants of each case under an earthquake."""
    yield "| case | J4 | J5 | J6 | J7 | J8 | J9 | noise alone |\n|---|---|---|---|---|---|---|---|"
    for case in (1, 2, 3, 4):
        _, _, *lines = table((case,), (quake,), perturbed)
        cells = np.array([line.split("|")[7:14] for line in lines], dtype=float)
        yield f"| {case} | {' | '.join(f'{value:.2f}' for value in cells.max(axis=0))} |"


def row(of: Any, called: Ours, what: tuple[int, str, str], over: dict[str, float]) -> str:
    """Return the row of a case and a plant under an earthquake."""
    case, plant, quake = what
    found, more = of.run(case, called, quake=quake, own=True, seed=len(plant) + case, **over)
    noise = 100.0 * NOISE * LVDT / 1000.0 / np.std(more["ref"][:, 0])
    return f"| {case} | {plant} | {quake} | {' | '.join(f'{value:.2f}' for value in (*found, noise))} |"


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, nargs="*", default=[1, 2, 3, 4])
    parser.add_argument("--quakes", nargs="*", default=[*QUAKES])
    parser.add_argument("--perturbed", type=int, default=0, metavar="N", help="perturbed plants of each case")
    parser.add_argument("--unknown", action="store_true", help="the stiffness of the storey is not known, either")
    parser.add_argument("--by", choices=("python", "c", "fmu"), default="python", help="of the nominal plants")
    chosen = parser.parse_args()
    for line in table(chosen.cases, chosen.quakes, chosen.perturbed, known=not chosen.unknown, by=chosen.by):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
