"""Stopping: why a run stopped, in words, and the condition that ends one before its planned end.

A run on a rig ends for one of `REASONS`, the `rig.end` of its manifest. A simulated one that cannot go on raises what
`check_status` makes of its kernel's status; `masking.compile.numerics.stop_codes` has what each status means.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from masking.analysis.synchronisation import Detector, period
from masking.analysis.synchronisation.detector import PHASES
from masking.compile.codegen.compiled_functions import Kernels
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.stop_codes import NOT_FINITE, REACHED
from masking.control.cancellation import INVERTIBLE
from masking.errors import IntegrationError, ModelError
from masking.model.declaration.schema import Stop
from masking.model.modelling.model import Model

FINISHED: Final = "finished"
SYNCHRONISED: Final = "synchronised"
STOPPED: Final = "stopped"
INTERRUPTED: Final = "interrupted"
LOST: Final = "plant lost"
TRIPPED: Final = "tripped"
FAILED: Final = "failed"
FULL: Final = "disk full"
KILLED: Final = "killed"
REASONS: Final = {
    FINISHED: "its planned time has passed",
    SYNCHRONISED: "the two coordinates of its stop condition have synchronised",
    STOPPED: "whoever started it asked it to stop",
    INTERRUPTED: "SIGINT, SIGTERM or SIGHUP came",
    LOST: "the plant ended the session, or did not answer in time",
    TRIPPED: "the safety chain found a fault, which is under rig.trip",
    FAILED: "an error was raised",
    FULL: "no place was left for the rows that go to disk during a run",
    KILLED: "its process ended before it saved the recording, which was made of its stream",
}
_ROWS: Final = 2**15  # of the ideal motion, of which the period is taken


def check_status(kernels: Kernels, status: int, time: float, state: Array, remedy: str) -> None:
    """Raise what the status of a closed loop's kernel stands for, unless it reached its end.

    `time` in s and `state` are those at which it stopped; `remedy` is what to do about a rig that became unstable. A
    SingularityError, which holds the state, or an IntegrationError.
    """
    if status == NOT_FINITE and not kernels.unsolved(status, state):
        raise IntegrationError(f"the masked rig became unstable and grew without bound by t = {time:.6g} s: {remedy}")
    if status != REACHED:
        kernels.stop(status, time, state, INVERTIBLE)


@dataclass(frozen=True)
class StopCondition:
    """The end of a run by synchronisation."""

    settings: Stop  # as the experiment declares them
    names: tuple[str, str]  # the two virtual coordinates
    columns: tuple[int, int]  # where they are among the virtual coordinates
    detector: Detector  # in units of virtual time; it takes a sample for each recorded row

    @classmethod
    def of(cls, settings: Stop, virtual: Model, initial: Array, *, step: float, duration: float) -> StopCondition:
        """End of a run, whose period is that of the virtual system by itself where none is declared.

        The initial state is (2 k,), and the step between recorded rows and the duration are virtual times. A ModelError
        where the first of the two does not oscillate, or rows are too far apart.
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

    def watch(self) -> Callable[[Array], int | None]:
        """Function of virtual coordinates (m, .), chunk after chunk: the row at which the run ends, or None."""
        step = self.detector.begin().step

        def row(virtual: Array) -> int | None:
            a, b = (virtual[:, column].tolist() for column in self.columns)
            return next((i for i, (x, y) in enumerate(zip(a, b, strict=True)) if step(x, y)), None)

        return row

    def entry(self, at: float | None) -> dict[str, Any]:
        """End of the run, for the manifest; `at` is the virtual time of synchronisation, None for none."""
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
