"""Fault 29: of a simulation in the place of a plant, an FMU that returns an error or numbers that are none."""

from __future__ import annotations

import contextlib
import math
import platform
from typing import Final

import numpy as np

from masking.app.workflows.export import export
from masking.compile.numerics.arrays import Array
from masking.control.exports.fmu_unit import has_binary
from masking.errors import PlantError
from masking.lab.plants import adapters
from masking.lab.plants.interface import Settings
from masking.lab.runs.realtime import Hooks, RigRun, run_rig
from tests.campaigns.bench import Bench
from tests.campaigns.table import Fault, Judgement
from tests.campaigns.twins import RATE

_LASTS: Final = 0.05  # s until the level is below zero, of which there is no square root
_MODEL: Final = f"""name: drain
states: {{level: {{initial: {_LASTS}}}}}
inputs: {{u: {{}}}}
outputs: {{pressure: {{expression: sqrt(level)}}}}
equations: {{"level'": u - 1}}
"""
_SAMPLES: Final = 200


def _run(address: str, rate: float) -> RigRun:
    """Run a controller on an FMU that fails; return how it ended."""
    ended: list[RigRun] = []

    def nothing(_: int, readings: Array) -> Array:
        return np.zeros_like(readings)

    with contextlib.suppress(PlantError):
        run_rig(
            nothing,
            adapters.connect(address),
            Settings(rate, lockstep=True),
            samples=_SAMPLES,
            limits=np.ones(1),
            hooks=Hooks(on_end=ended.append),
        )
    return ended[0]


def _fails(bench: Bench, judgement: Judgement) -> None:
    if not has_binary():
        judgement.need(holds=False, broken=f"FMUs get no binary on {platform.system()} {platform.machine()}")
        return
    folder = bench.place()
    folder.mkdir(parents=True)
    (folder / "drain.yaml").write_text(_MODEL, encoding="utf-8")
    for path in export(folder / "drain.yaml", to="fmu", rate=RATE, out=folder / "fmu").files:
        # FMI leaves a unit free to refuse a step that is no multiple of its own: this one does.
        cases = ("is not finite", RATE, math.ceil(_LASTS * RATE)), ("has stopped", RATE / math.e, 1)
        for said, rate, most in cases:
            ran = _run(f"fmu:{path}", rate)
            cause, detail = ("none", "") if ran.trip is None else (ran.trip.cause.name, ran.trip.detail)
            judgement.need(cause == "PLANT_ERROR", f"{path.name}: ended as {cause}, not PLANT_ERROR")
            judgement.need(said in detail, f"{path.name}: '{detail}' does not say '{said}'")
            judgement.need(len(ran.index) <= most + 1, f"{path.name}: {len(ran.index)} ticks, more than {most + 1}")
            judgement.say(f"{path.name} {said}: {cause} after {len(ran.index)} ticks")


FAULTS: Final = (Fault(29, "FMU plant returns an error or NaN", "PLANT_ERROR, in the same tick", _fails),)
