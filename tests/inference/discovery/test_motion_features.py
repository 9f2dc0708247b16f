"""Motion features: means of what effects do along a motion, in elements from one of a few samples.

However fast a record is sampled, there are means left to compare.
"""

from dataclasses import replace

import numpy as np
import pytest

from masking.control.rig.twin import Twin
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.motion_features import FEWEST, Kept, MotionFeatures, Thinning, middles, thinned
from masking.inference.discovery.parameter_prior import prior_of
from masking.inference.discovery.smoothing import Motion
from masking.inference.estimation.identification_data import Data
from tests.app.workflows.test_discover import PLANT

RATE, COUNT, MEAN = 1e3, 9000, 9
T = np.arange(COUNT) / RATE
X, V = 2e-3 * np.sin(3.0 * T), 6e-3 * np.cos(3.0 * T)


@pytest.fixture(scope="module")
def features(tmp_path_factory):
    """Return what the rig's effects do where every place moves as 2 mm sin(3 t), without a stride."""
    path = tmp_path_factory.mktemp("plant") / "plant.yaml"
    path.write_text(PLANT)
    twin = Twin.load(path)
    rig, readings = AugmentedModel(twin, twin.equation_parameters()), np.zeros((COUNT, 3))
    states, moving = np.zeros((COUNT, 6)), [np.tile(part[:, None], len(rig.places)) for part in (X, V, -9.0 * X)]
    motion = Motion(states, states[:, :3], np.ones(3), *moving)
    return MotionFeatures(rig, Data("made", RATE, readings, readings), motion, readings, Thinning(MEAN, MEAN), Kept())


@pytest.mark.parametrize(
    ("effect", "values", "law", "error"),
    [
        ("hardening_spring", (5e6,), 5e6 * X**3, 1e-4),
        ("quadratic_damping", (700.0,), 700.0 * V * np.abs(V), 1e-3),
        ("dry_friction", (0.4, 1e-9), 0.4 * np.sign(V), 1e-2),
    ],
)
def test_a_law_has_the_means_of_its_closed_form(features, effect, values, law, error):
    """A sign that is looked at every 3 ms turns up to 1.5 ms late."""
    expected = thinned(law[:, None], MEAN)[:, 0]
    for stride in (1, 3):
        made = replace(features, thinning=Thinning(MEAN, MEAN, stride))
        found, _ = made.with_slopes(EffectInstance(effect, "spring1", values, (0,)))
        assert len(found) == COUNT // MEAN
        assert np.sqrt(((found[:, 0] - expected) ** 2).mean() / (expected**2).mean()) < error * stride**2
        np.testing.assert_allclose(found[:, 1] * values[0], found[:, 0], rtol=1e-9, atol=1e-12)  # by a factor


@pytest.mark.parametrize("rate", [2.0, 1e3, 5e4, 2e6])
def test_a_record_at_any_rate_has_means(tmp_path, rate):
    (tmp_path / "model.yaml").write_text(
        "name: level\nstates: {x: {unit: m, initial: 1.0}}\ninputs: {u: {unit: m/s}}\n"
        "parameters: {a: {value: 0.1, unit: 1/s}}\nequations: {x': u - a*x}\noutputs: {s: {expression: x, unit: m}}\n"
    )
    (tmp_path / "plant.yaml").write_text("name: tank\nmodel: model.yaml\nsensors: {s: {measures: x, unit: m}}\n")
    twin, columns = Twin.load(tmp_path / "plant.yaml"), np.zeros((1380, 1))
    record = Data("made", rate, columns, columns + np.arange(1380.0)[:, None])
    rig = AugmentedModel(twin, ("a",))
    thinning = Thinning.of(EstimationProblem(rig, record, prior_of(twin, rig, 0.01), np.ones(1), 2))
    assert thinning.readings % thinning.motion == 0
    assert thinning.motion % thinning.stride == 0
    assert len(record) // thinning.readings >= FEWEST
    assert len(thinned(record.readings, thinning.motion)) >= FEWEST


@pytest.mark.parametrize("stride", [1, 2, 3, 4, 5])
def test_middles_have_the_means_of_a_straight_line(stride):
    line = np.arange(100.0)
    expected = thinned(line[:, None], stride)[:, 0]
    assert np.array_equal(middles(line, stride), expected)
