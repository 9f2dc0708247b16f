"""Fault 27: of many runs that nobody looks at."""

from __future__ import annotations

import json
from typing import Any, Final

import numpy as np

from masking.app.workflows import batch
from masking.lab.records.journal import Journal
from masking.lab.runs.stopping import FAILED, TRIPPED
from tests.campaigns.bench import Bench
from tests.campaigns.table import Fault, Judgement
from tests.campaigns.twins import PLANT

_EXPERIMENT: Final = {
    "name": "Duffing oscillators",
    "plant": PLANT,
    "virtual": "duffing",
    "controller": {"rate": "1 kHz", "model": "setup_springs", "observer": "disturbance", "homing": 0.5},
    "initial": {"x1": -0.6, "x2": -0.5},
    "duration": 10,
}
_JUMP: Final[dict[str, Any]] = {"what": "add", "channel": 0, "at": 600, "value": 0.4}  # in the run itself
_MOVED: Final[dict[str, Any]] = {"what": "add", "channel": 0, "value": 0.1}  # V: a tenth of the limit, at rest too
_COOL: Final = 0.2  # s


def _trips(bench: Bench, judgement: Judgement) -> None:
    many, at = (3, 2) if bench.is_quick else (100, 17)
    served, folder = bench.anew(lockstep=True), bench.place()
    folder.mkdir(parents=True)
    (folder / "experiment.yaml").write_text(json.dumps(_EXPERIMENT), encoding="utf-8")
    plan = {"name": "a batch", "experiment": "experiment.yaml", "plant": served.address, "lockstep": True,
            "repeats": many, "cool": _COOL}  # fmt: skip
    (folder / "plan.yaml").write_text(json.dumps(plan), encoding="utf-8")

    def say(text: str) -> None:
        is_moved = text.startswith(f"run {at} of") and ", try 2:" in text
        served.damage(**(_JUMP if text.startswith(f"run {at - 1} of") else _MOVED if is_moved else {}))

    made = batch.run(folder / "plan.yaml", folder / "out", say=say)
    ends = [[end["end"] for end in one.ends] for one in made.runs]
    judgement.need(made.done == many, f"{made.done} of {many} runs ended as planned: {made.why}")
    judgement.need(ends[at - 1] == [TRIPPED, "finished"], f"run {at}: {', '.join(ends[at - 1])}")
    judgement.need(ends[at] == [FAILED, "finished"], f"run {at + 1}: {', '.join(ends[at])}")
    others = [end for i, end in enumerate(ends) if i not in {at - 1, at}]
    judgement.need(all(end == ["finished"] for end in others), f"others: {ends}")
    judgement.need(made.runs[at - 1].ends[0].get("cause") == "SENSOR_JUMP", f"tripped: {made.runs[at - 1].ends[0]}")
    refused = made.runs[at].ends[0].get("why", "")
    judgement.need("have moved by" in refused, f"a moved zero: {refused}")
    with Journal(folder / "out" / batch.JOURNAL) as journal:
        cooled = [entry["cooled"] for entry in journal.entries if "cooled" in entry]
    judgement.need(len(cooled) == many + 1, f"the rig cooled {len(cooled)} times, not {many + 1}")
    judgement.need(
        min(cooled, default=0.0) >= _COOL, f"the rig cooled for {min(cooled, default=0.0):g} s, not {_COOL:g}"
    )
    own = [served.record() for _ in range(2 * (many + 1) + 1)]
    judgement.need(
        len(list(served.folder.glob("session-*"))) == len(own), f"the plant had more than {len(own)} sessions"
    )
    zero = own.pop(2 * (at + 1))  # where no run followed
    judgement.need(not zero.array("input").any(), "a rig whose zero had moved was moved")
    # Of each other try one to look at the zeros, and one for the run.
    quiet = all(not one.array("input").any() for one in own[::2])
    judgement.need(quiet, "a rig was moved where its zeros were looked at")
    moved = sum(bool(np.any(one.array("input"))) for one in own[1::2])
    judgement.need(moved == many + 1, f"the plant's own records hold {moved} runs, not {many + 1}")
    judgement.say(f"{made.done} of {many} runs, SENSOR_JUMP in run {at}, which its second try made")
    judgement.say(f"run {at + 1} refused first: {refused.partition(';')[0]}; at least {min(cooled):.2f} s to cool")


FAULTS: Final = (
    Fault(
        27,
        "trip in run 17 of a batch of 100",
        "cool down, zero check, retry, go on; a moved zero is refused; no silent skip",
        _trips,
        is_long=True,
    ),
)
