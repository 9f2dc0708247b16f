"""Drawing of a system: its declared shapes, or a generic one, as numbers at an instant and as code of a web page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.display.palette import COLOURS, MUTED
from masking.errors import RecordError
from masking.model.declaration.operations import CONSTANTS, Step
from masking.model.declaration.shape_declaration import Shape

_LOOKED = 240  # instants at which the extent of a motion is looked at
_ROOM = 0.06  # of the extent, around a drawing
_VISIBLE, _WANTED = 0.04, 0.1  # of the extent: a smaller motion is magnified, to about this one
_MAGNIFIED: Final = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
_SAME = {"+", "-", "*", "/", "<", "<=", ">", ">="}
# In JavaScript, what is not `Math.` and the name of the function.
_CODE = {"**": "Math.pow({0},{1})", "negative": "(-{0})", "where": "({0}?{1}:{2})", "heaviside": "(({0}>0)+({0}>=0))/2"}


@dataclass(frozen=True)
class Drawing:
    """A system that can be drawn at any instant."""

    title: str  # of the system
    unit: str  # of its lengths, "" for none
    coordinates: tuple[str, ...]  # their names, in the order of the series
    shapes: tuple[Shape, ...]  # to draw, those behind first
    parameters: Mapping[str, float]  # values of the parameters in the expressions, by name
    note: str = ""  # what must be known to read it, "" for nothing

    @property
    def colours(self) -> list[str]:
        """Colour for each shape: that of the coordinate that moves it, or grey."""
        return [self._colour(shape) for shape in self.shapes]

    def _colour(self, shape: Shape) -> str:
        if shape.kinds[0] in {"spring", "rod", "ground"}:
            return MUTED
        formulas = [*shape.formulas]
        turned = [x for path, x in formulas if path.endswith(".angle")]
        used = set().union(*(x.names for x in turned or [x for _, x in formulas]))
        moved = [i for i, name in enumerate(self.coordinates) if name in used]
        return COLOURS[moved[0] % len(COLOURS)] if moved else MUTED

    def numbers(self, t: float, q: Sequence[float]) -> list[list[float]]:
        """Numbers of each shape, in the order of its fields, at t in s and q (n,); fails where one has no value."""
        values = {**self.parameters, **dict(zip(self.coordinates, map(float, q), strict=True)), "t": t}
        return [[x.evaluate(values) for _, x in shape.formulas] for shape in self.shapes]

    def code(self) -> str:
        """Function of JavaScript that gives `numbers` of coordinates and time."""
        names = {name: f"q[{i}]" for i, name in enumerate(self.coordinates)} | {"t": "t"}
        algebra = _JavaScript(names | {name: f"({value!r})" for name, value in self.parameters.items()})
        rows = (",".join(x.walk(algebra) for _, x in shape.formulas) for shape in self.shapes)
        return f"(q,t)=>[{','.join(f'[{row}]' for row in rows)}]"

    def view(self, times: Array, motion: Array) -> tuple[tuple[float, float, float, float], int]:
        """Extent of the drawing (left, right, bottom, top), and by how much its motion is magnified.

        Times are (m,), in s, and the motion of the coordinates (m, n).
        """
        rows = np.unique(np.linspace(0, len(times) - 1, _LOOKED).astype(int))
        at_rest = self._corners(0.0, np.zeros(len(self.coordinates)))
        corners = np.array([self._corners(times[i], motion[i]) for i in rows])
        size = np.ptp(at_rest, axis=0).max() or 1.0
        moved = float(np.abs(corners - corners.mean(axis=0)).max()) / float(size)
        factor = 1
        if 0.0 < moved < _VISIBLE:
            factor = max((m for m in _MAGNIFIED if m * moved <= _WANTED), default=1)
            corners = np.array([self._corners(times[i], factor * motion[i]) for i in rows])
        everything = np.concatenate([corners.reshape(-1, 2), at_rest])
        (left, bottom), (right, top) = everything.min(axis=0), everything.max(axis=0)
        room = _ROOM * max(right - left, top - bottom)
        return (float(left - room), float(right + room), float(bottom - room), float(top + room)), factor

    def _corners(self, t: float, q: Array) -> Array:
        """Points (k, 2) that lie around every shape."""
        pairs = zip(self.shapes, self.numbers(t, q.tolist()), strict=True)
        return np.array([point for shape, numbers in pairs for point in _around(shape.kinds[0], numbers)])


def generic(title: str, names: Sequence[str], reach: Array) -> Drawing:
    """Drawing of a system that declares none: a body on a line for each coordinate, with its largest size (n,).

    Raises a `RecordError` where a name cannot stand in an expression.
    """
    note = "No drawing is declared: each coordinate moves a body on a line, its largest value by one unit."
    try:
        return Drawing(title, "", tuple(names), tuple(_on_lines(names, reach)), {}, note)
    except ValueError:  # of pydantic
        remedy = "rename its columns: a name is made of letters, digits and underscores"
        raise RecordError(f"{title}: one of {', '.join(names)} is no name of a coordinate; {remedy}") from None


def _on_lines(names: Sequence[str], reach: Array) -> Iterator[Shape]:
    for i, (name, most) in enumerate(zip(names, reach, strict=True)):
        place = f"{name}/{float(most)!r}" if most > 0.0 else name
        y = -0.9 * i
        yield Shape.model_validate({"rod": {"ends": [[-1.4, y], [1.4, y]]}})
        yield Shape.model_validate({"body": {"at": [place, y], "size": [0.55, 0.55], "label": name}})


def _around(kind: str, numbers: Sequence[float]) -> list[tuple[float, float]]:
    """Corners of what a shape takes."""
    if kind in {"spring", "rod", "ground"}:
        return [(numbers[0], numbers[1]), (numbers[2], numbers[3])]
    x, y = numbers[:2]
    if kind == "body":
        width, height = numbers[2] / 2, numbers[3] / 2
    elif kind == "arm":
        width = height = numbers[4]
        x, y = x + numbers[2] * math.sin(numbers[3]), y - numbers[2] * math.cos(numbers[3])
    else:
        width = height = numbers[2]
    spoke = [(x + width * math.sin(numbers[3]), y - width * math.cos(numbers[3]))] if kind == "disc" else []
    return [(x - width, y - height), (x + width, y + height), *spoke]


@dataclass(frozen=True, slots=True)
class _JavaScript:
    """Writes an expression as JavaScript; `names` are what stands for its symbols."""

    names: Mapping[str, str]

    def number(self, step: Step) -> str:
        return repr(CONSTANTS.get(step.value) or float(step.value))

    def symbol(self, step: Step) -> str:
        return self.names[step.value]

    def apply(self, step: Step, args: Sequence[str]) -> str:
        if step.operation in _SAME:
            return f"({args[0]}{step.operation}{args[1]})"
        if step.operation in _CODE:
            return _CODE[step.operation].format(*args)
        return f"Math.{step.operation}({','.join(args)})"


def shape_facts(drawing: Drawing) -> list[dict[str, Any]]:
    """Kind, the colour and the label of each shape, as JSON can hold them."""
    pairs = zip(drawing.shapes, drawing.colours, strict=True)
    return [{"kind": shape.kinds[0], "colour": colour, "label": shape.label} for shape, colour in pairs]
