"""The command line: one sub-command for each verb, each a few lines over `masking.verbs`."""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader as lazy

from masking import verbs
from masking.errors import DeclarationError, MaskingError, Problem

if TYPE_CHECKING:
    import tqdm

    from masking import budget, calibration, experiment, realtime, reporting
    from masking import rig as rigs
    from masking import twin as twins
    from masking.plants import simulated
    from masking.recording import Recording
else:
    budget = lazy.load("masking.budget", suppress_warning=True)
    calibration = lazy.load("masking.calibration", suppress_warning=True)
    experiment = lazy.load("masking.experiment", suppress_warning=True)
    realtime = lazy.load("masking.realtime", suppress_warning=True)
    reporting = lazy.load("masking.reporting", suppress_warning=True)
    rigs = lazy.load("masking.rig", suppress_warning=True)
    simulated = lazy.load("masking.plants.simulated", suppress_warning=True)
    tqdm = lazy.load("tqdm")
    twins = lazy.load("masking.twin", suppress_warning=True)

INTERRUPTED = 130
BAR = "{desc} {percentage:3.0f}% {bar}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status: 0 done, 1 a run that stopped, 2 something to mend first."""
    if arguments is None:  # in a process of its own, which an interrupt may end while packages are still loading
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    chosen = _parser().parse_args(arguments)
    try:
        status: int = chosen.verb(chosen)
        sys.stdout.flush()
    except MaskingError as error:
        _tell(error, as_json=chosen.json)
        return error.exit_status
    except KeyboardInterrupt:
        print("masking: interrupted; nothing was saved", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader, such as head, has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    return status


def _tell(error: MaskingError, *, as_json: bool) -> None:
    problems = error.problems if isinstance(error, DeclarationError) else ()
    if as_json:
        print(json.dumps({"error": str(error), "problems": [p.as_dict() for p in problems]}, indent=2))
    print(error if problems else f"masking: {error}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="masking", description="Make an actuated rig move as if it were another machine."
    )
    found = parser.add_subparsers(title="verbs", metavar="VERB", required=True)

    def add(verb: Callable[[argparse.Namespace], int], name: str, text: str) -> argparse.ArgumentParser:
        sub = found.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        sub.add_argument("--json", action="store_true", help="print JSON")
        sub.set_defaults(verb=verb)
        return sub

    add(_list, "list", "list the models, plants and experiments that are there")
    show = add(_show, "show", "show a model, a plant or an experiment: equations, parameters, blocks")
    show.add_argument("name", metavar="NAME", help="a name that 'masking list' shows, or a YAML file")
    show.add_argument("--kind", choices=verbs.KINDS, help="which, where the name stands for more than one")
    check = add(
        _check, "check", "check declarations, say where each problem is, and whether an experiment fits its rig"
    )
    check.epilog = "Exit status: 0 sound, 1 sound but an experiment does not fit the limits of its rig, 2 problems."
    check.add_argument("files", metavar="FILE", nargs="+", help="YAML files or names")
    schema = add(_schema, "schema", "print the JSON Schema of a kind of declaration, for editors")
    schema.add_argument("kind", choices=verbs.KINDS)
    run = add(_run, "run", "run an experiment, save its recording and write its report")
    run.add_argument("experiment", metavar="EXPERIMENT", help="a YAML file, or a name that 'masking list' shows")
    run.add_argument("--set", metavar="NAME=VALUE", action="append", default=[], help="change a virtual parameter")
    run.add_argument("--plant", metavar="PLANT", help="run on another plant: a name or a YAML file")
    run.add_argument("--out", metavar="DIR", help="where to save (default: results/EXPERIMENT)")
    run.add_argument(
        "--budget",
        action=argparse.BooleanOptionalAction,
        help="find out what limits the fidelity, by runs without each cause (default: where they take a few seconds)",
    )
    identify = add(_identify, "identify", "fit parameters of a plant to recordings of it")
    identify.add_argument("records", metavar="RECORD", nargs="+", help="folders of recordings")
    identify.add_argument("--plant", metavar="PLANT", required=True, help="the plant that was recorded: a name or file")
    identify.add_argument("--model", metavar="MODEL", help="fit this model instead of the plant's own")
    identify.add_argument("--parameters", metavar="A,B", default="", help="what to fit (default: all of the equations)")
    identify.add_argument("--validate", metavar="RECORD", action="append", default=[], help="judge by this recording")
    identify.add_argument("--horizon", metavar="SECONDS", type=float, help="begin with windows of so many seconds")
    identify.add_argument("--out", metavar="DIR", help="where to save (default: results/identified)")
    report = add(_report, "report", "write the report of a recording")
    report.add_argument("record", metavar="RECORD", help="the folder of a recording")
    report.add_argument("--out", metavar="DIR", help="where to write (default: beside the recording)")
    _add_rig(found)
    return parser


def _add_rig(found: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the verbs of `masking rig`."""
    rig = found.add_parser("rig", help="run on a plant that runs by itself, or serve a twin that stands in for one")
    verb_of_rig = rig.add_subparsers(title="verbs", metavar="VERB", required=True)

    def add_to_rig(verb: Callable[[argparse.Namespace], int], name: str, text: str) -> argparse.ArgumentParser:
        sub = verb_of_rig.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        sub.add_argument("--json", action="store_true", help="print JSON")
        sub.add_argument("--lockstep", action="store_true", help="each side waits for the other; no clock")
        sub.set_defaults(verb=verb)
        return sub

    serving = add_to_rig(_rig_serve, "serve", "serve the twin of a plant over UDP, on a clock of its own")
    serving.add_argument("plant", metavar="PLANT", help="a YAML file, or a name that 'masking list' shows")
    serving.add_argument("--address", default="udp://127.0.0.1:5005", help="udp://host:port (default: %(default)s)")
    serving.add_argument("--record", metavar="DIR", help="folder for the twin's own record of each session")
    serving.add_argument("--seed", type=int, default=0, help="of the sensors' noise (default: 0)")
    serving.add_argument("--sessions", type=int, metavar="N", help="end after so many sessions")
    running = add_to_rig(_rig_run, "run", "run an experiment on a plant that runs by itself, and write its report")
    running.add_argument("experiment", metavar="EXPERIMENT", help="a YAML file, or a name that 'masking list' shows")
    running.add_argument("--plant", metavar="ADDRESS", required=True, help="such as udp://127.0.0.1:5005")
    running.add_argument("--out", metavar="DIR", help="where to save (default: results/EXPERIMENT_rig)")
    text = "excite a rig, fit its plant file to the records, and judge the fit by one it has not seen"
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
    bar = tqdm.tqdm(total=1.0, desc="running", delay=1.0, leave=False, disable=None, bar_format=BAR)

    def progress(part: float) -> None:
        bar.update(part - bar.n)

    def keep(recording: Recording) -> None:
        bar.close()
        recording.save(out)
        written = reporting.report(recording, out)
        if chosen.json:
            told = {"fidelity": recording.manifest["fidelity"], "rig": recording.manifest["rig"], "recording": str(out)}
            print(json.dumps(told, indent=2))
        else:
            print(written.summary)
            print(f"report: {written.path}")

    try:
        plant = rigs.connect(chosen.plant)
        recording = rigs.run(made, plant, lockstep=chosen.lockstep, progress=progress, keep=keep)
    finally:
        bar.close()
    keep(recording)
    end = recording.manifest["rig"]["end"]
    if end != realtime.FINISHED:
        print(f"masking: the run was {end}; the record ends there", file=sys.stderr)
    return int(end != realtime.FINISHED)


def _rig_calibrate(chosen: argparse.Namespace) -> int:
    twin = twins.Twin.load(chosen.plant)
    out = Path(chosen.out or f"results/{Path(chosen.plant).stem}_calibration")
    verbs.check_folder(out)
    found = calibration.calibrate(
        twin,
        rigs.connect(chosen.at) if chosen.at else simulated.SimulatedPlant(twin),
        out,
        model=chosen.model,
        seconds=chosen.seconds,
        lockstep=chosen.lockstep or not chosen.at,
        say=lambda text: print(text, file=sys.stderr, flush=True),
    )
    print(json.dumps(found.as_dict(), indent=2) if chosen.json else found)
    return 0


def _list(chosen: argparse.Namespace) -> int:
    entries = verbs.list()
    if chosen.json:
        print(json.dumps([asdict(entry) for entry in entries], indent=2))
        return 0
    width = max(len(entry.name) for entry in entries)
    for kind in verbs.KINDS:
        print(f"{kind}s")
        for entry in entries:
            if entry.kind == kind:
                print(f"  {entry.name:{width}}  {entry.title}")
    return 0


def _show(chosen: argparse.Namespace) -> int:
    description = verbs.show(chosen.name, chosen.kind)
    print(description.to_json() if chosen.json else description)
    return 0


def _check(chosen: argparse.Namespace) -> int:
    results = verbs.check(*chosen.files, compiling=_say_compiling)
    if chosen.json:
        told = [
            {
                "file": r.file,
                "kind": r.kind,
                "problems": [p.as_dict() for p in r.problems],
                "feasibility": r.feasibility.as_dict() if r.feasibility else None,
                "untold": r.untold,
            }
            for r in results
        ]
        print(json.dumps(told, indent=2))
    else:
        for result in results:
            print("\n".join(map(str, result.problems)) or f"{result.file}: a sound {result.kind}")
            if result.feasibility is not None:
                print(result.feasibility)
            elif result.untold:
                print(f"  whether it fits cannot be told: {result.untold}")
    return max(result.exit_status for result in results)


def _say_compiling() -> None:
    print("compiling; this takes some ten seconds, once for each system", file=sys.stderr)


def _schema(chosen: argparse.Namespace) -> int:
    print(json.dumps(verbs.schema(chosen.kind), indent=2))
    return 0


def _run(chosen: argparse.Namespace) -> int:
    changes = dict(_change(text) for text in chosen.set)
    made = experiment.Experiment.load(chosen.experiment, plant=chosen.plant, changes=changes)
    out = Path(chosen.out or f"results/{made.stem}")
    verbs.check_folder(out)
    before = _created(out)
    if not made.is_compiled:
        _say_compiling()
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    bar = tqdm.tqdm(total=1.0, desc="running", delay=1.0, leave=False, disable=None, bar_format=BAR)

    def progress(part: float) -> None:
        bar.update(part - bar.n)

    try:
        recording = budget.run(made, chosen.budget, progress)
    except MaskingError:
        if before:
            print(f"{out} still holds the run of {before}", file=sys.stderr)
        raise
    finally:
        bar.close()
    recording.save(out)
    written = reporting.report(recording, out)
    if chosen.json:
        told = {
            "fidelity": recording.manifest["fidelity"],
            "limits_used": reporting.limits_used(recording),
            "warnings": reporting.warnings(recording),
            "recording": str(out),
            "report": str(written.path),
        }
        print(json.dumps(told, indent=2))
    else:
        print(written.summary)
        print(f"report: {written.path}" + (f" (replaces the run of {before})" if before else ""))
    return 0


def _created(folder: Path) -> str | None:
    """Return when the recording in a folder was made; None where there is none."""
    try:
        return str(json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["created"])
    except (OSError, ValueError, KeyError):
        return None


def _identify(chosen: argparse.Namespace) -> int:
    out = Path(chosen.out or "results/identified")
    bar = tqdm.tqdm(total=1.0, desc="fitting", delay=1.0, leave=False, disable=None, bar_format=BAR)

    def progress(part: float) -> None:
        bar.update(part - bar.n)

    try:
        found = verbs.identify(
            *chosen.records,
            plant=chosen.plant,
            model=chosen.model,
            parameters=[name.strip() for name in chosen.parameters.split(",") if name.strip()],
            validation=chosen.validate,
            horizon=chosen.horizon,
            out=out,
            progress=progress,
        )
    finally:
        bar.close()
    if chosen.json:
        print(
            json.dumps(
                {**found.as_dict(), "model": str(out / "model.yaml"), "plant": str(out / "plant.yaml")}, indent=2
            )
        )
    else:
        print(found)
        print(f"written: {out / 'model.yaml'}, {out / 'plant.yaml'}")
    return 0


def _report(chosen: argparse.Namespace) -> int:
    written = verbs.report(chosen.record, chosen.out)
    if chosen.json:
        print(json.dumps({"report": str(written.path), "figures": [str(f) for f in written.figures]}, indent=2))
    else:
        print(written.summary)
        print(f"report: {written.path}")
    return 0


def _change(text: str) -> tuple[str, float]:
    """Read one NAME=VALUE of the command line."""
    name, equals, value = text.partition("=")
    try:
        if not equals:
            raise ValueError(text)
        return name.strip(), float(value)
    except ValueError:
        message = f"'{text}' is not a change of a parameter"
        raise DeclarationError(Problem(None, "--set", message, "write it as in --set w3=0.6")) from None


if __name__ == "__main__":
    sys.exit(main())
