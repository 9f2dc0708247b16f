"""Drawing: shapes whose places are expressions of coordinates and parameters, which show how a system moves.

Lengths are in the units of the model, x to the right and y upwards. An angle is 0 where an arm hangs down, and grows
anticlockwise.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

from masking.model.declaration.expression import Expression
from masking.model.declaration.fields import Block, Formula, TextField

Point = tuple[Formula, Formula]


class Body(Block):
    """A box: `at` is its middle, `size` its width and height."""

    at: Point
    size: tuple[Formula, Formula]
    label: TextField = ""


class Line(Block):
    """Something straight between two points: a spring, a rod, or the ground, which is hatched on its right side."""

    ends: tuple[Point, Point]


class Arm(Block):
    """An arm that turns about `pivot`, with a bob of a radius at its end."""

    pivot: Point
    length: Formula
    angle: Formula
    bob: Formula = Expression("0")
    label: TextField = ""


class Disc(Block):
    """A disc that turns about its middle, with a spoke."""

    at: Point
    radius: Formula
    angle: Formula
    label: TextField = ""


class Shape(Block):
    """One shape: a mapping with the key of its kind."""

    body: Body | None = None
    spring: Line | None = None
    rod: Line | None = None
    ground: Line | None = None
    arm: Arm | None = None
    disc: Disc | None = None

    KINDS: ClassVar[tuple[str, ...]] = ("body", "spring", "rod", "ground", "arm", "disc")

    @property
    def kinds(self) -> list[str]:
        """The kinds that are given: one, in a sound declaration."""
        return [kind for kind in self.KINDS if getattr(self, kind) is not None]

    @property
    def label(self) -> str:
        """What is written on it, "" for nothing."""
        return str(getattr(getattr(self, self.kinds[0]), "label", ""))

    @property
    def formulas(self) -> Iterator[tuple[str, Expression]]:
        """Every expression with its path below the shape, in the order of the fields; an angle ends in `.angle`."""
        for kind in self.kinds:
            block = getattr(self, kind)
            for name in type(block).model_fields:
                yield from _within(f"{kind}.{name}", getattr(block, name))


def _within(path: str, value: object) -> Iterator[tuple[str, Expression]]:
    if isinstance(value, Expression):
        yield path, value
    elif isinstance(value, tuple):
        for i, part in enumerate(value):
            yield from _within(f"{path}.{i}", part)
