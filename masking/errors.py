"""Exceptions that say what is wrong, where (file:line:column) and how to correct it.

Every exception of the package is a `MaskingError` and carries the exit status of the command line: 2 where the
declaration or the call is at fault and running again cannot help, 1 where a run was started and stopped.
"""

from __future__ import annotations

import difflib
import errno
from collections.abc import Iterable, Mapping, Set
from dataclasses import asdict, dataclass
from typing import ClassVar

_SHOWN_NAMES = 8
# Keys of files, options of the command line and entries of manifests that have another name than they once had.
RENAMED = {
    "wiring": "allocation",
    "approach": "homing",
    "between": "hold",
    "horizon": "shooting_interval",
    "fidelity": "masking_error",
}
NO_PLACE = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS})  # where a disk takes no more


@dataclass(frozen=True, slots=True)
class Place:
    """A position in a text file; line and column count from 1."""

    file: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}"


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong.

    `place` is None for text that came from no file; `path` is the dotted path of the value inside its file; `excerpt`
    holds the source line and a caret line below it where the problem lies inside an expression.
    """

    place: Place | None
    path: str
    message: str
    remedy: str = ""
    excerpt: str = ""

    def __str__(self) -> str:
        where = [str(part) for part in (self.place, self.path) if part]
        line = ": ".join([*where, self.message])
        if self.remedy:
            line += f"; {self.remedy}"
        return f"{line}\n{self.excerpt}" if self.excerpt else line

    def as_dict(self) -> dict[str, str | int | None]:
        """Give the problem as JSON can hold it; file, line and column are None for text that came from no file."""
        place = asdict(self.place) if self.place else dict.fromkeys(("file", "line", "column"))
        return {**place, "path": self.path, "message": self.message, "remedy": self.remedy}


class MaskingError(Exception):
    """Base of every exception this package raises on purpose."""

    exit_status: ClassVar[int] = 1


class DeclarationError(MaskingError):
    """A declaration is wrong; holds every problem found, one per line of the message."""

    exit_status = 2

    def __init__(self, problems: Problem | Iterable[Problem]) -> None:
        self.problems: tuple[Problem, ...] = (problems,) if isinstance(problems, Problem) else tuple(problems)
        super().__init__(self.problems)

    def __str__(self) -> str:
        return "\n".join(str(problem) for problem in self.problems)


class ModelError(MaskingError):
    """The equations of a model cannot be brought into the form that was asked for; `problem` says where, if known."""

    exit_status = 2

    def __init__(self, message: str, problem: Problem | None = None) -> None:
        self.problem = problem
        super().__init__(message, problem)

    def __str__(self) -> str:
        return str(self.problem if self.problem and self.problem.place else self.args[0])


class ActuationError(MaskingError):
    """The actuators cannot make some coordinates move as asked; `coordinates` names them."""

    exit_status = 2

    def __init__(self, message: str, coordinates: Iterable[str] = ()) -> None:
        self.coordinates: tuple[str, ...] = tuple(coordinates)
        super().__init__(message, self.coordinates)

    def __str__(self) -> str:
        return str(self.args[0])


class SingularityError(MaskingError):
    """A matrix that must be inverted became singular on the way; holds the time and the state at which it did."""

    def __init__(self, message: str, time: float, state: Mapping[str, float], remedy: str = "") -> None:
        self.time = time
        self.state: dict[str, float] = dict(state)
        self.remedy = remedy
        super().__init__(message, self.time, self.state, remedy)

    def __str__(self) -> str:
        state = ", ".join(f"{name} = {value:.6g}" for name, value in self.state.items())
        remedy = f"; {self.remedy}" if self.remedy else ""
        return f"{self.args[0]} at t = {self.time:.6g}" + (f" ({state})" if state else "") + remedy


class IntegrationError(MaskingError):
    """An integrator could not go on."""


class UnreachableError(IntegrationError):
    """No input does what is wanted of it, such as a magnet that should push."""


class RootError(MaskingError):
    """Newton's method reached no root; says where it ended."""


class HoursUsedError(MaskingError):
    """The time for which a rig may be used is over."""


class RecordError(MaskingError):
    """A recording cannot be read or written."""

    exit_status = 2


class ColumnError(RecordError):
    """A recording lacks the column of a sensor or an actuator."""


class OperatorError(MaskingError):
    """What is asked for the operator of a run cannot be had: a port, an address, or that a run goes on."""

    exit_status = 2


class PlantError(MaskingError):
    """A plant could not do what was asked of it."""


class PlantLostError(PlantError):
    """A plant does not answer, or ended the session; says which and how to get it back."""


class SamplesLostError(PlantLostError):
    """Too many samples of a plant in a row did not arrive."""


class EmergencyStopError(PlantError):
    """The emergency stop of a plant is pressed."""


class PlantOrderError(PlantError):
    """A plant was used out of the order configure, activate, read and write, deactivate."""

    exit_status = 2


class PlantRefusedError(PlantError):
    """A plant refused a controller, such as a second one."""


class PlantMismatchError(PlantError):
    """Channels or settings of a plant are not those that the controller was made for."""

    exit_status = 2


class CommandError(PlantError):
    """A command is not one finite number for each actuator."""


class WireError(PlantError):
    """A datagram is no frame that may be used; `cause` is the word that it is counted under."""

    def __init__(self, cause: str, message: str) -> None:
        self.cause = cause
        super().__init__(cause, message)

    def __str__(self) -> str:
        return f"{self.args[0]}: {self.args[1]}"


def nearest(name: str, allowed: Iterable[str]) -> str:
    """Say which allowed name was probably meant, or list what is allowed."""
    names = sorted(allowed) if isinstance(allowed, Set) else list(dict.fromkeys(allowed))
    if RENAMED.get(name) in names:
        return f"it is called '{RENAMED[name]}' now"
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.6 if len(name) > 3 else 0.5)
    if not close:
        lowered = {candidate.lower(): candidate for candidate in names}
        close = [lowered[name.lower()]] if name.lower() in lowered else []
    if close:
        return f"did you mean '{close[0]}'?"
    if not names:
        return "no name is allowed here"
    shown = ", ".join(names[:_SHOWN_NAMES])
    more = len(names) - _SHOWN_NAMES
    return f"allowed: {shown}" + (f" and {more} more" if more > 0 else "")
