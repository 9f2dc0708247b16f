"""Fault 27: of many runs that nobody looks at."""

from __future__ import annotations

import json
from typing import Any, Final

import numpy as np

from masking.faults.bench import Bench
from masking.faults.table import Fault, Judgement
from masking.faults.twins import PLANT
from masking.records.recording import Recording
from masking.runs.stopping import TRIPPED
from masking.workflows import batch

_EXPERIMENT: Final = {
    "name": "Duffing oscillators",
    "plant": PLANT,
    "virtual": "duffing",
    "controller": {"rate": "1 kHz", "model": "setup_springs", "observer": "disturbance", "homing": 0.5},
    "initial": {"x1": -0.6, "x2": -0.5},
    "duration": 10,
}
_JUMP: Final[dict[str, Any]] = {"what": "add", "channel": 0, "at": 600, "value": 0.4}  # in the run itself
_COOL: Final = 0.2  # s


def _trips(bench: Bench, judgement: Judgement) -> None:
    many, at = (3, 2) if bench.is_quick else (100, 17)
    served, folder = bench.served(), bench.place()
    folder.mkdir(parents=True)
    (folder / "experiment.yaml").write_text(json.dumps(_EXPERIMENT), encoding="utf-8")
    plan = {"name": "a batch", "experiment": "experiment.yaml", "plant": served.address, "lockstep": True,
            "repeats": many, "cool": _COOL}  # fmt: skip
    (folder / "plan.yaml").write_text(json.dumps(plan), encoding="utf-8")

    def say(text: str) -> None:
        served.damage(**(_JUMP if text.startswith(f"run {at - 1} of") else {}))

    made = batch.run(folder / "plan.yaml", folder / "out", say=say)
    ends = [[end["end"] for end in one.ends] for one in made.runs]
    judgement.need(made.done == many, f"{made.done} of {many} runs ended as planned: {made.why}")
    judgement.need(ends[at - 1] == [TRIPPED, "finished"], f"run {at}: {', '.join(ends[at - 1])}")
    judgement.need(all(end == ["finished"] for i, end in enumerate(ends, 1) if i != at), f"others: {ends}")
    judgement.need(made.runs[at - 1].ends[0]["cause"] == "SENSOR_JUMP", f"tripped: {made.runs[at - 1].ends[0]}")
    own = [Recording.load(folder) for folder in sorted(served.folder.glob("session-*"), key=lambda x: int(x.name[8:]))]
    sessions = own[-2 * (many + 1) :]  # for each try one to look at the zeros, and the run
    quiet = all(not one.array("input").any() for one in sessions[::2])
    judgement.need(quiet, "a rig was moved where its zeros were looked at")
    moved = sum(bool(np.any(one.array("input"))) for one in sessions[1::2])
    judgement.need(moved == many + 1, f"the plant's own records hold {moved} runs, not {many + 1}")
    judgement.say(f"{made.done} of {many} runs, SENSOR_JUMP in run {at}, which its second try made")


FAULTS: Final = (
    Fault(
        27,
        "trip in run 17 of a batch of 100",
        "cool down, zero check, retry, go on; no silent skip",
        _trips,
        is_long=True,
    ),
)
