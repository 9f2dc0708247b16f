"""Grading: how much of the error on unseen data each cause makes, and its odds against causes of another class."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from masking.errors import IntegrationError
from masking.inference.discovery import fitting, unseen_data
from masking.inference.discovery.discovery_result import Discovery, Grade
from masking.inference.discovery.trace import Line
from masking.inference.discovery.verdict import Key
from masking.model.effects import Effect


def graded(found: Discovery) -> tuple[Grade, ...]:
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
            left = found.adjusted if fitted is None else unseen_data.validated(unseen, fitted)
            without = unseen.errors(left.squares)
        except IntegrationError:
            without = dict.fromkeys(errors, np.inf)
        worst = max(without, key=lambda sensor: without[sensor] / max(floor[sensor], 1e-300))
        share = max(0.0, 1.0 - errors[worst] / max(without[worst], 1e-300))
        made.append(Grade(name, on, share, without[worst], *_odds(lines, explanation.names, i, found.twin.dictionary)))
    return tuple(made)


def with_grades(found: Discovery) -> Discovery:
    """Discovery with the grades of its causes."""
    return replace(found, grades=graded(found))


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
