"""Verbs that find a rig from records of it: identify, and the procedures of measure."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lazy_loader as lazy

from masking.cli.options import RECORD, Add, add_of_tables, names
from masking.cli.progress import Bar
from masking.workflows import verbs

if TYPE_CHECKING:
    from masking.records import readers
else:
    readers = lazy.load("masking.records.readers", suppress_warning=True)

Option = tuple[str, Callable[[str], Any], str]  # of a procedure: what stands for its value, how it is read, help


def add(verb: Add) -> None:
    """Add the verb identify."""
    identify = verb(_identify, "identify", "fit parameters of a plant to recordings of it")
    identify.add_argument("records", metavar="RECORD", nargs="+", help=RECORD)
    identify.add_argument("--plant", metavar="PLANT", required=True, help="the plant that was recorded: a name or file")
    identify.add_argument("--model", metavar="MODEL", help="fit this model instead of the plant's own")
    identify.add_argument("--parameters", metavar="A,B", default="", help="what to fit (default: all of the equations)")
    identify.add_argument("--validate", metavar="RECORD", action="append", default=[], help="validate on it")
    text = "length of the intervals of multiple shooting with which the fit starts (default: each record whole)"
    identify.add_argument("--shooting-interval", metavar="SECONDS", type=float, help=text)
    text = "least squares, or one pass of the extended Kalman filter (default: %(default)s)"
    identify.add_argument("--method", choices=verbs.METHODS, default=verbs.METHODS[0], help=text)
    identify.add_argument("--square-root", action="store_true", help="of the filter: carry a root of the covariance")
    identify.add_argument("--iterated", metavar="N", type=int, default=1, help="of the filter: linearise N times")
    add_of_tables(identify)
    identify.add_argument("--out", metavar="DIR", help="where to save (default: results/identified)")


def add_measure(found: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
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
        "inputs": ("V1,V2", names, "the inputs (default: all that move)"),
        "sensors": ("s1,s2", names, "the sensors (default: all)"),
        "period": ("SECONDS", float, "of the excitation (default: as the record states, or as it repeats)"),
        "discard": ("N", int, "periods at the start that are left out (default: 1)"),
    }
    add(
        "response", "frequency response from periods of a multisine, and distortion where lines are left free", response
    )


def _identify(chosen: argparse.Namespace) -> int:
    out = Path(chosen.out or "results/identified")
    with Bar("fitting") as bar:
        found = verbs.identify(
            *chosen.records,
            plant=chosen.plant,
            model=chosen.model,
            parameters=names(chosen.parameters),
            validation=chosen.validate,
            shooting_interval=chosen.shooting_interval,
            method=chosen.method,
            square_root=chosen.square_root,
            iterated=chosen.iterated,
            hold=chosen.hold,
            columns=readers.mapping(chosen.map),
            dt=chosen.dt,
            out=out,
            progress=bar,
        )
    if chosen.json:
        files = {"model": str(out / "model.yaml"), "plant": str(out / "plant.yaml"), "page": str(out / "fit.html")}
        print(json.dumps({**found.as_dict(), **files}, indent=2))
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
        result = found.as_dict()
        del result["series"]  # which the file has
        print(json.dumps({**result, "page": str(page), "numbers": str(page.with_suffix(".json"))}, indent=2))
    else:
        print("\n".join([found.sentence, *(f"note: {note}" for note in found.notes)]))
        print(f"page: {page}")
    return 0
