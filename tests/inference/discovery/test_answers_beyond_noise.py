"""Answers on a rig that no model explains down to its noise: a hidden law beside a slow force that nothing describes.

Motion by scipy.
"""

import json

import numpy as np
import pytest
from scipy import signal
from scipy.integrate import solve_ivp

from masking.app import cli
from masking.app.workflows.discover import discover
from masking.reports import discovery_page, discovery_text

MODEL = """
name: mass on a spring
coordinates: {x: {unit: m}}
inputs: {f: {unit: N}}
parameters:
  m: {value: 1, unit: kg}
  c: {value: 2, unit: N*s/m}
  k: {value: 400, unit: N/m}
equations: {m*x'': f}
elements: {spring: {displacement: x, unit: N, force: k*d + c*d_rate, acts: {x: -1}}}
"""
RATE, NOISE, HARD, OFF = 200.0, 2e-6, 4e5, {"m": 1.004, "c": 1.005, "k": 0.996}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Write the model, and a record of it with parameters that are off, a cubic spring and a slow force."""
    folder, rng = tmp_path_factory.mktemp("rig"), np.random.default_rng(53)
    t = np.arange(4000) / RATE
    tones = rng.uniform(0.5, 6.0, 12)
    f = 3.0 * np.sin(2.0 * np.pi * tones * t[:, None] + rng.uniform(0.0, 6.0, 12)).sum(axis=1)
    slow = signal.lfilter([1.0], [1.0, -0.99], rng.standard_normal(len(t)))
    slow *= 0.4 / slow.std()

    def moved(at, y):
        force = np.interp(at, t, f + slow) - HARD * y[0] ** 3
        return y[1], (force - OFF["c"] * 2.0 * y[1] - OFF["k"] * 400.0 * y[0]) / OFF["m"]

    x = solve_ivp(moved, (0.0, t[-1]), (0.0, 0.0), t_eval=t, rtol=1e-9, atol=1e-12, max_step=2e-3).y[0]
    np.savez(folder / "record.npz", t=t, f=f, x=x + NOISE * rng.standard_normal(len(t)))
    (folder / "model.yaml").write_text(MODEL)
    return folder


@pytest.fixture(scope="module")
def found(files):
    return discover(files / "record.npz", model=files / "model.yaml", hold="first-order")


def test_the_law_is_named_though_the_rest_is_far_above_the_noise(found):
    assert found.simulation_error.over_noise > 20.0
    assert found.verdict == "named"
    (cause,) = found.effects  # a richer spring may take a part of the slow force
    assert (found.twin.dictionary[cause.name].family, cause.on) == ("springs", "spring")
    assert cause.parameters["k3"][0] == pytest.approx(HARD, rel=0.03)


def test_deviations_are_of_the_size_of_the_errors_though_the_residual_is_coloured(found):
    """As independent samples of noise, 2800 readings would make them four thousand times smaller.

    Of seven such records, 28 errors are 2.8 deviations in rms, and 8 at most.
    """
    law = ("hardening_spring", "spring")
    hypothesis = next(one.hypothesis for one in found.search.ranked if one.names == (law,))
    true = np.array([OFF["m"], 2.0 * OFF["c"], 400.0 * OFF["k"], HARD])
    errors = np.append(hypothesis.theta, hypothesis.added) - true
    assert (np.abs(errors) < 10.0 * hypothesis.deviations).all()
    assert (hypothesis.deviations < 0.2 * true).all()


def test_adjusted_parameters_do_not_stand_for_the_law(found):
    theta, known = found.search.base.hypothesis.theta, found.problem.prior
    assert (np.abs(theta - known.mean) < 6.0 * known.deviation).all()


def test_the_grade_of_a_cause_is_its_share_and_its_odds(found):
    (grade,) = found.grades
    after, alone = found.simulation_error.validation[1]["x"], found.simulation_error.adjusted["x"]
    assert grade.share == pytest.approx(1.0 - after / alone)
    assert grade.share > 0.5
    assert grade.odds > 100.0
    assert all(found.twin.dictionary[name].family != "springs" for name, _ in grade.rival)
    (words,) = discovery_text.weights(found)
    assert " spring in spring makes" in words
    assert "of the error on unseen data (odds" in words


def test_the_trace_has_the_answer_and_what_was_refused(found):
    lines = [*found.problem.trace.lines()]
    assert all(line.behind >= 0.0 for line in lines)
    names = [line.tried.names for line in lines]
    assert () in names
    assert found.explanation.names in names
    text = discovery_page.trace_text(found)
    assert "the answer" in text
    assert "no cause" in text


def test_explain_prints_the_trace(files, capsys):
    words = ["discover", str(files / "record.npz"), "--model", str(files / "model.yaml"), "--hold", "first-order"]
    assert cli.main([*words, "--explain", "--out", str(files / "out")]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("Hypotheses in the record, as declared:")
    assert "hardening spring in spring" in printed
    content = json.loads((files / "out" / "discovery.json").read_text(encoding="utf-8"))
    assert {"reading", "causes", "suggested_by", "behind", "error_over_noise", "not_taken"} == {*content["trace"][0]}
    assert content["grades"][0]["on"] == "spring"
    assert "What was looked at" in (files / "out" / "discovery.html").read_text(encoding="utf-8")
