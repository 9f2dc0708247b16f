"""Map: the latent force at a place over displacement and rate, with the laws that were found there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from masking.compile.numerics.arrays import Array
from masking.inference.discovery import latent_force
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.discovery_result import Discovery
from masking.inference.discovery.force_decomposition import SEEN
from masking.model.declaration.quantities import percent
from masking.model.declaration.units import pretty
from masking.reports import discovery_text, style
from masking.reports import figure_parts as parts
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
    """Draw the latent force over displacement and rate, before and after, with the laws that were found there."""
    has_after = latent.after is not None and bool(found.written.hypothesis.instances)
    what = MISSING[latent.where]
    instances, unnamed = laws_at(found, latent), found.law
    law = along(found, latent, instances) if instances else None
    if unnamed is not None:
        law = unnamed.force(latent.x, latent.rate)
    said = _seen(found, latent, what, law)
    values = [latent.before, *([law] if law is not None else [])]
    by, unit = parts.shown(pretty(latent.units[0]), *values)
    reach = 1.08 * by * max(float(np.quantile(np.abs(v), 0.999)) for v in values)
    rows_of = [(latent.before, BEFORE, "before"), *([(latent.after, AFTER, "after")] if has_after else [])]
    seen = latent.seen
    figure, rows = style.panels(len(rows_of), 2.05, (3.62, 3.62) if len(seen) > 1 else (7.8,), heading=said)
    ranges = np.array([np.quantile(x, [0.0005, 0.9995]) for x, _ in seen])
    step = max(1, len(latent.x) // POINTS)
    for (values_of, colour, kind), row in zip(rows_of, rows, strict=True):
        assert values_of is not None  # noqa: S101  # those that are None have no row
        for axes, (x, x_unit), (left, right) in zip(row, seen, ranges, strict=True):
            times, name = parts.shown(pretty(x_unit), x)
            axes.plot(times * x[::step], by * values_of[::step], ".", color=colour, ms=1.6, alpha=CLOUD, mew=0)
            centres, means, _ = latent_force.binned(x, values_of)
            half = 2.0 * latent.deviations[row is not rows[0]]
            axes.fill_between(times * centres, by * (means - half), by * (means + half), color=colour, alpha=0.16, lw=0)
            axes.plot(times * centres, by * means, color=colour, lw=1.8)
            if kind == "before" and law is not None:
                _law(axes, times * x, by * law)
                _band(axes, None if unnamed is None else unnamed.band(latent.x, latent.rate, x), times, by)
            pad = 0.03 * (right - left)
            axes.set(xlim=(times * (left - pad), times * (right + pad)), ylim=(-reach, reach))
            axes.axhline(0.0, color=MUTED, lw=0.7)
            label = {"element": "displacement", "actuator": "command", "sensor": "reading"}[latent.where]
            if row is rows[-1]:
                axes.set_xlabel(style.with_unit(label if x is latent.x else f"rate of {label}", name))
        label = what if kind == "before" else f"remaining {what}"
        row[0].set_ylabel(style.with_unit(label, unit))
        for axes in row[1:]:
            axes.tick_params(labelleft=False)
            axes.yaxis.get_offset_text().set_visible(False)
    handles: list[Line2D | Patch] = [parts.line_key(f"{what}, mean ± 2 deviations", BEFORE)]
    if law is not None:
        label = "law that was fitted" if len(instances) < 2 else f"sum of the {len(instances)} laws that were fitted"
        handles.append(parts.line_key("law without a name" if unnamed else label, INK, 1.6))
    if unnamed is not None:
        handles.append(Patch(color=KNOWN, alpha=KNOWN_OPACITY, label="its band, ± 2 deviations"))
    if has_after:
        handles.append(parts.line_key(f"remaining {what}", AFTER))
    parts.legend(figure, rows[0][-1], handles)
    caption = (
        f"The {what} at {latent.place} along the record, estimated from its readings by a Kalman smoother that adds a "
        "random walk to the equations. No reading is differentiated; changes faster than the noise allows are smoothed "
        "out. Points are samples; the line is their mean over equal ranges."
    )
    if latent.where == "sensor":
        caption = f"The residual of the reading of {latent.place} along the record, over the simulated reading."
    return CaptionedFigure("map", f"{capital(what)} over displacement and rate", caption, figure)


def laws_at(found: Discovery, latent: latent_force.LatentForce) -> list[EffectInstance]:
    """Causes at the place in view that are reported; none beside a law without a name."""
    if found.law is not None:
        return []
    offered = {(one.name, one.on) for one in discovery_text.offered(found)}
    return [
        instance
        for instance in found.explanation.hypothesis.instances
        if instance.where == latent.where
        and instance.at in {latent.place, ""}
        and (instance.effect, instance.at) in offered
    ]


def along(found: Discovery, latent: latent_force.LatentForce, instances: Sequence[EffectInstance]) -> Array:
    """Return what causes at the place that is looked at give together (m,): force, command or reading.

    Args:
        found: the discovery.
        latent: the latent force, at the place in view.
        instances: effect instances there.
    """
    law = np.zeros_like(latent.before)
    motion, names = found.smoothed.before, [place.name for place in found.rig.places]
    for instance in instances:
        if latent.where == "element":
            law += latent_force.along(found, instance, *motion.acted_on(instance.entry, names.index(latent.place)))
        else:
            law += latent_force.along(found, instance, latent.x, latent.rate) - latent.x
    return law


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


def _seen(found: Discovery, latent: latent_force.LatentForce, what: str, law: Array | None) -> str:
    """Say how much the laws at the place explain there, and the whole finding if that is more."""
    square = float((latent.before**2).mean())
    is_small = latent.where == "element" and square < SEEN * latent.deviations[0] ** 2
    if found.verdict == "none" or (found.verdict == "parameter" and is_small):
        beside = "With the parameters that were found, the" if found.verdict == "parameter" else "The"
        return f"{beside} record shows no {what} at {latent.place} beyond its deviation that follows the motion"
    if found.law is not None and law is not None:
        part, band = percent(share(latent, law), 3), found.law.coverage.band
        of = f"of the mean square of the {what} at {latent.place}"
        return f"The law without a name explains {part} {of}, and is known to ± {percent(band)} of its rms"
    if found.verdict == "unknown" or latent.after is None or not found.effects:
        return discovery_text.look(found)
    whole = share(latent, None)
    of = f"of the mean square of the {what} at {latent.place}"
    if law is None:
        return f"The finding explains {percent(whole, 3)} {of}"
    instances = laws_at(found, latent)
    name = listed([discovery_text.spoken(found, instance.effect, instance.at) for instance in instances])
    explains = "explains" if len(instances) == 1 else "together explain"
    if len(instances) == len(found.explanation.hypothesis.instances) and latent.where != "sensor":
        return f"{capital(name)} {explains} {percent(whole, 3)} {of}"
    # Others act here, too: parameters of a sensor's simulation, or causes at other places.
    alone = share(latent, law)
    sentence = f"{capital(name)} {explains} {percent(alone, 3)} {of}"
    return f"{sentence}; the whole finding explains {percent(whole, 3)}" if whole > alone + ALSO else sentence


def _band(axes: Axes, band: tuple[Array, Array, Array] | None, times: float, by: float) -> None:
    """Draw the band of a law without a name, in factors of what is drawn; of others, which have none, nothing."""
    if band is not None:
        centres, low, high = band
        axes.fill_between(times * centres, by * low, by * high, color=KNOWN, alpha=KNOWN_OPACITY, lw=0.8, zorder=4)


def _law(axes: Axes, x: Array, law: Array) -> None:
    """Draw a law: as a line where it is a function of x, as a fine cloud where it is not."""
    order = np.argsort(x)
    steps = np.abs(np.diff(law[order]))
    size = float(np.abs(law).max())
    rough = float(np.ptp(law)) > 1e-9 * size and float(np.quantile(steps, 0.9)) > 2e-3 * float(np.ptp(law))
    if not rough:
        places = np.linspace(x[order[0]], x[order[-1]], 400)
        axes.plot(places, np.interp(places, x[order], law[order]), color=INK, lw=1.6, zorder=5)
        return
    step = max(1, len(x) // 6000)
    axes.plot(x[::step], law[::step], ".", color=INK, ms=1.4, alpha=0.6, mew=0, zorder=5)
