"""Recorder: a process that takes the rows of a running loop out of its ring and adds them to a stream on disk.

    python -m masking.lab.records.recorder RING FOLDER

It outlives the loop: of a process that was killed it takes the rest from the ring. The loop never waits for it, and a
recorder that was killed itself is replaced by another one, which goes on in the same stream.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Final, final

from masking.display.characters import visible
from masking.display.json_text import Result
from masking.errors import RecordError
from masking.lab.records import stream
from masking.lab.records.child_process import Child, Supervisor
from masking.lab.records.ring import Ring, RingReader

FLUSH: Final = 0.02  # s between pages
SYNC: Final = 1.0  # s between the times at which all is brought to disk
MOST: Final = 1 << 20  # bytes of a page
STARTS: Final = 6  # recorders of one run at most
FULL: Final = 3  # exit status where no place is left
CLOSED: Final = "closed"
KILLED: Final = "killed"
WATCHING: Final = "recorder"  # name of the thread that waits for the end of a recorder
_NICE: Final = 5
_HELD: Final = 16.0  # s of rows in memory
_READY: Final = "ready"
_END: Final = 10.0  # s at most for the last rows


def main(arguments: list[str] | None = None) -> int:
    """Record until the ring is closed, or the process that writes it has ended; return the exit status."""
    ring, folder = sys.argv[1:3] if arguments is None else arguments
    try:
        _record(RingReader(ring), folder)
    except stream.NoSpaceError as error:
        _say(error)
        return FULL
    except RecordError as error:
        _say(error)
        return error.exit_status
    return 0


def _say(error: RecordError) -> None:
    """Say why the record ends; a full disk may hold what is said, too."""
    with contextlib.suppress(OSError):  # past the buffer, which would be tried once more at the end
        os.write(sys.stderr.fileno(), f"masking: {visible(str(error))}\n".encode(errors="backslashreplace"))


def _record(reader: RingReader, folder: str) -> None:
    writer = stream.StreamWriter(folder)
    reader.next = writer.next
    with contextlib.suppress(OSError):  # of a loop that is gone already, whose rows are still there
        os.write(sys.stdout.fileno(), f"{_READY}\n".encode())
    most, synced, lost = max(1, MOST // (8 * len(reader.columns))), time.monotonic(), 0
    while True:
        # Asked before the rows are taken: none follows those then.
        is_closed, is_killed = reader.is_closed, os.getppid() != reader.process
        while len((rows := reader.take(most)).table):
            writer.append(rows.first, rows.table)
            lost += rows.missed
        if is_closed or is_killed:
            break
        if time.monotonic() - synced > SYNC:
            writer.sync()
            synced = time.monotonic()
        time.sleep(FLUSH)
    writer.end({"why": CLOSED if is_closed else KILLED, "rows": writer.next, "lost": lost, "moved": writer.moved})
    if not is_closed:
        reader.path.unlink(missing_ok=True)


@final
class Recorder(Result):
    """The recorder of a run, as the process sees it that writes the rows into `ring`.

    The manifest is on disk once this is made: with unit and meaning of each column, the `rate` in Hz and what `more`
    says. The recorder is there then, too, unless `is_hurried`: rows wait for it. Where the folder is full, `spare` gets
    the rest. `lost` are rows that were put and are in no part of the stream, counted by `close`. A RecordError where
    the folder holds a stream already, or cannot be written.
    """

    json_names = ("ended", "lost", "note")

    def __init__(
        self,
        folder: str | Path,
        columns: Mapping[str, Mapping[str, str]],
        rate: float,
        spare: str | Path,
        *,
        is_hurried: bool = False,
        **more: object,
    ) -> None:
        self.folder, self.lost = Path(folder), 0
        units = {name: entry["unit"] for name, entry in columns.items()}
        number = os.urandom(8).hex()
        self.ring = Ring([*columns], rate, units, round(_HELD * rate), number=number)
        content = {"columns": dict(columns), "rate": rate, "number": number}
        content |= {"spare": str(Path(spare).absolute()), "ring": str(self.ring.path)}
        try:
            stream.begin(folder, {**content, **more})
            first = self._start()
            if not is_hurried and first.line() != _READY:
                first.wait()
                stream.remove(folder)
                raise RecordError(f"{folder}: the recorder could not begin; it said why")
        except BaseException:
            self.ring.close()
            raise
        self._supervisor = Supervisor(first, self._start, most=STARTS, final=[FULL], name=WATCHING)

    @property
    def process(self) -> int | None:
        """Number of the process that records; None where none does any more."""
        child = self._supervisor.child
        return None if child is None else child.pid

    @property
    def ended(self) -> int:
        """How many recorders ended before the rows did."""
        return len(self._supervisor.failures)

    @property
    def is_full(self) -> bool:
        """Whether no place is left for rows."""
        return FULL in self._supervisor.failures

    @property
    def is_lost(self) -> bool:
        """Whether rows are not recorded any more."""
        return self._supervisor.child is None

    @property
    def note(self) -> str:
        """What did not go as it should; empty where all did."""
        many, said = f"{self.ended} recorders were" if self.ended != 1 else "1 recorder was", list[str]()
        if self.is_full:
            said = ["no place was left for the stream of the run: it was stopped"]
        elif self.is_lost:
            said = [f"{many} killed, and no other was started: what followed was not streamed"]
        elif self.ended:
            said = [f"{many} killed and replaced"]
        return "; ".join([*said, *([f"{self.lost} rows were not streamed"] if self.lost else [])])

    def close(self) -> None:
        """Let the recorder take the last rows and end the stream; wait for it, and count what is missing."""
        self.ring.close(remove=False)
        self._supervisor.join(_END)
        self.lost = self.ring.count - stream.written(self.folder)
        self.ring.path.unlink(missing_ok=True)

    def discard(self) -> None:
        """Close it, and leave neither the stream nor its folder, unless something else is there."""
        self.close()
        stream.remove(self.folder)
        with contextlib.suppress(OSError):
            self.folder.rmdir()

    def _start(self) -> Child:
        return Child("masking.lab.records.recorder", [str(self.ring.path), str(self.folder)], nice=_NICE)


if __name__ == "__main__":
    sys.exit(main())
