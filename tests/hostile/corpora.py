"""The corpus: all records and all declarations, in an order that does not change."""

from __future__ import annotations

import tempfile
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

from tests.hostile import binaries, declarations, judge, texts
from tests.hostile.cases import RecordCase

SAMPLE = 21  # one in so many


def of(kind: str, is_sample: bool) -> list[Any]:
    """Return the cases of `records` or `declarations`, or one in some of them."""
    cases = _all(kind)
    if not is_sample:
        return cases
    return [case for case in cases if not getattr(case, "is_slow", False)][::SAMPLE]


@cache
def _all(kind: str) -> list[Any]:
    return [*chain(texts.cases(), binaries.cases())] if kind == "records" else [*declarations.cases()]


def name(case: Any) -> str:
    return str(case.name)


def prepared(case: Any, folder: Path) -> str | Path:
    """Write what a case reads into a folder; return its path."""
    return case.make(folder) if isinstance(case, RecordCase) else folder


def judge_one(case: Any, target: str | Path) -> tuple[str, str]:
    """Return what is wrong with what happens to a case, and what it said."""
    if isinstance(case, RecordCase):
        return judge.judged_record(case, target)
    return declarations.judged(case, Path(target))


def warm(kind: str) -> None:
    """Load every package, so that memory and time are those of the cases."""
    if kind == "records":
        for case in binaries.honest():
            with tempfile.TemporaryDirectory() as folder:
                assert judge_one(case, prepared(case, Path(folder))) == ("", "read"), case.name
    else:
        declarations.warm()
