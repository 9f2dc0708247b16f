"""Verbs of `masking rig`: serve, run, calibrate."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader as lazy

from masking.cli.options import add_to
from masking.cli.progress import INTERRUPTED, Bar, raise_interrupts
from masking.workflows import verbs

if TYPE_CHECKING:
    from masking.plants import simulated
    from masking.records.recording import Recording
    from masking.reports import run_report
    from masking.rig import twin as twins
    from masking.runs import experiment, realtime, stopping
    from masking.runs import hardware as rigs
    from masking.workflows import calibrate as calibration
else:
    calibration = lazy.load("masking.workflows.calibrate", suppress_warning=True)
    stopping = lazy.load("masking.runs.stopping", suppress_warning=True)
    experiment = lazy.load("masking.runs.experiment", suppress_warning=True)
    realtime = lazy.load("masking.runs.realtime", suppress_warning=True)
    run_report = lazy.load("masking.reports.run_report", suppress_warning=True)
    rigs = lazy.load("masking.runs.hardware", suppress_warning=True)
    simulated = lazy.load("masking.plants.simulated", suppress_warning=True)
    twins = lazy.load("masking.rig.twin", suppress_warning=True)


def add_rig(found: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the verbs of `masking rig`."""
    rig = found.add_parser("rig", help="run on a plant that runs by itself, or serve a twin that stands in for one")
    verb_of_rig = rig.add_subparsers(title="verbs", metavar="VERB", required=True)

    add_to_rig = add_to(verb_of_rig, ("--lockstep", "each side waits for the other; no clock"))
    serving = add_to_rig(_rig_serve, "serve", "serve the twin of a plant over UDP, on a clock of its own")
    serving.add_argument("plant", metavar="PLANT", help="a YAML file, or a name that 'masking list' shows")
    serving.add_argument("--address", default="udp://127.0.0.1:5005", help="udp://host:port (default: %(default)s)")
    serving.add_argument("--record", metavar="DIR", help="folder for the twin's own record of each session")
    serving.add_argument("--seed", type=int, default=0, help="of the sensors' noise (default: 0)")
    serving.add_argument("--sessions", type=int, metavar="N", help="end after N sessions")
    running = add_to_rig(_rig_run, "run", "run an experiment on a plant that runs by itself, and write its report")
    running.add_argument("experiment", metavar="EXPERIMENT", help="a YAML file, or a name that 'masking list' shows")
    running.add_argument("--plant", metavar="ADDRESS", required=True, help="such as udp://127.0.0.1:5005")
    running.add_argument("--out", metavar="DIR", help="where to save (default: results/EXPERIMENT_rig)")
    text = "excite a rig, fit its plant file to the records, and validate the fit on another"
    calibrating = add_to_rig(_rig_calibrate, "calibrate", text)
    calibrating.add_argument("plant", metavar="PLANT", help="the rig's plant file, or a packaged plant")
    calibrating.add_argument("--at", metavar="ADDRESS", help="such as udp://127.0.0.1:5005 (default: the plant's twin)")
    calibrating.add_argument("--model", metavar="MODEL", help="a model of the rig to fit beside that of the plant file")
    calibrating.add_argument("--seconds", type=float, default=40.0, help="length of each record (default: 40)")
    calibrating.add_argument("--out", metavar="DIR", help="records and result (default: results/PLANT_calibration)")


def _rig_serve(chosen: argparse.Namespace) -> int:
    folders = rigs.serve(
        chosen.plant,
        chosen.address,
        lockstep=chosen.lockstep,
        record=chosen.record,
        seed=chosen.seed,
        sessions=chosen.sessions,
        ready=lambda address: print(f"{chosen.plant} is served at {address}", file=sys.stderr, flush=True),
    )
    if chosen.json:
        print(json.dumps({"records": [str(folder) for folder in folders]}, indent=2))
    else:
        print("\n".join(f"record: {folder}" for folder in folders))
    return 0


def _rig_run(chosen: argparse.Namespace) -> int:
    made = experiment.Experiment.load(chosen.experiment)
    out = Path(chosen.out or f"results/{made.stem}_rig")
    verbs.check_folder(out)

    def keep(recording: Recording) -> None:
        bar.close()
        recording.save(out)
        written = run_report.report(recording, out)
        if chosen.json:
            result = {
                "masking_error": recording.manifest["masking_error"],
                "rig": recording.manifest["rig"],
                "recording": str(out),
            }
            print(json.dumps(result, indent=2))
        else:
            print(written.summary)
            print(f"report: {written.path}")

    with Bar("running") as bar:
        plant = rigs.connect(chosen.plant)
        recording = rigs.run(made, plant, lockstep=chosen.lockstep, progress=bar, keep=keep)
    keep(recording)
    end = recording.manifest["rig"]["end"]
    is_planned = end in {realtime.FINISHED, stopping.SYNCHRONISED}
    if not is_planned:
        print(f"masking: the run was {end}; the record ends there", file=sys.stderr)
    return int(not is_planned)


def _rig_calibrate(chosen: argparse.Namespace) -> int:
    twin = twins.Twin.load(chosen.plant)
    out = Path(chosen.out or f"results/{Path(chosen.plant).stem}_calibration")
    verbs.check_folder(out)
    raise_interrupts()
    try:
        with Bar("calibrating") as bar:
            found = calibration.calibrate(
                twin,
                rigs.connect(chosen.at) if chosen.at else simulated.SimulatedPlant(twin),
                out,
                model=chosen.model,
                seconds=chosen.seconds,
                lockstep=chosen.lockstep or not chosen.at,
                say=bar.say,
                progress=bar,
            )
    except KeyboardInterrupt:
        print(f"masking: interrupted; the records stay in {out / 'records'}: run the same again to go on from there",
              file=sys.stderr)  # fmt: skip
        return INTERRUPTED
    print(json.dumps(found.as_dict(), indent=2) if chosen.json else found)
    return 0
