"""Inputs between samples: as simulations know them, and as records are given.

Band-limited inputs become a first-order hold that acts alike, see `masking.estimation.data`.

Source: Pintelon and Schoukens, System Identification (2012), section 13.2.
"""

from __future__ import annotations

from typing import Literal

Hold = Literal["zero-order", "first-order"]
InputHold = Literal[Hold, "band-limited"]
