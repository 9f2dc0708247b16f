"""Verbs of `masking rig`: check, serve, run, batch, stop, calibrate, learn."""

from __future__ import annotations

import dataclasses
import math
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from masking.app.cli.terminal import Bar, raise_interrupts
from masking.app.cli.verb import Call, Verb, verb
from masking.errors import OperatorError

if TYPE_CHECKING:
    from masking.app.workflows.rig_settings import CheckSettings, RunSettings, ServeSettings
    from masking.lab.plants.arming import Arming
    from masking.lab.plants.authentication import Key
    from masking.lab.records.recording import Recording
    from masking.lab.runs.operator_link import Operator


_GO_ON = "masking: interrupted; start the same again to go on with {out}"


def _key(file: str | None) -> Key | None:
    from masking.lab.plants.authentication import Key

    return Key.read(file) if file is not None else None


@verb("app.workflows.rig_settings:CheckSettings")
def _check(call: Call) -> int:
    """Check that a plant keeps the rules of the interface, and that its rig answers; exit status 1 if not."""
    from masking.control.rig.twin import Twin
    from masking.lab.plants import adapters, conformance
    from masking.lab.plants.interface import Settings
    from masking.lab.runs.self_test import allowed, self_test

    chosen: CheckSettings = call.do()
    settings = Settings(chosen.rate, conformance.WATCHDOG, chosen.lockstep, chosen.acknowledge)
    make_plant = partial(adapters.connect, chosen.address, _key(chosen.key))
    twin = Twin.load(chosen.plant) if chosen.plant else None
    conformance.reach(make_plant, settings, chosen.amplitude, math.inf if twin is None else allowed(twin))
    found = conformance.verdicts(make_plant, settings, amplitude=chosen.amplitude)
    broken = sum(len(verdict.broken) for verdict in found)
    content: dict[str, Any] = {"address": chosen.address, "rules": [dataclasses.asdict(verdict) for verdict in found]}
    text = "\n".join([*map(str, found), f"{chosen.address} {'does not conform' if broken else 'conforms'}"])
    if twin is not None and not broken:
        plant, rate = make_plant(), chosen.rate
        tested = self_test(
            twin, plant, size=chosen.pulse, rate=rate, lockstep=chosen.lockstep, acknowledge=chosen.acknowledge
        )
        content, text = content | {"self_test": tested.as_dict()}, f"{text}\nself-test:\n{tested}"
        broken = len(tested.findings)
    call.answer(content, text)
    return int(broken > 0)


@verb("app.workflows.rig_settings:ServeSettings")
def _serve(call: Call) -> int:
    """Serve a plant, or the twin of one, over UDP or a serial line, on a clock of its own."""
    from masking.lab.plants.controller_session import Allowed
    from masking.lab.plants.serve import Serving
    from masking.lab.runs import rig_run

    chosen: ServeSettings = call.do()
    serving = Serving(
        clock="lockstep" if chosen.lockstep else "real",
        record=chosen.record,
        sessions=chosen.sessions,
        allowed=Allowed(chosen.watchdog, chosen.rates),
        key=_key(chosen.key),
    )
    folders = rig_run.serve(
        chosen.plant,
        chosen.address,
        serving,
        seed=chosen.seed,
        limits=chosen.limits,
        ready=lambda address: print(f"{chosen.plant} is served at {address}", file=sys.stderr, flush=True),
    )
    records = [str(folder) for folder in folders]
    return call.answer({"records": records}, "\n".join(f"record: {folder}" for folder in records))


@verb("app.workflows.rig_settings:RunSettings", out="results/{experiment}_rig", metavars={"plant": "[NAME=]ADDRESS"})
def _run(call: Call) -> int:
    """Run an experiment on a plant that runs by itself, and write its report."""
    from masking.app.workflows.output_folders import RUN, own_folder
    from masking.app.workflows.run import save
    from masking.lab.plants.group import connect_each
    from masking.lab.records import stream
    from masking.lab.runs import rig_run, stopping
    from masking.lab.runs.experiment import Experiment
    from masking.lab.runs.self_test import self_test
    from masking.reports.run_report import strayed

    chosen: RunSettings = call.do()
    made = Experiment.load(chosen.experiment)
    out = call.out
    with own_folder(out, *RUN, overwrite=chosen.overwrite):
        stream.remove(out)

        def keep(recording: Recording) -> None:
            bar.close()
            written = save(recording, out)
            content = {name: recording.manifest[name] for name in ("masking_error", "rig")} | {"recording": str(out)}
            call.answer(content, f"{written.summary}\nreport: {written.path}")

        try:
            with Bar("running") as bar, _operator(chosen, bar) as operator:
                plant = connect_each([*map(str, chosen.plant)], tuple(made.declaration.plants), _key(chosen.key))
                if chosen.self_test:
                    found = self_test(
                        made.twin,
                        plant,
                        rate=made.sampled.rate,
                        lockstep=chosen.lockstep,
                        acknowledge=chosen.acknowledge,
                    )
                    found.check()
                settings = rig_run.RunSettings(
                    lockstep=chosen.lockstep, acknowledge=chosen.acknowledge, progress=bar, keep=keep, stream=out,
                    spare=chosen.spare, operator=operator, arming=partial(_arming, bar),
                )  # fmt: skip
                recording = rig_run.run(made, plant, settings)
            keep(recording)
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
        if trip and chosen.page is not None:
            print("masking: the page shows this until it is acknowledged, there or here by Ctrl+C", file=sys.stderr)
            raise_interrupts()
            operator.wait()
    other = strayed(recording) if is_planned else ""
    if other:
        print(f"masking: {end}, but otherwise than wanted: {other}", file=sys.stderr)
    return int(not is_planned or (end == stopping.FINISHED and bool(other)))


@verb(
    "app.workflows.batch:run",
    out="results/{plan}",
    doing="running",
    interrupted=_GO_ON,
    metavars={"plant": "ADDRESS"},
)
def _batch(call: Call) -> int:
    """Make the runs of a plan unattended; started again, go on with it. Exit status 1 if one did not end as planned."""
    found = call.do()
    call.answer(found, f"{found}\npage: {call.out / 'batch.html'}")
    return int(found.done < len(found.runs))


def _arming(bar: Bar) -> Arming:
    from masking.lab.plants.arming import HOW, Arming

    bar.say(f"the plant waits: {HOW}")
    return Arming(sys.stdin)


def _operator(chosen: RunSettings, bar: Bar) -> Operator:
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


@verb("app.workflows.emergency_stop:stop", metavars={"processes": "PROCESS"})
def _stop(call: Call) -> int:
    """Press the emergency stop of a run of this user on this machine; of several, name some or say --all.

    The exit status is 1 if there is no run, and 2 if one goes on and none was stopped, or not all that were named.
    """
    stopped = call.do()
    text = f"stopped: {', '.join(f'process {process}' for process in stopped)}" if stopped else "no run to stop"
    call.answer({"stopped": stopped}, text)
    return int(not stopped)


_CALIBRATE = Verb(
    "calibrate",
    "Excite a rig, fit its plant file to the records, and validate the fit by a record held out.",
    "app.workflows.calibrate:calibrate_at",
    out="results/{plant}_calibration",
    doing="calibrating",
    interrupted="masking: interrupted; the records stay in {out}/records: run the same again to go on from there",
)
_LEARN = Verb(
    "learn",
    "Let a rig find out by itself what it is: excite it, find what its plant file lacks, and put that into control.",
    "app.workflows.learn:learn_at",
    out="results/{plant}_learning",
    doing="learning",
    interrupted=_GO_ON,
)
_TEXT = "Run on a plant that runs by itself, or serve a twin that stands in for one."
VERBS = (Verb("rig", _TEXT, verbs=(_check, _serve, _run, _batch, _stop, _CALIBRATE, _LEARN)),)
