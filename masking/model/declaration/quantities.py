"""Quantities as text: numbers, percentages, and values with their deviations and units."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

from masking.lazy_imports import uncertainties
from masking.model.declaration.units import RAISED, combined, dimension_of, factor_of, pretty

ROUNDING = 1e-12  # of a value in double precision: a deviation below it is none
_PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M"}
_PREFIXED = frozenset({"V", "m", "N", "W", "W/kg", "J", "J/kg"})
_SMALL = frozenset({"m/s", "m/s**2"})  # that take them where they are small
_PLAIN = 7  # digits before the point up to which a number is written without a power of ten


def number(value: Any, digits: int = 3) -> str:  # noqa: ANN401  # a number, or one that JSON keeps as text ("inf")
    """Write a number with a few digits, very small and large ones with a power of ten: 2500, 3e-7."""
    try:
        text = f"{float(value):.{digits}g}"
    except (TypeError, ValueError):
        return str(value)
    mantissa, e, exponent = text.partition("e")
    if e and 0 <= int(exponent) < _PLAIN:  # 2500 rather than 2.5e3
        return f"{float(text):.0f}"
    return f"{mantissa}e{int(exponent)}" if e else text


def percent(part: float, digits: int = 2) -> str:
    """Write a part in percent with a few digits; none of those before the point is rounded off."""
    value = 100.0 * part
    if abs(value) >= 10.0**_PLAIN:
        return f"{number(value, digits)} %"
    return f"{value:.0f} %" if abs(value) >= 10.0**digits - 0.5 else f"{float(f'{value:.{digits}g}'):g} %"


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """Write a value with a unit, which gets a prefix if it is one that takes them: 32 kN."""
    scale = 3 * math.floor(math.log10(abs(float(f"{value:.{digits}g}"))) / 3.0) if value else 0
    if scale in _PREFIXES and (unit in _PREFIXED or (unit in _SMALL and abs(value) < 1e-3)):
        return f"{number(value / 10.0**scale, digits)} {_PREFIXES[scale]}{pretty(unit)}"
    return f"{number(value, digits)} {pretty(unit)}".rstrip()


def power(value: float, units: Sequence[str]) -> str:
    """Write a power in W, or in W/kg of a force per mass; '' where force times rate is neither.

    The value is in the units of the force and the rate; `units` are those of the force, the displacement and its rate.
    """
    return _as_one_of(("W", "W/kg"), value, combined("F*V", {"F": units[0] or "1", "V": units[2] or "1"}))


def work(value: float, units: Sequence[str]) -> str:
    """Write an energy in J, or in J/kg of a force per mass; '' where force times rate and seconds is neither.

    The value is in the units of the force and the rate, times s; `units` are as those of `power`.
    """
    return _as_one_of(("J", "J/kg"), value, combined("F*V*s", {"F": units[0] or "1", "V": units[2] or "1", "s": "s"}))


def _as_one_of(shown: Sequence[str], value: float, unit: str) -> str:
    """Write a value in the first of some units that has its dimension; '' where none has."""
    found = next((one for one in shown if dimension_of(unit) == dimension_of(one)), "")
    return quantity(value * factor_of(unit), found) if found else ""


def with_deviation(value: float, std: float, unit: str) -> str:
    """Write a value and its standard deviation, which has two digits, with a unit: 5.47 ± 0.12 mm/s².

    The deviation is not finite, 0 or below rounding if it is not known.
    """
    if not (std > ROUNDING * abs(value) and math.isfinite(std)):
        return f"{number(value, 5)} {unit}".rstrip()
    size = max(abs(value), std)
    scale = 0 if 1e-3 <= size < 1e5 else 3 * math.floor(math.log10(size) / 3.0)
    made = uncertainties.ufloat(value / 10.0**scale, std / 10.0**scale)
    text = f"{made:.2ufP}".replace("±", " ± ")
    if not scale:
        return f"{text} {unit}".rstrip()
    if scale in _PREFIXES and scale < 0 and re.match(r"[mVN](/|$)", unit):
        return f"{text} {_PREFIXES[scale]}{unit}"
    return f"({text})·10{str(scale).translate(RAISED)} {unit}".rstrip()
