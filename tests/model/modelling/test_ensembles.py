"""Ensembles: many runs of one model by one call, against closed forms and against runs one by one."""

import numpy as np
import pytest

from masking.errors import DeclarationError, IntegrationError, ModelError
from masking.model.modelling import ensembles
from masking.model.modelling.model import Model, load_model

TIMES = np.linspace(0.0, 5.0, 26)


@pytest.fixture(scope="module")
def huygens():
    return load_model("huygens").dimensionless()


def test_each_run_has_its_own_damping_and_start():
    """The beam alone is a linear oscillator: x = a exp(-z Om t) (cos + z/sqrt(1 - z^2) sin)(Om sqrt(1 - z^2) t)."""
    beam = load_model("huygens").dimensionless().with_parameters(mu1=0.0, mu2=0.0)
    z, a, om = np.linspace(0.05, 0.6, 12), np.linspace(-1.0, 1.0, 12), np.linspace(3.0, 0.5, 12)
    found = beam.simulate(TIMES, ensemble={"z": z, "x": a, "Om": om})
    damped = (om * np.sqrt(1.0 - z**2))[:, None]
    decay, turn = np.exp(-(z * om)[:, None] * TIMES), damped * TIMES
    exact = a[:, None] * decay * (np.cos(turn) + (z / np.sqrt(1.0 - z**2))[:, None] * np.sin(turn))
    assert found.states.shape == (12, 26, 6)
    assert np.abs(found["x"] - exact).max() < 1e-9
    assert not found.errors


def test_runs_in_lanes_are_those_one_by_one(huygens):
    """Smooth runs are made side by side, with the same steps; what rounding changes stays far below the tolerance."""
    values = {"z": np.linspace(0.1, 0.3, 21), "th2'": np.linspace(-0.2, 0.2, 21)}
    for times in (TIMES, -TIMES[::5], TIMES[:1], np.repeat(TIMES, 2)):
        found = huygens.simulate(times, {"th1": 0.3}, ensemble=values)
        ones = [
            huygens.with_parameters(z=z).simulate(times, {"th1": 0.3, "th2'": v})
            for z, v in zip(*values.values(), strict=True)
        ]
        assert np.abs(found.states - [one.states for one in ones]).max() < 1e-12
        assert found.steps == sum(one.steps for one in ones)
        assert np.array_equal(found.times, times)


def test_a_run_depends_on_its_own_values_alone(huygens):
    """To the last bit: on neither the runs beside it, nor their number, nor the threads."""
    z, start = np.linspace(0.1, 0.3, 21), np.linspace(-2.0, 2.0, 21)

    def states(runs, threads=1):
        given = {"z": z[runs], "th1": start[runs]}
        fixed = {"initial": {}, "inputs": None, "tolerance": 1e-6}
        return ensembles.simulate(huygens, TIMES, given, threads=threads, **fixed).states

    every = np.arange(21)
    expected = states(every)
    for runs in (every[::-1], every[3:4], every[2:11], every[::2]):
        assert np.array_equal(states(runs), expected[runs])
    assert np.array_equal(states(every, 3), expected)


@pytest.mark.parametrize("tolerance", [1e-5, 1e-7, 1e-9])
@pytest.mark.parametrize("rate", [1e-9, 1.0, 1e12])
def test_rounding_to_single_precision_stays_below_the_tolerance(declared, rate, tolerance):
    """In any units: x'' = -w^2 (x + 2 x^3/a^2) has the energy v^2 + w^2 (x^2 + x^4/a^2)."""
    model = declared(coordinates={"x": {}}, parameters={"w": 1, "a": 1}, equations={"x''": "-w**2*(x + 2*x**3/a**2)"})
    times, size, w = np.linspace(0.0, 10.0 / rate, 3), np.geomspace(1e-7, 1e25, 19), np.full(19, rate)
    start = size * np.linspace(0.5, 2.0, 19)

    def simulated(runs, accuracy=tolerance):
        ensemble = {"x": start[runs], "w": w[runs], "a": size[runs]}
        given = {"initial": {"x'": 0.0}, "inputs": None, "tolerance": accuracy}
        return ensembles.simulate(model, times, ensemble, **given)

    found, exact = simulated(np.arange(19)), simulated(np.arange(19), 1e-13)
    assert not found.errors
    x, v = found["x"] / size[:, None], found["x'"] / size[:, None] / rate
    energy = v**2 + x**2 + x**4
    assert np.abs(energy / energy[:, :1] - 1.0).max() < 300.0 * tolerance
    for run in range(19):  # those which need double precision beside those which do not
        assert np.array_equal(simulated(np.array([run])).states[0], found.states[run])
    ones = [model.with_parameters(w=rate, a=a) for a in size]
    given = {"tolerance": tolerance}
    alone = [one.simulate(times, {"x": x, "x'": 0.0}, **given)["x"] for one, x in zip(ones, start, strict=True)]
    errors = [(np.abs(x - exact["x"]) / size[:, None]).max() for x in (found["x"], np.array(alone))]
    assert errors[0] <= 2.0 * errors[1] + 2.0 * tolerance


@pytest.mark.parametrize(
    ("equation", "values"),
    [
        ("-k*x**3/m", {"k": 1e150, "m": 1e150}),
        ("-k*(x + x**3)/(m + k*x**2)*(m/k)", {"k": 1e10, "m": 1e45}),
        ("-k*(x + x**3)/(m + k*x**2)*(m/k)", {"k": 1e-20, "m": 1e-20}),
        ("-((x + k)**3 - k**3 - m*x*k)/(3*k**2)", {"k": 1e4, "m": 3.0}),
        ("-k*1e-30*m/(1 + x**2)*sin(x)", {"k": 1e-25, "m": 1e55}),
    ],
)
def test_what_single_precision_cannot_hold_or_cancels_is_computed_in_double(declared, equation, values):
    model = declared(coordinates={"x": {}}, parameters=values, equations={"x''": equation})
    ensemble = {"x": np.linspace(0.2, 1.0, 17), "x'": np.zeros(17)}
    exact = model.simulate(TIMES, ensemble=ensemble, tolerance=1e-12)
    for tolerance in (1e-6, 1e-8):
        found = model.simulate(TIMES, ensemble=ensemble, tolerance=tolerance)
        assert np.abs(found.states - exact.states).max() < 20.0 * tolerance


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
    model, th1 = Model(load_model("duffing").declaration), np.full(19, 0.3)
    th1[[4, 17]] = -1e9, -2e9  # springs that push to infinity
    found = model.simulate(TIMES, ensemble={"th1": th1})
    assert set(found.errors) == {4, 17}
    assert np.isnan(found.states[[4, 17]]).all()
    assert np.array_equal(found.states[[0] * 17], found.states[np.delete(np.arange(19), [4, 17])])
    for run, error in found.errors.items():
        with pytest.raises(IntegrationError) as one:
            model.with_parameters(th1=th1[run]).simulate(TIMES)
        assert error.partition("(")[0] == str(one.value).partition("(")[0]
        assert "t = " in error


def test_runs_with_inputs_by_name_may_all_end_early(declared):
    """x'' = x^3 from x = a and x' = a^2/sqrt(2) is a/(1 - a t/sqrt(2)), infinite at sqrt(2)/a."""
    model = declared(coordinates={"x": {}}, inputs={"F": {}}, equations={"x''": "x**3 + F"})
    a = np.array([1.0, 0.1, 2.0])
    values = {"x": a, "x'": a**2 / 2**0.5}
    found = model.simulate(TIMES, inputs={"F": 0.0}, ensemble=values)
    assert set(found.errors) == {0, 2}
    assert np.abs(found["x"][1] * (1.0 - a[1] * TIMES / 2**0.5) / a[1] - 1.0).max() < 1e-9
    found = model.simulate(TIMES, inputs={"F": 0.0}, ensemble={name: x[::2] for name, x in values.items()})
    assert set(found.errors) == {0, 1}
    assert np.isnan(found.states).all()


def test_names_and_values_that_do_not_fit_are_refused(huygens):
    with pytest.raises(ModelError, match="no parameter or state 'zz'; did you mean 'z'"):
        huygens.simulate(TIMES, ensemble={"zz": [0.1]})
    with pytest.raises(ModelError, match="as many values for each name, one for each run; got z 2, x 1"):
        huygens.simulate(TIMES, ensemble={"z": [0.1, 0.2], "x": [0.0]})
    with pytest.raises(IntegrationError, match="times must be one row"):
        load_model("escapements").simulate(TIMES[[0, 2, 1]], ensemble={"x1": [0.1]})
    with pytest.raises(DeclarationError, match="mu1"):
        huygens.simulate(TIMES, ensemble={"mu1": [0.1, 1.5]})
