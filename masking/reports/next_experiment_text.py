"""Text of the next experiment for a law without a name, from the range of a record and its residual."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.inference.discovery import latent_force
from masking.inference.discovery.discovery_result import Discovery
from masking.inference.discovery.latent_force import LatentForces, LocatedForce
from masking.inference.discovery.unnamed_law import Coverage
from masking.model.declaration.quantities import percent, quantity
from masking.reports.place_text import MOST, MUCH
from masking.reports.text import capital, listed, much

NARROW = 0.05  # of the rms of a law: a band above this anywhere is to be made narrower first
THIN = 0.5  # part of the displacements and rates within a range: a motion that visits less hardly shows a memory
EQUAL = 0.95  # of what the best place explains: others that explain as much may be it
ONE = 0.999  # correlation of displacements from which they are the same motion


def further(found: Discovery) -> list[str]:
    """Experiments that would tell more of what no name explains, in sentences."""
    seen = found.localisation
    left, law = seen.residual or seen.latent, found.law
    place = left.best if law is None else left.places[law.place]
    rest = "the model error" if seen.residual is None else "the residual"
    is_known = law is not None and np.isfinite(law.coverage.band)
    made = [_of_law(found, law.coverage, law.free.place.name)] if law is not None and is_known else []
    if law is None or not law.closed:
        made += [*_of_rest(found, place, rest), *_of_places(found, seen.latent)]
    return [capital(text) for text in made or [_of_range(found, place.name)]]


def _of_law(found: Discovery, known: Coverage, place: str) -> str:
    """Uncertainty of a law without a name, where it is largest, and the motion that would reduce it."""
    _, length, speed = latent_force.element_units(found.written_rig, place)
    least, of_length = known.widest, known.widest.of == "displacement"
    unit = length if of_length else speed
    where = f"{'displacements' if of_length else 'speeds'} of {_between(least.low, least.high, unit)}"
    said = (
        f"along the motion the law is known to ± {percent(known.band)} of its rms (two standard deviations), and "
        f"least, to ± {percent(least.band)}, at {where}"
    )
    if least.band > NARROW:
        more = "a record with more of its motion there would tell most"
    else:
        more = f"a motion beyond {_reach(known, length, speed)} would tell how it goes on there"
    if known.visited >= THIN:
        return f"{said}: {more}"
    return (
        f"{said}: {more}, and one with another amplitude or frequency whether it has a memory, since this one visits "
        f"{percent(known.visited)} of the displacements and rates within its range"
    )


def _reach(known: Coverage, length: str, speed: str) -> str:
    """Range of a motion in what a law follows."""
    fastest = max(map(abs, known.rate))
    sides = {
        "d": f"displacements of {_between(*known.displacement, length)}",
        "v": f"speeds of {quantity(fastest, speed, 2)}",
    }
    return listed([sides[side] for side in known.sides])


def _between(low: float, high: float, unit: str) -> str:
    return f"{quantity(low, unit, 2)} to {quantity(high, unit, 2)}"


def _of_rest(found: Discovery, place: LocatedForce, rest: str) -> Iterator[str]:
    """Records that would tell a memory, another place or a change with time from each other."""
    parts, thirds = place.decomposition.energy, place.decomposition.regions.get("record", {})
    late = next((name for name, (part, time) in thirds.items() if part > max(MUCH * time, MOST)), None)
    if late is not None:
        yield (
            f"{much(thirds[late][0])} of {rest} is in the {late} third of the record: the same record once more "
            "would tell whether it changes with time"
        )
    if parts is not None and parts.neither > MOST:
        few = len(found.twin.sensors) < len(found.twin.model.coordinates)
        other = ", and a further sensor whether it is elsewhere" if few else ""
        yield (
            f"{much(parts.neither)} of {rest} at {place.name} follows neither displacement nor rate: two "
            f"amplitudes at one frequency, and two frequencies at one amplitude, would tell whether it has a "
            f"memory{other}"
        )


def _of_places(found: Discovery, latent: LatentForces) -> Iterator[str]:
    """Motions that would tell places apart that explain the model error alike."""
    best, motion = latent.best, found.search.motion
    names = [place.name for place in found.rig.places]

    def moves(name: str) -> Array:
        return motion.displacement[:, names.index(name)]

    others = [one for one in latent.places.values() if one is not best] if best.explained else []
    alike = [one.name for one in others if one.explained > EQUAL * best.explained]
    if not alike:
        return
    with np.errstate(all="ignore"):
        apart = [name for name in alike if not abs(np.corrcoef(moves(best.name), moves(name))[0, 1]) > ONE]
    what = listed([best.name, *alike])
    if not apart:
        yield f"{what} move as one: a sensor of the force in one of them would tell where it acts"
    else:
        yield f"{what} explain it alike: a motion of one of them without the other would tell where it acts"


def _of_range(found: Discovery, name: str) -> str:
    """Range of a record at a place, beyond which another record would tell more."""
    at = [place.name for place in found.rig.places].index(name)
    motion, (_, length, speed) = found.search.motion, latent_force.element_units(found.rig, name)
    x, fastest = motion.displacement[:, at], float(np.abs(motion.rate[:, at]).max())
    if not np.ptp(x):
        return f"the record moves {name} at no more than {quantity(fastest, speed, 2)}: a faster motion would tell more"
    far = _between(float(x.min()), float(x.max()), length)
    return (
        f"the record moves {name} from {far}, at no more than {quantity(fastest, speed, 2)}: a motion that is larger, "
        "or slower in the same range, would tell more"
    )
