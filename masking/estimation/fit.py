"""Fit: parameters of a twin that reproduce its records best, with how well they are known.

Sensors are simulated over each record and compared with what they read: output error, by the Levenberg-Marquardt method
with derivatives from the equations. The initial state of each record is estimated too. Cut into windows, each with an
initial state of its own, a record is fitted even where the simulation of the whole would leave it.
Source: Ljung, System Identification (1999), chapters 7 to 10; Nocedal and Wright (2006), section 10.3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from masking.errors import IntegrationError, ModelError, RecordError
from masking.estimation import estimates
from masking.estimation.data import Data
from masking.estimation.sensitivity import Sensitivity
from masking.estimation.simulation import first_start, judged, noise_alone, relative
from masking.numerics.arrays import Array
from masking.rig.twin import Twin

Progress = Callable[[float], None]

MOST_ROUNDS = 60
CONVERGED = 1e-9  # part of the cost that a step may still take off
REWEIGHTED = 3  # rounds in which the noise of each sensor is found from what is left
FLAT = 1e-7  # eigenvalue of the scaled information below which the record does not determine a direction
INDEPENDENT = 1e-6  # part of its information that a parameter has for itself, to be fitted beside others
CLOSE = 0.999  # correlation from which two parameters are hardly distinguished
COARSE = 30.0  # s of the first record that the fit of a longer one begins with
FEWEST = 5  # samples of each sensor for each unknown


@dataclass(frozen=True)
class Fit:
    """Parameters that reproduce records, and how well they are known.

    Args:
        twin: the plant with these parameters.
        names: of the parameters.
        values: in the units in which they are declared (k,).
        covariance: of the values (k, k).
        sigma: standard deviation of what is left in each reading (sensors,).
        chi: relative error of each sensor in the records together, by name.
        floor: chi that the noise of the record alone makes, by name.
        validation: chi in records that were not fitted, by name; empty where there are none.
        rounds: of the method.
        notes: what must be known to trust the values.
    """

    twin: Twin
    names: tuple[str, ...]
    values: Array
    covariance: Array
    sigma: Array
    chi: dict[str, float]
    floor: dict[str, float]
    validation: dict[str, float] = field(default_factory=dict)
    rounds: int = 0
    notes: tuple[str, ...] = ()

    @property
    def std(self) -> Array:
        """Return the standard deviation of each value (k,)."""
        found: Array = np.sqrt(np.diag(self.covariance))
        return found

    @property
    def intervals(self) -> Array:
        """Return the 95 % confidence intervals (k, 2)."""
        half = estimates.Z_975 * self.std
        found: Array = np.array([self.values - half, self.values + half]).T
        return found

    @property
    def correlation(self) -> Array:
        """Return the correlation of the values (k, k)."""
        std = np.maximum(self.std, 1e-300)
        found: Array = self.covariance / np.outer(std, std)
        return found

    def as_dict(self) -> dict[str, Any]:
        """Return the fit as JSON can hold it."""
        return {
            "parameters": estimates.parameters(self),
            "chi": {"train": self.chi, "validation": self.validation},
            "floor": self.floor,
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        return "\n".join([*estimates.lines(self), *self.notes])


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
        shooting_interval: seconds of the windows into which records are cut at first; none by default.
        shared: parameters of other fits of the same twin, with which this one shares its compiled functions.
        progress: called with the part done.

    Raises:
        ModelError: a parameter is not known or named twice.
        RecordError: the records are too short for so many parameters.
        IntegrationError: the motion is not finite with the values to begin from; a shorter shooting interval may help.
    """
    records, unseen = _several(records), _several(validation)
    sensitivity = Sensitivity(twin, tuple(names), tuple(shared))
    theta = sensitivity.start()
    stages = (
        [[window for record in records for window in record.windows(shooting_interval)]] if shooting_interval else []
    )
    if not shooting_interval and records and len(records[0]) > 2 * COARSE * records[0].rate:
        stages.append([records[0].first(COARSE)])
    stages.append(list(records))
    done = [0.0]

    def tell(part: float) -> None:
        done[0] = max(done[0], part)
        if progress is not None:
            progress(done[0])

    for number, pieces in enumerate(stages):
        problem = _Problem(sensitivity, pieces)
        theta = problem.solve(theta, part_of(tell, number, len(stages)))
    made = problem.result(theta)
    if unseen:
        made = replace(made, validation=judged(sensitivity, theta, unseen, problem.sigma**-2))
    tell(1.0)
    return made


def independent(twin: Twin, record: Data, names: Sequence[str]) -> tuple[str, ...]:
    """Return parameters that together tell all that the named ones do, with the values that the twin has.

    Later names are taken first: what a model adds is declared after what it extends.

    Args:
        twin: the plant.
        record: of the parameters.
        names: of parameters.
    """
    order = tuple(reversed(names))
    problem = _Problem(Sensitivity(twin, order), [record.first(COARSE)])
    information = problem.information(problem.sensitivity.start())[0]
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    left = information / np.outer(scale, scale)
    left[np.diag(information) <= 0.0] = 0.0
    kept = []
    for i, name in enumerate(order):  # Cholesky, without those of which nothing is left
        if left[i, i] > INDEPENDENT:
            kept.append(name)
            left = left - np.outer(left[:, i], left[i]) / left[i, i]
    return tuple(name for name in names if name in kept)


def _several(records: Data | Sequence[Data]) -> tuple[Data, ...]:
    return (records,) if isinstance(records, Data) else tuple(records)


def part_of(tell: Progress, number: int, count: int) -> Progress:
    """Return what tells of the part done of one of several."""
    return lambda part: tell((number + part) / count)


class _Problem:
    """Records to be reproduced: the parameters are shared, the initial state is each record's own."""

    def __init__(self, sensitivity: Sensitivity, pieces: list[Data]) -> None:
        self.sensitivity, self.pieces = sensitivity, pieces
        self.k = len(sensitivity.names)
        self.free = np.array(sensitivity.twin.free, dtype=int)  # states that are estimated: the others begin at rest
        self.moving = len(self.free)
        sensors, samples = len(sensitivity.twin.sensors), sum(map(len, pieces))
        unknown = self.k + self.moving * len(pieces)
        if samples * sensors < FEWEST * unknown:
            raise RecordError(
                f"{samples} samples of {sensors} sensors are too few for {unknown} unknowns ({self.k} parameters, and "
                f"{self.moving} of the initial state for each of {len(pieces)} pieces); give longer records, or fewer "
                "parameters"
            )
        self.substeps = [sensitivity.twin.substeps(piece.rate) for piece in pieces]
        self.acting = [piece.acting for piece in pieces]
        self.starts = [first_start(sensitivity, piece) for piece in pieces]
        noise = np.array([piece.noise for piece in pieces])
        declared = np.array([sensitivity.twin.noise().get(name, 0.0) for name in sensitivity.twin.sensors])
        self.sigma = np.where(declared > 0.0, declared, np.sqrt((noise**2).mean(axis=0)))
        self.sigma = np.where(self.sigma > 0.0, self.sigma, 1e-9 * self._size())
        self.rounds = 0
        self.bounds = sensitivity.bounds()
        self.squares = np.zeros(sensors)

    def _size(self) -> Array:
        mean = np.mean([np.mean(piece.readings**2, axis=0) for piece in self.pieces], axis=0)
        return np.asarray(np.maximum(np.sqrt(mean), 1e-300))

    def equations(
        self, theta: Array, starts: list[Array]
    ) -> tuple[Array, Array, list[tuple[Array, Array, Array]], Array]:
        """Return matrix (k, k) and gradient (k,) of the parameters, what each piece adds, and the sums of squares."""
        k, at = self.k, self.k + self.free
        matrix, gradient = np.zeros((k, k)), np.zeros(k)
        own, squares, weights = [], np.zeros(len(self.sigma)), self.sigma**-2
        basis = self.sensitivity.basis(theta)
        for piece, acting, start, substeps in zip(self.pieces, self.acting, starts, self.substeps, strict=True):
            found = self.sensitivity.normal_equations(
                basis,
                start,
                acting,
                piece.readings,
                weights,
                rate=piece.rate,
                substeps=substeps,
                hold=piece.hold,
            )
            matrix += found.matrix[:k, :k]
            gradient += found.gradient[:k]
            own.append((found.matrix[np.ix_(at, at)], found.matrix[at, :k], found.gradient[at]))
            squares += found.squares
        return matrix, gradient, own, squares

    def solve(self, theta: Array, tell: Progress) -> Array:
        """Return the parameters (k,) that reproduce the records best; keeps the initial states."""
        for again in range(REWEIGHTED):
            theta, settled = self._minimise(theta, part_of(tell, again, REWEIGHTED))
            before, samples = self.sigma, sum(map(len, self.pieces))
            self.sigma = np.maximum(np.sqrt(self.squares / samples), 1e-12 * self._size())
            if settled and np.allclose(self.sigma, before, rtol=0.02):
                break
        return theta

    def _minimise(self, theta: Array, tell: Progress) -> tuple[Array, bool]:
        damping, starts = 1e-3, self.starts
        matrix, gradient, own, squares = self.equations(theta, starts)
        cost = float((squares / self.sigma**2).sum())
        for number in range(MOST_ROUNDS):
            self.rounds += 1
            tell(number / MOST_ROUNDS)
            step, steps, gain = self._step(matrix, gradient, own, damping)
            moved = [self._moved(start, s) for start, s in zip(starts, steps, strict=True)]
            try:
                farther = self._within(theta, step)
                tried = self.equations(farther, moved)
                new = float((tried[3] / self.sigma**2).sum())
            except (IntegrationError, ModelError):
                new = np.inf
            if not new < cost:
                if gain < CONVERGED * cost or damping > 1e12:
                    break
                damping *= 10.0
                continue
            theta, starts, taken = farther, moved, cost - new
            (matrix, gradient, own, squares), cost = tried, new
            damping = max(damping / 10.0, 1e-12)
            if taken < CONVERGED * cost:
                break
        self.starts, self.squares = starts, squares
        return theta, number < MOST_ROUNDS - 1

    def _moved(self, start: Array, step: Array) -> Array:
        """Return an initial state (states,) after a step of what is estimated of it."""
        found = start.copy()
        found[self.free] += step
        return found

    def _within(self, theta: Array, step: Array) -> Array:
        """Return the parameters after a step that goes no more than half-way to a bound."""
        low, high = self.bounds
        return np.clip(theta + step, np.where(np.isfinite(low), 0.5 * (theta + low), low),
                       np.where(np.isfinite(high), 0.5 * (theta + high), high))  # fmt: skip

    def _step(
        self, matrix: Array, gradient: Array, own: list[tuple[Array, Array, Array]], damping: float
    ) -> tuple[Array, list[Array], float]:
        """Return the steps of parameters and initial states, and what they should take off the cost."""
        matrix = matrix + damping * np.diag(np.diag(matrix))
        rest, right = matrix.copy(), gradient.copy()
        inverses = []
        for square, cross, slope in own:
            inverse = np.linalg.pinv(square + damping * np.diag(np.diag(square)), hermitian=True)
            inverses.append(inverse)
            rest -= cross.T @ inverse @ cross
            right -= cross.T @ inverse @ slope
        step = _solve(rest, right)
        steps = [inverse @ (slope - cross @ step) for inverse, (_, cross, slope) in zip(inverses, own, strict=True)]
        gain = float(gradient @ step + sum(slope @ s for (_, _, slope), s in zip(own, steps, strict=True)))
        return step, steps, gain

    def information(self, theta: Array) -> tuple[Array, Array]:
        """Return the information on the parameters (k, k), initial states unknown, and the sums of squares."""
        matrix, _, own, squares = self.equations(theta, self.starts)
        for square, cross, _ in own:
            matrix -= cross.T @ np.linalg.pinv(square, hermitian=True) @ cross
        return matrix, squares

    def result(self, theta: Array) -> Fit:
        """Return the fit."""
        # The last equations had the noise of the round before.
        information, self.squares = self.information(theta)
        names = self.sensitivity.names
        scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
        values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
        kept = np.where(values > FLAT, values, np.inf)
        covariance = (vectors / kept) @ vectors.T / np.outer(scale, scale)
        notes = [_flat(names, vectors[:, i]) for i in np.flatnonzero(values <= FLAT)]
        correlation = covariance / np.sqrt(np.maximum(np.outer(np.diag(covariance), np.diag(covariance)), 1e-300))
        notes += [
            f"{names[i]} and {names[j]} are hardly distinguished: their correlation is {correlation[i, j]:.3f}"
            for i in range(len(names))
            for j in range(i)
            if abs(correlation[i, j]) > CLOSE and not notes
        ]
        twin = self.sensitivity.twin_at(theta)
        chi, floor = relative(twin.sensors, self.pieces, self.squares), noise_alone(twin.sensors, self.pieces)
        return Fit(twin, names, theta, covariance, self.sigma, chi, floor, {}, self.rounds, tuple(notes))


def _flat(names: tuple[str, ...], direction: Array) -> str:
    """Say which parameters a flat direction makes up."""
    strong = [name for name, part in zip(names, direction, strict=True) if abs(part) > 0.1 * np.abs(direction).max()]
    if len(strong) == 1:
        return f"these records do not tell {strong[0]}; excite what it belongs to, or leave it out"
    listed = f"{', '.join(strong[:-1])} and {strong[-1]}"
    return f"{listed} cannot be distinguished from these records; fix one of them, or give records that excite each"


def _solve(matrix: Array, right: Array) -> Array:
    if not len(right):
        return right
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    found = np.linalg.lstsq(matrix / np.outer(scale, scale), right / scale, rcond=1e-14)[0]
    return np.asarray(found / scale)
