"""Inputs of a virtual system: against the same equations typed out for scipy, and what is refused."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import masking
from masking.control.exports.controller_units import sampled_unit
from masking.errors import DeclarationError, ModelError
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.feasibility import feasibility
from masking.lab.signals import linear_chirp
from masking.model.modelling.input_series import Schedule, Series
from masking.reports.run_report import summary
from tests.control.exports.test_controller_units import EXACT, by_kernel
from tests.support.compiled_unit import GCC, CompiledUnit

DRIVEN = """\
name: driven
coordinates: {x: {meaning: displacement, initial: 0.5}}
inputs: {F: force, G: another}
parameters: {w: 2}
equations: {x'': -w*x/2 - 0.1*x' + F + G}
"""
KNOTS = np.linspace(0.0, 20.0, 41)
VALUES = 0.3 * np.sin(0.7 * KNOTS) + 0.1 * np.random.default_rng(0).standard_normal(41)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("inputs")
    (made / "driven.yaml").write_text(DRIVEN)
    rows = "\n".join(f"{t!r},{x!r}" for t, x in zip(KNOTS.tolist(), VALUES.tolist(), strict=True))
    (made / "force.csv").write_text(f"t,F\n{rows}\n")
    return made


def load(folder, inputs, duration=20, initial=None, **controller):
    settings = {"rate": "continuous", **controller}
    return Experiment.load("cart_alone").changed(
        virtual=str(folder / "driven.yaml"), initial=initial or {"x": 0.5}, duration=duration, controller=settings,
        inputs=inputs,
    )  # fmt: skip


def truth(force, tau):
    """x of x'' = -x - 0.1 x' + force at times tau (m,), integrated from knot to knot."""
    y, found = np.array([0.5, 0.0]), np.empty(len(tau))
    for i, (a, b) in enumerate(pairwise(KNOTS)):
        inside = (tau >= a) & (tau <= b)
        made = solve_ivp(
            lambda t, y, i=i: [y[1], -y[0] - 0.1 * y[1] + force(t, i)],
            (a, b), y, "DOP853", dense_output=True, rtol=1e-11, atol=1e-13,
        )  # fmt: skip
        found[inside], y = made.sol(tau[inside])[0], made.y[:, -1]
    return found


SPLINE = CubicSpline(KNOTS, VALUES)
FORCES = {
    "linear": lambda t, i: np.interp(t, KNOTS, VALUES),
    "previous": lambda t, i: VALUES[i],
    "cubic": lambda t, i: SPLINE(t),
}


@pytest.mark.parametrize("kind", FORCES)
def test_a_file_and_an_expression_drive_the_masked_rig(folder, kind):
    source = {"file": str(folder / "force.csv"), "interpolation": kind}
    run = load(folder, {"F": source, "G": "0.1*sin(w*t)"}).run()
    tau = run.t / 0.1
    expected = truth(lambda t, i: FORCES[kind](t, i) + 0.1 * np.sin(2 * t), tau)
    np.testing.assert_allclose(run["ideal.x"], expected, atol=1e-8)
    assert run.manifest["masking_error"]["x"] <= 1e-6
    between = np.abs(tau % 0.5 - 0.25) < 0.2  # a jump lies on one side of a knot or the other
    force = [float(FORCES[kind](t, int(t / 0.5))) for t in tau[between]]
    np.testing.assert_allclose(run["virtual_input.F"][between], force, atol=1e-12)
    assert len(run.manifest["inputs"]["F"]["sha256"]) == 64


@pytest.mark.parametrize("kind", FORCES)
def test_a_sampled_controller_reads_the_same_file(folder, kind):
    source = {"file": str(folder / "force.csv"), "interpolation": kind}
    inputs = {"F": source, "G": 0.1}
    run = load(folder, inputs, rate="500 Hz", observer="disturbance").run()
    assert run.manifest["masking_error"]["x"] <= 0.005
    exact = load(folder, inputs, rate="500 Hz", observer="exact").run()
    assert exact.manifest["masking_error"]["x"] <= 0.05


def test_a_parquet_file_and_a_signal_are_the_same(folder):
    wave = {"amplitude": 0.2, "first": 0.05, "last": 0.2, "duration": 20, "rate": 20}
    linear_chirp(**wave).save(folder / "chirp.parquet")
    both = [
        load(folder, {"F": source | {"interpolation": "cubic"}, "G": 0}).run()
        for source in (
            {"file": str(folder / "chirp.parquet"), "column": "u"},
            {"signal": "linear_chirp", "arguments": wave},
        )
    ]
    np.testing.assert_allclose(both[0]["ideal.x"], both[1]["ideal.x"], atol=1e-12)
    sine = {"signal": "multisine", "arguments": {"frequencies": [0.1], "amplitudes": 0.2, "rate": 50, "duration": 21}}
    made = load(folder, {"F": sine | {"interpolation": "cubic"}, "G": 0}).run()
    expected = solve_ivp(
        lambda t, y: [y[1], -y[0] - 0.1 * y[1] + 0.2 * np.cos(0.2 * np.pi * t)],
        (0, 20), [0.5, 0.0], "DOP853", made.t / 0.1, rtol=1e-11, atol=1e-13,
    )  # fmt: skip
    np.testing.assert_allclose(made["ideal.x"], expected.y[0], atol=1e-6)


def test_expressions_have_the_unit_of_the_input_and_virtual_time():
    # light_cart is in SI units: 0.3 x'' = F - 40 x - 2 x', F in N and t in s.
    ideal = {"push": False, "guide_friction": False, "pivot_friction": False}
    run = (
        Experiment.load("cart_felt")
        .changed(inputs={"F": "0.5*sin(3*t)"}, controller={"rate": "continuous"}, effects=ideal, duration=5)
        .run()
    )
    made = solve_ivp(
        lambda t, y: [y[1], (0.5 * np.sin(3 * t) - 40 * y[0] - 2 * y[1]) / 0.3],
        (0, 5), [0.0, 0.0], "DOP853", run.t, rtol=1e-11, atol=1e-14,
    )  # fmt: skip
    np.testing.assert_allclose(run["virtual.x"], made.y[0], atol=1e-9)
    assert run.manifest["masking_error"]["x"] <= 1e-6


@pytest.mark.parametrize(
    ("name", "own", "against_the_hand"), [("cart_felt", 0.03, 0.03), ("cart_felt_observer", 0.05, 0.25)]
)
def test_a_masked_mass_feels_the_hand(name, own, against_the_hand):
    run = Experiment.load(name).run()
    hand = solve_ivp(
        lambda t, y: [y[1], (0.5 * np.sin(1.6 * np.pi * t) - 40 * y[0] - 2 * y[1]) / 0.3],
        (0, run.t[-1]), [0.0, 0.0], "DOP853", run.t, rtol=1e-9, atol=1e-12,
    ).y[0]  # fmt: skip
    assert np.abs(hand).max() > 0.01
    assert run.manifest["masking_error"]["x"] <= own
    assert np.linalg.norm(run["virtual.x"] - hand) <= against_the_hand * np.linalg.norm(hand)
    assert "pushes felt through F" in summary(run)


def test_a_push_that_is_not_felt_is_rejected():
    made = Experiment.load("cart_felt").changed(inputs={"F": 0}, controller={"rate": "500 Hz"}, duration=5)
    run = made.run()
    assert np.abs(run["virtual.x"]).max() < 1e-3
    assert "pushes rejected" in summary(run)


def test_what_a_run_alone_knows_is_left_out_of_the_check():
    assert "without F, which is known in a run only" in feasibility(Experiment.load("cart_felt")).notes


@pytest.mark.parametrize(
    ("inputs", "controller", "message"),
    [
        ({}, {}, "driven has inputs that are not given: F, G; say where each comes from"),
        ({"F": 1}, {}, "driven has inputs that are not given: G"),
        ({"F": 1, "G": 0, "H": 0}, {}, "'H' is not an input of driven"),
        ({"F": "x", "G": 0}, {}, "unknown symbol 'x'; allowed: t, w"),
        ({"F": {"file": "a.csv"}, "G": 0}, {}, "a file is known at points: it must say what it is between them"),
        ({"F": {"file": "a.csv", "sensor": "force"}, "G": 0}, {}, "one source, not from file and sensor"),
        ({"F": {"signal": "chirp", "interpolation": "cubic"}, "G": 0}, {}, "there is no signal 'chirp'"),
        ({"F": {"sensor": "force"}, "G": 0}, {}, "a sensor is known to a controller that reads sensors"),
        ({"F": {"sensor": "hand"}, "G": 0}, {"rate": "500 Hz"}, "'hand' is not a sensor of"),
        ({"F": {"push": "x"}, "G": 0}, {"rate": "500 Hz"}, "a push is rejected where external forces are not felt"),
        ({"F": {"push": "y"}, "G": 0}, {"rate": "500 Hz", "external": "felt"}, "'y' is not a coordinate of"),
        ({"F": 0, "G": 0}, {"rate": "500 Hz", "external": "felt"}, "no input of driven takes them"),
        (
            {"F": {"push": "x"}, "G": 0},
            {"rate": "500 Hz", "observer": "kalman", "external": "felt"},
            "'observer: disturb",
        ),
    ],
)
def test_what_is_wrong_with_inputs_is_told(folder, inputs, controller, message):
    with pytest.raises(DeclarationError) as error:
        load(folder, inputs, **controller)
    assert message in str(error.value)


def test_files_and_signals_that_cannot_be_read_are_told(folder):
    cubic = {"interpolation": "cubic"}
    wrong = {
        "no such record": {"file": "none.csv"},
        "no column 'Q'": {"file": str(folder / "force.csv"), "column": "Q"},
        "it needs amplitude, first": {"signal": "linear_chirp", "arguments": {"last": 1}},
        "'level' is none of its arguments": {"signal": "ramp", "arguments": {"level": 1}},
    }
    for message, source in wrong.items():
        with pytest.raises(DeclarationError) as error:
            load(folder, {"F": source | cubic, "G": 0}).validate()
        assert message in str(error.value)


@pytest.mark.skipif(GCC is None, reason="there is no gcc")
def test_exported_controllers_have_inputs_of_every_kind_at_once(tmp_path, folder):
    driven = DRIVEN.replace("G: another", "G: another, H: a third, E: a fourth").replace("+ F + G", "+ F + G + H + E")
    (tmp_path / "driven.yaml").write_text(driven)
    inputs = {
        "E": "0.1*sin(w*t)",
        "F": {"file": str(folder / "force.csv"), "interpolation": "cubic"},
        "G": {"sensor": "force", "factor": 0.5},
        "H": {"push": "x", "above": 0.5},
    }
    settings = {"rate": "500 Hz", "observer": "disturbance", "external": "felt", "homing": 0.4}
    made = Experiment.load("cart_alone").changed(
        virtual=str(tmp_path / "driven.yaml"), initial={"x": 0.5}, inputs=inputs, controller=settings,
        effects={"push": True},
    )  # fmt: skip
    unit, feed = sampled_unit(made.sampled, "controller", 0.02), made.sampled.feed
    compiled = CompiledUnit(tmp_path, unit)
    samples = made.sampled.before + 300
    _, ours, (commands,) = by_kernel(made, samples, others=[compiled], missed={150, samples - 100})
    assert np.max(np.abs(commands - ours)) <= EXACT * np.max(np.abs(ours))
    cells = [feed.series[0][0], feed.sensors[0].cell, feed.pushes[0].cell]
    assert np.all(compiled.memory("p")[cells] != 0.0)


def test_exports_of_laws_take_expressions_alone(tmp_path, folder):
    text = (folder / "driven.yaml").as_posix()
    (tmp_path / "run.yaml").write_text(
        f"name: run\nplant: cart_pendulum\nvirtual: {text}\ntime_scale: 0.1\nduration: 1\n"
        f"inputs: {{F: {{file: {folder / 'force.csv'}, interpolation: linear}}, G: 0}}\n"
    )
    with pytest.raises(
        DeclarationError, match=r"law of the states takes expressions, not a file; .* give the controller rate"
    ):
        masking.export(tmp_path / "run.yaml", to="c", out=tmp_path / "out")


def test_a_model_is_simulated_with_series(folder):
    model, times = masking.load_model(folder / "driven.yaml"), np.linspace(0.0, 20.0, 101)
    for kind, force in FORCES.items():
        found = model.simulate(times, inputs={"F": Series(KNOTS, VALUES, kind), "G": 0.2})
        np.testing.assert_allclose(found["x"], truth(lambda t, i, f=force: f(t, i) + 0.2, times), atol=1e-8)
    found = model.simulate(KNOTS, inputs={"F": VALUES, "G": 0.0})
    np.testing.assert_allclose(found["x"], truth(FORCES["linear"], KNOTS), atol=1e-8)
    with pytest.raises(ModelError, match="inputs that are not given: G; its inputs are F, G"):
        model.simulate(times, inputs={"F": 0.0})
    with pytest.raises(ModelError, match="has no input 'H'"):
        model.simulate(times, inputs={"F": 0.0, "G": 0.0, "H": 0.0})
    with pytest.raises(ModelError, match="give times that increase"):
        model.simulate(times[::-1], inputs={"F": Series(KNOTS, VALUES), "G": 0.0})


@pytest.mark.parametrize("kind", ["linear", "previous", "cubic"])
def test_a_series_is_what_scipy_makes_of_it(kind):
    spline = CubicSpline(KNOTS, VALUES)
    times = np.linspace(-1.0, 21.0, 333)
    inside = np.clip(times, 0.0, 20.0)
    expected = {
        "linear": np.interp(times, KNOTS, VALUES),
        "cubic": spline(inside),
        "previous": VALUES[np.searchsorted(KNOTS, inside, side="right") - 1],
    }[kind]
    np.testing.assert_allclose(Series(KNOTS, VALUES, kind).at(times), expected, atol=1e-12)


def test_series_that_are_none_are_refused():
    for times, values, kind, message in (
        ([0, 1], [0, 1], "cubic", "4 or more points"),
        ([0, 1], [0, 1], "spline", "give one of linear, previous, cubic"),
        ([0, 0], [0, 1], "linear", "times that increase"),
        ([0, 1], [0, np.nan], "linear", "finite values"),
        ([0, 1], [0], "linear", "a time and a value each"),
    ):
        with pytest.raises(ModelError, match=message):
            Series(times, values, kind)


def test_a_schedule_of_two_series_holds_the_pieces_of_both():
    first, second = Series([0, 1], [1, 2]), Series([0.5, 3], [5, 6], "previous")
    made, p = Schedule.of([(first, range(5)), (second, range(5, 10))]), np.zeros(10)
    made.set(0.7, p)
    np.testing.assert_allclose(p, [1, 1, 0, 0, 0, 5, 0, 0, 0, 0.5])
    assert made.spans(np.array([0.0, 0.4, 0.5, 2.0, 4.0])) == [(0, 2), (2, 3), (3, 4), (4, 5)]


def test_a_controller_in_ones_own_loop_reads_the_same_inputs(folder):
    source = {"file": str(folder / "force.csv"), "interpolation": "linear"}
    made = load(folder, {"F": source, "G": 0})
    law, state = made.controller(), np.array([0.002, 0.05, 0.01, -0.2])
    with_force, without = (law(t, state).copy() for t in (0.725, -1.0))
    expected = np.interp([7.25, 0.0], KNOTS, VALUES)
    run = load(folder, {"F": 0.1, "G": 0}).controller()
    zero = load(folder, {"F": 0.0, "G": 0}).controller()
    per_force = (run(0.0, state).copy() - zero(0.0, state)) / 0.1
    np.testing.assert_allclose(with_force - without, per_force * (expected[0] - expected[1]), rtol=1e-9)
