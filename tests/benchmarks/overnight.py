"""Overnight in miniature: 40 runs of a batch on a served twin, while processes are killed and a disk is full.

    python -m tests.benchmarks.overnight --json results/overnight.json

In three runs a sensor jumps, so that they trip. In others, the process of the controller is killed, the server of the
twin, the batch itself (once in a run, once between two, with half a line at the end of its journal), and the disk is
full. The server and the batch are started again. What happened is then looked up in the journal and in the plant's own
record: the commands of each session are compared, to the last bit, with those that the recordings hold.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from masking.app.workflows.batch import JOURNAL
from masking.errors import RecordError
from masking.lab.records import stream
from masking.lab.records.journal import Journal
from masking.lab.records.recording import Recording
from masking.lab.runs.batch_plan import PLANNED, UNREACHABLE
from tests.campaigns import children
from tests.campaigns.bench import Child
from tests.campaigns.twins import PLANT

EXPERIMENT = {
    "name": "Duffing oscillators",
    "plant": PLANT,
    "virtual": "duffing",
    "controller": {"rate": "1 kHz", "model": "setup_springs", "observer": "disturbance", "homing": 0.5},
    "initial": {"x1": -0.6, "x2": -0.5},
    "duration": 60,
}
VARIED = {"initial.x1": [-0.6, -0.5, -0.4, -0.3, -0.2], "initial.x2": [-0.5, -0.4, -0.3, -0.2]}
RUNS = 40
TRIPS = (5, 12, 29)
CONTROLLER, SERVER, FULL, BATCH, BETWEEN = 9, 17, 23, 31, 35
JUMP = {"what": "add", "channel": 0, "at": 600, "value": 0.4}  # V, after the homing
ROOM = 150_000  # bytes that a file may have where the disk is full
SOME = 150_000  # bytes of rows after which a process is killed: after the release
ROW = 3 * 8  # bytes of the commands of a tick
LIMIT = 300.0  # s


class Twin:
    """The server of a twin, started again at the same address."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"udp://127.0.0.1:{free.getsockname()[1]}"
        self.damage(None)
        self.start()

    def start(self) -> None:
        self.process = Child(children.serve, PLANT, str(self.folder), self.address, lockstep=True, steps=False)
        assert self.process.hear() == self.address

    def damage(self, chosen: dict[str, Any] | None) -> None:
        (self.folder / "damage.json").write_text(json.dumps(chosen or {}))

    def kill(self) -> None:
        self.process.close()


def entries(path: Path) -> list[dict[str, Any]]:
    """Return the whole lines of a journal that another process writes."""
    with contextlib.suppress(OSError):
        lines = path.read_bytes().split(b"\n")[:-1]
        return [json.loads(line.rpartition(b"\t")[0]) for line in lines if b"\t" in line]
    return []


def process_of(place: Path) -> int:
    """Return the process of a try; 0 where there is none."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            words = path.read_bytes().split(b"\0")
            if b"masking.app.workflows.batch_run" in words and str(place).encode() in words:
                return int(path.parts[2])
    return 0


class Night:
    """A batch under way, and what is done to it.

    Args:
        folder: an empty one.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.out, own = folder, folder / "out", folder / "twin"
        own.mkdir()
        self.twin = Twin(own)
        (folder / "experiment.yaml").write_text(json.dumps(EXPERIMENT))
        plan = {"name": "overnight in miniature", "experiment": "experiment.yaml", "plant": self.twin.address}
        plan |= {"lockstep": True, "vary": VARIED, "repeats": 2, "retries": 2, "cool": 0.1}
        (folder / "plan.yaml").write_text(json.dumps(plan))
        self.done: list[str] = []
        self.started = 0
        self.start()

    def start(self) -> None:
        """Start the batch, or go on with it."""
        self.started += 1
        command = [sys.executable, "-m", "masking", "rig", "batch", str(self.folder / "plan.yaml")]
        with (self.folder / f"said-{self.started}.txt").open("wb") as said:
            self.batch = subprocess.Popen(
                [*command, "--out", str(self.out), "--json"], stdout=said, stderr=subprocess.STDOUT
            )

    def place(self, run: int, number: int) -> Path:
        return self.out / "runs" / f"{run:02}-{number}"

    def wait(self, is_there: Callable[[], object]) -> None:
        """Wait until something is there, while the batch goes on.

        Raises:
            RuntimeError: it has ended.
        """
        while not is_there():
            if self.batch.poll() is not None:
                raise RuntimeError(f"the batch ended with status {self.batch.returncode}")
            time.sleep(0.01)

    def has(self, event: str, run: int, number: int = 1) -> bool:
        """Tell whether the journal has an event of a try."""
        return any(
            (e["event"], e.get("run"), e.get("try")) == (event, run, number) for e in entries(self.out / JOURNAL)
        )

    def under_way(self, run: int) -> None:
        """Wait until the first try of a run drives the plant, and some of its rows are on disk."""
        rows = self.place(run, 1) / stream.ROWS
        self.wait(lambda: rows.exists() and rows.stat().st_size > SOME)

    def live(self) -> None:
        """Do what is done to the batch, in the order of its runs, and wait for its end."""
        what = dict.fromkeys(TRIPS, self.trip)
        what |= {CONTROLLER: self.kill_controller, SERVER: self.kill_server, FULL: self.fill, BATCH: self.kill_batch}
        what |= {BETWEEN: self.kill_between}
        for run in sorted(what):
            what[run](run)
        self.batch.wait(LIMIT)

    def trip(self, run: int) -> None:
        self.wait(lambda: self.has("begin", run))
        self.twin.damage(JUMP)
        self.wait(lambda: self.has("end", run))
        self.twin.damage(None)

    def kill_controller(self, run: int) -> None:
        self.under_way(run)
        os.kill(process_of(self.place(run, 1)), signal.SIGKILL)

    def kill_server(self, run: int) -> None:
        self.under_way(run)
        self.twin.kill()
        time.sleep(5.0)
        self.twin.start()

    def fill(self, run: int) -> None:
        """Leave no room for the controller's recording, nor for its recorder."""
        self.wait(lambda: stream.is_in(self.place(run, 1)))
        process = process_of(self.place(run, 1))
        children = Path(f"/proc/{process}/task/{process}/children")
        self.wait(children.read_text)
        for one in (process, *map(int, children.read_text().split())):
            resource.prlimit(one, resource.RLIMIT_FSIZE, (ROOM, ROOM))

    def kill_batch(self, run: int) -> None:
        self.under_way(run)
        self.batch.kill()
        self.batch.wait()
        self.start()

    def kill_between(self, run: int) -> None:
        """Kill the batch before a run, in the midst of a line of its journal."""
        self.wait(lambda: self.has("begin", run - 1))
        self.wait(lambda: self.has("end", run - 1))
        self.batch.kill()
        self.batch.wait()
        with Journal(self.out / JOURNAL, 30.0), (self.out / JOURNAL).open("ab") as journal:
            journal.write(b'{"event": "begin", "ru')
        self.start()

    def close(self) -> None:
        self.batch.kill()
        self.batch.wait()
        self.twin.kill()


def commands(recording: Recording) -> bytes:
    """Return the commands of a recording, without rows of zero at both ends, to the last bit."""
    inputs = recording.array("input")
    moving = np.flatnonzero(inputs.any(axis=1))
    return np.ascontiguousarray(inputs[moving[0] : moving[-1] + 1]).tobytes() if len(moving) else b""


def sessions(folder: Path) -> Iterator[Recording]:
    """Give the plant's own records of the sessions that moved it, in order."""
    for path in sorted(folder.glob("session-*"), key=lambda one: int(one.name[8:])):
        with contextlib.suppress(RecordError):
            found = Recording.load(path)
            if found.array("input").any():
                yield found


def evaluate(night: Night) -> tuple[dict[str, Any], list[str]]:
    """Return what the journal and the plant's own record show, and what of it is wrong."""
    journal, broken = entries(night.out / JOURNAL), list[str]()

    def need(holds: object, text: str) -> None:
        broken.extend([] if holds else [text])

    begins = [e for e in journal if e["event"] == "begin"]
    ends = [e for e in journal if e["event"] == "end"]
    good = [e for e in ends if e["end"] in PLANNED]
    made = Counter(e["run"] for e in good)
    need(set(made) == set(range(1, RUNS + 1)), f"runs that did not end as planned: {set(range(1, RUNS + 1)) - {*made}}")
    need(all(count == 1 for count in made.values()), f"ended as planned more than once: {made.most_common(3)}")
    asked = [dict(zip(VARIED, values, strict=True)) for values in itertools.product(*VARIED.values())] * 2
    wrong = [e["run"] for e in begins if e["settings"] != asked[e["run"] - 1]]
    need(not wrong, f"runs with other settings: {wrong}")
    need(len(begins) == len(ends), f"{len(begins)} tries began, {len(ends)} ended")
    failed = {(e["run"], e["try"]): e for e in ends if e["end"] not in PLANNED}
    tripped = sorted(run for (run, _), e in failed.items() if e.get("cause") == "SENSOR_JUMP")
    need(tripped == sorted(TRIPS), f"tripped: {tripped}, not {sorted(TRIPS)}")
    injected = {*TRIPS, CONTROLLER, SERVER, FULL, BATCH}
    need({run for run, _ in failed} == injected, f"failed tries of {sorted({run for run, _ in failed})}")

    # The plant's own record: what moved it is what the recordings hold, each as often as it was run.
    own = [commands(one) for one in sessions(night.twin.folder)]
    records = [commands(Recording.load(night.place(e["run"], e["try"]))) for e in good]
    is_in = [[record in one for one in own] for record in records]
    need(all(map(any, is_in)), "a recording holds commands that the plant did not get")
    matched = [i for i, _ in enumerate(own) if any(row[i] for row in is_in)]
    need(len(matched) == RUNS, f"the plant's own records hold {len(matched)} whole runs, not {RUNS}")
    rest = [one for i, one in enumerate(own) if i not in matched]
    # The killed server kept no record of its session.
    need(len(rest) == len(injected) - 1, f"{len(rest)} sessions are of no run that ended, not {len(injected) - 1}")

    # What the tries that failed left: each is the beginning of a session, or its part since the release.
    kept = {}
    for (run, number), end in failed.items():
        if end["end"] == UNREACHABLE:
            continue
        place = night.place(run, number)
        folder = place / "ticks" if (place / "ticks").is_dir() else place
        try:
            held = commands(Recording.load(folder))
        except RecordError as error:
            need(holds=False, text=f"run {run}, try {number}: nothing of it was kept: {error}")
            continue
        wholes = sorted((one for one in rest if held[:-ROW] in one), key=len)
        whole = wholes[0] if wholes else b""
        rest = [one for one in rest if one is not whole]
        kept[f"{run}-{number}"] = {"ticks": len(held) // ROW, "of": len(whole) // ROW}
        need(whole or run == SERVER, f"run {run}, try {number}: its record is none of the plant's")
    facts = {"runs": len(made), "tries": len(begins), "whole runs in the plant's own record": len(matched),
             "failed tries": {f"{r}-{n}": e.get("cause", e["end"]) for (r, n), e in failed.items()},
             "kept of them": kept, "starts of the batch": night.started}  # fmt: skip
    return facts, broken


def main() -> int:
    """Live through the night, and print what came out; exit status 1 where something was lost or made twice."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="an empty folder for all records")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="masking-overnight-") as folder:
        began = time.monotonic()
        night = Night(chosen.keep or Path(folder))
        try:
            night.live()
            status = night.batch.returncode
            seconds = time.monotonic() - began
            facts, broken = evaluate(night)
            broken += [f"the batch ended with status {status}"] if status else []
        except RuntimeError as error:
            said = (night.folder / f"said-{night.started}.txt").read_text()
            raise SystemExit(f"{error}: {said[-2000:]}") from error
        finally:
            night.close()
    facts |= {"seconds": round(seconds, 1), "broken": broken}
    print(json.dumps(facts, indent=2))
    if chosen.json:
        chosen.json.parent.mkdir(parents=True, exist_ok=True)
        chosen.json.write_text(json.dumps(facts, indent=2))
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
