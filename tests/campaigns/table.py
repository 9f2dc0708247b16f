"""A fault of the table: what is injected, what is expected, and how the test evaluated it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import final

from masking.errors import MaskingError
from tests.campaigns.bench import BUSY, Bench


@final
class Judgement:
    """What a test measures, and what of it breaks the criterion."""

    def __init__(self) -> None:
        self.measured: list[str] = []
        self.broken: list[str] = []

    def say(self, text: str) -> None:
        """Add a measurement."""
        self.measured.append(text)

    def need(self, holds: object, broken: str) -> None:
        """Demand what a criterion asks for; what is broken is said in words, with its number."""
        if not holds:
            self.broken.append(broken)


Test = Callable[[Bench, Judgement], None]


@dataclass(frozen=True)
class Fault:
    """A row of the table.

    Args:
        number: of the table.
        injected: what is done.
        expected: what must follow, and the criterion.
        test: injects it, measures, and evaluates.
        in_real_time: other programs may spoil a try, so that it has three.
        is_long: it begins first, beside others.
    """

    number: int
    injected: str
    expected: str
    test: Test
    in_real_time: bool = False
    is_long: bool = False


@dataclass(frozen=True)
class Finding:
    """How a fault was survived.

    Args:
        number: of the fault.
        injected: what was done.
        expected: what must follow.
        measured: what did.
        broken: what of the criterion is not met, a sentence each.
        tries: how often it was done.
        seconds: that it took.
    """

    number: int
    injected: str
    expected: str
    measured: str
    broken: tuple[str, ...]
    tries: int
    seconds: float

    @property
    def passes(self) -> bool:
        """Tell whether the criterion is met."""
        return not self.broken


def examine(fault: Fault, bench: Bench) -> Finding:
    """Inject a fault, and evaluate what follows."""
    began, tries, judgement = time.monotonic(), 0, Judgement()
    most = BUSY if fault.in_real_time else 1
    while tries < most:
        tries, judgement = tries + 1, Judgement()
        try:
            fault.test(bench, judgement)
        except (MaskingError, OSError, ValueError, LookupError) as error:
            judgement.need(holds=False, broken=f"{type(error).__name__}: {error}")
        if not judgement.broken:
            break
        bench.close()  # what it left must not be taken for what the next one does
    return Finding(
        fault.number,
        fault.injected,
        fault.expected,
        "; ".join(judgement.measured),
        tuple(judgement.broken),
        tries,
        time.monotonic() - began,
    )


def text(findings: Sequence[Finding], seconds: float) -> str:
    """Return the findings as a table of text.

    Args:
        findings: of the faults.
        seconds: that all of them took together.
    """
    faults = [found for found in findings if found.number]  # 0 is a run without one
    said = f"{sum(f.passes for f in faults)} of {len(faults)} pass, in {seconds:.0f} s"
    return "\n".join([*_lines(findings), said])


def _lines(findings: Sequence[Finding]) -> Iterator[str]:
    for found in findings:
        verdict = "pass" if found.passes else "FAIL"
        yield f"{found.number:>2}  {verdict}  {found.injected}: {found.expected}  ({found.seconds:.1f} s)"
        if found.measured:
            yield f"          {found.measured}{f'; try {found.tries}' if found.tries > 1 else ''}"
        for broken in found.broken:
            yield f"          broken: {broken}"
