"""Coordinates that no virtual one stands for stay as the rig has them: against the motion typed out for scipy."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from masking.app.workflows.show import show
from masking.control.zero_dynamics import ZeroDynamics
from masking.errors import ActuationError, DeclarationError, MaskingError, ModelError
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.feasibility import feasibility
from masking.reports.run_report import report
from masking.reports.run_report import summary as summary_of

PLANTS = Path(__file__).parents[3] / "plants"
M2, L, G, D, STROKE, SCALE = 0.1, 0.2, 9.81, 0.001, 0.005, 0.1  # of cart_pendulum, and s per unit of virtual time
IDEAL = {"guide_friction": False, "pivot_friction": False, "weak_coil": False}


@pytest.fixture(scope="module")
def alone():
    return Experiment.load("cart_alone")


@pytest.fixture(scope="module")
def run(alone):
    return alone.run()


@pytest.fixture(scope="module")
def swing(run):
    """Cart as a Van der Pol oscillator, and the pendulum that its acceleration drives: x, x', th, th' (4, m)."""

    def slope(t, y):
        x, v, th, w = y
        a = (1 - x * x) * v - x
        pull = STROKE / SCALE**2 * a
        return [v / SCALE, a / SCALE, w, (-G * np.sin(th) - pull * np.cos(th) - D / (M2 * L) * w) / L]

    start, times = [0.5, 0.0, 0.1, 0.0], run.t
    return solve_ivp(slope, (0.0, times[-1]), start, "DOP853", times, rtol=1e-12, atol=1e-14).y


def test_cart_moves_as_its_virtual_system_and_the_pendulum_as_the_cart_drives_it(run, swing):
    assert run.manifest["masking_error"]["x"] <= 1e-6
    np.testing.assert_allclose(run["virtual.x"], swing[0], atol=1e-8)
    np.testing.assert_allclose(run["rig.th"], swing[2], atol=1e-9)
    np.testing.assert_allclose(run["rig.th'"], swing[3], atol=1e-8)


def test_energy_that_the_pendulum_took(run, swing):
    _, v, th, w = swing
    taken = M2 * L * STROKE / SCALE * v * w * np.cos(th) + M2 * L**2 * w**2 / 2 + M2 * G * L * (1 - np.cos(th))
    found = run.manifest["passive"]["energy"]
    assert found["unit"] == "J"
    expected = [taken[0], taken[-1], taken.max()]
    np.testing.assert_allclose([found["start"], found["end"], found["peak"]], expected, rtol=1e-6)


def test_zero_dynamics_of_a_hanging_pendulum(alone):
    frequency = np.sqrt(G / L)
    damping = D / (M2 * L**2) / (2 * frequency)
    found = alone.passive.zero_dynamics
    expected = frequency * (-damping + 1j * np.sqrt(1 - damping**2))
    np.testing.assert_allclose(found.slowest, expected, rtol=1e-6)
    assert found.verdict == "stable"
    assert str(found) == "th passive, zero dynamics stable at rest: 7.004 rad/s, damping ratio 0.0178"


def _plant(tmp_path, text=lambda x: x, **parameters):
    rig = text((PLANTS / "cart_pendulum.yaml").read_text())
    if parameters:
        rig = rig.replace("sensors:", f"parameters: {json.dumps(parameters)}\nsensors:")
    (tmp_path / "rig.yaml").write_text(rig)
    return str(tmp_path / "rig.yaml")


@pytest.mark.parametrize(
    ("parameters", "verdict", "eigenvalue"),
    [({"g": -9.81, "d": 0.0}, "unstable", np.sqrt(G / L)), ({"d": 0.0}, "marginal", 1j * np.sqrt(G / L))],
)
def test_zero_dynamics_of_other_pendula(tmp_path, alone, parameters, verdict, eigenvalue):
    found = Experiment.load("cart_alone", plant=_plant(tmp_path, **parameters)).passive.zero_dynamics
    assert found.verdict == verdict
    np.testing.assert_allclose(found.slowest, eigenvalue, rtol=1e-6, atol=1e-6)


def test_an_unstable_pendulum_is_told(tmp_path):
    experiment = Experiment.load("cart_alone", plant=_plant(tmp_path, g=-9.81)).changed(duration=1)
    made = experiment.run()
    assert made.manifest["passive"]["verdict"] == "unstable"
    assert "Not for long: th passive, zero dynamics unstable at rest: grows like exp(" in summary_of(made)


def test_real_eigenvalues_in_words():
    found = ZeroDynamics(("z",), np.zeros(1), np.diag([-2.0, -0.5]))
    assert str(found) == "z passive, zero dynamics stable at rest: decays in 2 s"
    assert "neither returns nor grows" in ZeroDynamics(("z",), np.zeros(1), np.zeros((2, 2))).how


@pytest.mark.parametrize("turn", [np.zeros((2, 2)), np.array([[0.0, 3.0], [-3.0, 0.0]])])
def test_jordan_blocks_decide_whether_a_marginal_motion_grows(turn):
    """Two equal pairs side by side stay bounded; with one that drives the other, exp(A t) grows like t."""
    beside, driven = np.kron(np.eye(2), turn), np.kron(np.eye(2), turn) + np.kron(np.eye(2, k=1), np.eye(2))
    for matrix, verdict in ((beside, "marginal"), (driven, "unstable")):
        found = ZeroDynamics(("y", "z"), np.zeros(2), matrix)
        late, later = (np.linalg.norm(expm(matrix * t), 2) for t in (100.0, 200.0))
        assert found.verdict == verdict
        assert bool(later > 1.9 * late) == found.drifts == (verdict == "unstable")
    assert found.how == "drifts away in proportion to the time"


def two_carts(tmp_path, force, duration):
    """Experiment on two carts, of which the second is passive under a force."""
    (tmp_path / "carts.yaml").write_text(
        "name: carts\ncoordinates: {x: {unit: m, initial: 0}, z: {unit: m, initial: 0}}\ninputs: {F: {unit: N}}\n"
        "parameters: {m: {value: 1, unit: kg}, k: {value: 4, unit: N/m}}\n"
        f"equations: {{m*x'': F, m*z'': {force}}}\n"
    )
    (tmp_path / "rig.yaml").write_text(
        "name: rig\nmodel: carts.yaml\nsensors: {sx: {measures: x, unit: m}, sz: {measures: z, unit: m}}\n"
        "limits: {inputs: {F: {max: 100, unit: N}}}\n"
    )
    (tmp_path / "one.yaml").write_text("name: one\ncoordinates: {x: {initial: 0.1}}\nequations: {x'': -x}\n")
    (tmp_path / "e.yaml").write_text(
        f"name: e\nplant: rig.yaml\nvirtual: one.yaml\ncontroller: {{rate: continuous}}\nduration: {duration}\n"
    )
    return Experiment.load(tmp_path / "e.yaml")


def test_a_free_cart_drifts(tmp_path):
    """No spring holds the passive cart: nothing brings it back."""
    found = two_carts(tmp_path, "0*k*z", 10).passive.zero_dynamics
    assert str(found) == "z passive, zero dynamics unstable at rest: drifts away in proportion to the time"


def test_a_passive_cart_that_runs_away_is_named_as_the_cause(tmp_path):
    """z'' = 4 z: a growth by exp(2 t), which leaves the numbers by t = 355 whatever the decoupling matrix is."""
    with pytest.raises(DeclarationError, match=r"cannot be held .*grows like exp\(2 t\).* passive return to rest"):
        feasibility(two_carts(tmp_path, "k*(z - x)", 1000))


def test_sampled_on_the_imperfect_rig():
    made = Experiment.load("cart_alone_rig").run()
    assert made.manifest["masking_error"]["x"] <= 0.03
    assert np.abs(made["rig.th"]).max() > 0.1


def test_one_encoder_is_enough(tmp_path):
    rig = _plant(tmp_path, lambda text: "\n".join(line for line in text.splitlines() if "angle" not in line))
    made = Experiment.load("cart_alone_rig", plant=rig).run()
    assert made.manifest["masking_error"]["x"] <= 0.04
    assert made.manifest["observer"]["bandwidth"]["th"] == 0.0


def test_a_pendulum_that_no_sensor_tells_must_come_to_rest(tmp_path):
    rig = _plant(tmp_path, lambda text: "\n".join(line for line in text.splitlines() if "angle" not in line), d=0.0)
    with pytest.raises(ModelError, match="no sensor measures th, and in the model it does not come to rest"):
        Experiment.load("cart_alone_rig", plant=rig).validate()
    rig = _plant(tmp_path, lambda text: "\n".join(line for line in text.splitlines() if "angle" not in line))
    with pytest.raises(ModelError, match="differences need a sensor for every coordinate"):
        changed = Experiment.load("cart_alone_rig", plant=rig)
        changed.changed(controller={"rate": "500 Hz", "observer": "differences"}, plant=rig).validate()


def test_a_point_of_the_pendulum_is_masked(alone):
    # eta = x + 0.5 l sin(th): no rig coordinate by itself, the pendulum is passive beside it.
    point = alone.changed(transform={"expressions": {"x": "x + 20*sin(th)"}}, duration=20, initial={"x": 0.5})
    assert point.passive.names == ("th",)
    made = point.run()
    assert made.manifest["masking_error"]["x"] <= 1e-6
    np.testing.assert_allclose(made["virtual.x"], made["rig.x"] / STROKE + 20 * np.sin(made["rig.th"]), atol=1e-9)
    assert np.ptp(made["rig.th"]) > 0.01


def _virtual(tmp_path, coordinates, equations):
    text = f"name: wanted\ncoordinates: {json.dumps(coordinates)}\nequations: {json.dumps(equations)}\n"
    (tmp_path / "wanted.yaml").write_text(text)
    return str(tmp_path / "wanted.yaml")


def test_what_cannot_be_driven_is_named_and_may_be_passive(tmp_path, alone):
    entry = {"meaning": "m", "initial": 0}
    both = _virtual(tmp_path, {"x": entry, "th": entry}, {"x''": "-x", "th''": "-th"})
    with pytest.raises(ActuationError) as error:
        alone.changed(virtual=both, initial={"x": 0.5}).validate()
    assert error.value.coordinates == ("x", "th")
    assert "(u) cannot accelerate x, th independently of the other coordinates, 1 of 2 at most" in str(error.value)
    assert "leave th out of the virtual system: what it does not name is passive" in str(error.value)


def test_other_names_need_a_transform(tmp_path, alone):
    wanted = _virtual(tmp_path, {"z": {"meaning": "m", "initial": 1}}, {"z''": "-z"})
    with pytest.raises(DeclarationError, match="the identity takes rig coordinates by name, and the rig has x, th"):
        alone.changed(virtual=wanted, initial={})
    made = alone.changed(virtual=wanted, initial={}, transform={"matrix": [[1, 0]]}, duration=5).run()
    np.testing.assert_allclose(made["virtual.z"], np.cos(made.t / SCALE), atol=1e-7)


def test_more_actuators_than_coordinates_give_the_inputs_of_least_norm(tmp_path):
    entry = {"meaning": "m", "initial": 0.1}
    wanted = _virtual(tmp_path, {"x1": entry, "x2": entry}, {"x1''": "-x1", "x2''": "-2*x2"})
    experiment = Experiment.load("duffing").changed(virtual=wanted, initial={}, time_scale=0.1, duration=5)
    assert experiment.passive.names == ("x3",)
    q, v = np.array([0.001, -0.002, 0.0005]), np.array([0.01, 0.02, -0.03])
    blocks = experiment.loop.evaluate(0.0, q, v)
    model = experiment.plant

    def accelerations(u):
        out = np.empty(6)
        model.kernels.derivative(0.0, np.concatenate([q, v]), u, model.values(), out)
        return out[3:].copy()

    free = accelerations(np.zeros(3))
    driven = np.array([accelerations(u) - free for u in np.eye(3)]).T[:2]
    scaled = q[:2] / experiment.law.lengths[:2]
    wanted_rig = -np.array([1.0, 2.0]) * scaled * experiment.law.lengths[:2] / 0.1**2
    np.testing.assert_allclose(blocks.u, np.linalg.pinv(driven) @ (wanted_rig - free[:2]), rtol=1e-9)
    assert max(experiment.run().manifest["masking_error"].values()) <= 1e-6


def test_homing_cannot_bring_what_is_passive(alone):
    homed = {"rate": "500 Hz", "homing": 3}
    with pytest.raises(DeclarationError, match="th is passive: homing cannot bring it to a value"):
        alone.changed(controller=homed)
    with pytest.raises(MaskingError, match="a rig that is read by sensors starts at rest"):
        alone.changed(controller={"rate": "500 Hz"}, initial={"x": 0.5, "th'": 1.0}).validate()
    with pytest.raises(DeclarationError, match="nor a passive one of the rig"):
        alone.changed(initial={"phi": 1.0})


def test_a_sampled_run_begins_where_the_pendulum_is_told_to(alone):
    made = alone.changed(controller={"rate": "500 Hz"}, duration=5).run()
    assert abs(made["rig.th"][0] - 0.1) < 1e-3


def test_reports_descriptions_and_checks_tell(run, alone, tmp_path):
    text = summary_of(run)
    assert "passive    th up to 0.231 rad, energy up to 0.00522 J; zero dynamics stable" in text
    page = report(run, tmp_path).path.read_text()
    assert "Passive coordinates" in page
    assert "th passive, zero dynamics stable" in str(show("cart_alone"))
    assert show("cart_alone").content["passive"]["verdict"] == "stable"
    assert any("zero dynamics stable" in note for note in feasibility(alone).notes)
