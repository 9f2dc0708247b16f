"""Colours of figures, pages and notebooks. No other file has any.

Series have those of Okabe and Ito, distinguishable with any colour vision; the ideal is a thin dark dashed line.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
INK: Final = "#1b1f24"
MUTED: Final = "#5b6470"
GRID: Final = "#dfe3e8"
NOISE: Final = "#c9ced6"  # of a band of noise
UNKNOWN: Final = "#d9d9d9"  # of a word that says nothing
LIMIT: Final = "#b22222"
PAPER: Final = "#ffffff"
RULE: Final = "rgba(128,128,128,.3)"  # between the rows of a table, on a background of any colour

# Variables of every page, by their names in CSS.
LIGHT: Final[Mapping[str, str]] = {
    "paper": PAPER, "ink": INK, "muted": MUTED, "rule": GRID, "tint": "#f5f7f9", "accent": COLOURS[0],
    "wrong": LIMIT, "wrong-tint": "#fdf0ef", "care": "#b87700", "care-tint": "#fdf6e7",
    "well": "#00795a", "well-tint": "#eaf6f2", "shade": "rgb(0 0 0 / .16)",
    "stop": LIMIT, "stop-hover": "#8f1a1a", "stop-ink": PAPER,
}  # fmt: skip
DARK: Final[Mapping[str, str]] = {
    "paper": "#191919", "ink": "#e6e6e6", "muted": "#a2a9b2", "rule": "#3a3d42", "tint": "#222427",
    "accent": COLOURS[4], "wrong": "#ff7b72", "wrong-tint": "#351b1b", "care": "#e0a83a", "care-tint": "#322811",
    "well": "#45c49c", "well-tint": "#16302a", "shade": "rgb(0 0 0 / .7)",
}  # fmt: skip
