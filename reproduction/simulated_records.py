"""Simulated records of the twin of the rig, of one oscillator with the others held, and of all in free motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.sensitivity import Sensitivity
from masking.lab.signals import multisine, steps
from masking.model.declaration import schema
from masking.model.modelling.model import load_model
from reproduction.errata import table_b_2

FREE: Final = ("w", "z", "c")
FREE_MOTION: Final = ("mu1", "mu2", "w3", "z3")  # the document, too, corrects the beam after it was identified alone
PEAK: Final = (0.105, 0.105, 0.42)  # V, appendix C.6.2: the largest on the oscillators, and on the beam
SECONDS: Final = 200.0
LEVELS: Final = 4  # amplitudes of the steps, up to half of PEAK: the response fills the axes of Fig. 4.4
STAIRS: Final = 1500.0 / 13.2929  # s, the time axis of Fig. 4.4
RELEASED: Final = (-0.005, -0.004, 0.0)  # m, Fig. 4.5
RATE: Final = 500.0  # Hz
SUBSTEPS: Final = 2
SETTLE: Final = 5.0  # s
ELEMENTS: Final = ("spring1", "spring2", "beam")
_UNIT_OF_ACTUATORS: Final = (1.078, 1.109, 1.0)  # appendix C.5


def held_mass(number: int) -> float:
    """Return the mass that moves while the others are held, per its own: the oscillators are fixed to the beam."""
    values = load_model("setup").parameter_values()
    return 1.0 + values["mu1"] + values["mu2"] if number == 3 else 1.0


def alone(number: int, *, is_true: bool, chosen: Mapping[str, float] | None = None) -> Twin:
    """Return the twin of one oscillator with the others held.

    Args:
        number: 1, 2 or 3, the beam, which the held oscillators make heavier.
        is_true: with every effect of the rig; without, the linear model of Table B.1 on the same instruments.
        chosen: values of parameters of the whole twin.
    """
    whole, mass = Twin.load("tue_rig"), held_mass(number)
    values = whole.model.parameter_values()
    effects: dict[str, Any] = {}
    places = {ELEMENTS[number - 1]: "spring", f"V{number}": "V", f"s{number}": "s"}
    for effect in whole.effects if is_true else ():
        if effect.at in places:
            given = {}
            for name, parameter in effect.entry.parameters.items():
                if name in effect.entry.by_step:
                    continue
                label = f"{effect.label}_{name}"
                value = (chosen or {}).get(label, whole.parameter_value(label))
                given[name] = value / mass if parameter.unit.startswith("F") else value
            effects[effect.label] = {
                "effect": effect.kind, "at": places[effect.at], "parameters": given, "enabled": effect.enabled
            }  # fmt: skip
    w, z, c = (values[f"{name}{number}"] for name in FREE)
    plant = {
        "name": f"oscillator {number} alone",
        "model": "setup_oscillator",
        "parameters": {"w": w / mass**0.5, "z": z / mass**0.5, "c": c / mass},
        "sensors": {"s": {"measures": "x", "gain": {"value": 200, "unit": "V/m"}, "unit": "V"}},
        "actuators": {"V": {"unit": "V"}},
        "allocation": {"u": f"V/{_UNIT_OF_ACTUATORS[number - 1]}"},
        "effects": effects,
    }
    declared = schema.PlantDeclaration.model_validate(plant)
    return Twin(declared, load_model("setup_oscillator").declaration)


def multisine_record(number: int, chosen: Mapping[str, float] | None = None) -> Data:
    """Return a record of one oscillator of the twin alone under the multisine of Table B.2.

    Args:
        number: 1, 2 or 3, the beam.
        chosen: values of parameters of the whole twin.
    """
    made = multisine(table_b_2()[0], rate=RATE, duration=SECONDS)["u"]
    samples = PEAK[number - 1] / np.abs(made).max() * made[:, None]
    return recorded(alone(number, is_true=True, chosen=chosen), samples, name="multisine")


def step_record(number: int) -> Data:
    """Return a record of one oscillator of the twin alone under steps of growing amplitude."""
    hold = STAIRS / (4 * LEVELS + 1)
    made = steps(PEAK[number - 1] / 2.0, number=LEVELS, hold=hold, rate=RATE)["u"]
    return recorded(alone(number, is_true=True), made[:, None], name="steps")


def printed_spring() -> dict[str, float]:
    """Return the values of the twin's parameters that give its red oscillator the spring of Table B.4."""
    rho, si = load_model("setup_springs_table").parameter_values(), load_model("setup").parameter_values()
    unit = si["c2"] * si["nu"]
    table = {f"measured_spring2_k{j}": rho[f"rho2{j}"] * unit / si["l"] ** j for j in range(6)}
    table["measured_spring2_k1"] -= si["w2"] ** 2
    return table


def free_motion(chosen: Mapping[str, float] | None = None) -> Data:
    """Return a record of the whole twin, released without commands.

    Args:
        chosen: values of parameters of the twin.
    """
    twin = Twin.load("tue_rig")
    idle = np.zeros((round(4.6 * RATE), len(twin.actuators)))
    return recorded(twin.with_parameters(chosen or {}), idle, moved=np.array(RELEASED), name="free motion")


def recorded(
    twin: Twin,
    commands: Array,
    *,
    moved: Array | None = None,
    name: str = "record",
    seed: int = 0,
    rate: float = RATE,
) -> Data:
    """Return what the sensors of a twin read under commands, with its noise, zero at its equilibrium.

    Args:
        twin: what is recorded; it rests for a while before the record begins.
        commands: (m, a), V, at the rate.
        moved: displacement from rest at the first sample, SI units (n,); none where it is None.
        name: of the record.
        seed: of the noise.
        rate: Hz.
    """
    settle, substeps = round(SETTLE * rate), round(SUBSTEPS * RATE / rate)
    count = len(twin.model.coordinates)
    begin = twin.rest(np.zeros(count))
    idle = Data(
        name, rate, np.zeros((settle, len(twin.actuators))), np.zeros((settle, len(twin.sensors))), twin.late(rate)
    )
    sensing = Sensitivity(twin, ())
    rest = sensing.simulate(np.empty(0), begin, idle.acting, rate=rate, substeps=substeps)[-1]
    gains = 200.0  # V/m, each sensor sees one coordinate of its own
    start = begin.copy()
    start[:count] = np.linalg.solve(_sensing(count), rest / gains)
    if moved is not None:
        start[:count] += moved
    made = Data(name, rate, commands, np.zeros((len(commands), len(twin.sensors))), twin.late(rate))
    clean = sensing.simulate(np.empty(0), start, made.acting, rate=rate, substeps=substeps) - rest
    noise = np.array([twin.noise().get(sensor, 0.0) for sensor in twin.sensors])
    return replace(made, readings=clean + noise * np.random.default_rng(seed).standard_normal(clean.shape))


def _sensing(count: int) -> Array:
    """Return what the sensors see of the coordinates: relative displacements (A.1), or the only one."""
    return np.array([[1.0, 0.0, -1.0], [0.0, 1.0, -1.0], [0.0, 0.0, 1.0]]) if count == 3 else np.eye(count)
