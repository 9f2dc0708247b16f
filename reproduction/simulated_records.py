"""Simulated records of the twin of the rig, of one oscillator with the others held, and of all in free motion."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from masking.declaration import schema
from masking.estimation.data import Data
from masking.estimation.sensitivity import Sensitivity
from masking.modelling.model import load_model
from masking.numerics.arrays import Array
from masking.rig.twin import Twin

RATE: Final = 500.0  # Hz
SUBSTEPS: Final = 2
SETTLE: Final = 5.0  # s
ELEMENTS: Final = ("spring1", "spring2", "beam")
_UNIT_OF_ACTUATORS: Final = (1.078, 1.109, 1.0)  # appendix C.5


def alone(number: int, *, is_true: bool) -> Twin:
    """Return the twin of one oscillator with the others held.

    Args:
        number: 1, 2 or 3, the beam.
        is_true: with every effect of the rig; without, the linear model of Table B.1 on the same instruments.
    """
    whole = Twin.load("tue_rig")
    values = whole.model.parameter_values()
    effects: dict[str, Any] = {}
    places = {ELEMENTS[number - 1]: "spring", f"V{number}": "V", f"s{number}": "s"}
    for effect in whole.effects if is_true else ():
        if effect.at in places:
            values_of = {name: whole.parameter_value(f"{effect.label}_{name}") for name in effect.entry.parameters}
            effects[effect.label] = {"effect": effect.kind, "at": places[effect.at], "parameters": values_of}
    plant = {
        "name": f"oscillator {number} alone",
        "model": "setup_oscillator",
        "parameters": {"w": values[f"w{number}"], "z": values[f"z{number}"], "c": values[f"c{number}"]},
        "sensors": {"s": {"measures": "x", "gain": {"value": 200, "unit": "V/m"}, "unit": "V"}},
        "actuators": {"V": {"unit": "V"}},
        "allocation": {"u": f"V/{_UNIT_OF_ACTUATORS[number - 1]}"},
        "effects": effects,
    }
    declared = schema.PlantDeclaration.model_validate(plant)
    return Twin(declared, load_model("setup_oscillator").declaration)


def recorded(twin: Twin, commands: Array, *, moved: Array | None = None, name: str = "record", seed: int = 0) -> Data:
    """Return what the sensors of a twin read under commands, with its noise, zero at its equilibrium.

    Args:
        twin: what is recorded; it rests for a while before the record begins.
        commands: (m, a), V, at `RATE`.
        moved: displacement from rest at the first sample, SI units (n,); none where it is None.
        name: of the record.
        seed: of the noise.
    """
    settle = round(SETTLE * RATE)
    count = len(twin.model.coordinates)
    begin = twin.rest(np.zeros(count))
    idle = Data(name, RATE, np.zeros((settle, len(twin.actuators))), np.zeros((settle, len(twin.sensors))), twin.delay)
    sensing = Sensitivity(twin, ())
    rest = sensing.simulate(np.empty(0), begin, idle.acting, rate=RATE, substeps=SUBSTEPS)[-1]
    gains = 200.0  # V/m, each sensor sees one coordinate of its own
    start = begin.copy()
    start[:count] = np.linalg.solve(_sensing(count), rest / gains)
    if moved is not None:
        start[:count] += moved
    made = Data(name, RATE, commands, np.zeros((len(commands), len(twin.sensors))), twin.delay)
    clean = sensing.simulate(np.empty(0), start, made.acting, rate=RATE, substeps=SUBSTEPS) - rest
    noise = np.array([twin.noise().get(sensor, 0.0) for sensor in twin.sensors])
    return replace(made, readings=clean + noise * np.random.default_rng(seed).standard_normal(clean.shape))


def _sensing(count: int) -> Array:
    """Return what the sensors see of the coordinates: relative displacements (A.1), or the only one."""
    return np.array([[1.0, 0.0, -1.0], [0.0, 1.0, -1.0], [0.0, 0.0, 1.0]]) if count == 3 else np.eye(count)
