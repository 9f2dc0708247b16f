"""Events: instants at which a condition crosses zero upwards, and what jumps there."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from masking.errors import nearest
from masking.model.declaration.expression import Expression
from masking.model.declaration.fields import Block, Formula, TextField


class Event(Block):
    """What happens at each instant at which `when` crosses zero upwards, from below.

    `jumps` gives the values after it, of coordinates, velocities and internal states; those on the right are before it.
    """

    when: Formula
    jumps: dict[TextField, Formula]
    meaning: TextField = ""

    @property
    def formulas(self) -> Iterator[tuple[str, Expression]]:
        """Every expression with its path below the event."""
        yield "when", self.when
        yield from ((f"jumps.{name}", value) for name, value in self.jumps.items())

    @property
    def written(self) -> str:
        """The jumps in one line."""
        return ", ".join(f"{name} -> {value.text}" for name, value in self.jumps.items())

    def problems(self, states: Collection[str], moving: Collection[str]) -> Iterator[tuple[str, str, str]]:
        """Yield part, message, remedy of what is wrong beside its symbols. States may jump; moving names change."""
        if not self.jumps:
            first = next(iter(states), "s")
            yield "jumps", "an event without jumps does nothing", f"write what jumps, such as 'jumps: {{{first}: 0}}'"
        for name in self.jumps:
            if name not in states:
                message = f"'{name}' is not a coordinate, a velocity or an internal state, and nothing else jumps"
                yield f"jumps.{name}", message, nearest(name, states)
        if not self.when.names & {*moving}:
            message = "the condition does not change, so that it never crosses zero"
            yield "when", message, "write an expression of coordinates, velocities, internal states or t, such as x - 1"
