"""Faults 20 and 21: of who looks at a run, and of emergency stops."""

from __future__ import annotations

import contextlib
import http.client
import os
import signal
import subprocess
import sys
import threading
import time
import urllib.parse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from masking.app.workflows.operator_process import Attendant, attend
from masking.compile.numerics.arrays import Array
from masking.control.stepwise_controller import SampledStep
from masking.errors import MaskingError
from masking.lab.plants.safety_chain import Chain
from masking.lab.runs import safety_limits
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.loop_rows import known
from masking.lab.runs.operator_link import ABSENCE, Operator
from tests.campaigns.bench import Bench, Ended, Waits
from tests.campaigns.table import Fault, Judgement

_EXPERIMENT: Final = "huygens_rig"  # whose page is shown
_LOOKED: Final = 1.0  # s in which somebody looks at the page
_ROWS: Final = 4500  # samples that a run has which nobody needs to look at
_MOST: Final = 60_000  # samples of a run that ends by a trip
_AT: Final = 100  # tick of the stop
_PERIODS: Final = 2  # that a stop may take
_FILE: Final = 0.01  # s between looks at a file that stops a run
_ANSWER: Final = 4.0  # s at most until the page answers, less than a plant in lockstep waits


def _stopped(ended: Ended, said: str, judgement: Judgement, at: int = _AT) -> None:
    """Demand a trip by an emergency stop within two ticks of one, and a plant at zero since."""
    later = max(0, ended.tick - at)  # a plant that says so itself gives no sample of that tick
    judgement.need(ended.cause == "ESTOP", f"{said}: ended as {ended.cause or ended.run.reason}, not ESTOP")
    judgement.need(said in str(ended.run.trip), f"{said}: not named in '{ended.run.trip}'")
    judgement.need(later <= _PERIODS, f"{said}: {later} ticks later, more than {_PERIODS}")
    inputs = ended.own.array("input")[ended.own["tick"] > ended.tick]
    judgement.need(not inputs.any(), f"{said}: the plant got a command after the trip")
    judgement.say(f"{said}: {later} ticks")


def _emergency(bench: Bench, judgement: Judgement) -> None:
    with _Looked(Experiment.load(_EXPERIMENT)) as looked:
        ended = looked.run(bench, lockstep=True, samples=_MOST, on_tick=_at(looked.press))
    _stopped(ended, "on the page", judgement)
    _stopped(*_by_command(bench, judgement))
    file = bench.place()
    file.parent.mkdir(parents=True, exist_ok=True)
    with Operator(stop_file=file) as operator:
        ended = bench.run(look=operator.look, on_tick=_at(file.touch), samples=_MOST)
    wall = ended.run.wall[_AT:]  # looked at every 10 ms, at the begin of a tick
    took, most = float(wall[-1] - wall[0]), _FILE + float(np.diff(ended.run.wall[_AT - 1 :]).max())
    judgement.need(ended.cause == "ESTOP", f"by a file: ended as {ended.cause or ended.run.reason}, not ESTOP")
    judgement.need(took <= most, f"by a file: {took * 1e3:.1f} ms, more than {most * 1e3:.1f}")
    judgement.need(not ended.own.array("input")[ended.own["tick"] > ended.tick].any(), "by a file: not at zero")
    judgement.say(f"by a file: {took * 1e3:.1f} ms")
    _stopped(bench.run(damage={"what": "press", "at": _AT}), "at the plant", judgement)


def _by_command(bench: Bench, judgement: Judgement) -> tuple[Ended, str, Judgement, int]:
    """Stop a run by `masking rig stop`, in a process of its own; return it, and the tick at which that had ended."""
    command = [sys.executable, "-m", "masking", "rig", "stop", str(os.getpid())]
    stopping, over = list[subprocess.Popen[bytes]](), list[int]()

    def on_tick(row: int) -> None:
        if row == _AT - 1:
            stopping.append(subprocess.Popen(command, stdout=subprocess.DEVNULL))  # this program itself
        elif stopping and not over:
            if stopping[0].poll() is None:
                time.sleep(1e-3)  # the run is still there once it comes
            else:
                over.append(row)

    with Operator() as operator:
        ended = bench.run(look=operator.look, on_tick=on_tick, samples=_MOST)
        status = [one.wait() for one in stopping]
    judgement.need(status == [0], f"'masking rig stop' ended with {status}")
    return ended, "from the command line", judgement, over[0] + 1 if over else ended.tick


def _at(act: Callable[[], None]) -> Callable[[int], None]:
    """Return what does something at the end of the tick before `_AT`."""

    def on_tick(row: int) -> None:
        if row == _AT - 1:
            act()

    return on_tick


def _unattended(bench: Bench, judgement: Judgement) -> None:
    cases = [(number, is_attended) for number in (signal.SIGKILL, signal.SIGSTOP) for is_attended in (False, True)]
    for number, is_attended in cases[1:2] if bench.is_quick else cases:
        said = f"{'closed' if number == signal.SIGKILL else 'stalled'}{', attended' * is_attended}"
        with _Looked(Experiment.load(_EXPERIMENT), is_attended=is_attended) as looked:
            ended = looked.run(bench, number, lockstep=False, samples=_MOST if is_attended else _ROWS)
        gone, waits, last = looked.gone, looked.waits, looked.looks[-1][1]
        judgement.need(gone and gone < last, f"{said}: the page was there until the run ended")
        held = sum(instant > gone for instant in waits.held)
        judgement.need(not held, f"{said}: {held} rows and looks made the loop wait")
        if is_attended:
            _absent(ended, looked, said, judgement)
        else:
            judgement.need(last - gone > ABSENCE, f"{said}: the run ended {last - gone:.2f} s later")
            judgement.need(ended.run.reason == "finished", f"{said}: ended as {ended.cause or ended.run.reason}")
            judgement.need(ended.own.manifest["latch"] is None, f"{said}: {ended.own.manifest['latch']}")
            judgement.say(f"{said}: {ended.run.reason}, worst tick {ended.run.lateness.max() * 1e3:.2f} ms late")
        judgement.say(f"{waits.calls} rows and looks, {held} made the loop wait")


def _absent(ended: Ended, looked: _Looked, said: str, judgement: Judgement) -> None:
    """Demand a trip at the first look after `ABSENCE` without the page, and a plant at zero since."""
    judgement.need(ended.cause == "UNATTENDED", f"{said}: ended as {ended.cause or ended.run.reason}")
    silence = ended.run.trip.value if ended.run.trip is not None else 0.0
    most = ABSENCE + looked.looks[-1][1] - looked.looks[-2][0]  # at the look before, it was not so long yet
    judgement.need(ABSENCE < silence <= most, f"{said}: {silence:.4f} s, not from {ABSENCE:g} to {most:.4f}")
    left = ended.own.array("input")[ended.own["tick"] > ended.tick]
    judgement.need(not left.any(), f"{said}: the plant got a command after the trip")
    judgement.say(f"{said}: {ended.cause} after {silence:.4f} s, at most {most:.4f}")


@final
class _Looked:
    """A run of an experiment whose operator's page is served by a process of its own, and looked at; a context.

    Attributes:
        looks: when looks at the switch began and ended, s of the monotonic clock.
        waits: what rows and looks cost the loop.
        gone: when the page was gone; 0 where it was not.

    Args:
        experiment: that is shown.
        is_attended: the run trips where nobody looks.
    """

    def __init__(self, experiment: Experiment, *, is_attended: bool = False) -> None:
        self.looks, self.waits, self.gone = [(0.0, 0.0)] * 2, Waits(), 0.0
        self._experiment, self._controller = experiment, SampledStep(experiment.sampled)
        self._over, self._attendants, self._threads = threading.Event(), list[Attendant](), list[threading.Thread]()
        self._operator = Operator(self._begin, is_attended=is_attended)
        self._number: signal.Signals | None = None
        self._look = self.waits.watched(self._operator.look)

    def __enter__(self) -> _Looked:
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join()  # it sends a signal to the process, which must still be this one
        for one in self._attendants:
            one.process.end(0.0)
        self._operator.__exit__()

    def run(self, bench: Bench, number: signal.Signals | None = None, **more: Any) -> Ended:
        """Run the controller on a served twin.

        Args:
            bench: of the fault.
            number: the signal that the process of the page gets after a while; None for none.
            more: what `Bench.run` takes besides.
        """
        experiment, controller, operator = self._experiment, self._controller, self._operator
        self._number, before = number, experiment.sampled.before
        held = safety_limits.rules(experiment.instruments, controller.rate, experiment.twin, controller.estimate)
        operator.begin(experiment, controller, held)
        return bench.run(
            lambda tick, readings: self._step(tick - before, readings),
            held=held,
            look=self._watch,
            known=known(controller, np.zeros((1, 0))),
            on_row=[self.waits.watched(operator.put)] if operator.put is not None else [],
            **more,
        )

    def press(self) -> None:
        """Press STOP on the page, as a browser does."""
        with self._connected() as (connection, path):
            connection.request("POST", f"{path}stop")
            status = connection.getresponse().status
        if status != 200:
            raise MaskingError(f"the page answered STOP with {status}")

    def _step(self, index: int, readings: Array) -> Array:
        return self._controller(readings, index)

    def _watch(self, chain: Chain, tick: int) -> None:
        began = time.monotonic()
        self._look(chain, tick)
        self.looks = [self.looks[-1], (began, time.monotonic())]

    def _begin(self, ring: Path, switch: Path) -> Attendant:
        self._attendants.append(attend(ring, switch, page=0))
        self._threads.append(threading.Thread(target=self._browse, daemon=True))
        self._threads[0].start()
        return self._attendants[0]

    @contextlib.contextmanager
    def _connected(self) -> Iterator[tuple[http.client.HTTPConnection, str]]:
        at = urllib.parse.urlsplit(self._attendants[0].page)
        with contextlib.closing(http.client.HTTPConnection(at.hostname or "", at.port, timeout=_ANSWER)) as connection:
            yield connection, at.path

    def _browse(self) -> None:
        """Look at the page until a while after the first tick, or the end; then close or stall its process."""
        first = 0.0
        with contextlib.suppress(OSError, http.client.HTTPException), self._connected() as (connection, path):
            while not self._over.wait(0.05):
                connection.request("GET", f"{path}data?since=0")
                connection.getresponse().read()
                first = first or self.looks[-1][0]
                if self._number is not None and first and time.monotonic() > first + _LOOKED:
                    os.kill(self._attendants[0].process.pid, self._number)
                    self.gone = time.monotonic()
                    return


FAULTS: Final = (
    Fault(
        20,
        "operator page closed or stalled",
        "loop untouched; an attended run disarms at the first tick after 2 s",
        _unattended,
        in_real_time=True,
    ),
    Fault(
        21,
        "e-stop from page, command line, file, plant",
        "TRIPPED(ESTOP) within 2 ticks; by a file, within 10 ms and a tick",
        _emergency,
    ),
)
