"""Words: what was discovered, in plain sentences."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np

from masking.discovery import forces
from masking.discovery.discover import Discovery, Named
from masking.effects import EFFECTS

NOTABLE = 0.15  # part of a force's variance from which a dependence is told
SHOWN = 0.01  # probability from which an alternative is told
SURE = 2.0  # deviations of a parameter from which it is told in a sentence
CLOSED = 1.1  # of the noise: errors from here on are told as more than noise
_PREFIXES = {-9: "n", -6: "µ", -3: "m"}
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def sentence(found: Discovery) -> str:
    """Say what was found, in a sentence or two without a full stop at the end."""
    if found.verdict == "none":
        return f"Nothing is missing: with its parameters adjusted within what is believed of them, {left(found)}"
    if found.verdict == "parameter":
        return f"No effect is missing, but a parameter is off: {cause(found, found.effects[-1])}. {gap(found)}"
    if found.verdict == "named":
        what = listed([cause(found, one) for one in found.effects], "; ")
        return f"{capital(what)}, {'is' if len(found.effects) == 1 else 'are'} missing. {gap(found)}"
    if found.verdict == "ambiguous":
        last = found.effects[-1]
        names = [spoken(last.name, last.on), *(spoken(n, on) for n, on, p in last.alternatives if p > SHOWN)]
        before = [cause(found, one) for one in found.effects[:-1]]
        first = (
            f"{capital(listed(before, '; '))} is missing, and {alternatives(names)}" if before else alternatives(names)
        )
        coming = f". {capital(str(found.next_experiment))}" if found.next_experiment else ""
        return f"{capital(first)} is missing, and this record cannot tell which. {gap(found)}{coming}"
    known = [cause(found, one) for one in found.effects]
    near = f" The nearest of it is {listed(known)}, which does not explain the rest." if known else ""
    return f"Something is missing that is not in the dictionary.{near} {look(found)}"


def left(found: Discovery) -> str:
    """Say what the model leaves, where nothing is missing."""
    name = worst(found)
    after, floor = found.gap.validation[1][name], found.gap.validation_floor[name]
    return (
        f"the model leaves of {listed(found.twin.sensors)} what noise makes (of {name}, on data that were not used, "
        f"{percent(after)}; noise {percent(floor)})"
    )


def spoken(name: str, on: str) -> str:
    """Name a cause with its place: 'dry friction in spring1'."""
    words = name.replace("_", " ")
    if name in EFFECTS and EFFECTS[name].where == "loop":
        return f"a {words} of {on or 'all actuators'}"
    if name not in EFFECTS:
        return f"another {name}"
    return f"{words} {'in' if EFFECTS[name].where == 'element' else 'of'} {on}"


def cause(found: Discovery, named: Named) -> str:
    """Name a cause with its parameters: 'dry friction in spring1, fc = 0.00547 ± 0.00001 m/s²'."""
    values = []
    sure = [n for n, (value, std) in named.parameters.items() if abs(value) > SURE * std]
    for name in sure or named.parameters:
        value, std = named.parameters[name]
        told = f"{name} = {with_deviation(value, std, units(found, named).get(name, ''))}"
        if named.name not in EFFECTS:
            declared = float(found.rig.start[found.rig.names.index(name)])
            told += (
                f", {abs(value / declared - 1.0) * 100.0:.2g} % {'more' if value > declared else 'less'} than declared"
            )
        values.append(told)
    what = spoken(named.name, named.on) if named.name in EFFECTS else ""
    return ", ".join(filter(None, [what, *values]))


def gap(found: Discovery) -> str:
    """Say how far the gap closes on the record that judges, for the sensor in which it was largest."""
    before, after, floor = found.adjusted_gap, found.gap.validation[1], found.gap.validation_floor
    name = worst(found)
    return (
        f"On data that were not used, the error in {name} is {percent(before[name])} with parameters adjusted alone "
        f"and {percent(after[name])} with this; noise alone makes {percent(floor[name])}"
    )


def worst(found: Discovery) -> str:
    """Return the sensor in which adjusted parameters alone leave most, beside its noise."""
    floor, before = found.gap.validation_floor, found.adjusted_gap
    return max(floor, key=lambda name: before[name] / max(floor[name], 1e-300))


def look(found: Discovery) -> str:
    """Say what the lacking force looks like."""
    lacking = forces.lack(found)
    rest = lacking.before if lacking.after is None or not found.effects else lacking.after
    kind = forces.shape(lacking.x, lacking.rate, rest)
    of = {
        "element": ("displacement", "its rate"),
        "actuator": ("command", "its rate"),
        "sensor": ("reading", "its rate"),
    }
    x, rate = of[lacking.where]
    told = []
    for part, odd, what in ((kind.by_x, kind.odd_x, x), (kind.by_rate, kind.odd_rate, rate)):
        if part > NOTABLE:
            symmetry = "alike in both directions" if odd > forces.ODD else "different in the two directions"
            told.append(f"{100.0 * part:.0f} % of it follows the {what.removeprefix('its ')}, {symmetry}")
    size = f"{number(float(np.std(rest)), 2)} {pretty(lacking.units[0])}".rstrip()
    what = "reading" if lacking.where == "sensor" else "force"
    shown = "; ".join(told) or f"it follows neither the {x} nor {rate} alone: time, memory or another place matters"
    return f"It looks like a {what} of {size} (rms) at {lacking.place}: {shown}"


def remedies(found: Discovery) -> list[tuple[str, str, str, str]]:
    """Return what each named effect is, what causes it and what helps: (name, meaning, cause, remedy)."""
    seen = dict.fromkeys(n for e in found.effects for n in (e.name, *(a[0] for a in e.alternatives if a[2] > 0.05)))
    known = [(name, EFFECTS[name]) for name in seen if name in EFFECTS]
    return [(name.replace("_", " "), e.meaning, e.cause, e.remedy) for name, e in known]


def units(found: Discovery, named: Named) -> dict[str, str]:
    """Return the units of the parameters of a cause."""
    if named.name not in EFFECTS:
        return {n: pretty(found.twin.base.parameters[n].unit) for n in named.parameters}
    effect, twin = EFFECTS[named.name], found.twin
    if effect.where == "element":
        force, displacement, _ = forces.element_units(found, named.on)
        known = {"F": force or "1", "D": displacement or "1", "s": "s" if displacement else "1"}
    elif effect.where == "sensor":
        known = {"S": twin.declaration.sensors[named.on].unit}
    else:
        known = {"U": (twin.declaration.actuators or twin.base.inputs)[named.on].unit}
    return {n: pretty(_put_together(effect.parameters[n].unit, known)) for n in named.parameters}


def _put_together(template: str, known: Mapping[str, str]) -> str:
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
    if power in _PREFIXES and re.match(r"[mVN](/|$)", unit):
        return f"{told} {_PREFIXES[power]}{unit}"
    return f"({told})·10{str(power).translate(_RAISED)} {unit}".rstrip()


def number(value: float, digits: int = 3) -> str:
    """Write a number; small and large ones with a power of ten."""
    mantissa, e, exponent = f"{value:.{digits}g}".partition("e")
    return f"{mantissa}e{int(exponent)}" if e else mantissa


def percent(part: float) -> str:
    """Write a part in percent."""
    return f"{100.0 * part:.2g}\N{NO-BREAK SPACE}%" if part < 0.995 else f"{100.0 * part:.0f}\N{NO-BREAK SPACE}%"


def capital(text: str) -> str:
    """Return a text that begins a sentence."""
    return f"{text[:1].upper()}{text[1:]}"


def alternatives(words: Sequence[str]) -> str:
    """Write several words of which one holds."""
    return words[0] if len(words) == 1 else f"either {', '.join(words[:-1])} or {words[-1]}"


def listed(words: Sequence[str], between: str = ", ") -> str:
    """Write several words as a list."""
    return words[0] if len(words) == 1 else f"{between.join(words[:-1])} and {words[-1]}"
