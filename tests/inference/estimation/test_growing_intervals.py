"""Fits that begin far off, intervals that hold the truth, and initial states; records of closed-form motions."""

import numpy as np
import pytest
from scipy import linalg, stats

from masking.app.workflows import discovery_inputs, identify, simulate
from masking.inference.estimation import growing_intervals, simulation
from masking.inference.estimation.fit import fit
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.sensitivity import Sensitivity

RATE, TRUE = 100.0, {"c": 0.6, "k": 100.0}
MODEL = """
name: oscillator
coordinates: {x: {}}
inputs: {u: {}}
parameters: {c: {value: CC}, k: {value: KK}}
equations: {"x''": u - c*x' - k*x - CUBE*x**3}
"""


def written(folder, *, c=TRUE["c"], k=TRUE["k"], cube="0", name="model"):
    path = folder / f"{name}.yaml"
    path.write_text(MODEL.replace("CC", str(c)).replace("KK", str(k)).replace("CUBE", cube))
    return path


def motion(seconds, *, begin=(0.0, 0.0), driven=5.0, still=0.0):
    """Return held forces and the displacement, exact from sample to sample by a matrix exponential."""
    count = round(seconds * RATE)
    u = driven * np.repeat(np.random.default_rng(7).standard_normal(count // 10 + 1), 10)[:count]
    u[: round(still * RATE)] = 0.0
    block = np.zeros((3, 3))
    block[0, 1], block[1, :] = 1.0, (-TRUE["k"], -TRUE["c"], 1.0)
    step, state, found = linalg.expm(block / RATE), np.array([*begin, 0.0]), np.empty(count)
    for i in range(count):
        found[i], state[2] = state[0], u[i]
        state = step @ state
    return u[:, None], found[:, None]


def record(seconds, noise, seed=0, **how):
    u, x = motion(seconds, **how)
    return Data("made", RATE, u, x + noise * np.random.default_rng(seed).standard_normal(x.shape))


def test_intervals_hold_the_truth_as_often_as_they_say(tmp_path):
    """Of 24 records of a linear oscillator; fewer that hold it are a chance of 1 in 1000."""
    twin, truth = discovery_inputs.rig(written(tmp_path, c=0.5, k=95.0)), np.array([*TRUE.values()])
    found = [fit(twin, record(4.0, 3e-3, seed, begin=(0.1, -0.5)), ("c", "k")) for seed in range(24)]
    stated = [one for one in found if not one.doubt]
    assert len(stated) >= 22
    inside = [(one.intervals[:, 0] <= truth) & (truth <= one.intervals[:, 1]) for one in stated]
    assert np.sum(inside) >= stats.binom.ppf(1e-3, np.size(inside), 0.95)
    errors = [(one.values - truth) / one.std for one in stated]
    np.testing.assert_allclose(np.std(errors), 1.0, atol=0.3)


def test_intervals_grow_from_one_period():
    """A sine of period 0.5 s: 50 samples, then four times as many each, no more than half of the record."""
    x = np.sin(4.0 * np.pi * np.arange(4000) / RATE)[:, None]
    assert [*growing_intervals.lengths(Data("made", RATE, 0.0 * x, x), 4000)] == [50, 200, 800]


def test_a_model_that_lacks_something_states_no_interval_and_says_why(tmp_path):
    twin = discovery_inputs.rig(written(tmp_path, cube="40"))
    found = fit(twin, record(10.0, 1e-4, begin=(0.5, 0.0)), ("c", "k"))
    assert np.isnan(found.intervals).all()
    assert found.parameters()["k"]["std"] is None
    assert "+-" not in str(found)
    assert "times its noise" in str(found)
    assert "no confidence intervals are stated: " in str(found)


def test_a_residual_that_is_not_white_states_no_interval(tmp_path):
    """Noise that a sensor filters is as strong as white noise is, and correlated from sample to sample."""
    twin, clean = discovery_inputs.rig(written(tmp_path)), record(20.0, 0.0)
    noise = np.convolve(np.random.default_rng(1).standard_normal(len(clean) + 3), [1e-3] * 4, "valid")
    found = fit(twin, Data("made", RATE, clean.commands, clean.readings + noise[:, None]), ("c", "k"))
    assert "is not white noise" in found.doubt or "compensate" in found.doubt


def saved(path, data):
    table = np.column_stack([np.arange(len(data)) / RATE, data.commands, data.readings])
    np.savetxt(path, table, delimiter=",", header="t,u,x", comments="")
    return path


@pytest.mark.parametrize("where", ["model", "plant"])
def test_a_model_may_stand_where_a_plant_does(tmp_path, where):
    path = saved(tmp_path / "record.csv", record(8.0, 1e-3))
    found = identify.identify(path, **{where: written(tmp_path, k=95.0)}, out=tmp_path / "out")
    np.testing.assert_allclose(found.values, [*TRUE.values()], rtol=0.02)
    made = simulate.simulate(tmp_path / "out" / "plant.yaml", path)
    assert made.chi["x"] < 1.1 * made.floor["x"]


def test_a_wrong_model_begins_where_the_record_does(tmp_path):
    """At rest: a spring that is far too soft would begin with a velocity that makes up for what it does not do."""
    twin, given = discovery_inputs.rig(written(tmp_path, c=0.0, k=4.0)), record(3.0, 1e-5, still=0.4)
    sensing = Sensitivity(twin, ())
    state, _ = simulation.nearest(sensing, np.empty(0), given, given.noise**-2.0, thorough=True)
    assert abs(state[0]) < 1e-4
    assert abs(state[1]) < 0.01
