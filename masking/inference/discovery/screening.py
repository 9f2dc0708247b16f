"""Screening: the score of each candidate, to first order along the motion that was measured.

The force that an effect would have made along the measured motion is passed through the rig to its sensors and compared
with the residual. If the rig is linear and the motion known, this is no approximation, however strong the effect is.
The part that the rig's own parameters and the initial state could explain is projected out first.
Source: Frisch and Waugh (1933), Econometrica 1(4), for regression with some columns taken out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array, IntVector
from masking.compile.numerics.kernel_arguments import Blocks, KnownMotion, Sources
from masking.compile.numerics.least_squares import System
from masking.errors import IntegrationError
from masking.inference.discovery import compiled_laws
from masking.inference.discovery.augmented_model import MOST_COLUMNS, EffectInstance
from masking.inference.discovery.candidates import Candidate
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.fitting import Hypothesis, bounds
from masking.inference.discovery.motion_features import Kept, MotionFeatures, Thinning, thinned
from masking.inference.discovery.smoothing import Motion

# Double precision: singular values of columns beside prior rows, parts of squares, and normal equations, over the
# largest: smaller ones are rounding.
RANK, ROUNDING, COLLINEAR = 1e-9, 1e-12, 1e-10
HUGE = 1e100  # standard deviations for a unit of a factor, whatever the unit: squares of larger ones overflow
RESPONSE = 1e-7  # singular value, over the largest, from which parameters have a response: the error of integration
GROWTH = 20.0  # by which a time constant may grow to first order: the ratio of the largest to the least lag tried
LEAST, STEPS = 1e-3, 8  # of the largest factor: where one beyond its bounds begins; steps that sharpen a shape
ZOOMS = (0.08, 0.02, 0.005, 0.00125)  # widths about a converter's step, nine points each: the next is their distance
LIGHTEST = 0.7  # of a mass: most that an inertia may take away


@dataclass(frozen=True)
class Score:
    """What a candidate could take off the cost, with the effect instance from which to begin."""

    candidate: Candidate
    instance: EffectInstance  # with the best shape, and its factors
    gain: float  # of the cost (-2 log likelihood)


@dataclass(frozen=True)
class Products:
    """Products of columns, of what candidates do to the sensors."""

    gram: Array  # products of the columns (c, c), with what is taken out projected out
    right: Array  # products of the columns with the residual (c,)
    squares: Array  # of the columns before the projection (c,)
    columns: Sequence[IntVector]  # the numbers of those of each candidate


class Screen:
    """A record with what the rig's own parameters explain taken out.

    Args:
        base: a fit of the rig, whose residuals are looked at.
        motion: the smoothed record.
        found: effects that were found before; what they and their parameters explain is taken out too.
        taken: whether these effects are in the fit already.
        kept: what candidates do along this motion, from screens before; it is added to.

    Raises:
        IntegrationError: along what was found the rig's motion runs away, to first order.
    """

    def __init__(
        self,
        problem: EstimationProblem,
        base: Hypothesis,
        motion: Motion,
        found: Sequence[EffectInstance] = (),
        *,
        taken: bool = False,
        kept: Kept | None = None,
    ) -> None:
        self.rig, self.record, self.base = problem.rig, problem.record, base
        self.rules, self.bounds, self.work = problem.rules, problem.prior, problem.work
        rig, record, prior, sigma = problem.rig, problem.record, problem.prior, problem.sigma
        thinning = Thinning.of(problem)
        self.thin, self.every = thinning.motion, thinning.readings
        simulated = record.readings - base.residuals
        self._features = MotionFeatures(rig, record, motion, simulated, thinning, kept or Kept())
        self.blocks = len(record) // self.every
        self.interval_samples = problem.interval_samples // self.thin if problem.interval else len(record)
        self._states = thinned(motion.states, self.thin)
        self._commands = thinned(record.acting, self.thin)
        self.scale = np.sqrt(self.every) / sigma
        k = len(base.theta)
        basis = rig.basis(base.theta)[1]
        wanted = np.flatnonzero(basis.any(axis=1))
        coarse = len(self._states)
        columns = self._spread(np.ones((coarse, len(wanted))), wanted.astype(np.float64))
        of_parameters = np.einsum("bsm,mk->bsk", columns, basis[wanted])
        of_parameters[:, :, len(rig.names) :] = self._found(rig.imperfect(base.theta))[1]
        free = np.array(rig.twin.free, dtype=np.int64)
        start = self._of_intervals(self._spread(np.zeros((coarse, len(free))), np.zeros(len(free)), free))
        values, slopes = self._found(found)
        own = _bounded(self._rows(np.concatenate([of_parameters, start, slopes], axis=2)))
        prior_rows = np.zeros((k, own.shape[1]))
        prior_rows[:, :k] = np.diag(1.0 / prior.deviation)
        whole = np.vstack([own, prior_rows])
        size = np.linalg.norm(whole, axis=0)
        size = np.where(size > 0.0, size, 1.0)
        u, s, v = decompositions.svd(whole / size)
        independent = s > RANK * s.max(initial=0.0)
        self.taken, self._back = u[:, independent], v[independent].T / s[independent] / size[:, None]
        u, s, _ = decompositions.svd(own / size)
        self.possible = u[:, s > RESPONSE * s.max(initial=0.0)]
        self.single = _apart(own[:, :k], own[:, k:], RESPONSE)
        left = self._rows((self._means(base.residuals) - (0.0 if taken else values))[:, :, None])[:, 0]
        if not np.abs(left).max() < HUGE:
            raise IntegrationError("the rig's motion runs away along what was found")
        self._whole_left = np.concatenate([left, (prior.mean - base.theta) / prior.deviation])
        self.left = self._out(self._whole_left)
        self.total = float(self.left @ self.left)

    def _of_intervals(self, columns: Array) -> Array:
        """Columns (blocks, sensors, c) for each shooting interval, zero outside (blocks, sensors, w * c)."""
        every = np.arange(len(self.base.start))  # a last one may be shorter than a block
        interval = np.arange(self.blocks) * self.every // (self.interval_samples * self.thin)
        apart = np.equal.outer(np.minimum(interval, every[-1]), every).astype(float)
        return np.asarray(np.einsum("bsc,bw->bswc", columns, apart).reshape(*columns.shape[:2], -1))

    def _found(self, instances: Sequence[EffectInstance]) -> tuple[Array, Array]:
        """Responses of the sensors to effects together (blocks, sensors), and their derivatives (..., f)."""
        sensors = len(self.rig.twin.sensors)
        values, slopes = np.zeros((self.blocks, sensors)), [np.zeros((self.blocks, sensors, 0))]
        for made in self._effects(instances):
            values += made[:, :, 0]
            slopes.append(made[:, :, 1:])
        return values, np.concatenate(slopes, axis=2)

    def _effects(self, instances: Sequence[EffectInstance]) -> list[Array]:
        """Responses of the sensors to each effect, and their derivatives (blocks, sensors, 1 + f)."""
        pairs = [self._features.with_slopes(instance) for instance in instances]
        features, at = ([pair[i] for pair in pairs] for i in (0, 1))
        found: list[Array] = []
        for part in _chunks([table.shape[1] for table in features]):
            found += self._at_sensors([instance.where for instance in instances[part]], features[part], at[part])
        for i, instance in enumerate(instances):
            if instance.effect == compiled_laws.DELAY:  # the columns of each actuator: values, then slopes
                found[i] = np.stack([half.sum(axis=2) for half in np.split(found[i], 2, axis=2)], axis=2)
        return found

    def _at_sensors(self, where: Sequence[str], features: Sequence[Array], at: Sequence[Array]) -> list[Array]:
        """Responses of the sensors (blocks, sensors, c) to averaged features (m, c) of each effect at columns."""
        inside = [i for i, place in enumerate(where) if place != "sensor"]
        found = [np.zeros((self.blocks, len(self.rig.twin.sensors), table.shape[1])) for table in features]
        if inside:
            spread = self._spread(np.hstack([features[i] for i in inside]), np.concatenate([at[i] for i in inside]))
            edges = np.cumsum([features[i].shape[1] for i in inside])[:-1]
            for i, part in zip(inside, np.split(spread, edges, axis=2), strict=True):
                found[i] = part
        for i, table in enumerate(features):
            if where[i] == "sensor":
                found[i][:, int(at[i][0])] = self._means(table, self.every // self.thin)
        return found

    def responses(self, instances: Sequence[EffectInstance]) -> Array:
        """Change of `left` by a unit of each free parameter, to first order (r, f)."""
        rows = _bounded(self._rows(np.concatenate([made[:, :, 1:] for made in self._effects(instances)], axis=2)))
        return self._out(np.vstack([rows, np.zeros((len(self.left) - len(rows), rows.shape[1]))]))

    def around(self, instances: Sequence[EffectInstance]) -> tuple[Array, Array]:
        """Parameters of the rig (k,) and initial states (w, states) that go best with effects."""
        left = self._whole_left.copy()
        for table in self._effects(instances):
            rows = self._rows(table[:, :, :1])[:, 0]
            left[: len(rows)] -= rows
        step = self._back @ (self.taken.T @ left)
        theta, start = self.base.theta, self.base.start.copy()
        if not np.isfinite(step).all():  # the motion runs away along an effect
            return theta, start
        free = [*self.rig.twin.free]
        start[:, free] += step[len(theta) : len(theta) + len(start) * len(free)].reshape(len(start), len(free))
        return np.clip(theta + step[: len(theta)], self.bounds.low, self.bounds.high), start

    def scores(self, candidates: Sequence[Candidate]) -> list[Score]:
        """Reduction of the cost by each candidate, the best first."""
        found: dict[int, Score] = {}
        self._settle([(candidate, instance) for candidate in candidates for instance in candidate.instances], found)
        for width in ZOOMS:  # nearer to the steps of converters, whose effect has no slope to follow
            stepped = [p for p in found.values() if p.candidate.entry.quantum and p.gain > 0.0]
            parts = 1.0 + np.linspace(-width, width, 9)
            self._settle(
                [(p.candidate, p.instance.times(part, p.instance.free)) for p in stepped for part in parts], found
            )
        best = max((score.gain for score in found.values()), default=0.0)
        near = [p for p in found.values() if p.gain > self.rules.score_fraction * best and p.candidate.has_shape]
        sharper = self._sharpened(sorted(near, key=lambda score: -score.gain)[: self.rules.most_sharpened])
        kept = [sharper.get(id(score.candidate), score) for score in found.values()]
        return sorted(kept, key=lambda score: -score.gain)

    def _sharpened(self, scores: Sequence[Score]) -> dict[int, Score]:
        """Scores whose shapes are brought to their best values, by damped steps of all of them at once."""
        best = {id(score.candidate): score for score in scores}
        instances = {key: score.instance for key, score in best.items()}
        damping, active = 1e-4, [score.candidate for score in scores]
        for number in range(STEPS):
            columns = self._effects([instances[id(candidate)] for candidate in active])
            going = []
            for candidate, table in zip(active, columns, strict=True):
                key = id(candidate)
                # The gain of the grid is not of the same rows: it is replaced by that of the first round.
                least = -np.inf if number == 0 else best[key].gain
                rows = self._rows(table)
                if not np.abs(rows).max() < HUGE:
                    continue
                known = self.taken[: len(rows)].T @ rows
                gram, right = rows.T @ rows - known.T @ known, rows.T @ self.left[: len(rows)]
                gain = 2.0 * float(right[0]) - float(gram[0, 0])
                if gain > least:
                    best[key] = replace(best[key], instance=instances[key], gain=max(gain, 0.0))
                    step, _ = System(gram[1:, 1:], right[1:] - gram[1:, 0]).step(damping)
                    one = instances[key]
                    instances[key] = one.with_values(one.free, bounds([one]).after(np.array(one.estimated), step))
                    going.append(candidate)
            active, damping = going, damping / 10.0
        return best

    def _settle(self, jobs: Sequence[tuple[Candidate, EffectInstance]], found: dict[int, Score]) -> None:
        channels = len(self.rig.twin.actuators)
        sizes = [channels if one.effect == compiled_laws.DELAY else max(1, len(one.factors)) for one, _ in jobs]
        with ThreadPoolExecutor(2) as pool:
            for scores in pool.map(self._scored, [jobs[part] for part in _chunks(sizes)]):
                for score in scores:
                    before = found.get(id(score.candidate))
                    if before is None or score.gain > before.gain:
                        found[id(score.candidate)] = score

    def _scored(self, jobs: Sequence[tuple[Candidate, EffectInstance]]) -> list[Score]:
        """Scores of instances of candidates; their columns together are at most `MOST_COLUMNS`."""
        made = self.products(jobs)
        parts = (slice(own[0], own[-1] + 1) for own in made.columns)
        return [
            self._score(Score(*job, 0.0), made.gram[part, part], made.right[part], made.squares[part])
            for job, part in zip(jobs, parts, strict=True)
        ]

    def unique(self, instance: EffectInstance) -> float:
        """Part of what an effect does to the sensors that parameters of the rig could not do, in rms.

        Of an inertia, it is what no one of them could do: equations that are divided by a mass hold it in several.
        """
        rows = _bounded(self._rows(self._effects([instance])[0][:, :, 1:]))
        squares = (rows**2).sum(axis=0)
        if instance.entry.is_inertia:
            others, ones = (part.T @ rows for part in self.single)
            beyond = squares - (others**2).sum(axis=0) - (ones**2).max(axis=0, initial=0.0)
        else:
            beyond = squares - ((self.possible.T @ rows) ** 2).sum(axis=0)
        total = float(squares.sum())
        return float(np.sqrt(np.maximum(beyond, 0.0).sum() / total)) if total > 0.0 else 0.0

    def products(self, jobs: Sequence[tuple[Candidate, EffectInstance]]) -> Products:
        """Products of the columns of instances of candidates."""
        features, at = zip(*(self._features.by_factors(*job) for job in jobs), strict=True)
        made = self._at_sensors([instance.where for _, instance in jobs], features, at)
        tables = [
            table.sum(axis=2, keepdims=True) if candidate.effect == compiled_laws.DELAY else table
            for (candidate, _), table in zip(jobs, made, strict=True)
        ]
        ends = np.cumsum([table.shape[2] for table in tables])
        columns = np.split(np.arange(ends[-1]), ends[:-1])
        rows = _bounded(self._rows(np.concatenate(tables, axis=2)))
        # Products of the projected columns, without making these.
        known = self.taken[: len(rows)].T @ rows
        gram, right = rows.T @ rows - known.T @ known, rows.T @ self.left[: len(rows)]
        return Products(gram, right, np.einsum("ij,ij->j", rows, rows), columns)

    def _score(self, nothing: Score, gram: Array, right: Array, squares: Array) -> Score:
        candidate, instance = nothing.candidate, nothing.instance
        diagonal = np.diag(gram)
        if not (diagonal > ROUNDING * squares).any():
            return nothing
        if not candidate.factors:  # a shape without factors: the size of its effect tells how near it is
            gain = 2.0 * float(right[0]) - float(diagonal[0])
            if instance.entry.grows_with:
                factor = float(right[0] / diagonal[0])
                if factor <= 0.0:
                    return nothing
                gain = max(gain, factor * float(right[0]))
                instance = instance.times(min(factor, GROWTH), instance.free)
            elif instance.entry.quantum:
                gain = max(gain, float(right[0]) ** 2 / float(diagonal[0])) if right[0] > 0.0 else 0.0
            return Score(candidate, instance, max(gain, 0.0))
        factors = best_factors(gram, right, squares)
        if instance.entry.scaled:  # its one factor scales forces and stiffness together
            if factors[0] <= 0.0:
                return nothing
            scaled_by = instance.entry.indices(instance.entry.scaled)
            instance = instance.with_values(scaled_by, factors[0] * np.array([instance.values[i] for i in scaled_by]))
        else:
            box = bounds([replace(instance, free=candidate.factors)])
            if instance.entry.is_inertia:  # a mass that is left is positive
                lightest = LIGHTEST / max(self.rig.mobilities.get(instance.at, 0.0), 1e-300)
                box = replace(box, low=np.maximum(box.low, -lightest))
            if (factors < box.low).any():
                if (factors <= 0.0).all() and (box.low >= 0.0).any():
                    return nothing
                factors = np.where(box.low >= 0.0, np.maximum(factors, LEAST * np.abs(factors).max()), factors)
            factors = np.clip(factors, box.low, box.high)
            instance = instance.with_values(candidate.factors, factors)
        return Score(candidate, instance, max(float(2.0 * factors @ right - factors @ gram @ factors), 0.0))

    def _spread(self, features: Array, at: Array, initial: IntVector | None = None) -> Array:
        """Responses of the sensors (blocks, sensors, M) to forces (m, M) at columns (M,), or to `initial` states."""
        rig, record = self.rig, self.record
        sensors, many = len(rig.twin.sensors), features.shape[1]
        found = np.empty((self.blocks, sensors * many))
        p, _ = rig.basis(self.base.theta)
        every = self.every // self.thin
        self.work.add(self.blocks * every, many)
        is_direct = bool(rig.equations.meta["depends"][1])
        blocks = Blocks(self.blocks * every, self.thin / record.rate, every, self.interval_samples)
        sources = Sources(at.astype(np.int64), np.full(many, -1) if initial is None else initial)
        motion = KnownMotion(self._states, self._commands)
        if many:
            rig.kernels.respond(blocks, is_direct, sources, motion, p, np.ascontiguousarray(features), found)
        return found.reshape(self.blocks, sensors, many)

    def _means(self, table: Array, every: int = 0) -> Array:
        """Means over blocks (blocks, columns) of a table (m, columns)."""
        every = every or self.every
        return np.asarray(table[: self.blocks * every].reshape(self.blocks, every, -1).mean(axis=1))

    def _rows(self, columns: Array) -> Array:
        """Columns (blocks, sensors, c) in standard deviations, as rows (blocks * sensors, c)."""
        with np.errstate(over="ignore"):  # a force along which the rig's motion runs away is as good as infinite
            return np.asarray((columns * self.scale[None, :, None]).reshape(-1, columns.shape[2]))

    def _out(self, x: Array) -> Array:
        return x - self.taken @ (self.taken.T @ x)


def best_factors(gram: Array, right: Array, squares: Array) -> Array:
    """Factors of columns that fit best (c,), 0 for those that are rounding alone; see `Products`."""
    factors, keep = np.zeros(len(right)), np.diag(gram) > ROUNDING * squares
    if keep.sum() == 1:
        factors[keep] = right[keep] / np.diag(gram)[keep]
        return factors
    scale = np.sqrt(np.diag(gram)[keep])
    scaled = gram[np.ix_(keep, keep)] / np.outer(scale, scale)
    factors[keep] = decompositions.least_squares(scaled, right[keep] / scale, COLLINEAR) / scale
    return factors


def _bounded(rows: Array) -> Array:
    """Responses (r, c) with 0 for those along which the rig's motion runs away: they have no weight."""
    return np.where(np.abs(rows).max(axis=0, initial=0.0) < HUGE, rows, 0.0)


def _apart(columns: Array, others: Array, rank: float) -> tuple[Array, Array]:
    """Basis of other columns (r, o), and each of the columns (r, k) without these, of length 1."""
    u, s, _ = decompositions.svd(others / np.maximum(np.linalg.norm(others, axis=0), 1e-300))
    basis = u[:, s > rank * s.max(initial=0.0)]
    left = columns - basis @ (basis.T @ columns)
    size = np.linalg.norm(left, axis=0)
    independent = size > RANK * np.linalg.norm(columns, axis=0)
    return basis, np.where(independent, left / np.where(independent, size, 1.0), 0.0)


def _chunks(sizes: Sequence[int]) -> Iterator[slice]:
    """Slices of items that have at most `MOST_COLUMNS` columns together."""
    first = total = 0
    for i, size in enumerate(sizes):
        if total + size > MOST_COLUMNS and i > first:
            yield slice(first, i)
            first, total = i, 0
        total += size
    if sizes:
        yield slice(first, len(sizes))
