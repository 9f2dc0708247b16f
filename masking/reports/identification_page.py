"""Pages of measurements, fits and simulations: HTML that needs no other file, figures, and numbers as JSON.

Each figure of a measurement has its finding as a sentence on top; bands are 95 % confidence intervals.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from scipy import special

from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.errors import IntegrationError
from masking.inference.estimation.extended_kalman import KalmanFit
from masking.inference.estimation.fit import Fit
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.simulation import Simulated, noise_alone, relative, simulate
from masking.inference.procedures.actuator_ratio import ActuatorRatio
from masking.inference.procedures.friction import EquilibriumShift, LocatedFriction
from masking.inference.procedures.measured_response import Response
from masking.inference.procedures.measurement import LEVEL, Friction, Measurement, Row
from masking.inference.procedures.springs import SpringCurve
from masking.model.declaration.quantities import number, percent, with_deviation
from masking.model.declaration.units import pretty
from masking.reports import html, one_page, panels, style
from masking.reports.html import Tile
from masking.reports.one_page import Sheet
from masking.reports.panels import Band, Level, Line, Panel, Part, Span, drawn, plain_numbers
from masking.reports.style import BAND, COLOURS, INK, MUTED, SIZE, CaptionedFigure
from masking.reports.text import capital, listed, plural

UP: Final = COLOURS[0]  # the way up, the measured
DOWN: Final = COLOURS[1]  # the way down
_MOST_OUTPUTS = 4
_NARROW = 30.0  # times: a logarithmic axis that spans less has a number at 1, 2 and 5
_SIGN = {1: "above", -1: "below"}
MOST_TILES, FIT_PAGE = 3, "fit.html"


def _springs(measured: Measurement[SpringCurve]) -> list[CaptionedFigure]:
    curve, x, f = measured.found, measured.channels["displacement"], measured.channels["force"]
    grid = np.asarray(measured.series["displacement"])
    line = float(curve.stiffness(0.5 * (curve.lowest + curve.highest)))
    by, x_unit = panels.shown(x.unit, curve.displacement)
    rows = []
    for slope, label, width in ((0.0, f"force {style.symbol(f.name)}", 1.3), (line, "force less a straight line", 0.9)):
        force, fitted, half = curve.force - slope * curve.displacement, curve.at(grid), curve.band(grid, LEVEL)
        times, unit = panels.shown(f.unit, force)
        ways = ((1.0, UP, "force rises"), (-1.0, DOWN, "force falls"))
        spring = times * (fitted - slope * grid)
        shown = [
            *(Line(by * curve.displacement, times * force * np.where(curve.direction == way, 1.0, np.nan), colour,
                   width, key) for way, colour, key in ways),
            Band(by * grid, spring - times * half, spring + times * half, INK),
            Line(by * grid, spring, INK, 1.2, f"spring, order {len(curve.coefficients) - 1}, with 95 %", True),
        ]  # fmt: skip
        across = style.with_unit(f"displacement at {style.symbol(x.name)}", x_unit)
        rows.append([Panel(shown, style.with_unit(label, unit), across, (by * curve.lowest, by * curve.highest))])
    caption = (
        "Above: the record and the spring between its ways up and down, which friction and hysteresis hold apart. "
        "Below: the same less a straight line with the stiffness in the middle of the travel; the band holds the "
        "spring with 95 %."
    )
    return [drawn(CaptionedFigure("springs", "Spring", caption), rows, (2.5, 1.9), heading=measured.sentence)]


def _actuators(measured: Measurement[ActuatorRatio]) -> list[CaptionedFigure]:
    found, motion = measured.found, measured.channels["motion"]
    first, second = measured.channels["first"].name, measured.channels["second"].name
    by, unit = panels.shown(motion.unit, np.abs(found.motion))
    order = np.argsort(found.gains)
    gains, fitted, near = found.gains[order], found.fitted[order], found.used[order]
    slope = np.polyfit(found.gains[found.used], found.fitted[found.used], 1)[0]
    turn = np.conj(slope) / abs(slope)  # the phase in which the motion passes zero
    low, high = found.interval(LEVEL)
    is_right = found.ratio > 0.5 * (gains[0] + gains[-1])

    def balance(axes: Axes) -> None:
        axes.annotate(f"balance at {found.ratio:.4f}, 95 %: {low:.4f} to {high:.4f}", (found.ratio, 0.0),
                      (-8 if is_right else 8, 12), textcoords="offset points", ha="right" if is_right else "left",
                      fontsize=SIZE - 0.5, color=COLOURS[2])  # fmt: skip

    def panel(seen: Array, made: Array, label: str, **more: Any) -> Panel:  # noqa: ANN401  # fields of a panel
        shown = [
            Span(low, high, COLOURS[2], opacity=0.35),
            Level(found.ratio, COLOURS[2], 1.4, axis="x", is_dashed=False),
            Line(found.gains[found.used], by * seen[found.used], UP, 0.0, "readings near the balance", marker="o"),
            Line(found.gains, by * seen, UP, 0.0, "others", marker="o", size=3.2, opacity=0.35),
            Line(gains[near], by * made[near], INK, 1.2, "fitted", is_dashed=True),
        ]
        across = f"gain: command of {style.symbol(second)} per command of {style.symbol(first)}"
        return Panel(shown, style.with_unit(label, unit), across, (gains[0], gains[-1]), **more)

    amplitude = panel(np.abs(found.motion), np.abs(fitted), "amplitude of motion", ticks=5,
                      ylim=(0.0, 1.05 * by * float(np.abs(found.motion).max())))  # fmt: skip
    in_phase = panel((found.motion * turn).real, (fitted * turn).real, "part in phase", finish=balance)
    zero = Level(0.0, MUTED, 0.8, is_dashed=False)
    caption = (
        "Above: motion at the frequency of the sines against the gain of the second; it is least where the two "
        "actuators balance. Below: its part in the phase in which it passes zero. The ways up and down of the gain "
        "differ by the lag of the motion. Right only where the oscillator was held."
    )
    rows = [[amplitude], [replace(in_phase, parts=[*in_phase.parts, zero])]]
    words = CaptionedFigure("actuators", "Balance of two actuators", caption)
    return [drawn(words, rows, 2.1, heading=measured.sentence)]


def _friction(measured: Measurement[Friction]) -> list[CaptionedFigure]:
    shift, place = measured.found.shift, measured.found.place
    rows, captions = [], []
    if shift is not None:
        rows.append([_shift(shift, measured)])
        captions.append(
            "Shift of the equilibrium after each saw-tooth, and the line through it with its 95 % band: dry friction "
            "shifts it by the same after any travel, hysteresis by more after longer ones."
        )
    if place is not None:
        rows.append([_place(place, measured)])
        captions.append(
            "Half the gap between the ways up and down over the displacement; friction that sits at a place is a step."
        )
    words = CaptionedFigure("friction", "Friction", " ".join(captions))
    return [drawn(words, rows, 2.1, heading=measured.sentence)]


def _shift(shift: EquilibriumShift, measured: Measurement[Friction]) -> Panel:
    unit = measured.channels["displacement"].unit
    (by, x_unit), (times, y_unit) = panels.shown(unit, shift.travel), panels.shown(unit, shift.shift)
    grid = np.linspace(0.0, 1.05 * shift.travel.max(), 100)
    rows = np.column_stack([np.ones(len(grid)), grid])
    line = rows @ np.array([shift.constant, shift.growth])
    factor = float(special.stdtrit(len(shift.travel) - 2, 0.5 + LEVEL / 2.0))
    half = factor * np.sqrt(np.einsum("ij,jk,ik->i", rows, shift.covariance, rows))
    highest = min(float((line + half).max()), 2.0 * float(shift.shift.max()))
    lowest = max(min(0.0, float((line - half).min())), -0.5 * highest)
    shown = [
        Band(by * grid, times * (line - half), times * (line + half), INK, BAND / 1.5),
        Line(by * grid, times * line, INK, 1.2, is_dashed=True),
        Line(by * shift.travel, times * shift.shift, UP, 0.0, marker="o", size=5),
    ]
    label, across = style.with_unit("shift of equilibrium", y_unit), style.with_unit("travel to either side", x_unit)
    ends, reach = (0.0, by * grid[-1]), (times * lowest, 1.05 * times * highest)
    return Panel(shown, label, across, ends, reach, ticks=5)


def _place(place: LocatedFriction, measured: Measurement[Friction]) -> Panel:
    x, f = measured.channels["displacement"], measured.channels["force"]
    (by, x_unit), (times, f_unit) = panels.shown(x.unit, place.displacement), panels.shown(f.unit, place.half_gap)
    half = 1.96 * place.deviation

    def edge(axes: Axes) -> None:
        axes.set_ylim(bottom=min(0.0, 1.1 * times * float(place.half_gap.min())))
        if not place.is_found:
            return
        on_left = place.edge > float(place.displacement.mean())
        axes.annotate(
            f"engages {_SIGN[place.side]} {by * place.edge:.3g} ± {by * half:.1g} {x_unit}".rstrip(),
            (by * place.edge, 0.9), (-8 if on_left else 8, 0), ("data", "axes fraction"), "offset points",
            ha="right" if on_left else "left", fontsize=SIZE - 0.5, color=COLOURS[1],
        )  # fmt: skip

    shown: list[Part] = [
        Line(by * place.displacement, times * place.half_gap, UP, 0.0, marker="o", size=3.4),
        Line(by * place.displacement, times * place.fitted, INK, 1.2, is_dashed=True),
    ]
    if place.is_found:
        shown += [
            Span(by * (place.edge - half), by * (place.edge + half), COLOURS[1], opacity=0.35),
            Level(by * place.edge, COLOURS[1], 1.4, axis="x", is_dashed=False),
        ]
    label = style.with_unit(f"half the gap in {style.symbol(f.name)}", f_unit)
    across = style.with_unit(f"displacement at {style.symbol(x.name)}", x_unit)
    return Panel(shown, label, across, ticks=5, finish=edge)


def _response(measured: Measurement[Response]) -> list[CaptionedFigure]:
    made = measured.found
    outputs = made.outputs[:_MOST_OUTPUTS]
    lines = np.concatenate([made.responses[name].frequencies for name in made.inputs])
    edge = 0.01 * float(np.ptp(lines))
    across: dict[str, Any] = {"x": "frequency (Hz)", "xlim": (lines.min() - edge, lines.max() + edge)}
    inputs = {channel.unit for what, channel in measured.channels.items() if what.startswith("input ")}
    rows = []
    for j, output in enumerate(outputs):
        sizes, phases = list[Part](), list[Part]()
        for name, colour in zip(made.inputs, COLOURS, strict=False):
            f, radius = made.responses[name].frequencies, made.responses[name].radius(LEVEL)[:, j, 0]
            response = made.responses[name].response[:, j, 0]
            size, angle = np.abs(response), np.unwrap(np.angle(response))
            sure = np.clip(radius / np.maximum(size, 1e-300), 0.0, 1.0)
            angle -= 2.0 * np.pi * np.round(angle[np.argmin(sure)] / (2.0 * np.pi) + 1e-9)
            degrees, turn = np.degrees(angle), np.degrees(np.arcsin(sure))
            sizes += [
                Band(f, np.maximum(size - radius, 1e-2 * size), size + radius, colour),
                Line(f, size, colour, 1.1, f"to {style.symbol(name)}", marker="o", size=2.8),
            ]
            phases += [
                Band(f, degrees - turn, degrees + turn, colour),
                Line(f, degrees, colour, 1.1, marker="o", size=2.4),
            ]
        units = (measured.channels[f"output {output}"].unit, *inputs)
        ratio = "/".join(unit or "1" for unit in units) if len(units) == 2 and any(units) else ""
        label = style.with_unit(f"size of {style.symbol(output)}", ratio)
        rows += [[Panel(sizes, label, log="y", finish=_numbered, **across)]]
        rows += [[Panel(phases, "phase (°)", ticks=4, finish=_degrees, **across)]]
    more = panels.first_of(len(outputs), len(made.outputs), "sensors")
    caption = f"Size and phase of the response of each sensor, with the band that holds them with 95 %.{more}"
    words = CaptionedFigure("response", "Frequency response", caption)
    response_figure = drawn(words, rows, [1.7, 0.95] * len(outputs), heading=measured.sentence)
    return [response_figure, _distortion(measured)] if made.distortions else [response_figure]


def _numbered(axes: Axes) -> None:
    """Give a logarithmic axis of y that spans little more numbers."""
    least, most = axes.get_ylim()
    if most < _NARROW * least:
        plain_numbers(axes.yaxis)


def _degrees(axes: Axes) -> None:
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1.8, 4.5, 9]))


def _distortion(measured: Measurement[Response]) -> CaptionedFigure:
    made = measured.found
    outputs = [name for name in made.outputs if name in made.distortions][:_MOST_OUTPUTS]
    shares = {name: made.distortions[name].shares for name in outputs}
    shares_of = [f"{name} {percent(s['even'])} even and {percent(s['odd'])} odd" for name, s in shares.items()]
    rows = []
    for name in outputs:
        each = made.distortions[name]
        by, unit = panels.shown(measured.channels[f"output {name}"].unit, np.sqrt(each.level))
        f, size, noise = each.frequencies, by * np.sqrt(each.level), by * np.sqrt(each.noise)
        kinds = (
            (np.flatnonzero(each.excited), "o", UP, "excited lines"),
            (each.even, "^", DOWN, "even lines"),
            (each.odd, "s", COLOURS[2], "odd lines left out"),
        )
        shown = [Line(f[at], size[at], colour, 0.0, key, marker=marker, size=4.2) for at, marker, colour, key in kinds]
        # Stems from the noise to each line: pieces of one line, with gaps between them.
        stems = [
            Line(np.repeat(f[at], 3), np.column_stack([noise[at], size[at], np.full(len(at), np.nan)]).ravel(), colour,
                 0.7, opacity=0.5, bins=0) for at, _, colour, _ in kinds
        ]  # fmt: skip
        floor = Line(f, np.maximum(noise, 1e-12 * size.max()), MUTED, 1.0, "noise")
        label = style.with_unit(f"amplitude of {style.symbol(name)}", unit)
        rows.append([Panel([*stems, *shown, floor], label, "frequency (Hz)", (0.0, 1.02 * f[-1]), log="y")])
    caption = (
        "What the sensor has at each line: where nothing was excited, a linear rig would have noise only. Even lines "
        "show distortion that does not change its sign with the motion, odd lines that which does, such as friction."
    )
    words = CaptionedFigure("distortion", "Nonlinear distortion", caption)
    sentence = f"Nonlinear distortion, as part of the response: {', '.join(shares_of)}"
    return drawn(words, rows, 1.9, heading=sentence)


# Title of a page, its figures, and beginnings of the names of numbers on top; the first number of each is shown.
_PAGES: Final[dict[str, tuple[str, Callable[[Any], list[CaptionedFigure]], tuple[str, ...]]]] = {
    "springs": ("Spring curve", _springs, ("stiffness", "half_gap", "width")),
    "actuators": ("Balance of two actuators", _actuators, ("ratio", "residual")),
    "friction": ("Friction", _friction, ("edge", "step", "largest_shift", "friction")),
    "response": ("Frequency response", _response, ("peak_", "even_", "odd_")),
}


def save(measured: Measurement[Any], folder: str | Path) -> None:
    """Write page, numbers and PNG files, named after the procedure; a `RecordError` where they cannot be."""
    name = measured.procedure
    title, figures, keys = _PAGES[name]
    first = [next((row for row in measured.rows if row.key.startswith(key)), None) for key in keys]
    channels = [(what, channel.label) for what, channel in measured.channels.items()]
    html.save(
        Path(folder, f"{name}.html"),
        "procedure",
        figures(measured),
        measured.as_dict(),
        title=title,
        result=measured,
        tiles=[_tile(row) for row in first if row is not None],
        remarks=measured.notes,
        origin_title="Records and columns",
        origin=[("records", ", ".join(measured.records)), *channels],
    )


def save_fit(found: Fit | KalmanFit, figures: Sequence[CaptionedFigure], sentence: str, folder: str | Path) -> None:
    """Write `fit.html` with the finding, and a fit's figures into a folder that has `fit.json`; errors as of `save`."""
    content = found.as_dict()
    chi = content["chi"]
    html.save(
        Path(folder, FIT_PAGE),
        "fit",
        figures,
        names=found.names,
        title="Fit",
        tiles=_fitted(found) or _errors(chi["train"]),
        sentence=sentence,
        parameters=content["parameters"],
        errors={"error chi": chi["train"], "validation error": chi["validation"], "noise floor": content["floor"]},
        remarks=found.remarks,
    )


def save_simulation(made: Simulated, figures: Sequence[CaptionedFigure], sentence: str, folder: str | Path) -> None:
    """Write `simulation.html` with the finding, `simulation.json` and figures into a folder; errors as of `save`."""
    html.save(
        Path(folder, "simulation.html"),
        "fit",
        figures,
        {"record": made.record.name, "chi": made.chi, "floor": made.floor, "notes": made.record.notes},
        names=made.sensors,
        title="Simulation",
        tiles=_errors(made.chi),
        sentence=sentence,
        parameters={},
        errors={"error chi": made.chi, "noise floor": made.floor},
        remarks=made.record.notes,
    )


def _tile(row: Row) -> Tile:
    """Number with its unit and deviation; small lengths, voltages and forces with a prefix."""
    by, unit = panels.shown(row.unit, [row.value])
    if not row.unit and row.key.startswith(("even_", "odd_")):
        by, unit = 100.0, "%"
    deviation = "" if row.std is None else f" ± {number(by * row.std, 2)}"
    return Tile(row.label, number(by * row.value, 4), unit + deviation)


def sheet(
    found: Fit | KalmanFit, declared: Twin, train: Sequence[Data], unseen: Sequence[Data], sentence: str
) -> Sheet:
    """What one page says of a fit: also the errors of the plant as declared, by a simulation of the unseen records.

    Where there are none of these, the errors are those in the fitted ones.
    """
    records, which = (unseen, "validation") if unseen else (train, "fitted")
    errors = {
        "as declared": _errors_of(declared, records, found.names),
        "fitted": found.validation or found.chi,
        panels.NOISE: noise_alone(declared.sensors, records),
    }
    pairs = zip(found.names, found.values, found.std, strict=True)
    values = [
        f"{n} = {with_deviation(x, 0.0 if found.doubt else s, pretty(found.unit(n) or '1'))}" for n, x, s in pairs
    ]
    sections = {
        one_page.FOUND: [f"{sentence}."],
        "Parameters": [", ".join(values)] if len(values) > MOST_TILES else [],
        one_page.NOTES: [f"{capital(text)}." for text in found.remarks],
    }
    used = {"fitted": train, "validation": unseen}
    return Sheet(
        title=f"Fit of {declared.declaration.name}",
        subject=[f"{what}: {listed([one.name for one in each])}" for what, each in used.items() if each],
        tiles=_fitted(found) or _errors(found.chi),
        sections={heading: said for heading, said in sections.items() if said},
        errors=one_page.finite(errors),
        errors_title=f"Simulation error, {which} {plural(len(records), 'record', 'records')}",
        page=FIT_PAGE,
    )


def _errors_of(twin: Twin, records: Sequence[Data], shared: Sequence[str]) -> dict[str, float]:
    """Relative error of each sensor over records, by name; infinite where the simulated motion is not finite."""
    try:
        residuals = [simulate(twin, record.under(twin), shared).residual for record in records]
    except IntegrationError:
        return dict.fromkeys(twin.sensors, math.inf)
    return relative(twin.sensors, records, np.sum([(one**2).sum(axis=0) for one in residuals], axis=0))


def _fitted(found: Fit | KalmanFit) -> list[Tile]:
    """First parameters, with their deviations and units."""
    made = []
    for name, one in list(found.parameters().items())[:MOST_TILES]:
        deviation = "" if one["std"] is None else f"± {number(one['std'], 2)}"
        made.append(Tile(name, number(one["value"], 7), f"{deviation} {pretty(one.get('unit', '1'))}".strip()))
    return made


def _errors(chi: Mapping[str, float]) -> list[Tile]:
    """Errors of the first sensors."""
    return [Tile(f"error of {name}", percent(part)) for name, part in list(chi.items())[:MOST_TILES]]
