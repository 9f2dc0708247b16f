"""Files of models: the parts that a fit and a discovery write alike."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import yaml

from masking.control.rig.twin import Twin
from masking.model.declaration import registry

DIGITS = 10


def rounded(value: float, digits: int = DIGITS) -> float:
    """Value as it is written, with a number of significant digits."""
    return float(f"{value:.{digits}g}")


def parameter(value: float, std: float, digits: int = DIGITS) -> dict[str, float]:
    """Parameter as a file has it: value, and standard deviation, if that is not 0, in a number of digits."""
    return {"value": rounded(value)} | ({"std": rounded(std, digits)} if std > 0.0 else {})


def plant(
    twin: Twin, folder: Path, head: Mapping[str, str], fitted: Collection[str], effects: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Content of a plant file in a folder with a found model; `head` is its name, its model and its source, if any.

    `fitted` are parameters that are the model's or the effects' now, and that the plant no longer sets.
    """
    declared: dict[str, Any] = twin.declaration.canonical()
    made = {n: v for n, v in declared.items() if n not in {"effects", "own_effects"}} | dict(head)
    left = {n: v for n, v in made.pop("parameters", {}).items() if n not in fitted}
    own = [
        registry.name_from(one, folder)
        for one in twin.declaration.dictionaries
        if any(use["effect"] in one.dictionary for use in effects.values())
    ]
    sections = {"parameters": left, "own_effects": own, "effects": dict(effects)}
    return made | {name: content for name, content in sections.items() if content}


class _Entry(dict[str, Any]):
    """A mapping that is written in one line."""


class _Dumper(yaml.SafeDumper):
    """Writes entries of sections in a line each."""


_Dumper.add_representer(_Entry, lambda dumper, entry: dumper.represent_mapping("tag:yaml.org,2002:map", entry, True))


def text(content: Mapping[str, Any]) -> str:
    """Content of a file as YAML, each entry of a section in a line."""
    made = {
        section: {n: _Entry(e) if isinstance(e, dict) else e for n, e in entries.items()}
        if isinstance(entries, dict)
        else entries
        for section, entries in content.items()
    }
    return str(yaml.dump(made, Dumper=_Dumper, sort_keys=False, width=118, allow_unicode=True))
