"""Views of series over the time for other programs and for notebooks: pandas, xarray, a figure, a table in HTML."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from masking.display import fragments, symbols
from masking.display.palette import COLOURS, INK
from masking.display.thinning import thin
from masking.errors import RecordError
from masking.lazy_imports import axes

Columns = Mapping[str, NDArray[np.float64]]
IDEAL: Final = "ideal"
_WIDTH, _ROW, _ENDS = 9.0, 1.5, 0.75  # inches: width of a figure, height of a row, and room above and below


def frame(columns: Columns, units: Mapping[str, str], meanings: Mapping[str, str]) -> Any:  # noqa: ANN401  # a DataFrame
    """Pandas DataFrame of columns over the time, with units and meanings in `attrs`; a RecordError without pandas."""
    pandas = _package("pandas")
    made = pandas.DataFrame({name: values for name, values in columns.items() if name != "t"})
    made.index = pandas.Index(columns["t"], name="t")
    made.attrs.update(units=dict(units), meanings=dict(meanings))
    return made


def dataset(columns: Columns, units: Mapping[str, str], meanings: Mapping[str, str], title: str) -> Any:  # noqa: ANN401  # a Dataset
    """Xarray Dataset over the time; each variable has `units` and `long_name`. A RecordError without xarray."""
    xarray = _package("xarray")

    def variable(name: str) -> tuple[str, NDArray[np.float64], dict[str, str]]:
        attributes = {"units": units.get(name, ""), "long_name": meanings.get(name, "")}
        return "t", columns[name], {key: text for key, text in attributes.items() if text}

    data = {name: variable(name) for name in columns if name != "t"}
    return xarray.Dataset(data, coords={"t": variable("t")}, attrs={"title": title} if title else {})


def _package(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ImportError:
        raise RecordError(f"to_{name} needs the package {name}: pip install 'masking[notebook]'") from None


def figure(
    columns: Columns, units: Mapping[str, str], rows: Sequence[Sequence[str]], title: str
) -> axes.NotebookFigure:
    """Draw columns over the time, those of a row into the same axes, below a title.

    What is ideal lies as a dashed line over what is virtual. Where the units of a row differ, they are in its legend.
    """
    height = _ROW * len(rows) + _ENDS
    made = axes.NotebookFigure(figsize=(_WIDTH, height), dpi=axes.DPI / 2, facecolor="white", layout="constrained")
    for names, each in zip(rows, np.atleast_1d(made.subplots(len(rows), sharex=True)), strict=True):
        axes.dress(each)
        common = {units.get(name, "") for name in names}
        for name, colour in zip(names, COLOURS * len(names), strict=False):
            prefix, _, short = name.rpartition(".")
            unit = "" if len(common) == 1 else units.get(name, "")
            plain = short.rstrip("'")  # a rate keeps its prime
            label = symbols.in_figure(axes.with_unit(f"{symbols.tex(plain)}{short[len(plain) :]}", unit))
            each.plot(*thin(columns["t"], columns[name]), color=colour, lw=1.2, label=label)
            ideal = columns.get(f"{IDEAL}.{short}") if prefix == "virtual" else None
            if ideal is not None:
                each.plot(*thin(columns["t"], ideal), color=INK, lw=0.8, ls=axes.DASHED)
        prefixes = {name.rpartition(".")[0] for name in names}
        words = axes.with_unit(*(found.pop() if len(found) == 1 else "" for found in (prefixes, common)))
        each.set_ylabel(symbols.in_figure(words.strip()))
        each.legend(frameon=False, fontsize=axes.SIZE - 0.5, loc="center left", bbox_to_anchor=(1.0, 0.5))
        each.set_xlim(columns["t"][0], columns["t"][-1])
    each.set_xlabel(symbols.in_figure(axes.with_unit("time", units.get("t", ""))))
    made.suptitle(symbols.in_figure(title), fontsize=axes.SIZE + 1.5, color=INK, x=0.01, ha="left")
    return made


def card(title: str, subtitle: str, columns: Columns, units: Mapping[str, str], meanings: Mapping[str, str]) -> str:
    """HTML with a table of columns: their units, meanings, ranges and shapes, rates left out."""
    rows = [
        (name, units.get(name, ""), meanings.get(name, ""), f"{c.min():.4g}", f"{c.max():.4g}", fragments.line(c))
        for name, c in columns.items()
        if name != "t" and not name.endswith("'")
    ]
    head = ("column", "unit", "meaning", "least", "greatest", "")
    return fragments.card(title, subtitle, fragments.table(head, rows, numbers=(3, 4)))
