"""Stages of a discovery: from a record and a model to the effect that the model is missing, and how sure that is.

Source of the method: output-error identification with candidate terms, Ljung (1999), System Identification, chapters 7
and 16; the terms are physical effects with parameters and states of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.errors import IntegrationError, MaskingError
from masking.inference.discovery import (
    fitting,
    held_out,
    instrument_errors,
    shooting_intervals,
    units_after_search,
    verdict,
)
from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.composites import are_composite, is_of_one_family
from masking.inference.discovery.directed_places import are_worth_a_search
from masking.inference.discovery.discovery_result import (
    Alternative,
    Discovery,
    Errors,
    Estimate,
    Named,
    SimulationError,
)
from masking.inference.discovery.discovery_settings import DiscoverySettings
from masking.inference.discovery.explanation import Explanation, nearest
from masking.inference.discovery.fitting import Hypothesis, by_instance
from masking.inference.discovery.grading import with_grades
from masking.inference.discovery.name_or_unnamed import beside_names
from masking.inference.discovery.next_experiment import NextExperiment, declared_limits, next_experiment
from masking.inference.discovery.prior import prior_of, train_validation_split, uncertain
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.reading_noise import noise_of, steps_of
from masking.inference.discovery.rules import DecisionRules
from masking.inference.discovery.search import SearchResult, Tell
from masking.inference.discovery.smoothing import centred
from masking.inference.discovery.trace import Trace
from masking.inference.discovery.verdict import Scored
from masking.inference.discovery.work_budget import Work
from masking.inference.estimation.identification_data import NOT_LATE, Data
from masking.inference.estimation.unit_check import UnitDoubt
from masking.model.effects import ROUNDING

FINER = 4  # times the steps of integration in which an effect was fitted: those of the errors that are stated
LISTED = 1e-4  # probability from which an alternative is listed: less is never chosen


def discover(
    twin: Twin,
    record: Data,
    validation: Data | None = None,
    settings: DiscoverySettings | None = None,
    *,
    rig: AugmentedModel | None = None,
    tell: Tell | None = None,
) -> Discovery:
    """Find out which physical effect the model of a rig lacks.

    If the residual of a search over the whole record shows that the simulated motion loses phase with the recorded one,
    the search is repeated with shooting intervals of a few oscillations.

    Args:
        twin: the rig as its model declares it.
        record: commands and readings that the model does not reproduce.
        validation: another record to validate by; if not given, the last part of the record is held out.
        settings: parameters to re-fit, their tolerance, and the shooting interval; the files that it names are read
            by the workflow, not here.
        rig: the augmented model of the twin, if it has been made before.
        tell: called with what is done, and the fraction done.

    Raises:
        RecordError: the record is too short or clipped, or a reading is constant.
        IntegrationError: the rig cannot be simulated along the record.
    """
    settings = settings or DiscoverySettings()
    rig = rig or AugmentedModel(twin, tuple(settings.parameters) or uncertain(twin))
    say = tell or (lambda text, part: None)
    say("preparing the rig; the first time, it is compiled", 0.0)
    record.refuse_constant(twin)
    train, unseen = record, validation
    if unseen is None:
        train, unseen = train_validation_split(record, settings.rules.held_out)
    trace = Trace()
    found = _discovered(rig, (train, unseen), settings, trace, say)
    if not found.is_hidden:
        return found
    say("only unseen data show it: they are searched, and validated by the others", 0.0)
    try:
        again = _discovered(rig, (unseen, train), settings, trace.under("the records exchanged"), say)
    except MaskingError:
        return found
    return found if again.explanation.kind == "none" else replace(again, exchanged=True)


def _discovered(
    rig: AugmentedModel, records: tuple[Data, Data], settings: DiscoverySettings, trace: Trace, say: Tell
) -> Discovery:
    """Discovery in the first of two records, validated by the other."""
    (train, unseen), twin, rules = records, rig.twin, settings.rules
    prior, most = prior_of(twin, rig, settings.tolerance, rules), max(1, twin.substeps(train.rate) // 2)
    work = Work.allowed(len(train), len(twin.state_names) + len(twin.free) + len(prior.mean))
    with threadpool_limits(1):
        whole = centred(
            EstimationProblem(rig, train, prior, noise_of(twin, train), most, rules=rules, work=work, trace=trace)
        )
    named, substeps, doubt = _in_likeliest_unit(whole, unseen, settings, say)
    directed = _with_directed(named, substeps, named.validation.record, named.validation.sigma, say)
    stated = with_grades(_stated(replace(beside_names(directed, substeps, say), unit=doubt)))
    return stated if stated.is_at_noise_floor else replace(stated, first_order_hold=_with_first_order_hold(stated))


def _in_likeliest_unit(
    whole: EstimationProblem, unseen: Data, settings: DiscoverySettings, say: Tell
) -> tuple[Discovery, int, UnitDoubt | None]:
    """Discovery and integration steps as `_in_unit`, and the unit if it is probably another than declared."""
    say("checking units", 0.0)
    with threadpool_limits(1):
        doubt = units_after_search.doubted(whole)
    found, substeps = _in_unit(doubt, whole, unseen, settings, say)
    if doubt is not None or not (found.verdict == "unknown" or found.is_far_off):
        return found, substeps, doubt
    with threadpool_limits(1):
        other = units_after_search.suspected(whole, found.explanation.hypothesis)
    if other is not None:
        say(f"once more, with another unit or sign of {' and '.join(other.names)}", 0.0)
        again, steps = _in_unit(other, whole, unseen, settings, say)
        if _explains_more(found, again):
            return again, steps, other
    return found, substeps, None


def _in_unit(
    doubt: UnitDoubt | None, whole: EstimationProblem, unseen: Data, settings: DiscoverySettings, say: Tell
) -> tuple[Discovery, int]:
    """Discovery in a record whose channels are in some unit, and the integration steps of the model alone.

    The problem of the record, simulated whole, and the validation record are as declared; no doubt means these.
    """
    if doubt is not None:
        whole = whole.under(f"another unit or sign of {' and '.join(doubt.names)}")
        whole, unseen = units_after_search.converted(doubt, whole), doubt.of(whole.rig.twin, unseen)
    problem = replace(whole, interval=shooting_intervals.interval(whole, settings.shooting_interval))
    problem = replace(problem.apart(), substeps=shooting_intervals.substeps(problem))
    noise = noise_of(whole.rig.twin, unseen)
    found = _explained(problem, unseen, noise, say)
    if settings.shooting_interval is None and not problem.interval and _loses_phase(found):
        problem = problem.apart()
        for seconds in shooting_intervals.shorter(whole):
            say(f"the motion loses phase with the record: in shooting intervals of {seconds:.2g} s", 0.0)
            part = problem.under(f"in shooting intervals of {seconds:.2g} s")
            part = replace(part, interval=shooting_intervals.interval(whole, seconds))
            again = _explained(part, unseen, noise, say)
            if again.verdict != "unknown":
                found = again
                break
    return found, problem.substeps


def _explains_more(found: Discovery, again: Discovery) -> bool:
    """Whether a record is explained in another unit, and less well or in a less likely way as declared."""
    before, after = (one.simulation_error.over_noise for one in (found, again))
    if again.is_far_off or not after <= units_after_search.NO_WORSE * before:
        return False
    return found.is_far_off or again.verdict != "unknown" or after < units_after_search.MUCH_LESS * before


def _with_directed(found: Discovery, substeps: int, unseen: Data, noise: Array, say: Tell) -> Discovery:
    """Discovery that tries directed places, too, where the others leave more than noise.

    One with a cause at such a place takes the place of one without it only if it leaves a small part of the excess.
    """
    rig = replace(found.problem.rig, directed=True)
    every = len(rig.places) == len(found.problem.rig.places)
    if every or found.is_at_noise_floor or found.is_hidden or found.problem.work.ends():
        return found
    say("forces between coordinates, of commands elsewhere and under load", 0.0)
    problem = replace(found.problem.under("directed places"), rig=rig, substeps=substeps)
    try:
        with threadpool_limits(1):
            is_worth = are_worth_a_search(problem, found.search.base.hypothesis)
        again = _explained(problem, unseen, noise, say) if is_worth else found
    except IntegrationError:
        return found
    costs, size = (again.explanation.cost, found.explanation.cost), found.record.readings.size
    places = {place.name for place in rig.places if place.directed}
    is_directed = any(one.at in places for one in again.explanation.hypothesis.instances)
    return again if is_directed and verdict.leaves_little(*costs, size, problem.rules) else found


def _stated(found: Discovery) -> Discovery:
    """Discovery with the errors of its effects in finer steps of integration, as others simulate them."""
    known, errors = found.explanation.hypothesis, found.simulation_error
    if not known.instances:
        return found
    stated = list[dict[str, float]]()
    for part, start in ((found.problem, known.start), (found.validation, found.after.start)):
        fine = replace(part, substeps=FINER * part.substeps)
        try:
            with threadpool_limits(1):
                made = fitting.fit(fine, known.instances, theta=known.theta, start=start, frozen=True)
        except IntegrationError:
            return found
        stated.append(fine.errors(made.squares))
    estimation, validation = errors.estimation._replace(after=stated[0]), errors.validation._replace(after=stated[1])
    return replace(found, simulation_error=replace(errors, estimation=estimation, validation=validation))


def _with_first_order_hold(found: Discovery) -> dict[str, float] | None:
    """Errors with first-order hold of commands; None if they are no smaller."""
    if found.record.hold != "zero-order" or not found.twin.actuators:
        return None
    problem = replace(found.problem, record=replace(found.record, hold="first-order", late=NOT_LATE))
    with threadpool_limits(1), suppress(IntegrationError):
        other = fitting.fit(problem)
        size = found.record.readings.size
        if other.cost - size < problem.rules.first_order_hold_fraction * (found.explanation.cost - size):
            return problem.errors(other.squares)
    return None


def _loses_phase(found: Discovery) -> bool:
    """Whether a simulation of the whole record explains hardly anything, and does not follow its motion."""
    left = found.problem.errors(found.search.base.hypothesis.squares)
    return _near(found) is None and max(left.values()) > found.problem.rules.phase_loss


def _explained(problem: EstimationProblem, unseen: Data, noise: Array, say: Tell) -> Discovery:
    """Discovery in a record that is simulated in steps fine enough for its causes."""
    found = _found(problem, unseen, noise, say)
    known = _near(found)
    if known is None or problem.work.ends():
        return found
    with threadpool_limits(1):
        steps = shooting_intervals.finer(found.problem, known, problem.substeps)
    if steps == found.problem.substeps:
        return found
    say(f"again, with {steps} steps between samples", 0.0)
    alone = problem.substeps if known.instances else steps
    return _found(replace(found.problem.under("finer steps"), substeps=alone), unseen, noise, say, steps)


def _near(found: Discovery) -> Hypothesis | None:
    """Hypothesis whose law steps of integration are to resolve; None if none is near.

    Of an unknown law, that is the first cause if it leaves hardly anything: the remainder may be errors of integration.
    """
    if found.verdict != "unknown":
        return found.explanation.hypothesis
    base, size = found.search.base, found.problem.record.readings.size
    first = found.search.steps[0][0] if found.search.steps else base
    return first.hypothesis if verdict.leaves_little(first.cost, base.cost, size, found.problem.rules) else None


def _found(problem: EstimationProblem, unseen: Data, noise: Array, say: Tell, substeps: int = 0) -> Discovery:
    """Discovery in one search of a record, with the noise of the unseen one (sensors,).

    The problem has the integration steps of the model alone; models with effects have as many as they need by default.
    """
    with threadpool_limits(1):  # small matrices: more threads of BLAS only wait for each other
        search, known = instrument_errors.searched(problem, say, substeps)
        validation = replace(known, record=unseen, sigma=noise)
        declared = Explanation("none", (), fitting.fit(known, theta=known.prior.mean, frozen=True))
        before, adjusted = (fitting.validated(validation, one) for one in (declared.hypothesis, search.base.hypothesis))
        left, declared_left = (float(one.misfits.sum()) for one in (adjusted, before))
        if verdict.is_worse(left, declared_left, before.residuals.size, problem.rules):
            adjusted = before  # parameters that are worse on unseen data are not kept
        say("comparing explanations on data that were not used", 0.95)
        search = replace(search, steps=tuple(_reordered(step, known, validation) for step in search.steps))
        rivals, is_demoted = _likeliest(search, known, validation, adjusted)
        given = held_out.no_worse((rivals, (search.base,), (declared,)), known, validation, before)
    chosen, rules, size = given.explanation, problem.rules, problem.record.readings.size
    adjusted = given.after if given.rivals[0] is search.base else adjusted
    errors = SimulationError(
        Errors(known.errors(declared.hypothesis.squares), known.errors(chosen.hypothesis.squares)),
        Errors(validation.errors(before.squares), validation.errors(given.after.squares)),
        known.noise_floor, validation.noise_floor, validation.errors(adjusted.squares), given.alone,
    )  # fmt: skip
    without, after = (float(one.misfits.sum()) for one in (adjusted, given.after))
    unexplained = max(
        verdict.part_left(search.base.cost, chosen.cost, size, rules),
        verdict.part_left(without, after, given.after.residuals.size, rules),
    )
    scored, composite = _scored(given.rivals, known.rig, rules), are_composite(chosen.names, known.rig, rules)
    effects = _causes(known.rig, (chosen, *given.rivals[1:]), scored)
    rounded = _rounded(known, chosen.hypothesis)
    answer = verdict.revised(
        verdict.decide(scored, unexplained, size, rules, composite=composite),
        demoted=is_demoted,
        rounded=not effects and any(is_much for _, is_much in rounded),
        at_noise=errors.is_noise(len(unseen), rules),
    )
    return Discovery(
        verdict=answer, twin=known.rig.twin, problem=known, explanation=chosen, search=search,
        effects=(*effects, *(cause for cause, _ in rounded)), simulation_error=errors,
        unexplained_fraction=unexplained, rivals=given.rivals, validation=validation,
        before=before, after=given.after, adjusted=adjusted, withheld=given.withheld,
        next_experiment=_separating(known, given.rivals, say) if answer == "ambiguous" else None,
    )  # fmt: skip


def _likeliest(
    found: SearchResult, problem: EstimationProblem, validation: EstimationProblem, adjusted: Hypothesis
) -> tuple[tuple[Explanation, ...], bool]:
    """Explanations of the last step that is needed, the likeliest first, and whether parsimony put it behind."""
    needed = _needed(found, validation, adjusted)
    like, scored = nearest(needed), _scored(needed, problem.rig, problem.rules)
    is_demoted = verdict.is_demoted(scored, problem.record.readings.size, problem.rules)
    return tuple(sorted(needed, key=lambda rival: rival.score(like))) if is_demoted else needed, is_demoted


def _separating(problem: EstimationProblem, rivals: Sequence[Explanation], say: Tell) -> NextExperiment | None:
    say("looking for an experiment that separates them", 0.95)
    first, second = rivals[:2]
    with threadpool_limits(1):
        limits = declared_limits(problem.rig.twin)
        return next_experiment(problem, first.hypothesis, second.hypothesis, (_name(first), _name(second)), limits)


def _name(explanation: Explanation) -> str:
    name, at = explanation.names[-1]
    return f"{name} at {at}" if at else name


def _cost(problem: EstimationProblem, hypothesis: Hypothesis) -> float:
    try:
        return float(fitting.validated(problem, hypothesis).squares @ problem.weights)
    except IntegrationError:
        return np.inf


def _reordered(
    rivals: tuple[Explanation, ...], problem: EstimationProblem, validation: EstimationProblem
) -> tuple[Explanation, ...]:
    """Explanations that are nearly as good as the best, ordered by how well they explain another record, too."""
    like, margin = nearest(rivals), problem.rules.validation_margin
    near = [rival for rival in rivals if rival.score(like) <= rivals[0].score(like) + margin]
    if len(near) < 2 or any(rival.score(like) < rivals[0].score(like) for rival in near):
        return rivals
    both: list[Explanation] = []
    for rival in near:
        best = min((one.joint.cost for one in both if one.joint), default=np.inf)
        with suppress(IntegrationError):
            joint = fitting.together(rival.with_prior(problem), validation, rival.hypothesis, best)
            both.append(replace(rival, joint=joint))
    if not both:  # none moves on in the other record as it does in this one
        return rivals
    like = nearest(both)
    ordered = sorted(both, key=lambda rival: rival.score(like))
    size, rules = problem.record.readings.size, problem.rules
    follows_step = any(one.entry.by_step for one in ordered[0].hypothesis.instances[-1:])
    if not follows_step or not verdict.reaches_noise(ordered[0].cost, size, rules):
        return tuple(ordered)
    # Of laws that differ by errors of integration alone, in both records, the nested one stays.
    nested = {name: effect.nested for name, effect in problem.rig.twin.dictionary.items()}
    error, whole = rules.law_error**2, size + validation.record.readings.size
    found = verdict.simplest_first(ordered, ordered[0].cost, nested, size, rules, numerical=error * size)
    kept, other = found[0].joint, ordered[0].joint
    return tuple(found if kept and other and kept.cost - other.cost < error * whole else ordered)


def _needed(found: SearchResult, validation: EstimationProblem, adjusted: Hypothesis) -> tuple[Explanation, ...]:
    """Explanations of the last step that is needed, and that the validation record supports."""
    size = found.base.hypothesis.residuals.size

    def plain(explanation: Explanation, cost: float) -> Scored:
        misfit = float(explanation.hypothesis.squares @ validation.weights)
        return replace(_plain(explanation), misfit=misfit, validation_cost=cost)

    steps = (plain(step[0], _cost(validation, step[0].hypothesis)) for step in found.steps)
    base = plain(found.base, float(adjusted.squares @ validation.weights))
    last = found.steps[-1][0].cost if found.steps else found.base.cost
    count = verdict.steps_needed(base, steps, last, size, validation.rules)
    for step in found.steps[count:]:
        validation.trace.refuse(step[0].names, "unseen data do not support it, or it explains too little of the rest")
    while count > 1 and (doubt := _doubt(found.steps[count - 1][0], validation)):
        validation.trace.refuse(found.steps[count - 1][0].names, doubt)
        count -= 1
    return found.steps[count - 1] if count else (found.base,)


def _doubt(explanation: Explanation, validation: EstimationProblem) -> str:
    """Why the last cause of an explanation that leaves more than noise is not given a name; '' where it is."""
    rules = validation.rules
    if verdict.reaches_noise(explanation.cost, explanation.hypothesis.residuals.size, rules):
        return ""
    if are_composite(explanation.names, validation.rig, rules) and is_of_one_family(explanation.names, validation.rig):
        return "together its causes imitate another law of their family"
    is_significant = _one_scored(explanation, validation.rig, explanation.hypothesis).is_significant(rules)
    return "" if is_significant else "its last cause does not differ from nothing"


def _plain(explanation: Explanation) -> Scored:
    """Explanation as plain data, without what takes another record or another explanation."""
    absorbed = tuple(bool(instance.entry.absorbed_by) for instance in explanation.hypothesis.instances)
    return Scored(explanation.kind, explanation.names, explanation.cost, absorbed=absorbed, unique=explanation.unique)


def _scored(rivals: Sequence[Explanation], rig: AugmentedModel, rules: DecisionRules) -> list[Scored]:
    """Explanations as plain data; those that the records cannot tell from the first have its score.

    These have as many parameters and cost as much: only the units of their ranges would tell them apart, such as those
    of a constant force and of an offset of its sensor.
    """
    like = nearest(rivals)
    found = [_one_scored(rival, rig, like) for rival in rivals]
    first, *fits = [rival.fitted for rival in rivals]
    for i, fit in enumerate(fits, 1):
        is_same = abs(fit.misfit(like) - first.misfit(like)) < rules.indifferent
        if is_same and found[i].kind == found[0].kind and len(fit.added) == len(first.added):
            found[i] = replace(found[i], score=found[0].score)
    return found


def _one_scored(explanation: Explanation, rig: AugmentedModel, like: Hypothesis) -> Scored:
    """Explanation as plain data, with its score and the estimates of its last cause."""
    estimates = _estimates(rig, explanation)
    usual = rig.start[rig.names.index(explanation.names[-1][0])] if explanation.kind == "parameter" else 0.0
    last = tuple((value - float(usual), std) for value, std in estimates[-1].values()) if estimates else ()
    if explanation.hypothesis.instances:
        last = (*last, (explanation.last_strength, 1.0))
    return replace(_plain(explanation), score=explanation.score(like), estimates=last)


def _rounded(problem: EstimationProblem, hypothesis: Hypothesis) -> list[tuple[Named, bool]]:
    """Rounding of each sensor that makes much of its noise, and whether it makes much of the residual, too.

    It is seen in the readings themselves, and named if the rig does not declare it.
    """
    twin, least = problem.rig.twin, problem.rules.rounding_fraction
    known = {effect.at for effect in twin.effects if effect.kind == ROUNDING.name and effect.enabled}
    left = hypothesis.squares / len(problem.record)
    found = []
    for i, (name, step) in enumerate(zip(twin.sensors, steps_of(problem.record), strict=True)):
        variance = step**2 / 12.0
        if name not in known and variance > least * problem.sigma[i] ** 2:
            cause = Named(ROUNDING.name, name, {ROUNDING.quantum: Estimate(float(step), 0.0)}, 1.0)
            found.append((cause, bool(variance > least * left[i])))
    return found


def _estimates(rig: AugmentedModel, explanation: Explanation) -> list[dict[str, Estimate]]:
    hypothesis, deviations = explanation.hypothesis, explanation.hypothesis.deviations
    if explanation.kind == "parameter":
        indices = {name: rig.names.index(name) for name, _ in explanation.names}
        return [{name: Estimate(float(hypothesis.theta[i]), float(deviations[i]))} for name, i in indices.items()]
    parts = zip(hypothesis.instances, by_instance(hypothesis.instances, deviations[len(rig.start) :]), strict=True)
    return [
        {name: Estimate(float(x), float(std)) for name, x, std in zip(one.names, one.estimated, stds, strict=True)}
        for one, stds in parts
    ]


def _causes(rig: AugmentedModel, rivals: Sequence[Explanation], scored: Sequence[Scored]) -> tuple[Named, ...]:
    """Causes of the chosen explanation; the last one with its probability and its alternatives."""
    chosen, weights = rivals[0], [float(weight) for weight in verdict.probabilities([one.score for one in scored])]
    estimates = _estimates(rig, chosen)
    if not estimates:
        return ()
    pairs = zip(rivals[1:], weights[1:], strict=True)
    others = tuple(Alternative(*r.names[-1], weight) for r, weight in pairs if weight > LISTED)
    causes = [Named(*name, values, 1.0) for name, values in zip(chosen.names, estimates, strict=True)]
    return (*causes[:-1], replace(causes[-1], probability=weights[0], alternatives=others))
