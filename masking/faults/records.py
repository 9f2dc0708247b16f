"""Faults 18, 19 and 26: of the disk and of the process that writes the controller's record."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from masking.faults.bench import Bench
from masking.faults.table import Fault, Judgement
from masking.faults.twins import RATE
from masking.plants.udp import UdpPlant
from masking.records import stream, stream_content
from masking.records.recorder import Recorder
from masking.records.ring import cells
from masking.runs import hardware
from masking.runs.experiment import Experiment

_COLUMNS: Final = {f"c{i}": {"unit": "V", "meaning": ""} for i in range(30)}
_PAGE: Final = 20  # rows
_ROWS: Final = 2000
_STALLED: Final = 0.5  # s
_UNITS: Final = 120.0  # of the experiment's time
_FULL: Final = 200_000  # bytes that a file may have
_WRITTEN: Final = 20.0  # s at most until a recorder has written rows


def _cut(bench: Bench, judgement: Judgement) -> None:
    folder, number = bench.place(), 100 if bench.is_quick else 1000
    random = np.random.default_rng(2)
    table = random.standard_normal((_ROWS, len(_COLUMNS)))
    stream.begin(folder, {"columns": _COLUMNS, "rate": RATE, "spare": str(folder), "number": "0"})
    writer, ends = stream.StreamWriter(folder), []
    for first in range(0, _ROWS, _PAGE):
        writer.append(first, table[first : first + _PAGE])
        ends.append((folder / stream.ROWS).stat().st_size)
    writer.close()
    data, wrong, lost = (folder / stream.ROWS).read_bytes(), 0, 0
    for at in random.integers(0, len(data), number):
        (folder / stream.ROWS).write_bytes(data[:at])
        found = stream_content.read(folder)
        wrong += bool(found.damages) or not np.array_equal(found.table, table[: len(found.table)])
        there = min(_ROWS, _PAGE * (int(np.searchsorted(ends, at, side="right")) + 1))
        lost = max(lost, there - len(found.table))
    judgement.need(not wrong, f"{wrong} of {number} cuts are no exact prefix")
    judgement.need(lost / RATE <= 1.0, f"{lost} rows lost")
    judgement.say(f"{number - wrong} of {number} cuts are an exact prefix, at most {lost / RATE * 1e3:.0f} ms lost")


def _recorded(bench: Bench, judgement: Judgement, act: Callable[[int], None]) -> tuple[Recorder, int]:
    """Put rows at the rate, do something to the recorder after a third; return it, and the rows that are on disk.

    Demands that what is on disk is an exact prefix, and that no row made the loop wait or took a period of computing.
    """
    folder = bench.place()
    made, row = Recorder(folder, _COLUMNS, RATE, folder), np.zeros(len(_COLUMNS))
    held, begin = 0, time.monotonic()
    for n in range(_ROWS):
        if n == _ROWS // 3:
            judgement.need(made.process, "no recorder runs")
            act(made.process or 0)
        row[:] = n
        waits, used = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw, time.thread_time()
        made.ring.put(cells(row))
        is_long = time.thread_time() - used > 1.0 / RATE
        held += is_long or resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw > waits
        time.sleep(max(0.0, begin + (n + 1) / RATE - time.monotonic()))
    made.close()
    found = stream_content.read(folder)
    exact = np.array_equal(found.table[:, 0], np.arange(len(found.table)))
    judgement.need(exact and not found.damages, f"wrong rows: {found.damages}")
    judgement.need(held == 0, f"{held} rows made the loop wait")
    judgement.say(f"{_ROWS} rows put, {held} of them made the loop wait, {len(found.table)} on disk")
    if made.note:
        judgement.say(made.note)
    return made, len(found.table)


def _slow(bench: Bench, judgement: Judgement) -> None:
    """Let the recorder wait for its disk for a while."""

    def act(number: int) -> None:
        os.kill(number, signal.SIGSTOP)
        threading.Timer(_STALLED, os.kill, (number, signal.SIGCONT)).start()

    made, there = _recorded(bench, judgement, act)
    judgement.need(there == _ROWS and not made.ended, f"slow disk: {_ROWS - there} rows lost, {made.ended} ends")


def _killed(bench: Bench, judgement: Judgement) -> None:
    made, there = _recorded(bench, judgement, lambda number: os.kill(number, signal.SIGKILL))
    judgement.need(made.ended == 1, f"{made.ended} ends counted")
    judgement.need(there == _ROWS, f"{_ROWS - there} rows lost")


def _full(bench: Bench, judgement: Judgement) -> None:
    def act(number: int) -> None:
        resource.prlimit(number, resource.RLIMIT_FSIZE, (_FULL, _FULL))

    made, there = _recorded(bench, judgement, act)
    judgement.need(made.is_full, "the full disk is not reported")
    judgement.need(there < _ROWS, "the disk was not full")
    _slow(bench, judgement)
    _stopped(bench, judgement)


def _stopped(bench: Bench, judgement: Judgement) -> None:
    """Run an experiment whose disk becomes full: it stops in order, and what it lost is counted."""
    served, folder, is_full = bench.served(), bench.place(), False

    def fill(part: float) -> None:
        nonlocal is_full
        if part > 0.4 and not is_full:
            is_full = True
            until = time.monotonic() + _WRITTEN
            while not (folder / stream.ROWS).stat().st_size and time.monotonic() < until:
                time.sleep(0.01)  # the recorder may still start
            for number in _recorders():
                resource.prlimit(number, resource.RLIMIT_FSIZE, (1, 1))

    found = hardware.run(
        Experiment.load("huygens_rig").changed(duration=_UNITS),
        UdpPlant(served.address, patience=20.0),
        lockstep=True,
        acknowledge=True,
        progress=fill,
        stream=folder,
        spare=bench.place(),
    )
    end, own = found.manifest["rig"]["end"], served.record()
    judgement.need(end == "disk full", f"the run ended as {end}")
    judgement.need(own.manifest["end"] == "bye", f"the plant's session ended as {own.manifest['end']}")
    judgement.say(f"a run: {end}, {found.manifest['rig']['recorder']['note']}")


def _recorders() -> set[int]:
    """Return the numbers of the recorders of this process."""
    found = set()
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            name, _, rest = path.read_text().rpartition(")")
            if int(rest.split()[1]) == os.getpid() and b"records.recorder" in (path.parent / "cmdline").read_bytes():
                found.add(int(name.split()[0]))
    return found


FAULTS: Final = (
    Fault(
        18,
        "disk full, slow disk",
        "loop untouched, orderly stop, loss counted; 0 extra overruns",
        _full,
        in_real_time=True,
    ),
    Fault(19, "log writer killed", "loop goes on or stops by policy; counted", _killed, in_real_time=True),
    Fault(26, "power cut (truncate at random bytes)", "exact prefix; <= 1 s lost, never a wrong row", _cut),
)
