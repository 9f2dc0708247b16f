"""The twins of packaged rigs that faults are tried on, and what a controller is that holds them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.control.known_instruments import Instruments
from masking.control.rig.twin import Twin
from masking.lab.plants.safety_chain import Rules
from masking.lab.runs import safety_limits
from masking.model.declaration.instrument_declaration import ControlledStop, Limit

PLANT: Final = "tue_rig"
RATE: Final = 1000.0  # Hz
WATCHDOG: Final = 0.02  # s
_BRAKED: Final = 2.0  # s


@cache
def twin(plant: str = PLANT) -> Twin:
    """Return the twin of a packaged plant."""
    return Twin.load(plant)


@cache
def rules(
    plant: str = PLANT, rate: float = RATE, *, speed: float = 0.0, largest: float = 0.0, brakes: bool = False
) -> Rules:
    """Return what the safety chain holds the twin to.

    Args:
        plant: a packaged plant.
        rate: samples per second.
        speed: limit of the rate of the limited expressions, m/s; 0 for none.
        largest: command in place of the declared one, in its unit; 0 for the declared one.
        brakes: whether a run ends with a brake.
    """
    found = twin(plant)
    declared = found.declaration
    limits = declared.limits
    if speed:
        velocities = {text: Limit(max=speed, unit="m/s") for text in limits.coordinates}
        limits = limits.model_copy(update={"velocities": velocities})
    if largest:
        inputs = {name: limit.model_copy(update={"max": largest}) for name, limit in limits.inputs.items()}
        limits = limits.model_copy(update={"inputs": inputs})
    if brakes:
        limits = limits.model_copy(update={"stop": ControlledStop(kind="brake", time=_BRAKED)})
    known, changed = Instruments.of(found), declared.model_copy(update={"limits": limits})
    return safety_limits.rules(replace(known, plant=changed, factors={**known.factors, "m/s": 1.0}), rate, found)


def small(tick: int, _: Array) -> Array:
    """Answer a tick as a sound controller does that moves the rig a little."""
    return np.full(3, 0.02 * np.sin(2.0 * np.pi * 4.0 * tick / RATE))
