"""Stopping: the condition that ends a run before its planned end, offline and on a rig alike."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Final, TypeVar

import numpy as np

from masking.analysis.synchronisation import Detector, period
from masking.analysis.synchronisation.detector import PHASES
from masking.declaration.schema import Stop
from masking.errors import ModelError
from masking.modelling.model import Model
from masking.numerics.arrays import Array
from masking.runs.offline import Run, TwinRun

SYNCHRONISED: Final = "synchronised"
_ROWS: Final = 2**15  # of the ideal motion, of which the period is taken
_AnyRun = TypeVar("_AnyRun", Run, TwinRun)


@dataclass(frozen=True)
class StopCondition:
    """The end of a run by synchronisation.

    Args:
        settings: as the experiment declares them.
        names: the two virtual coordinates.
        columns: where they are among the virtual coordinates.
        detector: in units of virtual time; it takes a sample for each recorded row.
    """

    settings: Stop
    names: tuple[str, str]
    columns: tuple[int, int]
    detector: Detector

    @classmethod
    def of(cls, settings: Stop, virtual: Model, initial: Array, *, step: float, duration: float) -> StopCondition:
        """Return the end of a run, whose period is that of the virtual system by itself where none is declared.

        Args:
            settings: as declared.
            virtual: the virtual system.
            initial: its initial state (2 k,).
            step: virtual time between recorded rows.
            duration: virtual time.

        Raises:
            ModelError: the first of the two does not oscillate, or rows are too far apart.
        """
        first, second = settings.of or virtual.oscillators[:2]
        columns = (virtual.coordinates.index(first), virtual.coordinates.index(second))
        length = settings.period
        if length is None:
            times, u = np.linspace(0.0, duration, _ROWS), np.zeros(len(virtual.inputs))
            moved = virtual.kernels.integrate(times, initial, u, virtual.values(), tolerance=1e-8)
            length = period(times, moved.states[:, columns[0]])
            if not np.isfinite(length):
                raise ModelError(
                    f"stop: within the duration, {first} of {virtual.name} makes fewer than three oscillations, so "
                    "that its period is not known; give stop.period, in units of virtual time"
                )
        if length < 8.0 * step:
            raise ModelError(
                f"stop: a period of {first} takes {length:.4g} units of time, and rows are recorded every {step:.4g}; "
                "record at least eight rows in a period: raise record.rate"
            )
        detector = Detector(
            length, step, settings.eps, PHASES[settings.phase], settings.false_alarm, duration, settings.memory
        )
        return cls(settings, (first, second), columns, detector)

    def row(self, virtual: Array) -> int | None:
        """Return the row of virtual coordinates (m, .) at which the run ends, None where it goes on to its end."""
        step = self.detector.begin().step
        a, b = (virtual[:, column].tolist() for column in self.columns)
        return next((i for i, (x, y) in enumerate(zip(a, b, strict=True)) if step(x, y)), None)

    def entry(self, at: float | None) -> dict[str, Any]:
        """Return why the run ended, for the manifest; `at` is the virtual time of synchronisation, None for none."""
        detector = self.detector
        return {
            "when": SYNCHRONISED,
            "met": at is not None,
            "at": at,
            "of": [*self.names],
            "phase": self.settings.phase,
            "eps": detector.eps,
            "false_alarm": detector.false_alarm,
            "period": detector.period,
            "periods_needed": detector.needed / 2.0,
            "memory": detector.memory,
            "resolution": detector.resolution,
            "duration": detector.duration,
        }


def cut(run: _AnyRun, rows: int) -> _AnyRun:
    """Return the first rows of a run."""
    return replace(run, **{part.name: getattr(run, part.name)[:rows] for part in fields(run)})
