"""Panel of relative errors: those of several models in each channel, beside the noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from masking.display.palette import PAPER
from masking.model.declaration.quantities import number, percent
from masking.reports import style
from masking.reports.panels import Line, Panel, bars, plain_numbers
from masking.reports.style import COLOURS, GRID, INK, MUTED, SIZE

Errors = Mapping[str, Mapping[str, float]]  # of each channel, by model

NOISE: Final = "noise floor"
_ROOM = 1.6  # of a logarithmic axis beside its first and last point
# How the errors of models are marked: of these, of the first of several others, and of any other.
_MARKS: Final[dict[str, dict[str, Any]]] = {
    "adjusted parameters": {"colour": COLOURS[1], "marker": "o", "size": 7, "order": 3},
    NOISE: {"colour": INK, "marker": "|", "size": 15, "order": 5},
}
_FIRST: Final[dict[str, Any]] = {"colour": PAPER, "marker": "o", "size": 6.5, "edge": MUTED}
_LAST: Final[dict[str, Any]] = {"colour": COLOURS[0], "marker": "o", "size": 7, "order": 4}


def panel(
    errors: Errors,
    ends: tuple[float, float],
    label: str,
    title: str = "",
    *,
    by: float = 100.0,
    has_values: bool = False,
) -> Panel:
    """Panel of errors, whose axis has ends and a label; those that are not positive are left out.

    They are shown times a factor, 100 in percent. With `has_values`, those of the first and of the last model stand at
    the right of the axes.
    """
    is_in_percent = by == 100.0

    def said(error: float) -> str:
        if not math.isfinite(error):
            return "not finite"
        return percent(error) if is_in_percent else number(error, 2)

    models = [name for name in errors if name != NOISE]
    channels = list(errors[models[0]])

    def finish(axes: Axes) -> None:
        bars(axes, [style.symbol(name) for name in channels])
        plain_numbers(axes.xaxis, " %" * is_in_percent)
        axes.xaxis.set_minor_locator(NullLocator())
        for i, name in enumerate(channels if has_values else ()):
            each = [errors[model][name] for model in dict.fromkeys((models[0], models[-1]))]
            axes.annotate(" → ".join(map(said, each)), (1.0, i), (6, 0), ("axes fraction", "data"),
                          textcoords="offset points", va="center", fontsize=SIZE - 1.0, color=INK)  # fmt: skip

    joined = []
    for i, name in enumerate(channels):
        *before, last = (by * errors[model][name] for model in models)
        joined += [Line([max(before), last], [i, i], GRID, 4.0, order=1)] if before else []
    dots = [
        Line([by * part[name] for name in channels], range(len(channels)), width=0.0, key=model,
             **_MARKS.get(model, _FIRST if model != models[-1] and model == models[0] else _LAST))
        for model, part in errors.items()
    ]  # fmt: skip
    first, last = ends
    return Panel([*joined, *dots], "", label, (by * first, by * last), log="x", title=title, finish=finish)


def reach(*sides: Errors) -> tuple[float, float] | None:
    """Ends of an axis on which all errors are; None where none is positive and finite."""
    every = [x for side in sides for part in side.values() for x in part.values() if 0.0 < x < math.inf]
    return (min(every) / _ROOM, max(every) * _ROOM) if every else None
