"""Figures of a discovery: simulation errors, the latent force, residuals, and candidates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

from masking.inference.discovery import latent_force
from masking.inference.discovery.discovery_result import Discovery
from masking.inference.discovery.screening import Score
from masking.inference.discovery.verdict import noise_threshold
from masking.inference.estimation.simulation import Simulated
from masking.model.declaration.quantities import percent, quantity
from masking.model.declaration.units import pretty
from masking.reports import discovery_text, fit_figures, force_map, place_text, style
from masking.reports import figure_parts as parts
from masking.reports.force_map import AFTER, BEFORE, CLOUD, MISSING, POINTS
from masking.reports.style import COLOURS, DASHED, GRID, INK, MUTED, SIZE, WIDTH, CaptionedFigure
from masking.reports.text import capital, listed

MOST_SENSORS = 6
MOST_TRIED = 12
LETTER = 0.082  # inches of a letter of a label, with some room
MOST_PAID = 1000.0  # %, of what would count: more is stated as more than this
NEAR = 0.9  # of the best candidate's gain: those that are named together
WIDE = 200.0  # highest over lowest frequency from which powers of ten are enough of a scale
FAINT = 1e-3  # of the strongest line: weaker ones are rounded off by the smoother, and not drawn


def figures(found: Discovery) -> list[CaptionedFigure]:
    """Draw the figures of a discovery."""
    most = discovery_text.rest(found).best.name if found.law is None else found.law.free.place.name
    latent = latent_force.force_at(found.as_written, most)
    of_force = [force_map.figure(found, latent)] if np.isfinite(latent.deviations[0]) else []  # seen by a sensor
    if of_force and latent.where != "sensor" and found.twin.actuators:
        of_force.append(_course(found, latent))
    return [_comparison(found), _gap(found), *of_force, _residual(found), _candidates(found)]


def _comparison(found: Discovery) -> CaptionedFigure:
    """Draw the validation record beside what the model makes of it as declared, and with what was found."""
    record, sensors = found.validation_record, found.twin.declaration.sensors
    units = tuple("" if sensors[name].unit == "1" else sensors[name].unit for name in found.twin.sensors)
    before, after = (
        Simulated(record, found.twin.sensors, units, record.readings - one.residuals)
        for one in (found.before, found.unseen)
    )
    has_finding = found.effects or found.law
    labels = "as declared", "with the finding" if has_finding else "with adjusted parameters"
    name = discovery_text.worst(found)
    first, last = (percent(one.chi[name]) for one in (before, after))
    said = f"On data that were not used, the error of {name} falls from {first} {labels[0]} to {last} {labels[1]}"
    if not after.chi[name] < before.chi[name]:
        said = f"On data that were not used, the error of {name} is {first} {labels[0]} and {last} {labels[1]}"
    made = fit_figures.comparison(before, after, labels, said)
    return replace(made, caption=f"{made.caption}{_intervals(found)}")


def _intervals(found: Discovery) -> str:
    """Say in a caption in which shooting intervals records are simulated; '' where they are simulated whole."""
    every = {part.interval for part in (found.validation, found.as_written.validation)} - {0}
    seconds = [quantity(samples / found.record.rate, "s") for samples in sorted(every, reverse=True)]
    return f" Shooting intervals of {listed(seconds)} each have an initial state of their own." if seconds else ""


def _gap(found: Discovery) -> CaptionedFigure:
    """Draw the error of each sensor before and after, in the record and in the validation record, beside the noise."""
    names = found.twin.sensors
    said = capital(discovery_text.left(found)) if found.verdict == "none" else discovery_text.gap(found)
    figure, (row,) = style.panels(1, 0.34 * len(names) + 0.35, (3.6, 3.6), top=style.BELOW + 0.28, heading=said)
    sides = errors(found)
    every = [v for side in sides.values() for one in side for v in one.values() if 0.0 < v < np.inf]
    low, high = 100.0 * min(every) / 1.6, 100.0 * max(every) * 1.6
    for axes, (title, side) in zip(row, sides.items(), strict=True):
        for i, name in enumerate(names):
            declared, adjusted, after, noise = (100.0 * one[name] for one in side)
            axes.plot([max(declared, adjusted), after], [i, i], color=GRID, lw=4, solid_capstyle="round", zorder=1)
            axes.plot([noise, noise], [i - 0.32, i + 0.32], color=INK, lw=1.4, zorder=5)
            axes.plot(declared, i, "o", color="white", mec=MUTED, mew=1.4, ms=6.5, zorder=2)
            axes.plot(adjusted, i, "o", color=BEFORE, ms=7, zorder=3)
            if found.effects or found.law:
                axes.plot(after, i, "o", color=AFTER, ms=7, zorder=4)
        axes.set_xscale("log")
        axes.set(xlim=(low, high), ylim=(len(names) - 0.5, -0.5))
        parts.plain_numbers(axes.xaxis, " %")
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_yticks(range(len(names)), labels=map(style.symbol, names))
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("error relative to the reading")
        axes.set_title(title, loc="left", fontsize=SIZE, color=MUTED, pad=5)
    handles = [
        parts.marker_key("as declared", "white", mec=MUTED, mew=1.4),
        parts.marker_key("adjusted parameters", BEFORE),
    ]
    if found.effects or found.law:
        handles.append(parts.marker_key("with the finding", AFTER))
    handles.append(parts.marker_key("noise floor", INK, "|", 11.0, mew=1.4))
    parts.legend(figure, row[-1], handles, above=0.28)
    caption = (
        "The error of the free simulation of each sensor, chi = ||measured - simulated|| / ||measured||, with the best "
        "initial state: of the model as declared, with its parameters adjusted within their prior uncertainty, and "
        f"with the finding. The noise floor is the error that the noise alone makes.{_intervals(found)}"
    )
    return CaptionedFigure("gap", "Simulation error", caption, figure)


def _course(found: Discovery, latent: latent_force.LatentForce) -> CaptionedFigure:
    """Draw the latent force over a command, time and frequency, before and after."""
    what = MISSING[latent.where]
    seen = discovery_text.subject(found)
    command = max(seen.actuators, key=lambda name: seen.actuators[name])
    column = found.record.acting[:, found.twin.actuators.index(command)]
    said = _coursed(found, latent, command)
    by, unit = parts.shown(pretty(latent.units[0]), latent.before)
    figure, ((over, time, spectrum),) = style.panels(1, 1.75, (2.05, 2.7, 1.6), heading=said)
    t, step = np.arange(len(latent.before)) / found.record.rate, max(1, len(latent.before) // POINTS)
    pairs = [(latent.before, BEFORE), *([(latent.after, AFTER)] if found.effects or found.law else [])]
    drawn = [(values, colour) for values, colour in pairs if values is not None]
    times, name = parts.shown(pretty(latent_force.command_unit(found, command)), column)
    for values, colour in drawn:
        over.plot(times * column[::step], by * values[::step], ".", color=colour, ms=1.6, alpha=CLOUD, mew=0)
        time.plot(*style.thin(t, by * values, 500), color=colour, lw=0.7)
        f, density = parts.spectral_density(values, found.record.rate)
        spectrum.plot(f, density, color=colour, lw=1.2)
        if colour == BEFORE:
            strong = density > FAINT * density.max()
            spectrum.set_xlim(f[0], f[strong][-1])
            spectrum.set_ylim(0.03 * FAINT * density.max(), 2.0 * density.max())
    for axes in (over, time):
        parts.noise_band(axes, 2.0 * by * latent.deviations[0])
    reach = 1.05 * by * max(2.0 * latent.deviations[0], *(float(np.abs(values).max()) for values, _ in drawn))
    over.set_ylim(-reach, reach)
    time.set(xlim=(0.0, t[-1]), ylim=(-reach, reach))
    time.tick_params(labelleft=False)
    time.yaxis.get_offset_text().set_visible(False)
    over.xaxis.set_major_locator(MaxNLocator(4))
    over.set_ylabel(style.with_unit(what, unit))
    over.set_xlabel(style.with_unit(f"command {style.symbol(command)}", name))
    time.set_xlabel("time (s)")
    parts.logarithmic(spectrum)
    spectrum.set_xlabel("frequency (Hz)")
    spectrum.set_ylabel(style.with_unit("density", f"{pretty(latent.units[0])}/√Hz" if latent.units[0] else ""))
    parts.plain_numbers(spectrum.xaxis, few=WIDE)
    handles = [parts.line_key(what, BEFORE)]
    if len(drawn) > 1:
        handles.append(parts.line_key(f"remaining {what}", AFTER))
    label = "± 2 deviations" + " of the first" * (len(drawn) > 1)
    handles.append(parts.line_key(label, INK, 1, dashed=True))
    parts.legend(figure, spectrum, handles)
    caption = (
        f"The {what} at {latent.place} over the command that it follows most, over time, and the root of its power "
        "spectral density. Effects that change with time, or have a frequency of their own, show here."
    )
    return CaptionedFigure("course", f"{capital(what)} over command, time and frequency", caption, figure)


def _coursed(found: Discovery, latent: latent_force.LatentForce, command: str) -> str:
    """Say how much of the model error follows a command, and how alike the thirds of the record are."""
    seen = discovery_text.subject(found)
    if not any(seen.coordinates.values()):
        return f"The model error at {latent.place} is not beyond its deviation"
    sentence = capital(place_text.follows_command(seen, command))
    place = next((place for place in seen.places if place.name == latent.place), None)
    if place is None or not place.decomposition.regions:
        return sentence
    thirds = [energy for energy, _ in place.decomposition.regions["record"].values()]
    shares = listed([percent(part) for part in thirds])
    return f"{sentence}; the thirds of the record hold {shares} of the energy of the force at {latent.place}"


def _residual(found: Discovery) -> CaptionedFigure:
    """Draw the residuals of the validation record, over time and frequency, before and after."""
    names = found.twin.sensors[:MOST_SENSORS]
    sigma, record, after = found.validation.sigma, found.validation_record, found.unseen
    most = noise_threshold(len(record), found.problem.rules)
    more = [n for i, n in enumerate(found.twin.sensors) if after.squares[i] > most**2 * len(record) * sigma[i] ** 2]
    said = (
        f"On the validation record, the residual of {listed(found.twin.sensors)} is noise"
        if not more
        else f"On the validation record, the residual of {listed(more)} is above the noise floor"
    )
    figure, rows = style.panels(len(names), 1.35, (4.55, 2.55), heading=said)
    t = np.arange(len(record)) / record.rate
    pairs = [(found.adjusted, BEFORE, 0.9), *([(after, AFTER, 1.0)] if found.effects or found.law else [])]
    for i, (name, (time, spectrum)) in enumerate(zip(names, rows, strict=True)):
        unit = found.twin.declaration.sensors[name].unit
        by, y_unit = parts.shown(pretty(unit), *(h.residuals[:, i] for h, _, _ in pairs))
        for hypothesis, colour, width in pairs:
            time.plot(*style.thin(t, by * hypothesis.residuals[:, i], 500), color=colour, lw=0.6)
            f, density = parts.spectral_density(hypothesis.residuals[:, i], record.rate)
            spectrum.plot(f, density, color=colour, lw=width + 0.3)
        parts.noise_band(time, 1.96 * by * sigma[i])
        reach = 1.05 * by * max(float(np.abs(h.residuals[:, i]).max()) for h, _, _ in pairs)
        time.set(xlim=(0.0, t[-1]), ylim=(-reach, reach))
        time.set_ylabel(style.with_unit(style.symbol(name), y_unit))
        parts.ticks(time, 4)
        parts.logarithmic(spectrum)
        spectrum.set_xlim(f[0], f[-1])
        level = parts.noise_level(spectrum, sigma[i], record.rate)
        low, high = spectrum.get_ylim()
        spectrum.set_ylim(min(low, level / 5.0), max(high, 5.0 * level))
        spectrum.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        spectrum.set_ylabel(f"{unit}/√Hz" if unit != "1" else "1/√Hz")
    rows[-1][0].set_xlabel("time (s)")
    rows[-1][1].set_xlabel("frequency (Hz)")
    handles = [parts.line_key("adjusted parameters", BEFORE)]
    if found.effects or found.law:
        handles.append(parts.line_key("with the finding", AFTER))
    handles.append(parts.line_key("noise: 95 % of it, and its spectrum", INK, 1, dashed=True))
    parts.legend(figure, rows[0][1], handles)
    caption = (
        f"{record.name}: measured less simulated, over time and as the root of its power spectral density. A line "
        "above the noise is an effect that the model does not have."
    )
    return CaptionedFigure("residual", "Residuals", caption, figure)


def _candidates(found: Discovery) -> CaptionedFigure:
    """Draw how much of the residual each candidate would explain; if nothing is missing, of the least that counts."""
    every, nothing = tried(found), found.verdict == "none"
    chosen = {(one.name, one.on) for one in found.effects}
    rows = [row for i, row in enumerate(every) if i < MOST_TRIED or (row[0], row[1]) in chosen]
    if not rows:
        return CaptionedFigure("candidates", "Candidates", "No candidate would explain any of the residual.", None)
    names = [discovery_text.labelled(found, effect, at) for effect, at, _, _ in rows]
    shares = [100.0 * (paid if nothing else part) for _, _, part, paid in rows]
    fitted = {key for rival in found.rivals for key in rival.names}
    near = [part for part in shares if part > NEAR * shares[0]]
    count = len(found.search.tried)
    if nothing and shares[0] > 100.0:
        many = sum(part > 100.0 for part in shares)
        said = f"The residual is noise; of {count} candidates, {many} would be worth their parameters to first order"
    elif nothing:
        said = f"None of {count} candidates would explain enough to be worth its parameters"
    elif not found.effects:
        said = f"None of {count} candidates explains the residual"
    elif len(near) == 1:
        first = discovery_text.spoken(found, *rows[0][:2])
        said = f"Of {count} candidates, {first} alone would explain {near[0]:.3g} % of the residual"
    else:
        said = (
            f"Of {count} candidates, {len(near)} would each explain more than {min(near):.2g} % of the residual; full "
            "fits decide between them as far as the record allows"
        )
    figure, ((axes,),) = style.panels(1, 0.235 * len(rows) + 0.1, (5.6,), heading=said)
    box = axes.get_position()
    right, room = box.x0 + 0.19 + box.width, LETTER * max(map(len, names)) / WIDTH
    axes.set_position((max(box.x0, room), box.y0, right - max(box.x0, room), box.height))
    colours = [_colour((effect, at), chosen, fitted) for effect, at, _, _ in rows]
    axes.barh(range(len(rows)), shares, height=0.66, color=colours)
    reach = 112.0 if nothing else 1.12 * max(shares)
    for i, part in enumerate(shares):
        label = f"{part:.3g} %" if part <= MOST_PAID else f"> {MOST_PAID:.0f} %"
        axes.annotate(label, (min(part, reach), i), (4, 0), textcoords="offset points", va="center",
                      fontsize=SIZE - 1.5, color=MUTED)  # fmt: skip
    axes.set(ylim=(len(rows) - 0.4, -0.6), xlim=(0.0, reach))
    axes.set_yticks(range(len(rows)), labels=names)
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
    if nothing:
        axes.axvline(100.0, color=INK, lw=1.2, ls=DASHED)
        axes.set_xlabel("gain in log-likelihood, relative to the least that counts (%)")
    else:
        axes.set_xlabel("part of the residual beyond noise that the candidate alone would explain (%)")
    kinds = {AFTER: "chosen", COLOURS[4]: "fitted in full", GRID: "looked at"}
    parts.legend(figure, axes, [Patch(color=colour, label=text) for colour, text in kinds.items() if colour in colours])
    caption = (
        "To first order along the measured motion, less the part that the model's own parameters could explain; the "
        "best are then fitted in full, and their likelihoods decide."
    )
    return CaptionedFigure("candidates", "Candidates", caption, figure)


def _colour(key: tuple[str, str], chosen: set[tuple[str, str]], fitted: set[tuple[str, str]]) -> str:
    return AFTER if key in chosen else COLOURS[4] if key in fitted else GRID


def tried(found: Discovery) -> list[tuple[str, str, float, float]]:
    """Each candidate once, the best first: effect, place, part of the gap, part of what would count."""
    best: dict[str, Score] = {}
    for score in found.search.tried:
        label = discovery_text.spoken(found, *score.candidate.key)
        if score.gain > 0.0 and score.gain > getattr(best.get(label), "gain", 0.0):
            best[label] = score
    size = found.record.readings.size
    whole = max(found.search.base.hypothesis.cost - size, *(p.gain for p in best.values()), 1e-300)
    price, least = float(np.log(size)), found.problem.rules.effect_evidence
    return [
        (*p.candidate.key, p.gain / whole, p.gain / (price * len(p.candidate.free) + least))
        for p in sorted(best.values(), key=lambda score: -score.gain)
    ]


def errors(found: Discovery) -> dict[str, tuple[Mapping[str, float], ...]]:
    """Relative errors by sensor of each record: as declared, adjusted, with the finding, and the noise floor."""
    gap, size = found.simulation_error, (found.record.readings**2).sum(axis=0)
    fitted, validated = (gap.estimation[1], gap.validation[1]) if found.law is None else found.law.error
    own = np.sqrt(found.search.base.hypothesis.squares / np.maximum(size, 1e-300))
    adjusted = dict(zip(found.twin.sensors, map(float, own), strict=True))
    return {
        "record": (gap.estimation[0], adjusted, fitted, gap.noise_floor),
        "validation record": (gap.validation[0], gap.adjusted, validated, gap.validation_noise_floor),
    }
