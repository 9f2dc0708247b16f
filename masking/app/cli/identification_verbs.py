"""Verbs that compare a rig with records of it: simulate, identify, and the procedures of measure."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from masking.app.cli.options import (
    RECORD,
    Verb,
    add_json,
    add_of_tables,
    add_out,
    add_verb,
    answer,
    columns,
    names,
    prepare,
    settings_of_fit,
)
from masking.app.cli.progress import Bar
from masking.app.workflows.choices import METHODS

Option = tuple[str, Callable[[str], Any], str]  # of a procedure: placeholder of its value, how it is read, help


def _add_identify(sub: argparse.ArgumentParser) -> None:
    add_json(sub)
    sub.add_argument("records", metavar="RECORD", nargs="+", help=RECORD)
    sub.add_argument("--plant", metavar="PLANT", required=True, help="the plant that was recorded: a name or file")
    sub.add_argument("--model", metavar="MODEL", help="fit this model instead of the plant's own")
    sub.add_argument("--parameters", metavar="A,B", default="", help="what to fit (default: all of the equations)")
    sub.add_argument("--validate", metavar="RECORD", action="append", default=[], help="validation record")
    text = "length of the intervals of multiple shooting with which the fit starts (default: each record whole)"
    sub.add_argument("--shooting-interval", metavar="SECONDS", type=float, help=text)
    text = "least squares, or one pass of the extended Kalman filter (default: %(default)s)"
    sub.add_argument("--method", choices=METHODS, default=METHODS[0], help=text)
    sub.add_argument("--square-root", action="store_true", help="of the filter: carry a root of the covariance")
    sub.add_argument("--iterated", metavar="N", type=int, default=1, help="of the filter: linearise N times")
    add_of_tables(sub)
    add_out(sub, "results/identified")


def _identify(chosen: argparse.Namespace) -> int:
    """Fit parameters of a plant to recordings of it."""
    from masking.app.workflows.identify import identify

    out = Path(chosen.out or "results/identified")
    with Bar("fitting") as bar:
        found = identify(
            *chosen.records,
            model=chosen.model,
            method=chosen.method,
            square_root=chosen.square_root,
            iterated=chosen.iterated,
            out=out,
            overwrite=chosen.overwrite,
            progress=bar,
            **settings_of_fit(chosen),
        )
    files = {"model": str(out / "model.yaml"), "plant": str(out / "plant.yaml"), "page": str(out / "fit.html")}
    text = f"{found}\nwritten: {files['model']}, {files['plant']}\npage: {files['page']}"
    return answer(chosen.json, {**found.as_dict(), **files}, text)


def _add_simulate(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("model", metavar="MODEL", help="a model, or a plant file with its own: a name or a YAML file")
    sub.add_argument("record", metavar="RECORD", help=RECORD)
    text = "sensors and actuators of a model (default: its outputs or coordinates, and its inputs)"
    sub.add_argument("--plant", metavar="PLANT", help=text)
    add_of_tables(sub)
    text = "take the initial state from the readings of the first SECONDS (default: of all)"
    sub.add_argument("--initial", type=float, metavar="SECONDS", help=text)
    text = "length of shooting intervals, each with its own initial state (default: the whole record in one)"
    sub.add_argument("--shooting-interval", type=float, metavar="SECONDS", help=text)
    add_out(sub, "results/simulated")
    add_json(sub, after="RECORD")


def _simulate(chosen: argparse.Namespace) -> int:
    """Simulate a record with a model: measured against simulated."""
    from masking.app.workflows.simulate import simulate
    from masking.reports import fit_figures

    out = Path(chosen.out or "results/simulated")
    prepare(chosen.json, out)
    read = {"hold": chosen.hold, "columns": columns(chosen), "dt": chosen.dt}
    settings = {"plant": chosen.plant, "initial": chosen.initial, "shooting_interval": chosen.shooting_interval, **read}
    made = simulate(chosen.model, chosen.record, out=out, overwrite=chosen.overwrite, **settings)
    page = out / "simulation.html"
    return answer(
        chosen.json, page.with_suffix(".json").read_text("utf-8"), f"{fit_figures.summary(made)}\npage: {page}"
    )


_ONE: dict[str, Option] = {
    "input": ("V1", str, "the input that pushes (default: the only one that moves)"),
    "sensor": ("s1", str, "the sensor that shows the displacement (default: the only one)"),
}
# Procedures of measure: help, and options.
_PROCEDURES: dict[str, tuple[str, dict[str, Option]]] = {
    "springs": (
        "the curve of a spring from a slow ramp of force up and down, such as 60 s: Table B.4",
        {
            **_ONE,
            "order": ("N", int, "of the polynomial (default: 5)"),
            "settle": ("SECONDS", float, "left out at the start (default: 2)"),
            "scale": ("X", float, "unit of displacement of the coefficients (default: the plant's length, or 1)"),
            "force_scale": ("F", float, "unit of force of the coefficients (default: the plant's, or 1)"),
        },
    ),
    "actuators": (
        "the gain at which two actuators balance, from sines against each other with a swept gain: appendix C.5. The "
        "oscillator must be held: on a free rig its spring carries a part of the force, and the balance goes astray",
        {
            "first": ("V3", str, "the input with the sine of constant size"),
            "second": ("V1", str, "the input with the swept gain"),
            "sensor": ("s3", str, "the sensor that shows the motion of what both push (default: the only one)"),
            "frequency": ("HZ", float, "of the sines (default: that of the first input)"),
            "span": ("GAIN", float, "readings so near the balance are used (default: 0.3)"),
        },
    ),
    "friction": (
        "the shift of the equilibrium by friction, from saw-teeth, and the displacement at which it engages, from a "
        "ramp: appendix C.6.2",
        {**_ONE, "bins": ("N", int, "over the travel (default: 100)")},
    ),
    "response": (
        "frequency response from periods of a multisine, and distortion if lines are left free",
        {
            "inputs": ("V1,V2", names, "the inputs (default: all that move)"),
            "sensors": ("s1,s2", names, "the sensors (default: all)"),
            "period": ("SECONDS", float, "of the excitation (default: as the record states, or as it repeats)"),
            "discard": ("N", int, "periods left out at the start (default: 1)"),
        },
    ),
}


def _add_measure(sub: argparse.ArgumentParser) -> None:
    """Do one procedure of the identification on a record made for it."""
    procedures = sub.add_subparsers(title="procedures", metavar="PROCEDURE", required=True)
    for name, (text, options) in _PROCEDURES.items():
        add_verb(procedures, Verb(name, partial(_add_procedure, name, options), _measure, text))


def _add_procedure(name: str, options: dict[str, Option], sub: argparse.ArgumentParser) -> None:
    is_one = name in {"springs", "actuators"}
    text = "the folder of a recording" if is_one else "folders of recordings"
    sub.add_argument("records", metavar="RECORD", nargs=1 if is_one else "+", help=text)
    sub.add_argument("--plant", metavar="PLANT", help="what was recorded: readings become what its sensors measure")
    for option, (metavar, kind, words) in options.items():
        flag = {"inputs": "--input", "sensors": "--sensor"}.get(option, f"--{option.replace('_', '-')}")
        sub.add_argument(flag, dest=option, metavar=metavar, type=kind, help=words)
    add_out(sub, f"results/{name}")
    add_json(sub)
    sub.set_defaults(procedure=name, settings=[*options])


def _measure(chosen: argparse.Namespace) -> int:
    from masking.app.workflows.measure import measure

    out = Path(chosen.out or f"results/{chosen.procedure}")
    given = {name: value for name in chosen.settings if (value := getattr(chosen, name)) is not None}
    found = measure(chosen.procedure, *chosen.records, plant=chosen.plant, out=out, overwrite=chosen.overwrite, **given)
    page = out / f"{chosen.procedure}.html"
    content = {**found.as_dict(), "page": str(page), "numbers": str(page.with_suffix(".json"))}
    del content["series"]  # which the file has
    return answer(
        chosen.json, content, "\n".join([found.sentence, *(f"note: {n}" for n in found.notes), f"page: {page}"])
    )


VERBS = (
    Verb("simulate", _add_simulate, _simulate),
    Verb("identify", _add_identify, _identify),
    Verb("measure", _add_measure),
)
