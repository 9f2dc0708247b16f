"""Verbs of `masking rig`: check, serve, run, batch, stop, calibrate."""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from masking.app.cli.options import NAMED, Verb, add_json, add_out, add_verb, answer, prepare
from masking.app.cli.progress import INTERRUPTED, Bar
from masking.errors import OperatorError

if TYPE_CHECKING:
    from masking.lab.plants.authentication import Key
    from masking.lab.records.recording import Recording
    from masking.lab.runs.operator_link import Operator

SUCH = "such as udp://127.0.0.1:5005, serial:///dev/ttyACM0, mujoco:rig.xml or fmu:rig.fmu"


def _add_rig(sub: argparse.ArgumentParser) -> None:
    """Run on a plant that runs by itself, or serve a twin that stands in for one."""
    verbs = sub.add_subparsers(title="verbs", metavar="VERB", required=True)
    for verb in _OF_RIG:
        add_verb(verbs, verb)


def _add_common(sub: argparse.ArgumentParser) -> None:
    add_json(sub)
    sub.add_argument("--lockstep", action="store_true", help="each side waits for the other; no clock")


def _add_remote(sub: argparse.ArgumentParser) -> None:
    _add_key(sub, "that the server has, too")
    text = "why the plant tripped in the last run was looked at; it is refused without"
    sub.add_argument("--acknowledge", action="store_true", help=text)


def _add_key(sub: argparse.ArgumentParser, text: str) -> None:
    sub.add_argument("--key", metavar="FILE", help=f"file of mode 0600 with a key {text}")


def _add_check(sub: argparse.ArgumentParser) -> None:
    from masking.lab.plants import conformance

    _add_common(sub)
    _add_remote(sub)
    sub.add_argument("address", metavar="ADDRESS", help=f"{SUCH}; the outputs move")
    text = "samples per second (default: %(default)g)"
    sub.add_argument("--rate", metavar="HZ", type=float, default=conformance.RATE, help=text)
    text = "largest command, in the actuators' units (default: %(default)g)"
    sub.add_argument("--amplitude", metavar="U", type=float, default=conformance.AMPLITUDE, help=text)
    text = "the rig's plant file, or a packaged plant: also pulse each actuator, and compare the answer with the twin's"
    sub.add_argument("--plant", metavar="PLANT", help=text)
    text = "size of a pulse, as a part of the largest command (default: 0.05)"
    sub.add_argument("--pulse", metavar="PART", type=float, default=0.05, help=text)


def _add_serve(sub: argparse.ArgumentParser) -> None:
    from masking.lab.plants.session import LONGEST_WATCHDOG, RATES

    _add_common(sub)
    sub.add_argument("plant", metavar="PLANT", help=f"{NAMED}, whose twin is served; or an address, {SUCH}")
    text = "udp://host:port, serial:pty for a pseudo terminal, or a serial port (default: %(default)s)"
    sub.add_argument("--address", default="udp://127.0.0.1:5005", help=text)
    sub.add_argument("--record", metavar="DIR", help="folder for the plant's own record of each session")
    sub.add_argument("--seed", type=int, default=0, help="of the sensors' noise (default: 0)")
    sub.add_argument("--sessions", type=int, metavar="N", help="end after N sessions")
    text = "plant file whose limits hold for every command (default: PLANT, where it is one)"
    sub.add_argument("--limits", metavar="PLANT", help=text)
    text = "longest watchdog that a controller may ask for (default: %(default)g)"
    sub.add_argument("--watchdog", metavar="SECONDS", type=float, default=LONGEST_WATCHDOG, help=text)
    low, high = RATES
    text = f"samples per second that a controller may ask for (default: {low:g}:{high:g})"
    sub.add_argument("--rates", metavar="LOW:HIGH", type=_rates, default=RATES, help=text)
    _add_key(sub, "that controllers must have, too; needed where other machines reach the address")


def _rates(text: str) -> tuple[float, float]:
    """Read `LOW:HIGH`."""
    try:
        low, high = map(float, text.split(":"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"invalid rates '{text}'; write LOW:HIGH in Hz, such as 1:1000") from None
    return low, high


def _add_run(sub: argparse.ArgumentParser) -> None:
    _add_common(sub)
    _add_remote(sub)
    sub.add_argument("experiment", metavar="EXPERIMENT", help=NAMED)
    sub.add_argument(
        "--plant",
        metavar="[NAME=]ADDRESS",
        required=True,
        action="append",
        help=f"{SUCH}; a=ADDRESS for each plant of an experiment with several",
    )
    text = "pulse each actuator first, and refuse a rig that does not answer as its twin does"
    sub.add_argument("--self-test", action="store_true", help=text)
    text = "folder for the rest of the rows where that of the results is full (default: that for temporary files)"
    sub.add_argument("--spare", metavar="DIR", help=text)
    _add_operator(sub)
    add_out(sub, "results/EXPERIMENT_rig")


def _add_operator(sub: argparse.ArgumentParser) -> None:
    text = "show the run on a page on this machine, which can stop it, at this port (default: a free one)"
    sub.add_argument("--page", metavar="PORT", type=int, nargs="?", const=0, help=text)
    sub.add_argument(
        "--stream", metavar="HOST:PORT", help="send the rows there as JSON over UDP, as PlotJuggler takes them"
    )
    text = "with --page: the run waits until the page is open, and trips where it is not heard of for 2 s"
    sub.add_argument("--attended", action="store_true", help=text)
    sub.add_argument("--stop-file", metavar="FILE", help="the run trips as soon as there is this file")


def _add_batch(sub: argparse.ArgumentParser) -> None:
    add_json(sub)
    _add_key(sub, "that the server has, too")
    sub.add_argument("plan", metavar="PLAN", help="a batch file, or the name of a packaged one")
    sub.add_argument("--plant", metavar="ADDRESS", help=f"{SUCH} (default: that of the plan, or the twin)")
    sub.add_argument(
        "--out", metavar="DIR", help="folder of the results; a batch that it holds goes on (default: results/PLAN)"
    )


def _add_stop(sub: argparse.ArgumentParser) -> None:
    add_json(sub)
    sub.add_argument(
        "processes", metavar="PROCESS", type=int, nargs="*", help="number of one whose runs are stopped (default: all)"
    )


def _add_calibrate(sub: argparse.ArgumentParser) -> None:
    _add_common(sub)
    sub.add_argument("plant", metavar="PLANT", help="the rig's plant file, or a packaged plant")
    sub.add_argument("--at", metavar="ADDRESS", help=f"{SUCH} (default: the plant's twin)")
    _add_key(sub, "that the server has, too")
    sub.add_argument("--model", metavar="MODEL", help="a model of the rig to fit beside that of the plant file")
    sub.add_argument("--seconds", type=float, default=40.0, help="length of each record (default: 40)")
    add_out(sub, "results/PLANT_calibration; records that it holds are used again")


def _key(chosen: argparse.Namespace) -> Key | None:
    """Key of `--key`."""
    from masking.lab.plants.authentication import Key

    return Key.read(chosen.key) if chosen.key is not None else None


def _check(chosen: argparse.Namespace) -> int:
    """Check that a plant keeps the rules of the interface, and that its rig answers; exit status 1 if not."""
    from masking.control.rig.twin import Twin
    from masking.lab.plants import adapters, conformance
    from masking.lab.plants.interface import Settings
    from masking.lab.runs.self_test import allowed, self_test

    settings = Settings(chosen.rate, conformance.WATCHDOG, chosen.lockstep, chosen.acknowledge)
    make_plant = partial(adapters.connect, chosen.address, _key(chosen))
    twin = Twin.load(chosen.plant) if chosen.plant else None
    conformance.reach(make_plant, settings, chosen.amplitude, math.inf if twin is None else allowed(twin))
    found = conformance.verdicts(make_plant, settings, amplitude=chosen.amplitude)
    broken = sum(len(verdict.broken) for verdict in found)
    content = {"address": chosen.address, "rules": [dataclasses.asdict(verdict) for verdict in found]}
    text = "\n".join([*map(str, found), f"{chosen.address} {'does not conform' if broken else 'conforms'}"])
    if twin is not None and not broken:
        tested = self_test(
            twin,
            make_plant(),
            size=chosen.pulse,
            rate=chosen.rate,
            lockstep=chosen.lockstep,
            acknowledge=chosen.acknowledge,
        )
        content, text = content | {"self_test": tested.as_dict()}, f"{text}\nself-test:\n{tested}"
        broken = len(tested.findings)
    answer(chosen.json, content, text)
    return int(broken > 0)


def _serve(chosen: argparse.Namespace) -> int:
    """Serve a plant, or the twin of one, over UDP or a serial line, on a clock of its own."""
    from masking.lab.plants.serve import Serving
    from masking.lab.plants.session import Allowed
    from masking.lab.runs import hardware

    serving = Serving(
        clock="lockstep" if chosen.lockstep else "real",
        record=chosen.record,
        sessions=chosen.sessions,
        allowed=Allowed(chosen.watchdog, chosen.rates),
        key=_key(chosen),
    )
    folders = hardware.serve(
        chosen.plant,
        chosen.address,
        serving,
        seed=chosen.seed,
        limits=chosen.limits,
        ready=lambda address: print(f"{chosen.plant} is served at {address}", file=sys.stderr, flush=True),
    )
    records = [str(folder) for folder in folders]
    return answer(chosen.json, {"records": records}, "\n".join(f"record: {folder}" for folder in records))


def _run(chosen: argparse.Namespace) -> int:
    """Run an experiment on a plant that runs by itself, and write its report."""
    from masking.app.workflows.output_folders import RUN, check_folder
    from masking.app.workflows.run import save
    from masking.lab.plants.group import connect_each
    from masking.lab.records import stream
    from masking.lab.runs import hardware, stopping
    from masking.lab.runs.experiment import Experiment
    from masking.lab.runs.self_test import self_test

    made = Experiment.load(chosen.experiment)
    out = Path(chosen.out or f"results/{made.stem}_rig")
    check_folder(out, *RUN, overwrite=chosen.overwrite)
    stream.remove(out)

    def keep(recording: Recording) -> None:
        bar.close()
        written = save(recording, out)
        content = {name: recording.manifest[name] for name in ("masking_error", "rig")} | {"recording": str(out)}
        answer(chosen.json, content, f"{written.summary}\nreport: {written.path}")

    try:
        with Bar("running") as bar, _operator(chosen, bar) as operator:
            plant = connect_each(chosen.plant, tuple(made.declaration.plants), _key(chosen))
            if chosen.self_test:
                found = self_test(
                    made.twin, plant, rate=made.sampled.rate, lockstep=chosen.lockstep, acknowledge=chosen.acknowledge
                )
                found.check()
            settings = hardware.RunSettings(
                lockstep=chosen.lockstep, acknowledge=chosen.acknowledge, progress=bar, keep=keep, stream=out,
                spare=chosen.spare, operator=operator,
            )  # fmt: skip
            recording = hardware.run(made, plant, settings)
        keep(recording)
        operator.wait()
    finally:
        if stream.is_in(out):
            print(f"masking: {out} holds what was recorded; {stream.MEND.format(out)}", file=sys.stderr)
    note = recording.manifest["rig"].get("recorder", {}).get("note")
    if note:
        print(f"masking: {note}", file=sys.stderr)
    end = recording.manifest["rig"]["end"]
    is_planned = end in {stopping.FINISHED, stopping.SYNCHRONISED}
    if not is_planned:
        trip = recording.manifest["rig"].get("trip")
        why = trip["sentence"] if trip else stopping.REASONS[end]
        print(f"masking: {end}: {why}; the record ends there", file=sys.stderr)
    return int(not is_planned)


def _batch(chosen: argparse.Namespace) -> int:
    """Make the runs of a plan unattended; started again, go on with it. Exit status 1 if one did not end as planned."""
    from masking.app.workflows import batch

    out = Path(chosen.out or f"results/{Path(chosen.plan).stem}")
    prepare(chosen.json, out)
    try:
        with Bar("running") as bar:
            found = batch.run(chosen.plan, out, plant=chosen.plant, key=chosen.key, say=bar.say, progress=bar)
    except KeyboardInterrupt:
        print(f"masking: interrupted; start the same again to go on with {out}", file=sys.stderr)
        return INTERRUPTED
    answer(chosen.json, found.as_dict(), f"{found}\npage: {out / 'batch.html'}")
    return int(found.done < len(found.runs))


def _operator(chosen: argparse.Namespace, bar: Bar) -> Operator:
    """Return who looks at the run."""
    from masking.app.workflows.operator_process import Attendant, attend
    from masking.lab.runs.operator_link import Operator

    if chosen.attended and chosen.page is None:
        raise OperatorError("--attended needs somebody who looks: add --page")

    def begin(ring: Path, switch: Path) -> Attendant:
        found = attend(ring, switch, chosen.page, chosen.stream)
        if found.page:
            bar.say(f"operator's page: {found.page}")
        return found

    is_shown = chosen.page is not None or chosen.stream is not None
    return Operator(begin if is_shown else None, is_attended=chosen.attended, stop_file=chosen.stop_file)


def _stop(chosen: argparse.Namespace) -> int:
    """Press the emergency stop of every run on this machine that this user started; exit status 1 if there is none."""
    from masking.lab.records.stop_switch import Presser, switches

    stopped = []
    for switch in switches():
        if not chosen.processes or switch.process in chosen.processes:
            switch.press(Presser.COMMAND_LINE)
            stopped.append(switch.process)
    text = f"stopped: {', '.join(f'process {one}' for one in stopped)}" if stopped else "no run to stop"
    answer(chosen.json, {"stopped": stopped}, text)
    return int(not stopped)


def _calibrate(chosen: argparse.Namespace) -> int:
    """Excite a rig, fit its plant file to the records, and validate the fit by a record held out."""
    from masking.app.workflows.calibrate import calibrate
    from masking.control.rig.twin import Twin
    from masking.lab.plants import adapters
    from masking.lab.plants.simulated import SimulatedPlant

    twin = Twin.load(chosen.plant)
    out = Path(chosen.out or f"results/{Path(chosen.plant).stem}_calibration")
    prepare(chosen.json, out)
    try:
        with Bar("calibrating") as bar:
            found = calibrate(
                twin,
                adapters.connect(chosen.at, _key(chosen)) if chosen.at else SimulatedPlant(twin),
                out,
                model=chosen.model,
                seconds=chosen.seconds,
                overwrite=chosen.overwrite,
                lockstep=chosen.lockstep or not chosen.at,
                say=bar.say,
                progress=bar,
            )
    except KeyboardInterrupt:
        print(f"masking: interrupted; the records stay in {out / 'records'}: run the same again to go on from there",
              file=sys.stderr)  # fmt: skip
        return INTERRUPTED
    return answer(chosen.json, found.as_dict(), found)


_OF_RIG = (
    Verb("check", _add_check, _check),
    Verb("serve", _add_serve, _serve),
    Verb("run", _add_run, _run),
    Verb("batch", _add_batch, _batch),
    Verb("stop", _add_stop, _stop),
    Verb("calibrate", _add_calibrate, _calibrate),
)
VERBS = (Verb("rig", _add_rig),)
