"""Figures of a discovery: simulation errors, the latent force over what it follows, residuals, and candidates."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, MaxNLocator

from masking.compile.numerics.arrays import Array
from masking.inference.discovery import latent_force
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.discovery_result import Discovery
from masking.inference.discovery.force_decomposition import SEEN
from masking.inference.discovery.screening import Score
from masking.inference.discovery.verdict import noise_threshold
from masking.inference.estimation.simulation import Simulated
from masking.model.declaration.quantities import percent, quantity
from masking.model.declaration.units import pretty
from masking.reports import discovery_text, fit_figures, one_page, panels, place_text, style
from masking.reports.panels import (
    Band,
    Level,
    Line,
    Panel,
    Part,
    Span,
    bars,
    drawn,
    either_side,
    plain_numbers,
    spectrum,
)
from masking.reports.style import COLOURS, GRID, INK, MUTED, SIZE, CaptionedFigure
from masking.reports.text import capital, capped, listed

MOST_SENSORS = 6
MOST_TRIED = 12
LETTER = 0.082  # inches of a letter of a label, with some room
NEAR = 0.9  # of the best candidate's gain: those that are named together
WIDE = 200.0  # highest over lowest frequency from which powers of ten are enough of a scale
MODELS = ("as declared", "adjusted parameters", "with the finding", panels.NOISE)
VALIDATION = "validation record"
Tried = tuple[str, str, float, float]  # effect, place, part of the residual, part of what would count
FAINT = 1e-3  # of the strongest line: weaker ones are rounded off by the smoother, and not drawn
BEFORE: Final = COLOURS[1]
AFTER: Final = COLOURS[0]
MISSING: Final = {"element": "latent force", "actuator": "command error", "sensor": "reading error"}
KNOWN: Final = COLOURS[2]  # of a band
KNOWN_OPACITY: Final = 0.35
CLOUD: Final = 0.4  # opacity
POINTS = 5000  # of a cloud
ALSO = 0.02  # part that all takes beyond what the laws at the place take, from which that is stated


def figures(found: Discovery) -> list[CaptionedFigure]:
    """Figures of a discovery."""
    most = discovery_text.remaining_error(found).best.name if found.law is None else found.law.free.place.name
    latent = latent_force.force_at(found.as_written, most)
    of_force = [_map(found, latent)] if np.isfinite(latent.deviations[0]) else []  # seen by a sensor
    if of_force and latent.where != "sensor" and found.twin.actuators:
        of_force.append(_course(found, latent))
    return [_comparison(found), _gap(found), *of_force, _residual(found), _candidates(found)]


def _comparison(found: Discovery) -> CaptionedFigure:
    """Validation record beside its simulation by the model as declared, and with the finding."""
    record, sensors = found.validation_record, found.twin.declaration.sensors
    units = tuple("" if sensors[name].unit == "1" else sensors[name].unit for name in found.twin.sensors)
    left = found.before.residuals, found.unseen.residuals
    before, after = (Simulated(record, found.twin.sensors, units, record.readings - one) for one in left)
    has_finding = found.effects or found.law
    labels = "as declared", "with the finding" if has_finding else "with adjusted parameters"
    name = discovery_text.worst_sensor(found)
    first, last = (percent(one.chi[name]) for one in (before, after))
    said = f"On data that were not used, the error of {name} falls from {first} {labels[0]} to {last} {labels[1]}"
    if not after.chi[name] < before.chi[name]:
        said = f"On data that were not used, the error of {name} is {first} {labels[0]} and {last} {labels[1]}"
    made = fit_figures.comparison(before, after, labels, said)
    return replace(made, caption=f"{made.caption}{_intervals(found)}")


def _intervals(found: Discovery) -> str:
    """Shooting intervals in which records are simulated, for a caption; '' where they are simulated whole."""
    every = {part.interval for part in (found.validation, found.as_written.validation)} - {0}
    seconds = [quantity(samples / found.record.rate, "s") for samples in sorted(every, reverse=True)]
    return f" Shooting intervals of {listed(seconds)} each have an initial state of their own." if seconds else ""


def _gap(found: Discovery) -> CaptionedFigure:
    """Error of each sensor before and after, in the record and in the validation record, beside the noise."""
    said = discovery_text.noise_remark(found) if found.verdict == "none" else discovery_text.error_change(found)
    caption = (
        "The error of the free simulation of each sensor, chi = ||measured - simulated|| / ||measured||, with the best "
        "initial state: of the model as declared, with its parameters adjusted within their prior uncertainty, and "
        f"with the finding. The noise floor is the error that the noise alone makes.{_intervals(found)}"
    )
    words = CaptionedFigure("gap", "Simulation error", caption)
    sides = {record: by_model(found, record) for record in errors(found)}
    ends = panels.error_reach(*sides.values()) or (1e-3, 1.0)
    row = [panels.error_panel(side, ends, one_page.RELATIVE, title) for title, side in sides.items()]
    return drawn(words, [row], 0.34 * len(found.twin.sensors) + 0.35, heading=capital(said))


def by_model(found: Discovery, record: str) -> dict[str, Mapping[str, float]]:
    """Relative errors by sensor of each model in a record of `errors`, with what was found if anything was."""
    every = dict(zip(MODELS, errors(found)[record], strict=True))
    return {name: part for name, part in every.items() if name != MODELS[2] or found.effects or found.law}


def _course(found: Discovery, latent: latent_force.LatentForce) -> CaptionedFigure:
    """Latent force over a command, time and frequency, before and after."""
    what, rate = MISSING[latent.where], found.record.rate
    seen = discovery_text.model_error(found)
    command = max(seen.actuators, key=lambda name: seen.actuators[name])
    column = found.record.acting[:, found.twin.actuators.index(command)]
    by, unit = panels.shown(pretty(latent.units[0]), latent.before)
    times, name = panels.shown(pretty(latent_force.channel_unit(found, command, "actuator")), column)
    t, few = np.arange(len(latent.before)) / rate, slice(None, None, max(1, len(latent.before) // POINTS))
    pairs = [(latent.before, BEFORE, what)]
    if latent.after is not None and (found.effects or found.law):
        pairs.append((latent.after, AFTER, f"remaining {what}"))
    label = "± 2 deviations" + " of the first" * (len(pairs) > 1)
    band = either_side(2.0 * by * latent.deviations[0], key=label)
    reach = 1.05 * by * max(2.0 * latent.deviations[0], *(float(np.abs(values).max()) for values, *_ in pairs))
    x = times * column[few]
    cloud = [Line(x, by * v[few], colour, 0.0, marker=".", size=1.6, opacity=CLOUD) for v, colour, _ in pairs]
    course = [Line(t, by * values, colour, 0.7, key, bins=500) for values, colour, key in pairs]
    densities = spectrum([(values, colour, 1.2) for values, colour, _ in pairs], rate, None, "")
    f, first = panels.spectral_density(latent.before, rate)
    last = float(f[first > FAINT * first.max()][-1])

    def finish(axes: Axes) -> None:
        axes.set_xlim(float(f[0]), last)
        plain_numbers(axes.xaxis, few=WIDE)

    density = style.with_unit("density", f"{pretty(latent.units[0])}/√Hz" if latent.units[0] else "")
    row = [
        Panel([*cloud, *band], style.with_unit(what, unit), style.with_unit(f"command {style.symbol(command)}", name),
              ylim=(-reach, reach), finish=lambda axes: axes.xaxis.set_major_locator(MaxNLocator(4))),
        Panel([*course, *band], "", "time (s)", (0.0, t[-1]), (-reach, reach)),
        replace(densities, y=density, ylim=(0.03 * FAINT * first.max(), 2.0 * first.max()), finish=finish),
    ]  # fmt: skip
    caption = (
        f"The {what} at {latent.place} over the command that it follows most, over time, and the root of its power "
        "spectral density. Effects that change with time, or have a frequency of their own, show here."
    )
    words = CaptionedFigure("course", f"{capital(what)} over command, time and frequency", caption)
    return drawn(words, [row], 1.75, widths=(2.05, 2.7, 1.6), heading=_coursed(found, latent, command))


def _coursed(found: Discovery, latent: latent_force.LatentForce, command: str) -> str:
    """Part of the model error that follows a command, and the thirds of the record beside each other."""
    seen = discovery_text.model_error(found)
    if not any(seen.coordinates.values()):
        return f"The model error at {latent.place} is not beyond its deviation"
    sentence = capital(place_text.follows_command(seen, command))
    place = seen.places.get(latent.place)
    if place is None or not place.decomposition.regions:
        return sentence
    thirds = [energy for energy, _ in place.decomposition.regions["record"].values()]
    shares = listed([percent(part) for part in thirds])
    return f"{sentence}; the thirds of the record hold {shares} of the energy of the force at {latent.place}"


def _residual(found: Discovery) -> CaptionedFigure:
    """Residuals of the validation record, over time and frequency, before and after."""
    sigma, record, after = found.validation.sigma, found.validation_record, found.unseen
    most = noise_threshold(len(record), found.problem.rules)
    more = [n for i, n in enumerate(found.twin.sensors) if after.squares[i] > most**2 * len(record) * sigma[i] ** 2]
    said = f"the residual of {listed(more or found.twin.sensors)} is {'above the noise floor' if more else 'noise'}"
    t = np.arange(len(record)) / record.rate
    pairs = [(found.adjusted, BEFORE, "adjusted parameters", 1.2)]
    if found.effects or found.law:
        pairs.append((after, AFTER, "with the finding", 1.3))
    rows = []
    for i, name in enumerate(found.twin.sensors[:MOST_SENSORS]):
        unit = found.twin.declaration.sensors[name].unit
        by, y_unit = panels.shown(pretty(unit), *(h.residuals[:, i] for h, *_ in pairs))
        lines = [Line(t, by * h.residuals[:, i], colour, 0.6, key, bins=500) for h, colour, key, _ in pairs]
        band = either_side(1.96 * by * sigma[i], key="noise: 95 % of it, and its spectrum")
        reach = 1.05 * by * max(float(np.abs(h.residuals[:, i]).max()) for h, *_ in pairs)
        signals = [(h.residuals[:, i], colour, width) for h, colour, _, width in pairs]
        label = style.with_unit(style.symbol(name), y_unit)
        densities = spectrum(signals, record.rate, sigma[i], "" if unit == "1" else unit)
        level = panels.noise_density(sigma[i], record.rate)
        rows.append([
            Panel([*lines, *band], label, "time (s)", (0.0, t[-1]), (-reach, reach), ticks=4),
            replace(densities, finish=functools.partial(_with_room, level=level)),
        ])  # fmt: skip
    caption = (
        f"{record.name}: measured less simulated, over time and as the root of its power spectral density. A line "
        "above the noise is an effect that the model does not have."
    )
    words = CaptionedFigure("residual", "Residuals", caption)
    return drawn(words, rows, widths=(4.55, 2.55), heading=f"On the validation record, {said}")


def _with_room(axes: Axes, level: float) -> None:
    """Give a spectrum room around the noise, and plain frequencies."""
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, level / 5.0), max(high, 5.0 * level))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))


def _candidates(found: Discovery) -> CaptionedFigure:
    """Part of the residual that each candidate would explain; if nothing is missing, of the least that counts."""
    every, nothing = tried(found), found.verdict == "none"
    chosen = {(one.name, one.on) for one in found.effects}
    rows = [row for i, row in enumerate(every) if i < MOST_TRIED or (row[0], row[1]) in chosen]
    if not rows:
        return CaptionedFigure("candidates", "Candidates", "No candidate would explain any of the residual.", None)
    names = [discovery_text.cause_label(found, effect, at) for effect, at, _, _ in rows]
    shares = [100.0 * (paid if nothing else part) for _, _, part, paid in rows]
    fitted = {key for rival in found.rivals for key in rival.names}
    kinds = {AFTER: "chosen", COLOURS[4]: "fitted in full", GRID: "looked at"}
    colours = [AFTER if row[:2] in chosen else COLOURS[4] if row[:2] in fitted else GRID for row in rows]
    reach = 112.0 if nothing else 1.12 * max(shares)

    def finish(axes: Axes) -> None:
        axes.barh(range(len(rows)), shares, height=0.66, color=colours)
        for i, part in enumerate(shares):
            axes.annotate(capped(part / 100.0), (min(part, reach), i), (4, 0), textcoords="offset points", va="center",
                          fontsize=SIZE - 1.5, color=MUTED)  # fmt: skip
        bars(axes, names)

    label = "part of the residual beyond noise that the candidate alone would explain (%)"
    if nothing:
        label = "gain in log-likelihood, relative to the least that counts (%)"
    least = [Level(100.0, axis="x", width=1.2)] if nothing else []
    caption = (
        "To first order along the measured motion, less the part that the model's own parameters could explain; the "
        "best are then fitted in full, and their likelihoods decide."
    )
    return drawn(
        CaptionedFigure("candidates", "Candidates", caption),
        [[Panel(least, "", label, (0.0, reach), finish=finish)]],
        0.235 * len(rows) + 0.1,
        heading=_screened(found, rows, shares),
        keys=[Span(0.0, 0.0, colour, text, opacity=1.0) for colour, text in kinds.items() if colour in colours],
        left=max(style.LEFT, LETTER * max(map(len, names))),
        right=0.8,
    )


def _screened(found: Discovery, rows: Sequence[Tried], shares: Sequence[float]) -> str:
    """Candidates that would explain something, as a sentence."""
    count, near = len(found.search.tried), [part for part in shares if part > NEAR * shares[0]]
    if found.verdict == "none" and shares[0] > 100.0:
        many = sum(part > 100.0 for part in shares)
        return f"The residual is noise; of {count} candidates, {many} would be worth their parameters to first order"
    if found.verdict == "none":
        return f"None of {count} candidates would explain enough to be worth its parameters"
    if not found.effects:
        return f"None of {count} candidates explains the residual"
    if len(near) == 1:
        first = discovery_text.cause_name(found, *rows[0][:2])
        return f"Of {count} candidates, {first} alone would explain {near[0]:.3g} % of the residual"
    return (
        f"Of {count} candidates, {len(near)} would each explain more than {min(near):.2g} % of the residual; full "
        "fits decide between them as far as the record allows"
    )


def tried(found: Discovery) -> list[Tried]:
    """Each candidate once, the best first: effect, place, part of the gap, part of what would count."""
    best: dict[str, Score] = {}
    for score in found.search.tried:
        label = discovery_text.cause_name(found, *score.candidate.key)
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
        VALIDATION: (gap.validation[0], gap.adjusted, validated, gap.validation_noise_floor),
    }


def _map(found: Discovery, latent: latent_force.LatentForce) -> CaptionedFigure:
    """Latent force over displacement and rate, before and after, with the laws that are reported there."""
    what, instances, unnamed = MISSING[latent.where], laws_at(found, latent), found.law
    law = along(found, latent, instances) if instances else None
    if unnamed is not None:
        law = unnamed.force(latent.x, latent.rate)
    values = [latent.before, *([law] if law is not None else [])]
    by, unit = panels.shown(pretty(latent.units[0]), *values)
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
            times, shown_unit = panels.shown(pretty(x_unit), x)
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
