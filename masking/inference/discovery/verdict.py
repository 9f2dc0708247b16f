"""Verdict: what fitted hypotheses say of a record. Pure functions of plain data; nothing is fitted or simulated here.

`probabilities` weighs explanations by their evidence, `decide` says what is said of the likeliest.
Source: Kass and Raftery (1995), JASA 90(430), 773-795; see `rules` for each threshold.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from scipy import special

from masking.compile.numerics.arrays import Array
from masking.inference.discovery.decision_rules import DecisionRules
from masking.lab.records.noise_estimate import ALIKE

Verdict = Literal["none", "parameter", "named", "ambiguous", "unknown"]
Kind = Literal["none", "parameter", "effects"]
Key = tuple[str, str]  # an effect and its place, or a parameter and ''

# Of the probability that none of the names is right, see `none_of_these`.
NONE_LEAST = 0.01  # p0, where the names leave no more than noise; and of the names, where a closed form is better
NONE_HALF = 0.1  # l0: a law that is a tenth off is as likely another one
NONE_SHARPNESS = 3.0  # s
REST, REST_HALF = 0.4, 0.05  # p1, l1: of names that leave a part of the error, whatever explains that
SHARED = 0.3  # at least, where two forces of one place are named: together they imitate many a single law
LIKELIER = 0.5  # from which none of the names is likelier than all of them


class Cause(NamedTuple):
    """An effect and its place, or a parameter and ''."""

    name: str
    on: str


@dataclass(frozen=True)
class Scored:
    """A fitted and scored hypothesis as plain data."""

    kind: Kind  # 'none': the model with its parameters adjusted; 'parameter': one that is off; or 'effects'
    names: tuple[Key, ...] = ()  # (parameter, '') or (effect, place) of each cause, as they were found
    cost: float = 0.0  # -2 log posterior density up to a constant: squared residuals over noise variances, and priors
    # of the last cause: a parameter's value less the declared one, with its standard deviation; of an effect, what
    # scales it all together in deviations, and 1
    estimates: tuple[tuple[float, float], ...] = ()
    absorbed: tuple[bool, ...] = ()  # of each cause, whether parameters of the model do as it does, if all may

    @property
    def is_like_parameters(self) -> bool:
        """Whether its causes are parameters of the model, or do as they do."""
        return self.kind == "parameter" or all(self.absorbed)

    def is_significant(self, rules: DecisionRules) -> bool:
        """Whether a parameter of the last cause differs from its reference by more than its deviation allows."""
        return any(not abs(off) < rules.significant_deviations * std for off, std in self.estimates)


@dataclass(frozen=True)
class Law:
    """A cause as part of an explanation."""

    is_linear: bool  # whether its law is linear
    seat: str  # the element that it acts on, or the coordinate, sensor or actuator
    follows: str  # what its force is a function of, such as 'd' or 'd and d_rate'; '' if that does not matter
    family: str = ""  # of its physics, such as 'friction'


def noise_threshold(readings: int, rules: DecisionRules) -> float:
    """Residual rms over noise rms up to which a residual of m readings is at the noise floor.

        1.05 + 3 sqrt(2.63 / (2 m))

    The second term is the sampling error of the noise, which is the mean of the lines of a spectrum of m readings; the
    window of that correlates neighbouring lines, which makes the variance 2.63 times as large.
    Source: Stoica and Moses, Spectral Analysis of Signals (2005), section 2.7.
    """
    return rules.noise_floor + rules.chance_deviations * float(np.sqrt(ALIKE / (2.0 * readings)))


def at_noise_floor(residual: Iterable[float], noise: Iterable[float], readings: int, rules: DecisionRules) -> bool:
    """Whether the rms of residuals is at the noise floor: each at most `noise_threshold` times its noise."""
    threshold = noise_threshold(readings, rules)
    return all(size <= threshold * floor for size, floor in zip(residual, noise, strict=True))


def reaches_noise(cost: float, readings: int, rules: DecisionRules) -> bool:
    """Whether a fit leaves residuals at the noise floor, all readings together."""
    return at_noise_floor([float(np.sqrt(cost / readings))], [1.0], readings, rules)


def is_closed(*, at_noise: bool, white: Iterable[bool], estimated: float, rules: DecisionRules) -> bool:
    """Whether an explanation is complete: validation residuals at the noise floor, and those of both records white.

    Many initial states that were estimated, per reading, colour a residual.
    """
    return at_noise and (estimated > rules.initial_state_share or all(white))


def probabilities(scores: Sequence[float]) -> Array:
    """Posterior probabilities of hypotheses with equal priors, from their scores (h,)."""
    found = np.asarray(scores, dtype=float)
    weights = np.exp(-0.5 * (found - found.min()))
    return np.asarray(weights / weights.sum())


def excess_cost(cost: float, readings: int) -> float:
    """Part of a cost beyond that of noise, which is the number of readings."""
    return max(cost - readings, 0.0)


def part_left(base: float, cost: float, readings: int, rules: DecisionRules) -> float:
    """Part of the excess cost of the model alone that causes leave, beyond chance; 0 where there is no excess."""
    if not is_excess(base, readings, rules):
        return 0.0
    return excess_cost(cost, readings) / excess_cost(base, readings) if is_excess(cost, readings, rules) else 0.0


def leaves_little(cost: float, base: float, size: int, rules: DecisionRules) -> bool:
    """Whether causes leave hardly anything of what the model alone does, however far above noise."""
    return excess_cost(cost, size) < rules.trace_fraction * excess_cost(base, size)


def is_excess(cost: float, readings: int, rules: DecisionRules) -> bool:
    """Whether a cost exceeds that of noise by more than chance, whose standard deviation is sqrt(2 m)."""
    return cost - readings > rules.chance_deviations * float(np.sqrt(2.0 * readings))


def is_worse(cost: float, declared: float, readings: int, rules: DecisionRules) -> bool:
    """Whether the cost of an answer on unseen data is worse than that of the model as declared."""
    chance = rules.chance_deviations * float(np.sqrt(2.0 * readings))
    return not cost <= declared + max(chance, rules.worse_fraction * declared)


def is_composite(laws: Sequence[Law], rules: DecisionRules) -> bool:
    """Whether laws together imitate one that is not in the dictionary.

    Such are two laws at one seat that follow the same quantity, or are both friction; three laws at one seat; and
    linear laws enough to make any linear system. Friction and damping are two causes, although both follow the rate.
    """
    own = [law for law in laws if law.follows]
    many = [sum(law.is_linear for law in laws), *(sum(law.seat == one.seat for law in laws) for one in own)]
    return max(many) >= rules.composite_laws or any(_are_alike(*two) for two in itertools.combinations(own, 2))


def _are_alike(one: Law, other: Law) -> bool:
    """Whether two laws follow the same quantity at one seat, or are both friction there."""
    frictions = [one.family, other.family].count("friction")
    is_apart = frictions == 1 and "d_rate" in one.follows
    return one.seat == other.seat and (frictions > 1 or (one.follows == other.follows and not is_apart))


def decide(
    chosen: Scored, sure: float, unexplained: float, readings: int, rules: DecisionRules, *, composite: bool = False
) -> Verdict:
    """Verdict on an explanation.

    Args:
        chosen: the explanation.
        sure: least probability of one of its causes.
        unexplained: part of the excess cost that it leaves.
        readings: of the record.
        rules: the thresholds.
        composite: whether its effects imitate one that the dictionary lacks.
    """
    is_complete = reaches_noise(chosen.cost, readings, rules)
    if chosen.kind == "none":
        return "none" if is_complete else "unknown"
    is_small = chosen.cost <= rules.small_residual * readings
    most = rules.small_unexplained_fraction if is_small else rules.unexplained_fraction
    if composite or (not is_complete and (unexplained > most or not chosen.is_significant(rules))):
        return "unknown"
    if chosen.is_like_parameters:
        return "parameter"
    return "named" if sure >= rules.named_probability else "ambiguous"


def revised(verdict: Verdict, *, rounded: bool, at_noise: bool) -> Verdict:
    """Verdict in the light of what is known beside the hypotheses.

    Rounding is named where nothing else is found and it makes much of the residual. If nothing is missing in the
    estimation record, an effect that shows in the validation record alone, whose residual is not at the noise floor, is
    unknown.
    """
    if rounded:
        verdict = "named"
    return "unknown" if verdict == "none" and not at_noise else verdict


def none_of_these(left: float, better: float = -np.inf, *, rest: float = 0.0, shared: bool = False) -> float:
    """Probability that none of the names is right, of which a law without a name is the rival.

        p = p0 + (1 - p0)/(1 + (l0/l)**s), and at least p1/(1 + (l1/r)**2)

    A law whose shape is off by a tenth leaves a tenth. A closed form is the rival of names by its score. What remains
    in any case casts a doubt, but no more: no model of a rig is exact. Where names leave a twentieth of the error or
    more, nearly all were wrong in generated records, and none in measured ones: p1 is between the two.
    `python -m tests.benchmarks.answers` says how often answers of each probability are right.

    Args:
        left: l, what the names leave and the law without a name explains, as part of the rms of the model error.
        rest: r, what the names leave beyond noise, as part of it.
        better: score by which a closed form is better than the names, beyond what is asked of an effect.
        shared: whether two of them are forces of one place.
    """
    found = NONE_LEAST + (1.0 - NONE_LEAST) / (1.0 + (NONE_HALF / left) ** NONE_SHARPNESS) if left > 0.0 else NONE_LEAST
    found = max(found, REST / (1.0 + (REST_HALF / rest) ** 2) if rest > 0.0 else 0.0)
    found = max(found, (1.0 - NONE_LEAST) * float(special.expit(0.5 * float(better))))
    return max(found, SHARED if shared else 0.0)
