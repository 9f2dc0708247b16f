"""Quantities: numbers with their deviations and units, as people write them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

_PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M"}
_PREFIXED = frozenset({"V", "m", "N", "W", "W/kg"})
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_PLAIN = 5  # digits before the point up to which a number is written without a power of ten


def power(value: float, units: Sequence[str]) -> str:
    """Write a power with its unit: that of a force times that of a rate."""
    unit = put_together("F*V", {"F": units[0] or "1", "V": units[2] or "1"})
    return quantity(value, {"m**2/s**3": "W/kg", "N*m/s": "W"}.get(unit, unit))


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """Write a value with a unit, which gets a prefix where it may have one: 32 kN."""
    scale = 3 * math.floor(math.log10(abs(float(f"{value:.{digits}g}"))) / 3.0) if value else 0
    if unit in _PREFIXED and scale in _PREFIXES:
        return f"{number(value / 10.0**scale, digits)} {_PREFIXES[scale]}{unit}"
    return f"{number(value, digits)} {pretty(unit)}".rstrip()


def put_together(template: str, known: Mapping[str, str]) -> str:
    """Return a unit of the dictionary with the units of a place in it as they are written, not as SI has them."""
    powers: dict[str, int] = {}
    for letter, power in _powers(template).items():
        for name, inner in _powers(known.get(letter, letter)).items():
            powers[name] = powers.get(name, 0) + power * inner
    above = [n if p == 1 else f"{n}**{p}" for n, p in powers.items() if p > 0]
    below = [n if p == -1 else f"{n}**{-p}" for n, p in powers.items() if p < 0]
    return "/".join(["*".join(above) or "1", *below])


def _powers(unit: str) -> dict[str, int]:
    """Return the units in a text such as m/s**2 or 1/(V**2*s) with their powers."""
    found: dict[str, int] = {}
    sign, depth, last, last_sign = 1, [1], "", 1
    for piece in re.findall(r"\*\*\s*\(?-?\d+\)?|[A-Za-zµΩ%]+|[*/()]|\d+", unit):
        if piece.startswith("**"):
            found[last] += (int(piece.strip("*() ")) - 1) * last_sign
        elif piece == "(":
            depth.append(depth[-1] * sign)
            sign = 1
        elif piece == ")":
            depth.pop()
        elif piece in "*/":
            sign = 1 if piece == "*" else -1
        elif not piece.isdigit():
            last, last_sign = piece, sign * depth[-1]
            found[last] = found.get(last, 0) + last_sign
            sign = 1
    return {n: p for n, p in found.items() if p}


def pretty(unit: str) -> str:
    """Write a unit for people, such as 1/(m² s²) for 1/m**2/s**2."""
    raised = re.sub(r"\*\*\(?(-?\d+)\)?", lambda m: m[1].translate(_RAISED), "" if unit == "1" else unit)
    first, *below = (part.replace("*", " ") for part in raised.split("/"))
    return "/".join([first, *([f"({' '.join(below)})"] if len(below) > 1 else below)])


def with_deviation(value: float, std: float, unit: str) -> str:
    """Write a value with as many digits as its deviation tells, its deviation and its unit."""
    if not (std > 0.0 and math.isfinite(std)):
        return f"{number(value, 5)} {unit}".rstrip()
    size = max(abs(value), std)
    power = 0 if 1e-3 <= size < 1e5 else 3 * math.floor(math.log10(size) / 3.0)
    scaled, off = value / 10.0**power, std / 10.0**power
    digits = max(0, 1 - math.floor(math.log10(off)))
    told = f"{scaled:.{digits}f} ± {off:.{digits}f}"
    if not power:
        return f"{told} {unit}".rstrip()
    if power in _PREFIXES and power < 0 and re.match(r"[mVN](/|$)", unit):
        return f"{told} {_PREFIXES[power]}{unit}"
    return f"({told})·10{str(power).translate(_RAISED)} {unit}".rstrip()


def number(value: float, digits: int = 3) -> str:
    """Write a number; small and very large ones with a power of ten."""
    mantissa, e, exponent = f"{value:.{digits}g}".partition("e")
    if e and 0 <= int(exponent) < _PLAIN:  # 120 rather than 1.2e2
        return f"{float(f'{value:.{digits}g}'):.0f}"
    return f"{mantissa}e{int(exponent)}" if e else mantissa


def percent(part: float) -> str:
    """Write a part in percent."""
    return f"{100.0 * part:.2g}\N{NO-BREAK SPACE}%" if part < 0.995 else f"{100.0 * part:.0f}\N{NO-BREAK SPACE}%"


def much(part: float) -> str:
    """Write how much of something: all, nothing, or a part in percent."""
    return "all" if part >= 0.995 else percent(part) if part >= 0.005 else "nothing"
