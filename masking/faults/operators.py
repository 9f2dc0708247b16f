"""Faults 20 and 21: of who looks at a run, and of emergency stops."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

from masking.faults.bench import Bench, Ended
from masking.faults.table import Fault, Judgement
from masking.records.switch import Presser
from masking.runs.operator import Operator

_EXPERIMENT: Final = "linear_rig"  # whose page is shown
_LOOKED: Final = 0.5  # s in which somebody looks at the page
_AFTER: Final = 1.0  # s that a run goes on where nobody needs to look
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


FAULTS: Final = (
    Fault(21, "e-stop from page, command line, file, plant", "TRIPPED(ESTOP) within 2 ticks; file: 100 ms", _emergency),
)
