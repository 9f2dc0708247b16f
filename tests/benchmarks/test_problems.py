"""Random problems: drawn as they are described, and answered where no sensor shows a force at once."""

import numpy as np
import pytest

from masking.inference.discovery.latent_force import projected
from masking.inference.discovery.smoothing import Motion
from tests.benchmarks.problems import drawn
from tests.benchmarks.problems.__main__ import Outcome, summary

NONE = np.zeros((5, 2))


def test_the_same_seed_draws_the_same_problem_and_others_differ():
    one, again, other = (drawn.drawn(seed) for seed in (3, 3, 4))
    assert (one.model, one.plant, one.truth) == (again.model, again.plant, again.truth)
    assert all(np.array_equal(one.columns[name], again.columns[name]) for name in one.columns)
    assert one.model != other.model


def test_an_answer_is_right_if_it_has_each_law_and_no_other():
    truth = [("dry_friction", ("spring2", "x2")), ("saturation", ("u1",))]
    problem = drawn.Problem("", "", {}, truth, "")
    assert problem.is_right([("saturation", "u1"), ("lugre_friction", "x2")])
    assert not problem.is_right([("dry_friction", "spring2")])
    assert not problem.is_right([("saturation", "u1"), ("dry_friction", "spring1")])
    assert not problem.is_right([("saturation", "u1"), ("dry_friction", "x2"), ("stop", "spring1")])
    assert problem.has_name
    assert not drawn.Problem("", "", {}, [("valve", ("spring1",))], "").has_name


def test_the_summary_counts_what_is_said():
    said = [Outcome(i, "", "", "", probability=0.95, is_right=i > 0, seconds=200.0 * (i == 1)) for i in range(4)]
    lines = summary([*said, Outcome(4, "", "", "", "traceback")])
    assert lines[0] == "problems 5: 1 tracebacks, 0 refused, 1 longer than 180 s"
    assert "answers of 90 % and more that are right: 3 of 4" in lines
    assert "Brier score: 0.228 of 4" in lines  # (3 * 0.05**2 + 0.95**2) / 4 = 0.2275


def test_a_force_that_no_sensor_shows_has_no_part_in_those_that_one_does():
    forces = np.column_stack([np.zeros(5), np.arange(5.0)])
    motion = Motion(NONE, forces, np.array([np.inf, 0.1]), NONE, NONE, NONE)
    seen, deviation = projected(motion, np.array([1.0, -1.0]))
    np.testing.assert_allclose(seen, -forces[:, 1])
    assert deviation == pytest.approx(0.1)
    unseen, unknown = projected(motion, np.array([1.0, 0.0]))
    assert not unseen.any()
    assert unknown == np.inf
