"""Faults 20 and 21: of who looks at a run, and of emergency stops."""

from __future__ import annotations

import http.client
import os
import signal
import threading
import time
import urllib.parse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from masking.control.step import SampledStep
from masking.faults.bench import Bench, Ended
from masking.faults.table import Fault, Judgement
from masking.numerics.arrays import Array
from masking.records.switch import Presser
from masking.runs import protection
from masking.runs.experiment import Experiment
from masking.runs.loop_rows import known
from masking.runs.operator import ABSENCE, Operator
from masking.workflows.operator import Attendant, attend

_EXPERIMENT: Final = "huygens_rig"  # whose page is shown
_LOOKED: Final = 1.0  # s in which somebody looks at the page
_ROWS: Final = 4500  # samples that a run has
_AT: Final = 100  # tick of the stop
_PERIODS: Final = 2  # that a stop may take
_FILE: Final = 100.0  # ms that one by a file may take


def _stopped(ended: Ended, said: str, judgement: Judgement) -> None:
    """Demand a trip by an emergency stop within two ticks, and a plant at zero since."""
    later = max(0, ended.tick - _AT)  # a plant that says so itself gives no sample of that tick
    judgement.need(ended.cause == "ESTOP", f"{said}: ended as {ended.cause or ended.run.reason}, not ESTOP")
    judgement.need(said in str(ended.run.trip), f"{said}: not named in '{ended.run.trip}'")
    judgement.need(later <= _PERIODS, f"{said}: {later} ticks later, more than {_PERIODS}")
    inputs = ended.own.array("input")[ended.own["tick"] > ended.tick]
    judgement.need(not inputs.any(), f"{said}: the plant got a command after the trip")
    judgement.say(f"{said}: {later} ticks")


def _emergency(bench: Bench, judgement: Judgement) -> None:
    for presser, said in ((Presser.PAGE, "on the page"), (Presser.COMMAND_LINE, "from the command line")):
        with Operator() as operator:
            ended = bench.run(look=operator.look, on_tick=_at(partial(operator.switch.press, presser)))
        _stopped(ended, said, judgement)
    file = bench.place()
    file.parent.mkdir(parents=True, exist_ok=True)
    with Operator(stop_file=file) as operator:
        ended = bench.run(look=operator.look, on_tick=_at(file.touch), samples=100_000)
    took = (ended.run.wall[-1] - ended.run.wall[_AT]) * 1e3
    judgement.need(ended.cause == "ESTOP", f"by a file: ended as {ended.cause or ended.run.reason}, not ESTOP")
    judgement.need(took <= _FILE, f"by a file: {took:.1f} ms, more than {_FILE:g}")
    judgement.say(f"by a file: {took:.1f} ms")
    _stopped(bench.run(damage={"what": "press", "at": _AT}), "at the plant", judgement)


def _at(act: Callable[[], None]) -> Callable[[int], None]:
    """Return what does something at the end of the tick before `_AT`."""

    def on_tick(row: int) -> None:
        if row == _AT - 1:
            act()

    return on_tick


def _unattended(bench: Bench, judgement: Judgement) -> None:
    cases = [(number, is_attended) for number in (signal.SIGKILL, signal.SIGSTOP) for is_attended in (False, True)]
    for number, is_attended in cases[1:2] if bench.is_quick else cases:
        ended, gone = _looked_at(bench, number, is_attended=is_attended)
        said = f"{'closed' if number == signal.SIGKILL else 'stalled'}{', attended' * is_attended}"
        rows = ended.run
        if is_attended:
            seconds, left = rows.wall[-1] - gone, ended.own.array("input")[ended.own["tick"] > ended.tick]
            judgement.need(not left.any(), f"{said}: the plant got a command after the trip")
            judgement.need(ended.cause == "UNATTENDED", f"{said}: ended as {ended.cause or rows.reason}")
            judgement.need(ABSENCE - 0.1 <= seconds <= ABSENCE + 0.1, f"{said}: {seconds:.2f} s")
            judgement.say(f"{said}: {ended.cause} after {seconds:.2f} s")
        else:
            most = int(rows.lateness.argmax())
            judgement.need(rows.reason == "finished", f"{said}: ended as {ended.cause or rows.reason}")
            judgement.say(f"{said}: {rows.reason}, worst tick {rows.lateness[most] * 1e3:.2f} ms late")


def _looked_at(bench: Bench, number: signal.Signals, *, is_attended: bool) -> tuple[Ended, float]:
    """Run a controller in real time whose page is looked at for a while, then closed or stalled; and when it was."""
    experiment, attendants, gone = Experiment.load(_EXPERIMENT), list[Attendant](), list[float]()
    controller, before = SampledStep(experiment.sampled), experiment.sampled.before
    held = protection.rules(experiment.instruments, controller.rate, experiment.twin, controller.estimate)
    began = [0.0]

    def begin(ring: Path, switch: Path) -> Attendant:
        attendants.append(attend(ring, switch, page=0))
        threading.Thread(target=_browse, args=(attendants[0], began, gone, number), daemon=True).start()
        return attendants[0]

    def step(tick: int, readings: Array) -> Array:
        began[0] = began[0] or time.perf_counter()
        return controller(readings, tick - before)

    try:
        with Operator(begin, is_attended=is_attended) as operator:
            operator.begin(experiment, controller, held)
            ended = bench.run(
                step,
                lockstep=False,
                samples=_ROWS,
                held=held,
                look=operator.look,
                estimate=controller.estimate,
                known=known(controller, np.zeros((1, 0))),
                before=before,
                on_row=[operator.put] if operator.put is not None else [],
            )
    finally:
        for one in attendants:
            one.process.kill()
            one.process.wait()
    return ended, gone[0] - began[0] if gone else 0.0


def _browse(attendant: Attendant, began: list[float], gone: list[float], number: signal.Signals) -> None:
    """Look at a page until a while after the run began, then close or stall the process that serves it."""
    at = urllib.parse.urlsplit(attendant.page)
    connection = http.client.HTTPConnection(at.hostname or "", at.port, timeout=5)
    while not began[0] or time.perf_counter() < began[0] + _LOOKED:
        connection.request("GET", f"{at.path}data?since=0")
        connection.getresponse().read()
        time.sleep(0.05)
    connection.close()
    gone.append(time.perf_counter())
    os.kill(attendant.process.pid, number)


FAULTS: Final = (
    Fault(
        20,
        "operator page closed or stalled",
        "loop untouched; an attended run disarms after 2 s",
        _unattended,
        in_real_time=True,
    ),
    Fault(21, "e-stop from page, command line, file, plant", "TRIPPED(ESTOP) within 2 ticks; file: 100 ms", _emergency),
)
