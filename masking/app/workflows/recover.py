"""Recover: the recording of a run that did not end in order, from what it had streamed to disk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.app.workflows.output_folders import RUN, own_folder
from masking.compile.numerics.arrays import Array
from masking.display.printed_result import Printed
from masking.errors import MaskingError, RecordError
from masking.lab.plants import controller_session
from masking.lab.records import foreign_json, stream, stream_reader, tick_record
from masking.lab.records.recorder import CLOSED
from masking.lab.records.recording import Recording
from masking.lab.records.ring import RingReader
from masking.lab.records.stop_switch import is_running
from masking.lab.records.stream_reader import Stream
from masking.lab.records.tick_times import timing
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.loop_rows import RowLayout, samples_after
from masking.lab.runs.realtime import LOOP
from masking.lab.runs.stopping import KILLED
from masking.model.declaration import registry
from masking.reports import one_page, run_report

TICKS: Final = "ticks"
_SLOWEST, _FASTEST = 1e-9, 1e9  # Hz
_OF_RUN: Final = ("created", "commit", "files", "versions", "declarations")
_PLANTS: Final = "it is the plant's own record of a session, whose server was killed"


@dataclass(frozen=True)
class _Column:
    """What the manifest of a stream says of a column."""

    unit: str
    meaning: str


@dataclass(frozen=True)
class _Run:
    """What the manifest of the stream of a run has to say, by its keys."""

    columns: dict[str, _Column]
    rate: float
    lockstep: bool
    created: str
    commit: str | None
    files: dict[str, str]
    versions: dict[str, str]
    declarations: dict[str, Any]
    inputs: dict[str, dict[str, Any]]


@dataclass(frozen=True)
class _Session:
    """What the manifest of the stream of a plant's session has to say, by its keys."""

    columns: dict[str, _Column]
    rate: float
    name: str
    created: str
    clock: str
    watchdog: float


@dataclass(frozen=True)
class _End:
    """What the last page of a stream has to say."""

    why: str
    rows: int


@dataclass(frozen=True, repr=False)
class Recovered(Printed):
    """Recording of a run that was killed."""

    folder: Path  # of the recordings
    ticks: Path  # folder of the recording of all ticks
    rows: int  # ticks that are there, the homing included
    homing: int  # how many of them are in the homing
    seconds: float  # from the first to the last
    missing: int  # rows before the end of the stream that are not there
    end: str  # why the stream ends
    damages: tuple[str, ...]  # what in it was changed or is missing, a sentence each
    recording: Recording | None  # that of the run since the release; None where there is none
    why: str  # why there is none, or no other column than those of the loop; empty otherwise

    def __str__(self) -> str:
        ticks = f"{self.rows} ticks, {self.seconds:.3f} s, of which {self.homing} in the homing: {self.ticks}"
        missing = f"{self.missing} ticks are missing" if self.missing else "no tick is missing"
        run = self.why or f"the run since the release, {len(self.recording or ())} samples: {self.folder}"
        return "\n".join([ticks, missing, self.end, *self.damages, run])

    def as_dict(self) -> dict[str, Any]:
        """Everything as JSON can hold it."""
        names = ("rows", "homing", "seconds", "missing", "end", "why")
        found = {name: getattr(self, name) for name in names} | {"damages": list(self.damages)}
        recording = str(self.folder) if self.recording is not None else None
        return {**found, "ticks": str(self.ticks), "recording": recording}


def recover(folder: str | Path, *, out: str | Path | None = None, overwrite: bool = False) -> Recovered:
    """Make the recording of a run on a rig that was killed, or whose recording could not be saved.

    `ticks` below the folder gets a row for each tick, the homing included. The run since the release becomes what it
    would have been, whatever became of the files of the experiment since, but for those that its inputs come from. Once
    all is saved, the stream is removed, unless something in it was damaged.

    Args:
        folder: that the run was to be saved in.
        out: folder to save in; by default the same.
        overwrite: whether an earlier recording there may be replaced.

    Raises:
        RecordError: there is no stream, or no row in it, it is still being written, or the folder cannot be written.
    """
    target = Path(folder if out is None else out)
    found = _read(folder)
    held = [*(name for name in RUN if name != stream.MANIFEST), f"{TICKS}/{RUN[0]}"]
    with own_folder(target, *held, overwrite=overwrite):
        whole, end = _with_ring(found), _end(found)
        if not len(whole.numbers):
            unread = f"no tick of the run is readable ({'; '.join(found.damages)})"
            why = unread if found.damages else "the run ended before its first tick"
            raise RecordError(f"{folder}: {why}; remove {stream.MANIFEST} and {stream.ROWS}")
        missing = max(int(whole.numbers[-1]) + 1, (found.end or {}).get("rows", 0)) - len(whole.numbers)
        lost = {"missing": missing, "end": end, "damages": list(found.damages)}
        is_plants = _is_of_plant(found)
        kept = {name: found.manifest[name] for name in (controller_session.FACTS if is_plants else _OF_RUN)}
        kept |= {"recovered": lost} if is_plants else {"name": "the ticks of a run", "recovered": lost}
        ticks = target if is_plants else target / TICKS
        tick_record.save(whole, ticks, kept)
        column = dict(zip(found.manifest["columns"], whole.table.T, strict=True))
        recording, why = (None, _PLANTS) if is_plants else _run(whole, column, lost)
        if recording is not None:
            recording.save(target, overwrite=True)
            run_report.report(recording, target)
            one_page.remove(target)
        if not found.damages:
            stream.remove(folder)
            reader = _ring(found)
            if reader is not None and not is_running(reader.process):
                reader.path.unlink(missing_ok=True)
        seconds = float(column["tick"][-1] - column["tick"][0] + 1.0) / float(found.manifest["rate"])
        homing = 0 if is_plants else int(np.count_nonzero(column["index"] < 0))
        counts = len(whole.numbers), homing, seconds, missing
        return Recovered(target, ticks, *counts, end, found.damages, recording, why)


def _is_of_plant(found: Stream) -> bool:
    return "declarations" not in found.manifest


def _read(folder: str | Path) -> Stream:
    """Stream whose manifest and last page say what they have to; rows that are no ticks are left out."""
    found = stream_reader.read(folder)
    where, is_plants = f"{Path(folder) / stream.MANIFEST}", _is_of_plant(found)
    foreign_json.check(found.manifest, _Session if is_plants else _Run, where)
    if found.end is not None:
        foreign_json.check(found.end, _End, f"the last page of {Path(folder) / stream.ROWS}")
    names, rate = list(found.manifest["columns"]), found.manifest["rate"]
    if not _SLOWEST <= rate <= _FASTEST:
        raise RecordError(f"{where}: rate: must be from {_SLOWEST:g} to {_FASTEST:g} Hz, not {rate:g}")
    counted = [tick_record.TICK] if is_plants else [*LOOP]
    if absent := [name for name in counted if name not in names]:
        raise RecordError(f"{where}: columns: there is no '{absent[0]}'; it is no stream of a run")
    counts = [tick_record.column(found.tables, names.index(name)) for name in counted if name in {"tick", "index"}]
    sound = np.isfinite(counts).all(axis=0)
    if sound.all():
        return found
    said = f"{np.count_nonzero(~sound)} rows hold no number of a tick, and were left out"
    damages = (*found.damages, f"{stream.ROWS}: {said}")
    return replace(found, numbers=found.numbers[sound], tables=(found.table[sound],), damages=damages)


def _end(found: Stream) -> str:
    """Reason for the end of the stream, as a sentence."""
    if found.end is None:
        return "it is cut off: the machine stopped, or the recorder was killed too; what followed may be missing"
    if found.end["why"] == CLOSED:
        return "the run ended in order, but its recording was not saved"
    return "the process of the controller was killed; the recorder took all rows that it had made"


def _ring(found: Stream) -> RingReader | None:
    """Rows in memory that the stream was taken from, if they are still there."""
    try:
        reader = RingReader(found.manifest["ring"])
    except (RecordError, KeyError, TypeError):
        return None
    is_same = reader.facts.get("number") == found.manifest.get("number")
    return reader if is_same and [*reader.columns] == [*found.manifest["columns"]] else None


def _with_ring(found: Stream) -> Stream:
    """Stream with the rows that only memory still holds."""
    reader = _ring(found) if found.end is None else None
    if reader is None:
        return found
    reader.next = int(found.numbers[-1]) + 1 if len(found.numbers) else 0
    rows = reader.take()
    numbers = np.concatenate([found.numbers, rows.first + np.arange(len(rows.table))])
    return replace(found, numbers=numbers, tables=(*found.tables, rows.table))


def _run(found: Stream, column: Mapping[str, Array], lost: Mapping[str, Any]) -> tuple[Recording | None, str]:
    """Recording since the release; or None, and why."""
    if not (column["index"] >= 0).any():
        return None, "the run ended in the homing, before the release"
    try:
        experiment = Experiment(registry.restored(found.manifest["declarations"]))
        for name, entry in experiment.inputs.entry().items():
            if entry.get("sha256") != found.manifest["inputs"][name].get("sha256"):
                return None, f"{entry['file']} has changed since the run; put it back as it was, and recover it again"
        layout = RowLayout(experiment)
        if [*layout.columns.items()] != [*found.manifest["columns"].items()]:
            return None, "another version of this program has written it; recover it with that version"
        after = samples_after(experiment, experiment.sampled)
        counters = {"late": int(np.count_nonzero(column["late"])), "missed": int(np.sum(np.diff(column["tick"]) - 1.0))}
        is_lockstep = bool(found.manifest["lockstep"])
        clock = {} if is_lockstep else {"lateness": column["lateness"]}
        times = timing(column["tick"].astype(np.int64), **clock, controller=column["duration"])
        outcome = {"end": KILLED, "counters": counters, "recovered": dict(lost), "timing": times}
        made = layout.recording(found.table, after, lockstep=is_lockstep, outcome=outcome)
        made.manifest.update({name: found.manifest[name] for name in _OF_RUN})
        return made, ""
    except MaskingError as error:
        return None, f"the run since the release could not be made: {error}"
