"""The parts of discovery: simulation with effects at places, the smoother, screening, and what parameters pay."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize, signal

from masking.app.workflows import discovery_inputs
from masking.control.rig.twin import Twin
from masking.errors import DeclarationError
from masking.inference.discovery import discrepancy, fitting, shooting_intervals, validation_simulation
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.inference.discovery.candidates import candidates, spans
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.explanation import Explanation, are_composite, occam
from masking.inference.discovery.other_laws import simpler_explanations
from masking.inference.discovery.parameter_prior import prior_of
from masking.inference.discovery.places import opened, places
from masking.inference.discovery.screening import Screen
from masking.inference.discovery.search_state import Ground
from masking.inference.discovery.smoothing import smooth
from masking.inference.estimation.identification_data import Data
from masking.lab.records.noise_estimate import rounding_steps
from masking.model.declaration import catalogue, registry
from masking.model.declaration.dimensions import is_plain
from masking.model.declaration.expression import Expression
from masking.model.declaration.model_checks import beyond_ordinary
from masking.model.declaration.schema import Element
from masking.model.effects import attach
from masking.model.modelling.model import Model, load_model
from tests.app.workflows.test_discover import PLANT

RATE, SECONDS, NOISE = 1000.0, 12.0, 1e-3
INSTANCES = {
    "dry friction": EffectInstance("dry_friction", "spring1", (0.05, 1e-3), (0,)),
    "hysteresis": EffectInstance("hysteresis", "beam", (10.0, 1e-3, 0.5, 2.0), (0, 1)),
    "a stop": EffectInstance("stop", "spring2", (50.0, 1e-3, 0.0, 1.0), (0, 1)),
    "a spring between oscillators": EffectInstance("linear_spring", "x1-x2", (5.0,), (0,)),
    "an added mass": EffectInstance("added_mass", "x1", (0.05,), (0,)),
    "an inertia between oscillator and beam": EffectInstance("added_mass", "spring2", (0.3,), (0,)),
    "a lag of a sensor": EffectInstance("sensor_lag", "s2", (0.004,), (0,)),
    "a bent sensor": EffectInstance("sensor_cubic", "s1", (0.1,), (0,)),
    "a lag of an actuator": EffectInstance("actuator_lag", "V3", (0.01,), (0,)),
    "a late actuator": EffectInstance("delay", "V1", (0.0021,), (0,)),
}


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    path = tmp_path_factory.mktemp("plant") / "plant.yaml"
    path.write_text(PLANT)
    return Twin.load(path)


@pytest.fixture(scope="module")
def rig(twin):
    return AugmentedModel(twin, twin.equation_parameters())


@pytest.fixture(scope="module")
def commands():
    rng, t = np.random.default_rng(3), np.arange(round(SECONDS * RATE)) / RATE
    lines = np.arange(1, 40)
    columns = [
        sum(
            np.sin(2.0 * np.pi * line / SECONDS * t + phase)
            for line, phase in zip(own, rng.uniform(0, 6.3, len(own)), strict=True)
        )
        for own in (lines[0::3], lines[1::3], lines[2::3])
    ]
    return np.ascontiguousarray(0.02 * np.array(columns).T)


@pytest.fixture(scope="module")
def problem(twin, rig, commands):
    record = Data("a record", RATE, commands, np.zeros((len(commands), 3)))
    return EstimationProblem(rig, record, prior_of(twin, rig, 0.01), np.full(3, NOISE), 2)


def equations(problem, instances=(), added=None, theta=None):
    rig = problem.rig
    values = np.array([s.values[i] for s in instances for i in s.free]) if added is None else added
    return problem.equations(rig.start if theta is None else theta, np.zeros((1, 6)), instances, values)


@pytest.mark.parametrize("interval", [0, 3000])
def test_known_parameters_have_no_columns_and_change_nothing_else(problem, interval):
    cut, rig = replace(problem, interval=interval), problem.rig
    every = [*INSTANCES.values()]
    start, added = np.zeros((cut.intervals, 6)), fitting.estimated(every)
    free, fixed = (cut.equations(rig.start, start, every, added, frozen=frozen) for frozen in (False, True))
    states = len(rig.start) + len(added)
    np.testing.assert_array_equal(fixed.matrix[states:, states:], free.matrix[states:, states:])
    np.testing.assert_array_equal(fixed.gradient[states:], free.gradient[states:])
    np.testing.assert_array_equal(fixed.simulated, free.simulated)
    assert not fixed.matrix[:states].any()
    assert not fixed.gradient[:states].any()
    assert np.abs(free.matrix[:states, :states]).any()


def noisy(problem, instances, seed=0):
    """Return a problem whose record holds effects and noise."""
    told = equations(replace(problem, substeps=4), instances).simulated
    noise = NOISE * np.random.default_rng(seed).standard_normal(told.shape)
    return replace(problem, record=replace(problem.record, readings=told + noise))


def exact(problem, commands, rate):
    """Return the readings of the linear rig (4.1)-(4.3) at a rate, exactly discretised with commands held."""
    p = dict(zip(problem.rig.names, problem.rig.start, strict=True))
    k = np.array([p["w1"] ** 2, p["w2"] ** 2, p["w3"] ** 2])
    c = np.array([2 * p["z1"] * p["w1"], 2 * p["z2"] * p["w2"], 2 * p["z3"] * p["w3"]])
    relative = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, -1.0], [0.0, 0.0, 1.0]])
    acts = np.array([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [p["mu1"], p["mu2"], -1.0]])
    a = np.block([[np.zeros((3, 3)), np.eye(3)], [acts @ np.diag(k) @ relative, acts @ np.diag(c) @ relative]])
    gains = -acts @ np.diag([p["c1"], p["c2"], p["c3"]])  # the actuators push where the springs pull
    system = (
        a,
        np.vstack([np.zeros((3, 3)), gains]),
        np.hstack([200.0 * relative, np.zeros((3, 3))]),
        np.zeros((3, 3)),
    )
    return signal.dlsim((*signal.cont2discrete(system, 1.0 / rate)[:4], 1.0 / rate), commands)[1]


def test_without_effects_it_is_the_linear_rig(problem):
    truth = exact(problem, problem.record.commands, RATE)
    assert np.abs(equations(problem).simulated - truth).max() < 1e-7 * np.abs(truth).max()


@pytest.mark.parametrize("quarters", [5, 8, 10])
def test_held_commands_of_a_late_actuator_change_within_samples(problem, quarters):
    commands = np.repeat(problem.record.commands, 4, axis=0)
    commands[:, 0] = np.append(np.full(quarters, commands[0, 0]), commands[:-quarters, 0])
    truth = exact(problem, commands, 4.0 * RATE)[::4]
    late = EffectInstance("delay", "V1", (quarters / 4.0 / RATE,), (0,))
    for substeps, error in ((4, 1e-7), (1, 1e-5)):
        found = equations(replace(problem, substeps=substeps), (late,)).simulated
        assert np.abs(found - truth).max() < error * np.abs(truth).max()


@pytest.mark.parametrize("name", INSTANCES)
def test_derivatives_are_those_of_differences(problem, name):
    instance, readings = INSTANCES[name], equations(problem).simulated
    problem = replace(problem, record=replace(problem.record, readings=readings))
    found = equations(problem, (instance,))
    values = np.array([instance.values[i] for i in instance.free])
    k, size = len(problem.rig.names), found.squares.sum() / NOISE**2

    def cost(added, theta):
        left = readings - equations(problem, (instance,), added, theta).simulated
        return 0.5 * float((left**2).sum()) / NOISE**2

    for i, value in enumerate(values):
        ahead, behind = values.copy(), values.copy()
        ahead[i] += 1e-4 * value
        behind[i] -= 1e-4 * value
        slope = (cost(ahead, None) - cost(behind, None)) / (2e-4 * value)
        scale = np.sqrt(found.matrix[k + i, k + i] * size)
        assert -found.gradient[k + i] == pytest.approx(slope, abs=2e-3 * scale)
    for i in (0, 7):
        theta = problem.rig.start
        step = 1e-5 * theta[i] * (np.arange(k) == i)
        slope = (cost(values, theta + step) - cost(values, theta - step)) / (2e-5 * theta[i])
        scale = np.sqrt(found.matrix[i, i] * size)
        assert -found.gradient[i] == pytest.approx(slope, abs=1e-4 * scale)


def test_two_coordinates_push_each_other_by_their_masses():
    # momentum: what x1 gets times its mass is what x2 gets times its own; mu1 and mu2 are masses per that of the beam
    model = load_model("setup")
    found = {place.name: place for place in places(model.declaration)}
    assert list(found) == ["spring1", "spring2", "beam", "x1", "x2", "x1-x2"]
    values = {name: model.value(name) for name in ("mu1", "mu2")}
    acts = {name: factor.evaluate(values) for name, factor in found["x1-x2"].element.acts.items()}
    assert values["mu1"] * acts["x1"] + values["mu2"] * acts["x2"] == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("name", [n for n in catalogue.names("model") if not beyond_ordinary(registry.load_model(n))])
def test_every_packaged_model_has_a_place_at_each_coordinate(name):
    # pushed by 1 in the unit of its place, each coordinate gets what its equation divides by
    twin = discovery_inputs.rig(name, None)
    rig = AugmentedModel(twin, twin.equation_parameters())
    assert rig.start.shape == (len(rig.names),)
    of_coordinates = rig.degree_places[: len(rig.coordinates)]
    assert len(of_coordinates) == len(rig.coordinates)
    units = UNITS.get(name, dict.fromkeys(rig.coordinates, "1" if is_plain(twin.base) else "m/s**2"))
    assert {rig.places[i].coordinate: rig.places[i].element.unit for i in of_coordinates} == units


UNITS = {
    "building": {"x1": "N"},
    "cart": {"x": "N"},
    "cart_by_voltage": {"x": "N"},
    "cart_pendulum": {"x": "N", "th": "N*m"},
    "light_cart": {"x": "N"},
    "magnet": {"x": "N"},
    "pendula": {"th1": "N*m", "th2": "N*m", "x": "N"},
    "setup_lagrangian": {"x1": "N", "x2": "N", "x3": "N"},
    "storey": {"x1": "N"},
}


def test_a_place_acts_in_an_equation_with_a_factor():
    twin = discovery_inputs.rig("duffing_enoc", None)
    model = opened(twin.base)[0]
    pushed = Model(attach(model, "constant_force", "x3_place", "f", {"f0": 1.0}))
    out, rest, values = np.empty(3), np.zeros(3), pushed.values()
    pushed.kernels.accelerations(0.0, rest, rest, np.zeros(0), values, out)
    np.testing.assert_allclose(out, [0.0, 0.0, -1.0 / 0.8])


def test_a_coordinate_without_an_equation_of_its_own_is_refused(tmp_path):
    (tmp_path / "both.yaml").write_text(
        "name: both\ncoordinates: {x: '', y: ''}\nequations: {x'' + y'': -x, y'': -y}\n"
    )
    twin = discovery_inputs.rig(tmp_path / "both.yaml", None)
    with pytest.raises(DeclarationError, match="no equation has x'' and no other acceleration on its left side"):
        places(twin.base)


def test_the_smoother_finds_a_force_and_how_well_it_is_known(problem):
    hidden = EffectInstance("periodic_force", "beam", (0.05, 0.02, 0.7), (0, 1, 2))
    record = noisy(problem, (hidden,))
    motion = smooth(record, problem.rig.start, np.zeros((1, 6)))
    t = np.arange(len(motion.forces)) / RATE
    true = 0.05 * np.sin(2 * np.pi * 0.7 * t) + 0.02 * np.cos(2 * np.pi * 0.7 * t)
    middle = slice(2000, -2000)
    off = (motion.forces[:, 2] - true)[middle]
    assert np.abs(off).mean() < 0.1 * np.abs(true).mean()
    assert np.sqrt((off**2).mean()) < 1.5 * motion.deviation[2]
    assert np.abs(motion.forces[middle, 0]).mean() < 3.0 * motion.deviation[0]


VELOCITY = """name: oscillator
coordinates: {x: ''}
parameters: {w2: 400.0, c: 0.4}
equations: {"x''": -w2*x - c*x'}
"""


def test_the_smoother_finds_a_force_from_velocities(tmp_path):
    """Readings are the closed form of an oscillator that a slow force moves from rest."""
    (tmp_path / "model.yaml").write_text(VELOCITY)
    (tmp_path / "plant.yaml").write_text('name: rig\nmodel: model.yaml\nsensors: {s: {measures: "x\'"}}\n')
    twin = Twin.load(tmp_path / "plant.yaml")
    rig, t = AugmentedModel(twin, twin.equation_parameters()), np.arange(6000) / 500.0
    pushed = 2.0 * np.sin(3.0 * t)
    _, _, states = signal.lsim(([[0.0, 1.0], [-400.0, -0.4]], [[0.0], [1.0]], np.eye(2), np.zeros((2, 1))), pushed, t)
    noise = 1e-5
    readings = states[:, 1:] + noise * np.random.default_rng(2).standard_normal((len(t), 1))
    record = Data("velocities", 500.0, np.zeros((len(t), 0)), readings)
    problem = EstimationProblem(rig, record, prior_of(twin, rig, 0.01), np.array([noise]), 2)
    motion = smooth(problem, rig.start, np.zeros((1, 2)))
    middle = slice(500, -500)
    assert np.isfinite(motion.deviation).all()
    off = (motion.forces[:, 0] + pushed)[middle]  # a force at a place acts on its coordinate with -1
    assert np.sqrt((off**2).mean()) < 0.1 * pushed.std()


def test_shooting_intervals_are_no_shorter_than_what_an_initial_state_may_take(problem):
    """A rig that does not settle within a short record: its twentieth parts would follow any motion."""
    fewest, rules = problem.rules.fewest_samples, replace(problem.rules, settling_rates=1e9)
    for count, samples in ((fewest // 2, 0), (5 * fewest, fewest), (40 * fewest, 2 * fewest)):
        short = replace(problem, record=problem.record.part(0, count), rules=rules)
        assert shooting_intervals.interval(short, None) == pytest.approx(samples, abs=0.1 * fewest)


def test_a_lag_is_judged_by_a_record_that_begins_in_motion(problem):
    lag = INSTANCES["a lag of a sensor"]
    whole = noisy(problem, (lag,))
    begin = 4000 + int(np.argmax(np.abs(whole.record.readings[4000:5000, 1])))
    own = whole.record.readings[begin:], whole.record.commands[begin:]
    assert abs(own[0][0, 1]) > 10.0 * NOISE
    part = replace(whole, record=replace(whole.record, readings=own[0], commands=own[1]))
    left = validation_simulation.validated(part, replace(fitting.fit(whole, (lag,)), start=np.zeros((1, 6)))).residuals
    assert (np.abs(left[:5, 1]) < 5.0 * NOISE).all()


def test_screening_tells_what_a_fit_would_take_off(problem):
    hidden = INSTANCES["dry friction"]
    record = noisy(problem, (hidden,))
    base = fitting.fit(record)
    worth = discrepancy.weights(base.misfits, base.independent)[0]
    record = replace(record, sigma=record.sigma / np.sqrt(worth))  # as the fit weighs what it leaves
    motion = smooth(record, base.theta, base.start)
    every = [c for c in candidates(record.rig, spans(record, motion), record.dt) if c.at in ("spring1", "s1")]
    best = Screen(record, base, motion).scores(every)
    friction = next(score for score in best if score.candidate.key == ("dry_friction", "spring1"))
    fitted = fitting.fit(noisy(problem, (hidden,)), (friction.instance,), theta=base.theta, start=base.start)
    less = float(worth @ (base.misfits - fitted.misfits)[0]) + base.pull - fitted.pull
    assert friction.gain == pytest.approx(less, rel=0.02)
    assert friction.instance.values[0] == pytest.approx(0.05, rel=0.01)
    assert fitted.added[0] == pytest.approx(0.05, abs=4.0 * fitted.deviations[-1])


def test_a_parameter_that_the_record_does_not_tell_pays_nothing(problem):
    # friction without a dip: the rate at which it would have fallen is not told
    record = noisy(problem, (INSTANCES["dry friction"],))
    plain = fitting.fit(record, (INSTANCES["dry friction"],))
    dip = EffectInstance("stribeck_friction", "spring1", (0.05, 0.05, 0.01, 1e-3), (0, 2))
    assert occam(fitting.fit(record, (dip,))) == pytest.approx(occam(plain), abs=1.5)


def test_readings_on_a_lattice_are_rounded():
    rng = np.random.default_rng(0)
    free = rng.standard_normal((5000, 2))
    readings = np.column_stack([0.02 * np.round(free[:, 0] / 0.02), free[:, 1]])
    assert rounding_steps(readings) == pytest.approx([0.02, 0.0])


@pytest.mark.parametrize("rest", [1, 7, 500])
def test_first_states_of_windows_lie_on_the_readings_also_where_the_last_is_short(problem, rest):
    t = np.arange(1000 + rest) / RATE
    readings = np.add(np.outer(t, (1e-3, -2e-3, 3e-3)), (1e-3, 2e-3, 0.0))
    record = Data("a line", RATE, np.zeros_like(readings), readings)
    windows = replace(problem, record=record, interval=500)
    found = windows.first_states(problem.rig.start)
    offset, sensing = problem.rig.reading(problem.rig.start, np.zeros(6))
    assert found.shape == (3, 6)
    np.testing.assert_allclose(offset + sensing @ found[2], readings[1000], atol=1e-12)
    np.testing.assert_allclose(sensing[:, :3] @ found[2, 3:], (1e-3, -2e-3, 3e-3), atol=1e-10)


def test_two_records_together_tell_what_their_sum_of_squares_tells(rig, problem, commands):
    """By scipy's least squares on the residuals of both, simulated by the rig alone."""
    instance = EffectInstance("hardening_spring", "spring1", (3e4,), (0,))
    records = []
    for seed, more in ((1, 1.0), (2, 0.7)):
        record = noisy(replace(problem, record=replace(problem.record, commands=more * commands)), (instance,), seed)
        records.append(record)
    first, second = records
    start = instance.with_values((0,), (2e4,))
    alone = fitting.fit(first, (start,))
    both = fitting.together(first, second, alone, validation_simulation.validated(second, alone).start)
    k = len(rig.start)

    def residuals(x):
        theta, k3, states = x[:k] * rig.start, x[k] * 3e4, x[k + 1 :].reshape(2, 1, 6) * 1e-4
        parts = [(theta - first.prior.mean) / first.prior.deviation]
        for one, state in zip(records, states, strict=True):
            simulated = one.equations(theta, state, (start,), np.array([k3])).simulated
            parts.append(((one.record.readings - simulated) * np.sqrt(worth[len(parts) - 1]) / one.sigma).ravel())
        return np.concatenate(parts)

    begin, worth = (
        np.concatenate([both.theta / rig.start, both.added / 3e4, both.start.ravel() / 1e-4]),
        np.ones((2, 3)),
    )
    assert both.cost == pytest.approx((residuals(begin) ** 2).sum(), rel=1e-9)
    worth = discrepancy.weights(both.misfits, both.independent)
    found = optimize.least_squares(residuals, begin, x_scale="jac", max_nfev=3)
    assert 2.0 * found.cost == pytest.approx((residuals(begin) ** 2).sum(), abs=0.1)
    deviation = 3e4 * np.sqrt(np.linalg.inv(found.jac.T @ found.jac)[k, k])
    assert both.deviations[k] == pytest.approx(deviation, rel=1e-2)
    assert both.deviations[k] < 0.9 * alone.deviations[k]


@pytest.mark.parametrize(
    ("causes", "patched"),
    [
        ((("dry_friction", "spring1"), ("dry_friction", "spring2"), ("dry_friction", "beam")), False),
        ((("quadratic_damping", "spring2"), ("hardening_spring", "spring2")), False),
        ((("quadratic_damping", "spring2"), ("dry_friction", "spring2")), False),
        ((("asymmetric_friction", "spring2"), ("dry_friction", "spring2")), True),
        ((("local_friction", "spring2"), ("local_friction", "x2")), True),  # x2 is of spring2 alone
        ((("dry_friction", "spring2"), ("dry_friction", "x1")), False),
        ((("linear_spring", "x2"), ("viscous_damping", "x2"), ("delay", "V2")), True),  # any linear system
        ((("gravity_force", "x1"), ("linear_spring", "x2"), ("viscous_damping", "x2"), ("delay", "V2")), True),
        ((("gravity_force", "x1"), ("viscous_damping", "x2"), ("delay", "V2")), False),
    ],
)
def test_laws_of_one_kind_at_one_place_are_a_patchwork(rig, causes, patched):
    assert are_composite(causes, rig) is patched


def test_further_places_of_a_law_take_no_place_of_a_coordinate(tmp_path):
    """A law at a coordinate may follow another one, as its displacement or its rate."""
    (tmp_path / "model.yaml").write_text(
        "name: pair\ncoordinates: {x1: {unit: m}, x2: {unit: m}}\nparameters: {k: {value: 9, unit: 1/s**2}}\n"
        "equations: {x1'': -k*x1, x2'': -k*x2}\n"
    )
    base = registry.load_model(tmp_path / "model.yaml")
    own = Element(displacement=Expression("x2"), rate=Expression("x1/2"), acts={"x2": Expression("-1")})
    other = Element(displacement=Expression("x1"), acts={"x2": Expression("-1")})
    further = base.model_copy(update={"elements": {**base.elements, "own": own, "other": other}})
    known = {place.name: place.coordinate for place in places(further)}
    assert {**known, "x1": "x1", "x2": "x2"} == known
    assert (known["own"], known["other"]) == (None, None)


def test_a_simpler_law_takes_the_place_of_one_that_is_no_better(problem):
    """Friction with two levels that are equal is dry friction, although a fit of that had ended elsewhere."""
    hidden = INSTANCES["dry friction"], INSTANCES["a stop"]
    record = noisy(problem, hidden)
    base = Explanation("none", (), fitting.fit(record))
    motion = smooth(record, base.hypothesis.theta, base.hypothesis.start)
    every = [
        one for one in candidates(record.rig, spans(record, motion), record.dt) if one.at in {"spring1", "spring2"}
    ]
    two = EffectInstance("asymmetric_friction", "spring1", (0.05, 0.05, 1e-3), (0, 1))
    two = two.at_step(record.rig.mobilities["spring1"], record.dt / record.substeps)
    names = ("asymmetric_friction", "spring1"), ("stop", "spring2")
    richer = Explanation("effects", names, fitting.fit(record, (two, hidden[1])))
    ground = Ground(record, base, motion, every)
    found = ground.ranked([richer, *simpler_explanations(ground, richer, [base, richer])])[0]
    assert {*found.names} == {("dry_friction", "spring1"), ("stop", "spring2")}
    values = dict(zip(found.names, found.hypothesis.instances, strict=True))
    assert values["dry_friction", "spring1"].estimated[0] == pytest.approx(0.05, rel=0.01)
