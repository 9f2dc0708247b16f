"""Form of a record: inputs between samples, as simulations know them too, names of columns, and forms of texts.

Band-limited inputs become a first-order hold that acts alike, see `masking.inference.estimation.identification_data`.

Source: Pintelon and Schoukens, System Identification (2012), section 13.2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

Hold = Literal["zero-order", "first-order"]
InputHold = Literal[Hold, "band-limited"]
Names = Mapping[str, str] | Sequence[str]  # columns of a file by the names that they get, or the names of all


@dataclass(frozen=True)
class TextForm:
    """What cannot be known of a text: the number of lines above its numbers, and its encoding where it is not UTF-8."""

    header_rows: int | None = None
    encoding: str | None = None


@dataclass(frozen=True, kw_only=True)
class RecordForm:
    """How the records of a verb are given, beside their files.

    Args:
        hold: inputs between samples: 'zero-order' for commands, which act after the delay of the plant; 'first-order'
            for measured inputs; 'band-limited' for inputs measured behind an anti-alias filter. By default
            'first-order' for inputs that elements of the model follow, and 'zero-order' for all others.
        columns: columns of the files by the names that they get, such as `{"t": "time", "V1": "u"}`; of a text without
            names, those of all its columns, in order.
        dt: time between samples in s, for a table without a clock.
        header_rows: lines of a text above its numbers, the last of which names the columns; by default they are found.
        encoding: of a text that is not in UTF-8, such as latin-1 or gbk.
        resample: samples per second, such as 200 or '200 Hz', at which channels on several clocks, or on one that is
            not steady, are interpolated; by default these are refused.
    """

    hold: InputHold | None = None
    columns: Names | None = None
    dt: float | None = None
    header_rows: int | None = None
    encoding: str | None = None
    resample: float | str | None = None

    @property
    def reading(self) -> dict[str, Any]:
        """As keywords of `Data.read`."""
        text = TextForm(self.header_rows, self.encoding)
        return {"hold": self.hold, "columns": self.columns, "dt": self.dt, "form": text, "resample": self.resample}
