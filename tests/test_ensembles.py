"""Ensembles: many runs of one model by one call, against closed forms and against runs one by one."""

import numpy as np
import pytest

from masking.errors import DeclarationError, ModelError
from masking.modelling.model import Model, load_model

TIMES = np.linspace(0.0, 5.0, 26)


@pytest.fixture(scope="module")
def huygens():
    return load_model("huygens").dimensionless()


def test_each_run_has_its_own_damping_and_start():
    """The beam alone is a linear oscillator: x = a exp(-z Om t) (cos + z/sqrt(1 - z^2) sin)(Om sqrt(1 - z^2) t)."""
    beam = load_model("huygens").dimensionless().with_parameters(mu1=0.0, mu2=0.0)
    z, a, om = np.linspace(0.05, 0.6, 12), np.linspace(-1.0, 1.0, 12), 1.3034
    found = beam.simulate(TIMES, ensemble={"z": z, "x": a})
    damped = om * np.sqrt(1.0 - z**2)[:, None]
    decay, turn = np.exp(-z[:, None] * om * TIMES), damped * TIMES
    exact = a[:, None] * decay * (np.cos(turn) + (z / np.sqrt(1.0 - z**2))[:, None] * np.sin(turn))
    assert found.states.shape == (12, 26, 6)
    assert np.abs(found["x"] - exact).max() < 1e-9
    assert not found.errors


def test_an_ensemble_is_bit_equal_to_runs_one_by_one(huygens):
    values = {"z": np.linspace(0.1, 0.3, 5), "th2'": np.linspace(-0.2, 0.2, 5)}
    found = huygens.simulate(TIMES, {"th1": 0.3}, ensemble=values)
    for run in range(5):
        one = huygens.with_parameters(z=values["z"][run]).simulate(TIMES, {"th1": 0.3, "th2'": values["th2'"][run]})
        assert np.array_equal(found.states[run], one.states)


def test_scales_that_depend_on_what_varies_and_events_are_followed_too():
    model = load_model("duffing_si").dimensionless()
    scale = next(
        iter({n for s in model.declaration.scales.values() if hasattr(s.value, "names") for n in s.value.names})
    )
    values = model.declaration.parameters[scale].value * np.array([0.9, 1.1])
    found = model.simulate(TIMES, ensemble={scale: values})
    for run, value in enumerate(values):
        assert np.array_equal(found.states[run], model.with_parameters(**{scale: value}).simulate(TIMES).states)
    ball = load_model("escapements")
    found = ball.simulate(TIMES, ensemble={ball.coordinates[0]: [0.1, 0.2]})
    assert np.array_equal(found.states[1], ball.simulate(TIMES, {ball.coordinates[0]: 0.2}).states)


def test_a_run_that_cannot_go_on_is_named_and_the_others_go_on():
    model = Model(load_model("duffing").declaration)
    found = model.simulate(TIMES, ensemble={"th1": [0.3, -1e9, 0.3]})  # a spring that pushes to infinity
    assert set(found.errors) == {1}
    assert "t = " in found.errors[1]
    assert np.isnan(found.states[1]).all()
    assert np.array_equal(found.states[0], found.states[2])


def test_names_and_values_that_do_not_fit_are_refused(huygens):
    with pytest.raises(ModelError, match="no parameter or state 'zz'; did you mean 'z'"):
        huygens.simulate(TIMES, ensemble={"zz": [0.1]})
    with pytest.raises(ModelError, match="as many values for each name, one for each run; got z 2, x 1"):
        huygens.simulate(TIMES, ensemble={"z": [0.1, 0.2], "x": [0.0]})
    with pytest.raises(DeclarationError, match="mu1"):
        huygens.simulate(TIMES, ensemble={"mu1": [0.1, 1.5]})
