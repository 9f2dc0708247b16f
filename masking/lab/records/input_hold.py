"""How records are given: inputs between samples, as simulations know them too, names of columns, and forms of texts.

Band-limited inputs become a first-order hold that acts alike, see `masking.inference.estimation.identification_data`.

Source: Pintelon and Schoukens, System Identification (2012), section 13.2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

Hold = Literal["zero-order", "first-order"]
InputHold = Literal[Hold, "band-limited"]
Names = Mapping[str, str] | Sequence[str]  # columns of a file by the names that they get, or the names of all


@dataclass(frozen=True)
class TextForm:
    """What cannot be known of a text: the number of lines above its numbers, and its encoding where it is not UTF-8."""

    header_rows: int | None = None
    encoding: str | None = None
