"""Stages of a discovery: from a record and a model to the effect that the model is missing, and how sure that is.

Source of the method: output-error identification with candidate terms, Ljung (1999), System Identification, chapters 7
and 16; the terms are physical effects with parameters and states of their own.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from masking.control.rig.twin import Twin
from masking.errors import IntegrationError, MaskingError
from masking.inference.discovery import (
    answer_by_validation,
    fitting,
    instrument_errors,
    readings,
    validation_simulation,
    verdict,
)
from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.discovery_result import (
    Alternative,
    Discovery,
    Errors,
    Estimate,
    Grade,
    Named,
    SimulationError,
)
from masking.inference.discovery.discovery_settings import DiscoverySettings
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.explanation import Explanation, Unseen, ended
from masking.inference.discovery.fitting import Hypothesis, by_instance
from masking.inference.discovery.next_experiment import NextExperiment, declared_limits, next_experiment
from masking.inference.discovery.parameter_prior import train_validation_split, uncertain
from masking.inference.discovery.readings import Reading
from masking.inference.discovery.screening import Screen
from masking.inference.discovery.search import SearchResult
from masking.inference.discovery.search_state import Tell, silent
from masking.inference.discovery.trace import Line
from masking.inference.discovery.unnamed_as_rival import beside_names
from masking.inference.discovery.verdict import Key, Scored
from masking.inference.estimation.identification_data import Data
from masking.lab.records.noise_estimate import rounding_steps
from masking.model.effects import ROUNDING, Effect

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

    The record is searched as it is declared, and in other readings where the answer calls for them.

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
    say = tell or silent
    say("preparing the rig; the first time, it is compiled", 0.0)
    record.refuse_constant(twin)
    train, unseen = record, validation
    if unseen is None:
        train, unseen = train_validation_split(record, settings.rules.held_out)
    with threadpool_limits(1):  # small matrices: more threads of BLAS only wait for each other
        reading = Reading.of(rig, train, unseen, settings)
        found = _explained(reading, say)
        for others in readings.OTHERS:
            reading, found = _otherwise(others(reading, found), reading, found, say)
        stated = _stated(beside_names(found, reading.problem.substeps, say))
        held = None if stated.is_at_noise_floor else _with_first_order_hold(stated)
        return replace(stated, grades=_grades(stated), first_order_hold=held)


def _otherwise(others: Iterator[Reading], reading: Reading, found: Discovery, say: Tell) -> tuple[Reading, Discovery]:
    """First of other readings whose answer explains more, with that; as it was where none does or can be searched."""
    with suppress(MaskingError):  # a record that cannot be read so
        for other in others:
            say(f"once more, {other.problem.trace.reading}", 0.0)
            with suppress(MaskingError):
                again = _explained(other, say)
                if readings.explains_more(again, found):
                    return other, again
    return reading, found


def _stated(found: Discovery) -> Discovery:
    """Discovery with the errors of its effects in finer steps of integration, as others simulate them."""
    known, errors = found.explanation.hypothesis, found.simulation_error
    if not known.instances:
        return found
    stated = list[dict[str, float]]()
    for part, start in ((found.problem, known.start), (found.validation, found.after.start)):
        fine = replace(part, substeps=FINER * part.substeps)
        try:
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
    problem = replace(found.problem, record=found.record.first_order())
    with suppress(IntegrationError):
        other = fitting.fit(problem)
        size = found.record.readings.size
        if other.cost - size < problem.rules.first_order_hold_fraction * (found.explanation.cost - size):
            return problem.errors(other.squares)
    return None


def _explained(reading: Reading, say: Tell) -> Discovery:
    """Discovery in one reading of the records."""
    problem = reading.problem
    search = instrument_errors.searched(problem, say)
    known = search.problem
    validation = replace(known, record=reading.unseen, sigma=reading.noise)
    declared = Explanation("none", (), fitting.fit(known, theta=known.prior.mean, frozen=True))
    before = validation_simulation.validated(validation, declared.hypothesis)
    base = answer_by_validation.simulated(search.base, validation)
    without = base.unseen or Unseen(before, before)
    left, declared_left = (float(one.misfits.sum()) for one in (without.alone, before))
    if verdict.is_worse(left, declared_left, before.residuals.size, problem.rules):
        without = Unseen(before, before)  # parameters that are worse on unseen data are not kept
    say("comparing explanations on data that were not used", 0.95)
    rivals = answer_by_validation.likeliest(search, base, validation)
    given = answer_by_validation.no_worse((rivals, (base,), (declared,)), known, validation, before)
    chosen, rules, size = given.explanation, problem.rules, problem.record.readings.size
    after = given.unseen.alone
    without = given.unseen if given.rivals[0] is base else without
    errors = SimulationError(
        Errors(known.errors(declared.hypothesis.squares), known.errors(chosen.hypothesis.squares)),
        Errors(validation.errors(before.squares), validation.errors(after.squares)),
        known.noise_floor, validation.noise_floor, validation.errors(without.alone.squares), given.alone,
    )  # fmt: skip
    # By the estimates, or within their uncertainty: either shows what the causes explain.
    unseen = (
        verdict.part_left(float(one.misfits.sum()), float(other.misfits.sum()), after.residuals.size, rules)
        for one, other in zip(without, given.unseen, strict=True)
    )
    unexplained = max(verdict.part_left(search.base.cost, chosen.cost, size, rules), min(unseen))
    weights = answer_by_validation.weights(given.rivals)
    effects = _causes(known.rig, (chosen, *given.rivals[1:]), weights, search.ranked)
    sure = min((one.probability for one in effects), default=1.0)
    rounded = _rounded(known, chosen.hypothesis)
    answer = verdict.revised(
        verdict.decide(
            _scored(chosen, search),
            sure,
            unexplained,
            size,
            rules,
            composite=chosen.is_composite(known.rig),
        ),
        rounded=not effects and any(is_much for _, is_much in rounded),
        at_noise=errors.is_noise(len(reading.unseen), rules),
    )
    stated = Discovery(
        verdict=answer, twin=known.rig.twin, problem=known, explanation=chosen, search=search,
        effects=(*effects, *(cause for cause, _ in rounded)), simulation_error=errors,
        unexplained_fraction=unexplained, rivals=given.rivals, weights=tuple(weights), validation=validation,
        before=before, after=after, adjusted=without.alone, withheld=given.withheld,
        unit=reading.doubt, exchanged=reading.exchanged,
    )  # fmt: skip
    return replace(stated, next_experiment=_separating(stated, say)) if answer == "ambiguous" else stated


def _separating(found: Discovery, say: Tell) -> NextExperiment | None:
    """Experiment that separates the least sure cause from what may be in its place; None where no rival has that."""
    say("looking for an experiment that separates them", 0.95)
    problem, rivals, cause = found.problem, found.rivals, found.least_sure
    instead = [(one.name, one.on) for one in cause.alternatives]
    others = [one for one in rivals if not {(cause.name, cause.on)} & {*one.names} and {*instead} & {*one.names}]
    if not others:
        return None
    second = min(others, key=lambda one: min(instead.index(key) for key in one.names if key in instead))
    pairs = (cause.name, cause.on), instead[0]
    names = [f"{name} at {on}" if on else name for name, on in pairs]
    limits = declared_limits(problem.rig.twin)
    return next_experiment(problem, rivals[0].hypothesis, second.hypothesis, (names[0], names[1]), limits)


def _scored(explanation: Explanation, search: SearchResult) -> Scored:
    """Explanation as plain data, with the estimates of its last cause."""
    rig, instances = search.problem.rig, explanation.hypothesis.instances
    last: tuple[tuple[float, float], ...]
    last = ((explanation.last_strength, 1.0),) if instances else ()
    if explanation.kind == "parameter":
        usual = float(rig.start[rig.names.index(explanation.names[-1][0])])
        last = tuple((value - usual, std) for value, std in _estimates(rig, explanation)[-1].values())
    may_be = all(one.entry.absorbed_by for one in instances)  # a law that is none speaks for all: no screen is made
    absorbed = tuple(may_be and _is_absorbed(search, explanation, i) for i in range(len(instances)))
    return Scored(explanation.kind, explanation.names, explanation.cost, last, absorbed)


def _is_absorbed(search: SearchResult, explanation: Explanation, i: int) -> bool:
    """Whether parameters of the model do what a cause does, beside the others, whose law has their form."""
    instance, others = explanation.hypothesis.instances[i], explanation.without(i)[1]
    with suppress(IntegrationError):
        unique = Screen(search.problem, search.base.hypothesis, search.motion, others).unique(instance)
        return unique < search.problem.rules.unique_fraction
    return False


def _rounded(problem: EstimationProblem, hypothesis: Hypothesis) -> list[tuple[Named, bool]]:
    """Rounding of each sensor that makes much of its noise, and whether it makes much of the residual, too.

    It is seen in the readings themselves, and named if the rig does not declare it.
    """
    twin, least = problem.rig.twin, problem.rules.rounding_fraction
    known = {effect.at for effect in twin.effects if effect.kind == ROUNDING.name and effect.enabled}
    left = hypothesis.squares / len(problem.record)
    found = []
    for i, (name, step) in enumerate(zip(twin.sensors, rounding_steps(problem.record.readings), strict=True)):
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


def _causes(
    rig: AugmentedModel, rivals: Sequence[Explanation], weights: Sequence[float], ranked: Sequence[Explanation]
) -> tuple[Named, ...]:
    """Causes of the first of rivals, each with its probability and with what others have instead.

    Causes that explain the record equally well where one takes the place of the other share their probability: the
    record does not tell them apart, such as a constant force and an offset of its sensor.
    """
    chosen, causes = rivals[0], []
    for key, values in zip(chosen.names, _estimates(rig, chosen), strict=True):
        others = dict[Key, float]()
        for rival, weight in zip(rivals, weights, strict=True):
            own = [name for name in rival.names if name not in chosen.names]
            if key not in rival.names and own:
                others[own[-1]] = others.get(own[-1], 0.0) + weight
        sure = sum(weight for rival, weight in zip(rivals, weights, strict=True) if key in rival.names)
        same = [one for one in _equal_to(key, ranked) if one not in chosen.names]
        sure = (sure + sum(others.get(one, 0.0) for one in same)) / (1 + len(same))
        others |= dict.fromkeys(same, sure)
        instead = tuple(Alternative(*other, weight) for other, weight in others.items() if weight > LISTED)
        causes.append(Named(*key, values, sure, instead))
    return tuple(causes)


def _equal_to(key: Key, ranked: Sequence[Explanation]) -> list[Key]:
    """Causes that do as much in the place of one, with as many parameters, in an explanation that is the same else.

    It is one in which they do something.
    """
    found = list[Key]()
    for one, other in itertools.product(ranked, repeat=2):
        new, old = {*other.names} - {*one.names}, {*one.names} - {*other.names}
        if old == {key} and len(new) == 1 and one.kind == other.kind:
            least, margin = max(one.cost, other.cost), one.hypothesis.rules.indifferent * one.hypothesis.scale
            is_same = abs(one.cost - other.cost) < margin < ended(ranked, {*one.names} - {key}) - least
            if is_same and len(one.hypothesis.added) == len(other.hypothesis.added):
                found += [one for one in new if one not in found]
    return found


def _grades(found: Discovery) -> tuple[Grade, ...]:
    """Grade of each effect of an answer; a cause without which the motion is not finite takes all of the error."""
    explanation, unseen = found.explanation, found.validation
    if explanation.kind != "effects":
        return ()
    errors, floor = found.simulation_error.validation[1], found.simulation_error.validation_noise_floor
    lines = [line for line in found.problem.trace.lines() if line.tried.reading == found.problem.trace.reading]
    made = list[Grade]()
    for i, (name, on) in enumerate(explanation.names):
        others, known = explanation.without(i)[1], explanation.hypothesis
        try:
            fitted = fitting.fit(found.problem, others, theta=known.theta, start=known.start) if others else None
            left = found.adjusted if fitted is None else validation_simulation.validated(unseen, fitted)
            without = unseen.errors(left.squares)
        except IntegrationError:
            without = dict.fromkeys(errors, np.inf)
        worst = max(without, key=lambda sensor: without[sensor] / max(floor[sensor], 1e-300))
        share = max(0.0, 1.0 - errors[worst] / max(without[worst], 1e-300))
        made.append(Grade(name, on, share, without[worst], *_odds(lines, explanation.names, i, found.twin.dictionary)))
    return tuple(made)


def _odds(
    lines: Sequence[Line], names: Sequence[Key], i: int, dictionary: Mapping[str, Effect]
) -> tuple[float | None, tuple[Key, ...]]:
    """Odds of causes against the likeliest hypothesis without one of the class of cause i, and the causes of that."""
    name, on = names[i]
    family = dictionary[name].family if name in dictionary else name

    def is_other(line: Line) -> bool:
        return not any(at == on and n in dictionary and dictionary[n].family == family for n, at in line.tried.names)

    own = next((line for line in lines if sorted(line.tried.names) == sorted(names)), None)
    rivals = sorted((line for line in lines if is_other(line) and not line.why), key=lambda line: line.behind)
    if own is None or not rivals:
        return None, ()
    return float(np.exp(np.clip(0.5 * (rivals[0].behind - own.behind), -700.0, 700.0))), rivals[0].tried.names
