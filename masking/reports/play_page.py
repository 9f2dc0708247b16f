"""Play: a model under sliders, its motion drawn again at once, on a local page that a notebook shows, too."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Final, final
from urllib.parse import parse_qsl

import numpy as np
from markupsafe import Markup

from masking.analysis.stability.modes import state_matrix
from masking.errors import MaskingError, ModelError, nearest
from masking.lazy_imports import typeset
from masking.model.declaration.expression import Expression
from masking.model.declaration.units import pretty
from masking.model.modelling.model import Model
from masking.reports import html
from masking.reports.local_page import LocalPage

DURATION: Final = "duration"
_POINTS: Final = 1500  # of a motion that is drawn
_PERIODS, _MOST, _ELSE = 15.0, 300.0, 20.0  # of the slowest and of the fastest mode; s, or units of time, without modes
_TIMES: Final = 3.0  # its value: the end of a slider
_FRAME: Final = Markup(
    '<iframe src="{0}" style="width:100%;height:46rem;border:0"></iframe>'
    '<div><a href="{0}" target="_blank">{0}</a></div>'
)


@dataclass(frozen=True)
class Slider:
    """A value that is changed: a parameter, an initial value, a constant input, or the duration."""

    name: str
    kind: str  # as a heading
    meaning: str
    unit: str
    value: float  # declared, in the unit
    least: float
    most: float


@dataclass(frozen=True)
class Playground:
    """A model by itself with values that are changed: these come in, its motion goes out.

    A `ModelError` says that a `duration`, in s or in units of time, is not positive.
    """

    model: Model
    duration: float | None = None

    def __post_init__(self) -> None:
        if self.duration is not None and not 0.0 < self.duration < math.inf:
            raise ModelError(f"a duration of {self.duration:g} shows no motion; give a positive number")

    @cached_property
    def sliders(self) -> dict[str, Slider]:
        """Sliders by name, in the order in which they are shown."""
        return {one.name: one for one in self._sliders()}

    def _sliders(self) -> Iterator[Slider]:
        model, d = self.model, self.model.declaration
        si = model.units.parameter_values(model.overrides, dimensionless=False)
        second = model.units.computed[False]["t"]
        for name, p in d.parameters.items():
            if not isinstance(p.value, Expression) or not p.value.names:  # others follow from these
                value = si[name] / model.units.conversions[p.unit].factor
                low, high = p.bounds
                ends = _ends(value, -math.inf if low is None else low, math.inf if high is None else high)
                yield Slider(name, "parameters", p.meaning, _unit(p.unit), value, *ends)
        starts = [(n, c.unit, c.meaning, c.initial or 0.0) for n, c in d.coordinates.items()]
        largest = max((abs(value) for *_, value in starts), default=0.0) or 1.0
        for name, unit, meaning, value in starts:
            yield Slider(name, "initial values", meaning, _unit(unit), value, *_around(value or largest))
        for name, c in d.coordinates.items():
            unit = _unit(model.shown_in(c.unit, is_rate=True).unit)
            ends = _around(c.initial_velocity or largest)
            yield Slider(f"{name}'", "initial values", f"rate of {name}", unit, c.initial_velocity, *ends)
        for name, z in d.states.items():
            yield Slider(name, "initial values", z.meaning, _unit(z.unit), z.initial, *_around(z.initial or 1.0))
        for name, u in d.inputs.items():
            yield Slider(name, "constant inputs", u.meaning, _unit(u.unit), 0.0, *_around(1.0))
        length = self.duration or self._usual_duration
        yield Slider(DURATION, "time", "what is drawn", second, length, length / 20.0, _TIMES * length)

    @cached_property
    def _usual_duration(self) -> float:
        """Some periods of the slowest mode around 0, or of the fastest where these are too many to be seen."""
        try:
            values = np.linalg.eigvals(state_matrix(self.model))
        except (MaskingError, np.linalg.LinAlgError):
            return _ELSE
        found = np.abs(values.imag[np.abs(values.imag) > 1e-6 * np.abs(values).max(initial=0.0)])
        if not len(found) or not np.isfinite(found).all():
            return _ELSE
        return float(f"{2.0 * math.pi * min(_PERIODS / found.min(), _MOST / found.max()):.2g}")

    def motion(self, values: Mapping[str, float]) -> dict[str, Any]:
        """Motion with some values, in the units of their sliders: times, and each state in its unit, as JSON holds it.

        Raises:
            MaskingError: there is no slider of a name, a value is none that the model allows, or it cannot go on.
        """
        known, model = self.sliders, self.model
        for name, value in values.items():
            if name not in known:
                raise ModelError(f"{model.name} has no slider '{name}'; {nearest(name, known)}")
            if not math.isfinite(value):
                raise ModelError(f"{name} = {value:g} is not finite; give a number")
        given = {name: one.value for name, one in known.items()} | dict(values)
        if not 0.0 < given[DURATION] <= known[DURATION].most:
            raise ModelError(f"a {DURATION} of {given[DURATION]:g} is not shown; give up to {known[DURATION].most:g}")
        changed = {name: x for name, x in values.items() if name in model.parameters}
        moved = model.with_parameters(**changed) if changed else model
        inputs = [given[n] * model.shown_in(u.unit).size for n, u in model.declaration.inputs.items()]
        times = np.linspace(0.0, given[DURATION], _POINTS)
        found = moved.simulate(times, {name: given[name] for name in model.state_names}, inputs, tolerance=1e-7)
        states = {name: found[name] / moved.shown[name].size for name in model.state_names}
        if not all(np.isfinite(series).all() for series in states.values()):
            raise ModelError("the motion is not finite with these values; move a slider back")
        return {"t": times.tolist(), "states": {name: _rounded(series) for name, series in states.items()}}

    def facts(self) -> dict[str, Any]:
        """All that a page shows before anything moves, as JSON can hold it."""
        shown = self.model.shown
        states = {name: _unit(shown[name].unit) for name in self.model.state_names}
        named = {"name": self.model.name, "time": self.sliders[DURATION].unit, "coordinates": self.model.coordinates}
        return {**named, "states": states, "sliders": [asdict(one) for one in self.sliders.values()]}


@final
class PlayPage(LocalPage):
    """The page of a playground, served from the construction on; a context that ends the service.

    Port 0 is a free one; an `OperatorError` says that another is taken. The first motion is made before, so that a
    model that cannot move is refused with the `MaskingError` that says why.
    """

    frames = "'self' http://127.0.0.1:* http://localhost:*"  # of a notebook on this machine

    def __init__(self, playground: Playground, port: int = 0) -> None:
        self.playground = playground
        facts = {**playground.facts(), "first": playground.motion({})}
        equations = typeset.equations(playground.model.equations.pairs)
        self._begin(html.render("play", facts=facts, equations=equations), port, "--port")

    def __repr__(self) -> str:
        return f"<PlayPage {self.playground.model.name}: {self.address}>"

    def __str__(self) -> str:
        return f"page: {self.address}"

    def _repr_html_(self) -> str:
        return str(_FRAME.format(self.address))

    def as_dict(self) -> dict[str, Any]:
        """Address of the page, as JSON can hold it."""
        return {"page": self.address}

    def _data(self, query: str) -> bytes:
        """Motion with the values of a query, or an error in words, as JSON."""
        try:
            values = {name: float(text) for name, text in parse_qsl(query, max_num_fields=512)}
        except ValueError:
            return json.dumps({"error": f"{query[:80]} does not give numbers; write name=1.5"}).encode()
        try:
            return json.dumps(self.playground.motion(values), allow_nan=False).encode()
        except MaskingError as error:
            return json.dumps({"error": str(error)}).encode()


def _rounded(series: np.ndarray) -> list[float]:
    """Numbers with six digits of the largest, which no screen shows."""
    size = float(np.abs(series).max()) or 1.0
    digits = 6 - math.floor(math.log10(size)) if size > 1e-300 else 6
    return [round(x, digits) for x in series.tolist()]


def _unit(unit: str) -> str:
    return "" if unit == "1" else pretty(unit)


def _around(value: float) -> tuple[float, float]:
    return -_TIMES * abs(value), _TIMES * abs(value)


def _ends(value: float, low: float, high: float) -> tuple[float, float]:
    """Ends of the slider of a parameter: on its side of 0, and within its bounds."""
    least, most = sorted((0.0, _TIMES * value)) if value else (-1.0, 1.0)
    least, most = max(least, low), min(most, high)
    return (least, most) if least < most else (min(value, least), max(value, most))
