"""Fit: parameters of a twin that reproduce its records best, with how well they are known.

Simulated readings are compared with measured ones (output error) by the Levenberg-Marquardt method, with derivatives
from the equations; the initial state of each record is estimated too. Multiple shooting, with an initial state for each
interval, fits a record that a simulation of the whole would diverge from.
Source: Ljung, System Identification (1999), chapters 7 to 10; Bock (1981) for multiple shooting.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.least_squares import Box, Damping, Linearised, System, minimise
from masking.control.rig.twin import Twin
from masking.display import fragments, symbols
from masking.display.printed_result import Printed
from masking.errors import IntegrationError, RecordError
from masking.inference.estimation import growing_intervals, initial_states
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.initial_states import InitialPrior
from masking.inference.estimation.sensitivity import Sensitivity
from masking.inference.estimation.simulation import first_start, noise_alone, relative, validated
from masking.inference.estimation.whiteness import DOUBTED, whiteness

Progress = Callable[[float], None]

Z_975 = 1.959963984540054  # quantile of the normal distribution
MOST_ROUNDS = 60
DAMPING = Damping(1e-3, least=1e-12, most=1e12)
CONVERGED = 1e-9  # fraction of the cost: a smaller reduction ends the fit
REWEIGHTED = 3  # rounds in which the noise of each sensor is estimated from the residuals
FLAT = 1e-7  # eigenvalue of the scaled information below which the record does not determine a direction
INDEPENDENT = 1e-6  # part of its information that a parameter has for itself, to be fitted beside others
CLOSE = 0.999  # correlation from which two parameters are hardly distinguished
COARSE = 30.0  # s of the first record that the fit of a longer one begins with,
COARSE_SAMPLES = 2000  # and samples at least: processes that are sampled slowly move slowly
EXACT = 1e-6  # relative error that integration may make
BEYOND = 3.0  # times the noise: a model that leaves more lacks something
FEWEST = 5  # samples of each sensor for each unknown
OTHERS = 2  # values beside the declared ones that fits begin from
DOUBLINGS = 3  # of integration steps, at most
SETTLED = 0.5  # of its deviation by which smaller steps may move a value
ALIKE = 1.01  # times what the best fit leaves: so much leaves one that ends in the same minimum


@dataclass(frozen=True, repr=False, kw_only=True)
class Estimate(Printed):
    """Parameters of a twin that were found from records, by any method."""

    twin: Twin  # the plant with these parameters
    names: tuple[str, ...]  # of the parameters
    values: Array  # in the units in which they are declared (k,)
    covariance: Array  # of the values (k, k)
    # relative error (4.12) of each sensor in the records together, simulated with the values from the best initial
    # states, by name; not a number if that motion is not finite
    chi: dict[str, float]
    floor: dict[str, float]  # chi that the noise of the records alone makes, by name
    validation: dict[str, float] = field(default_factory=dict)  # chi in records that were not used, by name
    notes: tuple[str, ...] = ()  # what must be known to trust the values
    doubt: str = ""  # why no interval is stated; empty where the residual is as white as the noise that is assumed

    @property
    def headline(self) -> str:
        """Values, and the relative errors that they leave."""
        values = ", ".join(f"{name} = {value:.6g}" for name, value in zip(self.names, self.values, strict=True))
        return f"{values}; chi {_each(self.chi)}"

    def _repr_html_(self) -> str:
        rows = [
            (symbols.markup(name), f"{value:.6g}", "" if self.doubt else f"{Z_975 * std:.2g}", self.unit(name))
            for name, value, std in zip(self.names, self.values, self.std, strict=True)
        ]
        kinds = {"error chi": self.chi, "chi of the noise alone": self.floor, "chi on unseen data": self.validation}
        errors = [(kind, *(f"{chi[name]:.2g}" for name in self.chi)) for kind, chi in kinds.items() if chi]
        parts = [
            fragments.table(("parameter", "value", "\N{PLUS-MINUS SIGN} (95 %)", "unit"), rows, numbers=(1, 2)),
            fragments.table(("", *self.chi), errors, numbers=range(1, len(self.chi) + 1)),
        ]
        return fragments.card(f"Fit of {self.twin.declaration.name}", " ".join(self.remarks), *parts)

    @property
    def std(self) -> Array:
        """Standard deviation of each value (k,) by the curvature of the cost; see `doubt`."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def intervals(self) -> Array:
        """95 % confidence intervals (k, 2), not numbers where they are not stated."""
        half = Z_975 * (np.full(len(self.values), np.nan) if self.doubt else self.std)
        return np.array([self.values - half, self.values + half]).T

    @property
    def correlation(self) -> Array:
        """Correlation of the values (k, k)."""
        std = np.maximum(self.std, 1e-300)
        return np.asarray(self.covariance / np.outer(std, std))

    def unit(self, name: str) -> str:
        """Declared unit of a parameter; "" where it has none."""
        found = self.twin.model.declaration.parameters.get(name)
        return "" if found is None or found.unit == "1" else found.unit

    def parameters(self) -> dict[str, Any]:
        """Values and deviations as JSON can hold them, in their units; no deviation where none is stated."""
        pairs = zip(self.names, self.values, self.std, strict=True)
        found = {n: {"value": float(value), "std": None if self.doubt else float(std)} for n, value, std in pairs}
        return {name: {**one, **({"unit": unit} if (unit := self.unit(name)) else {})} for name, one in found.items()}

    @property
    def remarks(self) -> tuple[str, ...]:
        """Notes, and why no interval is stated."""
        return (*self.notes, *([f"no confidence intervals are stated: {self.doubt}"] if self.doubt else []))

    def lines(self) -> list[str]:
        """Line for each parameter, with half its 95 % interval, and one for the errors."""
        width = max(map(len, self.names), default=0)
        every = zip(self.names, self.values, self.std, strict=True)
        half = "" if self.doubt else "+- {:.2g}"
        rows = [f"  {n:{width}}  {x:<12.6g} {half.format(Z_975 * std)} {self.unit(n)}".rstrip() for n, x, std in every]
        kinds = {"chi": self.chi, "on unseen data": self.validation, "the noise alone": self.floor}
        return [*rows, "; ".join(f"{kind} {_each(chi)}" for kind, chi in kinds.items() if chi)]


@dataclass(frozen=True, repr=False, kw_only=True)
class Fit(Estimate):
    """Parameters that reproduce records."""

    sigma: Array  # standard deviation of the residual of each sensor (sensors,)
    rounds: int  # of the method

    def as_dict(self) -> dict[str, Any]:
        """Fit as JSON can hold it."""
        return {
            "parameters": self.parameters(),
            "covariance": self.covariance.tolist(),
            "chi": {"train": self.chi, "validation": self.validation},
            "floor": self.floor,
            "notes": list(self.remarks),
        }

    def __str__(self) -> str:
        return "\n".join([*self.lines(), *self.remarks])


def fit(
    twin: Twin,
    records: Data | Sequence[Data],
    names: Sequence[str],
    *,
    validation: Data | Sequence[Data] = (),
    shooting_interval: float | None = None,
    shared: Sequence[str] = (),
    progress: Progress | None = None,
) -> Fit:
    """Fit parameters of a twin to records.

    Args:
        twin: the plant, with the values to begin from.
        records: one or several.
        names: of the parameters, as `Twin.parameter_names` has them.
        validation: records that the fit is validated on.
        shooting_interval: length of the intervals of multiple shooting with which the fit starts, s; by default
            records are simulated whole.
        shared: parameters of other fits of the same twin, with which this one shares its compiled functions.
        progress: called with the part done.

    Raises:
        ModelError: a parameter is not known or named twice.
        RecordError: the records are too short for the number of parameters.
        IntegrationError: the motion is not finite with the values to begin from; a shorter shooting interval may help.
    """
    records, unseen = several(records), several(validation)
    sensitivity = Sensitivity(twin, tuple(names), tuple(shared))
    if sensitivity.dead_times:  # records that were read with other ones
        records, unseen = (tuple(one.under(twin) for one in each) for each in (records, unseen))
    lead = list[list[Data]]()
    if shooting_interval:
        lead = [[window for record in records for window in record.windows(shooting_interval)]]
    elif records and len(records[0]) > 2 * len(_beginning(records[0])):
        lead = [[_beginning(records[0])]]
    done = [0.0]

    def tell(part: float) -> None:
        done[0] = max(done[0], part)
        if progress is not None:
            progress(done[0])

    best, notes = _best(sensitivity, [*lead, list(records)], tell)
    made = best.result(notes)
    if unseen:
        made = replace(made, validation=validated(sensitivity, made.values, unseen, best.problem.sigma**-2))
    tell(1.0)
    return made


def _best(sensitivity: Sensitivity, stages: list[list[Data]], tell: Progress) -> tuple[_Ended, tuple[str, ...]]:
    """Best of several fits to the records, the last of the stages, and a note where the first is not the best.

    A fit that leaves more than the noise may have ended in a local minimum: others begin in shooting intervals that
    grow, from the declared values and from others, until one leaves the noise, or the best two are alike.
    """
    found, failure, declared = list[_Ended](), IntegrationError(""), sensitivity.start()
    try:
        found += _ended(sensitivity, stages, declared, lambda part: tell(0.5 * part))
    except IntegrationError as error:
        failure = error
    first, grown = list(found), [*_grown(sensitivity, stages[-1]), stages[-1]]
    for number, theta in enumerate(_starts(declared, sensitivity.bounds()) if len(grown) > 1 else ()):
        levels = sorted(one.level for one in found)
        if levels and (levels[0] <= 1.0 or (len(levels) > 1 and levels[1] <= ALIKE * levels[0])):
            break
        told = part_of(lambda part: tell(0.5 + 0.5 * part), number, 1 + OTHERS)
        with suppress(IntegrationError):
            found += _ended(sensitivity, grown, theta, told, min(levels, default=np.inf))
    if not found:
        raise failure
    best = min(found, key=lambda one: one.level)
    if best.level > 1.0 and len(grown) > 1:
        return best, ("fits in shooting intervals that grow, also from other values, leave no less",)
    if best in first:
        return _in_finer_steps(best), ()
    seconds, left = len(grown[0][0]) / grown[0][0].rate, max(chi for one in first for chi in one.chi.values())
    before = f"with an error chi of {left:.3g}" if first else "where the motion is not finite"
    return _in_finer_steps(best), (
        f"from the declared values a fit of the whole record ends in a local minimum, {before}: this one began in "
        f"shooting intervals of {seconds:.2g} s, which grow",
    )


def _ended(
    sensitivity: Sensitivity, stages: list[list[Data]], theta: Array, tell: Progress, least: float = np.inf
) -> list[_Ended]:
    """Fit that goes through stages from parameters (k,); none where one leaves more than the least level."""
    for number, pieces in enumerate(stages):
        problem = _Problem(sensitivity, pieces)
        made = _Ended(problem, *problem.solve(problem.unknowns(theta), part_of(tell, number, len(stages))))
        theta = made.x[: problem.k]
        if made.level > ALIKE * least:
            return []
    return [made]


def _in_finer_steps(found: _Ended) -> _Ended:
    """Fit in integration steps that move no value by more than a part of its deviation, if there are such.

    Steps that reproduce readings within their noise may be too long for values that many readings determine.
    """
    for _ in range(DOUBLINGS * (found.level <= 1.0)):
        finer = found.problem.in_half_steps()
        off, deviations = finer.step_and_deviations(found.x)
        if (np.abs(off) <= SETTLED * deviations).all():
            return replace(found, settled=True)
        x, at = finer.solve(found.x)
        found = _Ended(finer, x, at)
    return found


def _grown(sensitivity: Sensitivity, records: list[Data]) -> Iterator[list[Data]]:
    """Records in shooting intervals, the shortest first, with enough samples for the unknowns."""
    longest, twin = max(records, key=len), sensitivity.twin
    unknown = len(sensitivity.names) + len(twin.free)
    for samples in growing_intervals.lengths(longest, len(longest), len(longest) // growing_intervals.MOST):
        if samples * len(twin.sensors) > FEWEST * unknown:
            yield [piece for record in records for piece in growing_intervals.windows(record, samples)]


def _starts(declared: Array, bounds: tuple[Array, Array]) -> Iterator[Array]:
    """Values of the parameters to begin from (k,): those that are declared, and others within half and twice these."""
    rng = np.random.default_rng(0)
    yield declared
    for _ in range(OTHERS):
        yield np.clip(declared * 2.0 ** rng.uniform(-1.0, 1.0, len(declared)), *bounds)


def independent(twin: Twin, record: Data, names: Sequence[str]) -> tuple[str, ...]:
    """Parameters that a record determines independently, at the values that the twin has.

    Later names are taken first: what a model adds is declared after what it extends.
    """
    order = tuple(reversed(names))
    problem = _Problem(Sensitivity(twin, order), [_beginning(record)])
    x = problem.unknowns(problem.sensitivity.start())
    problem.expect(x)
    left, _ = _scaled(problem.linearised(x).equations.information())
    kept = []
    for i, name in enumerate(order):  # Cholesky, without those of which nothing is left
        if left[i, i] > INDEPENDENT:
            kept.append(name)
            left = left - np.outer(left[:, i], left[i]) / left[i, i]
    return tuple(name for name in names if name in kept)


def _scaled(information: Array) -> tuple[Array, Array]:
    """Information with a diagonal of 1, or 0 of a parameter that does nothing, and the scale of each (k,)."""
    is_seen = np.diag(information) > 0.0  # rounding makes it negative where a parameter does nothing
    scale = np.sqrt(np.where(is_seen, np.diag(information), 1.0))
    return np.where(np.outer(is_seen, is_seen), information, 0.0) / np.outer(scale, scale), scale


def _beginning(record: Data) -> Data:
    return record.first(max(COARSE, COARSE_SAMPLES / record.rate))


def several(records: Data | Sequence[Data]) -> tuple[Data, ...]:
    """One record, or a sequence of them, as a tuple."""
    return (records,) if isinstance(records, Data) else tuple(records)


def part_of(tell: Progress, number: int, count: int) -> Progress:
    """Progress of one of several parts, numbered from 0, as that of all of them."""
    return lambda part: tell((number + part) / count)


class _Problem:
    """Records to be reproduced: the parameters are shared, the initial state is each record's own."""

    def __init__(self, sensitivity: Sensitivity, pieces: list[Data]) -> None:
        self.sensitivity, self.pieces = sensitivity, pieces
        self.k = len(sensitivity.names)
        self.free = np.array(sensitivity.twin.free, dtype=int)  # states that are estimated: the others begin at rest
        sensors, samples = len(sensitivity.twin.sensors), sum(map(len, pieces))
        unknown = self.k + len(self.free) * len(pieces)
        if samples * sensors < FEWEST * unknown:
            raise RecordError(
                f"{samples} samples of {sensors} sensor{'s' * (sensors != 1)} are too few for {unknown} unknowns: "
                f"{self.k} parameters, and {len(self.free)} of the initial state of each record or interval; give "
                "longer records, or fewer parameters"
            )
        self.substeps = [sensitivity.twin.resolving(piece.rate) for piece in pieces]
        self.starts = [first_start(sensitivity, piece) for piece in pieces]
        self.known = list[InitialPrior]()
        noise = np.array([piece.noise for piece in pieces])
        declared = np.array([sensitivity.twin.noise().get(name, 0.0) for name in sensitivity.twin.sensors])
        self.noise = np.where(declared > 0.0, declared, np.sqrt((noise**2).mean(axis=0)))
        self.noise = np.where(self.noise > 0.0, self.noise, 1e-9 * self._size())
        self.sigma = self.noise
        self.rounds = 0

    def _size(self) -> Array:
        mean = np.mean([np.mean(piece.readings**2, axis=0) for piece in self.pieces], axis=0)
        return np.asarray(np.maximum(np.sqrt(mean), 1e-300))

    def states(self, x: Array) -> list[Array]:
        """Initial states (states,) of the pieces at parameters and free initial states (n,)."""
        found = [start.copy() for start in self.starts]
        for state, moved in zip(found, np.split(x[self.k :], len(found)), strict=True):
            state[self.free] = moved
        return found

    def expect(self, x: Array) -> None:
        """Take the prior of the initial states by the first readings at parameters and free initial states (n,)."""
        sensing = self.sensitivity
        reading, n = partial(sensing.sensed, theta=x[: self.k]), len(sensing.twin.model.coordinates)
        pairs = zip(self.pieces, self.states(x), strict=True)
        self.known = [initial_states.prior(reading, state, piece, self.noise, n) for piece, state in pairs]

    def linearised(self, x: Array) -> Linearised[list[Array]]:
        """Problem, with the residuals of each piece (m, sensors), at parameters and free initial states (n,)."""
        k, at, theta, many = self.k, self.k + self.free, x[: self.k], len(self.free)
        matrix, gradient = np.zeros((len(x), len(x))), np.zeros(len(x))
        residuals, weights, cost = list[Array](), self.sigma**-2, 0.0
        basis = self.sensitivity.basis(theta)
        each = zip(self.pieces, self.states(x), self.known, self.substeps, strict=True)
        for number, (piece, y, known, substeps) in enumerate(each):
            late = self.sensitivity.later(theta, piece)
            found = self.sensitivity.normal_equations(basis, y, late, weights, substeps)
            own, used = np.r_[:k, k + number * many : k + (number + 1) * many], np.r_[:k, at]
            matrix[np.ix_(own, own)] += found.matrix[np.ix_(used, used)]
            gradient[own] += found.gradient[used]
            (more, pulled), begun = known.off(y), own[k:]
            matrix[np.ix_(begun, begun)] += known.information[np.ix_(self.free, self.free)]
            gradient[begun] += pulled[self.free]
            residuals.append(late.residuals(found.simulated))
            cost += float(found.squares @ weights) + more
        equations = System(matrix, gradient, shared=k, block=max(1, many))
        return Linearised(cost, equations, residuals)

    def unknowns(self, theta: Array) -> Array:
        """Parameters (k,) with the first guess of the free initial states (n,)."""
        return np.concatenate([theta, *(start[self.free] for start in self.starts)])

    def in_half_steps(self) -> _Problem:
        """The same in half the steps of integration."""
        finer = copy.copy(self)
        finer.substeps = [2 * steps for steps in self.substeps]
        return finer

    def step_and_deviations(self, x: Array) -> tuple[Array, Array]:
        """How far parameters are from their best values by the linearised problem, and their deviations (k,)."""
        equations = self.linearised(x).equations
        variances = np.maximum(np.diag(equations.covariance()), 0.0)
        return equations.step(DAMPING.least)[0][: self.k], np.sqrt(variances)

    def solve(self, x: Array, tell: Progress = lambda part: None) -> tuple[Array, Linearised[list[Array]]]:
        """Parameters and free initial states that reproduce the records best, from such values (n,)."""
        samples, box = sum(map(len, self.pieces)), Box(*self.sensitivity.bounds())
        for again in range(REWEIGHTED):
            self.expect(x)
            made = minimise(
                self.linearised, x, box, DAMPING, rounds=MOST_ROUNDS,
                tolerance=lambda at: CONVERGED * at.cost, progress=part_of(tell, again, REWEIGHTED),
            )  # fmt: skip
            x, before = made.x, self.sigma
            self.rounds += made.rounds
            self.sigma = np.maximum(np.sqrt(squares(made.at.extra) / samples), 1e-12 * self._size())
            if made.converged and np.allclose(self.sigma, before, rtol=0.02):
                break
        return x, self.linearised(x)  # the last equations had the noise of the round before


def squares(residuals: Sequence[Array]) -> Array:
    """Sum of squared residuals of each sensor (sensors,), of pieces (m, sensors)."""
    return np.asarray(np.sum([(one**2).sum(axis=0) for one in residuals], axis=0))


@dataclass(frozen=True, eq=False)
class _Ended:
    """Where a fit ended."""

    problem: _Problem
    x: Array  # parameters and free initial states (n,)
    at: Linearised[list[Array]]
    settled: bool = False  # whether smaller steps of integration move no value by more than a part of its deviation

    @cached_property
    def chi(self) -> dict[str, float]:
        return relative(self.problem.sensitivity.twin.sensors, self.problem.pieces, squares(self.at.extra))

    @cached_property
    def floor(self) -> dict[str, float]:
        return noise_alone(self.problem.sensitivity.twin.sensors, self.problem.pieces)

    @property
    def level(self) -> float:
        """Largest error in parts of that from which a model lacks something."""
        return max(chi / max(BEYOND * self.floor[name], EXACT) for name, chi in self.chi.items())

    def doubts(self) -> Iterator[str]:
        """Why deviations by the curvature of the cost are not those of the values."""
        pieces, every = self.problem.pieces, self.at.extra
        if self.level > 1.0:
            yield "what the parameters compensate for moves them farther than noise does"
            return
        if not self.settled:
            yield "smaller steps of integration move the values, by more than noise does"
        for i, name in enumerate(self.problem.sensitivity.twin.sensors):
            for piece, left in zip(pieces, every, strict=True):
                seen = whiteness(left[:, i], piece.readings[:, i], self.problem.noise[i], piece.rate)
                if seen.p * len(pieces) * len(self.floor) < DOUBTED:
                    yield f"the residual of {name} in {piece.name} is not white noise (at {seen.frequency:.3g} Hz)"

    def result(self, more: Sequence[str]) -> Fit:
        at, names = self.at, self.problem.sensitivity.names
        scaled, scale = _scaled(at.equations.information())
        values, vectors = decompositions.symmetric(scaled)
        covariance = (vectors / np.where(values > FLAT, values, np.inf)) @ vectors.T / np.outer(scale, scale)
        notes = [_flat(names, vectors[:, i]) for i in np.flatnonzero(values <= FLAT)]
        correlation = covariance / np.sqrt(np.maximum(np.outer(np.diag(covariance), np.diag(covariance)), 1e-300))
        notes += [
            f"{names[i]} and {names[j]} are hardly distinguished: their correlation is {correlation[i, j]:.3f}"
            for i in range(len(names))
            for j in range(i)
            if abs(correlation[i, j]) > CLOSE and not notes
        ]
        theta, chi, floor = self.x[: self.problem.k], self.chi, self.floor
        notes += [
            f"the residual of {name} is {chi[name] / max(floor[name], 1e-300):.1f} times its noise: the model is "
            "missing something that the parameters compensate for; see 'masking discover'"
            for name in chi
            if chi[name] > max(BEYOND * floor[name], EXACT)
        ]
        return Fit(
            twin=self.problem.sensitivity.twin_at(theta), names=names, values=theta, covariance=covariance,
            sigma=self.problem.sigma, chi=chi, floor=floor, rounds=self.problem.rounds, notes=(*notes, *more),
            doubt=next(self.doubts(), ""),
        )  # fmt: skip


def _flat(names: tuple[str, ...], direction: Array) -> str:
    strong = [name for name, part in zip(names, direction, strict=True) if abs(part) > 0.1 * np.abs(direction).max()]
    if len(strong) == 1:
        return f"these records do not determine {strong[0]}; excite what it belongs to, or leave it out"
    return (
        f"{', '.join(strong[:-1])} and {strong[-1]} cannot be distinguished from these records; fix one of them "
        "(--parameters names those to fit; in Python, parameters=), or give records that excite each"
    )


def _each(errors: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in errors.items())
