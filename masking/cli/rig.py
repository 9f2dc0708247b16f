"""Verbs of `masking rig`: serve, run, calibrate."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from masking.cli.options import Verb, add_json, add_verb
from masking.cli.progress import INTERRUPTED, Bar, raise_interrupts

if TYPE_CHECKING:
    from masking.records.recording import Recording


def _add_rig(sub: argparse.ArgumentParser) -> None:
    verbs = sub.add_subparsers(title="verbs", metavar="VERB", required=True)
    for verb in _OF_RIG:
        add_verb(verbs, verb)


def _add_common(sub: argparse.ArgumentParser) -> None:
    add_json(sub)
    sub.add_argument("--lockstep", action="store_true", help="each side waits for the other; no clock")


def _add_serve(sub: argparse.ArgumentParser) -> None:
    _add_common(sub)
    sub.add_argument("plant", metavar="PLANT", help="a YAML file, or a name that 'masking list' shows")
    sub.add_argument("--address", default="udp://127.0.0.1:5005", help="udp://host:port (default: %(default)s)")
    sub.add_argument("--record", metavar="DIR", help="folder for the twin's own record of each session")
    sub.add_argument("--seed", type=int, default=0, help="of the sensors' noise (default: 0)")
    sub.add_argument("--sessions", type=int, metavar="N", help="end after N sessions")


def _add_run(sub: argparse.ArgumentParser) -> None:
    _add_common(sub)
    sub.add_argument("experiment", metavar="EXPERIMENT", help="a YAML file, or a name that 'masking list' shows")
    sub.add_argument("--plant", metavar="ADDRESS", required=True, help="such as udp://127.0.0.1:5005")
    sub.add_argument("--out", metavar="DIR", help="where to save (default: results/EXPERIMENT_rig)")


def _add_calibrate(sub: argparse.ArgumentParser) -> None:
    _add_common(sub)
    sub.add_argument("plant", metavar="PLANT", help="the rig's plant file, or a packaged plant")
    sub.add_argument("--at", metavar="ADDRESS", help="such as udp://127.0.0.1:5005 (default: the plant's twin)")
    sub.add_argument("--model", metavar="MODEL", help="a model of the rig to fit beside that of the plant file")
    sub.add_argument("--seconds", type=float, default=40.0, help="length of each record (default: 40)")
    sub.add_argument("--out", metavar="DIR", help="records and result (default: results/PLANT_calibration)")


def _serve(chosen: argparse.Namespace) -> int:
    from masking.runs import hardware

    folders = hardware.serve(
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


def _run(chosen: argparse.Namespace) -> int:
    from masking.reports import run_report
    from masking.runs import hardware, stopping
    from masking.runs.experiment import Experiment
    from masking.workflows.outputs import check_folder

    made = Experiment.load(chosen.experiment)
    out = Path(chosen.out or f"results/{made.stem}_rig")
    check_folder(out)

    def keep(recording: Recording) -> None:
        bar.close()
        recording.save(out)
        written = run_report.report(recording, out)
        if chosen.json:
            content = {
                "masking_error": recording.manifest["masking_error"],
                "rig": recording.manifest["rig"],
                "recording": str(out),
            }
            print(json.dumps(content, indent=2))
        else:
            print(written.summary)
            print(f"report: {written.path}")

    with Bar("running") as bar:
        plant = hardware.connect(chosen.plant)
        recording = hardware.run(made, plant, lockstep=chosen.lockstep, progress=bar, keep=keep)
    keep(recording)
    end = recording.manifest["rig"]["end"]
    is_planned = end in {stopping.FINISHED, stopping.SYNCHRONISED}
    if not is_planned:
        print(f"masking: {end}: {stopping.REASONS[end]}; the record ends there", file=sys.stderr)
    return int(not is_planned)


def _calibrate(chosen: argparse.Namespace) -> int:
    from masking.plants.simulated import SimulatedPlant
    from masking.rig.twin import Twin
    from masking.runs import hardware
    from masking.workflows.calibrate import calibrate
    from masking.workflows.outputs import check_folder

    twin = Twin.load(chosen.plant)
    out = Path(chosen.out or f"results/{Path(chosen.plant).stem}_calibration")
    check_folder(out)
    raise_interrupts()
    try:
        with Bar("calibrating") as bar:
            found = calibrate(
                twin,
                hardware.connect(chosen.at) if chosen.at else SimulatedPlant(twin),
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


_OF_RIG = (
    Verb("serve", "serve the twin of a plant over UDP, on a clock of its own", _add_serve, _serve),
    Verb("run", "run an experiment on a plant that runs by itself, and write its report", _add_run, _run),
    Verb(
        "calibrate",
        "excite a rig, fit its plant file to the records, and validate the fit by a record held out",
        _add_calibrate,
        _calibrate,
    ),
)
VERBS = (Verb("rig", "run on a plant that runs by itself, or serve a twin that stands in for one", _add_rig),)
