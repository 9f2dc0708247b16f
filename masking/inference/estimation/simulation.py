"""Simulation: a record beside what a twin makes of its commands, from the initial state that comes nearest to it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.compile.numerics.least_squares import NO_BOUNDS, Damping, Linearised, System, minimise
from masking.control.rig.initial_internal_states import reaches
from masking.control.rig.twin import Twin
from masking.display.printed_result import Printed, aligned
from masking.errors import IntegrationError
from masking.inference.estimation import initial_states
from masking.inference.estimation.identification_data import NOT_LATE, Data
from masking.inference.estimation.initial_states import FIRST_READINGS, InitialPrior
from masking.inference.estimation.sensitivity import NormalEquations, Sensitivity
from masking.model.declaration.quantities import percent, quantity

# Parts of a record from which its initial state is estimated before the whole: friction has many minima.
PARTS = (1 / 64, 1 / 8)
DOUBLED = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2)  # the same where these lead nowhere
STUCK = 4.0  # cost per reading from which another initial state is sought
CLEAN = 1.2  # the same where time is no matter
SMALL = 1e-6  # part of a motion in which forces that grow faster than the displacement vanish
BESIDE = 1e-9  # displacement from rest at which sensors that fold are linearised
MOST_SIDES = 16  # combinations of sides of these that are tried
ROUNDS = 25  # steps for the initial state, at most
DAMPING = Damping(1e-9, least=1e-12, most=1e6)
SETTLED = 1e-9  # fraction of the cost that a step must take off
# Of the noise, or of what a model leaves where that is more: what smaller steps may change, and most refinement.
STEP_ERROR = 0.05
MOST_REFINEMENT = 16

_MORE = 1.2  # times the noise: from here on a residual is more than that


@dataclass(frozen=True, repr=False)
class Simulated(Printed):
    """What sensors read, and what they would read."""

    record: Data  # commands and readings
    sensors: tuple[str, ...]  # their names
    units: tuple[str, ...]  # of the readings
    readings: Array  # simulated (m, sensors), from the best initial state
    shooting_interval: float | None = None  # s of each simulation with its own initial state; None for a whole one

    @property
    def times(self) -> Array:
        """Times of the samples, s (m,)."""
        return np.asarray(np.arange(len(self.record)) / self.record.rate)

    @property
    def residual(self) -> Array:
        """Measured less simulated (m, sensors), 0 where commands from before the record act."""
        return self.record.residuals(self.readings)

    @property
    def chi(self) -> dict[str, float]:
        """Relative error of each sensor, by name. Source: Rijlaarsdam (2008), (4.12)."""
        return relative(self.sensors, [self.record], (self.residual**2).sum(axis=0))

    @property
    def floor(self) -> dict[str, float]:
        """Relative error that the noise of the record alone makes, by name."""
        return noise_alone(self.sensors, [self.record])

    def verdict(self, which: str = "") -> str:
        """Comparison of the residual with the noise floor, as a sentence; `which` is a word for the record."""
        chi, floor, record = self.chi, self.floor, f"{which} record".lstrip()
        if self.shooting_interval:
            record += f", simulated in intervals of {quantity(self.shooting_interval, 's')},"
        if more := [f"{n} {percent(chi[n])} ({percent(floor[n])})" for n in chi if chi[n] > _MORE * floor[n]]:
            above = f"In the {record} the residual is above the noise floor (in brackets), as part of the readings"
            return f"{above}: {', '.join(more)}"
        sensors = ", ".join(f"{name} {percent(chi[name])}" for name in chi)
        return f"In the {record} the residual is hardly above the noise floor: {sensors} of the readings"

    @property
    def headline(self) -> str:
        """Its verdict."""
        return self.verdict()

    def __str__(self) -> str:
        errors = (("error chi", self.chi), ("noise floor", self.floor))
        rows = [("", *self.sensors), *((what, *(percent(part[n]) for n in self.sensors)) for what, part in errors)]
        return "\n".join([*self.record.notes, f"{self.verdict()}.", *aligned(rows)])


def relative(sensors: Sequence[str], records: Sequence[Data], squares: Array) -> dict[str, float]:
    """Relative error (4.12) of each sensor, by name, from sums of squared errors over records (sensors,)."""
    whole = np.sum([np.sum(record.readings**2, axis=0) for record in records], axis=0)
    return dict(zip(sensors, map(float, np.sqrt(squares / np.maximum(whole, 1e-300))), strict=True))


def noise_alone(sensors: Sequence[str], records: Sequence[Data]) -> dict[str, float]:
    """Relative error that the noise of records alone makes, by name."""
    return relative(sensors, records, np.sum([len(record) * record.noise**2 for record in records], axis=0))


def validated(sensing: Sensitivity, theta: Array, unseen: Sequence[Data], weights: Array) -> dict[str, float]:
    """Relative error of each sensor over records that were not fitted, by name, with parameters (k,) in declared units.

    The initial state of each record is estimated, with weights of squared residuals (sensors,); errors as `nearest`.
    """
    every = (nearest(sensing, theta, record, weights)[1].squares for record in unseen)
    squares = sum(every, np.zeros(len(weights)))
    return relative(sensing.twin.sensors, unseen, squares)


def simulate(
    twin: Twin, record: Data, shared: Sequence[str] = (), initial: float | None = None, noise: Array | None = None
) -> Simulated:
    """Simulate a record from the initial state that reproduces it best.

    Args:
        twin: the plant, with the values to simulate with.
        record: commands and readings.
        shared: parameters that a fit had free: its compiled functions are then used again.
        initial: s from the beginning whose readings the initial state is estimated from; by default all. Readings that
            commands from before the record make count only where the others are too few: the first commands are then
            taken for these.
        noise: standard deviation of each reading (sensors,); by default that of the record.

    Raises:
        IntegrationError: the motion is not finite from any initial state that was tried.
    """
    sensing = Sensitivity(twin, (), tuple(shared))
    size = np.maximum(np.abs(record.readings).max(axis=0), 1e-300)
    noise = record.noise if noise is None else noise
    weights = np.maximum(noise, 1e-12 * size) ** -2.0
    beginning = record if initial is None else record.first(initial)
    if np.isfinite(beginning.counted()).sum() < len(twin.free):  # the first commands have acted before, too
        beginning = replace(beginning, commands=beginning.acting, late=NOT_LATE)
    theta, basis, least = sensing.start(), sensing.basis(sensing.start()), twin.resolving(record.rate)

    @cache
    def reproduced(number: int) -> tuple[Array, NormalEquations]:
        return nearest(sensing, theta, beginning, weights, steps=number, thorough=True)

    # At rest, where steps are chosen, what is fast may stand still, such as the slider of a play.
    most, any_change = MOST_REFINEMENT * least, np.full_like(size, np.inf)
    steps = refined(lambda number: reproduced(number)[1].simulated, least, most, any_change, ahead=1)
    state, found = reproduced(steps)

    def simulated(first: Array, number: int) -> Array:
        return sensing.normal_equations(basis, first, beginning, weights, number).simulated

    allowed, enough = STEP_ERROR * np.maximum(noise, np.sqrt(found.squares / len(beginning))), steps
    for begun in (state, first_start(sensing, beginning)):  # where larger steps have led, less may move
        enough = refined(partial(simulated, begun), enough, most, allowed, ahead=4)
    if enough > steps:
        tried = list[tuple[Array, NormalEquations]]()
        for first in (state, None):  # larger steps may have led to another minimum
            with suppress(IntegrationError):
                tried.append(nearest(sensing, theta, beginning, weights, first, steps=enough, thorough=True))
        state, found = min(tried, key=lambda one: float(one[1].squares @ weights), default=(state, found))
    if initial is not None:
        try:
            found = sensing.normal_equations(basis, state, record, weights, enough)
        except IntegrationError:
            raise IntegrationError(f"the simulated motion is no longer finite in {record.name}") from None
    plant = twin.declaration.sensors
    units = tuple("" if plant[name].unit == "1" else plant[name].unit for name in twin.sensors)
    return Simulated(record, twin.sensors, units, found.simulated)


def in_intervals(twin: Twin, record: Data, seconds: float) -> Simulated:
    """Simulate a record in intervals of about a length in s, each from the initial state that reproduces it best.

    Raises:
        IntegrationError: the motion of an interval is not finite from any initial state that was tried.
    """
    every = [simulate(twin, piece, noise=record.noise) for piece in record.windows(seconds)]
    readings = np.concatenate([one.readings for one in every])
    return replace(every[0], record=record, readings=readings, shooting_interval=len(record) / record.rate / len(every))


def nearest(
    sensing: Sensitivity,
    theta: Array,
    record: Data,
    weights: Array,
    start: Array | None = None,
    *,
    steps: int | None = None,
    thorough: bool = False,
) -> tuple[Array, NormalEquations]:
    """Initial state (states,) from which a record is reproduced best, and what is simulated from there.

    Internal states begin about as far from where they are declared as their size says. In a short first part, what no
    sensor reads may go anywhere: where much more than noise is left, it is sought from longer ones, too. Where the
    motion is not finite from what the readings alone tell, it begins where a motion as small as linear equations have
    would begin.

    Args:
        sensing: the twin.
        theta: values of its parameters (k,), in declared units.
        record: commands and readings.
        weights: of squared residuals of each sensor (sensors,).
        start: a state near it (states,); by default it is guessed, and found in longer and longer parts of the record.
        steps: of integration between samples; by default as many as the twin needs.
        thorough: whether to take more time: for a state from which little more than noise is left.

    Raises:
        IntegrationError: the motion is not finite.
    """
    found = list[tuple[Array, NormalEquations]]()
    usable, doubled = (
        [part for part in parts if start is None and part * len(record) >= FIRST_READINGS] for parts in (PARTS, DOUBLED)
    )
    ways = [usable[i:] for i in range(len(usable) + 1)]
    begins = guesses(sensing, record) if start is None else [start]
    starts = itertools.product(begins, ways + [doubled] * bool(doubled))
    nearer = ((first, doubled) for first in _small(sensing, theta, record, weights, usable) if not found)
    for first, parts in itertools.chain(starts, nearer):
        if parts is doubled and found and not thorough:
            continue
        near = first
        for part in parts:
            beginning = record.first(part * len(record) / record.rate)
            with suppress(IntegrationError):
                near, _ = _nearest(sensing, theta, beginning, weights, near, steps=steps)
        with suppress(IntegrationError):
            found.append(_nearest(sensing, theta, record, weights, near, steps=steps))
            if float(found[-1][1].squares @ weights) < (CLEAN if thorough else STUCK) * record.readings.size:
                break
    if not found:
        raise IntegrationError(f"the simulated motion is no longer finite in {record.name}")
    return min(found, key=lambda one: float(one[1].squares @ weights))


def refined(simulated: Callable[[int], Array], least: int, most: int, allowed: Array, *, ahead: int) -> int:
    """Integration steps between samples, doubled until smaller ones change readings by less than is allowed.

    Simulated readings (m, sensors) in a number of steps, at least and at most as given, may change in the rms by what
    is allowed (sensors,). Smaller steps are `ahead` times as many; 1 if the motion is to be finite only.
    """

    @cache
    def made(number: int) -> Array:  # too large steps diverge, or hold a motion that runs away
        try:
            return simulated(number)
        except IntegrationError:
            return np.full_like(allowed, np.nan)

    steps = least
    while steps < most:
        change = made(min(ahead * steps, ahead * most // 2)) - made(steps)
        if bool((np.sqrt((change**2).mean(axis=0)) < allowed).all()):
            break
        steps = min(2 * steps, most)
    return steps


def _nearest(
    sensing: Sensitivity, theta: Array, record: Data, weights: Array, start: Array, *, steps: int | None = None
) -> tuple[Array, NormalEquations]:
    """Result as of `nearest`, near a state to begin with (states,)."""
    twin, record = sensing.twin, sensing.later(theta, record)
    sized, rest = reaches(twin), twin.rest(np.zeros(len(twin.model.coordinates)))
    free = np.array(sorted({*twin.free, *sized}), dtype=int)
    reach = np.array([sized.get(i, np.inf) for i in free])
    first, basis = start.copy(), sensing.basis(theta)
    substeps, at = steps or twin.resolving(record.rate), len(theta) + free

    def linearised(known: InitialPrior, part: float, x: Array) -> Linearised[NormalEquations]:
        first[free] = x
        made = sensing.normal_equations(basis, first, record, weights, substeps)
        (cost, gradient), held = known.off(first), part * known.information[np.ix_(free, free)]
        equations = System(made.matrix[np.ix_(at, at)] + held, made.gradient[at] + part * gradient[free])
        off = (x - rest[free]) / reach
        cost = float(weights @ made.squares + off @ off) + part * cost
        return Linearised(cost, equations.with_prior(rest[free] - x, reach), made)

    # Where a model leaves no more than the noise, the state that all readings determine is taken.
    reading, noise, part = partial(sensing.sensed, theta=theta), weights**-0.5, 1.0
    while True:  # what a model leaves beyond the noise makes its readings less certain than those of the rig
        known = initial_states.prior(reading, first, record, noise, len(twin.model.coordinates))
        best = minimise(
            partial(linearised, known, part), first[free], NO_BOUNDS, DAMPING, rounds=ROUNDS,
            tolerance=lambda at: SETTLED * at.cost,
        )  # fmt: skip
        first[free] = best.x
        left = float(weights @ best.at.extra.squares) / record.readings.size
        if left < STUCK:
            break
        if part > 1.0:
            return first, best.at.extra
        part = left
    alone = minimise(
        partial(linearised, known.without(), part), first[free], NO_BOUNDS, DAMPING, rounds=ROUNDS,
        tolerance=lambda at: SETTLED * at.cost,
    )  # fmt: skip
    by_readings = first.copy()
    by_readings[free] = alone.x
    return (by_readings, alone.at.extra) if known.allows(by_readings) else (first, best.at.extra)


def _small(sensing: Sensitivity, theta: Array, record: Data, weights: Array, parts: Sequence[float]) -> Iterator[Array]:
    """States (states,) near those from which parts of a record are reproduced best if its motion is small."""
    rest = sensing.twin.rest(np.zeros(len(sensing.twin.model.coordinates)))
    read, _ = sensing.sensed(rest)
    for part in parts:
        first = record.first(part * len(record) / record.rate)
        small = replace(first, commands=SMALL * first.commands, readings=read + SMALL * (first.readings - read))
        with suppress(IntegrationError):
            begun = first_start(sensing, small)
            yield rest + (_nearest(sensing, theta, small, weights / SMALL**2, begun)[0] - rest) / SMALL


def first_start(sensing: Sensitivity, record: Data) -> Array:
    """Guess of the initial state of a record (states,), from a parabola through its first readings."""
    return next(guesses(sensing, record))


def guesses(sensing: Sensitivity, record: Data) -> Iterator[Array]:
    """Guesses of the initial state of a record (states,), as `first_start`, on each side of sensors that fold.

    Such a sensor reads alike on both sides of rest, where it may read nothing: it is linearised beside that.
    """
    n, count, given = len(sensing.twin.model.coordinates), min(FIRST_READINGS, len(record)), record.acting[0]
    rest, beside, times = sensing.twin.rest(np.zeros(n)), np.zeros(sensing.states), np.arange(count) / record.rate
    beside[:n] = BESIDE * np.arange(1, n + 1)  # not alike: a sensor may read a difference
    read, jacobian = sensing.sensed(rest, given)
    above, below = (sensing.sensed(rest + side * beside, given)[1] for side in (1.0, -1.0))
    folded = np.flatnonzero((above * below).sum(axis=1) < 0.0)
    for sides in itertools.islice(itertools.product((above, below), repeat=len(folded)), MOST_SIDES):
        for sensor, slopes in zip(folded, sides, strict=True):
            jacobian[sensor] = slopes[sensor]
        readings, free = record.readings[:count], sensing.twin.free
        yield initial_states.guessed_state(rest, (read, jacobian), free, times, readings, n=n, degree=2)
