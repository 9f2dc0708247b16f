"""Verbs that look at declarations: list, show, check, schema."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict

from masking.app.cli.options import Verb, add_json, answer
from masking.model.declaration import catalogue


def say_compiling() -> None:
    """Say why nothing happens for a while."""
    print("compiling; this takes some ten seconds, once for each system", file=sys.stderr)


def _list(chosen: argparse.Namespace) -> int:
    """List the packaged models, plants, experiments and dictionaries of effects."""
    entries = catalogue.catalogue()
    if chosen.json:
        print(json.dumps([asdict(entry) for entry in entries], indent=2))
        return 0
    width = max(len(entry.name) for entry in entries)
    for kind in catalogue.KINDS:
        print("dictionaries" if kind == "dictionary" else f"{kind}s")
        for entry in entries:
            if entry.kind == kind:
                print(f"  {entry.name:{width}}  {entry.title}")
    return 0


def _add_show(sub: argparse.ArgumentParser) -> None:
    add_json(sub)
    sub.add_argument("name", metavar="NAME", help="a name that 'masking list' shows, or a YAML file")
    sub.add_argument("--kind", choices=catalogue.KINDS, help="which, if the name stands for more than one")


def _show(chosen: argparse.Namespace) -> int:
    """Show a model, a plant, an experiment or physical effects."""
    from masking.app.workflows.show import show

    description = show(chosen.name, chosen.kind)
    return answer(chosen.json, f"{description.to_json()}\n", description)


def _add_check(sub: argparse.ArgumentParser) -> None:
    add_json(sub)
    sub.epilog = "Exit status: 0 sound, 1 sound but an experiment does not fit the limits of its rig, 2 problems."
    sub.add_argument("files", metavar="FILE", nargs="+", help="YAML files or names")


def _check(chosen: argparse.Namespace) -> int:
    """Check declarations: each problem with its place, and whether an experiment fits its rig."""
    from masking.app.workflows.check import check

    results = check(*chosen.files, compiling=say_compiling)
    if chosen.json:
        content = [
            {
                "file": r.file,
                "kind": r.kind,
                "problems": [p.as_dict() for p in r.problems],
                "feasibility": r.feasibility.as_dict() if r.feasibility else None,
                "unknown": r.unknown,
            }
            for r in results
        ]
        print(json.dumps(content, indent=2))
    else:
        for result in results:
            print("\n".join(map(str, result.problems)) or f"{result.file}: a sound {result.kind}")
            if result.feasibility is not None:
                print(result.feasibility)
            elif result.unknown:
                print(f"  whether it fits is unknown: {result.unknown}")
    return max(result.exit_status for result in results)


def _add_schema(sub: argparse.ArgumentParser) -> None:
    add_json(sub)
    sub.add_argument("kind", choices=catalogue.KINDS)


def _schema(chosen: argparse.Namespace) -> int:
    """Print the JSON Schema of a kind of declaration, for editors."""
    from masking.model.declaration.json_schema import json_schema

    print(json.dumps(json_schema(chosen.kind), indent=2))
    return 0


VERBS = (
    Verb("list", add_json, _list),
    Verb("show", _add_show, _show),
    Verb("check", _add_check, _check),
    Verb("schema", _add_schema, _schema),
)
