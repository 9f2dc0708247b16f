"""Faults 9 to 17, 22, 25 and 30: of time, of the line and of both processes."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable, Mapping
from functools import partial
from importlib.util import find_spec
from typing import Any, Final

import numpy as np

from masking.errors import PlantRefusedError
from masking.lab.plants.interface import Settings
from masking.lab.plants.udp import UdpPlant
from masking.lab.records.recording import Recording
from tests.campaigns.bench import Bench, Chosen, Controller, Served
from tests.campaigns.children import FAILING
from tests.campaigns.damage import DamagedPlant, spoiled
from tests.campaigns.table import Fault, Judgement
from tests.campaigns.twins import RATE, WATCHDOG, small

LATEST: Final = round(WATCHDOG * RATE) + 2  # ticks after the last command at which a plant is at zero
_HELD: Final = 4  # lost samples that are borne
_LOST_AT: Final = 300  # first sample that is lost
_FROZEN: Final = 0.2  # s
_SLOW: Final = 1.5  # periods between ticks, beyond which the machine has held the loop up
_MOST: Final = 5  # late ticks in a row


def _started(judgement: Judgement, said: object) -> bool:
    ended = said.get("trip") or said.get("reason") if isinstance(said, dict) else said
    judgement.need(said == "running", f"the controller did not come to run: {ended}")
    return said == "running"


def zero_after(own: Recording) -> int:
    """Return the ticks from the last command that reached a plant until its commands were zero."""
    last = int(np.flatnonzero(own["fresh"])[-1])
    moving = np.flatnonzero(own.array("input").any(axis=1))
    ticks = own["tick"]
    return int(ticks[min(moving[-1] + 1, len(ticks) - 1)] - ticks[last])


def _latched(own: Recording, judgement: Judgement) -> None:
    """Demand that the plant was at zero a watchdog and two ticks after the last command in time, and stayed there."""
    latch = own.manifest["latch"]
    judgement.need(latch is not None, f"the plant did not trip: {own.manifest['end']}")
    if latch is None:
        return
    later = zero_after(own)
    judgement.need(later <= LATEST, f"zero {later} ticks after the last command, more than {LATEST}")
    judgement.need(not own.array("input")[own["tick"] >= latch["tick"]].any(), "a command was in force after the trip")
    judgement.say(f"zero {later} ticks after the last command, latched: {latch['cause']}")


def _in_two(
    bench: Bench, act: Callable[[Controller, Served], None], judgement: Judgement, **chosen: Chosen
) -> dict[str, Any]:
    """Run a controller in a process of its own on a served twin, do something to them, and return what it says."""
    served = bench.served(lockstep=False)
    with bench.controller(served.address, **chosen) as controller:
        if not _started(judgement, controller.said):
            with contextlib.suppress(Exception):
                served.record()
            return {}
        act(controller, served)
        return controller.end()


def _raises(bench: Bench, judgement: Judgement) -> None:
    served = bench.served()
    with bench.controller(served.address, fault="raise", lockstep=True) as controller:
        _started(judgement, controller.said)
        said, status = controller.end(), controller.process.exitcode
    own, trip = served.record(), said.get("trip") or {}
    judgement.need(trip.get("cause") == "CONTROLLER_EXCEPTION", f"ended as {trip.get('cause')}")
    judgement.need("Traceback" in trip.get("detail", ""), "no traceback in the record")
    judgement.need(status != 0, "the exit status is 0")
    judgement.need(not own.array("input")[own["tick"] >= trip.get("tick", 0)].any(), "the output is not zero")
    judgement.say(f"{trip.get('cause')}, exit status {status}")


def _stalls(bench: Bench, judgement: Judgement) -> None:
    served = bench.served(lockstep=False)
    with bench.controller(served.address, fault="stall", samples=500) as controller:
        _started(judgement, controller.said)
        said = controller.end()
    late, slow = set(said["late"]), {row for row, wall in enumerate(said["walls"], 1) if wall > _SLOW / RATE}
    judgement.need(said["reason"] == "finished", f"once: ended as {said['reason']}")
    judgement.need(FAILING + 1 in late, "the tick after the stall is not counted as late")
    # One that the machine held up shows it on the loop's clock, or the one before does, which then began late.
    others = {row for row in late - {FAILING + 1} if not slow & {row, row - 1}}
    judgement.need(not others, f"ticks {others} are counted as late, and were not")
    _counted(said, served.record(), judgement)
    judgement.say(f"once: {len(late)} late, {len(late) - 1} of them held up by the machine; no burst")
    with bench.controller(served.address, fault="stalls") as controller:
        _started(judgement, controller.said)
        said = controller.end()
    trip, late, last = said["trip"] or {}, set(said["late"]), said["rows"] - 1
    in_a_row = next(n for n in range(last + 1) if last - n not in late)
    judgement.need(trip.get("cause") == "OVERRUN", f"ended as {trip.get('cause') or said['reason']}")
    judgement.need(in_a_row == _MOST, f"tripped after {in_a_row} late ticks in a row, not {_MOST}")
    judgement.need(last <= FAILING + _MOST, f"tripped after {last - FAILING} stalls, not {_MOST}")
    own = served.record()
    _counted(said, own, judgement)
    judgement.need(not own.array("input")[-1].any(), "the plant was not left at zero")
    judgement.say(f"always: {trip.get('cause')} after {in_a_row}")


def _counted(said: Mapping[str, Any], own: Recording, judgement: Judgement) -> None:
    """Demand that the plant got one command for each sample that was answered, in time, and none for those missed."""
    counted, gaps = own.manifest["counters"], np.array(said["gaps"])
    missed, skipped = int((gaps - 1).sum()), said["counters"].get("skipped", 0) + said["counters"].get("lost", 0)
    judgement.need(said["counters"]["late"] == (gaps > 1).sum(), f"{said['counters']['late']} late ticks counted")
    judgement.need(said["counters"]["missed"] == missed, f"{said['counters']['missed']} of {missed} missed counted")
    judgement.need(skipped == missed + said["first"], f"{missed} missed, {skipped} skipped")
    judgement.need(counted.get("commands") == said["rows"], f"{counted.get('commands')} of {said['rows']} commands")
    for cause in ("stale", "reordered", "duplicate", "ahead"):
        judgement.need(not counted.get(cause), f"the plant counted {counted.get(cause)} {cause} commands")
    judgement.need(said["rows"] + missed <= len(own["tick"]), f"{said['rows']} commands in {len(own['tick'])} ticks")


def _loses(bench: Bench, judgement: Judgement) -> None:
    for lost in (1, _HELD, _HELD + 1, 20):
        made = partial(DamagedPlant, lost=range(_LOST_AT, _LOST_AT + lost))
        ended = bench.run(lockstep=False, samples=500, made=made)
        counted, own = ended.run.counters.get("lost", 0), ended.own
        if lost <= _HELD:
            judgement.need(not ended.cause, f"{lost} lost: ended as {ended.cause}")
            judgement.need(own.manifest["latch"] is None, f"{lost} lost: the plant tripped: {own.manifest['latch']}")
            rows = np.flatnonzero(own["tick"] == _LOST_AT)[0] + np.arange(lost - 1)
            inputs, unanswered = own.array("input"), own["fresh"][rows] == 0.0
            is_held = (inputs[rows] == inputs[rows - 1]).all(axis=1)
            judgement.need(is_held[unanswered].all(), f"{lost} lost: the last command was not held")
            judgement.say(f"{lost} lost: {counted} counted, goes on")
        else:
            later = zero_after(own)
            judgement.need(later <= LATEST, f"{lost} lost: zero {later} ticks after the last command")
            judgement.need(ended.cause == "COMM_LOST", f"{lost} lost: ended as {ended.cause or ended.run.reason}")
            judgement.say(f"{lost} lost: {counted} counted, {ended.cause}")
        judgement.need(abs(counted - lost) <= 1, f"{lost} lost, {counted} counted")


def _spoils(bench: Bench, judgement: Judgement) -> None:
    ended = bench.run(made=partial(DamagedPlant, spoil=spoiled))
    judgement.need(ended.run.reason == "finished", f"ended as {ended.cause or ended.run.reason}")
    rows = len(ended.run.applied) - 1  # the last one acts no more: the controller says good-bye
    judgement.need(np.array_equal(ended.own.array("input")[:rows], ended.run.applied[:rows]), "a wrong command acted")
    sensors = ended.own.array("sensor")[: len(ended.run.sensors)]
    judgement.need(np.array_equal(sensors, ended.run.sensors[: len(sensors)]), "a wrong sample was used")
    kinds = ("duplicate", "reordered", "other session")
    theirs, ours = ended.own.manifest["counters"], ended.run.counters
    for name, counted in (("plant", theirs), ("controller", ours)):
        few = {kind: counted.get(kind, 0) for kind in kinds}
        broken = sum(counted.values()) - sum(counted.get(k, 0) for k in (*kinds, "commands", "late", "missed"))
        judgement.need(min(few.values()) >= rows - 6, f"the {name} counted {few} of {rows}")
        judgement.need(broken >= rows - 6, f"the {name} counted {broken} corrupt frames of {rows}")
    judgement.say(f"{rows} of {rows} commands and samples as sent; {ours.get('duplicate', 0)} duplicates rejected")


def _killed(bench: Bench, judgement: Judgement) -> None:
    def act(controller: Controller, _: Served) -> None:
        controller.send(signal.SIGKILL)

    if _in_two(bench, act, judgement) or not judgement.broken:
        _latched(bench.served(lockstep=False).record(), judgement)


def _frozen(bench: Bench, judgement: Judgement) -> None:
    for side in ("controller", "plant"):
        _frozen_side(bench, judgement, side)


def _frozen_side(bench: Bench, judgement: Judgement, side: str) -> None:
    def act(controller: Controller, served: Served) -> None:
        number = (controller if side == "controller" else served).process.pid or 0
        os.kill(number, signal.SIGSTOP)
        time.sleep(_FROZEN)
        os.kill(number, signal.SIGCONT)

    said = _in_two(bench, act, judgement)
    if not said:
        return
    own = bench.served(lockstep=False).record()
    _latched(own, judgement)
    judgement.need((said["trip"] or {}).get("cause") == "PLANT_LOST", f"the controller ended as {said['reason']}")
    latch = own.manifest["latch"] or {"tick": 0}
    stale = int(own["fresh"][own["tick"] > latch["tick"]].sum())
    judgement.need(stale == 0, f"{stale} stale frames were used")
    judgement.say(f"{side} frozen: the controller ended as {said['reason']}; {stale} stale frames used")


def _signalled(bench: Bench, judgement: Judgement) -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        sent: list[float] = []

        def act(controller: Controller, _: Served, number: int = number, sent: list[float] = sent) -> None:
            sent.append(time.monotonic())
            controller.send(number)

        said = _in_two(bench, act, judgement)
        if not said:
            return
        own = bench.served(lockstep=False).record()
        seconds = said["now"] - sent[0]
        judgement.need(said["reason"] == "interrupted", f"{number.name}: ended as {said['reason']}")
        judgement.need(seconds <= 0.1, f"{number.name}: {seconds * 1e3:.0f} ms")
        judgement.need(own.manifest["end"] == "bye" and said["rows"] > 0, f"{number.name}: {own.manifest['end']}")
        judgement.say(f"{number.name} {seconds * 1e3:.1f} ms")


def _crashes(bench: Bench, judgement: Judgement) -> None:
    _in_two(bench, lambda *_: None, judgement, fault="segfault")
    if not judgement.broken:
        _latched(bench.served(lockstep=False).record(), judgement)


def _dies(bench: Bench, judgement: Judgement) -> None:
    _dies_on(bench, judgement, "udp://127.0.0.1:0")
    judgement.need(find_spec("serial"), "pyserial is not installed: pip install 'masking[serial]'")
    if find_spec("serial"):
        _dies_on(bench, judgement, "serial:pty")


def _dies_on(bench: Bench, judgement: Judgement, line: str) -> None:
    """Kill a served plant, at the end of a line that goes with it."""
    served = bench.anew(line=line)
    with bench.controller(served.address) as controller:
        if not _started(judgement, controller.said):
            return
        served.process.kill()
        said = controller.end()
    seconds, trip = said["now"] - said["seen"], said["trip"] or {}
    judgement.need(trip.get("cause") == "PLANT_LOST", f"ended as {trip.get('cause')}")
    judgement.need(seconds <= 2.0 * WATCHDOG, f"{seconds * 1e3:.1f} ms after the last sample")
    judgement.need(said["rows"] > 0, "nothing was kept")
    scheme, after = line.partition(":")[0], f"{seconds * 1e3:.1f} ms after the last sample"
    judgement.say(f"{scheme}: {trip.get('cause')} {after}, {said['rows']} rows kept")


def _rearmed(bench: Bench, judgement: Judgement) -> None:
    def act(controller: Controller, _: Served) -> None:
        controller.send(signal.SIGKILL)

    _in_two(bench, act, judgement)
    if judgement.broken:
        return
    served = bench.served(lockstep=False)
    cause = served.record().manifest["latch"]["cause"]
    plant = UdpPlant(served.address, patience=20.0)
    try:
        plant.configure(Settings(RATE, WATCHDOG))
        judgement.need(holds=False, broken="armed without an acknowledgement")
    except PlantRefusedError as error:
        judgement.need(cause in str(error), f"the refusal does not name the cause: {error}")
        judgement.say(f"refused: it has tripped: {cause}")
    finally:
        plant.deactivate()
    ended = bench.run(lockstep=False, damage={"what": "set", "channel": 0, "value": "nan"})
    judgement.need(ended.cause == "SENSOR_NONFINITE", f"with the fault present: {ended.cause or ended.run.reason}")
    judgement.need(not ended.own.array("input").any(), "a command reached the plant with the fault present")
    judgement.say(f"with the fault present: {ended.cause} before any command")


def _clock_steps(bench: Bench, judgement: Judgement) -> None:
    served = bench.anew(steps=True)
    with bench.controller(served.address, fault="clock", samples=500) as controller:
        _started(judgement, controller.said)
        said = controller.end()
    own = served.record()
    served.close()
    judgement.need(said["reason"] == "finished", f"ended as {said['reason']}")
    judgement.need(own.manifest["latch"] is None, f"the plant tripped: {own.manifest['latch']}")
    judgement.need(np.ptp(own["wall"] - own["t"]) < 1.0, "the record's times step")
    judgement.say(f"{said['reason']}, {said['rows']} ticks, no trip")


def _second(bench: Bench, judgement: Judgement) -> None:
    refusals: list[str] = []

    def act(controller: Controller, served: Served) -> None:
        second = UdpPlant(served.address, patience=20.0)
        try:
            second.configure(Settings(RATE, WATCHDOG, acknowledge=True))
        except PlantRefusedError as error:
            refusals.append(str(error))
        second.deactivate()
        time.sleep(0.1)
        controller.send(signal.SIGTERM)

    said = _in_two(bench, act, judgement)
    if not said:
        return
    own = bench.served(lockstep=False).record()
    judgement.need(refusals and "has this plant" in refusals[0], "the second was not refused")
    judgement.need(said["reason"] == "interrupted" and own.manifest["end"] == "bye", f"the first: {said['reason']}")
    counted = own.manifest["counters"].get("refused controllers", 0)
    judgement.say(f"{counted} refused, the first went on for {said['rows']} ticks")


def sound(bench: Bench, judgement: Judgement) -> None:
    """Run without a fault, in lockstep and in real time: nothing may trip."""
    for lockstep in (True, False):
        ended = bench.run(small, lockstep=lockstep, samples=1000)
        judgement.need(ended.run.reason == "finished", f"ended as {ended.cause or ended.run.reason}")
        judgement.need(ended.own.manifest["latch"] is None, f"the plant tripped: {ended.own.manifest['latch']}")
        judgement.say(f"{'lockstep' if lockstep else 'real time'}: {ended.run.reason}, {len(ended.run.index)} ticks")


FAULTS: Final = (
    Fault(0, "no fault", "no trip, in lockstep and in real time", sound, in_real_time=True),
    Fault(9, "controller raises", "CONTROLLER_EXCEPTION, traceback; zero, exit status not 0", _raises),
    Fault(10, "5 ms stall once / always", "counted; OVERRUN after 5 in a row; no burst", _stalls, in_real_time=True),
    Fault(11, "1, 4, 5, 20 samples lost in a row", "hold <= 4, then COMM_LOST; +- 1", _loses, in_real_time=True),
    Fault(12, "duplicate, reordered, corrupt frames", "rejected, counted; only the newest valid acts", _spoils),
    Fault(13, "kill -9 of the controller", "zero, latched; <= watchdog + 2 ticks", _killed, in_real_time=True),
    Fault(14, "SIGSTOP 200 ms, then CONT", "both sides trip; 0 stale frames used", _frozen, in_real_time=True),
    Fault(15, "SIGINT / SIGTERM / SIGHUP", "zero, disarm, record closed; <= 100 ms", _signalled, in_real_time=True),
    Fault(16, "segfault of the controller", "zero, latched; <= watchdog + 2 ticks", _crashes, in_real_time=True),
    Fault(
        17,
        "plant dies, serial line unplugged",
        "PLANT_LOST, record kept; <= 2 watchdogs",
        _dies,
        in_real_time=True,
    ),
    Fault(22, "re-arm unacknowledged or faulty", "refused, cause named", _rearmed, in_real_time=True),
    Fault(25, "wall clock steps", "nothing", _clock_steps, in_real_time=True),
    Fault(30, "two controllers on one plant", "second refused", _second, in_real_time=True),
)
