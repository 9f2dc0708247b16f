"""Units of columns: in the name of a column, in a row below the names, or behind the name in a map.

A unit is kept as text, in the spelling of declarations: `m/s**2` for m/s², `rpm` for U/min, `um` for µm. Who knows the
plant converts with `masking.control.rig.channel_units`; the clock alone is converted here, since it must be in s.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "minute": 60.0, "h": 3600.0}
_BRACKETED = re.compile(r"(.*?\S)??\s*(?:\[\s*([^\[\]]*?)\s*\]|\(\s*([^()]*?)\s*\))\s*")
_SAME = {
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "millis", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "micros", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("nsec", "nanos", "nanosecond", "nanoseconds"), "ns"),
    **dict.fromkeys(("min", "minute", "minutes"), "minute"),
    **dict.fromkeys(("hour", "hours", "hr"), "h"),
    **dict.fromkeys(("volt", "volts"), "V"),
    **dict.fromkeys(("amp", "amps", "ampere", "amperes"), "A"),
    **dict.fromkeys(("newton", "newtons"), "N"),
    **dict.fromkeys(("meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("degree", "degrees", "°"), "deg"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("rpm", "u/min", "r/min", "rev/min"), "rpm"),
    **dict.fromkeys(("°c", "celsius", "degc"), "degC"),
    **dict.fromkeys(("-", "1", "none", "n/a", "dimensionless"), "1"),
    **{"%": "percent", "ohms": "ohm", "hertz": "Hz", "g": "g", "nm": "N*m"},
}
_CASED = {"Nm": "N*m", "kNm": "kN*m", "mNm": "mN*m", "Nmm": "N*mm", "nm": "nm", "G": "gauss"}  # capitals decide
_RAISED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_SYMBOL = (
    r"(?:[numkMGd]?(?:m|s|g|N|V|A|W|J|Pa|Hz|rad|K|ohm|C|F|H|T|bar)"
    r"|cm|dm|deg|rev|turn|rpm|minute|h|lbf|kgf|psi|inch|in|ft)"
)
_KNOWN = re.compile(rf"(?:1|{_SYMBOL}(?:\*\*\(?-?\d\)?)?)(?:[*/]\(?{_SYMBOL}(?:\*\*\(?-?\d\)?)?\)?)*", re.ASCII)
_WORD = re.compile(r"(?:.*[_ .])?([^_ .]+)")


@dataclass(frozen=True)
class Asked:
    """A column of a file, the name that it gets, and its unit: "" where none is known."""

    name: str
    column: str
    unit: str


def spelled(text: str) -> str:
    """Unit in the spelling of declarations; as it is where nothing is known about it."""
    plain = text.strip().replace("µ", "u").replace("μ", "u").replace("Ω", "ohm").replace("Ω", "ohm")
    if plain in _CASED:
        return _CASED[plain]
    if plain.lower() in _SAME:
        return _SAME[plain.lower()]
    plain = re.sub(r"[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda found: f"**{found[0].translate(_RAISED)}", plain)
    plain = plain.replace("^", "**").replace("·", "*").replace("⋅", "*").replace("°", "deg")
    plain = re.sub(r"\bmin\b", "minute", plain)  # min is a function
    plain = re.sub(r"(?<=\w)\s*(?:\.|\s)\s*(?=[A-Za-z])", "*", plain)
    return re.sub(r"(?<=[a-z])(?=[23](?![0-9]))|\*\*\*\*", "**", plain)


def is_unit(text: str) -> bool:
    """Whether a text is probably a unit, such as `mm/s` or (V)."""
    inner = text.strip()
    if len(inner) > 2 and inner[0] + inner[-1] in {"()", "[]"}:
        inner = inner[1:-1].strip()
    return inner.lower() in _SAME or inner in _CASED or _KNOWN.fullmatch(spelled(inner)) is not None


def split(name: str) -> tuple[str, str]:
    """Name of a column without its unit, and the unit, "" where it says none.

    Round brackets hold a unit only if it is a known one: `x (left)` is a name. Square ones that hold a number are an
    index.
    """
    found = _BRACKETED.fullmatch(name)
    if found is None or not found[1]:
        return name, ""
    square, round_ = found[2], found[3]
    if square is not None:
        return (name, "") if not square or square.isdigit() else (found[1], spelled(square))
    return (found[1], spelled(round_)) if round_ and not round_.isdigit() and is_unit(round_) else (name, "")


def bare(text: str) -> str:
    """Text of a cell in a row of units, without brackets, as a unit."""
    inner = text.strip()
    return spelled(inner[1:-1] if inner[:1] + inner[-1:] in {"()", "[]"} else inner)


def hinted(name: str) -> str:
    """Unit that the last word of a name may be, such as that of `x_mm`; "" where it is none."""
    found = _WORD.fullmatch(name)
    word = found[1] if found else name
    is_part = found is not None and word != name
    return spelled(word) if is_unit(word) and (is_part or len(word) > 1) else ""


def named(columns: Collection[str], given: Mapping[str, str], units: Mapping[str, str]) -> list[Asked]:
    """Columns of a file by the names that they get: those of a map first, then all others by their own, without units.

    `given` has a column, or `column:unit`, by each name; `units` those that the file says beside the names.
    """
    parts = {name: split(name) for name in columns}
    count = Counter(short for short, _ in parts.values())
    short = {s: name for name, (s, _) in parts.items() if count[s] == 1 and s not in columns}

    def own(column: str) -> tuple[str, str]:
        full = column if column in columns else short.get(column, column)
        full = full if full in columns else short.get(full.lstrip("%# "), full.lstrip("%# "))
        return (full, units.get(full, parts[full][1])) if full in columns else (column, "")

    made = list[Asked]()
    for name, path in given.items():
        column, colon, unit = path.rpartition(":")
        full, known = own(path)
        if full in columns or not colon:
            made.append(Asked(name, full, known))
        else:
            made.append(Asked(name, own(column)[0], spelled(unit)))
    taken = {*(one.column for one in made), *given}
    for name in columns:
        as_named = parts[name][0] if short.get(parts[name][0]) == name else name
        if name not in taken and as_named not in given:
            made.append(Asked(as_named, name, own(name)[1]))
    return made
