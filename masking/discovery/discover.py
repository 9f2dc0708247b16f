"""Discover: from a record and a model to the effect that the model is missing, and how sure that is.

Source of the method: output-error identification with candidate terms, Ljung (1999), System Identification, chapters 7
and 16; the terms are physical effects with parameters and states of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from masking.discovery import fitting, shooting
from masking.discovery.augmented_model import OpenRig
from masking.discovery.composites import LIKE_PARAMETERS, is_patched
from masking.discovery.discovery import Discovery, Gap, Named, Verdict
from masking.discovery.explanation import Explanation, probabilities
from masking.discovery.fitting import Hypothesis
from masking.discovery.next_experiment import next_experiment
from masking.discovery.noise import noise_of, steps_of
from masking.discovery.prior import prior_of, train_validation_split
from masking.discovery.problem import Evidence
from masking.discovery.search import CLEAN, REST, SAME, SHARE, SMALL, TRACE, Found, Search
from masking.discovery.settings import DiscoverySettings
from masking.errors import IntegrationError
from masking.estimation.data import Data
from masking.estimation.simulation import relative
from masking.numerics.arrays import Array
from masking.rig.twin import Twin

Tell = Callable[[str, float], None]

FAINT = 0.7  # part of the gap beyond noise that causes that are named may leave where that is less than `SMALL`
SURE = 0.9  # probability from which a name is given
SURELY = 2.0  # deviations from which a parameter is off, or an effect is there, where something else is left
NEAR = 60.0  # of the score: rivals that the record that judges may decide between
ROUNDED = 0.3  # part of the noise's variance, or of what is left, that rounding must make to be named
LOST = 0.5  # part of a reading that the model leaves from which its motion is out of step with the record
MEASURED = 0.2  # part of what is left from which commands were measured, and not held, where they leave no more
BELIEVED = 0.5  # part of what a cause takes off the cost from which it is parameters that need not be off


def discover(
    twin: Twin,
    record: Data,
    validation: Data | None = None,
    settings: DiscoverySettings | None = None,
    *,
    rig: OpenRig | None = None,
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
        RecordError: the record is too short, clipped, or its readings carry no noise.
        IntegrationError: the rig cannot be simulated along the record.
    """
    settings = settings or DiscoverySettings()
    rig = rig or OpenRig(twin, tuple(settings.parameters) or twin.equation_parameters())
    say = tell or (lambda text, part: None)
    say("preparing the rig; the first time, it is compiled", 0.0)
    train, judge = train_validation_split(record) if validation is None else (record, validation)
    belief, most = prior_of(twin, rig, settings.tolerance), max(1, twin.substeps(train.rate) // 2)
    whole = Evidence(rig, train, belief, noise_of(rig, train), most)
    evidence = replace(whole, horizon=shooting.horizon(whole, settings.shooting_interval))
    evidence = replace(evidence, substeps=shooting.substeps(evidence))
    noise = noise_of(rig, judge)
    found = _explained(evidence, judge, noise, say)
    if settings.shooting_interval is None and not evidence.horizon and _is_out_of_step(found):
        for seconds in shooting.shorter(whole):
            say(f"the motion comes out of step with the record: in windows of {seconds:.2g} s", 0.0)
            again = _explained(replace(evidence, horizon=shooting.horizon(whole, seconds)), judge, noise, say)
            if again.verdict != "unknown":
                found = again
                break
    return found if found.within else replace(found, as_measured=_as_measured(found))


def _as_measured(found: Discovery) -> dict[str, float] | None:
    """Return the errors that are left where held commands were measured; None where they are no smaller."""
    if found.record.hold != "zero-order" or not found.twin.actuators:
        return None
    evidence, known = found.evidence, found.explanation.hypothesis
    evidence = replace(evidence, record=replace(found.record, hold="first-order", delay=0))
    with threadpool_limits(1), suppress(IntegrationError):
        other = fitting.fit(evidence)
        size = found.record.readings.size
        if other.cost - size < MEASURED * (known.cost - size):
            return _chi(evidence, other)
    return None


def _is_out_of_step(found: Discovery) -> bool:
    """Return whether nothing is found by simulating the whole record in one, whose motion the model does not follow."""
    left = relative(found.twin.sensors, [found.record], found.found.base.hypothesis.squares)
    return found.verdict == "unknown" and max(left.values()) > LOST


def _explained(evidence: Evidence, judge: Data, noise: Array, say: Tell) -> Discovery:
    """Return what explains a record, simulated in steps that are fine enough for the law that is found."""
    found = _found(evidence, judge, noise, say)
    if found.verdict == "unknown":
        return found
    with threadpool_limits(1):
        steps = shooting.finer(evidence, found.explanation.hypothesis)
    if steps == evidence.substeps:
        return found
    say(f"again, with {steps} steps between samples", 0.0)
    return _found(replace(evidence, substeps=steps), judge, noise, say)


def _found(evidence: Evidence, judge: Data, noise: Array, say: Tell) -> Discovery:
    """Return what explains a record; its noise is that of the record that judges (sensors,)."""
    rig, train = evidence.rig, evidence.record
    judged = replace(evidence, record=judge, sigma=noise)
    with threadpool_limits(1):  # small matrices: more threads of BLAS only wait for each other
        found = Search(evidence, say).run()
        say("comparing explanations on data that were not used", 0.95)
        found = replace(found, steps=tuple(_reordered(step, evidence, judged) for step in found.steps))
        rivals = _chosen(found, judged, train.readings.size)
        heat = evidence.temperature(rivals[0].hypothesis.residuals)
        is_put_off = _is_put_off(rivals, heat, train.readings.size)
        if is_put_off:
            rivals = tuple(sorted(rivals, key=lambda rival: rival.score(heat)))
        chosen = rivals[0]
        declared = fitting.fit(evidence, theta=evidence.belief.mean, frozen=True)
        before, after = fitting.judged(judged, declared), fitting.judged(judged, chosen.hypothesis)
    size, heat = train.readings.size, evidence.temperature(chosen.hypothesis.residuals)
    excess, left = (max(e.hypothesis.cost - size, 0.0) for e in (found.base, chosen))
    rest = left / excess if excess > 0.0 else 0.0
    gap = Gap(
        (_chi(evidence, declared), _chi(evidence, chosen.hypothesis)),
        (_chi(judged, before), _chi(judged, after)),
        _floor(evidence),
        _floor(judged),
    )
    verdict, effects = _with_rounding(evidence, chosen.hypothesis, *_verdict(rig, rivals, heat, rest, size))
    if is_put_off and verdict not in {"none", "parameter"}:
        verdict = "unknown"
    coming = None
    if verdict == "ambiguous":
        say("looking for an experiment that tells them apart", 0.95)
        first, second = rivals[:2]
        names_of = (_name(first), _name(second))
        with threadpool_limits(1):
            coming = next_experiment(evidence, first.hypothesis, second.hypothesis, names_of, _limits(rig.twin))
    answer = Discovery(
        verdict, effects, gap, rest, rig.twin, chosen, rivals, heat, found, evidence, judged, before, after, coming
    )
    # What the record does not show may be missing in the one that judges, which moves further or faster.
    return replace(answer, verdict="unknown") if verdict == "none" and not answer.within else answer


def _name(explanation: Explanation) -> str:
    name, at = explanation.names[-1]
    return f"{name} at {at}" if at else name


def _limits(twin: Twin) -> Array | None:
    """Return the largest command of each actuator that the plant file declares (actuators,); None where it does not."""
    declared = twin.declaration.limits.inputs
    if any(name not in declared for name in twin.actuators):
        return None
    ports = twin.declaration.actuators or twin.base.inputs
    return np.array([declared[n].max * twin.size(declared[n].unit) / twin.size(ports[n].unit) for n in twin.actuators])


def _cost(evidence: Evidence, hypothesis: Hypothesis) -> float:
    try:
        return float(fitting.judged(evidence, hypothesis).squares @ evidence.weights)
    except IntegrationError:
        return np.inf


def _reordered(rivals: tuple[Explanation, ...], evidence: Evidence, judged: Evidence) -> tuple[Explanation, ...]:
    """Return explanations that are nearly as good as the best, ordered by how well they explain another record, too."""
    heat = evidence.temperature(rivals[0].hypothesis.residuals)
    near = [rival for rival in rivals if rival.score(heat) <= rivals[0].score(heat) + NEAR]
    if len(near) < 2 or any(rival.score(heat) < rivals[0].score(heat) for rival in near):
        return rivals
    both: list[Explanation] = []
    for rival in near:
        best = min((one.judged.cost for one in both if one.judged), default=np.inf)
        with suppress(IntegrationError):
            joint = fitting.together(rival.believed(evidence), judged, rival.hypothesis, best)
            both.append(replace(rival, judged=joint))
    return tuple(sorted(both, key=lambda rival: rival.score(heat)))


def _chosen(found: Found, judged: Evidence, size: int) -> tuple[Explanation, ...]:
    """Return the explanations of the last step that is needed, and that shrinks the gap in the record that judges."""
    chosen: tuple[Explanation, ...] = (found.base,)
    excess = start = max(found.base.hypothesis.cost - size, 0.0)
    before = _cost(judged, found.base.hypothesis)
    closed = bool(found.steps) and found.steps[-1][0].hypothesis.cost <= CLEAN**2 * size
    for step in found.steps:
        best = step[0]
        left, after = max(best.hypothesis.cost - size, 0.0), _cost(judged, best.hypothesis)
        little = (SMALL - 1.0) * size if closed else max((SMALL - 1.0) * size, TRACE * start)
        explained = chosen[0] is not found.base and excess <= min(REST * start, little)
        enough = left <= (1.0 - SHARE) * excess or left < (CLEAN**2 - 1.0) * size
        like = best.kind == "parameter" or _is_like_parameter(best.names[-1][0], best)
        told = float((chosen[0].hypothesis.squares - best.hypothesis.squares) @ judged.weights)
        together = told < BELIEVED * (chosen[0].hypothesis.cost - best.hypothesis.cost)
        # Its error is in what was fitted before, too; so is what several parameters could only have together.
        wrong = (like or together) and after < CLEAN * before
        if not (after < before or wrong) or (explained and not enough):
            break
        chosen, excess, before = step, left, after
    return chosen


def _is_put_off(rivals: tuple[Explanation, ...], heat: float, size: int) -> bool:
    """Return whether a far likelier explanation was put off for what a simpler law leaves, and nothing came of it."""
    if rivals[0].kind != "effects" or rivals[0].hypothesis.cost <= CLEAN**2 * size:
        return False
    return bool(probabilities(rivals, heat)[0] < 1.0 - SURE)


def _verdict(
    rig: OpenRig, rivals: tuple[Explanation, ...], heat: float, rest: float, size: int
) -> tuple[Verdict, tuple[Named, ...]]:
    chosen = rivals[0]
    closed = chosen.hypothesis.cost <= CLEAN**2 * size
    if chosen.kind == "none":
        return ("none" if closed else "unknown"), ()
    weights = [float(weight) for weight in probabilities(rivals, heat)]
    others = [(*r.names[-1], weight) for r, weight in zip(rivals[1:], weights[1:], strict=True) if weight > 1e-4]
    causes = _causes(rig, chosen, heat, weights[0], tuple(others))
    most = REST if chosen.hypothesis.cost > SMALL * size else FAINT
    if (rest > most and not closed) or is_patched([(cause.name, cause.on) for cause in causes], rig):
        return "unknown", causes
    usual = rig.start[rig.names.index(causes[0].name)] if chosen.kind == "parameter" else 0.0
    if not closed and all(abs(x - usual) < SURELY * std for x, std in causes[-1].parameters.values()):
        return "unknown", causes
    if chosen.kind == "parameter" or all(_is_like_parameter(c.name, chosen) for c in causes):
        return "parameter", causes
    return ("named" if weights[0] >= SURE else "ambiguous"), causes


def _with_rounding(
    evidence: Evidence, hypothesis: Hypothesis, verdict: Verdict, causes: tuple[Named, ...]
) -> tuple[Verdict, tuple[Named, ...]]:
    """Add the rounding of sensors, which is seen in the readings themselves, where the rig does not declare it."""
    twin = evidence.rig.twin
    known = {effect.at for effect in twin.effects if effect.kind == "quantisation" and effect.enabled}
    left = hypothesis.squares / len(evidence.record)
    rounded, is_much = [], False
    for i, (name, step) in enumerate(zip(twin.sensors, steps_of(evidence.record), strict=True)):
        if name not in known and step**2 / 12.0 > ROUNDED * evidence.sigma[i] ** 2:
            rounded.append(Named("quantisation", name, {"step": (float(step), 0.0)}, 1.0))
            is_much = is_much or step**2 / 12.0 > ROUNDED * left[i]
    return ("named" if is_much and not causes else verdict), (*causes, *rounded)


def _is_like_parameter(effect: str, chosen: Explanation) -> bool:
    """Return whether an effect is what parameters of the rig could be, too."""
    return effect in LIKE_PARAMETERS and chosen.own < SAME


def _causes(
    rig: OpenRig, chosen: Explanation, heat: float, probability: float, others: tuple[tuple[str, str, float], ...]
) -> tuple[Named, ...]:
    hypothesis, k = chosen.hypothesis, len(rig.names)
    deviations = chosen.deviations(heat)
    if chosen.kind == "parameter":
        ((name, _),) = chosen.names
        i = rig.names.index(name)
        return (Named(name, "", {name: (float(hypothesis.theta[i]), float(deviations[i]))}, probability, others),)
    causes, used = [], k
    for number, slot in enumerate(hypothesis.slots):
        values = {}
        for name, i in zip(slot.names, slot.free, strict=True):
            values[name] = (float(slot.values[i]), float(deviations[used]))
            used += 1
        last = number == len(hypothesis.slots) - 1
        causes.append(Named(slot.effect, slot.at, values, probability if last else 1.0, others if last else ()))
    return tuple(causes)


def _chi(evidence: Evidence, hypothesis: Hypothesis) -> dict[str, float]:
    return relative(evidence.rig.twin.sensors, [evidence.record], hypothesis.squares)


def _floor(evidence: Evidence) -> dict[str, float]:
    return relative(evidence.rig.twin.sensors, [evidence.record], len(evidence.record) * evidence.sigma**2)
