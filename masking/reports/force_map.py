"""Map of the latent force at a place over displacement and rate, with the laws there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.inference.discovery import latent_force
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.discovery_result import Discovery
from masking.inference.discovery.force_decomposition import SEEN
from masking.model.declaration.quantities import percent
from masking.model.declaration.units import pretty
from masking.reports import discovery_text, style
from masking.reports import panels as parts
from masking.reports.panels import Band, Level, Line, Panel, Part, drawn
from masking.reports.style import COLOURS, INK, MUTED, CaptionedFigure
from masking.reports.text import capital, listed

BEFORE: Final = COLOURS[1]
AFTER: Final = COLOURS[0]
MISSING: Final = {"element": "latent force", "actuator": "command error", "sensor": "reading error"}
KNOWN: Final = COLOURS[2]  # of a band
KNOWN_OPACITY: Final = 0.35
CLOUD: Final = 0.4  # opacity
POINTS = 5000  # of a cloud
ALSO = 0.02  # part that all takes beyond what the laws at the place take, from which that is stated


def figure(found: Discovery, latent: latent_force.LatentForce) -> CaptionedFigure:
    """Latent force over displacement and rate, before and after, with the laws that are reported there."""
    what, instances, unnamed = MISSING[latent.where], laws_at(found, latent), found.law
    law = along(found, latent, instances) if instances else None
    if unnamed is not None:
        law = unnamed.force(latent.x, latent.rate)
    values = [latent.before, *([law] if law is not None else [])]
    by, unit = parts.shown(pretty(latent.units[0]), *values)
    reach = 1.08 * by * max(float(np.quantile(np.abs(v), 0.999)) for v in values)
    clouds = [(latent.before, latent.deviations[0], BEFORE, what)]
    if latent.after is not None and found.written.hypothesis.instances:
        clouds.append((latent.after, latent.deviations[1], AFTER, f"remaining {what}"))
    drawn_law = None if law is None else by * law
    across = {"element": "displacement", "actuator": "command", "sensor": "reading"}[latent.where]
    rows = []
    for force, deviation, colour, name in clouds:
        key = f"{what}, mean ± 2 deviations" if colour == BEFORE else name
        row = list[Panel]()
        for x, x_unit in latent.seen:
            times, shown_unit = parts.shown(pretty(x_unit), x)
            left, right = np.quantile(x, [0.0005, 0.9995])
            pad = 0.03 * (right - left)
            content = _cloud(times, x, by * force, 2.0 * by * deviation, colour=colour, key=key)
            if colour == BEFORE and drawn_law is not None:
                content += _law(times * x, drawn_law)
            if colour == BEFORE and unnamed is not None:
                centres, low, high = unnamed.band(latent.x, latent.rate, x)
                content.append(Band(times * centres, by * low, by * high, KNOWN, KNOWN_OPACITY, order=4))
            label = style.with_unit(across if x is latent.x else f"rate of {across}", shown_unit)
            ends = (times * (left - pad), times * (right + pad))
            row.append(Panel(content, "" if row else style.with_unit(name, unit), label, ends, (-reach, reach)))
        rows.append(row)
    caption = (
        f"The {what} at {latent.place} along the record, estimated from its readings by a Kalman smoother that adds a "
        "random walk to the equations. No reading is differentiated; changes faster than the noise allows are smoothed "
        "out. Points are samples; the line is their mean over equal ranges."
    )
    if latent.where == "sensor":
        caption = f"The residual of the reading of {latent.place} along the record, over the simulated reading."
    keys: list[Part] = [Line([], [], BEFORE, 2.0, f"{what}, mean ± 2 deviations")]
    if law is not None:
        label = "law that was fitted" if len(instances) < 2 else f"sum of the {len(instances)} laws that were fitted"
        keys.append(Line([], [], INK, 1.6, "law without a name" if unnamed else label))
    if unnamed is not None:
        keys.append(Band([], [], [], KNOWN, KNOWN_OPACITY, "its band, ± 2 deviations"))
    words = CaptionedFigure("map", f"{capital(what)} over displacement and rate", caption)
    return drawn(words, rows, 2.05, heading=_explained(found, latent, what, law), keys=keys)


def _cloud(times: float, x: Array, force: Array, half: float, *, colour: str, key: str) -> list[Part]:
    """Samples of a force over x as points, and their means over equal ranges with a band."""
    few = slice(None, None, max(1, len(x) // POINTS))
    centres, means, _ = latent_force.binned(x, force)
    return [
        Line(times * x[few], force[few], colour, 0.0, marker=".", size=1.6, opacity=CLOUD),
        Band(times * centres, means - half, means + half, colour, 0.16),
        Line(times * centres, means, colour, 1.8, key),
        Level(0.0, MUTED, 0.7, is_dashed=False),
    ]


def laws_at(found: Discovery, latent: latent_force.LatentForce) -> list[EffectInstance]:
    """Causes at the place in view that are reported; none beside a law without a name."""
    if found.law is not None:
        return []
    offered = {(one.name, one.on) for one in discovery_text.reported(found)}
    every = [x for x in found.explanation.hypothesis.instances if (x.effect, x.at) in offered]
    return [x for x in every if x.where == latent.where and x.at in {latent.place, ""}]


def along(found: Discovery, latent: latent_force.LatentForce, instances: Sequence[EffectInstance]) -> Array:
    """Sum of the causes at the place in view (m,): force, command or reading; of its latent force and its instances."""
    known = latent_force.features(found, found.smoothed.before)
    laws = (known.signal(replace(instance, at=latent.place))[0][:, 0] for instance in instances)
    return sum(laws, np.zeros_like(latent.before))


def share(latent: latent_force.LatentForce, law: Array | None) -> float:
    """Part of the mean square of the latent force that a law explains; without one, the whole finding."""
    if law is None:
        assert latent.after is not None  # noqa: S101  # asked only where something was found
        rest = latent.after
    else:
        rest = latent.before - law
    noise = latent.deviations[0] ** 2 if latent.where == "sensor" else 0.0
    after, before = (max(float((v**2).mean()) - noise, 0.0) for v in (rest, latent.before))
    return max(1.0 - after / max(before, 1e-300), 0.0)


def _explained(found: Discovery, latent: latent_force.LatentForce, what: str, law: Array | None) -> str:
    """Part that the laws at the place explain there, and the whole finding if that is more, as a sentence."""
    square = float((latent.before**2).mean())
    is_small = latent.where == "element" and square < SEEN * latent.deviations[0] ** 2
    if found.verdict == "none" or (found.verdict == "parameter" and is_small):
        adjusted = "With the parameters that were found, the" if found.verdict == "parameter" else "The"
        return f"{adjusted} record shows no {what} at {latent.place} beyond its deviation that follows the motion"
    if found.law is not None and law is not None:
        part, band = percent(share(latent, law), 3), found.law.coverage.band
        of = f"of the mean square of the {what} at {latent.place}"
        return f"The law without a name explains {part} {of}, and is known to ± {percent(band)} of its rms"
    if found.verdict == "unknown" or latent.after is None or not found.effects:
        return discovery_text.resemblance(found)
    whole = share(latent, None)
    of = f"of the mean square of the {what} at {latent.place}"
    if law is None:
        return f"The finding explains {percent(whole, 3)} {of}"
    instances = laws_at(found, latent)
    name = listed([discovery_text.cause_name(found, instance.effect, instance.at) for instance in instances])
    explains = "explains" if len(instances) == 1 else "together explain"
    if len(instances) == len(found.explanation.hypothesis.instances) and latent.where != "sensor":
        return f"{capital(name)} {explains} {percent(whole, 3)} {of}"
    # Others act here, too: parameters of a sensor's simulation, or causes at other places.
    alone = share(latent, law)
    sentence = f"{capital(name)} {explains} {percent(alone, 3)} {of}"
    return f"{sentence}; the whole finding explains {percent(whole, 3)}" if whole > alone + ALSO else sentence


def _law(x: Array, law: Array) -> list[Part]:
    """Law as a line where it is a function of x, as a fine cloud where it is not."""
    order = np.argsort(x)
    steps = np.abs(np.diff(law[order]))
    size = float(np.abs(law).max())
    rough = float(np.ptp(law)) > 1e-9 * size and float(np.quantile(steps, 0.9)) > 2e-3 * float(np.ptp(law))
    if rough:
        few = slice(None, None, max(1, len(x) // 6000))
        return [Line(x[few], law[few], INK, 0.0, marker=".", size=1.4, opacity=0.6, order=5)]
    places = np.linspace(x[order[0]], x[order[-1]], 400)
    return [Line(places, np.interp(places, x[order], law[order]), INK, 1.6, order=5)]
