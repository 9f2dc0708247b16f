"""Wall clock: instants such as 2024-05-03 10:00:00.002 or 12:34:56.789, as seconds from the first.

Times of the day without a date go on after midnight. A day and a month whose order the instants do not show are read
only where all have one date.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from datetime import date

import numpy as np
from numpy.typing import NDArray

_DAY = 86_400 * 10**9  # ns
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_STAMP = re.compile(
    r"(?:(?:(?P<year>\d{4})[-/.](?P<month>\d{1,2})[-/.](?P<day>\d{1,2})"
    r"|(?P<a>\d{1,2})(?P<mark>[-/.])(?P<b>\d{1,2})(?P=mark)(?P<year2>\d{4})"
    r"|(?P<day3>\d{1,2})[- ](?P<name>[A-Za-z]{3})[- ](?P<year3>\d{4}))(?:T|,?\s+))?"
    r"(?P<hour>\d{1,2}):(?P<minute>[0-5]\d):(?P<second>[0-5]\d)(?:[.,](?P<part>\d{1,9})\d*|:(?P<ms>\d{3}))?"
    r"\s*(?P<half>[AaPp][Mm])?\s*(?:Z|UTC|(?P<zone>[-+]\d\d):?(?P<zone_minute>\d\d))?",
    re.ASCII,
)
EXAMPLE = "2024-05-03 10:00:00.002 or 10:00:00.002"


def is_stamp(text: str) -> bool:
    """Whether a text is an instant on a wall clock: hours, minutes and seconds, with a date or without."""
    return _STAMP.fullmatch(text) is not None


def seconds(texts: Sequence[str]) -> NDArray[np.float64]:
    """Instants in s from the first one (samples,), exact to 1 ns; NaN for what is none, or where the day is unknown."""
    found = [_STAMP.fullmatch(text) for text in texts]
    dates = [None if one is None else (one["a"], one["b"]) for one in found]
    pairs = [(int(a), int(b)) for a, b in filter(None, dates) if a]
    is_dotted = any(one is not None and one["mark"] == "." for one in found)
    is_day_first = is_dotted or any(a > 12 for a, _ in pairs)
    if len({*pairs}) > 1 and not is_day_first and not any(b > 12 for _, b in pairs):
        return np.full(len(texts), np.nan)
    made = [None if one is None else _nanoseconds(one, is_day_first) for one in found]
    known = [one for one in made if one is not None]
    if not any(one is not None and (one["year"] or one["year2"] or one["year3"]) for one in found):
        days = itertools.accumulate((b < a - _DAY // 2 for a, b in itertools.pairwise(known)), initial=0)
        known = [one + day * _DAY for one, day in zip(known, days, strict=False)]
    rest = iter(known)
    return np.array([np.nan if one is None else (next(rest) - known[0]) / 1e9 for one in made])


def _nanoseconds(stamp: re.Match[str], is_day_first: bool) -> int | None:
    """Nanoseconds of an instant since some midnight; None where there is no such day or hour."""
    hour, minute, second = (int(stamp[name]) for name in ("hour", "minute", "second"))
    if stamp["half"]:
        hour = hour % 12 + 12 * (stamp["half"].lower() == "pm") if 1 <= hour <= 12 else 24
    day = _day(stamp, is_day_first)
    if hour > 23 or day is None:
        return None
    zone = int(stamp["zone"] or 0) * 60
    zone += (-1 if (stamp["zone"] or "").startswith("-") else 1) * int(stamp["zone_minute"] or 0)
    part = int((stamp["part"] or stamp["ms"] or "0").ljust(9, "0"))
    return day * _DAY + ((hour * 60 + minute - zone) * 60 + second) * 10**9 + part


def _day(stamp: re.Match[str], is_day_first: bool) -> int | None:
    """Number of the day of an instant, 0 where it has no date; None where there is no such day."""
    year, name = stamp["year"] or stamp["year2"] or stamp["year3"], (stamp["name"] or "").lower()
    if not year:
        return 0
    month = stamp["month"] or stamp["b" if is_day_first else "a"] or 1 + (*_MONTHS, name).index(name)
    day = stamp["day"] or stamp["a" if is_day_first else "b"] or stamp["day3"]
    try:
        return date(int(year), int(month), int(day)).toordinal()
    except ValueError:
        return None
