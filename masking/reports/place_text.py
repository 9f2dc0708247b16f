"""Text of a force at a place: its dependences, symmetry, regions and power."""

from __future__ import annotations

import itertools

import numpy as np

from masking.inference.discovery.discovery_result import Discovery
from masking.inference.discovery.latent_force import LatentForces, LocatedForce
from masking.inference.estimation.whiteness import Whiteness
from masking.model.declaration.quantities import number, percent, power, quantity, work
from masking.model.effects import CROSS_DAMPING
from masking.reports.text import listed, much

DEVIATIONS, APART = 3.0, 0.01  # of two numbers, in parts of their own: as far as those may be apart that are the same
NOTABLE = 0.15  # part of a force's energy from which a dependence is stated
ALIKE = 0.9  # part of it that turns round with the motion, or does not, from which it is called so
CONSTANT = 0.9  # part of its mean square that is its mean's, from which it hardly changes
MOST = 0.5  # part of the energy of a force, from which a region is stated
MUCH = 1.5  # times the part of the time: a part of the energy from which a region is stated
LITTLE = 0.05  # of the power that a force could take out of the motion: less is not shown
TAKEN = 0.2  # of the power that a force could take out of the motion, from which that is stated


def follows_command(latent: LatentForces, name: str) -> str:
    """Part of the model error that follows a command."""
    return f"{much(latent.actuators[name])} of the model error follows the command of {name}"


def dependences(latent: LatentForces) -> str:
    """Parts of the model error that follow commands and readings, and harmonics of the force where it is largest."""
    said = []
    sides = (("command", latent.actuators, "the model error"), ("reading", latent.sensors, "its residual"))
    for what, shares, whole in sides:
        each = listed([f"{percent(part)} ({name})" for name, part in shares.items()])
        said += [f"A function of a {what} would explain {each} of {whole}."] if shares else []
    harmonics = latent.best.harmonics
    if harmonics is not None and harmonics.only_odd:
        said.append(
            f"The commands repeat themselves with odd multiples of {harmonics.base:.4g} Hz only; of the force at "
            f"{latent.best.name}, {percent(harmonics.even)} is at even multiples and "
            f"{percent(harmonics.odd)} at odd ones that were not excited."
        )
    return " ".join(said)


def portrayed(place: LocatedForce) -> str:
    """Dependences of a force at a place, its symmetry, its regions and the power that it takes."""
    force, parts = place.decomposition, place.decomposition.energy
    if parts is None:
        return "it is no larger than its uncertainty"
    if force.mean**2 > CONSTANT * force.rms**2:
        return "it hardly changes"
    of = {"the displacement": parts.displacement, "the rate": parts.rate, "displacement and rate together": parts.both}
    most_first = sorted(of.items(), key=lambda pair: -pair[1])
    follows = [(much(part), what) for what, part in most_first if part > NOTABLE]
    sentences = []
    if follows:
        (first, what), *others = follows
        said = listed([f"{first} of its energy follows {what}", *(f"{part} {what}" for part, what in others)])
        sentences.append(said if parts.odd is None else f"{said}, {symmetry(parts.odd, what)}")
    if parts.neither > NOTABLE:
        rest = much(parts.neither)
        sentences.append(f"{rest} follows neither displacement nor rate: time, memory or another place matters")
    sentences.extend(regions(place))
    if abs(force.loss_part) > TAKEN:
        way = ("takes", "out of") if force.loss > 0.0 else ("puts", "into")
        sentences.append(f"it {way[0]} {loss(place) or 'energy'} {way[1]} the motion")
    return "; ".join(sentences)


def loss(place: LocatedForce) -> str:
    """Power that a force takes out of the motion or puts into it, and its energy in a cycle; '' without units.

    A cycle is one of the motion's frequency, where it has one.
    """
    size, cycle = abs(place.decomposition.loss), place.frequency
    watts = power(size, place.units)
    if not watts or not cycle:
        return watts
    return f"{watts} ({work(size / cycle, place.units)} per cycle of {quantity(cycle, 'Hz', 2)})"


def taken(place: LocatedForce) -> str:
    """Power that a force takes out of the motion, negative where it puts it in."""
    force = place.decomposition
    if abs(force.loss_part) <= LITTLE:
        return "little"
    size = loss(place) or f"{percent(abs(force.loss_part))} of the most"
    return f"{'-' if force.loss < 0.0 else ''}{size}"


def symmetry(odd: float, of: str) -> str:
    """Symmetry of a force, by the part of its energy that turns round with the motion that it follows most."""
    sides = "sides" if of == "the displacement" else "directions"
    if ALIKE >= odd >= 1.0 - ALIKE:
        return f"different {'on' if sides == 'sides' else 'in'} the two {sides}"
    at = f"{'on' if sides == 'sides' else 'in'} both {sides}"
    return f"equal and opposite {at}" if odd > ALIKE else f"the same {at}"


def regions(place: LocatedForce) -> list[str]:
    """Parts of travel, speed and record in which a force has much more of its energy than there is time."""
    sentences, of = [], place.decomposition.regions

    def larger(kind: str) -> dict[str, float]:
        return {name: part for name, (part, spent) in of[kind].items() if part > MUCH * spent}

    ends = [of["displacement"][name] for name in ("low", "high")]
    (energy, time), parts = np.sum(ends, axis=0), place.decomposition.energy
    if energy > MUCH * time and energy > MOST and min(part / max(spent, 1e-9) for part, spent in ends) > 1.0:
        sentences.append("most of it is at the ends of the travel")
    else:
        most = {n: part for n, part in larger("displacement").items() if part > MOST}
        where = {name: "in the middle" if name == "middle" else name for name in most}
        sentences += [f"{much(part)} of it is where the displacement is {where[n]}" for n, part in most.items()]
    if parts is not None and parts.rate < MOST:  # what follows the rate is larger where that is
        sentences += [f"{much(part)} of it is where the motion is {name}" for name, part in larger("speed").items()]
    thirds = larger("record").items()
    return sentences + [f"{much(part)} of it is in the {name} third of the record" for name, part in thirds]


def white(one: Whiteness) -> str:
    """Whiteness of residuals, or the frequency at which they are not white."""
    if one.white:
        return "white"
    at = "an offset" if not one.frequency else f"{number(one.frequency, 2)} Hz"
    return f"not white ({'slow, ' if one.slow and one.frequency else ''}{at})"


def opposite(found: Discovery) -> str:
    """Remark on two cross dampings of one gyroscopic coupling, which takes no energy; '' if there are none."""
    known = {one.on: one.parameters["c"] for one in found.effects if one.name == CROSS_DAMPING.name}
    for (one, (c, std)), (other, (d, deviation)) in itertools.combinations(known.items(), 2):
        is_pair = one.split(" on ") == other.split(" on ")[::-1]
        if is_pair and c * d < 0.0 and abs(c + d) < max(DEVIATIONS * np.hypot(std, deviation), APART * abs(c)):
            return f"The forces of {one} and of {other} are opposite, within their uncertainty: a gyroscopic coupling"
    return ""
