"""The command line: one sub-command for each verb, each a few lines over `masking.verbs`."""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
Option = tuple[str, Callable[[str], Any], str]  # of a procedure: what stands for its value, how it is read, help
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
    text = "least squares, or one pass of the extended Kalman filter (default: %(default)s)"
    identify.add_argument("--method", choices=verbs.METHODS, default=verbs.METHODS[0], help=text)
    identify.add_argument("--square-root", action="store_true", help="of the filter: carry a root of the covariance")
    identify.add_argument("--iterated", metavar="N", type=int, default=1, help="of the filter: linearise N times")
    identify.add_argument("--out", metavar="DIR", help="where to save (default: results/identified)")
    report = add(_report, "report", "write the report of a recording")
    report.add_argument("record", metavar="RECORD", help="the folder of a recording")
    report.add_argument("--out", metavar="DIR", help="where to write (default: beside the recording)")
    _add_measure(found)
    _add_rig(found)
    return parser


def _add_measure(found: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the procedures of `masking measure`."""
    measure = found.add_parser("measure", help="do one procedure of the identification on a record made for it")
    procedures = measure.add_subparsers(title="procedures", metavar="PROCEDURE", required=True)

    def add(name: str, text: str, options: Mapping[str, Option]) -> None:
        sub = procedures.add_parser(name, help=text.partition(":")[0], description=f"{text[0].upper()}{text[1:]}.")
        is_one = verbs.PROCEDURES[name] == 1
        what = "the folder of a recording" if is_one else "folders of recordings"
        sub.add_argument("records", metavar="RECORD", nargs=1 if is_one else "+", help=what)
        sub.add_argument("--plant", metavar="PLANT", help="what was recorded: readings become what its sensors measure")
        for option, (metavar, kind, words) in options.items():
            flag = {"inputs": "--input", "sensors": "--sensor"}.get(option, f"--{option.replace('_', '-')}")
            sub.add_argument(flag, dest=option, metavar=metavar, type=kind, help=words)
        sub.add_argument("--out", metavar="DIR", help=f"where to save (default: results/{name})")
        sub.add_argument("--json", action="store_true", help="print JSON")
        sub.set_defaults(verb=_measure, procedure=name, settings=[*options])

    one: dict[str, Option] = {
        "input": ("V1", str, "the input that pushes (default: the only one that moves)"),
        "sensor": ("s1", str, "the sensor that shows the displacement (default: the only one)"),
    }
    text = "the curve of a spring from a slow ramp of force up and down, such as 60 s: Table B.4"
    springs: dict[str, Option] = {
        "order": ("N", int, "of the polynomial (default: 5)"),
        "settle": ("SECONDS", float, "left out at the start (default: 2)"),
        "scale": ("X", float, "unit of displacement of the coefficients (default: the plant's length, or 1)"),
        "force_scale": ("F", float, "unit of force of the coefficients (default: the plant's, or 1)"),
    }
    add("springs", text, one | springs)
    text = (
        "the gain at which two actuators balance, from sines against each other with a swept gain: appendix C.5. The "
        "oscillator must be held: on a free rig its spring carries a part of the force, and the balance goes astray"
    )
    actuators: dict[str, Option] = {
        "first": ("V3", str, "the input with the sine of constant size"),
        "second": ("V1", str, "the input with the swept gain"),
        "sensor": ("s3", str, "the sensor that shows the motion of what both push (default: the only one)"),
        "frequency": ("HZ", float, "of the sines (default: that of the first input)"),
        "span": ("GAIN", float, "readings so near the balance are used (default: 0.3)"),
    }
    add("actuators", text, actuators)
    text = (
        "how far friction shifts the equilibrium, from saw-teeth, and where over the displacement it engages, from a "
        "ramp: appendix C.6.2"
    )
    friction: dict[str, Option] = {"bins": ("N", int, "over the travel (default: 100)")}
    add("friction", text, one | friction)
    response: dict[str, Option] = {
        "inputs": ("V1,V2", _names, "the inputs (default: all that move)"),
        "sensors": ("s1,s2", _names, "the sensors (default: all)"),
        "period": ("SECONDS", float, "of the excitation (default: what the record tells or repeats with)"),
        "discard": ("N", int, "periods at the start that are left out (default: 1)"),
    }
    add(
        "response", "frequency response from periods of a multisine, and distortion where lines are left free", response
    )


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
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    bar = tqdm.tqdm(total=1.0, desc="calibrating", delay=1.0, leave=False, disable=None, bar_format=BAR)

    def progress(part: float) -> None:
        bar.update(part - bar.n)

    def say(text: str) -> None:
        with bar.external_write_mode(file=sys.stderr):
            print(text, file=sys.stderr, flush=True)

    try:
        found = calibration.calibrate(
            twin,
            rigs.connect(chosen.at) if chosen.at else simulated.SimulatedPlant(twin),
            out,
            model=chosen.model,
            seconds=chosen.seconds,
            lockstep=chosen.lockstep or not chosen.at,
            say=say,
            progress=progress,
        )
    except KeyboardInterrupt:
        bar.close()
        print(f"masking: interrupted; the records stay in {out / 'records'}: run the same again to go on from there",
              file=sys.stderr)  # fmt: skip
        return INTERRUPTED
    finally:
        bar.close()
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
            parameters=_names(chosen.parameters),
            validation=chosen.validate,
            horizon=chosen.horizon,
            method=chosen.method,
            square_root=chosen.square_root,
            iterated=chosen.iterated,
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
        print(f"page: {out / 'fit.html'}")
    return 0


def _measure(chosen: argparse.Namespace) -> int:
    out = Path(chosen.out or f"results/{chosen.procedure}")
    given = {name: value for name in chosen.settings if (value := getattr(chosen, name)) is not None}
    found = verbs.measure(chosen.procedure, *chosen.records, plant=chosen.plant, out=out, **given)
    page = out / f"{chosen.procedure}.html"
    if chosen.json:
        told = found.as_dict()
        del told["series"]  # which the file has
        print(json.dumps({**told, "page": str(page), "numbers": str(page.with_suffix(".json"))}, indent=2))
    else:
        print("\n".join([found.sentence, *(f"note: {note}" for note in found.notes)]))
        print(f"page: {page}")
    return 0


def _names(text: str) -> tuple[str, ...]:
    """Read names with commas between them."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


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
