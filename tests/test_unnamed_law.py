"""Laws that no dictionary has: fitted as curves, written into the model, and true to what is promised of them.

Records are those of the benchmark: integrated by scipy from laws typed there.
"""

import json

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import masking
from masking.declaration.expression import Expression
from masking.discovery.bases import Curve, pieces
from tests.benchmarks.laws import records

CASE = records.Case("fluid 1.7", 1)


def test_a_curve_holds_every_spline_over_its_points():
    x = np.linspace(-0.7, 1.0, 400)
    curve = Curve(pieces(x, 9))
    truth = CubicSpline(curve.points, np.sin(3.0 * curve.points), bc_type="natural")
    inside = np.linspace(curve.points[0], curve.points[-1], 500)[1:-1]
    rows = curve.values(inside)
    factors = np.linalg.lstsq(rows, truth(inside), rcond=None)[0]
    np.testing.assert_allclose(rows @ factors, truth(inside), atol=1e-10)
    np.testing.assert_allclose(curve.values(inside, 1) @ factors, truth(inside, 1), atol=1e-8)
    assert np.abs(curve.bends()[[0, -1]] @ factors).max() < 1e-6
    np.testing.assert_allclose(rows.sum(axis=1), 1.0, atol=1e-12)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder, rig = tmp_path_factory.mktemp("law"), records.Rig.of(CASE)
    (folder / "model.yaml").write_text(records.model(rig, 1))
    for seed, name in ((1, "train"), (2, "unseen")):
        (folder / f"{name}.csv").write_text(records.table(records.record(rig, seed)))
    given = {"model": folder / "model.yaml", "validation": folder / "unseen.csv", "hold": "first-order"}
    return masking.discover(folder / "train.csv", **given, out=folder / "found"), rig, folder


def test_a_law_without_a_name_leaves_no_more_than_noise(found):
    discovery, rig, _ = found
    assert (discovery.verdict, discovery.law.place, discovery.law.closed) == ("unknown", "spring1", True)
    assert discovery.law.error[1]["q1"] == pytest.approx(records.NOISE, rel=0.1)
    law = discovery.law.instance
    x, rate = (discovery.search.motion.displacement[::20, 0], discovery.search.motion.rate[::20, 0])
    truth = np.array([rig.hidden(d, v) for d, v in zip(x, rate, strict=True)])
    known, force = dict(zip(law.entry.parameters, law.values, strict=True)), Expression(law.entry.expression)
    made = [force.evaluate({**known, "d": d, "d_rate": v}) for d, v in zip(x, rate, strict=True)]
    # A stiffness that is off by 1 % and a force of the displacement are one and the same.
    assert np.abs(made - truth).max() < 0.05 * np.abs(truth).max()


def test_the_written_model_reproduces_what_is_promised(found):
    discovery, _, folder = found
    for name, promised in zip(("train", "unseen"), discovery.law.error, strict=True):
        made = masking.simulate(folder / "found" / "plant.yaml", folder / f"{name}.csv", hold="first-order")
        assert made.chi["q1"] == pytest.approx(promised["q1"], rel=0.01)
    content = json.loads((folder / "found" / "discovery.json").read_text())
    assert (content["verdict"], content["law"]["on"], content["law"]["closed"]) == ("unknown", "spring1", True)
    assert content["model"].endswith("model+unnamed_law.yaml")
    page = (folder / "found" / "discovery.html").read_text()
    assert "A law without a name in spring1 explains the record" in page
