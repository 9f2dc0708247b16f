"""Reliability: how often answers that are stated with a probability are right, as a table and as a diagram.

Source: Murphy and Winkler (1977), J. R. Stat. Soc. C 26(1), 41-47, for the diagram.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from tests.benchmarks.answers.scoring import Line
from tests.benchmarks.discovering.scoring import wilson

EDGES = (0.0, 0.5, 0.7, 0.9, 0.97, 1.0)  # of the bins of probability
WORLDS = {"measured": "measured sets", "second": "second generator", "problems": "random problems"}


class Bin(NamedTuple):
    """Answers of about one probability."""

    said: float  # mean probability
    right: int
    count: int

    @property
    def interval(self) -> tuple[float, float]:
        """Part that is right, with 95 % confidence."""
        return wilson(self.right, self.count)


def stated(lines: Iterable[Line]) -> list[tuple[float, bool]]:
    """Return the probabilities that answers state of themselves, and whether they are right.

    They are those of the least sure name, or of none of the names.
    """
    pairs = [(line.none if line.verdict == "unknown" else line.probability, line.right) for line in lines]
    return [(p, right) for p, right in pairs if p is not None]


def bins(pairs: Sequence[tuple[float, bool]]) -> list[Bin]:
    """Return answers by their probability, given with whether each is right."""
    found = []
    for low, high in pairwise(EDGES):
        those = [(p, right) for p, right in pairs if low <= p < high or p == high == EDGES[-1]]
        if those:
            found.append(Bin(float(np.mean([p for p, _ in those])), sum(right for _, right in those), len(those)))
    return found


def table(lines: Sequence[Line]) -> list[str]:
    """Return the lines of a table: for each suite and bin, what is stated, and how often it is right."""
    shown = ["| suite | stated probability | answers | right | with 95 % confidence |", "|---" * 5 + "|"]
    for suite in dict.fromkeys(line.suite for line in lines):
        for one in bins(stated(line for line in lines if line.suite == suite)):
            low, high = (round(100.0 * end) for end in one.interval)
            cells = (WORLDS.get(suite, suite), f"{100.0 * one.said:.0f} %", one.count,
                     f"{100.0 * one.right / one.count:.0f} %", f"{low} to {high} %")  # fmt: skip
            shown.append(f"| {' | '.join(map(str, cells))} |")
    return shown


def diagram(lines: Sequence[Line], file: Path) -> None:
    """Write the diagram: the part that is right over the probability that is stated, one line for each suite."""
    figure = Figure(figsize=(5.2, 4.2), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.6", linestyle=":", label="as often as stated")
    for suite in dict.fromkeys(line.suite for line in lines):
        every = bins(stated(line for line in lines if line.suite == suite))
        parts = [one.right / one.count for one in every]
        ends = np.array([one.interval for one in every]).T
        reach = np.abs(ends - np.array(parts))
        label = f"{WORLDS.get(suite, suite)} ({sum(one.count for one in every)})"
        axes.errorbar([one.said for one in every], parts, reach, marker="o", capsize=3, label=label)
    axes.set(xlabel="stated probability", ylabel="part that is right", xlim=(0, 1.02), ylim=(0, 1.02))
    figure.legend(loc="outside upper center", ncols=2, frameon=False)
    figure.savefig(file, dpi=110)
