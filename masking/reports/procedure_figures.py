"""Figures of measurements: what a procedure saw, what it made of it, and how sure that is.

Each figure has its finding as a sentence on top; bands are 95 % confidence intervals.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import lazy_loader as lazy
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from masking.inference.procedures.actuators import ActuatorRatio
from masking.inference.procedures.frequency_response import Distortion
from masking.inference.procedures.friction import EquilibriumShift, LocatedFriction
from masking.inference.procedures.measured_response import Response
from masking.inference.procedures.measurement import LEVEL, Friction, Measurement
from masking.inference.procedures.springs import SpringCurve
from masking.model.declaration.quantities import percent
from masking.reports import figure_parts as parts
from masking.reports import style
from masking.reports.style import BAND, COLOURS, DASHED, INK, MUTED, SIZE, CaptionedFigure

if TYPE_CHECKING:
    from scipy import stats
else:
    stats = lazy.load("scipy.stats", suppress_warning=True)


UP: Final = COLOURS[0]  # the way up, the measured
DOWN: Final = COLOURS[1]  # the way down
_MOST_OUTPUTS = 4
_NARROW = 30.0  # times: a logarithmic axis that spans less has a number at 1, 2 and 5
_SIGN = {1: "above", -1: "below"}


def figures(measured: Measurement[Any]) -> list[CaptionedFigure]:
    """Draw the figures of a measurement; the first has the procedure's name."""
    drawn: list[CaptionedFigure] = _FIGURES[measured.procedure](measured)
    return drawn


def _springs(measured: Measurement[SpringCurve]) -> list[CaptionedFigure]:
    curve, x, f = measured.found, measured.channels["displacement"], measured.channels["force"]
    grid = np.asarray(measured.series["displacement"])
    (by, x_unit), (times, f_unit) = parts.shown(x.unit, curve.displacement), parts.shown(f.unit, curve.force)
    figure, (above, below) = style.sheet([2.5, 1.9], heading=measured.sentence)
    line = float(curve.stiffness(0.5 * (curve.lowest + curve.highest)))
    rest = curve.force - line * curve.displacement
    small, rest_unit = parts.shown(f.unit, rest)
    force, band = curve.at(grid), curve.band(grid, LEVEL)
    for way, colour in ((1.0, UP), (-1.0, DOWN)):
        chosen = np.where(curve.direction == way, 1.0, np.nan)
        above.plot(by * curve.displacement, times * curve.force * chosen, color=colour, lw=1.3)
        below.plot(by * curve.displacement, small * rest * chosen, color=colour, lw=0.9, alpha=0.85)
    for axes, values, scale in ((above, force, times), (below, force - line * grid, small)):
        axes.fill_between(by * grid, scale * (values - band), scale * (values + band), color=INK, alpha=BAND, lw=0)
        axes.plot(by * grid, scale * values, color=INK, lw=1.2, ls=DASHED)
        axes.set_xlim(by * curve.lowest, by * curve.highest)
    above.set_ylabel(style.with_unit(f"force {style.symbol(f.name)}", f_unit))
    below.set_ylabel(style.with_unit("force less a straight line", rest_unit))
    below.set_xlabel(style.with_unit(f"displacement at {style.symbol(x.name)}", x_unit))
    parts.legend(figure, above, [
        parts.line_key("force rises", UP), parts.line_key("force falls", DOWN),
        parts.line_key(f"spring, order {len(curve.coefficients) - 1}, with 95 %", INK, 1.2, dashed=True),
    ])  # fmt: skip
    caption = (
        "Above: the record and the spring between its ways up and down, which friction and hysteresis hold apart. "
        "Below: the same less a straight line with the stiffness in the middle of the travel; the band holds the "
        "spring with 95 %."
    )
    return [CaptionedFigure("springs", "Spring", caption, figure)]


def _actuators(measured: Measurement[ActuatorRatio]) -> list[CaptionedFigure]:
    found, motion = measured.found, measured.channels["motion"]
    first, second = measured.channels["first"].name, measured.channels["second"].name
    by, unit = parts.shown(motion.unit, np.abs(found.motion))
    order = np.argsort(found.gains)
    gains, fitted = found.gains[order], found.fitted[order]
    slope = np.polyfit(found.gains[found.used], found.fitted[found.used], 1)[0]
    turn = np.conj(slope) / abs(slope)  # the phase in which the motion passes zero
    figure, (above, below) = style.sheet([2.1, 2.1], heading=measured.sentence)
    near = found.used[order]
    low, high = found.interval(LEVEL)
    for axes, seen, made in (
        (above, np.abs(found.motion), np.abs(fitted)),
        (below, (found.motion * turn).real, (fitted * turn).real),
    ):
        axes.axvspan(low, high, color=COLOURS[2], alpha=0.35, lw=0)
        axes.axvline(found.ratio, color=COLOURS[2], lw=1.4)
        axes.plot(found.gains, by * seen, "o", ms=3.2, mew=0, color=UP, alpha=0.35)
        axes.plot(found.gains[found.used], by * seen[found.used], "o", ms=4, mew=0, color=UP)
        axes.plot(gains[near], by * made[near], color=INK, lw=1.2, ls=DASHED)
        axes.set_xlim(gains[0], gains[-1])
    above.set_ylim(bottom=0.0)
    parts.ticks(above)
    below.axhline(0.0, color=MUTED, lw=0.8)
    above.set_ylabel(style.with_unit("amplitude of motion", unit))
    below.set_ylabel(style.with_unit("part in phase", unit))
    below.set_xlabel(f"gain: command of {style.symbol(second)} per command of {style.symbol(first)}")
    left = "right" if found.ratio > 0.5 * (gains[0] + gains[-1]) else "left"
    below.annotate(f"balance at {found.ratio:.4f}, 95 %: {low:.4f} to {high:.4f}", (found.ratio, 0.0),
                   (-8 if left == "right" else 8, 12), textcoords="offset points", ha=left, fontsize=SIZE - 0.5,
                   color=COLOURS[2])  # fmt: skip
    parts.legend(figure, above, [
        parts.marker_key("readings near the balance", UP, "o", 4),
        parts.marker_key("others", UP, "o", 3.2, alpha=0.35),
        parts.line_key("fitted", INK, 1.2, dashed=True),
    ])  # fmt: skip
    caption = (
        "Above: motion at the frequency of the sines against the gain of the second; it is least where the two "
        "actuators balance. Below: its part in the phase in which it passes zero. The ways up and down of the gain "
        "differ by the lag of the motion. Right only where the oscillator was held."
    )
    return [CaptionedFigure("actuators", "Balance of two actuators", caption, figure)]


def _friction(measured: Measurement[Friction]) -> list[CaptionedFigure]:
    shift, place = measured.found.shift, measured.found.place
    count = (shift is not None) + (place is not None)
    figure, rows = style.sheet([2.3] * count, top=0.04, heading=measured.sentence)
    if shift is not None and place is not None:
        for axes, up in ((rows[0], 0.34), (rows[1], 0.0)):  # both have an axis of their own below
            axes.tick_params(labelbottom=True)
            height, box = figure.get_size_inches()[1], axes.get_position()
            axes.set_position((box.x0, box.y0 + up / height, box.width, box.height - (0.34 if up else 0.12) / height))
    if shift is not None:
        _shift(rows[0], shift, measured)
    if place is not None:
        _place(rows[-1], place, measured)
    words = []
    if shift is not None:
        words.append(
            "Shift of the equilibrium after each saw-tooth, and the line through it with its 95 % band: dry friction "
            "shifts it by the same after any travel, hysteresis by more after longer ones."
        )
    if place is not None:
        words.append(
            "Half the gap between the ways up and down over the displacement; friction that sits at a place is a step."
        )
    return [CaptionedFigure("friction", "Friction", " ".join(words), figure)]


def _shift(axes: Axes, shift: EquilibriumShift, measured: Measurement[Friction]) -> None:
    unit = measured.channels["displacement"].unit
    (by, x_unit), (times, y_unit) = parts.shown(unit, shift.travel), parts.shown(unit, shift.shift)
    grid = np.linspace(0.0, 1.05 * shift.travel.max(), 100)
    rows = np.column_stack([np.ones(len(grid)), grid])
    line = rows @ np.array([shift.constant, shift.growth])
    factor = float(stats.t.ppf(0.5 + LEVEL / 2.0, len(shift.travel) - 2))
    half = factor * np.sqrt(np.einsum("ij,jk,ik->i", rows, shift.covariance, rows))
    axes.fill_between(by * grid, times * (line - half), times * (line + half), color=INK, alpha=BAND / 1.5, lw=0)
    axes.plot(by * grid, times * line, color=INK, lw=1.2, ls=DASHED)
    axes.plot(by * shift.travel, times * shift.shift, "o", ms=5, mew=0, color=UP)
    axes.set_xlim(0.0, by * grid[-1])
    highest = min(float((line + half).max()), 2.0 * float(shift.shift.max()))
    axes.set_ylim(max(min(0.0, times * float((line - half).min())), -0.5 * times * highest), 1.05 * times * highest)
    parts.ticks(axes)
    axes.set_xlabel(style.with_unit("travel to either side", x_unit))
    axes.set_ylabel(style.with_unit("shift of equilibrium", y_unit))


def _place(axes: Axes, place: LocatedFriction, measured: Measurement[Friction]) -> None:
    x, f = measured.channels["displacement"], measured.channels["force"]
    (by, x_unit), (times, f_unit) = parts.shown(x.unit, place.displacement), parts.shown(f.unit, place.half_gap)
    axes.plot(by * place.displacement, times * place.half_gap, "o", ms=3.4, mew=0, color=UP)
    axes.plot(by * place.displacement, times * place.fitted, color=INK, lw=1.2, ls=DASHED)
    if place.is_found:
        half = 1.96 * place.deviation
        axes.axvspan(by * (place.edge - half), by * (place.edge + half), color=COLOURS[1], alpha=0.35, lw=0)
        axes.axvline(by * place.edge, color=COLOURS[1], lw=1.4)
        on_left = place.edge > float(place.displacement.mean())
        axes.annotate(
            f"engages {_SIGN[place.side]} {by * place.edge:.3g} ± {by * half:.1g} {x_unit}".rstrip(),
            (by * place.edge, 0.9), (-8 if on_left else 8, 0), ("data", "axes fraction"), "offset points",
            ha="right" if on_left else "left", fontsize=SIZE - 0.5, color=COLOURS[1],
        )  # fmt: skip
    axes.set_ylim(bottom=min(0.0, 1.1 * times * float(place.half_gap.min())))
    parts.ticks(axes)
    axes.set_xlabel(style.with_unit(f"displacement at {style.symbol(x.name)}", x_unit))
    axes.set_ylabel(style.with_unit(f"half the gap in {style.symbol(f.name)}", f_unit))


def _response(measured: Measurement[Response]) -> list[CaptionedFigure]:
    made = measured.found
    outputs = made.outputs[:_MOST_OUTPUTS]
    figure, rows = style.sheet([1.7, 0.95] * len(outputs), heading=measured.sentence)
    for i, (name, colour) in enumerate(zip(made.inputs, COLOURS, strict=False)):
        found = made.responses[name]
        f, radius = found.frequencies, found.radius(LEVEL)[:, :, 0]
        for j in range(len(outputs)):
            size, angle = np.abs(found.response[:, j, 0]), np.unwrap(np.angle(found.response[:, j, 0]))
            above, below = rows[2 * j], rows[2 * j + 1]
            sure = np.clip(radius[:, j] / np.maximum(size, 1e-300), 0.0, 1.0)
            low = np.maximum(size - radius[:, j], 1e-2 * size)
            above.fill_between(f, low, size + radius[:, j], color=colour, alpha=BAND, lw=0)
            above.plot(f, size, color=colour, lw=1.1, marker="o", ms=2.8, mew=0)
            angle -= 2.0 * np.pi * np.round(angle[np.argmin(sure)] / (2.0 * np.pi) + 1e-9)
            turn = np.degrees(np.arcsin(sure))
            below.fill_between(f, np.degrees(angle) - turn, np.degrees(angle) + turn, color=colour, alpha=BAND, lw=0)
            below.plot(f, np.degrees(angle), color=colour, lw=1.1, marker="o", ms=2.4, mew=0)
            if i == 0:
                _response_axes(above, below, measured, outputs[j])
    for axes in rows:
        lines = np.concatenate([made.responses[name].frequencies for name in made.inputs])
        edge = 0.01 * float(np.ptp(lines))
        axes.set_xlim(lines.min() - edge, lines.max() + edge)
    for axes in rows[::2]:
        least, most = axes.get_ylim()
        if most < _NARROW * least:
            parts.plain_numbers(axes.yaxis)
    rows[-1].set_xlabel("frequency (Hz)")
    parts.legend(figure, rows[0], [
        parts.line_key(f"to {style.symbol(name)}", colour)
        for name, colour in zip(made.inputs, COLOURS, strict=False)
    ])  # fmt: skip
    more = parts.first_of(len(outputs), len(made.outputs), "sensors")
    caption = f"Size and phase of the response of each sensor, with the band that holds them with 95 %.{more}"
    found_plates = [CaptionedFigure("response", "Frequency response", caption, figure)]
    if made.distortions:
        found_plates.append(_distortion(measured))
    return found_plates


def _response_axes(above: Axes, below: Axes, measured: Measurement[Response], output: str) -> None:
    units = [measured.channels[f"output {output}"].unit, *{
        c.unit for what, c in measured.channels.items() if what.startswith("input ")
    }]  # fmt: skip
    unit = f"{units[0] or '1'}/{units[1] or '1'}" if len(units) == 2 and any(units) else ""
    parts.logarithmic(above, "y")
    above.set_ylabel(style.with_unit(f"size of {style.symbol(output)}", unit))
    below.set_ylabel("phase (°)")
    below.yaxis.set_major_locator(MaxNLocator(4, steps=[1.8, 4.5, 9]))


def _distortion(measured: Measurement[Response]) -> CaptionedFigure:
    made = measured.found
    outputs = [name for name in made.outputs if name in made.distortions][:_MOST_OUTPUTS]
    shares = {name: made.distortions[name].shares for name in outputs}
    shares_of = [f"{name} {percent(s['even'])} even and {percent(s['odd'])} odd" for name, s in shares.items()]
    sentence = f"Nonlinear distortion, as part of the response: {', '.join(shares_of)}"
    figure, rows = style.sheet([1.9] * len(outputs), heading=sentence)
    for name, axes in zip(outputs, rows, strict=True):
        each, unit = made.distortions[name], measured.channels[f"output {name}"].unit
        by, unit = parts.shown(unit, np.sqrt(each.level))
        size, noise = by * np.sqrt(each.level), by * np.sqrt(each.noise)
        parts.logarithmic(axes, "y", 6)
        axes.plot(each.frequencies, np.maximum(noise, 1e-12 * size.max()), color=MUTED, lw=1.0)
        for lines, marker, colour in _kinds(each):
            axes.vlines(each.frequencies[lines], noise[lines], size[lines], color=colour, lw=0.7, alpha=0.5)
            axes.plot(each.frequencies[lines], size[lines], marker, color=colour, ms=4.2, mew=0)
        axes.set_xlim(0.0, 1.02 * each.frequencies[-1])
        axes.set_ylabel(style.with_unit(f"amplitude of {style.symbol(name)}", unit))
    rows[-1].set_xlabel("frequency (Hz)")
    parts.legend(figure, rows[0], [
        parts.marker_key("excited lines", UP, "o", 4.2),
        parts.marker_key("even lines", DOWN, "^", 4.2),
        parts.marker_key("odd lines left out", COLOURS[2], "s", 4.2),
        parts.line_key("noise", MUTED, 1.0),
    ])  # fmt: skip
    caption = (
        "What the sensor has at each line: where nothing was excited, a linear rig would have noise only. Even lines "
        "show distortion that does not change its sign with the motion, odd lines that which does, such as friction."
    )
    return CaptionedFigure("distortion", "Nonlinear distortion", caption, figure)


def _kinds(found: Distortion) -> tuple[tuple[NDArray[np.int64], str, str], ...]:
    return (
        (np.flatnonzero(found.excited), "o", UP),
        (found.even, "^", DOWN),
        (found.odd, "s", COLOURS[2]),
    )


_FIGURES: Final[dict[str, Any]] = {
    "springs": _springs,
    "actuators": _actuators,
    "friction": _friction,
    "response": _response,
}
