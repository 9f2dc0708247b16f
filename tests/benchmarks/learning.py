"""Rigs that learn what they are: `python -m tests.benchmarks.learning [RIG...] [--kills N] [--json FILE]`.

Each is a twin that is served in lockstep by a process of its own, and a plant file that lacks what it has. `masking rig
learn` is given that file and an experiment. With `--kills` it is killed with SIGKILL at random moments, started again
until it ends, and compared with one that was left alone. The masking error is that which the controller estimates, and
beside it that of the twin's own record.
"""

from __future__ import annotations

import argparse
import json
import random
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from masking.app.workflows.learn import JOURNAL
from masking.lab.records.journal import Journal
from masking.lab.records.recording import Recording
from masking.model.declaration import registry

CART: dict[str, Any] = {
    "name": "cart",
    "model": "cart",
    "sensors": {"encoder": {"measures": "x", "gain": {"value": 1000, "unit": "mm/m"}, "unit": "mm"}},
    "limits": {"inputs": {"u": {"max": 2, "unit": "A"}}, "coordinates": {"x": {"max": 25, "unit": "mm"}}},
    "effects": {
        "noise": {"effect": "noise", "at": "encoder", "parameters": {"sigma": 0.002}},
        "delay": {"effect": "delay", "parameters": {"samples": 1}},
    },
}
SHAFT = {
    "name": "shaft",
    "coordinates": {"x": {"unit": "rad", "meaning": "angle of the motor"}},
    "inputs": {"u": {"unit": "A", "meaning": "current of the motor"}},
    "parameters": {
        "J": {"value": 0.004, "unit": "kg*m**2", "bounds": [1e-9, None]},
        "b": {"value": 0.01, "unit": "N*m*s/rad", "bounds": [0, None]},
        "kt": {"value": 0.2, "unit": "N*m/A"},
    },
    "equations": {"J*x''": "kt*u - b*x'"},
    "elements": {"shaft": {"displacement": "x", "unit": "N*m", "acts": {"x": -1}}},
}
DRIVE = {
    "name": "drive",
    "model": "shaft.yaml",
    "sensors": {"encoder": {"measures": "x", "gain": {"value": 1, "unit": "rad/rad"}, "unit": "rad"}},
    "limits": {"inputs": {"u": {"max": 3, "unit": "A"}}, "coordinates": {"x": {"max": 3, "unit": "rad"}}},
    "effects": {
        "noise": {"effect": "noise", "at": "encoder", "parameters": {"sigma": 2e-4}},
        "delay": {"effect": "delay", "parameters": {"samples": 1}},
    },
}
CART_RUN = {
    "name": "a Van der Pol oscillator", "plant": "rig.yaml", "virtual": "van_der_pol",
    "transform": {"expressions": {"x": "x/stroke"}, "parameters": {"stroke": 0.005}},
    "controller": {"rate": "500 Hz", "observer": "disturbance", "homing": 2},
    "initial": {"x": 0.5}, "time_scale": 0.1, "duration": 100,
}  # fmt: skip
DRIVE_RUN = CART_RUN | {"transform": {"expressions": {"x": "x/stroke"}, "parameters": {"stroke": 0.3}}}
SETUP_RUN = {
    "name": "Duffing oscillators", "plant": "rig.yaml", "virtual": "duffing",
    "controller": {"rate": "500 Hz", "observer": "disturbance", "homing": 2},
    "initial": {"x1": -0.6, "x2": -0.5}, "duration": 100,
}  # fmt: skip
SECONDS = "20"
ALIKE = 1e-9  # relative, of numbers of two runs that came to the same end


@dataclass(frozen=True)
class Hidden:
    """A rig, what it has that its plant file lacks, and the causes that are right."""

    what: str
    plant: dict[str, Any]
    effects: dict[str, Any]
    causes: tuple[str, ...]
    run: dict[str, Any]
    # coordinate of the rig and its displacement per unit of each virtual one
    transform: dict[str, tuple[str, float]]


def _at(effect: str, at: str, **parameters: float) -> dict[str, Any]:
    return {"effect": effect, "at": at, "parameters": parameters}


SETUP = yaml.safe_load(Path(next(iter(registry.load_plant("linear_rig").files))).read_text(encoding="utf-8"))
ON_CART, ON_DRIVE = (CART_RUN, {"x": ("x", 0.005)}), (DRIVE_RUN, {"x": ("x", 0.3)})
RIGS = {
    "friction": Hidden(
        "friction, and a delay of 4 samples in place of 1", CART,
        {"rub": _at("dry_friction", "guide", fc=0.3, vs=0.002),
         "delay": {"effect": "delay", "parameters": {"samples": 4}}},
        ("dry friction", "delay"), *ON_CART,
    ),
    "backlash": Hidden(
        "backlash at one oscillator; the gains of two actuators 8 % too small", SETUP,
        {"play": _at("backlash", "spring2", k=60, gap=0.001),
         "gains": {"effect": "actuator_gain", "at": ["V1", "V2"], "parameters": {"e": -0.08}}},
        ("backlash", "c1", "c2"), SETUP_RUN, {f"x{i}": (f"x{i}", 0.005) for i in (1, 2, 3)},
    ),
    "scale": Hidden(
        "backlash; an actuator 12 % too weak, and a sensor 5 % too large", CART,
        {"play": _at("backlash", "guide", k=60, gap=0.004), "coil": _at("actuator_gain", "u", e=-0.12),
         "scale": _at("sensor_gain", "encoder", e=0.05)},
        ("backlash",), *ON_CART,
    ),
    "spring": Hidden(
        "a cubic spring, and drift of the sensor", CART,
        {"spring": _at("hardening_spring", "guide", k3=6e4), "drift": _at("sensor_drift", "encoder", rate=0.02)},
        ("hardening spring", "sensor drift"), *ON_CART,
    ),
    "gear": Hidden(
        "a load behind a flexible gear, on a shaft that nothing holds", DRIVE,
        {"gear": _at("attached_oscillator", "shaft", m=0.0015, nu=3.5, zeta=0.03)},
        ("attached oscillator",), *ON_DRIVE,
    ),
    "nothing": Hidden("nothing", CART, {}, ("nothing is missing",), *ON_CART),
}  # fmt: skip


def written(rig: Hidden, folder: Path) -> tuple[Path, Path, Path]:
    """Write the files of a rig into a folder; return the plant file, that of the true rig, and an experiment."""
    effects = {**rig.plant["effects"], **rig.effects}
    files = {"shaft.yaml": SHAFT, "rig.yaml": rig.plant, "true.yaml": rig.plant | {"effects": effects}}
    for name, content in (files | {"experiment.yaml": rig.run}).items():
        (folder / name).write_text(json.dumps(content), encoding="utf-8")
    return folder / "rig.yaml", folder / "true.yaml", folder / "experiment.yaml"


@contextmanager
def served(plant: Path, records: Path) -> Iterator[str]:
    """Serve the twin of a plant file in a process of its own, at the address that this gives."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        address = f"udp://127.0.0.1:{free.getsockname()[1]}"
    command = [sys.executable, "-m", "masking", "rig", "serve", str(plant), "--lockstep", "--address", address]
    with subprocess.Popen(
        [*command, "--record", str(records)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        said = process.stderr.readline()
        assert address in said, said
        try:
            yield address
        finally:
            process.terminate()


def learned(command: Sequence[str], kills: int, generator: random.Random) -> tuple[int, float]:
    """Start a command until it ends, killed some times; how often it was, and the processor-free seconds it took."""
    began, made = time.monotonic(), 0
    while True:
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            try:
                process.wait(generator.uniform(4.0, 25.0) if made < kills else None)
            except subprocess.TimeoutExpired:
                process.kill()
                command, made = [*command, "--acknowledge"], made + 1
                continue
            assert process.returncode == 0, f"exit status {process.returncode}: {' '.join(command)}"
            return made, time.monotonic() - began


def rows(folder: Path) -> list[dict[str, Any]]:
    """Steps of a journal."""
    with Journal(folder / JOURNAL) as journal:
        return journal.entries[1:]


def true_errors(rig: Hidden, folder: Path, records: Path) -> list[float]:
    """Masking error of the worst coordinate before and after, by what the twin's own record says of its motion."""
    own, found = [Recording.load(path) for path in records.glob("session-*")], list[float]()
    for name in ("before", "after"):
        (place,) = (folder / "steps").glob(f"*-{name}")
        made = Recording.load(place)
        read, ideal = made.array("sensor"), {n: made[f"ideal.{n}"] for n in rig.transform}
        first, one = next((at, one) for one in own if (at := _begin(one.array("sensor"), read)) >= 0)
        rows = slice(first - 1, first - 1 + len(read))  # what the record has of a tick is at its end
        errors = []
        for n, (coordinate, stroke) in rig.transform.items():
            moved = one[f"plant.{coordinate}"][rows] / stroke
            errors.append(float(np.linalg.norm(moved - ideal[n]) / np.linalg.norm(ideal[n])))
        found.append(max(errors))
    return found


def _begin(whole: np.ndarray[Any, Any], part: np.ndarray[Any, Any]) -> int:
    """Row of a table in which another begins, to the last bit; -1 where it does not."""
    rows = np.flatnonzero((whole[: len(whole) - len(part) + 1] == part[0]).all(axis=1))
    return next((int(row) for row in rows if (whole[row : row + len(part)] == part).all()), -1)


def same(one: Any, other: Any) -> bool:
    """Whether two steps are the same, but for how long they took."""
    if isinstance(one, dict):
        left = {"wall", "seconds"}
        return one.keys() == other.keys() and all(same(one[n], other[n]) for n in one.keys() - left)
    if isinstance(one, float) and isinstance(other, float):
        return abs(one - other) <= ALIKE * max(abs(one), abs(other))
    return bool(one == other)


def measured(name: str, kills: int) -> dict[str, Any]:
    """Let a rig learn; what was found of it."""
    rig = RIGS[name]
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        plant, true, experiment = written(rig, folder)

        def learn(out: Path, many: int, records: Path) -> tuple[int, float]:
            with served(true, records) as address:
                command = [
                    *(sys.executable, "-m", "masking", "rig", "learn", str(plant), "--at", address, "--lockstep"),
                    *("--seconds", SECONDS, "--experiment", str(experiment), "--out", str(out)),
                ]
                return learned(command, many, random.Random(3))  # noqa: S311  # no secret

        _, seconds = learn(folder / "out", 0, folder / "records")
        steps = rows(folder / "out")
        chi = [row.get("chi") for row in steps if row["step"] in {"before", "after"}]
        found = [row for row in steps if row["step"] == "discovery"]
        said = "; ".join(row["cause"] for row in found)
        row = {
            "rig": name, "hidden": rig.what, "found": said, "odds": found[0]["odds"],
            "right": all(cause in said for cause in rig.causes), "gap before": found[0]["before"],
            "gap after": found[-1]["after"], "chi before": chi[0], "chi after": chi[-1],
            **dict(zip(("true chi before", "true chi after"), true_errors(rig, folder / "out", folder / "records"),
                       strict=True)),
            "hours of the rig": sum(one["seconds"] for one in steps) / 3600.0,
            "runs": sum(one["step"] != "discovery" for one in steps), "seconds": seconds,
        }  # fmt: skip
        if kills:
            made, _ = learn(folder / "killed", kills, folder / "again")
            again = rows(folder / "killed")
            row |= {"kills": made, "same end": len(again) == len(steps) and all(map(same, steps, again))}
        return row


def main() -> None:
    """Measure the chosen rigs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rigs", nargs="*", metavar="RIG", help=f"of {', '.join(RIGS)}; all by default")
    parser.add_argument("--kills", type=int, default=0, metavar="N", help="times that each is killed")
    parser.add_argument("--json", type=Path, default=Path("results/learning.json"), metavar="FILE")
    chosen = parser.parse_args()
    if not set(chosen.rigs) <= set(RIGS):
        parser.error(f"the rigs are {', '.join(RIGS)}")
    found = []
    for name in chosen.rigs or RIGS:
        found.append(measured(name, chosen.kills))
        print(
            "  ".join(f"{key}: {x:.3g}" if isinstance(x, float) else f"{key}: {x}" for key, x in found[-1].items()),
            flush=True,
        )
        chosen.json.parent.mkdir(parents=True, exist_ok=True)
        chosen.json.write_text(json.dumps(found, indent=2), encoding="utf-8")


if __name__ == "__main__":
    main()
