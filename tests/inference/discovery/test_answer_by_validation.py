"""What no answer does: to be worse on unseen data than the model as declared, contradict readings, forget its prior."""

from dataclasses import replace

import numpy as np
import pytest

import masking
from masking.inference.discovery import fitting, validation_simulation
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.decision_rules import RULES
from masking.inference.discovery.excluded_laws import is_excluded
from masking.inference.discovery.parameter_prior import prior_of, train_validation_split
from masking.inference.discovery.verdict import is_worse
from masking.inference.estimation.identification_data import Data
from masking.reports import discovery_text
from tests.inference.discovery.test_continuation import models, problem

__all__ = ["models"]
CASE = {"seconds": 20.0, "off": 0.02, "noise": 1e-3, "driven": True}


def test_worse_is_more_than_chance_and_more_than_a_thousandth():
    assert not is_worse(10_000.0 + 3.0 * np.sqrt(2e4), 10_000.0, 10_000, RULES)
    assert is_worse(10_001.0 + 3.0 * np.sqrt(2e4), 10_000.0, 10_000, RULES)
    assert not is_worse(1.0009e9, 1e9, 10_000, RULES)
    assert is_worse(1.0011e9, 1e9, 10_000, RULES)
    assert is_worse(np.inf, 1.0, 10_000, RULES)


def test_unseen_data_are_predicted_within_the_uncertainty_of_the_parameters(models):
    """A frequency that two seconds give to a hundredth loses the phase of thirty; the true law stays possible there."""
    rig = models["pendulum"]
    known = fitting.fit(problem(rig, "pendulum", seconds=2.0, off=0.02, noise=5e-3, driven=False))
    other = problem(rig, "pendulum", seconds=30.0, off=0.02, noise=5e-3, driven=False, seed=1)
    size = other.record.readings.size
    alone = validation_simulation.validated(other, known)
    within = validation_simulation.predicted(other, known, alone)
    assert alone.misfits.sum() > 2.0 * size
    assert within.misfits.sum() < (1.0 + 5.0 * np.sqrt(2.0 / size)) * size
    assert within.pull < 4.0 * len(known.theta)
    off = (within.theta - known.theta) / known.deviations[: len(known.theta)]
    assert within.pull == pytest.approx(float(off @ off), rel=1e-6)
    sure = replace(known, covariance=1e-12 * known.covariance)
    assert validation_simulation.predicted(other, sure, alone).misfits.sum() > 0.9 * alone.misfits.sum()


def test_what_is_worse_on_unseen_data_is_not_given(models, tmp_path):
    """Of a drag that is there in the first part alone, what a fit makes of it is worse than nothing afterwards."""
    t = np.arange(1500) / 25.0
    rng, change = np.random.default_rng(1), 42.0
    decay = np.exp(-0.03 * t) * np.exp(-0.12 * np.minimum(t, change))
    q = 0.05 * decay / decay[t >= change][0] * np.cos(np.sqrt(60.0) * t) + 2e-4 * rng.standard_normal(len(t))
    np.savez(tmp_path / "record.npz", t=t, q=q)
    (tmp_path / "model.yaml").write_text(
        "name: pendulum\ncoordinates: {q: {}}\n"
        "parameters: {w2: {value: 60}, k: {value: 0.06}}\nequations: {\"q''\": -w2*q - k*q'}\n"
    )
    found = masking.discover(tmp_path / "record.npz", model=tmp_path / "model.yaml")
    before, after = found.simulation_error.validation
    assert after["q"] <= 1.001 * before["q"]
    assert found.withheld is not None
    assert found.withheld.validation_error["q"] > before["q"]
    assert "as declared, so it is not reported" in discovery_text.sentence(found)
    assert found.as_dict()["withheld"]["validation_error"] == found.withheld.validation_error


@pytest.mark.parametrize(
    ("effect", "values", "excluded"),
    [
        ("sensor_saturation", (0.5,), True),
        ("sensor_saturation", (3.0,), False),
        ("sensor_gain", (0.1,), False),
    ],
)
def test_readings_beyond_the_range_of_a_sensor_exclude_its_law(models, effect, values, excluded):
    asked = problem(models["pendulum"], "pendulum", **CASE)  # readings up to 1.3
    assert is_excluded(asked, [EffectInstance(effect, "q", values, (0,))]) is excluded


@pytest.mark.parametrize(("static", "excluded"), [(0.3, False), (0.1, True)])
def test_friction_that_grows_with_the_rate_is_not_stribecks(models, static, excluded):
    asked = problem(models["pendulum"], "pendulum", **CASE)
    law = EffectInstance("stribeck_friction", asked.rig.places[0].name, (0.2, static, 0.5), (0, 1, 2))
    assert is_excluded(asked, [law]) is excluded


def test_outliers_exclude_nothing(models):
    asked = problem(models["pendulum"], "pendulum", **CASE)
    readings = np.clip(asked.record.readings, -0.5, 0.5)
    readings[::200] = 1.0
    clipped = replace(asked, record=replace(asked.record, readings=readings))
    assert not is_excluded(clipped, [EffectInstance("sensor_saturation", "q", (0.5,), (0,))])


def test_no_parameter_is_known_worse_than_before_the_record(models):
    """The misfit of a law that the model lacks does not outweigh the prior in directions that hardly matter."""
    asked = problem(models["Duffing"], "pendulum", **CASE)
    small = replace(asked.record, readings=0.02 * asked.record.readings, commands=0.02 * asked.record.commands)
    rig, prior = asked.rig, prior_of(asked.rig.twin, asked.rig, 0.05)
    asked = replace(asked, record=small, prior=prior, sigma=1e-7 * np.ones(1))
    held = fitting.fit(asked)
    cubic = rig.names.index("c")
    assert abs(held.theta[cubic] - prior.mean[cubic]) < 3.0 * prior.deviation[cubic]
    assert (held.deviations < 1.05 * prior.deviation).all()
    wide = replace(asked, prior=replace(prior, deviation=1e6 * prior.deviation))
    free = fitting.fit(wide, theta=held.theta, start=held.start)
    assert abs(free.theta[cubic] - prior.mean[cubic]) > 10.0 * prior.deviation[cubic]
    assert held.cost < 1.2 * free.cost


def test_a_parameter_keeps_its_sign_unless_its_deviation_is_larger_than_its_value(models):
    rig = models["pendulum"]
    assert (prior_of(rig.twin, rig, 0.99).low == 0.0).all()


def test_of_a_decay_that_comes_to_rest_the_motion_is_split():
    t = np.arange(4000) / 100.0
    decay = np.exp(-t) * np.cos(20.0 * t) + 1e-3 * np.random.default_rng(1).standard_normal(len(t))
    record = Data("a decay", 100.0, np.zeros((len(t), 0)), decay[:, None])
    parts = train_validation_split(record, 0.3)
    assert all(part.moves for part in parts)
    assert sum(len(part) for part in parts) / 100.0 == pytest.approx(np.log(1e3 / 8.0), abs=0.5)
    driven = Data("driven", 100.0, np.sin(t)[:, None], decay[:, None])
    assert [len(part) for part in train_validation_split(driven, 0.3)] == [2800, 1200]


def test_a_loop_that_holds_a_position_is_at_rest():
    """A cart moves to where a loop then holds it for most of the record: readings flicker by a step of the encoder."""
    rate, step, z, rest = 250.0, 5e-5, np.zeros(2), np.random.default_rng(2)
    rows = []
    for k in range(2250):
        reading = step * np.round(z[0] / step + 0.4 * rest.standard_normal())
        command = 10.0 * (0.2 * (k > 250) - reading)
        z = z + np.array([z[1], -20.0 * z[1] + 8.0 * command]) / rate
        rows.append((command, reading))
    record = Data("a cart", rate, np.array(rows)[:, :1], np.array(rows)[:, 1:])
    train, unseen = train_validation_split(record, 0.3)
    assert len(train) + len(unseen) < 0.6 * len(record)
    assert np.ptp(unseen.readings) > 20.0 * step
