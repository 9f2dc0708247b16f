"""Thinning: however fast a record is sampled, there are means left to compare."""

import numpy as np
import pytest

from masking.discovery.augmented_model import AugmentedModel
from masking.discovery.prior import prior_of
from masking.discovery.problem import EstimationProblem
from masking.discovery.thinning import FEWEST, thinned, thinning
from masking.estimation.data import Data
from masking.rig.twin import Twin


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
    thin, every = thinning(EstimationProblem(rig, record, prior_of(twin, rig, 0.01), np.ones(1), 2))
    assert every % thin == 0
    assert len(record) // every >= FEWEST
    assert len(thinned(record.readings, thin)) >= FEWEST
