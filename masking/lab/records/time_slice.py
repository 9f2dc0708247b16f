"""Part: a part of a record by its times, written behind its path: `record.csv@10:20` is what lies from 10 s to 20 s."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from masking.errors import RecordError
from masking.lab.records.decimals import is_decimal

MARK = "@"
_NEAR = 1e-3  # of the time between samples: a sample so near to a time is at it


@dataclass(frozen=True)
class Part:
    """The samples of a file from a time on, and before another one, so that parts side by side share none."""

    name: str  # path and times, as they were given
    file: Path  # path of the whole record
    start: float | None = None  # time of the first sample in s; None for the first of the record
    end: float | None = None  # time in s that the last sample lies before; None for the end of the record

    @classmethod
    def of(cls, path: str | Path) -> Part:
        """Read `FILE`, `FILE@10:20`, `FILE@10:` or `FILE@:20`; a path that is there as it stands is a whole record.

        A RecordError where what is behind the file are not two times in s, one after the other.
        """
        text = str(path)
        file, _, times = text.rpartition(MARK)
        if not file or exists(Path(text)) or not exists(Path(file)):
            return cls(text, Path(text))
        first, colon, last = times.partition(":")
        start = end = None
        try:
            start, end = (_seconds(time.strip()) for time in (first, last))
        except ValueError:
            colon = ""
        if not colon:
            raise RecordError(
                f"{text}: '{times}' is no part of a record; give two times in s, such as {file}{MARK}10:20, "
                f"{file}{MARK}10: or {file}{MARK}:20"
            )
        if start is not None and end is not None and start >= end:
            raise RecordError(f"{text}: the part ends at {end:.9g} s, but starts at {start:.9g} s; let it end later")
        return cls(text, Path(file), start, end)

    @property
    def limits(self) -> tuple[float, float]:
        """Times in s that the part goes from and until; infinite where none is given."""
        return -math.inf if self.start is None else self.start, math.inf if self.end is None else self.end

    def samples(self, t: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell of each sample of a clock (samples,) in s whether it is in the part.

        The last sample of a record lasts as long as the others: 1000 samples from 0 s on at 100 Hz go to 10 s. A
        RecordError where the part reaches out of the record, or no sample lies in it.
        """
        chosen = np.full(len(t), True)
        known = t[np.isfinite(t)]
        if (self.start is None and self.end is None) or not len(known):
            return chosen
        step = max(0.0, float(np.median(np.diff(known)))) if len(known) > 1 else 0.0
        first, last = float(known.min()), float(known.max())
        start, end = self.within(first, last, step)
        if self.start is not None:
            chosen &= t >= start
        if self.end is not None:
            chosen &= t < end
        if not chosen.any():
            raise self.empty(first, last, step)
        return chosen

    def within(self, first: float, last: float, step: float) -> tuple[float, float]:
        """Times of a record that the part goes from and until; infinite where none is given.

        The record has samples at the times `first` to `last`, `step` apart, in s; a RecordError where the part reaches
        out of it.
        """
        near = _NEAR * step
        if any(time is not None and not first - near <= time <= last + step + near for time in (self.start, self.end)):
            raise RecordError(f"{self.name}: the record goes from {first:.9g} s to {last:.9g} s; name a part of it")
        start, end = self.limits
        return start - near, end - near

    def empty(self, first: float, last: float, step: float) -> RecordError:
        """Error of a part without a sample; the arguments are those of `within`."""
        return RecordError(
            f"{self.name}: no sample lies in this part; the record goes from {first:.9g} s to {last:.9g} s, with "
            f"{step:.9g} s between samples"
        )


def exists(path: Path) -> bool:
    """Whether a path is there; one that the system cannot look up, such as a name too long, is not."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def _seconds(text: str) -> float | None:
    """Time; None for no text, and a ValueError for no finite decimal number."""
    if not text:
        return None
    if not is_decimal(text) or not math.isfinite(value := float(text)):
        raise ValueError
    return value
