"""Runs hostile cases in processes of their own, with bounded memory and time, and judges what happened.

A process runs many cases and says before each which one it is; one that is silent for too long, or ends, is told, and
another one goes on with the next.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import os
import resource
import selectors
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from masking.errors import MaskingError
from tests.hostile.cases import SECRET, Read, RecordCase, Refused
from tests.hostile.corpus import MARKER

SECONDS = 10.0
BYTES = 2**30
LONGEST_MESSAGE = 2000
ROOT = Path(__file__).parents[2]
STARTS = (
    "os.system",
    "os.exec",
    "os.posix_spawn",
    "os.fork",
    "subprocess.Popen",
    "socket.connect",
    "pty.spawn",
    "pickle.find_class",
)


@dataclass(frozen=True)
class Verdict:
    """What happened in a case; nothing is wrong where `wrong` is empty."""

    name: str
    wrong: str
    detail: str
    seconds: float
    bytes: int


class Watch:
    """Python's own audit events of what is started."""

    events: list[str] = []  # noqa: RUF012  (an audit hook cannot be taken away)

    @classmethod
    def hook(cls, event: str, _: tuple[object, ...]) -> None:
        if event.startswith(STARTS):
            cls.events.append(event)


def judged_record(case: RecordCase, path: str | Path) -> tuple[str, str]:
    """Read a record; return what is wrong with what happened."""
    from masking.lab.records import readers

    try:
        found = readers.read(path, **case.given)
    except MaskingError as error:
        return _judged_refusal(str(error), case)
    except BaseException as error:  # whatever it is, it must not be
        return "traceback", f"{type(error).__name__}: {error}"
    if isinstance(case.wanted, Refused) and all(name in found.columns for name in case.given.get("needed", ())):
        return "taken silently", str({name: values[:3] for name, values in found.columns.items()})
    for name, values in getattr(case.wanted, "columns", {}).items():
        held = found.columns.get(name)
        if held is None or not np.array_equal(held, values):
            return "wrong numbers", name
    return "", "read"


def _judged_refusal(said: str, case: RecordCase) -> tuple[str, str]:
    if isinstance(case.wanted, Read):
        return "refused in vain", said
    if SECRET in said:
        return "shown", said
    if "\n" in said or "Traceback" in said or len(said) > LONGEST_MESSAGE + 5000 * ("a" * 5000 in said):
        return "no sentence", said
    missing = [word for word in getattr(case.wanted, "words", ()) if word not in said]
    return ("not told", f"{missing} not in: {said}") if missing else ("", said)


def work(kind: str, first: int, step: int, is_sample: bool) -> None:
    """Judge every `step`-th case from one on; print a line before and after each."""
    from tests.hostile import corpora

    sys.addaudithook(Watch.hook)
    warnings.simplefilter("ignore")
    logging.disable()
    cases = corpora.of(kind, is_sample)
    corpora.warm(kind)
    base = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for number in range(first, len(cases), step):
        print(json.dumps([number]), flush=True)
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            os.chdir(folder)
            Watch.events.clear()
            target = corpora.prepared(cases[number], folder)
            _forget_peak()
            resource.setrlimit(resource.RLIMIT_AS, (base + BYTES, resource.RLIM_INFINITY))
            before, start = _peak(), time.perf_counter()
            with Path(os.devnull).open("w") as nothing, contextlib.redirect_stderr(nothing):
                wrong, detail = corpora.judge_one(cases[number], target)
            resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            seconds, grown = time.perf_counter() - start, max(0, _peak() - before)
            if Watch.events or (folder / MARKER).exists():
                wrong, detail = "executed", f"{Watch.events}"
            os.chdir(ROOT)
        print(json.dumps([number, wrong, detail[:1000], seconds, grown]), flush=True)
    os._exit(0)  # threads of libraries do not count


def _forget_peak() -> None:
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _peak() -> int:
    """Return the largest resident memory since it was forgotten, in bytes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))


def run(kind: str, is_sample: bool = False, jobs: int = 2) -> list[Verdict]:
    """Judge all cases of a kind, or the sample of them, in several processes at a time."""
    from tests.hostile import corpora

    names = [corpora.name(case) for case in corpora.of(kind, is_sample)]
    found: dict[int, Verdict] = {}
    waiting = [(first, jobs) for first in range(jobs)]
    running: dict[subprocess.Popen[str], list[float | int]] = {}  # since when it is at which case, -1 at first; step
    with selectors.DefaultSelector() as ready, _ended(running):
        while waiting or running:
            while waiting:
                first, step = waiting.pop()
                process = _started(kind, first, step, is_sample)
                running[process] = [time.monotonic() + 60.0, -1, first, step]
                assert process.stdout is not None
                ready.register(process.stdout, selectors.EVENT_READ, process)
            for key, _ in ready.select(1.0):
                process = key.data
                line = key.fileobj.readline()  # type: ignore[union-attr]
                state = running[process]
                if not line:
                    ready.unregister(key.fileobj)
                    key.fileobj.close()
                    status, at = process.wait(), int(state[1])
                    del running[process]
                    if at >= 0 and at not in found:
                        found[at] = Verdict(names[at], "crash", f"status {status}", 0.0, 0)
                        if at + state[3] < len(names):
                            waiting.append((at + int(state[3]), int(state[3])))
                    elif status:
                        raise RuntimeError(f"a process of the corpus ended with status {status}")
                    continue
                said = json.loads(line)
                state[0], state[1] = time.monotonic(), said[0]
                if len(said) > 1:
                    found[said[0]] = _verdict(names[said[0]], *said[1:])
            for process, (since, at, *_) in running.items():
                if time.monotonic() - since > 2.0 * SECONDS and process.poll() is None:
                    found.setdefault(int(at), Verdict(names[int(at)], "hang", "", 2.0 * SECONDS, 0))
                    process.kill()
                    first = int(at) + int(running[process][3])
                    if first < len(names):
                        waiting.append((first, int(running[process][3])))
    assert len(found) == len(names), (len(found), len(names))
    return [found[number] for number in range(len(names))]


@contextlib.contextmanager
def _ended(running: Iterable[subprocess.Popen[str]]) -> Iterator[None]:
    """Let no process outlive a judgement that fails."""
    try:
        yield
    finally:
        for process in running:
            process.kill()
            with process:
                pass


def _verdict(name: str, wrong: str, detail: str, seconds: float, grown: int) -> Verdict:
    if not wrong and seconds > SECONDS:
        wrong, detail = "hang", f"{seconds:.1f} s"
    if not wrong and grown > BYTES:
        wrong, detail = "memory", f"{grown / 2**20:.0f} MiB"
    return Verdict(name, wrong, detail, seconds, grown)


def _started(kind: str, first: int, step: int, is_sample: bool) -> subprocess.Popen[str]:
    words = [sys.executable, "-m", "tests.hostile.judge", kind, str(first), str(step), "--sample" * is_sample]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "ARROW_NUM_THREADS": "1"}
    return subprocess.Popen(
        [word for word in words if word], cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True
    )


def summary(verdicts: Sequence[Verdict]) -> str:
    """Return a line of counts and one for each case that is wrong."""
    counts = Counter(verdict.wrong or "as it must be" for verdict in verdicts)
    slowest, largest = max(v.seconds for v in verdicts), max(v.bytes for v in verdicts)
    lines = [
        f"{len(verdicts)} cases: " + ", ".join(f"{count} {what}" for what, count in counts.most_common()),
        f"slowest {slowest:.2f} s, largest {largest / 2**20:.0f} MiB",
    ]
    return "\n".join([*lines, *(f"{v.wrong}: {v.name}: {v.detail}" for v in verdicts if v.wrong)])


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("kind")
    parser.add_argument("first", type=int)
    parser.add_argument("step", type=int)
    parser.add_argument("--sample", action="store_true")
    given = parser.parse_args()
    work(given.kind, given.first, given.step, given.sample)
