"""Scoring: whether an answer is right, strictly; how far its parameters are off; intervals of shares.

Right is the effect AND the place that were hidden, alone and on top, or what `hidden.cases` shows to give exactly the
same readings. Nothing else counts but for near kin that a record leaves open: there the verdict must be `ambiguous`,
the truth among what it names, and the proposed experiment must tell the two apart. What no dictionary has is `unknown`,
or the nearest law at its place, marked as not explaining all.
Source of the interval: Wilson (1927), J. Am. Stat. Assoc. 22(158), 209-212.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tests.benchmarks import hidden
from tests.benchmarks.hidden.rig import ALL_ACTUATORS, PARAMETERS

Key = tuple[str, str]  # effect and place; a parameter of the rig is ("parameter", its name)

PLAUSIBLE = 0.05  # probability from which a rival is one of those between which an answer leaves it open
NORMAL = 1.959964  # of a 95 % interval
EXACT = 1e-6  # relative error of a value that is given without deviation
# Names and units of ours in the judged dictionary: a drift is told per second there, per 100 s here.
NAMED_AS = {("periodic_force", "f"): "nu", ("delay", "seconds"): "tau"}
UNIT = {("stiffness_drift", "k"): 0.01}
CONFIDENT = ("named", "parameter")


@dataclass(frozen=True)
class Cause:
    """One cause of an answer: its key, parameters as (value, std), and rivals with their probabilities."""

    key: Key
    parameters: Mapping[str, tuple[float, float]]
    probability: float = 1.0
    rivals: tuple[tuple[Key, float], ...] = ()

    def __str__(self) -> str:
        return said(self.key)


@dataclass(frozen=True)
class Answer:
    """What was answered: the verdict, its causes in order, and which two causes an experiment tells apart."""

    verdict: str
    causes: tuple[Cause, ...] = ()
    closed: bool = True  # False: the answer says itself that it does not explain all
    separated: frozenset[str] = frozenset()  # labels, as `labelled` makes them

    @property
    def keys(self) -> tuple[Key, ...]:
        """Return effects and places."""
        return tuple(cause.key for cause in self.causes)

    def __str__(self) -> str:
        text = " + ".join(map(str, self.causes))
        rivals = [said(key) for key, p in self.causes[-1].rivals if p >= PLAUSIBLE] if self.causes else []
        if rivals and self.verdict == "ambiguous":
            text += f" (or {', '.join(rivals)})"
        return f"{self.verdict}: {text}" if text else self.verdict


@dataclass(frozen=True)
class Score:
    """Whether an answer is right, and how: a word or two for the page."""

    right: bool
    how: str
    confident: bool  # a name was given without reserve

    @property
    def confidently_wrong(self) -> bool:
        """Return whether a name was given that is not right."""
        return self.confident and not self.right


def key_of(name: str, on: str) -> Key:
    """Return the key of a cause as it is reported."""
    if not on and name in PARAMETERS:
        return "parameter", name
    return (name, ALL_ACTUATORS) if name == "delay" and not on else (name, on)


def said(key: Key) -> str:
    """Return a key in words."""
    name, at = key
    return at if name == "parameter" else f"{name} at {at}" if at else name


def labelled(key: Key) -> str:
    """Return how a proposed experiment calls a key."""
    name, at = key
    return at if name == "parameter" else name if at in ("", ALL_ACTUATORS) else f"{name} at {at}"


def answer(told: Mapping[str, Any]) -> Answer:
    """Return the answer in the JSON of a discovery."""
    causes = tuple(
        Cause(
            key_of(one["name"], one["on"]),
            {name: (p["value"], p["std"]) for name, p in one["parameters"].items()},
            one["probability"],
            tuple((key_of(x["name"], x["on"]), x["probability"]) for x in one["alternatives"]),
        )
        for one in told["effects"]
    )
    coming = told.get("next_experiment") or {}
    separated = frozenset(coming["between"]) if coming.get("separates") else frozenset()
    return Answer(told["verdict"], causes, told["closed"], separated)


def judge(case: hidden.Case, told: Answer) -> Score:
    """Return the score of an answer."""
    confident = told.verdict in CONFIDENT and (told.closed or case.family != "outside")
    right, how = _judged(case, told)
    return Score(right, how, confident)


def _judged(case: hidden.Case, told: Answer) -> tuple[bool, str]:  # noqa: PLR0911  # one for each family
    if told.verdict == "failed":
        return False, "failed"
    if case.asked == "none":
        return told.verdict == "none", "nothing" if told.verdict == "none" else "something where nothing is"
    if case.family == "dirty_none":
        if told.verdict not in CONFIDENT:
            return True, "no confident name"
        real = set(told.keys) <= {(one.effect, one.at) for one in case.imperfections}
        return False, "a small imperfection, named" if real else "a name where no main effect is"
    if case.asked == "parameter":
        if told.verdict != "parameter":
            return False, f"not `parameter` but `{told.verdict}`"
        (allowed,) = hidden.answers(case)
        if len(told.causes) != 1 or told.causes[0].key not in allowed:
            return False, "another parameter"
        return True, "exact" if told.causes[0].key == (case.effect, case.at) else "equivalent"
    if case.family == "outside" and told.verdict == "unknown":
        return True, "unknown"
    found = _named(case, told)
    if case.family == "outside" and not found[0]:
        if not told.closed and told.causes and told.causes[0].key[1] == case.at:
            return True, "the nearest, marked"
        return False, "another name, in doubt" if told.verdict == "ambiguous" else "a wrong name"
    return found


def _named(case: hidden.Case, told: Answer) -> tuple[bool, str]:
    """Judge an answer that must name each hidden effect and nothing else."""
    if told.verdict in ("none", "unknown") or not told.causes:
        return False, "missed" if told.verdict == "none" else "not known"
    wanted = hidden.answers(case)
    # Imperfections of a dirty record are there: to find one besides is no mistake.
    there = {(one.effect, one.at) for one in case.imperfections}
    causes = [cause for i, cause in enumerate(told.causes) if i == 0 or cause.key not in there]
    best: tuple[bool, str] = (False, "")
    for order in itertools.permutations(causes, len(wanted)) if len(causes) >= len(wanted) else ():
        hows = [_stands_for(cause, allowed, case, told) for cause, allowed in zip(order, wanted, strict=True)]
        if all(right for right, _ in hows):
            words = [how for _, how in hows]
            best = (True, next((w for w in ("kin", "on top", "equivalent") if w in words), "exact"))
            break
        best = (False, next(how for right, how in hows if not right))
    if best[0] and len(causes) > len(wanted):
        return False, "more than is there"
    if not best[1]:
        return False, "only one of two"
    return best


def _stands_for(cause: Cause, allowed: set[Key], case: hidden.Case, told: Answer) -> tuple[bool, str]:
    """Return whether a cause is one that was hidden, with its exact equivalents in `allowed`."""
    left_open = told.verdict == "ambiguous" and cause is told.causes[-1]
    open_to = {cause.key} | ({key for key, p in cause.rivals if p >= PLAUSIBLE} if left_open else set())
    if cause.key in allowed and open_to <= allowed:
        return True, "exact" if cause.key in {(one.effect, one.at) for one in case.hidden} else "equivalent"
    if open_to & allowed:
        if cause.key not in allowed | hidden.kin(case):
            return False, "the truth among others that are no kin"
        labels = {labelled(key) for key in allowed}
        if not (told.separated & labels and told.separated - labels):
            return False, "left open, no experiment"
        return True, "on top" if cause.key in allowed else "kin"
    if cause.key[0] in {name for name, _ in allowed}:
        return False, "wrong place"
    return False, "near kin" if cause.key in hidden.kin(case) else "wrong effect"


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect: its name, its relative error (None where the truth is 0), and if 95 % covers it."""

    name: str
    error: float | None
    covered: bool


def parameters(case: hidden.Case, told: Answer) -> list[Parameter]:
    """Return the parameters that an answer gives of hidden effects that it names as they were named."""
    found = []
    for one in case.hidden:
        truth = {
            NAMED_AS.get((one.effect, n), n): value * UNIT.get((one.effect, n), 1.0)
            for n, value in one.parameters.items()
        }
        size = {name: abs(value) for name, value in truth.items()}
        if one.effect == "periodic_force":  # a and b together are amplitude and phase
            size["a"] = size["b"] = math.hypot(truth["a"], truth["b"])
        for cause in told.causes:
            if cause.key == (one.effect, one.at):
                found += [
                    _parameter(name, value, std, truth.get(name, 0.0), size.get(name, 0.0))
                    for name, (value, std) in cause.parameters.items()
                ]
    if case.effect == "parameter" and told.keys == ((case.effect, case.at),):
        value = hidden.truth(case).rig[case.at]
        found = [_parameter(case.at, *told.causes[0].parameters[case.at], value, abs(value))]
    return found


def _parameter(name: str, value: float, std: float, truth: float, size: float) -> Parameter:
    off = abs(value - truth)
    return Parameter(name, off / size if size else None, off <= max(NORMAL * std, EXACT * size))


def left_over(after: Mapping[str, float], floor: Mapping[str, float]) -> float:
    """Return the gap of the worst sensor in units of the noise."""
    return max(after[name] / floor[name] for name in floor)


def total(gap: Mapping[str, float], floor: Mapping[str, float]) -> float:
    """Return the gap of all sensors together in units of the noise."""
    return math.sqrt(sum((gap[name] / floor[name]) ** 2 for name in floor) / len(floor))


def is_larger(before: Mapping[str, float], after: Mapping[str, float], floor: Mapping[str, float]) -> bool:
    """Return whether a gap has grown, over all sensors, by more than rounding."""
    return total(after, floor) > total(before, floor) * (1.0 + 1e-9)


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share."""
    if not count:
        return 0.0, 1.0
    share, z2 = hits / count, NORMAL**2
    middle = (share + z2 / (2.0 * count)) / (1.0 + z2 / count)
    half = NORMAL / (1.0 + z2 / count) * math.sqrt(share * (1.0 - share) / count + z2 / (4.0 * count**2))
    return (middle - half if hits else 0.0), (middle + half if hits < count else 1.0)


def ranked(case: hidden.Case, terms: Sequence[Sequence[Sequence[str]]], verdict: str) -> Answer:
    """Return the answer of a list of terms, the most important first, each with all that it may mean.

    Only as many terms are looked at as effects are hidden, and a term means the truth if it may.
    """
    allowed = hidden.acceptable(case)
    causes = []
    for term in terms[: max(1, len(hidden.answers(case)))]:
        keys = [(name, at) for name, at in term]
        causes.append(Cause(next((key for key in keys if key in allowed), keys[0]), {}))
    return Answer(verdict, tuple(causes))


def shortened(text: str, most: int = 160) -> str:
    """Return a text cut to a length."""
    return text if len(text) <= most else text[: most - 3] + "..."
