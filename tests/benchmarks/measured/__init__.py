"""Measured records of known cause: the model that lacks it, the command that looks for it, and which answers are right.

A model in `examples/measured`, or in this folder, has its command as a comment. Paths in it are of `../shared/data`, as
`prepared` lays it out. What is right is the main cause that the source of the record names; what is plainly false are
names that the rig cannot have, and other units than declared, since those that are declared are right.
"""

from __future__ import annotations

import contextlib
import json
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

import masking
from masking.app.cli import arguments, main_program
from masking.inference.discovery.discovery_result import Discovery
from masking.model.effects.dictionary import EFFECTS
from tests.benchmarks import official
from tests.benchmarks.official import DATA, ROOT

MEASURED = (ROOT / "examples" / "measured", Path(__file__).parent)
INCH, KIP = 0.0254, 4448.22  # m and N


@dataclass(frozen=True)
class Truth:
    """What hides in a record.

    Args:
        folder: of the data.
        cause: in words.
        right: names of the main cause, any of which is right.
        beside: further names that are known to be there, and no mistake.
        shorter: options of the command that make the record shorter, where it would take minutes.
    """

    folder: str
    cause: str
    right: frozenset[str]
    beside: frozenset[str] = frozenset()
    shorter: Mapping[str, str] | None = None


def family(*names: str) -> frozenset[str]:
    """Return the names of the dictionary of some families."""
    return frozenset(name for name, effect in EFFECTS.items() if effect.family in names)


FRICTION = family("friction") - {"play_with_friction", "load_friction", "local_friction"}
REMEMBERS = frozenset({"hysteresis", "bouc_wen_hysteresis", "dahl_friction", "lugre_friction"})
PLAY = frozenset({"play", "backlash", "play_with_friction"})
CUBIC = frozenset({"hardening_spring", "polynomial_spring"})
OFFSET = frozenset({"actuator_offset", "constant_force", "actuator_asymmetry"})
# What no rig here has, but where it is right: a tank that is full, a sensor that bends or has lost its sign.
FALSE = family("overflow") | {"sensor_cubic", "sensor_rectification", "sensor_magnitude", "actuator_cubic", "thermal"}

SETS: Mapping[str, Truth] = {
    "boucwen": Truth("boucwen", "Bouc-Wen hysteresis", frozenset({"hysteresis", "bouc_wen_hysteresis"})),
    "brfd": Truth("brfd_friction_backlash", "friction with dead travel", PLAY, FRICTION | REMEMBERS),
    "cascaded_tanks": Truth("cascaded_tanks", "overflow", family("overflow"), frozenset({"sensor_saturation"})),
    "coupled_drives": Truth("coupled_drives", "a sensor without sign", frozenset({"sensor_magnitude"})),
    "dc_motor": Truth(
        "dc_motor_deadzone_delay", "dead zone or dry friction, asymmetric", FRICTION | {"dead_zone"},
        OFFSET | {"delay", "actuator_delay", "quantisation"},
    ),
    "emps": Truth(
        "emps", "dry friction, and an offset", FRICTION, OFFSET | {"asymmetric_damping"},
        {"record": "emps/DATA_EMPS.mat@:12", "validation": "emps/DATA_EMPS_PULSES.mat@:12"},
    ),
    "f16": Truth(
        "f16_gvt", "clearance and friction of the interface", FRICTION | REMEMBERS | PLAY | {"stop"}, CUBIC,
        {"record": "f16_gvt/level5.npz@:8", "validation": "f16_gvt/level3.npz@:8"},
    ),
    "hsm150": Truth("hsm150_servomotor", "dry friction", FRICTION, OFFSET),
    "mr_damper_nees": Truth(
        "mr_damper_nees", "friction with hysteresis, of a voltage that is late",
        FRICTION | REMEMBERS | {"load_friction"}, OFFSET | {"actuator_lag", "delay", "actuator_delay"},
    ),
    "mr_damper": Truth("mr_damper_utfpr", "friction with hysteresis", REMEMBERS, FRICTION),
    "pendulum": Truth(
        "multiarm_pendulum", "dry friction, and drag", FRICTION, frozenset({"quadratic_damping"}),
        {"resample": "100 Hz"},
    ),
    "oring": Truth(
        "pneumatic_oring_friction", "dry friction of a seal", FRICTION | REMEMBERS, frozenset({"viscous_damping"})
    ),
    "rack_pinion": Truth("rack_pinion_friction", "friction", FRICTION),
    "silverbox": Truth("silverbox", "cubic stiffness", CUBIC, OFFSET | {"sensor_offset"}),
    "vhb4910": Truth("vhb4910_elastomer", "relaxation", frozenset({"relaxation", "maxwell_element"}), CUBIC),
}  # fmt: skip


def examples() -> dict[str, Path]:
    """Return the models with a command, by name."""
    return {path.stem: path for folder in MEASURED for path in sorted(folder.glob("*.yaml"))}


def command(example: Path) -> list[str]:
    """Return the words of the command in a file, `masking` left out."""
    lines = [line[1:].strip() for line in example.read_text(encoding="utf-8").splitlines() if line.startswith("#   ")]
    words = shlex.split(" ".join(lines).replace("\\", ""))[1:]
    return [str(example) if word == example.name else word for word in words]


def discovered(name: str, folder: Path) -> Callable[[], Discovery]:
    """Prepare the files of a set in a folder, and return what discovers what hides in it."""
    prepared(folder, SETS[name].folder)
    chosen = main_program._parser().parse_args(command(examples()[name]))
    known, written = chosen.verb.parameters(), vars(chosen) | (SETS[name].shorter or {})
    settings = {n: arguments.value(known[n], text) for n, text in written.items() if n in known and n != "record"}

    def run() -> Discovery:
        with contextlib.chdir(folder):
            return masking.discover(written["record"], **settings, **arguments.columns(written))

    return run


def prepared(folder: Path, *names: str) -> None:
    """Lay out data in a folder: as they are, or as tables that are written from them."""
    for name in names or [one.name for one in DATA.iterdir()]:
        if name in TABLES:
            (folder / name).mkdir()
            TABLES[name](folder / name)
        else:
            (folder / name).symlink_to(DATA / name)


def bands(folder: Path) -> None:
    """Write two amplitudes of the band brake in SI."""
    for inches in ("1", "1.5"):
        path = DATA / "brfd_friction_backlash" / f"dataset2_0.5Hz30lbtension{inches}amplitude.json"
        t, d, force, v = np.array(json.loads(path.read_text())["data"])[2048::4, :4].T
        np.savez(folder / f"{inches}in.npz", t=t, d=INCH * d, v=INCH * v, F=KIP * force)


def voltages(folder: Path) -> None:
    """Write two parts of the random test of the prototype damper."""
    path = DATA / "mr_damper_nees" / "ransim_u_converted.csv"
    d, y, v, force = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=(2, 3, 5, 6))[::10].T
    t = np.arange(len(d)) / 300.48  # stamps are rounded
    for part, inside in (("first", t < 12.0), ("second", (t >= 12.0) & (t < 19.4))):
        columns = {"t": t, "d": d, "v": v, "Y": y, "F": force}
        np.savez(folder / f"{part}.npz", **{name: column[inside] for name, column in columns.items()})


def steps(folder: Path) -> None:
    """Write two steps of the servo motor."""
    for torque in ("0.06", "0.065"):
        table = scipy.io.loadmat(DATA / "hsm150_servomotor" / f"idf_pos_{torque}_1.mat")["data"][::10]
        np.savez(folder / f"{torque}.npz", t=table[:, 0], T=table[:, 4], speed=table[:, 3])


def seals(folder: Path) -> None:
    """Write two pressures of the cylinder."""
    for bar in ("5", "7"):
        table = np.loadtxt(DATA / "pneumatic_oring_friction" / f"O-ring_{bar}bar.csv")[15:]
        np.savez(
            folder / f"{bar}bar.npz", **slopes(1e-3 * table[:, 0], 20.0, d=table[:, 4], p=table[:, 5], F=table[:, 6])
        )


def strips(folder: Path) -> None:
    """Write two strain rates of the elastomer."""
    for rate in ("0.03", "0.05"):
        path = DATA / "vhb4910_elastomer" / f"0d{rate[2:]}_3d0.csv"
        lines = path.read_text(encoding="gbk").replace('"', "").splitlines()
        t, d, force = np.array([line.split(",") for line in lines[3:] if line], dtype=float).T
        np.savez(folder / f"{rate}.npz", **slopes(t, 10.0, d=d, F=force))


def slopes(t: np.ndarray, rate: float, **columns: np.ndarray) -> dict[str, Any]:
    """Return columns on a steady clock, with v, the slope of d."""
    steady = np.arange(t[0], t[-1], 1.0 / rate)
    found = {name: np.interp(steady, t, column) for name, column in columns.items()}
    return {"t": steady - steady[0], "v": np.gradient(found["d"], 1.0 / rate), **found}


TABLES: Mapping[str, Callable[[Path], Any]] = {
    "coupled_drives": official.drives,
    "f16_gvt": official.wings,
    "brfd_friction_backlash": bands,
    "mr_damper_nees": voltages,
    "hsm150_servomotor": steps,
    "pneumatic_oring_friction": seals,
    "vhb4910_elastomer": strips,
}
