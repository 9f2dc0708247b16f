"""The dictionary of physical effects."""

from __future__ import annotations

from masking.effects.elements import ELEMENTS
from masking.effects.entry import Effect
from masking.effects.instruments import INSTRUMENTS

EFFECTS: dict[str, Effect] = {**ELEMENTS, **INSTRUMENTS}
