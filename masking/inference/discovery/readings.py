"""Readings: how a record is taken, and in which other ways it may be, where an answer leaves a doubt.

A reading is searched by itself. Each of the others is tried where an answer calls for it: unseen data alone show
something, the motion loses phase, a channel is of another size, or forces may follow the motion of other places. It
takes the place of the one before only if its answer explains more of unseen data.

A law that the model lacks may hide that a channel has another unit or sign. So a unit is suspected where what was found
needs a gain or a parameter that is several times what is declared, or is unknown, and readings and simulation are of
one size in another unit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import IntegrationError
from masking.inference.discovery import continuation, fitting, shooting_intervals, verdict
from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.discovery_result import Discovery
from masking.inference.discovery.discovery_settings import DiscoverySettings
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.explanation import ahead
from masking.inference.discovery.parameter_prior import prior_of
from masking.inference.discovery.reading_noise import noise_of
from masking.inference.discovery.search_state import Ground
from masking.inference.discovery.smoothing import centred
from masking.inference.discovery.trace import Trace
from masking.inference.discovery.work_budget import Work
from masking.inference.estimation import unit_check
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.unit_check import FAR, STEPS, UnitDoubt

LIKE = 1.2  # times the factor between units, up to which a gain is like it: a law may be mistaken for the rest


@dataclass(frozen=True)
class Reading:
    """A record to explain and another one to validate by, with the model that is fitted to them."""

    problem: EstimationProblem  # the record, in its shooting intervals and in the steps that the model alone needs
    unseen: Data
    noise: Array  # standard deviation of that of each unseen reading (sensors,)
    settings: DiscoverySettings
    doubt: UnitDoubt | None = None  # unit of a channel that is another than declared
    exchanged: bool = False  # whether the record to validate by is explained

    @classmethod
    def of(cls, rig: AugmentedModel, train: Data, unseen: Data, settings: DiscoverySettings) -> Reading:
        """Reading of two records as they are declared, or in the unit that their sizes tell."""
        twin, rules = rig.twin, settings.rules
        prior, most = prior_of(twin, rig, settings.tolerance, rules), max(1, twin.substeps(train.rate) // 2)
        work = Work.allowed(len(train), len(twin.state_names) + len(twin.free) + len(prior.mean))
        noise = noise_of(twin, train)
        whole = EstimationProblem(rig, train, prior, noise, most, rules=rules, work=work, trace=Trace())
        whole = centred(whole)
        declared = cls(whole, unseen, noise_of(twin, unseen), settings)
        doubt = doubted(whole)
        return declared.in_intervals(settings.shooting_interval) if doubt is None else declared.in_unit(doubt)

    def in_intervals(self, seconds: float | None) -> Reading:
        """Same in shooting intervals of some length, or of that which suits the model."""
        whole = replace(self.problem, interval=0).apart()
        part = replace(whole, interval=shooting_intervals.interval(whole, seconds))
        return replace(self, problem=replace(part, substeps=shooting_intervals.substeps(part)))

    def in_unit(self, doubt: UnitDoubt) -> Reading:
        """Same with the channels in another unit, or with another sign."""
        whole = replace(self.problem, interval=0).under(f"another unit or sign of {' and '.join(doubt.names)}")
        unseen = doubt.of(whole.rig.twin, self.unseen)
        made = replace(self, problem=converted(doubt, whole), unseen=unseen, doubt=doubt)
        return replace(made, noise=noise_of(whole.rig.twin, unseen)).in_intervals(self.settings.shooting_interval)


def exchanged_records(reading: Reading, found: Discovery) -> Iterator[Reading]:
    """The other record explained, where that alone shows something."""
    if found.is_hidden:
        problem = reading.problem
        other = Reading.of(problem.rig, reading.unseen, problem.record, reading.settings)
        trace = problem.trace.under("the records exchanged")
        yield replace(other, problem=replace(other.problem, trace=trace), exchanged=True)


def shorter_intervals(reading: Reading, found: Discovery) -> Iterator[Reading]:
    """Shooting intervals of a few oscillations, where a simulation of the whole record does not follow its motion."""
    base, size, rules = found.search.base, found.problem.record.readings.size, found.problem.rules
    is_near = found.verdict != "unknown" or verdict.leaves_little(found.search.best.cost, base.cost, size, rules)
    is_lost = max(found.problem.errors(base.hypothesis.squares).values()) > rules.phase_loss
    if is_lost and not is_near and reading.settings.shooting_interval is None and not reading.problem.interval:
        for seconds in shooting_intervals.shorter(reading.problem):
            part = reading.in_intervals(seconds)
            yield replace(part, problem=part.problem.under(f"in shooting intervals of {seconds:.2g} s"))


def another_unit(reading: Reading, found: Discovery) -> Iterator[Reading]:
    """Another unit or sign of a channel, where a gain or a parameter is far off or nothing is found."""
    if reading.doubt is None and (found.verdict == "unknown" or found.far_off):
        doubt = suspected(replace(reading.problem, interval=0), found)
        if doubt is not None:
            yield reading.in_unit(doubt)


def directed_places(reading: Reading, found: Discovery) -> Iterator[Reading]:
    """Places whose forces follow something else than the motion they act on, where more than noise is left.

    They are more than all other places together. So the model without causes is screened with them first: they are
    searched if a cause there scores most, or one of two between coordinates half of that.
    """
    rig = replace(found.problem.rig, directed=True)
    every = len(rig.places) == len(found.problem.rig.places)
    if every or found.is_at_noise_floor or found.is_hidden or found.problem.work.ends():
        return
    problem = replace(found.problem.under("directed places"), rig=rig, substeps=reading.problem.substeps)
    part = {"coordinate": problem.rules.score_fraction}
    wanted = {place.name: part.get(place.directed, 1.0) for place in rig.places if place.directed}
    try:
        seen = Ground.beside(problem, found.search.base).screened(found.search.base)
    except IntegrationError:
        return
    scores = [] if seen is None else seen[1]
    most = max((score.gain for score in scores if score.candidate.at not in wanted), default=0.0)
    if any(score.gain > wanted.get(score.candidate.at, float("inf")) * most for score in scores):
        yield replace(reading, problem=problem)


OTHERS = (exchanged_records, shorter_intervals, another_unit, directed_places)


def explains_more(again: Discovery, found: Discovery) -> bool:
    """Whether an answer explains more of unseen data than another one, or no less in a likelier way.

    Likelier is by more than a cause costs, of the same record in intervals as long.
    """
    rules = found.problem.rules
    after, before = (one.simulation_error.over_noise for one in (again, found))
    if again.far_off or not after <= rules.noise_floor * before:
        return False
    is_known = again.verdict != "unknown"
    if is_known and (found.verdict == "unknown" or found.far_off):
        return True
    is_alike = again.exchanged == found.exchanged and again.problem.interval == found.problem.interval
    is_likelier = is_known and is_alike and ahead(again.explanation, found.explanation) > rules.effect_evidence
    return is_likelier or after < rules.much_less * before


def doubted(problem: EstimationProblem) -> UnitDoubt | None:
    """Unit that is probably another than declared, before a search; None where none is."""
    return unit_check.doubted(problem.rig.twin, problem.record, partial(_residuals, problem))


def suspected(problem: EstimationProblem, found: Discovery) -> UnitDoubt | None:
    """Unit that makes readings and simulation one size, which they are not in the declared one; or None.

    A law may change the size of a motion by itself: a gain that is as large as a factor between units counts, too. What
    explains the record in the declared unit is known; the problem is simulated whole.
    """
    twin, record = problem.rig.twin, problem.record
    compare = unit_check.comparison(record, partial(_residuals, problem))
    every = (replace(one, otherwise=found.far_off) for one in unit_check.others(twin, record) if one.kind != "clock")
    before, size = compare(record)
    tried = [*unit_check.tried(twin, record, every, compare, before)]
    best, least = unit_check.best_of(tried)
    return best if best and FAR * least < size else next((one for one, _ in tried if is_gain(one)), None)


def is_gain(doubt: UnitDoubt) -> bool:
    """Whether a record needs a gain of the one channel that is about the factor of its unit."""
    gains = {on: times for (_, on), times in doubt.otherwise if on and times}
    known = gains if doubt.kind == "actuator" else {on: 1.0 / times for on, times in gains.items()}
    by = known.get(doubt.names[0], 0.0) / doubt.factor if len(doubt.names) == 1 else 0.0
    return 1.0 / LIKE < by < LIKE


def converted(doubt: UnitDoubt, problem: EstimationProblem) -> EstimationProblem:
    """Problem with the channels in the declared unit."""
    twin, sigma = problem.rig.twin, problem.sigma.copy()
    if doubt.kind == "sensor":
        sigma[[twin.sensors.index(name) for name in doubt.names]] *= abs(doubt.factor)
    record = doubt.of(twin, problem.record)
    steps = _steps(problem, record) if doubt.kind == "clock" else problem.substeps
    return replace(problem, record=record, sigma=sigma, substeps=steps)


def _steps(problem: EstimationProblem, record: Data) -> int:
    return min(max(1, problem.rig.twin.substeps(record.rate) // 2), STEPS)


def _residuals(problem: EstimationProblem, record: Data) -> Array | None:
    """Residuals of the model as declared along a record, its initial state fitted; None if its motion is not finite."""
    mean = problem.prior.mean
    here = replace(
        problem, record=record, sigma=np.maximum(record.readings.std(axis=0), 1e-300), substeps=_steps(problem, record)
    )
    try:
        begun = fitting.Begun((), mean, here.first_states(mean))
    except IntegrationError:
        return None
    made = fitting.solved(here, begun, rounds=continuation.ROUNDS, frozen=True)
    return None if made is None else made.residuals
