"""Summary: what the manifest says of the rows of a run, gathered while they come in chunks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, final

from masking.analysis.masking_error import ErrorSum
from masking.compile.numerics.arrays import Array
from masking.lab.runs.passive_coordinates import Passive


@final
class Summary:
    """Numbers of a run that need all of its rows, but not all at once.

    `first` is the first row of the virtual coordinates, by name, `last` the last time in s, and `passive` what the
    passive coordinates did, for the manifest; None where there are none. They are the first of those given, of the
    plant or of the controller's model, whose rig has its columns.
    """

    def __init__(self, virtual: Sequence[str], passive: Sequence[Passive | None]) -> None:
        self._errors, self._passive = {name: ErrorSum() for name in virtual}, passive
        self.first, self.last = dict[str, float](), 0.0
        self.passive: dict[str, Any] | None = None

    def add(self, columns: Mapping[str, Array]) -> None:
        """Add a chunk of rows: the columns of the recording (m,), by name."""
        self.first = self.first or {name: float(columns[f"virtual.{name}"][0]) for name in self._errors}
        self.last = float(columns["t"][-1])
        for name, errors in self._errors.items():
            errors.add(columns[f"virtual.{name}"], columns[f"ideal.{name}"])
        for passive in filter(None, self._passive):
            if not columns.keys() >= {f"rig.{name}" for name in passive.plant.coordinates}:
                continue
            entry = passive.entry(columns)
            self.passive = entry if self.passive is None else Passive.merged(self.passive, entry)
            break

    @property
    def masking_error(self) -> dict[str, float]:
        """Masking error of each virtual coordinate."""
        return {name: errors.value for name, errors in self._errors.items()}
