"""The verb rig batch: the runs of a plan, one after the other, whatever ends one of them.

All that is known is in `batch.journal`, in the folder of the results; started again, it goes on from there. Each try
has a folder `runs/NUMBER-TRY` of its own.
"""

from __future__ import annotations

import contextlib
import json
import pickle
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, final

from masking.app.workflows.batch_run import Try, facts
from masking.app.workflows.recover import TICKS, recover
from masking.display.printed_result import Printed
from masking.errors import MaskingError, RecordError
from masking.lab.plants.authentication import Key
from masking.lab.records import stream
from masking.lab.records.child_process import Child
from masking.lab.records.journal import Journal
from masking.lab.records.owned_folder import OwnedFolder
from masking.lab.records.recording import Recording
from masking.lab.runs import batch_plan
from masking.lab.runs.batch_plan import Progress
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.stopping import FAILED, INTERRUPTED
from masking.model.declaration.schema import BatchDeclaration
from masking.reports import batch_page

JOURNAL: Final = "batch.journal"
RUNS: Final = "runs"
_OTHERS: Final = 30.0  # s that the last run of a batch that was killed may take to end
_WRITTEN: Final = 5.0  # s that the recorder of a run that was killed may take to end
_LOOK: Final = 0.1  # s
_AGAIN: Final = 1.0  # s between tries to reach a plant
_ENDS: Final = 20.0  # s at most until a run that is asked to stop has


@dataclass(frozen=True, repr=False)
class Batch(Printed):
    """Outcome of a batch."""

    folder: Path  # of its results
    name: str  # of the plan
    runs: tuple[Progress, ...]  # all of them, in order
    why: str  # it ended before its runs did; empty where all were made

    @property
    def done(self) -> int:
        """How many runs ended as planned."""
        return sum(one.is_done for one in self.runs)

    def as_dict(self) -> dict[str, Any]:
        """Everything as JSON can hold it."""
        return {"name": self.name, "why": self.why, "runs": self.rows, "used": batch_plan.used(self.runs)}

    @property
    def sentence(self) -> str:
        """Number of runs that ended as planned, and why others did not."""
        more = sum(one.tries > 1 for one in self.runs)
        said = f"{self.name}: {self.done} of {len(self.runs)} runs ended as planned, {more} after more than one try"
        failed = len(self.runs) - self.done - sum(bool(one.left_out) for one in self.runs)
        said += f"; {failed} failed" if failed else ""
        return f"{said}; the others were not made: {self.why}." if self.why else f"{said}."

    @property
    def rows(self) -> list[dict[str, Any]]:
        """For each run its settings, how it ended, after how many tries, and what it took."""
        found = []
        for one in self.runs:
            last = one.ends[-1] if one.ends else {}
            trips = [end["cause"] for end in one.ends if "cause" in end]
            row: dict[str, Any] = {"run": one.run.number, **one.run.settings}
            row |= {"end": (one.left_out and "not made") or last.get("end", "not made"), "tries": one.tries}
            row |= {"trips": " ".join(trips), "chi": max(last.get("chi", {}).values(), default=None)}
            row |= {"seconds": sum(end.get("seconds", 0.0) for end in one.ends)}
            row |= {"energy": sum(end.get("energy", 0.0) for end in one.ends)}
            found.append(row | {"why": one.left_out or ("" if one.is_done else last.get("why", ""))})
        return found

    def __str__(self) -> str:
        return batch_page.text(self.sentence, self.rows)


def run(
    plan: str | Path,
    out: str | Path,
    *,
    plant: str | None = None,
    key: str | None = None,
    say: Callable[[str], None] = lambda _: None,
    progress: Callable[[float], None] = lambda _: None,
) -> Batch:
    """Make all runs of a plan that are not made yet.

    Args:
        plan: a batch file.
        out: folder of the results; one that holds a batch of the same plan is gone on with.
        plant: address in place of that of the plan.
        key: file with the key of the plant's server.
        say: called with a sentence for each run.
        progress: called with the part done.

    Raises:
        DeclarationError: the plan or its experiment is wrong.
        RecordError: the folder cannot be written, is that of another plan, or another process works on it.
    """
    declared, experiment, runs = batch_plan.load(plan)
    folder = Path(out)
    if sys.platform == "win32":
        raise RecordError(f"{folder}: Windows has no lock that processes hand on, as a batch needs; run it on Linux")
    with OwnedFolder(folder, _OTHERS) as owned, Journal(folder / JOURNAL) as journal:
        wanted = batch_plan.identity(experiment, runs)
        if not batch_plan.begin(journal.entries, wanted, folder):
            journal.add(event="batch", plan=wanted, name=declared.name, runs=len(runs))
        found = batch_plan.progress(runs, journal.entries)
        server = plant or declared.plant, None if key is None else Key.read(key)
        why = _Worker(declared, owned, journal, found, experiment, *server, say).work(progress)
        made = Batch(folder, declared.name, tuple(found), why)
        batch_page.save(declared.name, made.sentence, made.rows, made.as_dict(), folder)
    return made


@final
@dataclass
class _Worker:
    """Makes the runs of a batch, and keeps up to date what is known of each."""

    declared: BatchDeclaration
    owned: OwnedFolder  # of the results
    journal: Journal
    found: Sequence[Progress]
    experiment: Experiment
    address: str | None  # of the plant; None for the twin
    key: Key | None  # of the plant's server
    say: Callable[[str], None]
    has_run: bool = False
    outcome: Mapping[str, Any] = field(default_factory=dict)  # of the last try
    waited: float = 0.0  # s since the plant was reached
    last: str = ""  # what was said when it was not
    ended: float = 0.0  # when the last try did, s of the monotonic clock

    def work(self, progress: Callable[[float], None]) -> str:
        """Make what is not made yet; return why not all of it could be."""
        for one in self.found:
            if one.open:
                self._end(one, self._left(self._place(one)))
        for number, one in enumerate(self.found):
            while not one.is_done and one.counted <= self.declared.retries:
                if why := self._over():
                    for other in self.found[number:]:
                        other.left_out = "" if other.is_done or other.counted > self.declared.retries else why
                    return why
                self._try(one)
            progress((number + 1) / len(self.found))
        return ""

    def _over(self) -> str:
        """Reason why no other run may begin; empty where one may."""
        spent, budget = batch_plan.used(self.found), self.declared.budget
        for name, unit in (("time", " s"), ("trips", ""), ("energy", " J")):
            most = getattr(budget, name)
            if most is not None and spent[name] >= most:
                return f"the budget of {name}, {most:g}{unit}, is used up"
        if self.waited > self.declared.patience:
            return f"the plant was not reached for {self.waited:.0f} s: {self.last}"
        cause = self.outcome.get("cause", "")
        if cause in batch_plan.PEOPLE:  # only a person may arm the rig again
            return f"the run was stopped by a person ({cause}); look at the rig, then start the same again"
        return ""

    def _place(self, one: Progress) -> Path:
        return self.owned.folder / RUNS / f"{one.run.number:0{len(str(len(self.found)))}}-{one.tries}"

    def _try(self, one: Progress) -> None:
        begin: dict[str, Any] = {"event": "begin", "run": one.run.number}
        if self.has_run:
            time.sleep(self.declared.cool)
            begin["cooled"] = round(time.monotonic() - self.ended, 3)
        one.tries += 1
        place, declared = self._place(one), self.declared
        made = batch_plan.changed(self.experiment, one.run.settings)
        batch_plan.write(made, place)
        self.journal.add(**begin, **{"try": one.tries}, settings=dict(one.run.settings))
        one.open, self.has_run = one.tries, True
        zeros = [end["zero"] for other in self.found for end in other.ends if end.get("zero")]
        server, rest = (self.address, self.key, declared.lockstep), (declared.drift, declared.patience)
        begun = time.monotonic()
        with tempfile.TemporaryFile() as file:
            file.write(pickle.dumps(Try(made, place, *server, *rest, zeros[0] if zeros else {})))
            file.seek(0)
            # The folder is the child's, too: who goes on after a crash waits for its end.
            handles = [self.owned.handle, file.fileno()]
            child = Child("masking.app.workflows.batch_run", [str(file.fileno())], is_apart=False, handles=handles)
            try:
                said = child.output(_ENDS)
            except BaseException:
                self._end(one, self._left(place, {"end": INTERRUPTED}))
                raise
        lines = [line for line in said.splitlines() if line.startswith("{")]
        outcome: dict[str, Any] = {"end": FAILED, "why": f"its process ended with status {child.wait()}"}
        outcome = json.loads(lines[-1]) if lines else {**outcome, "seconds": time.monotonic() - begun}
        if not lines or stream.is_in(place):
            outcome = self._left(place, outcome)
        self._end(one, outcome)
        is_there = outcome["end"] != batch_plan.UNREACHABLE
        self.waited, self.last = 0.0 if is_there else self.waited + outcome["seconds"], outcome.get("why", "")
        if not is_there:
            time.sleep(_AGAIN)

    def _left(self, place: Path, end: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Outcome of a try from its folder, with what its stream holds, and `end` unless it ended as planned."""
        found = self._kept(place)
        return found if end is None or found["end"] in batch_plan.PLANNED else {**found, **end}

    def _kept(self, place: Path) -> dict[str, Any]:
        """Outcome of the recording that a try saved, or that is recovered from its stream."""
        why, until = "nothing of it was recorded", time.monotonic() + _WRITTEN
        while stream.is_in(place):
            try:
                found = recover(place)
            except MaskingError as error:
                if time.monotonic() < until:  # its recorder may still write
                    time.sleep(_LOOK)
                    continue
                why = f"what it streamed is not recovered: {error}"
                break
            inputs = Recording.load(place / TICKS).array("input")
            spent = batch_plan.energy(self.experiment, inputs, self.experiment.sampled.rate)
            kept = f"{found.rows} ticks of it are in {place}"
            return {"end": batch_plan.CUT_OFF, "why": kept, "seconds": found.seconds, "energy": spent}
        with contextlib.suppress(RecordError, KeyError):
            return facts(self.experiment, Recording.load(place)) | {"seconds": 0.0}
        return {"end": batch_plan.CUT_OFF, "why": why, "seconds": 0.0}

    def _end(self, one: Progress, outcome: Mapping[str, Any]) -> None:
        """Write down how a try ended."""
        entry = {"event": "end", "run": one.run.number, "try": one.open, **outcome}
        self.journal.add(**entry)
        one.ends.append(entry)
        one.open, self.ended = 0, time.monotonic()
        self.outcome = outcome if self.has_run else {}  # what ended a former batch was looked at before this one began
        why = f": {outcome['why']}" if outcome.get("why") else ""
        self.say(f"run {one.run.number} of {len(self.found)}, try {entry['try']}: {outcome['end']}{why}")
