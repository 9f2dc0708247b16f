"""Thinning: however fast a record is sampled, there are means left to compare."""

import numpy as np
import pytest

from masking.control.rig.twin import Twin
from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.motion_features import FEWEST, Thinning, middles, thinned
from masking.inference.discovery.parameter_prior import prior_of
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.estimation.identification_data import Data


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
