"""Colours: Okabe and Ito's, distinguishable with any colour vision; what is ideal is a thin dark dashed line."""

from __future__ import annotations

from typing import Final

COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
INK: Final = "#1b1f24"
MUTED: Final = "#5b6470"
GRID: Final = "#dfe3e8"
LIMIT: Final = "#B22222"
