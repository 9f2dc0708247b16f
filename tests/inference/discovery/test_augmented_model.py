"""An added mass: as a larger mass in other equations, solved exactly, and found in records made outside the package."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from masking.app.workflows import discovery_inputs
from masking.control.rig.twin import Twin
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.inference.discovery.candidates import Span, candidates
from masking.inference.discovery.discovery_stages import discover
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.parameter_prior import prior_of
from masking.inference.discovery.screening import Screen
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.simulation import simulate
from masking.reports import discovery_files, discovery_text
from tests.app.workflows.test_discover import BASE, NOISE, PLANT
from tests.benchmarks import hidden

RATE, SECONDS = 1000.0, 20.0
RELATIVE = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, -1.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    path = tmp_path_factory.mktemp("plant") / "plant.yaml"
    path.write_text(PLANT)
    return Twin.load(path)


@pytest.fixture(scope="module")
def rig(twin):
    return AugmentedModel(twin, twin.equation_parameters())


def setup(p, masses, springs=(0.0, 0.0)):
    """Return A, B, C, D of (4.1)-(4.3) with masses added to x1, x2 and x3, and inertias in the two springs."""
    acts = np.array([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [p["mu1"], p["mu2"], -1.0]])
    k = np.diag([p[f"w{i}"] ** 2 for i in (1, 2, 3)])
    c = np.diag([2.0 * p[f"z{i}"] * p[f"w{i}"] for i in (1, 2, 3)])
    gains = -acts @ np.diag([p["c1"], p["c2"], p["c3"]])  # the actuators push where the springs pull
    heavy = np.linalg.inv(np.eye(3) + np.diag(masses) - acts @ np.diag([*springs, 0.0]) @ RELATIVE)
    a = np.block([[np.zeros((3, 3)), np.eye(3)], [heavy @ acts @ k @ RELATIVE, heavy @ acts @ c @ RELATIVE]])
    b = np.vstack([np.zeros((3, 3)), heavy @ gains])
    return a, b, np.hstack([200.0 * RELATIVE, np.zeros((3, 3))]), np.zeros((3, 3))


def read(system, commands, rate=RATE):
    """Return what the sensors of a linear rig read, from rest, with commands held (m, sensors)."""
    exact = signal.cont2discrete(system, 1.0 / rate)
    return np.ascontiguousarray(signal.dlsim((*exact[:4], 1.0 / rate), commands)[1])


def excitation(seconds, channels, seed=3, rate=RATE):
    rng, t = np.random.default_rng(seed), np.arange(round(seconds * rate)) / rate
    lines = np.array_split(rng.permutation(np.arange(1, 60)), channels)
    columns = [np.sin(np.outer(2 * np.pi * t / 10.0, own) + rng.uniform(0, 6.3, len(own))).sum(1) for own in lines]
    return np.ascontiguousarray(0.02 * np.array(columns).T)


def evidence_of(rig, record):
    return EstimationProblem(rig, record, prior_of(rig.twin, rig, 0.01), np.full(record.readings.shape[1], NOISE), 2)


def test_several_at_once_are_a_mass_matrix(rig):
    # and what the kernel says of parameters while there are any is right, too
    commands = excitation(6.0, 3)
    p = dict(zip(rig.names, rig.start, strict=True))
    problem = evidence_of(rig, Data("a record", RATE, commands, np.zeros_like(commands)))
    places = (("x1", 0.05), ("spring1", 0.4), ("beam", -0.2), ("x2", 0.1), ("spring2", 0.7))
    instances = tuple(EffectInstance("added_mass", at, (m,), (0,)) for at, m in places)
    found = problem.equations(rig.start, np.zeros((1, 6)), instances, np.array([m for _, m in places]))
    exact = read(setup(p, (0.05, 0.1, -0.2), (0.4, 0.7)), commands)
    assert np.abs(found.simulated - exact).max() < 1e-7 * np.abs(exact).max()
    for i in range(len(places)):  # -J^T W r is the gradient of half the squares, r being minus what is read
        step = 1e-5 * (np.arange(len(places)) == i)
        costs = []
        for sign in (1.0, -1.0):
            (x1, s1, x3, x2, s2) = (m + sign * d for (_, m), d in zip(places, step, strict=True))
            costs.append(0.5 * float((read(setup(p, (x1, x2, x3), (s1, s2)), commands) ** 2).sum()) / NOISE**2)
        slope = (costs[0] - costs[1]) / 2e-5
        assert -found.gradient[len(rig.names) + i] == pytest.approx(slope, rel=1e-4)


def test_it_is_a_candidate_where_the_displacement_is_linear(rig):
    names = {"element": [p.name for p in rig.places], "sensor": rig.twin.sensors, "actuator": rig.twin.actuators}
    spans = {(where, name): Span(-1.0, 1.0, 1.0, 1.0) for where in names for name in names[where]}
    found = [c.at for c in candidates(rig, spans, 1.0 / RATE) if c.effect == "added_mass"]
    assert found == ["spring1", "spring2", "beam", "x1", "x2"]


@pytest.fixture(scope="module")
def hidden_records():
    """Return a record and one to judge by, of 4 % more mass of oscillator 1, and of a parameter that is off by 4 %."""
    mass = replace(BASE, effect="added_mass", at="x1", parameters={"m": 0.04})
    parameter = replace(BASE, effect="parameter", at="w1", parameters={"relative": 0.04}, family="parameter")
    made = hidden.generate([mass, parameter], SECONDS, 10.0)
    return [[Data("a record", RATE, one.commands, one.readings) for one in pair] for _, *pair in made]


@pytest.mark.search
def test_a_heavier_oscillator_is_named(twin, rig, hidden_records):
    # Every parameter is off by up to 1 %. w1, z1, mu1 and c1 together are the same as a mass: how well m is known
    # is how well these are, 1/sqrt(2 (1/2)^2 + 2) %
    found = discover(twin, *hidden_records[0], rig=rig)
    (effect,) = found.effects
    assert (found.verdict, effect.name, effect.on) == ("named", "added_mass", "x1")
    m, std = effect.parameters["m"]
    assert std == pytest.approx(0.01 / np.sqrt(2.5), rel=0.1)
    assert m == pytest.approx(0.04, abs=0.02)
    assert m == pytest.approx(0.04, abs=3.0 * std)
    assert discovery_text.sentence(found).startswith(f"An added mass of {m:.4f} ± {std:.4f} on x1 is missing.")


@pytest.mark.search
def test_a_wrong_parameter_is_no_mass(twin, rig, hidden_records):
    found = discover(twin, *hidden_records[1], rig=rig)
    (effect,) = found.effects
    assert (found.verdict, effect.name) == ("parameter", "w1")


@pytest.mark.search
def test_a_mass_beside_parameters_that_are_known(tmp_path, rig):
    # Oscillator 1 was measured to 1e-4; the others' parameters are off by up to 1 %. The files that are written
    # simulate what was read.
    known = {name: 1e-4 * value for name, value in zip(rig.names, rig.start, strict=True) if "1" in name}
    values = dict(zip(rig.names, rig.start, strict=True))
    stds = ", ".join(f"{name}: {{value: {values[name]}, std: {std:.4g}}}" for name, std in known.items())
    (tmp_path / "known.yaml").write_text(f"name: known\nextends: setup\nparameters: {{{stds}}}\n")
    (tmp_path / "plant.yaml").write_text(PLANT.replace("model: setup", "model: known.yaml"))
    twin = Twin.load(tmp_path / "plant.yaml")
    rng = np.random.default_rng(1)
    off = {name: rng.uniform(-1, 1) * (1e-4 if name in known else 1e-2) for name in rig.names}
    p = {name: value * (1.0 + off[name]) for name, value in values.items()}
    commands = excitation(10.0, 3)
    readings = read(setup(p, (0.04, 0.0, 0.0)), commands)
    readings += NOISE * rng.standard_normal(readings.shape)
    found = discover(twin, Data("a record", RATE, commands, readings))
    (effect,) = found.effects
    assert (found.verdict, effect.name, effect.on) == ("named", "added_mass", "x1")
    assert effect.parameters["m"][0] == pytest.approx(0.04, rel=0.02)
    files = discovery_files.save(found, tmp_path / "found", discovery_files.Origin({}), "", {})
    assert "added_mass_acc: x1''" in files.model.read_text()
    for sensor, chi in simulate(Twin.load(files.plant), found.validation_record).chi.items():
        assert chi < 1.1 * found.simulation_error.validation_noise_floor[sensor]


SLIDER = """
name: a slider whose mass grows with its displacement
coordinates: {x: {unit: m}}
inputs: {f: {unit: N}}
parameters:
  m: {value: 1, unit: kg}
  n: {value: 0.5, unit: kg/m**2}
  k: {value: 40, unit: N/m}
  c: {value: 1, unit: N*s/m}
equations: {"(m + n*x**2)*x''": f - k*x - c*x'}
"""


def slider(m, commands, rate, pieces=4):
    """Return x of the slider from rest (count, 1), by Runge and Kutta's method of order 4 in plain arithmetic."""
    h, x, v, read_x = 1.0 / rate / pieces, 0.0, 0.0, []

    def a(x, v, f):
        return (f - 40.0 * x - v) / (m + 0.5 * x * x)

    for f in commands[:, 0].tolist():
        read_x.append([x])
        for _ in range(pieces):
            a1 = a(x, v, f)
            v2 = v + h / 2 * a1
            a2 = a(x + h / 2 * v, v2, f)
            v3 = v + h / 2 * a2
            a3 = a(x + h / 2 * v2, v3, f)
            v4 = v + h * a3
            a4 = a(x + h * v3, v4, f)
            x, v = x + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return np.array(read_x)


@pytest.fixture(scope="module")
def single(tmp_path_factory):
    path = tmp_path_factory.mktemp("single") / "slider.yaml"
    path.write_text(SLIDER)
    return discovery_inputs.rig(path, None)


@pytest.fixture(scope="module")
def single_rig(single):
    return AugmentedModel(single, single.equation_parameters())


def test_it_is_the_parameter_of_a_single_mass(single_rig):
    # the same motion as with a larger m, and the same derivatives, while the inertia changes with the displacement
    rig, n = single_rig, 4
    commands = 100.0 * excitation(10.0, 1, rate=200.0)
    exact = slider(1.3, commands, 200.0)
    assert np.abs(exact).max() > 0.8  # 30 % more inertia than at rest, or so
    problem, start = evidence_of(rig, Data("a record", 200.0, commands, np.zeros_like(exact))), np.zeros((1, 2))
    larger = rig.start * np.where(np.array(rig.names) == "m", 1.3, 1.0)
    added = problem.equations(rig.start, start, (EffectInstance("added_mass", "x", (0.3,), (0,)),), np.array([0.3]))
    heavy = problem.equations(larger, start)
    for found in (added, heavy):
        np.testing.assert_allclose(found.simulated, exact, atol=1e-6)
    by, own = rig.names.index("m"), [*range(n), n + 1, n + 2]
    np.testing.assert_allclose(added.matrix[np.ix_(own, own)], heavy.matrix, rtol=1e-6)
    np.testing.assert_allclose(added.matrix[n, own], heavy.matrix[by], rtol=1e-6)
    np.testing.assert_allclose(added.gradient[[*own, n]], heavy.gradient[[*range(n + 2), by]], rtol=1e-6)


def test_the_parameter_of_a_single_mass_wins(single, single_rig):
    commands = 100.0 * excitation(20.0, 1, rate=200.0)
    readings = slider(1.3, commands, 200.0)
    readings += 1e-3 * np.random.default_rng(0).standard_normal(readings.shape)
    found = discover(single, Data("a record", 200.0, commands, readings), rig=single_rig)
    (effect,) = found.effects
    assert (found.verdict, effect.name) == ("parameter", "m")
    assert effect.parameters["m"][0] == pytest.approx(1.3, rel=1e-3)
    screen = Screen(found.problem, found.search.base.hypothesis, found.search.motion)
    assert screen.unique(EffectInstance("added_mass", "x", (0.3,), (0,))) < 0.01
