"""Unnamed as a rival: the law without a name as the rival of all names, and the probability that none is right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from masking.errors import IntegrationError
from masking.inference.discovery import closed_form, fitting, validation_simulation, verdict
from masking.inference.discovery.discovery_result import Discovery, Errors, Named
from masking.inference.discovery.explanation import share_a_place
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.free_law import explainable
from masking.inference.discovery.search_state import Tell
from masking.inference.discovery.unnamed_law import UnnamedLaw, law_of

OPEN, NAMED = 0.8, 0.3  # of what a search may simulate: for a law that is the answer, and for a rival of names


def beside_names(found: Discovery, substeps: int, say: Tell) -> Discovery:
    """Discovery with the probability that no name is right, and with the law without a name where it is not.

    That law is fitted where the names are refused, and as their rival where it could explain what they leave beyond
    noise, or where two act at one place. The integration steps are those of the model alone.
    """
    is_refused, has_names = found.verdict == "unknown", found.explanation.kind != "none"
    if found.verdict == "none" or not (is_refused or has_names):
        return replace(found, law=None, none_of_these=0.0)
    rules, size = found.problem.rules, found.record.readings.size
    are_two = share_a_place(found.explanation.names, found.problem.rig)
    is_noise = found.is_at_noise_floor and verdict.reaches_noise(found.explanation.cost, size, rules)
    has_rival = not is_refused and (are_two or not is_noise) and _is_explainable(found)
    law, matched = None, found
    if has_rival or (is_refused and not found.is_hidden):
        say("fitting a law without a name", 0.97)
        law = law_of(found, found.validation, substeps, OPEN if is_refused else NAMED)
        matched = found if law is None else _in_intervals_of(law, found)
        if law is not None and not _is_better(law, matched.before, matched.adjusted):
            law, matched = None, found
    left, better = _left(found) if is_refused else 0.0, -np.inf
    if law is not None and _is_as_long(law, found):
        left, better = _left(matched, law), evidence(matched, law) - rules.effect_evidence
    none = verdict.none_of_these(left, better, rest=0.0 if is_noise else _left(found), shared=are_two)
    if law is None and not is_noise and has_rival and found.problem.work.is_cut:  # no rival was tried
        none = max(none, verdict.LIKELIER)
    answer = "unknown" if none > verdict.LIKELIER else found.verdict
    is_written = answer == "unknown" and law is not None and _is_better(law, matched.after)
    of, kept = (matched, law) if is_written else (found, None)
    effects = _effects(found, 1.0 - none) if has_names else found.effects
    return replace(of, verdict=answer, law=kept, none_of_these=none, effects=effects)


def _effects(found: Discovery, part: float) -> tuple[Named, ...]:
    """Causes, with their probabilities and those of their alternatives multiplied by a part."""
    causes = []
    for one in found.effects[: len(found.explanation.names)]:
        others = tuple(other._replace(probability=part * other.probability) for other in one.alternatives)
        causes.append(replace(one, probability=part * one.probability, alternatives=others))
    return (*causes, *found.effects[len(causes) :])


def _in_intervals_of(law: UnnamedLaw, found: Discovery) -> Discovery:
    """Discovery with its errors on unseen data in the shooting intervals in which a law follows these.

    It is as it was where the model does not move on from one interval to the next.
    """
    if law.problem.interval == found.validation.interval:
        return found
    validation = replace(found.validation, interval=law.problem.interval)
    try:
        new = [validation_simulation.validated(validation, one) for one in (found.before, found.after, found.adjusted)]
    except IntegrationError:
        return found
    before, after, adjusted = (validation.errors(one.squares) for one in new)
    errors = replace(found.simulation_error, validation=Errors(before, after), adjusted=adjusted)
    return replace(found, validation=validation, before=new[0], after=new[1], adjusted=new[2], simulation_error=errors)


def _is_better(law: UnnamedLaw, *others: Hypothesis) -> bool:
    """Whether a law leaves less on unseen data than others do, in its shooting intervals."""
    left, *rest = (float(one.squares @ law.problem.weights) for one in (law.validated, *others))
    return left < min(rest)


def _is_as_long(law: UnnamedLaw, found: Discovery) -> bool:
    """Whether a law follows both records in intervals as long as the names do: in shorter ones any law leaves less."""
    pairs = (law.free.problem, found.problem), (law.problem, found.validation)
    return all(own.interval_samples >= other.interval_samples for own, other in pairs)


def evidence(found: Discovery, law: UnnamedLaw) -> float:
    """Score of the names less that of the closed form of a law, each fitted to both records.

    So a parameter that shows in the validation record alone is no evidence against either. The form is no rival, and
    this is -inf, where there is none, it is known in other intervals, a motion of both fits is not finite, or it has
    more numbers than names that leave no more than noise of unseen data.

    The discovery is in the shooting intervals of the law.
    """
    form, named, unseen = law.form, found.explanation, law.problem
    if form is None or law.free.problem.interval != found.problem.interval:
        return -np.inf
    numbers = [len(one.hypothesis.deviations) for one in (named, form.explanation)]
    if numbers[1] > numbers[0] and found.is_at_noise_floor:
        return -np.inf
    known = named.with_prior(found.problem)
    seen = replace(unseen, substeps=known.substeps, rig=known.rig, prior=known.prior)
    written = form.explanation.hypothesis
    fine, other = (closed_form.knowing(one, written.instances) for one in (law.free.problem, unseen))
    try:
        names = fitting.together(known, seen, named.hypothesis, found.after.start)
        rival = fitting.together(fine, other, written, form.validated.start)
    except IntegrationError:
        return -np.inf
    like = fitting.nearest([names, rival])
    penalty = float(np.log(found.record.readings.size + unseen.record.readings.size))
    return names.misfit(like) - rival.misfit(like) + penalty * (numbers[0] - numbers[1])


def _is_explainable(found: Discovery) -> bool:
    """Whether a law could explain nearly all that the names leave of the record, or so much that it is likelier.

    Where the rest does not follow the motion of a place, no law does better than the names.
    """
    taken = explainable(found)
    base, names = (
        verdict.excess_cost(one.cost, found.record.readings.size) for one in (found.search.base, found.explanation)
    )
    part = min(_left(found), float(np.sqrt(taken / max(base, 1.0))))
    return taken > (1.0 - found.problem.rules.much_less) * names or verdict.none_of_these(part) > verdict.LIKELIER


def _left(found: Discovery, law: UnnamedLaw | None = None) -> float:
    """Part of the rms of the model error beyond noise that the names leave in both records, and a law explains.

    What it leaves itself is of as many independent samples as it is worth, and is larger or smaller by chance.
    """
    seen, unseen = [found.search.base.hypothesis, found.explanation.hypothesis], [found.adjusted, found.after]
    chance = 0.0
    if law is not None:
        seen, unseen = [*seen, law.fitted], [*unseen, law.validated]
        samples = float(law.fitted.independent.sum() + law.validated.independent.sum())
        chance = float(found.problem.rules.chance_deviations) * float(np.sqrt(2.0 / samples))
    excess = [
        [verdict.excess_cost(float(one.squares @ part.weights), part.record.readings.size) for one in every]
        for part, every in ((found.problem, seen), (found.validation, unseen))
    ]
    base, names, *own = np.sum(excess, axis=0)
    explained = max(names - (1.0 + chance) * sum(own), 0.0)
    return float(np.sqrt(explained / base)) if base > names else 1.0
