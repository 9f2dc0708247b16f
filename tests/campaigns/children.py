"""Processes of a fault: the server of a twin that can be damaged, and a controller that can fail.

What they share is loaded and compiled as this module is: they are forked off a process that has imported it.
"""

from __future__ import annotations

import ctypes
import itertools
import os
import signal
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from masking.compile.numerics.arrays import Array
from masking.lab.plants import adapters, safety_chain
from masking.lab.plants.interface import Settings
from masking.lab.plants.operating_system import STOPPING
from masking.lab.plants.serve import Serving
from masking.lab.plants.serve import serve as serve_plant
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.runs.realtime import Hooks, RigRun, run_rig
from tests.campaigns import twins
from tests.campaigns.damage import Damaged

_RUNNING, FAILING = 200, 300  # ticks
_STALL = 0.005  # s
_HOUR = 3600.0


def serve(said: Connection, plant: str, folder: str, line: str, *, lockstep: bool, steps: bool) -> None:
    """Serve a twin, whose sessions are recorded in a folder; say its address.

    Args:
        said: where.
        plant: a packaged one.
        folder: of the records, and of the damage.
        line: an address, as `rig serve` takes it.
        lockstep: whether controller and plant wait for each other.
        steps: whether the wall clock steps.
    """
    _begin()
    if steps:
        _step_the_wall_clock()
    simulated = SimulatedPlant(twins.twin(plant))
    simulated.configure(Settings(twins.RATE))  # compiles what a controller would not wait for
    simulated.deactivate()
    serve_plant(
        Damaged(simulated, Path(folder) / "damage.json"),
        line,
        Serving("lockstep" if lockstep else "real", folder, after_latch=0.1),
        ready=said.send,
    )


def control(said: Connection, address: str, chosen: dict[str, Any]) -> None:
    """Run a controller on a plant; say `running` after 200 ticks, and how it ended.

    Args:
        said: where.
        address: of the plant.
        chosen: `fault`, `samples`, `lockstep` and `acknowledge`, each by default as a sound one has it.
    """
    _begin()
    fault, seen, row_of = chosen.get("fault", ""), [0.0], itertools.count()
    if fault == "clock":
        _step_the_wall_clock()

    def step(tick: int, readings: Array) -> Array:
        row = next(row_of)
        seen[0] = time.monotonic()
        if row == FAILING and fault == "segfault":
            ctypes.string_at(0)
        if row == FAILING and fault == "raise":
            raise ZeroDivisionError("the controller was asked to raise")
        if (fault == "stalls" and row >= FAILING) or (fault == "stall" and row == FAILING):
            time.sleep(_STALL)
        return twins.small(tick, readings)

    def on_tick(row: int) -> None:
        if row == _RUNNING:
            said.send("running")

    def on_end(ran: RigRun) -> None:
        trip = ran.trip.as_dict() if ran.trip is not None else None
        made: dict[str, Any] = {
            "reason": ran.reason,
            "trip": trip,
            "rows": len(ran.index),
            "counters": dict(ran.counters),
        }
        gaps = (ran.index[1:] - ran.index[:-1]).tolist()
        made |= {"late": [i for i, late in enumerate(ran.late.tolist()) if late], "gaps": gaps}
        made |= {"walls": (ran.wall[1:] - ran.wall[:-1]).tolist(), "first": int(ran.index[0])}
        said.send(made | {"now": next(at for at in zeroed if at >= seen[0]), "seen": seen[0]})

    plant = adapters.connect(address)
    zeroed, deactivate = [0.0], plant.deactivate

    def at_zero() -> None:
        zeroed.append(time.monotonic())
        deactivate()

    vars(plant)["deactivate"] = at_zero
    run_rig(
        step,
        plant,
        Settings(twins.RATE, twins.WATCHDOG, chosen.get("lockstep", False), chosen.get("acknowledge", True)),
        samples=chosen.get("samples", 10**5),
        limits=twins.rules(),
        hooks=Hooks(on_tick=on_tick, on_end=on_end),
    )


def _step_the_wall_clock() -> None:
    """Let the wall clock of this process step by an hour, to and fro, each time that it is read."""
    sound, steps = time.time, itertools.cycle((0.0, _HOUR, -_HOUR))
    time.time = lambda: sound() + next(steps)


def _begin() -> None:
    """Let signals do what they do by default, and say nothing on standard error."""
    for number in STOPPING:
        signal.signal(number, signal.SIG_DFL)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


twins.rules()
safety_chain.kernels()
