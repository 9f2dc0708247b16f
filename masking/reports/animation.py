"""Animation of a recording: the rig beside its virtual system, in a page that needs no other file and no network."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from markupsafe import Markup, escape

from masking.analysis.synchronisation import period
from masking.compile.numerics.arrays import Array
from masking.display.palette import COLOURS, MUTED
from masking.display.symbols import markup
from masking.errors import DeclarationError, MaskingError, RecordError
from masking.lab.records.recording import Recording
from masking.model.declaration import schema
from masking.model.declaration.operations import CONSTANTS, Step
from masking.model.declaration.shape_declaration import Shape
from masking.model.declaration.units import dimension_of, factor_of
from masking.model.modelling.scales import Units
from masking.reports import html

_LOOKED = 240  # instants at which the extent of a motion is looked at
_ROOM = 0.06  # of the extent, around a drawing
_VISIBLE, _WANTED = 0.04, 0.1  # of the extent: a smaller motion is magnified, to about this one
_MAGNIFIED: Final = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
_SAME = {"+", "-", "*", "/", "<", "<=", ">", ">="}
# In JavaScript, what is not `Math.` and the name of the function.
_CODE = {"**": "Math.pow({0},{1})", "negative": "(-{0})", "where": "({0}?{1}:{2})", "heaviside": "(({0}>0)+({0}>=0))/2"}
PAGE: Final = "animation.html"
_MOST_ROWS: Final = 20_000  # in a page: 40 points in each of 500 periods
_LEVELS: Final = 32_767  # of a series, which is kept in 16 bits
_SPEEDS: Final = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_SECONDS: Final = 1.6  # that a period takes at first, about
PERIODS: Final = 12.0  # that the traces show at once


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
    shapes: list[dict[str, Any]] = []
    note = "No drawing is declared: each coordinate moves a body on a line, its largest value by one unit."
    try:
        for i, (name, most) in enumerate(zip(names, reach, strict=True)):
            place, y = f"{name}/{float(most)!r}" if most > 0.0 else name, -0.9 * i
            body = {"at": [place, y], "size": [0.55, 0.55], "label": name}
            shapes += [{"rod": {"ends": [[-1.4, y], [1.4, y]]}}, {"body": body}]
        return Drawing(title, "", tuple(names), tuple(map(Shape.model_validate, shapes)), {}, note)
    except ValueError:  # of pydantic
        remedy = "rename its columns: a name is made of letters, digits and underscores"
        raise RecordError(f"{title}: one of {', '.join(names)} is no name of a coordinate; {remedy}") from None


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


@dataclass(frozen=True)
class Scene:
    """One system of a recording, as it is drawn."""

    prefix: str  # of its columns
    what: str  # it is, in words
    drawing: Drawing  # of the system
    view: tuple[float, float, float, float]  # extent (left, right, bottom, top), in the unit of the drawing
    factor: int  # by which its motion is magnified
    sizes: tuple[float, ...]  # of a unit of each coordinate's column, in what the drawing is computed with


@dataclass(frozen=True)
class Animation:
    """What a recording shows as an animation."""

    recording: Recording

    def __repr__(self) -> str:
        return f"<Animation of {self.recording!r}>"

    @cached_property
    def scenes(self) -> tuple[Scene, ...]:
        """Rig and the virtual system, as far as they were recorded.

        Raises a `RecordError` where the recording holds no motion, and a `DeclarationError` where an expression of a
        drawing has no value.
        """
        words = {"rig": "The rig", "virtual": "The virtual system"}
        found = tuple(self._scene(prefix, what) for prefix, what in words.items() if self.recording.names(prefix))
        if not found:
            raise RecordError("the recording holds no motion to animate: no columns 'rig.*' or 'virtual.*'")
        return found

    def _scene(self, prefix: str, what: str) -> Scene:
        recording = self.recording
        sizes = {name: _size(recording, f"{prefix}.{name}") for name in recording.names(prefix)}
        drawn = _drawing(recording, prefix, np.abs(recording.array(prefix)).max(axis=0))
        own = tuple(sizes[name] for name in drawn.coordinates)
        motion = np.column_stack([recording[f"{prefix}.{name}"] for name in drawn.coordinates]) * own
        return Scene(prefix, what, drawn, *drawn.view(recording.t, motion), own)

    @property
    def main(self) -> Scene:
        """Scene whose coordinates are the traces: the virtual system, where there is one."""
        return self.scenes[-1]

    @cached_property
    def period(self) -> float:
        """Period of the first coordinate that has one, in s; a twentieth of the record where none has."""
        t, main = self.recording.t, self.main
        series = [self.recording[f"{main.prefix}.{name}"] for name in main.drawing.coordinates]
        found = (period(t, one) for one in series)
        return next((one for one in found if math.isfinite(one)), (t[-1] - t[0]) / 20.0)

    @property
    def speed(self) -> float:
        """How fast it is played at first, so that a period can be seen: 1 is as fast as the rig."""
        wanted = self.period / _SECONDS
        return 1.0 if 0.3 < wanted < 3.0 else min(_SPEEDS, key=lambda speed: abs(math.log(speed / wanted)))

    @property
    def rows(self) -> slice:
        """Rows that a page holds."""
        return slice(None, None, max(1, -(-len(self.recording) // _MOST_ROWS)))

    def data(self) -> dict[str, Any]:
        """All that a page shows, as JSON can hold it."""
        recording = self.recording
        return {
            "t": _packed(recording.t[self.rows], np.float32),
            "scale": float(recording.manifest.get("time_scale") or 1.0),
            "speed": self.speed,
            "speeds": list(_SPEEDS),
            "window": PERIODS * self.period,
            "scenes": [self._scene_data(scene) for scene in self.scenes],
            "traces": list(self._traces()),
        }

    def page(self) -> str:
        """Page that needs no other file, as HTML; errors as `scenes`."""
        return html.render(
            "animation",
            title=self.recording.name or "Recording",
            tiles=(),
            names=self.main.drawing.coordinates,
            scenes=self.scenes,
            data=self.data(),
            code=Markup(f"[{','.join(scene.drawing.code() for scene in self.scenes)}]"),  # noqa: S704  # numbers, names
        )

    def _repr_html_(self) -> str:
        frame = Markup('<iframe srcdoc="{}" style="width:100%;height:46rem;border:0"></iframe>')
        return str(frame.format(self.page()))

    def _scene_data(self, scene: Scene) -> dict[str, Any]:
        names = scene.drawing.coordinates
        ideal = [f"ideal.{name}" for name in names] if scene.prefix == "virtual" else []
        is_there = bool(ideal) and all(name in self.recording.columns for name in ideal)
        return {
            "shapes": shape_facts(scene.drawing),
            "view": scene.view,
            "factor": scene.factor,
            "unit": scene.drawing.unit,
            "q": [self._series(f"{scene.prefix}.{n}", size) for n, size in zip(names, scene.sizes, strict=True)],
            "ideal": [self._series(*pair) for pair in zip(ideal, scene.sizes, strict=True)] if is_there else [],
        }

    def _traces(self) -> Iterator[dict[str, Any]]:
        """Coordinates of the main scene, the dashed ideal ones below them, and the inputs."""
        main, units = self.main, self.recording.units
        kinds = [("motion", main.prefix, main.drawing.coordinates), ("inputs", "input", self.recording.inputs)]
        for title, prefix, names in kinds:
            lines, each = [], [units.get(f"{prefix}.{name}", "") for name in names]
            common = each[0] if len(set(each)) == 1 else ""
            for name, unit, colour in zip(names, each, COLOURS, strict=False):
                own = f" ({unit})" if unit and not common else ""
                line: dict[str, Any] = {"name": name, "label": f"{markup(name)}{escape(own)}", "colour": colour}
                line["y"] = self._series(f"{prefix}.{name}")
                ideal = f"ideal.{name}"
                line["ideal"] = self._series(ideal) if title == "motion" and ideal in self.recording.columns else None
                lines.append(line)
            if lines:
                yield {"title": title, "unit": str(escape(common)), "lines": lines}

    def _series(self, column: str, factor: float = 1.0) -> dict[str, Any]:
        """Column times a factor in 16 bits, with its size."""
        series = self.recording[column][self.rows] * factor
        size = float(np.abs(series).max()) or 1.0
        return {"size": size, "data": _packed(np.rint(series / size * _LEVELS), np.int16)}


def save(made: Animation, page: Path) -> None:
    """Write an animation as one HTML file and its folder; a `RecordError` says that nothing moves, or why it cannot."""
    html.write({page: made.page()})


def _drawing(recording: Recording, prefix: str, reach: Array) -> Drawing:
    """Drawing that the system of a prefix declares, or a generic one, of coordinates alone."""
    names = recording.names(prefix)
    coordinates = tuple(name for name in names if f"{prefix}.{name}'" in recording.columns) or names
    reach = reach * [_size(recording, f"{prefix}.{name}") for name in coordinates]
    manifest, key = recording.manifest, {"rig": "plant_model", "virtual": "virtual"}[prefix]
    title = str(manifest.get({"rig": "plant_name", "virtual": "virtual_name"}[prefix]) or prefix)
    declared = (manifest.get("declarations") or {}).get(key)
    try:
        model = schema.ModelDeclaration.model_validate(declared)
        moved = {*model.coordinates, *model.states}
        drawn = {name for shape in model.drawing for _, x in shape.formulas for name in x.names & moved}
        if not drawn or not drawn <= {*names} <= moved:
            return generic(title, coordinates, reach)
        if prefix == "virtual":
            values = manifest["parameters"]
        else:  # as the plant file has them
            given = manifest["declarations"]["plant"].get("parameters", {})
            known = {name: value for name, value in given.items() if name in model.parameters}
            values = Units.of(model).parameter_values(known, dimensionless=False)
        values = {name: float(value) for name, value in values.items()}
        units = (recording.units.get(f"{prefix}.{name}", "1") for name in names)
        has_lengths = any(dimension_of(unit) == dimension_of("m") for unit in units)
    except (ValueError, TypeError, KeyError, MaskingError):  # a record from elsewhere, or of another version
        return generic(title, coordinates, reach)
    names = tuple(name for name in names if name in {*coordinates} | drawn)
    return Drawing(title, "m" * has_lengths, names, model.drawing, values)


def _size(recording: Recording, column: str) -> float:
    """Factor of a column to what is computed with: SI units, or scales; 1 where its unit is none that is known."""
    try:
        return factor_of(recording.units.get(column, "1"))
    except DeclarationError:
        return 1.0


def _packed(series: Array | Sequence[float], kind: type[np.generic]) -> str:
    """Numbers as text that a page unpacks: little-endian, base64."""
    dtype = np.dtype(kind).newbyteorder("<")
    return base64.b64encode(np.ascontiguousarray(series, dtype=dtype).tobytes()).decode("ascii")
