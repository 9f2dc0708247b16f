"""The verdict of a discovery on constructed hypotheses: each verdict, and each threshold from both sides; no rig."""

import ast
import inspect
from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from masking.inference.discovery import decision_rules as module
from masking.inference.discovery import verdict
from masking.inference.discovery.decision_rules import DecisionRules
from masking.inference.discovery.verdict import Law, Scored
from masking.lab.records.noise_estimate import white_noise

RULES = DecisionRules()
M = 1_000_000  # readings: the cost of pure noise
FLOOR = verdict.noise_threshold(M, RULES) ** 2 * M  # largest cost at the noise floor
SMALL = RULES.small_residual * M
FRICTION, SPRING = ("dry_friction", "spring1"), ("linear_spring", "spring1")


def effect(cost=M, **changes):
    """Return dry friction, ten standard deviations from zero."""
    made = Scored("effects", (FRICTION,), cost, estimates=((1.0, 0.1),), absorbed=(False,))
    return replace(made, **changes)


def spring(cost=M, **changes):
    return effect(cost, names=(SPRING,), absorbed=(True,), **changes)


def parameter(cost=M, **changes):
    return replace(effect(cost, names=(("w1", ""),)), kind="parameter", **changes)


def base(cost=100.0 * M, **changes):
    return Scored("none", (), cost, **changes)


def decide(chosen, *, sure=1.0, unexplained=0.0, composite=False, rules=RULES):
    return verdict.decide(chosen, sure, unexplained, M, rules, composite=composite)


def test_every_rule_says_why():
    (tree,) = (node for node in ast.parse(inspect.getsource(module)).body if isinstance(node, ast.ClassDef))
    said = {
        one.target.id: after.value.value
        for one, after in zip(tree.body, tree.body[1:], strict=False)
        if isinstance(one, ast.AnnAssign) and isinstance(after, ast.Expr)
    }
    assert said.keys() == {field.name for field in fields(DecisionRules)}
    assert all("\n\n    Why: " in text for text in said.values())


def test_rules_do_not_contradict_each_other():
    assert 1.0 < RULES.noise_floor < np.sqrt(RULES.small_residual)
    assert RULES.unexplained_fraction < RULES.small_unexplained_fraction
    assert RULES.indifferent < RULES.parameter_evidence < RULES.effect_evidence < RULES.separation


def test_rules_do_not_take_a_linear_law_for_dry_friction_or_a_cubic_spring():
    v = stats.norm.ppf((np.arange(200_000) + 0.5) / 200_000)  # Gaussian motion
    for law, part in ((np.sign(v), 2.0 / np.pi), (v**3, 9.0 / 15.0)):
        taken = (law @ v) ** 2 / (law @ law) / (v @ v)
        assert taken == pytest.approx(part, rel=1e-3)
        assert 1.0 - taken > RULES.unexplained_fraction
    left = [1.0, *(_left_of(np.sign(v), v, degree) for degree in (1, 3, 5))]
    gains = [1.0 - after / before for before, after in pairwise(left)]
    assert gains[0] > gains[1] > RULES.gain_fraction > gains[2]


def _left_of(law, v, degree):
    """Return the part of the mean square of a law that odd powers of the rate up to a degree leave."""
    powers = np.column_stack([v**n for n in range(1, degree + 1, 2)])
    residual = law - powers @ np.linalg.lstsq(powers, law, rcond=None)[0]
    return float(residual @ residual / (law @ law))


@pytest.mark.parametrize(("cost", "said"), [(M, "none"), (0.999 * FLOOR, "none"), (1.001 * FLOOR, "unknown")])
def test_nothing_is_missing_at_the_noise_floor(cost, said):
    assert decide(base(cost)) == said


def test_a_cause_that_is_likely_is_named():
    edge = RULES.named_probability
    assert decide(effect(), sure=1.001 * edge) == "named"
    assert decide(effect(), sure=0.999 * edge) == "ambiguous"
    assert decide(effect()) == "named"


@pytest.mark.parametrize(
    ("cost", "unexplained", "said"),
    [
        (1.001 * SMALL, 0.999 * RULES.unexplained_fraction, "named"),
        (1.001 * SMALL, 1.001 * RULES.unexplained_fraction, "unknown"),
        (0.999 * SMALL, 1.001 * RULES.unexplained_fraction, "named"),
        (0.999 * SMALL, 0.999 * RULES.small_unexplained_fraction, "named"),
        (0.999 * SMALL, 1.001 * RULES.small_unexplained_fraction, "unknown"),
        (1.001 * FLOOR, 1.001 * RULES.small_unexplained_fraction, "unknown"),
        (0.999 * FLOOR, 1.0, "named"),  # at the noise floor, the fraction of what little was missing does not count
    ],
)
def test_an_effect_that_leaves_much_is_unknown(cost, unexplained, said):
    assert decide(effect(cost), unexplained=unexplained) == said


@pytest.mark.parametrize("make", [effect, parameter])
def test_a_value_that_may_be_its_reference_is_unknown(make):
    edge = RULES.significant_deviations
    off, within = ((1.001 * edge, 1.0),), ((0.999 * edge, 1.0), (-0.5, 1.0))
    assert decide(make(2.0 * FLOOR, estimates=off)) != "unknown"
    assert decide(make(2.0 * FLOOR, estimates=within)) == "unknown"
    assert decide(make(2.0 * FLOOR, estimates=(*within, (-3.0, 1.0)))) != "unknown"  # one of them is enough
    assert decide(make(FLOOR * 0.999, estimates=within)) != "unknown"  # the residual is noise: it is needed
    assert decide(make(2.0 * FLOOR, estimates=((0.0, 0.0),))) != "unknown"  # a value without deviation is exact


def test_a_parameter_is_no_effect():
    assert decide(parameter()) == "parameter"
    assert decide(spring()) == "parameter"
    assert decide(effect()) == "named"
    both = replace(spring(), names=(SPRING, FRICTION), absorbed=(True, False))
    assert decide(both) == "named"
    assert decide(replace(both, absorbed=(True, True))) == "parameter"


def test_a_composite_is_unknown():
    assert decide(effect(), composite=True) == "unknown"


@pytest.mark.parametrize(
    ("laws", "said"),
    [
        ([Law(False, "spring1", "d")], False),
        ([Law(False, "spring1", "d"), Law(False, "spring1", "d")], True),
        ([Law(False, "spring1", "d"), Law(False, "beam", "d")], False),
        ([Law(False, "spring1", "d"), Law(False, "spring1", "d_rate")], False),
        ([Law(False, "spring1", "d", "springs"), Law(False, "spring1", "d", "backlash")], True),
        ([Law(False, "spring1", "d_rate", "friction"), Law(False, "spring1", "d_rate", "friction")], True),
        ([Law(False, "spring1", "d_rate", "friction"), Law(False, "spring1", "d_rate", "damping")], False),
        ([Law(False, "spring1", follows) for follows in ("d", "d_rate", "memory")], True),
        ([Law(False, "s1", ""), Law(False, "s1", "")], False),
        ([Law(True, f"spring{i}", "") for i in range(RULES.composite_laws - 1)], False),
        ([Law(True, f"spring{i}", "") for i in range(RULES.composite_laws)], True),
    ],
)
def test_composites(laws, said):
    assert verdict.is_composite(laws, RULES) is said


def test_a_verdict_is_revised_by_what_is_known_beside():
    def revised(before, rounded=False, at_noise=True):
        return verdict.revised(before, rounded=rounded, at_noise=at_noise)

    for told in ("none", "parameter", "named", "ambiguous", "unknown"):
        assert revised(told) == told
    assert revised("none", rounded=True) == revised("unknown", rounded=True) == "named"
    assert revised("none", at_noise=False) == "unknown"
    assert revised("named", at_noise=False) == "named"
    assert revised("none", rounded=True, at_noise=False) == "named"


def test_probabilities_are_those_of_likelihood_ratios():
    assert verdict.probabilities([7.0, 7.0 + 2.0 * np.log(3.0)]) == pytest.approx([0.75, 0.25])
    assert verdict.probabilities([5.0, np.inf]) == pytest.approx([1.0, 0.0])


def test_the_noise_floor():
    limit = verdict.noise_threshold(M, RULES)
    assert verdict.at_noise_floor([limit, 2.0 * limit], [1.0, 2.0], M, RULES)
    assert not verdict.at_noise_floor([limit, 2.01 * limit], [1.0, 2.0], M, RULES)
    assert verdict.reaches_noise(0.999 * FLOOR, M, RULES)
    assert not verdict.reaches_noise(1.001 * FLOOR, M, RULES)


def test_few_readings_know_their_noise_less():
    # the spread of the estimate in 2000 records of white noise with as many readings
    readings = 4000
    noise = white_noise(np.random.default_rng(5).standard_normal((readings, 2000)))
    spread = RULES.chance_deviations * noise.std()
    assert verdict.noise_threshold(readings, RULES) == pytest.approx(RULES.noise_floor + spread, rel=0.01)
    assert verdict.noise_threshold(10**9, RULES) == pytest.approx(RULES.noise_floor, rel=1e-3)


def test_closed_is_noise_that_is_white():
    def closed(at_noise=True, white=(True, True), estimated=0.0):
        return verdict.is_closed(at_noise=at_noise, white=white, estimated=estimated, rules=RULES)

    assert closed()
    assert not closed(at_noise=False)
    assert not closed(white=(True, False))
    assert not closed(white=(True, False), estimated=0.999 * RULES.initial_state_share)
    assert closed(white=(True, False), estimated=1.001 * RULES.initial_state_share)


def test_an_excess_is_more_than_chance():
    edge = M + RULES.chance_deviations * np.sqrt(2.0 * M)
    assert verdict.is_excess(1.0001 * edge, M, RULES)
    assert not verdict.is_excess(0.9999 * edge, M, RULES)
