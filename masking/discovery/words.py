"""Words: what was discovered, in plain sentences."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np

from masking.declaration.units import describe, dimension_of
from masking.discovery import forces
from masking.discovery.discover import Discovery, Named
from masking.discovery.where import Lacking, Place, where
from masking.identification.whiteness import Whiteness

NOTABLE = 0.15  # part of a force's energy from which a dependence is told
ALIKE = 0.9  # part of it that turns round with the motion, or does not, from which it is called so
CONSTANT = 0.9  # part of its mean square that is its mean's, from which it hardly changes
MOST = 0.5  # part of what is lacking from which a place or a side of the rig is told
MUCH = 1.5  # times the part of the time: a part of the energy from which a region is told
TAKEN = 0.2  # of the power that a force could take out of the motion, from which that is told
SHOWN = 0.01  # probability from which an alternative is told
SURE = 2.0  # deviations of a parameter from which it is told in a sentence
NO_EXPERIMENT = "no experiment is proposed, since it is not known which measured input is the rate of which"
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
        pause = "," if ", " in what else ""
        return f"{capital(what)}{pause} {'is' if len(found.effects) == 1 else 'are'} missing. {gap(found)}"
    if found.verdict == "ambiguous":
        last = found.effects[-1]
        names = [
            spoken(found, last.name, last.on),
            *(spoken(found, n, on) for n, on, p in last.alternatives if p > SHOWN),
        ]
        before = [cause(found, one) for one in found.effects[:-1]]
        first = (
            f"{capital(listed(before, '; '))} is missing, and {alternatives(names)}" if before else alternatives(names)
        )
        coming = f". {capital(str(found.next_experiment or NO_EXPERIMENT))}"
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


def spoken(found: Discovery, name: str, on: str) -> str:
    """Name a cause with its place: 'dry friction in spring1', 'an added mass on x1'."""
    words, effect = name.replace("_", " "), found.twin.dictionary.get(name)
    if effect is None:
        return f"another {name}"
    if effect.is_inertia:
        return f"an {words} on {on}"
    if effect.where == "loop":
        return f"a {words} of {on or 'all actuators'}"
    return f"{words} {'in' if effect.where == 'element' else 'of'} {on}"


def cause(found: Discovery, named: Named) -> str:
    """Name a cause with its parameters: 'dry friction in spring1, fc = 0.00547 ± 0.00001 m/s²'.

    That of an inertia is said as one says it: 'an added mass of 0.0312 ± 0.0005 kg on x1'.
    """
    values = []
    sure = [n for n, (value, std) in named.parameters.items() if abs(value) > SURE * std]
    for name in sure or named.parameters:
        value, std = named.parameters[name]
        told = f"{name} = {with_deviation(value, std, units(found, named).get(name, ''))}"
        if named.name not in found.twin.dictionary:
            declared = float(found.rig.start[found.rig.names.index(name)])
            told += (
                f", {abs(value / declared - 1.0) * 100.0:.2g} % {'more' if value > declared else 'less'} than declared"
            )
        values.append(told)
    what = spoken(found, named.name, named.on) if named.name in found.twin.dictionary else ""
    if what and found.twin.dictionary[named.name].is_inertia:
        return what.replace(" on ", f" of {values[0].removeprefix('m = ')} on ", 1)
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


def beside(found: Discovery) -> str:
    """Say what is left beside the causes that are known, where more than noise is; '' where not, or it is said."""
    if found.closed or not found.effects or found.verdict == "unknown":
        return ""
    return f"{'This does' if len(found.effects) == 1 else 'These do'} not explain all. {look(found)}"


def look(found: Discovery) -> str:
    """Say what is lacking, or is left beside the causes, looks like."""
    lacking = rest(found)
    place = lacking.best
    portrait, (unit, *_) = place.portrait, place.units
    of_command = max(lacking.actuators, key=lambda name: lacking.actuators[name], default="")
    if of_command and lacking.actuators[of_command] > max(MOST, place.explained):
        return f"It looks like a force: {follows_command(lacking, of_command)}"
    size = f"{number(portrait.size, 2)} {pretty(unit)}".rstrip()
    return f"It looks like a force of {size} (rms) at {place.name}: {portrayed(place)}"


def rest(found: Discovery) -> Lacking:
    """Return what is lacking, or what is left where causes are known that do not explain it."""
    seen = where(found)
    return seen.lacking if seen.left is None or not found.effects else seen.left


def subject(found: Discovery) -> Lacking:
    """Return what is lacking, or what is left where the causes that are known do not explain it."""
    return rest(found) if found.verdict == "unknown" else where(found).lacking


def whereabouts(found: Discovery) -> list[str]:
    """Say where it is lacking, and whether what is left is white; nothing where neither says anything."""
    seen, lacking = where(found), where(found).lacking
    told = []
    if found.verdict in {"named", "ambiguous"} and found.effects[-1].name in found.twin.dictionary:
        on, side = found.effects[-1].on, found.twin.dictionary[found.effects[-1].name].where
        if side == "element" and lacking.best.explained > MOST:
            place = lacking.best
            told.append(f"{capital(much(place.share))} of what is lacking sits at {place.name}: {portrayed(place)}")
        elif side == "actuator" and lacking.actuators.get(on, 0.0) > MOST:
            told.append(capital(follows_command(lacking, on)))
        elif side == "sensor" and lacking.sensors.get(on, 0.0) > MOST:
            told.append(f"{capital(much(lacking.sensors[on]))} of what is lacking of {on} follows its reading")
    if found.verdict == "unknown":
        return told
    coloured = {
        name: last for name, (first, after) in seen.whiteness.items() for last in (after or first,) if not last.white
    }
    if coloured:
        told.append(
            f"On data that were not used, what is left of {listed([f'{n} is {white(w)}' for n, w in coloured.items()])}"
        )
    return told


def follows_command(lacking: Lacking, name: str) -> str:
    """Say how much of what is lacking follows a command."""
    return f"{much(lacking.actuators[name])} of what is lacking follows the command of {name}"


def portrayed(place: Place) -> str:
    """Say what a force at a place follows, how alike it is in both directions, where it sits and what it takes."""
    parts = place.portrait.parts
    if parts is None:
        return "it is hardly beyond its deviation"
    if place.portrait.mean**2 > CONSTANT * place.portrait.size**2:
        return "it hardly changes"
    follows = [
        (much(part), what)
        for part, what in (
            (parts.displacement, "the displacement"),
            (parts.rate, "the rate"),
            (parts.both, "displacement and rate together"),
        )
        if part > NOTABLE
    ]
    told = []
    if follows:
        (first, what), *others = follows
        said = listed([f"{first} of its energy follows {what}", *(f"{part} {what}" for part, what in others)])
        told.append(said if parts.odd is None else f"{said}, {symmetry(parts.odd)}")
    if parts.neither > NOTABLE:
        told.append(
            f"{much(parts.neither)} follows neither displacement nor rate: time, memory or another place matters"
        )
    told.extend(regions(place))
    if abs(place.portrait.taken) > TAKEN:
        way = ("takes", "out of") if place.portrait.loss > 0.0 else ("puts", "into")
        told.append(f"it {way[0]} {power(abs(place.portrait.loss), place.units)} {way[1]} the motion")
    return "; ".join(told)


def symmetry(odd: float) -> str:
    """Say how alike a force is in both directions, by the part of it that turns round with the motion."""
    if odd > ALIKE:
        return "alike in both directions"
    return "the same way on both sides" if odd < 1.0 - ALIKE else "different in the two directions"


def regions(place: Place) -> list[str]:
    """Say in which part of travel, speed and record a force has much more of its energy than there is time."""
    told, of = [], place.portrait.regions
    ends = [of["displacement"][name] for name in ("low", "high")]
    (energy, time), parts = np.sum(ends, axis=0), place.portrait.parts
    if energy > MUCH * time and energy > MOST and min(part / max(spent, 1e-9) for part, spent in ends) > 1.0:
        told.append("most of it is at the ends of the travel")
    else:
        told.extend(
            f"{much(part)} of it is where the displacement is {name if name != 'middle' else 'in the middle'}"
            for name, (part, spent) in of["displacement"].items()
            if part > max(MUCH * spent, MOST)
        )
    if parts is not None and parts.rate < MOST:  # what follows the rate is larger where that is
        told.extend(
            f"{much(part)} of it is where the motion is {name}"
            for name, (part, spent) in of["speed"].items()
            if part > MUCH * spent
        )
    told.extend(
        f"{much(part)} of it is in the {name} third of the record"
        for name, (part, spent) in of["record"].items()
        if part > MUCH * spent
    )
    return told


def white(one: Whiteness) -> str:
    """Say whether residuals are white, and if not, at which frequency they are not."""
    if one.white:
        return "white"
    at = "an offset" if not one.frequency else f"{number(one.frequency, 2)} Hz"
    return f"not white ({'slow, ' if one.slow and one.frequency else ''}{at})"


def power(value: float, units: Sequence[str]) -> str:
    """Write a power with its unit: that of a force times that of a rate."""
    unit = _put_together("F*V", {"F": units[0] or "1", "V": units[2] or "1"})
    unit = {"m**2/s**3": "W/kg", "N*m/s": "W"}.get(unit, unit)
    scale = math.floor(math.log10(value) / 3.0) * 3 if value > 0.0 else 0
    if unit in {"W", "W/kg"} and scale in _PREFIXES:
        return f"{number(value / 10.0**scale)} {_PREFIXES[scale]}{unit}"
    return f"{number(value)} {pretty(unit)}".rstrip()


def remedies(found: Discovery) -> list[tuple[str, str, str, str]]:
    """Return what each named effect is, what causes it and what helps: (name, meaning, cause, remedy)."""
    dictionary = found.twin.dictionary
    seen = dict.fromkeys(n for e in found.effects for n in (e.name, *(a[0] for a in e.alternatives if a[2] > 0.05)))
    known = [(name, dictionary[name]) for name in seen if name in dictionary]
    return [(name.replace("_", " "), e.meaning, e.cause, e.remedy) for name, e in known]


def units(found: Discovery, named: Named) -> dict[str, str]:
    """Return the units of the parameters of a cause."""
    if named.name not in found.twin.dictionary:
        return {n: pretty(found.twin.base.parameters[n].unit) for n in named.parameters}
    effect, twin = found.twin.dictionary[named.name], found.twin
    if effect.where == "element":
        force, displacement, _ = forces.element_units(found, named.on)
        known = {"F": force or "1", "D": displacement or "1", "s": "s" if displacement else "1"}
    elif effect.where == "sensor":
        known = {"S": twin.declaration.sensors[named.on].unit}
    else:
        known = {"U": forces.command_unit(found, named.on)}
    made = {n: _put_together(effect.parameters[n].unit, known) for n in named.parameters}
    if effect.is_inertia:  # kg, rather than N s²/m
        made = {n: describe(dimension_of(unit)) for n, unit in made.items()}
    return {n: pretty(unit) for n, unit in made.items()}


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


def much(part: float) -> str:
    """Write how much of something: all, nothing, or a part in percent."""
    return "all" if part >= 0.995 else percent(part) if part >= 0.005 else "nothing"


def capital(text: str) -> str:
    """Return a text that begins a sentence."""
    return f"{text[:1].upper()}{text[1:]}"


def alternatives(words: Sequence[str]) -> str:
    """Write several words of which one holds."""
    return words[0] if len(words) == 1 else f"either {', '.join(words[:-1])} or {words[-1]}"


def listed(words: Sequence[str], between: str = ", ") -> str:
    """Write several words as a list."""
    return words[0] if len(words) == 1 else f"{between.join(words[:-1])} and {words[-1]}"
