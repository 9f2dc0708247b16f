"""Fitting: the rig with effects at some places, brought as near to its records as its parameters let it.

The parameters of the rig have a normal prior around their declared values; the initial state of each shooting interval
is estimated. The likelihood is that of `discrepancy`: what no values explain weighs as little as it is worth, so that
the prior holds parameters which would else go far to stand for what is missing.
Source: as `masking.compile.numerics.least_squares`; Green (1984), J. R. Stat. Soc. B 46(2), 149-192, for weights that
follow the residuals.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.compile.numerics.least_squares import Box, Damping, Linearised, Minimum, Patience, System, minimise
from masking.errors import IntegrationError
from masking.inference.discovery import continuation, discrepancy
from masking.inference.discovery.augmented_model import EffectInstance, Equations
from masking.inference.discovery.decision_rules import RULES, DecisionRules
from masking.inference.discovery.discrepancy import Likelihood
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.smoothing import sizes
from masking.inference.estimation.initial_states import FIRST_READINGS
from masking.model.declaration.expression import Expression

MOST_ROUNDS = 40
CONVERGED = 0.01  # of a difference of scores that separates nothing: what a fit leaves decides nothing
IDLE = 50.0  # times what has converged: several steps that take less together are those of a law with corners
STEADY = 1e-6  # part of the information on the best known initial state that others resist a step with
BEHIND = 10.0  # times the cost of a rival, from which a fit with few rounds does not come near it
DAMPING = Damping(1e-6, least=1e-13, most=1e8)


@dataclass(frozen=True)
class Begun:
    """Values that a fit begins from."""

    instances: tuple[EffectInstance, ...]  # the effects with their values
    theta: Array  # parameters of the rig (k,)
    start: Array  # initial states of the shooting intervals (w, states)

    @property
    def added(self) -> Array:
        """Free parameters of the effects (f,)."""
        return estimated(self.instances)

    @property
    def cost(self) -> float:
        """Cost as far as it is known: that of values which are not fitted may be 0."""
        return 0.0


@dataclass(frozen=True)
class Hypothesis(Begun):
    """The rig with effects, fitted."""

    pull: float  # squares of parameters over the variance of their prior
    squares: Array  # of each sensor (sensors,)
    misfits: Array  # squared residuals over the variance of the noise, of each record and sensor (records, sensors)
    independent: Array  # how many independent samples these are worth (records, sensors)
    covariance: Array  # of rig's parameters and free parameters of the effects (k + f, k + f)
    residuals: Array  # of each sample (m, sensors)
    rules: DecisionRules = RULES  # the thresholds that it was fitted by

    @property
    def cost(self) -> float:
        """Squared residuals over the variance of the noise, and parameters over that of their prior."""
        return float(self.misfits.sum()) + self.pull

    def misfit(self, like: Hypothesis) -> float:
        """-2 log likelihood and prior, with the colour of the residual that another one leaves, as a rule the best."""
        return discrepancy.misfit(self.misfits, like.independent) + self.pull

    @property
    def scale(self) -> float:
        """Squared residuals over noise variances that are worth as much as one of noise; 1 or more."""
        return 1.0 / float(discrepancy.weights(self.misfits, self.independent).min())

    @property
    def as_given(self) -> Hypothesis:
        """Hypothesis whose parameters are given: their prior is no part of its likelihood."""
        return replace(self, pull=0.0)

    @property
    def creeping(self) -> Hypothesis:
        """Hypothesis with smooth laws in the place of those that stick."""
        return replace(self, instances=tuple(instance.creeping for instance in self.instances))

    @property
    def deviations(self) -> Array:
        """Standard deviations of rig's parameters and of those of the effects (k + f,)."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))


def nearest(hypotheses: Iterable[Hypothesis]) -> Hypothesis:
    """Hypothesis that leaves least, whose residual says how coloured those of all are."""
    return min(hypotheses, key=lambda one: one.cost)


def estimated(instances: Sequence[EffectInstance]) -> Array:
    """Values of the estimated parameters of effect instances, one after the other (f,)."""
    return np.array([value for instance in instances for value in instance.estimated])


def by_instance(instances: Sequence[EffectInstance], values: Array) -> list[Array]:
    """Values of the estimated parameters of all effect instances (f,) as those of each."""
    return np.split(values, np.cumsum([len(instance.free) for instance in instances], dtype=int))[:-1]


def fit(
    problem: EstimationProblem,
    instances: Sequence[EffectInstance] = (),
    *,
    theta: Array | None = None,
    start: Array | None = None,
    rounds: int = MOST_ROUNDS,
    frozen: bool = False,
    rival: float = np.inf,
    penalty: Array | None = None,
) -> Hypothesis:
    """Fit a rig with effects to a record; no fit costs more than the values that it begins from.

    If the simulated motion loses phase with the record, the fit begins again from those in shorter intervals, which
    grow, unless initial states are given and nothing else is estimated. Where none are given, those that suit the
    values to begin from best count.

    Args:
        problem: the record and the rig.
        instances: effects with values to begin from.
        theta: parameters to begin from; the prior's means if none are given.
        start: initial states to begin from (w, states); from the first readings if none are given.
        rounds: most rounds.
        frozen: whether only the initial state is estimated.
        rival: cost of another hypothesis; a fit that no longer comes near it is abandoned.
        penalty: a' penalty a is added to the cost for free parameters a of the effects (f, f); 0 if not given.

    Raises:
        IntegrationError: the motion is not finite from where it begins.
    """
    x = problem.prior.mean if theta is None else theta
    begun = Begun(tuple(instances), x, problem.first_states(x) if start is None else start)
    shortest = cache(partial(_in_shortest, problem, begun))

    def is_behind() -> bool:
        return shortest(frozen).cost > BEHIND * rival

    ended = partial(solved, problem, rounds=rounds, rival=rival, penalty=penalty, is_behind=is_behind)
    found, is_fresh = ended(begun, frozen=frozen), start is None and not frozen
    if is_fresh:  # the initial states that suit the parameters to begin from best count
        first = ended(begun, frozen=True)
        if first is not None and _better(first, found) is first:
            found = _better(ended(first), first)
    known = frozen and start is not None  # near the states that are given
    for fixed in (False, True) if is_fresh else () if known else (frozen,):
        if found is None or _is_doubtful(problem, found, fresh=is_fresh and not fixed):
            nearer = _continued(problem, shortest(fixed), frozen=fixed, most=BEHIND * rival)
            found = _better(found, ended(nearer, frozen=frozen) if nearer else None)
    if found is None:
        raise IntegrationError("the simulated motion is no longer finite")
    return found


def _is_doubtful(problem: EstimationProblem, found: Hypothesis, *, fresh: bool) -> bool:
    """Whether a fit may have ended in a wrong minimum; if fresh, of a model that rings, by any error."""
    if float(found.squares @ problem.weights) <= problem.rules.small_residual * found.residuals.size:
        return False
    return (fresh and continuation.rings(problem)) or continuation.loses_phase(problem, found.residuals)


def solved(
    problem: EstimationProblem,
    begun: Begun,
    *,
    rounds: int = MOST_ROUNDS,
    frozen: bool = False,
    rival: float = np.inf,
    penalty: Array | None = None,
    is_behind: Callable[[], bool] | None = None,
) -> Hypothesis | None:
    """Fit; None if the motion is not finite from where it begins.

    Args as in `fit`, but for:
        is_behind: whether no fit comes near the rival; asked once, where this one is far from it after many rounds.
    """
    try:
        return _LeastSquares(
            problem, begun.instances, begun.start, frozen=frozen, penalty=penalty, rival=rival, is_behind=is_behind
        ).solve(begun.theta, rounds)
    except IntegrationError:
        return None


def _better(one: Hypothesis | None, other: Hypothesis | None) -> Hypothesis | None:
    if one is None or other is None:
        return one or other
    like = nearest([one, other])
    return other if other.misfit(like) < one.misfit(like) else one


def _in_shortest(problem: EstimationProblem, begun: Begun, frozen: bool) -> Begun:
    """Fit to the first of a record in the shortest intervals; where it begins if there are none."""
    stage = next(continuation.stages(problem), problem)
    return begun if stage is problem else _in_part(next(continuation.parts(stage)), begun, frozen=frozen)


def _in_part(part: EstimationProblem, begun: Begun, *, frozen: bool) -> Begun:
    """Fit to a part of a record in short intervals, whose initial states are guessed."""
    samples = max(4, min(FIRST_READINGS, part.interval_samples // continuation.LINE))
    start = part.first_states(begun.theta, samples)
    return _at_stage(part, Begun(begun.instances, begun.theta, start), frozen=frozen)


def _at_stage(part: EstimationProblem, begun: Begun, *, frozen: bool) -> Begun:
    """Fit in short intervals; where it begins if the motion is not finite there."""
    return solved(part, begun, rounds=continuation.ROUNDS, frozen=frozen) or begun


def _continued(problem: EstimationProblem, begun: Begun, *, frozen: bool, most: float) -> Begun | None:
    """Where a fit in growing shooting intervals ends; None if the intervals cannot be shorter, or it costs too much.

    It goes on from the fit to the first of the record in the shortest intervals. The least cost grows with the
    intervals, so that it ends at the first of them in which it costs more than `most`.
    """
    stages = [*continuation.stages(problem), problem]
    if len(stages) == 1 or begun.cost > most:
        return None
    others = itertools.islice(continuation.parts(stages[0]), 1, None)  # the parameters are those of the first
    every = np.concatenate([begun.start, *(_in_part(part, begun, frozen=True).start for part in others)])
    for before, stage in itertools.pairwise(stages):
        every = continuation.grown(every, before, stage)
        if stage is not problem:
            part = next(continuation.parts(stage))
            begun = _at_stage(part, Begun(begun.instances, begun.theta, every[: part.intervals]), frozen=frozen)
            if begun.cost > most:
                return None
            every[: part.intervals] = begun.start
    return Begun(begun.instances, begun.theta, every)


def together(problem: EstimationProblem, other: EstimationProblem, known: Hypothesis, start: Array) -> Hypothesis:
    """Fit a hypothesis to its own record and to another one at once, which begins at `start` (w, states).

    The initial states that are found are those of both records, the residuals those of its own; the rest as in `fit`.
    """
    begins = np.concatenate([known.start, start])
    return _LeastSquares(problem, known.instances, begins, (other,)).solve(known.theta)


def repeated(problem: EstimationProblem, known: Hypothesis, rival: float = np.inf) -> Hypothesis:
    """Hypothesis that was fitted in larger steps of integration, fitted in those of a problem; errors as `fit`."""
    begun = [*map(problem.in_steps, known.instances)]
    return fit(problem, begun, theta=known.theta, start=known.start, rounds=continuation.ROUNDS, rival=rival)


def cost(problem: EstimationProblem, instances: Sequence[EffectInstance], theta: Array, start: Array) -> float:
    """Cost of a hypothesis that is not fitted; infinite if its motion is not finite."""
    whole = _LeastSquares(problem, tuple(instances), start, frozen=True)
    try:
        return whole.linearised(whole.unknowns(theta), Likelihood(discrepancy.EXACT)).cost
    except IntegrationError:
        return np.inf


def foreseen(problem: EstimationProblem, begun: Begun) -> float:
    """Cost where a fit would end if derivatives were everywhere as where it begins; errors as `fit`."""
    whole = _LeastSquares(problem, begun.instances, begun.start)
    at = whole.linearised(whole.unknowns(begun.theta), Likelihood(discrepancy.EXACT))
    return at.cost - at.equations.step(DAMPING.least)[1]


@dataclass(frozen=True)
class _LeastSquares:
    """Least squares of records and prior.

    The unknowns x (n,) are parameters of rig (k) and effects (f), initial states of effects (s), and of the motion.
    """

    problem: EstimationProblem  # of the record whose residuals are kept
    instances: tuple[EffectInstance, ...]  # the effects
    start: Array  # initial states of each record in turn (w, states); those that are not free stay as they are
    others: tuple[EstimationProblem, ...] = ()  # other records
    frozen: bool = False  # whether only initial states are estimated
    penalty: Array | None = None  # on the free parameters of the effects (f, f); None for none
    # cost of another hypothesis, and whether no fit comes near it; as in `solved`
    rival: float = np.inf
    is_behind: Callable[[], bool] | None = None

    @property
    def records(self) -> tuple[EstimationProblem, ...]:
        return (self.problem, *self.others)

    @cached_property
    def begins(self) -> Array:
        """How far from 0 the states of effects may begin, in one record after the other (s,)."""
        return np.tile([size for instance in self.instances for size in instance.begins], len(self.records))

    @property
    def steepest(self) -> Array:
        """Least values of the effects' parameters that the steps of integration bear (f,)."""
        rig, step = self.problem.rig, self.problem.dt / self.problem.substeps
        found = list[float]()
        for one in self.instances:
            texts = {} if one.sticks else one.entry.least
            known = {"step": step, "mobility": rig.mobilities[one.at]} if texts else {}
            known |= zip(one.entry.parameters, one.values, strict=True) if texts else {}
            found += [Expression(texts[n]).evaluate(known) if n in texts else -np.inf for n in one.names]
        return np.array(found)

    @cached_property
    def penalties(self) -> Array:
        """Weights of squares and products of the effects' parameters in the cost (f, f).

        Errors of instruments are small: a large one would imitate anything.
        """
        found = [size**-2.0 for one in self.instances for size in self.problem.spreads(one)]
        return np.diag(found) if self.penalty is None else np.diag(found) + self.penalty

    @cached_property
    def edges(self) -> tuple[int, int, int]:
        """Where the unknowns of the rig, of the effects, and of the states of effects end."""
        k, f = len(self.problem.prior.mean), len(estimated(self.instances))
        return k, k + f, k + f + len(self.begins)

    @property
    def free(self) -> list[int]:
        return [*self.problem.rig.twin.free]

    @cached_property
    def sizes(self) -> Array:
        """Sizes of initial states that are estimated (w * e,); 0 of unseen ones."""
        return np.tile(sizes(self.problem)[self.free], len(self.start))

    def resistance(self, matrix: Array) -> Array:
        """Addition of steps to the diagonal of the normal equations (n,).

        A speed that friction takes at once hardly shows in the readings: a full step of it would go anywhere, and keep
        the others from theirs.
        """
        found, squares = np.zeros(len(matrix)), self.sizes**2
        known = float((squares * np.diag(matrix)[self.edges[2] :]).max(initial=0.0))
        found[self.edges[2] :] = np.divide(STEADY * known, squares, out=np.zeros_like(squares), where=squares > 0.0)
        return found

    def unknowns(self, theta: Array) -> Array:
        return np.concatenate([theta, estimated(self.instances), 0.0 * self.begins, self.start[:, self.free].ravel()])

    def parts(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Parameters of rig and effects, and initial states of effects and motion (w, states)."""
        theta, added, inner, moving = np.split(x, self.edges)
        start = self.start.copy()
        start[:, self.free] = moving.reshape(len(start), -1)
        return theta, added, inner, start

    def solve(self, theta: Array, rounds: int = MOST_ROUNDS) -> Hypothesis:
        """Fitted hypothesis, from values of the rig's parameters (k,).

        It is fitted again from where it ends while its residual is worth more or fewer samples there.
        """
        x, likelihood = self.unknowns(theta), Likelihood(discrepancy.EXACT) if self.frozen else Likelihood()
        is_settled = False
        while not is_settled:
            made = self._solved(x, likelihood, rounds)
            x, rounds, found, shared = made.x, rounds - made.rounds, made.at.extra, self.edges[1]
            ended, is_behind = found.independent, made.at.cost > likelihood.level(BEHIND * self.rival)
            is_settled = self.frozen or rounds < 1 or is_behind or likelihood.is_of(ended)
            likelihood = Likelihood(samples=ended, weights=discrepancy.weights(found.misfits, ended))
        theta, added, _, start = self.parts(x)
        parts = zip(self.instances, by_instance(self.instances, added), strict=True)
        values = tuple(instance.with_values(instance.free, part) for instance, part in parts)
        return Hypothesis(
            values, theta, start, found.pull, found.every[0].squares, found.misfits, ended,
             made.at.equations.covariance()[:shared, :shared], found.every[0].residuals,
            self.problem.rules,
        )  # fmt: skip

    def _solved(self, x: Array, likelihood: Likelihood, rounds: int) -> Minimum[_Found]:
        """Where the method ends, from values of the unknowns (n,)."""
        rules, slow, costs, enough = self.problem.rules, 0, list[float](), CONVERGED * self.problem.rules.indifferent

        def wanted(now: float) -> float:
            return rules.hopeless_fraction * max(now - likelihood.level(self.rival), 0.0)

        def is_hopeless(now: float, tried: float, expected: float) -> bool:
            nonlocal slow
            costs.append(now)
            slow = slow + 1 if now - tried < wanted(now) else 0
            is_idle = len(costs) > rules.hopeless_steps and costs[-1 - rules.hopeless_steps] - now < IDLE * enough
            is_idle = is_idle or (tried >= now and expected < IDLE * enough)
            is_far = len(costs) == continuation.ROUNDS and now > likelihood.level(BEHIND * self.rival)
            return (
                slow == rules.hopeless_steps or is_idle or (is_far and self.is_behind is not None and self.is_behind())
            )

        prior, effects = self.problem.prior, bounds(self.instances)
        low = np.concatenate([prior.low, np.maximum(effects.low, self.steepest)])
        high = np.concatenate([prior.high, effects.high])
        box = Box(low, high, np.arange(len(low)) >= self.edges[0])
        with np.errstate(over="ignore", invalid="ignore"):  # a step that runs away costs more, and is not taken
            return minimise(
                partial(self.linearised, likelihood=likelihood), x, box, DAMPING, rounds=rounds,
                tolerance=lambda at: enough, patience=Patience(wanted, is_hopeless),
            )  # fmt: skip

    def linearised(self, x: Array, likelihood: Likelihood) -> Linearised[_Found]:
        theta, added, inner, start = self.parts(x)
        starts = np.split(start, np.cumsum([one.intervals for one in self.records])[:-1])
        noise = likelihood.of(np.array([one.weights for one in self.records]))
        pieces = zip(self.records, starts, np.split(inner, len(self.records)), noise, strict=True)
        every = [
            one.equations(theta, begin, self.instances, added, inner=begun, weights=weights, frozen=self.frozen)
            for one, begin, begun, weights in pieces
        ]
        (k, first, last), prior = self.edges, self.problem.prior
        off, deviation, fixed = np.zeros(len(x)), np.full(len(x), np.inf), np.zeros(len(x), dtype=bool)
        off[:k], deviation[:k], fixed[:first] = prior.mean - theta, prior.deviation, self.frozen
        known = self.begins == 0.0
        off[first:last], deviation[first:last], fixed[first:last] = -inner, np.where(known, np.inf, self.begins), known
        rough = max(float(added @ self.penalties @ added), 0.0)  # of factors that run away, rounding may be negative
        pull = float(((off / deviation) ** 2).sum()) + rough
        left = np.array([part.squares * one.weights for part, one in zip(every, self.records, strict=True)])
        ended = _Found(left, pull, self.records, every)
        cost, times = likelihood.cost(left, pull, lambda: ended.independent)
        found = _joined(every, first, len(inner) // len(self.records))
        found = replace(found, matrix=times * found.matrix, gradient=times * found.gradient)
        if not self.frozen:
            found.matrix[k:first, k:first] += self.penalties
            found.gradient[k:first] -= self.penalties @ added
        equations = System(found.matrix, found.gradient, fixed, self.resistance(found.matrix))
        if len(self.start) > 1 and self.free:
            equations = replace(equations, shared=last, block=len(self.free))
        return Linearised(cost, equations.with_prior(off, deviation), ended)


@dataclass(frozen=True)
class _Found:
    """Records at values of the unknowns."""

    misfits: Array  # squared residuals over noise variances (records, sensors)
    pull: float  # of the prior
    records: tuple[EstimationProblem, ...]
    every: Sequence[Equations]  # of each record

    @cached_property
    def independent(self) -> Array:
        """How many independent samples the residuals are worth (records, sensors)."""
        pairs = zip(self.records, self.every, strict=True)
        return np.array([one.independent(part.residuals) for one, part in pairs])


def _joined(parts: Sequence[Equations], shared: int, inner: int) -> Equations:
    """Equations of several records as those of one, with the squares and residuals of the first.

    The first columns are `shared` by all; then come `inner` ones of states inside of effects, each record's own.
    """
    if len(parts) == 1:
        return parts[0]
    sizes = [len(part.gradient) - shared - inner for part in parts]
    ends = shared + inner * len(parts) + np.cumsum([0, *sizes])
    matrix, gradient = np.zeros((ends[-1], ends[-1])), np.zeros(ends[-1])
    for i, part in enumerate(parts):
        first = shared + i * inner
        own = np.concatenate([np.arange(shared), np.arange(first, first + inner), np.arange(ends[i], ends[i + 1])])
        matrix[np.ix_(own, own)] += part.matrix
        gradient[own] += part.gradient
    return replace(parts[0], matrix=matrix, gradient=gradient)


def bounds(instances: Sequence[EffectInstance]) -> Box:
    """Bounds of the free parameters of effects (f,); what is positive may at most double in a step."""
    pairs = [one.entry.parameters[name].bounds for one in instances for name in one.names]
    low = np.array([-np.inf if a is None else a for a, _ in pairs])
    return Box(low, np.array([np.inf if b is None else b for _, b in pairs]), growing=True)
