"""Directed places: forces that follow something else than the motion they act on; records by scipy's discretisation."""

import numpy as np
import pytest
from scipy import signal

import masking
from masking.inference.discovery.places import places
from masking.model.declaration import registry

RATE, SAMPLES, NOISE = 500.0, 6000, 1e-3
MODEL = """
name: two masses
coordinates: {x1: {unit: m}, x2: {unit: m}}
inputs: {f1: {unit: N}, f2: {unit: N}}
parameters:
  m1: {value: 1, unit: kg}
  m2: {value: 1.4, unit: kg}
  k1: {value: 401, unit: N/m}
  k2: {value: 299, unit: N/m}
  c1: {value: 1.2, unit: N*s/m}
  c2: {value: 0.9, unit: N*s/m}
equations:
  "m1*x1''": f1 - k1*x1 - c1*x1' - k2*(x1 - x2) - c2*(x1' - x2')
  "m2*x2''": f2 + k2*(x1 - x2) + c2*(x1' - x2')
elements:
  ground: {displacement: x1, unit: N, acts: {x1: -1}}
  link: {displacement: x1 - x2, unit: N, acts: {x1: -1, x2: 1}}
"""
MASS = np.diag([1.0, 1.4])
STIFFNESS, DAMPING = np.array([[700.0, -300.0], [-300.0, 300.0]]), np.array([[2.1, -0.9], [-0.9, 0.9]])
PUSH = np.eye(2)


def record(folder, stiffness=STIFFNESS, damping=DAMPING, push=PUSH):
    """Return model and record of two masses with given matrices."""
    inverse, nothing = np.linalg.inv(MASS), np.zeros((2, 2))
    a = np.block([[nothing, np.eye(2)], [-inverse @ stiffness, -inverse @ damping]])
    b = np.vstack([nothing, inverse @ push])
    step, drive, *_ = signal.cont2discrete((a, b, np.eye(4), np.zeros((4, 2))), 1.0 / RATE)
    generator, t = np.random.default_rng(5), np.arange(SAMPLES) / RATE
    lines = generator.uniform([[0.3], [0.0]], [[8.0], [6.0]], (2, 2, 24))
    force = np.sin(2.0 * np.pi * lines[:, 0, :, None] * t + lines[:, 1, :, None]).sum(axis=1).T
    state, motion = np.zeros(4), np.empty((SAMPLES, 2))
    for i, u in enumerate(force):
        motion[i] = state[:2]
        state = step @ state + drive @ u
    motion += NOISE * motion.std(axis=0) * generator.standard_normal(motion.shape)
    np.savez(folder / "record.npz", t=t, f1=force[:, 0], f2=force[:, 1], x1=motion[:, 0], x2=motion[:, 1])
    (folder / "model.yaml").write_text(MODEL)
    return folder / "model.yaml", folder / "record.npz"


def test_directed_places_follow_what_the_model_does_not_let_act(tmp_path):
    (tmp_path / "model.yaml").write_text(MODEL)
    model = registry.load_model(tmp_path / "model.yaml")
    found = {place.name: place for place in places(model, directed=True) if place.directed}
    assert [*found] == [
        *("x2 on x1", "f2 on x1", "f1 at x1", "x1 under x1", "x1 under f1", "x1 under f2"),
        *("x1 on x2", "f1 on x2", "f2 at x2", "x2 under x2", "x2 under f1", "x2 under f2"),
    ]
    effects = masking.model.effects.EFFECTS
    taken = {name: [n for n, e in effects.items() if e.where == "element" and p.takes(e)] for name, p in found.items()}
    assert taken["x2 on x1"] == ["cross_stiffness", "cross_damping"]
    assert taken["f1 on x2"] == ["actuator_reaction"]
    assert taken["f1 at x1"] == ["position_gain"]
    assert taken["x2 under f1"] == ["load_friction"]
    assert not any(place.directed for place in places(model))


GYROSCOPE = np.array([[0.0, 0.8], [-0.8, 0.0]])


@pytest.mark.search
@pytest.mark.parametrize(
    ("changed", "truth"),
    [
        ({"stiffness": STIFFNESS + np.array([[0, 40.0], [0, 0]])}, {("cross_stiffness", "x2 on x1"): 40.0}),
        (
            {"damping": DAMPING + GYROSCOPE},
            {("cross_damping", "x2 on x1"): 0.8, ("cross_damping", "x1 on x2"): -0.8},
        ),
        ({"push": PUSH - np.array([[0, 0], [0.15, 0]])}, {("actuator_reaction", "f1 on x2"): 0.15}),
    ],
    ids=["cross-coupled stiffness", "gyroscopic", "reaction"],
)
def test_a_directed_force_is_found_where_the_others_leave_more_than_noise(tmp_path, changed, truth):
    model, file = record(tmp_path, **changed)
    found = masking.discover(file, model=model, out=tmp_path / "found")
    assert found.closed
    assert {(cause.name, cause.on) for cause in found.effects} == {*truth}
    for cause in found.effects:
        ((value, deviation),) = cause.parameters.values()
        assert abs(value - truth[cause.name, cause.on]) < 4.0 * deviation
    # What is written has the same commands, and their hold.
    again = masking.simulate(tmp_path / "found" / "plant.yaml", file)
    assert all(error < 1.1 * again.floor[name] for name, error in again.chi.items())


GUIDED = """
name: a mass in a guide
coordinates: {x: {unit: m}}
inputs: {u: {unit: N}}
parameters:
  m: {value: 1.2, unit: kg}
  k: {value: 240, unit: N/m}
  c: {value: 2, unit: N*s/m}
equations: {"m*x''": u - k*x - c*x'}
"""
MU, PARTS, SHORT = 0.15, 20, 2500


@pytest.mark.search
def test_friction_under_the_force_of_an_actuator_is_named_with_its_coefficient(tmp_path):
    """By the time stepping of Moreau: in each small step friction takes what stops the mass, up to mu times load."""
    generator, t, h = np.random.default_rng(7), np.arange(SAMPLES) / RATE, 1.0 / RATE / PARTS
    at, phases = generator.uniform([[0.3], [0.0]], [[5.0], [6.0]], (2, 16))
    force = 6.0 * np.sin(2.0 * np.pi * at[:, None] * t + phases[:, None]).sum(axis=0)
    x, v, read = 0.0, 0.0, np.empty(SAMPLES)
    for i, u in enumerate(force):
        read[i] = x
        for _ in range(PARTS):
            free = v + h * (u - 240.0 * x - 2.0 * v) / 1.2
            most = h * MU * abs(u) / 1.2
            v = free - min(max(free, -most), most)
            x += h * v
    read += NOISE * read.std() * generator.standard_normal(SAMPLES)
    np.savez(tmp_path / "record.npz", t=t[:SHORT], u=force[:SHORT], x=read[:SHORT])
    (tmp_path / "model.yaml").write_text(GUIDED)
    found = masking.discover(tmp_path / "record.npz", model=tmp_path / "model.yaml")
    (cause,) = found.effects
    assert (found.verdict, cause.name, cause.on) == ("named", "load_friction", "x under u")
    assert cause.parameters["mu"][0] == pytest.approx(MU, rel=0.05)
