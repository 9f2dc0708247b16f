"""How records are given: inputs between samples, as simulations know them too, and names of columns.

Band-limited inputs become a first-order hold that acts alike, see `masking.inference.estimation.identification_data`.

Source: Pintelon and Schoukens, System Identification (2012), section 13.2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

Hold = Literal["zero-order", "first-order"]
InputHold = Literal[Hold, "band-limited"]
Names = Mapping[str, str] | Sequence[str]  # columns of a file by the names that they get, or the names of all
