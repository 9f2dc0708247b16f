"""Trajectory: the states of a model over time, as an integrator gives them, drawn and as a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from masking.compile.numerics.arrays import Array
from masking.errors import ModelError, nearest
from masking.lazy_imports import axes, series_views


@dataclass(frozen=True, repr=False)
class Trajectory:
    """States over time.

    Args:
        times: (m,).
        states: (m, 2 n + k), coordinates, velocities, internal states; of an ensemble (runs, m, 2 n + k).
        coordinates: names of the n coordinates.
        steps: integration steps taken.
        internal: names of the k internal states.
        events: the time and the name of each event.
        errors: why a run of an ensemble could not go on, by its number; its states are not a number.
        units: of states, rates and the time `t`, by name; none of numbers without a unit.
    """

    times: Array
    states: Array
    coordinates: tuple[str, ...]
    steps: int
    internal: tuple[str, ...] = ()
    events: tuple[tuple[float, str], ...] = ()
    errors: Mapping[int, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        first, last = (f"{time:g}" for time in self.times[[0, -1]])
        runs = f"{len(self.states)} runs of " if self.is_ensemble else ""
        failed = f", {len(self.errors)} of which could not go on" if self.errors else ""
        seen = f", {len(self.events)} events" if self.events else ""
        size = f"{runs}{len(self.times)} times, t = {first} to {last}{failed}{seen}"
        return f"<Trajectory of {', '.join(self.names)}: {size}>"

    def _repr_html_(self) -> str:
        title, size = f"Trajectory of {', '.join(self.names)}", repr(self).partition(": ")[2][:-1]
        return series_views.card(title, size, {} if self.is_ensemble else self._columns, self.units, {})

    @property
    def is_ensemble(self) -> bool:
        """Whether it holds several runs."""
        return self.states.ndim == 3

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates, and of the internal states."""
        return (*self.coordinates, *self.internal)

    def run(self, number: int) -> Trajectory:
        """One run of an ensemble, numbered from 0; an ModelError says that it could not go on, or is none."""
        if number in self.errors:
            raise ModelError(f"run {number}: {self.errors[number]}")
        if not self.is_ensemble or not 0 <= number < len(self.states):
            raise ModelError(f"there is no run {number}: {self!r}")
        return replace(self, states=self.states[number], errors={})

    @property
    def _columns(self) -> dict[str, Array]:
        if self.is_ensemble:
            raise ModelError(f"name one of {len(self.states)} runs, such as trajectory.run(0)")
        return {"t": self.times, **{name: self[name] for name in self._states}}

    @property
    def _states(self) -> list[str]:
        return [*self.coordinates, *(f"{name}'" for name in self.coordinates), *self.internal]

    def to_pandas(self) -> Any:  # noqa: ANN401  # pandas is optional
        """Pandas DataFrame of the states over the time, with `units` in its `attrs`.

        Raises:
            RecordError: pandas is not installed.
            ModelError: it is an ensemble; take a `run` of it.
        """
        return series_views.frame(self._columns, self.units, {})

    def plot(self, *names: str) -> axes.NotebookFigure:
        """Draw states over the time; a notebook shows the figure.

        Args:
            names: of coordinates, rates (`x1'`) and internal states, each in axes of its own; by default all
                but the rates, those of one unit in common axes.

        Raises:
            ModelError: there is no such state, or it is an ensemble; take a `run` of it.
        """
        columns, rows = self._columns, dict[str, list[str]]()
        for name in names or self.names:
            _ = self[name]
            rows.setdefault(name if names else self.units.get(name, ""), []).append(name)
        return series_views.figure(columns, self.units, [*rows.values()], "")

    @property
    def positions(self) -> Array:
        """Coordinates (m, n), or (runs, m, n)."""
        return self.states[..., : len(self.coordinates)]

    @property
    def velocities(self) -> Array:
        """Velocities (m, n), or (runs, m, n)."""
        n = len(self.coordinates)
        return self.states[..., n : 2 * n]

    def __getitem__(self, name: str) -> Array:
        """One coordinate (`x1`), velocity (`x1'`) or internal state over time (m,), or (runs, m); a ModelError else."""
        if name in self.internal:
            return self.states[..., 2 * len(self.coordinates) + self.internal.index(name)]
        if name.removesuffix("'") not in self.coordinates:
            raise ModelError(f"there is no state '{name}'; {nearest(name, self._states)}")
        index = self.coordinates.index(name.removesuffix("'"))
        return self.states[..., index + (len(self.coordinates) if name.endswith("'") else 0)]
