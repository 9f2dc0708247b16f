"""Faults 18, 19 and 26: of the disk and of the process that writes the controller's record."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from masking.lab.plants.udp import UdpPlant
from masking.lab.records import stream, stream_reader
from masking.lab.records.recorder import WATCHING, Recorder
from masking.lab.records.ring import cells
from masking.lab.runs import rig_run
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.realtime import Row
from tests.campaigns.bench import Bench, Ended, Waits
from tests.campaigns.table import Fault, Judgement
from tests.campaigns.twins import RATE

if sys.platform != "win32":
    import resource

_COLUMNS: Final = {f"c{i}": {"unit": "V", "meaning": ""} for i in range(30)}
_PAGE: Final = 20  # rows
_ROWS: Final = 2000
_STALLED: Final = 0.5  # s
_UNITS: Final = 120.0  # of the experiment's time
_FULL: Final = 50_000  # bytes that a file may have
_LOOP_ROWS: Final = 1000  # of a controller in real time
_FILLED: Final = 0.4  # of a run, after which its disk is full
_PATIENCE: Final = 2.0  # s in a tick that the end of a recorder is waited for: the plant waits for commands longer


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
        found = stream_reader.read(folder)
        wrong += bool(found.damages) or not np.array_equal(found.table, table[: len(found.table)])
        there = min(_ROWS, _PAGE * (int(np.searchsorted(ends, at, side="right")) + 1))
        lost = max(lost, there - len(found.table))
    judgement.need(not wrong, f"{wrong} of {number} cuts are no exact prefix")
    judgement.need(lost / RATE <= 1.0, f"{lost} rows lost")
    judgement.say(f"{number - wrong} of {number} cuts are an exact prefix, at most {lost / RATE * 1e3:.0f} ms lost")


def _recorded(
    bench: Bench, judgement: Judgement, act: Callable[[int], None], *, is_loop: bool = False
) -> tuple[Recorder, int, int]:
    """Put rows at the rate, do something to the recorder after a third; return it, the rows put, and those on disk.

    Demands that what is on disk is an exact prefix, and that no row made the loop wait or took a period of computing.

    Args:
        bench: of the fault.
        judgement: of it.
        act: is given the number of the recorder's process.
        is_loop: the rows are those of a controller that runs on the served twin, in real time.
    """
    folder, waits, count = bench.place(), Waits(), _LOOP_ROWS if is_loop else _ROWS
    made, row = Recorder(folder, _COLUMNS, RATE, folder), np.zeros(len(_COLUMNS))
    put = waits.watched(made.ring.put)

    def on_tick(tick: int) -> None:
        if tick == count // 3:
            judgement.need(made.process, "no recorder runs")
            act(made.process or 0)

    def on_row(_: Row) -> None:
        row[:] = waits.calls
        put(cells(row))

    if is_loop:
        _undisturbed(bench.run(lockstep=False, samples=count, on_row=[on_row], on_tick=on_tick), judgement)
    else:
        begin = time.monotonic()
        for n in range(count):
            on_tick(n)
            row[:] = n
            put(cells(row))
            time.sleep(max(0.0, begin + (n + 1) / RATE - time.monotonic()))
    made.close()
    found = stream_reader.read(folder)
    exact, there = np.array_equal(found.table[:, 0], np.arange(len(found.table))), len(found.table)
    judgement.need(exact and not found.damages, f"wrong rows: {found.damages}")
    judgement.need(not waits.held, f"{len(waits.held)} rows made the loop wait")
    judgement.need(made.lost == waits.calls - there, f"{made.lost} lost rows counted of {waits.calls - there}")
    judgement.say(f"{waits.calls} rows put, {len(waits.held)} of them made the loop wait, {there} on disk")
    if made.note:
        judgement.say(made.note)
    return made, waits.calls, there


def _undisturbed(ended: Ended, judgement: Judgement) -> None:
    """Demand that a run went on to its end, and that the plant saw nothing of what happened to the recorder."""
    judgement.need(ended.run.reason == "finished", f"the loop ended as {ended.cause or ended.run.reason}")
    judgement.need(ended.own.manifest["latch"] is None, f"the plant tripped: {ended.own.manifest['latch']}")
    sent, counted = len(ended.run.index), ended.own.manifest["counters"].get("commands", 0)
    judgement.need(counted == sent, f"{counted} of {sent} commands acted")


def _slow(bench: Bench, judgement: Judgement) -> None:
    """Let the recorder wait for its disk for a while."""

    def act(number: int) -> None:
        os.kill(number, signal.SIGSTOP)
        threading.Timer(_STALLED, os.kill, (number, signal.SIGCONT)).start()

    made, count, there = _recorded(bench, judgement, act)
    judgement.need(there == count and not made.ended, f"slow disk: {count - there} rows lost, {made.ended} ends")


def _killed(bench: Bench, judgement: Judgement) -> None:
    for is_loop in (False, True):
        made, count, there = _recorded(
            bench, judgement, lambda number: os.kill(number, signal.SIGKILL), is_loop=is_loop
        )
        judgement.need(made.ended == 1, f"{made.ended} ends counted")
        judgement.need(there == count, f"{count - there} rows lost")


def _full(bench: Bench, judgement: Judgement) -> None:
    def act(number: int) -> None:
        resource.prlimit(number, resource.RLIMIT_FSIZE, (_FULL, _FULL))

    for is_loop in (False, True):
        made, _, _ = _recorded(bench, judgement, act, is_loop=is_loop)
        judgement.need(made.is_full, "the full disk is not reported")
        judgement.need(made.lost, "the disk was not full")
    _slow(bench, judgement)
    _stopped(bench, judgement)


def _stopped(bench: Bench, judgement: Judgement) -> None:
    """Run an experiment whose disk becomes full: it stops in order, and what it lost is counted."""
    served, folder, before = bench.served(), bench.place(), set(threading.enumerate())
    waiting = list[threading.Thread]()

    def fill(part: float) -> None:
        if waiting:  # there are rows since, which the recorder cannot write: whatever the machine does, it ends of them
            waiting[0].join(_PATIENCE)
        elif part > _FILLED:
            waiting.extend(one for one in threading.enumerate() if one.name == WATCHING and one not in before)
            for number in _recorders():
                resource.prlimit(number, resource.RLIMIT_FSIZE, (1, 1))

    found = rig_run.run(
        Experiment.load("huygens_rig").changed(duration=_UNITS),
        UdpPlant(served.address, patience=20.0),
        rig_run.RunSettings(
            lockstep=True,
            acknowledge=True,
            progress=fill,
            stream=folder,
            spare=bench.place(),
        ),
    )
    rig, own = found.manifest["rig"], served.record()
    judgement.need(rig["end"] == "disk full", f"the run ended as {rig['end']}")
    judgement.need(own.manifest["end"] == "bye", f"the plant's session ended as {own.manifest['end']}")
    judgement.need(not own.array("input")[-1].any(), "the plant was not left at zero")
    lost = own.manifest["counters"]["commands"] - len(stream_reader.read(folder).table)
    counted = rig.get("recorder", {}).get("lost", 0)
    judgement.need(counted == lost > 0, f"{counted} lost rows counted of {lost}")
    judgement.say(f"a run: {rig['end']}, {rig.get('recorder', {}).get('note', '')}")


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
