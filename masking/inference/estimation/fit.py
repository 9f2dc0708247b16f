"""Fit: parameters of a twin that reproduce its records best, with how well they are known.

Simulated readings are compared with measured ones (output error) by the Levenberg-Marquardt method, with derivatives
from the equations; the initial state of each record is estimated too. Multiple shooting, with an initial state for each
interval, fits a record that a simulation of the whole would diverge from.
Source: Ljung, System Identification (1999), chapters 7 to 10; Bock (1981) for multiple shooting.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.least_squares import Box, Damping, Linearised, System, minimise
from masking.control.rig.twin import Twin
from masking.display import fragments, symbols
from masking.errors import RecordError
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.sensitivity import Sensitivity
from masking.inference.estimation.simulation import first_start, noise_alone, relative, validated

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


@dataclass(frozen=True, repr=False, kw_only=True)
class Estimate:
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

    def __repr__(self) -> str:
        values = ", ".join(f"{name} = {value:.6g}" for name, value in zip(self.names, self.values, strict=True))
        return f"<{type(self).__name__} {values}; chi {_each(self.chi)}>"

    def _repr_html_(self) -> str:
        rows = [
            (symbols.markup(name), f"{value:.6g}", f"{Z_975 * std:.2g}", self.unit(name))
            for name, value, std in zip(self.names, self.values, self.std, strict=True)
        ]
        kinds = {"error chi": self.chi, "chi of the noise alone": self.floor, "chi on unseen data": self.validation}
        errors = [(kind, *(f"{chi[name]:.2g}" for name in self.chi)) for kind, chi in kinds.items() if chi]
        parts = [
            fragments.table(("parameter", "value", "\N{PLUS-MINUS SIGN} (95 %)", "unit"), rows, numbers=(1, 2)),
            fragments.table(("", *self.chi), errors, numbers=range(1, len(self.chi) + 1)),
        ]
        return fragments.card(f"Fit of {self.twin.declaration.name}", " ".join(self.notes), *parts)

    @property
    def std(self) -> Array:
        """Standard deviation of each value (k,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def intervals(self) -> Array:
        """95 % confidence intervals (k, 2)."""
        half = Z_975 * self.std
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
        """Values and deviations as JSON can hold them, in the units that they have there."""
        pairs = zip(self.names, self.values, self.std, strict=True)
        found = {name: {"value": float(value), "std": float(std)} for name, value, std in pairs}
        return {name: {**one, **({"unit": unit} if (unit := self.unit(name)) else {})} for name, one in found.items()}

    def lines(self) -> list[str]:
        """Line for each parameter, with half its 95 % interval, and one for the errors."""
        width = max(map(len, self.names), default=0)
        every = zip(self.names, self.values, self.std, strict=True)
        rows = [f"  {n:{width}}  {x:<12.6g} +- {Z_975 * std:.2g} {self.unit(n)}".rstrip() for n, x, std in every]
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
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        return "\n".join([*self.lines(), *self.notes])


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
    theta = sensitivity.start()
    if sensitivity.dead_times:  # records that were read with other ones
        records, unseen = (tuple(one.under(twin) for one in each) for each in (records, unseen))
    stages = [list(records)]
    if shooting_interval:
        stages.insert(0, [window for record in records for window in record.windows(shooting_interval)])
    elif records and len(records[0]) > 2 * len(_beginning(records[0])):
        stages.insert(0, [_beginning(records[0])])
    done = [0.0]

    def tell(part: float) -> None:
        done[0] = max(done[0], part)
        if progress is not None:
            progress(done[0])

    for number, pieces in enumerate(stages):
        problem = _Problem(sensitivity, pieces)
        x = problem.solve(theta, part_of(tell, number, len(stages)))
        theta = x[: len(names)]
    made = problem.result(x)
    if unseen:
        made = replace(made, validation=validated(sensitivity, theta, unseen, problem.sigma**-2))
    tell(1.0)
    return made


def independent(twin: Twin, record: Data, names: Sequence[str]) -> tuple[str, ...]:
    """Parameters that a record determines independently, at the values that the twin has.

    Later names are taken first: what a model adds is declared after what it extends.
    """
    order = tuple(reversed(names))
    problem = _Problem(Sensitivity(twin, order), [_beginning(record)])
    left, _ = _scaled(problem.linearised(problem.unknowns(problem.sensitivity.start())).equations.information())
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
        noise = np.array([piece.noise for piece in pieces])
        declared = np.array([sensitivity.twin.noise().get(name, 0.0) for name in sensitivity.twin.sensors])
        self.sigma = np.where(declared > 0.0, declared, np.sqrt((noise**2).mean(axis=0)))
        self.sigma = np.where(self.sigma > 0.0, self.sigma, 1e-9 * self._size())
        self.rounds = 0

    def _size(self) -> Array:
        mean = np.mean([np.mean(piece.readings**2, axis=0) for piece in self.pieces], axis=0)
        return np.asarray(np.maximum(np.sqrt(mean), 1e-300))

    def linearised(self, x: Array) -> Linearised[Array]:
        """Problem, with the sums of squares (sensors,), at parameters and free initial states (n,)."""
        k, at, theta, many = self.k, self.k + self.free, x[: self.k], len(self.free)
        matrix, gradient = np.zeros((len(x), len(x))), np.zeros(len(x))
        squares, weights = np.zeros(len(self.sigma)), self.sigma**-2
        basis = self.sensitivity.basis(theta)
        moving = np.split(x[k:], len(self.pieces))
        each = zip(self.pieces, self.starts, moving, self.substeps, strict=True)
        for number, (piece, start, begun, substeps) in enumerate(each):
            y = start.copy()
            y[self.free] = begun
            late = self.sensitivity.later(theta, piece)
            found = self.sensitivity.normal_equations(basis, y, late, weights, substeps)
            own, used = np.r_[:k, k + number * many : k + (number + 1) * many], np.r_[:k, at]
            matrix[np.ix_(own, own)] += found.matrix[np.ix_(used, used)]
            gradient[own] += found.gradient[used]
            squares += found.squares
        equations = System(matrix, gradient, shared=k, block=max(1, many))
        return Linearised(float((squares / self.sigma**2).sum()), equations, squares)

    def unknowns(self, theta: Array) -> Array:
        """Parameters (k,) with the first guess of the free initial states (n,)."""
        return np.concatenate([theta, *(start[self.free] for start in self.starts)])

    def solve(self, theta: Array, tell: Progress) -> Array:
        """Parameters and free initial states (n,) that reproduce the records best, from parameters (k,)."""
        x, samples, box = self.unknowns(theta), sum(map(len, self.pieces)), Box(*self.sensitivity.bounds())
        for again in range(REWEIGHTED):
            made = minimise(
                self.linearised, x, box, DAMPING, rounds=MOST_ROUNDS,
                tolerance=lambda at: CONVERGED * at.cost, progress=part_of(tell, again, REWEIGHTED),
            )  # fmt: skip
            x, before = made.x, self.sigma
            self.rounds += made.rounds
            self.sigma = np.maximum(np.sqrt(made.at.extra / samples), 1e-12 * self._size())
            if made.converged and np.allclose(self.sigma, before, rtol=0.02):
                break
        return x

    def result(self, x: Array) -> Fit:
        at, theta = self.linearised(x), x[: self.k]  # the last equations had the noise of the round before
        names = self.sensitivity.names
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
        twin = self.sensitivity.twin_at(theta)
        chi, floor = relative(twin.sensors, self.pieces, at.extra), noise_alone(twin.sensors, self.pieces)
        notes += [
            f"the residual of {name} is {chi[name] / max(floor[name], 1e-300):.1f} times its noise: the model is "
            "missing something that the parameters compensate for, so they are less certain than their intervals say; "
            "see 'masking discover'"
            for name in chi
            if chi[name] > max(BEYOND * floor[name], EXACT)
        ]
        return Fit(
            twin=twin, names=names, values=theta, covariance=covariance, sigma=self.sigma, chi=chi, floor=floor,
            rounds=self.rounds, notes=tuple(notes),
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
