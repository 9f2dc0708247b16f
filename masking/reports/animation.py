"""Animation of a recording: the rig beside its virtual system, in a page that needs no other file and no network."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from markupsafe import Markup, escape

from masking.analysis.synchronisation import period
from masking.compile.numerics.arrays import Array
from masking.display.palette import COLOURS
from masking.display.symbols import markup
from masking.errors import DeclarationError, MaskingError, RecordError
from masking.lab.records.recording import Recording
from masking.model.declaration import schema
from masking.model.declaration.units import dimension_of, factor_of
from masking.model.modelling.scales import Units
from masking.reports import html, system_drawing
from masking.reports.system_drawing import Drawing

PAGE: Final = "animation.html"
_MOST_ROWS: Final = 20_000  # in a page: 40 points in each of 500 periods
_LEVELS: Final = 32_767  # of a series, which is kept in 16 bits
_SPEEDS: Final = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_SECONDS: Final = 1.6  # that a period takes at first, about
PERIODS: Final = 12.0  # that the traces show at once


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
        return html.framed(self.page())

    def _scene_data(self, scene: Scene) -> dict[str, Any]:
        names = scene.drawing.coordinates
        ideal = [f"ideal.{name}" for name in names] if scene.prefix == "virtual" else []
        is_there = bool(ideal) and all(name in self.recording.columns for name in ideal)
        return {
            "shapes": system_drawing.shape_facts(scene.drawing),
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
            return system_drawing.generic(title, coordinates, reach)
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
        return system_drawing.generic(title, coordinates, reach)
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
