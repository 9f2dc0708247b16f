"""Numbers that note where another value would have decided otherwise, by which the effects of rules are measured."""

from dataclasses import replace

import numpy as np
import pytest

from masking.inference.discovery import verdict
from masking.inference.discovery.decision_rules import RULES
from tests.benchmarks import rules
from tests.benchmarks.watched import Watched, WatchedRules


def watched(value=3.0):
    noted = set()
    return Watched(value, {"half": 0.5 * value, "twice": 2.0 * value}, noted), noted


@pytest.mark.parametrize(
    ("decide", "says", "changes"),
    [
        (lambda x: x > 1.0, True, set()),
        (lambda x: not x < 2.0, True, {"half"}),
        (lambda x: np.float64(5.0) >= x, True, {"twice"}),
        (lambda x: x == 3.0, True, {"half", "twice"}),
        (lambda x: 10.0 - x * x < 2.0**x, True, {"half"}),
        (lambda x: max(4.0, x) == 4.0, True, {"twice"}),
        (lambda x: (np.array([1.0, 2.0, 4.0]) < x).tolist(), [True, True, False], {"half", "twice"}),
        (lambda x: (np.array([1.0, 1.2]) * x > 1.0).all(), True, set()),
        (float, 3.0, {"half", "twice"}),
        (lambda x: [1, 2, 3, 4][: round(x)], [1, 2, 3], {"half", "twice"}),
        (lambda x: (np.zeros(2) + np.asarray(x)).tolist(), [3.0, 3.0], {"half", "twice"}),
    ],
)
def test_what_would_be_decided_otherwise_is_noted(decide, says, changes):
    number, noted = watched()
    assert decide(number) == says
    assert noted == changes


def test_watched_rules_decide_as_the_rules_do_and_note_those_that_matter():
    readings, declared = 1000, 5000.0
    for cost in (4800.0, 5100.0, 5200.0, 5400.0):
        others = {"chance_deviations": {factor: factor * RULES.chance_deviations for factor in rules.FACTORS}}
        own = WatchedRules().watching(others)
        answer = verdict.is_worse(cost, declared, readings, own)
        assert answer == verdict.is_worse(cost, declared, readings, RULES)
        assert own.watch["read"] == {"chance_deviations", "worse_fraction"}
        for factor in rules.FACTORS:
            other = replace(RULES, chance_deviations=factor * RULES.chance_deviations)
            differs = verdict.is_worse(cost, declared, readings, other) != answer
            assert not differs or ("chance_deviations", factor) in own.watch["noted"]


def test_changed_rules_mean_something():
    assert rules.changed("most_effects", 0.5) == 2
    assert rules.changed("noise_floor", 2.0) == pytest.approx(1.1)
    assert rules.changed("named_probability", 0.5) == pytest.approx(0.95)
    assert rules.changed("interval_periods", 2.0) == (8.0, 2.0)
