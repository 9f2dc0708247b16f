"""The page of the benchmark: one HTML file that needs no other, and its pictures beside it."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from masking.reports import html
from masking.reports.html import Tile
from masking.reports.style import COLOURS, DPI, GRID, INK, LIMIT, MUTED, SIZE, WIDTH, CaptionedFigure, dress
from tests.benchmarks import mujoco_records, table
from tests.benchmarks.discovering import scoring, sindy, summary
from tests.benchmarks.discovering.scoring import said, shortened, wilson
from tests.benchmarks.discovering.summary import Bar, Confusion, Result

PAGE, NUMBERS = "discovery.html", "bars.json"
OURS, THEIRS = "masking discover", "PySINDy"
RIGHT, WRONG, PLACE = COLOURS[0], COLOURS[1], COLOURS[3]
CELL = 0.185  # inches
PARTS: Any = html.environment().get_template("parts.html").make_module({"names": ()})
TEMPLATE = html.environment().from_string(
    """{% extends "base.html" %}
    {% from "parts.html" import section with context %}
    {% block lead %}{{ lead }}{% endblock %}
    {% block main %}
    {% for title, body in sections %}{% call section(title) %}{{ body }}{% endcall %}{% endfor %}
    {% endblock %}"""
)


def write(
    folder: Path, ours: Sequence[Result], theirs: Sequence[Result], expected: int, digests: Mapping[str, str]
) -> Path:
    """Write the page, its pictures and its numbers into a folder; return the page."""
    bars = summary.bars(ours, theirs)
    figures = [shares(bars), matrix(ours, OURS), matrix(theirs, THEIRS)]
    sections = [
        ("What must be reached", PARTS.figure(figures[0]) + _bars(bars, bool(theirs))),
        ("What was taken for what", PARTS.figure(figures[1])),
        (f"The same records with {THEIRS}", _contender(theirs) + PARTS.figure(figures[2])),
        ("Beside the bars", _facts(ours, theirs)),
        ("Records made by MuJoCo", _engine(ours)),
        ("Every wrong answer", _wrong(ours)),
        ("Every gap that is not closed, or has grown", _open(ours)),
        ("How it is scored", _scored()),
        ("Provenance", _provenance(ours, theirs, expected, digests)),
    ]
    text = TEMPLATE.render(
        title="Discovery of hidden effects",
        lead=_lead(ours, bars, expected),
        tiles=_tiles(ours, theirs),
        sections=sections,
    )
    numbers = {"bars": [asdict(bar) for bar in bars], "records": len(ours), "expected": expected}
    path = folder / PAGE
    contents = {path: text, folder / NUMBERS: json.dumps(numbers, indent=2) + "\n"}
    html.write(html.images(figures, folder) | contents)
    return path


def shares(bars: Sequence[Bar]) -> CaptionedFigure:
    """Draw each share with its interval, ours and theirs, and the bar that must be reached."""
    title = "Shares against what must be reached"
    drawn = [bar for bar in bars if bar.share is not None and bar.count]
    if not drawn:
        return CaptionedFigure("shares", title, "No record has been run yet.", None)
    height = 0.34 * len(drawn)
    left, top, bottom = 4.35, 0.45, 0.5
    total = top + height + bottom
    figure = Figure(figsize=(WIDTH, total), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((left / WIDTH, bottom / total, (WIDTH - left - 1.0) / WIDTH, height / total))
    dress(axes)
    for row, bar in enumerate(drawn):
        assert bar.share is not None
        for hits, count, colour, shift, marker in (
            (bar.hits, bar.count, RIGHT, -0.13, "o"),
            (bar.their_hits, bar.their_count, WRONG, 0.17, "D"),
        ):
            if count:
                low, high = (100.0 * x for x in wilson(hits, count))
                axes.plot([low, high], [row + shift] * 2, color=colour, lw=1.6, solid_capstyle="butt", alpha=0.55)
                axes.plot(100.0 * hits / count, row + shift, marker, color=colour, ms=5.0, clip_on=False, zorder=3)
        aim = 100.0 * bar.share
        axes.plot([aim] * 2, [row - 0.38, row + 0.38], color=INK, lw=1.4, ls=(0, (2, 1)), zorder=2)
        missed = bar.verdict == "short"
        axes.text(
            1.02, row, f"{bar.hits} of {bar.count}", transform=axes.get_yaxis_transform(), va="center",
            fontsize=SIZE - 1, color=LIMIT if missed else INK, fontweight="bold" if missed else "normal",
        )  # fmt: skip
    axes.set_yticks(range(len(drawn)), [bar.what for bar in drawn], fontsize=SIZE - 1)
    axes.set_ylim(len(drawn) - 0.4, -0.6)
    axes.set_xlim(-1.0, 101.0)
    axes.set_xticks(range(0, 101, 20))
    axes.set_xlabel("share of records (%)")
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
    handles = [
        axes.plot([], [], "o", color=RIGHT, ms=5.0, label=OURS)[0],
        axes.plot([], [], "D", color=WRONG, ms=5.0, label=THEIRS)[0],
        axes.plot([], [], color=INK, lw=1.4, ls=(0, (2, 1)), label="must be reached, or not exceeded")[0],
    ]
    if not any(bar.their_count for bar in drawn):
        del handles[1]
    figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(0.1 / WIDTH, 1.0),
        ncols=3,
        frameon=False,
        fontsize=SIZE - 0.5,
    )
    caption = (
        "Points are measured shares, lines their 95 % intervals (Wilson), dashed strokes what must be reached. At the "
        "right are the counts of masking discover, red where it falls short."
    )
    return CaptionedFigure("shares", title, caption, figure)


def matrix(results: Sequence[Result], tool: str) -> CaptionedFigure:
    """Draw who was taken for whom."""
    name = "confusion" if tool == OURS else "confusion-pysindy"
    title = f"Hidden effects and what {tool} took them for"
    if not results:
        why = "no record has been run yet" if tool == OURS or sindy.version() else "it could not be installed here"
        return CaptionedFigure(name, title, f"Not drawn: {why}.", None)
    found = summary.confusion(results)
    figure, axes = _grid(found)
    for (row, column), (good, bad) in found.cells.items():
        x, y = found.columns.index(column), found.rows.index(row)
        _cell(axes, (x, y), {RIGHT if column in _meant(found, row) else PLACE: good, WRONG: bad}, found.total(row))
    _labels(axes, found)
    handles = [
        Rectangle((0, 0), 1, 1, facecolor=RIGHT, label="right"),
        Rectangle((0, 0), 1, 1, facecolor=PLACE, label="wrong effect, right place"),
        Rectangle((0, 0), 1, 1, facecolor=WRONG, label="wrong place"),
    ]
    figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(0.04 / WIDTH, 1.0),
        frameon=False, fontsize=SIZE - 1, handlelength=1.0, handleheight=1.0,
    )  # fmt: skip
    caption = (
        "Rows: what was hidden, with the number of records. Columns: the cause on top of the answer. Numbers count "
        "records, darker where they are more of the row. Framed cells are right: the diagonal and, where nothing of "
        "the dictionary was hidden, nothing or unknown. An exact equivalent counts as the effect that was hidden. "
        "Records with two effects are not drawn."
    )
    return CaptionedFigure(name, title, caption, figure)


def _grid(found: Confusion) -> tuple[Figure, Axes]:
    left, bottom, top = 2.0, 0.12, 1.35
    width, height = WIDTH - left - 0.1, CELL * len(found.rows)
    total = top + height + bottom
    figure = Figure(figsize=(WIDTH, total), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((left / WIDTH, bottom / total, width / WIDTH, height / total))
    axes.set_xlim(-0.5, len(found.columns) - 0.5)
    axes.set_ylim(len(found.rows) - 0.5, -0.5)
    return figure, axes


def _cell(axes: Axes, at: tuple[int, int], counts: Mapping[str, int], of: int) -> None:
    x, y = at
    parts = [(count, colour) for colour, count in counts.items() if count]
    for i, (count, colour) in enumerate(parts):
        width, share = 1.0 / len(parts), count / of
        start = x - 0.5 + i * width
        axes.add_patch(Rectangle((start, y - 0.5), width, 1.0, facecolor=colour, alpha=0.25 + 0.75 * share, lw=0))
        axes.text(
            start + width / 2.0, y + 0.04, str(count), ha="center", va="center", fontsize=SIZE - 3,
            color="white" if share > 0.45 else INK,
        )  # fmt: skip


def _labels(axes: Axes, found: Confusion) -> None:
    rows = [f"{_words(row)}  {found.total(row)}" for row in found.rows]
    axes.set_yticks(range(len(rows)), rows, fontsize=SIZE - 2.5)
    axes.set_xticks(range(len(found.columns)), map(_words, found.columns), fontsize=SIZE - 2.5, rotation=90)
    axes.xaxis.tick_top()
    axes.tick_params(length=0, pad=2)
    axes.set_xticks(np.arange(len(found.columns) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(rows) + 1) - 0.5, minor=True)
    axes.grid(visible=True, which="minor", color=GRID, lw=0.5)
    axes.tick_params(which="minor", length=0)
    axes.set_axisbelow(True)
    for side in axes.spines.values():
        side.set_visible(False)
    for y, row in enumerate(found.rows):
        for column in _meant(found, row) & set(found.columns):
            x = found.columns.index(column)
            axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1.0, 1.0, fill=False, ec=MUTED, lw=0.8, zorder=3))


def _meant(found: Confusion, row: str) -> set[str]:
    """Return the columns in which a row is right."""
    if row in ("none", summary.EMPTY):
        return {"none"} if row == "none" else {"none", "unknown"}
    if row == "bilinear_spring":  # a stop at edge 0
        return {"unknown", "stop"}
    return {row} if row in found.columns else {"unknown"}


def _words(name: str) -> str:
    return {"none": "nothing", "parameter": "a parameter"}.get(name, name.replace("_", " "))


def _lead(ours: Sequence[Result], bars: Sequence[Bar], expected: int) -> Markup:
    reached = sum(bar.verdict == "reached" for bar in bars)
    measured = sum(bar.verdict != "not measured" for bar in bars)
    wrong = sum(not r.score.right for r in ours)
    text = (
        f"{len(ours)} records of a rig with a hidden effect, a wrong parameter, dirt or nothing at all, made by a "
        f"generator that shares no code with what is judged: {reached} of {measured} measured bars are reached, "
        f"{wrong} answers are wrong."
    )
    parts = [PARTS.paragraph(text, "lead")]
    if len(ours) < expected:
        parts.append(PARTS.paragraph(f"{expected - len(ours)} of {expected} records have not been run yet.", "card"))
    failed = [r for r in ours if r.error]
    if failed:
        parts.append(PARTS.paragraph(f"{len(failed)} records ended in an error.", "card wrong"))
    return Markup("").join(parts)


def _tiles(ours: Sequence[Result], theirs: Sequence[Result]) -> list[Tile]:
    tiles = []
    for label, results in ((OURS, ours), (THEIRS, theirs)):
        few = [r for r in results if r.case.family == "effect"]
        if few:
            hits = sum(r.score.right for r in few)
            tiles.append(Tile(f"{label}: hidden effects right", summary.percent(hits / len(few))))
    wrong = sum(r.score.confidently_wrong for r in ours)
    if ours:
        tiles.append(Tile("confident and wrong", str(wrong), f"of {len(ours)}", wrong > 0))
        tiles.append(Tile("a record takes", f"{np.median([r.seconds for r in ours]):.3g}", "s, median"))
    return tiles


def _bars(bars: Sequence[Bar], beside: bool) -> Markup:
    head = ("bar", "aim", "measured", "records", "95 % interval", "verdict", *([THEIRS] if beside else []))
    rows = [
        (
            bar.what,
            bar.aim,
            bar.measured,
            f"{bar.hits} of {bar.count}" if bar.share is not None and bar.count else str(bar.count or ""),
            bar.interval,
            bar.verdict,
            *([bar.theirs] if beside else []),
        )
        for bar in bars
    ]
    return PARTS.table(head, rows, numbers=(2,))


def _contender(theirs: Sequence[Result]) -> Markup:
    if not theirs:
        why = "was not run on these records" if sindy.version() else "could not be installed here"
        return PARTS.paragraph(f"{THEIRS} {why}: its columns are left out.", "card")
    text = (
        f"{THEIRS} {sindy.version()} is given the declared rig and looks, in the force that each element lacks, for "
        "sparse terms among cubic polynomials of displacements and rates, v|v|, a smooth sign of each rate and powers "
        "of the commands. Accelerations are those of filtered positions, both sides of the regression pass the same "
        "filter; its cut-off and the threshold are chosen on the last 30 % of the record. The linear terms of the rig "
        "are free and count as added only where they change by more than 3 %. The score is the same: kind and place "
        "of the most significant term, of the two most significant where two effects are hidden."
    )
    return PARTS.paragraph(text, "missing")


def _facts(ours: Sequence[Result], theirs: Sequence[Result]) -> Markup:
    rows = summary.facts(ours, theirs)
    return PARTS.table(("what", OURS, THEIRS), rows, numbers=(1, 2))


def _truth(result: Result) -> str:
    case = result.case
    if case.effect == "parameter":
        return f"{case.at} {100.0 * case.parameters['relative']:+.3g} %"
    return " + ".join(said((one.effect, one.at)) for one in case.hidden) or "nothing"


def _unit(result: Result) -> str:
    return " of the rms" if result.case.family == "mujoco" else " V"


def _engine(ours: Sequence[Result]) -> Markup:
    made = [r for r in ours if r.case.family == "mujoco"]
    if not made:
        why = "No record has been run yet" if mujoco_records.version() else "MuJoCo is not installed here"
        return PARTS.paragraph(f"{why}.", "missing")
    text = (
        "These records are made by an engine that nobody here wrote, with what is hidden in its own terms "
        "(tests/benchmarks/mujoco_records.py tells which, and how near its laws are to those of the dictionary). Noise "
        "is told in parts of the rms of each reading; the error is the largest of the effect's parameters."
    )
    head = ("hidden", "answer", "right", "error of parameters", "gap/noise", "s")
    rows = []
    for r in made:
        errors = [p.error for p in scoring.parameters(r.case, r.answer) if p.error is not None]
        rows.append(
            (
                _truth(r),
                shortened(str(r.answer)),
                r.score.how if r.score.right else f"no: {r.score.how}",
                summary.percent(max(errors)) if errors else "",
                "" if r.left is None else f"{r.left:.3f}",
                f"{r.seconds:.0f}",
            )
        )
    return PARTS.paragraph(text, "missing") + PARTS.table(head, rows, numbers=(3, 4, 5))


def _wrong(ours: Sequence[Result]) -> Markup:
    wrong = [r for r in ours if not r.score.right]
    if not wrong:
        return PARTS.paragraph("None." if ours else "No record has been run yet.", "missing")
    head = ("record", "strength", "truth", "meaning", "why it is wrong", "gap/noise")
    rows = [
        (
            f"{r.case.family}, {r.case.damping}, {r.case.noise:g}{_unit(r)}, seed {r.case.seed}",
            r.case.strength or "",
            _truth(r),
            shortened(str(r.answer)),
            r.score.how + (" (confident)" if r.score.confident else ""),
            "" if r.left is None else f"{r.left:.3f}",
        )
        for r in sorted(wrong, key=lambda r: r.case.name)
    ]
    text = "Under meaning is what was answered. Confident answers are those without reserve: named and parameter."
    errors = Markup("").join(PARTS.details(f"{r.case.name}: error", r.error) for r in wrong if r.error)
    return PARTS.paragraph(text, "missing") + PARTS.table(head, rows, numbers=(5,)) + errors


def _open(ours: Sequence[Result]) -> Markup:
    named = [
        r
        for r in ours
        if r.grown
        or (
            r.case.family in ("effect", "two")
            and r.answer.verdict in summary.NAMING
            and (r.left or 0.0) > summary.CLOSED
        )
    ]
    if not named:
        return PARTS.paragraph("None.", "missing")
    rows = [
        (r.case.name, shortened(str(r.answer), 60), "" if r.left is None else f"{r.left:.3f}", "yes" if r.grown else "")
        for r in sorted(named, key=lambda r: -(r.left or 0.0))
    ]
    return PARTS.table(("record", "meaning", "gap/noise", "larger than before"), rows, numbers=(2,))


def _scored() -> Markup:
    texts = (
        "Right is the effect and the place that were hidden, alone and on top, or what gives exactly the same readings "
        "on this rig (tests/benchmarks/hidden/cases.py lists these and shows why). A gain of an actuator is never the "
        "same as a gain parameter of the rig, since it changes the reaction on the beam as well.",
        "Where an answer is ambiguous, the proposed experiment must tell the truth from a rival, and near kin on top "
        f"count only with the truth among the rivals that have at least {summary.percent(scoring.PLAUSIBLE)}.",
        "Outside the dictionary only unknown is right, with or without a nearest kin, and an exact equivalent where "
        "there is one. A dirty record without a main effect may not be given a name without reserve, not even that of "
        "an imperfection that is there.",
        "Gaps are relative errors of the validation, in units of the noise that discovery itself estimates; the worst "
        "sensor counts. A gap is larger than before where it is so over all sensors together.",
    )
    return Markup("").join(PARTS.paragraph(text, "missing") for text in texts)


def _provenance(ours: Sequence[Result], theirs: Sequence[Result], expected: int, digests: Mapping[str, str]) -> Markup:
    versions = table.versions()
    return PARTS.provenance(
        [
            ("written", f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"),
            ("records", f"{len(ours)} of {expected}; {len(theirs)} with {THEIRS}"),
            ("sources", ", ".join(f"{tool} {digest}" for tool, digest in digests.items())),
            ("versions", ", ".join(f"{name} {versions[name]}" for name in ("masking", "numba", "numpy", "scipy"))),
            (THEIRS, sindy.version() or "could not be installed here"),
            ("processor", table.processor()),
            ("python", platform.python_version()),
            ("made by", "make bench-discovery"),
        ]
    )
