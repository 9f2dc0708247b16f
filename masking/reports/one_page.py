"""One page of a result: what was found, where, how sure it is, the error before and after, and what to do next.

A result says this in its own words, and its JSON keeps it under `sheet`: the page can be made afterwards and elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Final

from masking.errors import RecordError
from masking.lab.records import foreign_json
from masking.reports import html
from masking.reports.html import Tile

DISCOVERY, FIT, LEARNING = RESULTS = "discovery.json", "fit.json", "learning.json"  # files with a sheet
PAGE, PICTURE = "one_page.pdf", "one_page.png"
RELATIVE: Final = "error relative to the reading"
# Headings.
FOUND, WHERE, SURE, LIMITS = "What was found", "Where", "How sure", "What limits it"
NEXT, NOTES = "What to do next", "Notes"


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """What stands on one page."""

    title: str
    subject: list[str]  # lines on the rig and its records
    tiles: list[Tile]  # numbers on top
    sections: dict[str, list[str]]  # paragraphs by heading; the errors stand below the first section
    # relative, by model and channel; none where not finite
    errors: dict[str, dict[str, float]] = field(default_factory=dict)
    errors_title: str = ""  # with the record that they are of
    errors_label: str = RELATIVE
    in_percent: bool = True  # whether errors are shown so
    page: str  # file that says more


@dataclass(frozen=True)
class _Holder:
    sheet: Sheet


def finite(by_model: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Errors that JSON can hold: those of a motion that is not finite are left out."""
    return {model: {n: x for n, x in part.items() if math.isfinite(x)} for model, part in by_model.items() if part}


def read(path: Path) -> Sheet:
    """Sheet of a result; a `RecordError` where the file cannot be read or holds none."""
    try:
        content = foreign_json.load(path, _Holder)["sheet"]
    except RecordError as error:
        raise RecordError(
            f"{error}; name a file that this version of masking wrote, or make the result again"
        ) from error
    tiles = [Tile(**{name: tile[name] for name in Tile._fields if name in tile}) for tile in content["tiles"]]
    return Sheet(**{one.name: content[one.name] for one in fields(Sheet) if one.name in content} | {"tiles": tiles})


def remove(folder: Path) -> None:
    """Delete the page of an earlier result in a folder, if there is one."""
    with html.writing(folder):
        for name in (PAGE, PICTURE):
            (folder / name).unlink(missing_ok=True)
