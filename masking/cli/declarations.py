"""Verbs that look at declarations: list, show, check, schema."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict

from masking.cli.options import Add
from masking.workflows import verbs


def add(verb: Add) -> None:
    """Add the verbs."""
    verb(_list, "list", "list the models, plants, experiments and dictionaries of effects that are there")
    show = verb(_show, "show", "show a model, a plant, an experiment or physical effects")
    show.add_argument("name", metavar="NAME", help="a name that 'masking list' shows, or a YAML file")
    show.add_argument("--kind", choices=verbs.KINDS, help="which, where the name stands for more than one")
    check = verb(
        _check, "check", "check declarations, say where each problem is, and whether an experiment fits its rig"
    )
    check.epilog = "Exit status: 0 sound, 1 sound but an experiment does not fit the limits of its rig, 2 problems."
    check.add_argument("files", metavar="FILE", nargs="+", help="YAML files or names")
    schema = verb(_schema, "schema", "print the JSON Schema of a kind of declaration, for editors")
    schema.add_argument("kind", choices=verbs.KINDS)


def say_compiling() -> None:
    """Tell why nothing happens for a while."""
    print("compiling; this takes some ten seconds, once for each system", file=sys.stderr)


def _list(chosen: argparse.Namespace) -> int:
    entries = verbs.list()
    if chosen.json:
        print(json.dumps([asdict(entry) for entry in entries], indent=2))
        return 0
    width = max(len(entry.name) for entry in entries)
    for kind in verbs.KINDS:
        print("dictionaries" if kind == "dictionary" else f"{kind}s")
        for entry in entries:
            if entry.kind == kind:
                print(f"  {entry.name:{width}}  {entry.title}")
    return 0


def _show(chosen: argparse.Namespace) -> int:
    description = verbs.show(chosen.name, chosen.kind)
    print(description.to_json() if chosen.json else description)
    return 0


def _check(chosen: argparse.Namespace) -> int:
    results = verbs.check(*chosen.files, compiling=say_compiling)
    if chosen.json:
        results_as_json = [
            {
                "file": r.file,
                "kind": r.kind,
                "problems": [p.as_dict() for p in r.problems],
                "feasibility": r.feasibility.as_dict() if r.feasibility else None,
                "unknown": r.unknown,
            }
            for r in results
        ]
        print(json.dumps(results_as_json, indent=2))
    else:
        for result in results:
            print("\n".join(map(str, result.problems)) or f"{result.file}: a sound {result.kind}")
            if result.feasibility is not None:
                print(result.feasibility)
            elif result.unknown:
                print(f"  whether it fits is unknown: {result.unknown}")
    return max(result.exit_status for result in results)


def _schema(chosen: argparse.Namespace) -> int:
    print(json.dumps(verbs.schema(chosen.kind), indent=2))
    return 0
