"""Name or unnamed: the law without a name as the rival of all names, and the probability that none is right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from masking.errors import IntegrationError
from masking.inference.discovery import fitting, verdict
from masking.inference.discovery.composites import share_a_place
from masking.inference.discovery.discovery_result import Discovery, Errors, Named
from masking.inference.discovery.free_law import explainable
from masking.inference.discovery.ground import Tell
from masking.inference.discovery.unnamed_law import UnnamedLaw, evidence, law_of

OPEN, NAMED = 0.8, 0.3  # of what a search may simulate: for a law that is the answer, and for a rival of names


def beside_names(found: Discovery, substeps: int, say: Tell) -> Discovery:
    """Discovery with the probability that no name is right, and with the law without a name where it is not.

    Where the names leave so much more than noise that it could explain, that law is fitted, as their rival; also where
    they leave a little more, two act at one place, the last takes what another left or one changes beyond the motion,
    for a closed form may do as well with no more numbers. The integration steps are those of the model alone.
    """
    if found.verdict in {"none", "parameter"} or found.is_hidden or not found.explanation.hypothesis.instances:
        return _without_names(found, substeps)
    is_refused, rules = found.verdict == "unknown", found.problem.rules
    left, size, errs = _left(found), found.record.readings.size, found.simulation_error.over_noise
    with threadpool_limits(1):
        taken = explainable(found)
    part = taken / max(verdict.excess_cost(found.search.base.cost, size), 1.0)
    is_open = is_refused or (verdict.none_matters(min(left, float(np.sqrt(part)))) and not found.closed)
    are_two = share_a_place(found.explanation.names, found.problem.rig)
    leaves_more = max(found.explanation.cost / size, errs**2) > 1.0 + rules.screen_resolution
    # Where the rest does not follow the motion of a place, no law does better than the names.
    follows = taken > (1.0 - rules.much_less) * verdict.excess_cost(found.explanation.cost, size)
    law = None
    if is_open or (follows and (are_two or leaves_more or _takes_a_rest(found) or changes_beyond(found))):
        say("fitting a law without a name", 0.97)
        law = law_of(found, found.validation, substeps, OPEN if is_refused else NAMED)
    matched, better, unexplained = _in_intervals_of(law, found), -np.inf, left if is_refused else 0.0
    if law is not None and law.follows(found.problem, found.validation):
        alone = not matched.is_at_noise_floor and law.reaches(found.simulation_error.validation_noise_floor)
        better = evidence(matched, matched.after, law, alone=alone) - rules.effect_evidence
        unexplained = law.unexplained(found) if is_open else 0.0
    none = verdict.none_of_these(unexplained, better, shared=are_two)
    if law is None and leaves_more and follows and found.problem.work.is_cut:  # no rival was tried
        none = max(none, verdict.LIKELIER)
    answer = "unknown" if none > verdict.LIKELIER else found.verdict
    is_written = answer == "unknown" and law is not None and not _leaves_more(law, found, matched)
    of, kept = (matched, law) if is_written else (found, None)
    return replace(of, verdict=answer, law=kept, none_of_these=none, effects=_effects(found, 1.0 - none))


def _without_names(found: Discovery, substeps: int) -> Discovery:
    """Discovery that names no effect, with the law without a name where something is missing."""
    if found.verdict != "unknown":
        return replace(found, law=None, none_of_these=0.0)
    law = None if found.is_hidden else law_of(found, found.validation, substeps, OPEN)
    none = verdict.none_of_these(1.0 if law is None else law.unexplained(found))
    return replace(_in_intervals_of(law, found), law=law, none_of_these=none)


def _effects(found: Discovery, part: float) -> tuple[Named, ...]:
    """Causes, with their probabilities and those of their alternatives multiplied by a part."""
    causes = []
    for one in found.effects[: len(found.explanation.names)]:
        others = tuple(other._replace(probability=part * other.probability) for other in one.alternatives)
        causes.append(replace(one, probability=part * one.probability, alternatives=others))
    return (*causes, *found.effects[len(causes) :])


def _in_intervals_of(law: UnnamedLaw | None, found: Discovery) -> Discovery:
    """Discovery with its errors on unseen data in the shooting intervals in which a law follows these.

    It is as it was where there is no law, or where the model does not move on from one interval to the next.
    """
    if law is None or law.problem.interval == found.validation.interval:
        return found
    validation = replace(found.validation, interval=law.problem.interval)
    try:
        new = [fitting.validated(validation, one) for one in (found.before, found.after, found.adjusted)]
    except IntegrationError:
        return found
    before, after, adjusted = (validation.errors(one.squares) for one in new)
    errors = replace(found.simulation_error, validation=Errors(before, after), adjusted=adjusted)
    return replace(found, validation=validation, before=new[0], after=new[1], adjusted=new[2], simulation_error=errors)


def _leaves_more(law: UnnamedLaw, *found: Discovery) -> bool:
    """Whether a law leaves more on unseen data than the names do, in intervals that are no shorter."""
    left, length = float(law.validated.squares @ law.problem.weights), law.problem.interval_samples
    fair = [one for one in found if one.validation.interval_samples >= length]
    return any(left > one.after.squares @ one.validation.weights for one in fair)


def changes_beyond(found: Discovery) -> bool:
    """Whether a law has its edge, width or rate beyond the motion, which shows it in a limit that others share.

    Such as dry friction that is proportional to each rate of the record.
    """
    places, motion = [place.name for place in found.problem.rig.places], found.search.motion
    for one in found.explanation.hypothesis.instances:
        if one.at in places:
            at = places.index(one.at)
            reached = {"D": np.abs(motion.displacement[:, at]).max(), "D/s": np.abs(motion.rate[:, at]).max()}
            units = (one.entry.parameters[name].unit for name in one.names)
            if any(abs(value) > reached.get(unit, np.inf) for unit, value in zip(units, one.estimated, strict=True)):
                return True
    return False


def _takes_a_rest(found: Discovery) -> bool:
    """Whether the last cause takes no more than a trace that the others leave: of one law, they may be two."""
    names, ranked = {*found.explanation.names}, found.search.ranked
    before = next((one for one in ranked if {*one.names} < names and len(one.names) == len(names) - 1), None)
    base, size = found.search.base, found.problem.record.readings.size
    return before is not None and verdict.leaves_little(before.cost, base.cost, size, found.problem.rules)


def _left(found: Discovery) -> float:
    """Part of the rms of the model error that the names leave in both records, beyond noise."""
    seen = found.problem, found.search.base.hypothesis, found.explanation.hypothesis
    unseen = found.validation, found.adjusted, found.after
    excess = [
        [verdict.excess_cost(float(one.squares @ part.weights), part.record.readings.size) for one in (base, named)]
        for part, base, named in (seen, unseen)
    ]
    whole, left = np.sum(excess, axis=0)
    return float(np.sqrt(left / whole)) if whole > left else 1.0
