"""The verb export: a controller, a rig or a model as source that runs without this package."""

from __future__ import annotations

import argparse

from masking.app.cli.options import NAMED, Verb, add_json, add_out, answer
from masking.app.cli.run_verbs import change
from masking.app.workflows.choices import EXPORTED, REALS, TARGETS


def _add(sub: argparse.ArgumentParser) -> None:
    add_json(sub)
    sub.add_argument("name", metavar="EXPERIMENT", help=f"or a plant, or a model: {NAMED}")
    sub.add_argument("--to", choices=TARGETS, required=True, help="what to write")
    sub.add_argument("--kind", choices=EXPORTED, help="which, if the name stands for several (default: the first)")
    sub.add_argument("--set", metavar="NAME=VALUE", action="append", default=[], help="change a parameter")
    sub.add_argument("--plant", metavar="PLANT", help="the controller of another plant: a name or a YAML file")
    sub.add_argument("--real", choices=REALS, default="double", help="numbers of C (default: double)")
    text = "steps per second of a plant or a model, or per unit of a model's own time (default: 1000)"
    sub.add_argument("--rate", metavar="HZ", type=float, help=text)
    text = "seconds without a step after which a controller's commands are zero (default: 0.02)"
    sub.add_argument("--watchdog", metavar="SECONDS", type=float, default=0.02, help=text)
    add_out(sub, "exported/NAME")


def _export(chosen: argparse.Namespace) -> int:
    """Write a controller, a rig or a model as C, as an FMU, or as Python that needs numpy only."""
    from masking.app.workflows.export import export

    written = export(
        chosen.name,
        to=chosen.to,
        kind=chosen.kind,
        changes=dict(change(text) for text in chosen.set),
        plant=chosen.plant,
        real=chosen.real,
        rate=chosen.rate,
        watchdog=chosen.watchdog,
        out=chosen.out,
        overwrite=chosen.overwrite,
    )
    return answer(chosen.json, written.as_dict(), written)


VERBS = (Verb("export", _add, _export),)
