"""LabVIEW measurement files as text (.lvm): channels with their units, on the clock that their header gives.

Source: National Instruments, Specification for the LabVIEW Measurement File (.lvm), white paper 4139.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from masking.errors import RecordError
from masking.lab.records import column_units
from masking.lab.records.text_header import Header

MARK = "LabVIEW Measurement"  # with which a file begins
_END = "***End_of_Header***"
_SEPARATORS = {"Tab": "\t", "Comma": ",", "Semicolon": ";"}


def header(file: Path, text: str) -> Header:
    """Header of a file with one segment: `t` is its clock in s, from X_Value, or from X0 and Delta_X.

    A RecordError where it has several segments, channels on several clocks, or another dimension than the time.
    """
    lines = text.split("\n")
    ends = [i for i, line in enumerate(lines) if line.strip().startswith(_END)]
    if len(ends) < 2 or len(lines) < ends[1] + 3:
        raise RecordError(f"{file}: its header is cut off: a LabVIEW measurement file has two lines {_END}")
    if len(ends) > 2:
        raise RecordError(
            f"{file}: it holds several segments, the second from line {ends[1] + 3} on; write one segment a file, or "
            "give its lines as a .csv file with --header-rows"
        )
    separator = _SEPARATORS.get(_entries(lines[: ends[0]], "\t").get("Separator", ["Tab"])[0], "\t")
    separator = separator if separator in lines[ends[1] + 1] else "\t"
    general, channels = (_entries(part, separator) for part in (lines[: ends[0]], lines[ends[0] + 1 : ends[1]]))
    number, names = ends[1] + 2, [cell.strip() for cell in lines[ends[1] + 1].split(separator)]
    given = [general.get("X_Columns", ["One"])[0], *channels.get("X_Dimension", [])]
    if given[0] == "Multi" or any(one not in {"Time", ""} for one in given[1:]):
        what = "a clock for each channel" if given[0] == "Multi" else f"{given[1]} in place of the time"
        remedy = "give its lines as a .csv file with --header-rows, and name the clock with --map"
        raise RecordError(f"{file}: it has {what}; {remedy}")
    units = ["s", *map(column_units.bare, channels.get("Y_Unit_Label", []))]
    names = ["t", *names[1 : -1 if names[-1] == "Comment" else None]]
    rows = [line.split(separator)[: len(names)] for line in lines[number:] if line.strip()]
    clock = _clock(file, channels) if given[0] == "No" else None
    if clock is not None:
        rows = [[str(i), *row[1:]] for i, row in enumerate(rows)]
    body = "\n".join(map(separator.join, rows))
    return Header(names, separator, number + 1, body, units, clock=clock)


def _entries(lines: Sequence[str], separator: str) -> dict[str, list[str]]:
    """Values of each key of a block of a header."""
    parts = [[cell.strip() for cell in line.split(separator)] for line in lines]
    return {key: values for key, *values in parts if key and values}


def _clock(file: Path, channels: Mapping[str, list[str]]) -> tuple[float, float]:
    """Start and increment in s that all channels have; a RecordError where these differ."""
    made = list[float]()
    for key in ("X0", "Delta_X"):
        try:
            values = {float(value.replace(",", ".")) for value in channels.get(key, []) if value}
        except ValueError:
            values = set()
        if len(values) != 1:
            what = f"the channels have several values of {key}" if values else f"its header has no {key}"
            raise RecordError(f"{file}: {what}; write the X values, too, or one file for each")
        made += values
    return made[0], made[1]
