"""Trace: every hypothesis that a discovery looked at, with the move that suggested it and what became of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from masking.compile.numerics.arrays import Array
from masking.inference.discovery import discrepancy
from masking.inference.discovery.verdict import Key


@dataclass(frozen=True)
class Tried:
    """A hypothesis that was fitted."""

    reading: str  # how the record was read
    move: str  # what suggested it
    names: tuple[Key, ...]  # its causes
    # squared residuals over noise variances, and the independent samples that they are worth, by sensor (sensors,)
    misfits: Array
    independent: Array
    price: float  # -2 log of its priors, of the Occam factor and of the penalty of its parameters
    readings: int  # of the record

    def evidence(self, like: Tried) -> float:
        """-2 log evidence, up to a constant, with the residual as coloured as that of another hypothesis."""
        return discrepancy.misfit(self.misfits, like.independent) + self.price

    @property
    def over_noise(self) -> float:
        """Rms of its residual over that of the noise, all sensors together."""
        return float((self.misfits.sum() / self.readings) ** 0.5)


class Line(NamedTuple):
    """A hypothesis beside the likeliest one of its reading."""

    tried: Tried
    behind: float  # -2 log of the odds against the likeliest one; 0 for that
    why: str  # it was not taken; '' if nothing but its evidence says so


@dataclass
class Trace:
    """Hypotheses in the order in which they were fitted; traces of other readings of the record share them."""

    reading: str = "as declared"
    tried: list[Tried] = field(default_factory=list)
    refusals: dict[tuple[str, tuple[Key, ...]], str] = field(default_factory=dict)

    def under(self, reading: str) -> Trace:
        """Trace of the record in another reading, which adds to this one."""
        return replace(self, reading=reading if self.reading == "as declared" else f"{self.reading}, {reading}")

    def refuse(self, names: tuple[Key, ...], why: str) -> None:
        """Note why a hypothesis is not taken, whatever its evidence."""
        self.refusals.setdefault((self.reading, tuple(sorted(names))), why)

    def as_dict(self) -> list[dict[str, object]]:
        """Lines as JSON can hold them."""
        return [
            {
                "reading": one.reading, "causes": [*map(list, one.names)], "suggested_by": one.move,
                "behind": behind, "error_over_noise": one.over_noise, "not_taken": why,
            }
            for one, behind, why in self.lines()
        ]  # fmt: skip

    def lines(self) -> Iterator[Line]:
        """Hypotheses by reading, the likeliest first; of several fits with the same causes the likeliest."""
        for reading in dict.fromkeys(one.reading for one in self.tried):
            every = [one for one in self.tried if one.reading == reading]
            like = min(every, key=lambda one: float(one.misfits.sum()))
            best = dict[tuple[Key, ...], Tried]()
            for one in sorted(every, key=lambda one: one.evidence(like)):
                best.setdefault(tuple(sorted(one.names)), one)
            least = next(iter(best.values())).evidence(like)
            for names, one in best.items():
                yield Line(one, one.evidence(like) - least, self.refusals.get((reading, names), ""))
