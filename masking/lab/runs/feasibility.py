"""Feasibility: what a wanted motion asks of a rig's actuators and stroke, before anything is run on it.

The controller's own model stands for the rig, and the control law acts in continuous time: the rig then moves exactly
as the virtual system does. What that takes is compared with the limits of the plant file, and what would have to change
so that it fits is found by simulating the changed motion.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.compile.numerics.controller_sizes import HEATING, LARGEST, POWER, TIME
from masking.control.cancellation import INVERTIBLE
from masking.control.closed_loop import ClosedLoop
from masking.control.zero_dynamics import ZeroDynamics
from masking.display.printed_result import Printed
from masking.errors import (
    DeclarationError,
    IntegrationError,
    MaskingError,
    ModelError,
    Problem,
    SingularityError,
    UnreachableError,
)
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.growth_along_motion import Growth
from masking.lab.runs.passive_coordinates import Passive
from masking.lab.runs.simulated_run import Run, complete, loop_state, rig_state
from masking.lazy_imports import signal
from masking.model.declaration.expression import Expression
from masking.model.declaration.operations import CONSTANTS, OPERATIONS, Step
from masking.model.declaration.quantities import number, percent
from masking.model.modelling import input_series

# Rows per unit of virtual time at first; they are doubled until no peak changes by more than the tolerance.
ROWS_PER_UNIT = 10
FEWEST_ROWS, MOST_ROWS = 1_000, 400_000
MOST_HALVINGS = 10  # of a motion that cannot be followed to its end
TOLERANCE = 1e-4  # relative error of a peak, and by how much a limit may be passed
BISECTED = 1e-4  # of a factor, to which it is found
BEYOND = 1e3  # of a limit: a need that is greater is not stated in digits
# Tried in turn: slower motion up to 64 times, faster up to 16 times, and less stroke or amplitude down to 1/256.
SLOWER = tuple(2.0 ** (i / 4) for i in range(1, 25))
FASTER = tuple(2.0 ** (-i / 4) for i in range(1, 17))
SMALLER = tuple(2.0 ** (-i / 2) for i in range(1, 17))

What = Literal["time_scale", "transform", "initial"]
LADDERS: Mapping[What, Sequence[Sequence[float]]] = {
    "time_scale": (SLOWER, FASTER), "transform": (SMALLER,), "initial": (SMALLER,),
}  # fmt: skip


@dataclass(frozen=True, repr=False)
class Use(Printed):
    """How much of one limit a motion uses."""

    name: str  # of the actuator, or the expression that is limited
    # of the limit: the largest command, its largest rate, the largest mean power, or the largest value of a coordinate
    kind: Literal["command", "rate", "power", "coordinate"]
    needed: float  # largest magnitude over the motion, in `unit`
    limit: float  # largest magnitude that the plant file allows, in `unit`
    unit: str  # of both

    @property
    def part(self) -> float:
        """Need per allowance."""
        return self.needed / self.limit

    @property
    def fits(self) -> bool:
        """Whether the limit holds."""
        return self.part <= 1.0 + TOLERANCE

    @property
    def label(self) -> str:
        """Limited quantity, in words."""
        return {"power": "mean power of ", "rate": "rate of "}.get(self.kind, "") + self.name

    @property
    def used(self) -> str:
        """Part of the limit in words."""
        return percent(self.part, 3) if self.part <= BEYOND else f"over {100.0 * BEYOND:.0f} %"

    @property
    def row(self) -> tuple[str, str, str, str]:
        """Limited quantity, need, limit and part, in words."""
        least = f"over {_digits(BEYOND * self.limit)}"
        needed = _digits(self.needed) if self.part <= BEYOND else least
        return self.label, f"{needed} {self.unit}", f"{_digits(self.limit)} {self.unit}", self.used

    def __str__(self) -> str:
        return f"{self.label} needs {self.used} of {_digits(self.limit)} {self.unit}".rstrip()


@dataclass(frozen=True, repr=False)
class Remedy(Printed):
    """One change that makes a motion fit, or that was tried in vain."""

    what: What  # the seconds per unit of virtual time, the stroke that the transform uses, or all initial values
    factor: float | None  # what to multiply it by, the one nearest to 1 that fits; None where none does
    shown: float | None = None  # the factor in few digits, rounded to the side that fits
    # where no factor fits, the limits that each of them passes, with the least use; where there is none such, those
    # that are passed under the factor that comes nearest
    left: tuple[Use, ...] = ()

    def __str__(self) -> str:
        if self.factor is None or self.shown is None:
            return f"{_NOTHING[self.what]} not help: {'; '.join(map(str, self.left))} even then"
        if self.what == "time_scale":
            is_slower = self.factor > 1.0
            change = f"{self.shown:g} times slower" if is_slower else f"{_digits(1.0 / self.shown)} times faster"
            return f"time_scale x {self.shown:g} (a virtual system {change})"
        if self.what == "transform":
            return f"a transform that maps to {self.shown:g} of the stroke"
        return f"initial values x {self.shown:g}"


_NOTHING = {
    "time_scale": "another time_scale alone does",
    "transform": "a mapping to less stroke alone does",
    "initial": "smaller initial values alone do",
}


@dataclass(frozen=True, repr=False)
class Feasibility(Printed):
    """What the ideal motion of an experiment asks of its rig, and what to change where that is too much."""

    name: str  # of the experiment
    uses: tuple[Use, ...]  # each limit and how much of it is used
    remedies: tuple[Remedy, ...] = ()  # what was tried where a limit is passed; empty where the motion fits
    notes: tuple[str, ...] = ()  # how what is passive moves, and what could not be determined
    zero_dynamics: tuple[ZeroDynamics, ...] = ()  # of passive coordinates, at rest and along the wanted motion

    @property
    def fits(self) -> bool:
        """Whether every limit holds."""
        return all(use.fits for use in self.uses)

    def __getitem__(self, label: str) -> Use:
        """Use of a limit by its label, such as "V1", "mean power of V1" or "x1 - x3"."""
        return next(use for use in self.uses if use.label == label)

    @property
    def verdict(self) -> str:
        """Whether it fits and what to change, in words."""
        if self.fits:
            return f"fits: {max(self.uses, key=lambda use: use.part)} at most"
        needs = "; ".join(str(use) for use in sorted(self.uses, key=lambda use: -use.part) if not use.fits)
        ways = ", or ".join(str(remedy) for remedy in self.remedies if remedy.factor is not None)
        vain = [str(remedy) for remedy in self.remedies if remedy.factor is None]
        growing = [", ".join(one.names) for one in self.zero_dynamics[-1:] if one.verdict == "unstable"]
        if growing and vain:  # what grows passes any limit, whatever it began with
            vain = [
                f"while the virtual coordinates follow, what is passive ({growing[0]}) grows: in these coordinates the "
                "rig is non-minimum phase. Mask others, whose zero dynamics are stable"
            ]
        parts = [f"does not fit: {needs}", f"To fit: {ways}" if ways else "", *(f"{v[0].upper()}{v[1:]}" for v in vain)]
        return ". ".join(part for part in parts if part)

    @property
    def headline(self) -> str:
        """Name of the experiment, and its verdict."""
        return f"{self.name}: {self.verdict}"

    def __str__(self) -> str:
        rows = [("", "needed", "limit", "used"), *(use.row for use in self.uses)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = [
            f"  {name:{widths[0]}}  " + "  ".join(f"{x:>{w}}" for x, w in zip(rest, widths[1:], strict=True))
            for name, *rest in rows
        ]
        return "\n".join([*lines, *(f"  {note}" for note in self.notes), f"  {self.verdict}"])

    def as_dict(self) -> dict[str, Any]:
        """Everything as JSON can hold it."""
        return {
            "fits": self.fits,
            "verdict": self.verdict,
            "limits": [
                {"name": u.name, "kind": u.kind, "needed": u.needed, "limit": u.limit, "unit": u.unit, "used": u.part}
                for u in self.uses
            ],
            "remedies": [
                {"change": m.what, "factor": m.factor, "left": [u.label for u in m.left]} for m in self.remedies
            ],
            "notes": list(self.notes),
            "zero_dynamics": [one.as_dict() for one in self.zero_dynamics],
        }


def feasibility(experiment: Experiment) -> Feasibility:
    """Compare what the ideal motion of a sound experiment needs with the limits of its plant.

    A limit of mean power is compared if the plant file gives the heating of an actuator: the power `heating c^2` of a
    command c, averaged as the sampled controller does it, with the time constant of the plant file, from rest.

    A ModelError where an actuator has no largest command or no rig position gives the initial state, an ActuationError
    where the actuators cannot give what the control law asks for, and a DeclarationError, with the place of what is to
    blame, where the motion cannot be followed to its end.
    """
    motion = Motion(experiment)
    try:
        uses, rows, settled = motion.resolve()
    except (SingularityError, IntegrationError) as error:
        raise DeclarationError(_problem(motion, error)) from error
    unsettled = () if settled else (f"peaks between the {rows} rows of the simulation may be higher",)
    passive = motion.zero_dynamics(partial(motion.simulate, rows))
    notes = (*map(str, passive), *motion.notes, *unsettled)
    remedies = () if all(use.fits for use in uses) else tuple(_remedy(motion, what, rows, uses) for what in LADDERS)
    known = tuple(one for one in passive if isinstance(one, ZeroDynamics))
    return Feasibility(experiment.declaration.name, uses, remedies, notes, known)


@dataclass(frozen=True)
class Motion:
    """The ideal motion of an experiment: the controller's model, moved by the control law in continuous time."""

    experiment: Experiment

    @cached_property
    def loop(self) -> ClosedLoop:
        """Controller with its own model as the plant."""
        controller = self.experiment.law
        return ClosedLoop(controller, controller.model)

    @property
    def notes(self) -> tuple[str, ...]:
        """How inputs act, what the controller's model does not have, and which limits cannot be compared."""
        power, subject = self.experiment.assembly.plant.limits.power, self.experiment
        how = subject.acting_law.approach
        notes = (*([how] if how else []), *self._unknown())
        live = [name for name, source in self.experiment.declaration.inputs.items() if source.is_live]
        notes = (*notes, f"without {', '.join(live)}, which is known in a run only") if live else notes
        if power is None or power.heating is not None:
            return notes
        return (*notes, "mean power is unknown: the plant file has no limits.power.heating")

    def followed(self) -> Run | None:
        """The motion over the first half of the run, or a half of that, as far as it can be followed; None if not."""
        for halvings in range(1, MOST_HALVINGS):
            with contextlib.suppress(SingularityError, IntegrationError):
                return self.simulate(FEWEST_ROWS, part=0.5**halvings)
        return None

    def zero_dynamics(self, follow: Callable[[], Run | None]) -> tuple[ZeroDynamics | ModelError, ...]:
        """How what is passive moves at rest and along the motion that `follow` gives, or why that is not known.

        The motion is asked for only where something is passive.
        """
        passive, found = self.experiment.assumed_passive, list[ZeroDynamics | ModelError]()
        if passive is None:
            return ()
        moving: list[Passive | Growth] = [passive]
        if (run := follow()) is not None:
            moving.append(Growth(self.loop, run, self.experiment.inputs.of_rig(self.experiment.time_scale)))
        for one in moving:
            try:
                found.append(one.zero_dynamics)
            except ModelError as error:
                found.append(error)
        return tuple(found)

    def _unknown(self) -> tuple[str, ...]:
        """What of the plant the controller's model does not have."""
        match, model = self.experiment.match, self.experiment.law.model.name
        if match.is_same:
            idle = self.experiment.sampled.unused if self.experiment.has_observer else ()
            why = (
                "others tell the coordinates, and the model alone ties what it reads to them; 'observer: {at: inputs}' "
                "follows it where that model is right"
            )
            return tuple(f"{name}: not used, {why}" for name in idle)
        own = ", ".join(match.own)
        words = f" ({self.experiment.passive.words})" if self.experiment.passive else ""
        notes = [f"{own}: the plant's own, not in the controller's model {model}{words}"] if own else []
        given = self.experiment.assembly.plant.sensors
        seen = self.experiment.instruments.plant.sensors
        unused = [n for n, s in seen.items() if s.measures.text == "0" != given[n].measures.text]
        notes += [f"{', '.join(unused)}: not used, the controller's model {model} has nothing that it reads"] * any(
            unused
        )
        return tuple(notes)

    def resolve(self) -> tuple[tuple[Use, ...], int, bool]:
        """Uses of the limits, the rows of the simulation that show them, and whether these were enough."""
        rows = round(ROWS_PER_UNIT * self.experiment.declaration.duration)
        rows = min(MOST_ROWS, max(FEWEST_ROWS, rows)) + 1
        uses = self.uses(rows)
        while 2 * rows <= MOST_ROWS:
            before, rows = uses, 2 * rows - 1
            uses = self.uses(rows)
            if all(new.needed - old.needed <= TOLERANCE * new.limit for old, new in zip(before, uses, strict=True)):
                return uses, rows, True
        return uses, rows, False

    def uses(self, rows: int, what: What = "time_scale", factor: float = 1.0) -> tuple[Use, ...]:
        """How much of each limit the motion uses, looked at in `rows` instants, with a change of the experiment.

        Raises what `simulate` does, and a ModelError as `feasibility` does.
        """
        experiment, instruments, model = self.experiment, self.experiment.instruments, self.experiment.law.model
        plant = instruments.plant
        table = instruments.limits()
        run = self.simulate(rows, what, factor)
        times, states, commands = run.times, run.rig, run.inputs @ instruments.allocation_inverse.T
        found, sizes = [], experiment.twin.size
        for i, name in enumerate(instruments.actuators):
            declared = plant.limits.inputs[name]
            size = sizes(declared.unit) / sizes(instruments.unit(name))
            peak = float(np.abs(commands[:, i]).max())
            found.append(Use(name, "command", peak / size, table[i, LARGEST] / size, declared.unit))
            if declared.rate is not None:
                fastest = float(np.abs(np.diff(commands[:, i])).max()) / float(times[1] - times[0])
                found.append(Use(name, "rate", fastest / size, declared.rate, f"{declared.unit}/s"))
        power = plant.limits.power
        for i, name in enumerate(instruments.actuators):
            if power is not None and table[i, HEATING] > 0.0:
                size = sizes(power.unit)
                mean = mean_power(table[i, HEATING] * commands[:, i] ** 2, times[1] - times[0], table[i, TIME])
                found.append(Use(name, "power", float(mean.max()) / size, table[i, POWER] / size, power.unit))
        names = [*model.coordinates, *(f"{c}'" for c in model.coordinates)]
        columns = model.parameter_values() | dict(zip(names, states[:, : len(names)].T, strict=True))
        for expression, limit in plant.limits.coordinates.items():
            peak = float(np.abs(evaluate(expression, columns)).max()) / sizes(limit.unit)
            found.append(Use(expression.text, "coordinate", peak, limit.max, limit.unit))
        return tuple(found)

    def simulate(self, rows: int, what: What = "time_scale", factor: float = 1.0, part: float = 1.0) -> Run:
        """The motion at `rows` instants, with the states of the closed loop as those of the rig.

        The factor multiplies the seconds per unit of virtual time, the stroke that the transform uses, or all initial
        values; `part` of the duration is followed. A SingularityError or IntegrationError where it cannot be.
        """
        time, stroke, amplitude = (factor if what == one else 1.0 for one in LADDERS)
        experiment = self.experiment
        controller = experiment.law
        changed = replace(controller, time_scale=controller.time_scale * time, stroke=stroke)
        loop, passive = ClosedLoop(changed, changed.model), experiment.assumed_passive
        start = amplitude * experiment.virtual_start
        beside = passive.scaled(amplitude, stroke).initial() if passive else None
        state, p = loop_state(loop, start, rig_state(loop, start, passive=beside)), loop.values()
        times = np.linspace(0.0, part * experiment.declaration.duration * changed.time_scale, rows)
        schedule = experiment.inputs.of_rig(changed.time_scale)
        u, tolerance = np.zeros(len(loop.plant.inputs)), experiment.declaration.tolerance
        found = input_series.integrate(loop.kernels, times, state, u, p, schedule=schedule, tolerance=tolerance)
        run = complete(loop, times, found.states, p, schedule)
        if not (np.isfinite(run.inputs).all() and np.isfinite(run.rig).all()):
            raise IntegrationError("the state or the inputs are no longer finite numbers")
        return run


def mean_power(power: Array, step: float, time: float) -> Array:
    """Exponential mean P of a power p (m,), with P' = (p - P) / time and P = 0 at first; `step` and `time` in s."""
    kept = math.exp(-step / time)
    halves = 0.5 * (1.0 - kept) * (power[1:] + power[:-1])
    return np.concatenate([[0.0], np.asarray(signal.lfilter([1.0], [1.0, -kept], halves), dtype=np.float64)])


def evaluate(expression: Expression, columns: Mapping[str, Array | float]) -> Array:
    """Values of an expression (m,) for columns (m,) or numbers by symbol, primes included."""
    try:
        return np.atleast_1d(np.asarray(expression.walk(_Columns(columns)), dtype=float))
    except (ArithmeticError, ValueError):  # row by row, a branch of `where` that is not chosen does no harm
        rows = max(np.size(column) for column in columns.values())
        table = {name: np.broadcast_to(column, rows) for name, column in columns.items()}
        return np.array([expression.evaluate({name: c[i] for name, c in table.items()}) for i in range(rows)])


@dataclass(frozen=True)
class _Columns:
    """Numbers, a column at a time."""

    columns: Mapping[str, Array | float]

    def number(self, step: Step) -> Any:  # noqa: ANN401  (a number, or a column of them)
        return CONSTANTS[step.value] if step.value in CONSTANTS else float(step.value)

    def symbol(self, step: Step) -> Any:  # noqa: ANN401
        return self.columns[step.value]

    def apply(self, step: Step, args: Sequence[Any]) -> Any:  # noqa: ANN401
        number = OPERATIONS[step.operation].number
        if step.operation in {"+", "-", "*", "negative", "abs"}:
            return number(*args)
        return np.asarray(np.frompyfunc(number, len(args), 1)(*args), dtype=float)


def _remedy(motion: Motion, what: What, rows: int, unchanged: tuple[Use, ...]) -> Remedy:
    """Search the factor nearest to 1 that makes a motion fit, ladder by ladder."""
    tried = [unchanged]

    def fits(factor: float) -> bool:
        try:
            tried.append(motion.uses(rows, what, factor))
        except MaskingError:  # the changed motion cannot be followed
            return False
        return _worst(tried[-1]) <= 1.0 + 0.01 * TOLERANCE

    for ladder in LADDERS[what]:
        outside = 1.0
        for factor in ladder:
            if fits(factor):
                found = _bisect(fits, outside, factor)
                shown = _outward(found)
                return Remedy(what, found, shown if fits(shown) else found)
            outside = factor
    least = [min(column, key=lambda use: use.part) for column in zip(*tried, strict=True)]
    never = tuple(use for use in least if not use.fits)
    together = tuple(use for use in min(tried, key=_worst) if not use.fits)
    return Remedy(what, None, None, never or together)


def _bisect(fits: Callable[[float], bool], outside: float, inside: float) -> float:
    """Factor at which a motion begins to fit, on the side that does."""
    while abs(inside - outside) > BISECTED * inside:
        middle = 0.5 * (inside + outside)
        outside, inside = (outside, middle) if fits(middle) else (middle, inside)
    return inside


def _worst(uses: Iterable[Use]) -> float:
    return max(use.part for use in uses)


def _outward(factor: float) -> float:
    """Round a factor away from 1, to two digits, or to three near 1."""
    digits = 2 if factor < 1.0 or factor >= 1.1 else 3
    unit = 10.0 ** (math.floor(math.log10(factor)) + 1 - digits)
    steps = factor / unit
    return float(f"{(math.ceil(steps - 1e-9) if factor > 1.0 else math.floor(steps + 1e-9)) * unit:.6g}")


def _digits(value: float) -> str:
    return number(value, 2) if abs(value) < 100.0 else number(round(value), 7)


def _problem(motion: Motion, error: MaskingError) -> Problem:
    """Fault of an experiment whose ideal motion cannot be followed, and its place."""
    experiment, declaration = motion.experiment, motion.experiment.declaration
    passive = motion.zero_dynamics(motion.followed)
    words = f" ({'; '.join(map(str, passive))})" if passive else ""
    if isinstance(error, SingularityError):
        path = "transform"
        message = f"the transform or the decoupling matrix becomes singular on the way{words}: {error}"
        remedy = INVERTIBLE
    elif isinstance(error, UnreachableError):
        path = "virtual"
        message = f"the virtual motion asks for what no input gives{words}: {error}"
        remedy = "choose a slower or smaller virtual motion, or give the actuator a bias: a weight, or a second one"
    elif _can_follow_virtual(experiment):
        path = "transform"
        message = f"the rig cannot be held on the way, although the virtual motion goes on{words}: {error}"
        remedy = "map the virtual coordinates to others of the rig, so that those that are passive return to rest"
    else:
        path = "initial"
        message = f"the virtual motion cannot be followed to its end: {error}"
        remedy = "start elsewhere, or change the virtual system so that it stays in reach"
    return Problem(declaration.key_place(path) or declaration.key_place("virtual"), path, message, remedy)


def _can_follow_virtual(experiment: Experiment) -> bool:
    """Whether the virtual system, by itself, moves on to the end of the experiment."""
    virtual, declaration = experiment.virtual, experiment.declaration
    start, inputs = experiment.virtual_start, np.zeros(len(virtual.inputs))
    try:
        schedule, span = experiment.inputs.schedule, np.array([0.0, declaration.duration])
        input_series.integrate(
            virtual.kernels, span, start, inputs, virtual.values(),
            schedule=schedule, tolerance=declaration.tolerance,
        )  # fmt: skip
    except (SingularityError, IntegrationError):
        return False
    return True
