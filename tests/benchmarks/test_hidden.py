"""The generator of hidden effects: against exact solutions, power balance, order of convergence, sizes and seeds."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete

from tests.benchmarks import hidden
from tests.benchmarks.hidden.catalogue import CHI, EFFECTS
from tests.benchmarks.hidden.excitation import commands, training, validation
from tests.benchmarks.hidden.laws import ELEMENT_LAWS, Motion
from tests.benchmarks.hidden.rig import (
    LARGEST_COMMAND,
    PARAMETERS,
    PLACES,
    RATE,
    SENSOR_GAIN,
    STROKE,
    Rigs,
    declared,
    linear_response,
)
from tests.benchmarks.hidden.simulate import Batch, Hidden

SEED = [[3]]


def rigs(count, damping="own"):
    return Rigs(np.repeat(declared(damping)[None], count, axis=0))


def told(seconds, count=1, damping="own"):
    return np.repeat(commands(training, seconds, SEED, [damping]), count, axis=2)


def exact(u, damping="own", lag=None, sensor_lag=None):
    """Solve the linear rig by scipy, with a lag (s) of actuator 1 or of sensor 1 as one more state."""
    a, b = (x[0] for x in rigs(1, damping).linear())
    c = np.eye(3, 6)
    if lag:
        a = np.block([[a, b[:, :1]], [np.zeros((1, 6)), -np.eye(1) / lag]])
        b = np.vstack((b, [1.0 / lag, 0.0, 0.0]))
        b[:6, 0] = 0.0
        c = np.eye(3, 7)
    if sensor_lag:
        a = np.block([[a, np.zeros((6, 1))], [c[:1] / sensor_lag, -np.eye(1) / sensor_lag]])
        b = np.vstack((b, np.zeros(3)))
        c = np.eye(3, 7)
        c[0, 0], c[0, 6] = 0.0, 1.0
    ad, bd, *_ = cont2discrete((a, b, c, np.zeros((3, 3))), 1.0 / RATE, method="zoh")
    state, seen = np.zeros(len(ad)), np.empty((len(u), 3))
    for k, now in enumerate(u):
        seen[k] = c @ state
        state = ad @ state + bd @ now
    return seen


@pytest.mark.parametrize("damping", ["own", "light"])
def test_linear_rig_is_exact(damping):
    u = told(3.0, damping=damping)
    want = exact(u[:, :, 0], damping)
    np.testing.assert_allclose(linear_response(rigs(1, damping), u)[:, :, 0], want, atol=1e-15)
    np.testing.assert_allclose(Batch(rigs(1, damping), [()]).motion(u)[:, :, 0], want, atol=1e-13)


def test_lags_and_delays_are_exact():
    u = told(2.0, 4)
    effects = [
        [Hidden("actuator_lag", "V1", {"tau": 3e-3})],
        [Hidden("sensor_lag", "s1", {"tau": 3e-3})],
        [Hidden("delay", "actuators", {"seconds": 2e-3})],
        [Hidden("delay", "actuators", {"seconds": 2.5e-3})],
    ]
    seen = Batch(rigs(4), effects).motion(u)
    one = u[:, :, 0]
    late = np.vstack((np.zeros((2, 3)), one[:-2]))
    np.testing.assert_allclose(seen[:, :, 0], exact(one, lag=3e-3), atol=1e-11)
    np.testing.assert_allclose(seen[:, :, 1], exact(one, sensor_lag=3e-3), atol=1e-11)
    np.testing.assert_allclose(seen[:, :, 2], exact(late), atol=1e-13)
    fine = np.repeat(late, 2, axis=0)[:-1]  # half samples, each a sample of a rig that lives twice as slowly
    fine = np.vstack((np.zeros((1, 3)), fine))
    a, b = (x[0] for x in rigs(1).linear())
    ad, bd, *_ = cont2discrete((a, b, np.eye(3, 6), np.zeros((3, 3))), 0.5 / RATE, method="zoh")
    state = np.zeros(6)
    for k, now in enumerate(fine):
        if k % 2 == 0:
            np.testing.assert_allclose(seen[k // 2, :, 3], state[:3], atol=1e-13)
        state = ad @ state + bd @ now


def test_an_added_mass_is_another_mass():
    # (4.1)-(4.3) with m1 (1 + m) or m3 (1 + m): w_i^2 = k_i/m_i, 2 z_i w_i = b_i/m_i, mu_i = m_i/m3, c_i = k_vi/m_i
    m, one = 0.04, declared("own")
    heavier = np.repeat(one[None], 2, axis=0)
    powers = {"w": -0.5, "z": -0.5, "c": -1.0}
    for row, number in enumerate("13"):
        for i, name in enumerate(PARAMETERS):
            if name[-1] == number and name[0] in powers:
                heavier[row, i] *= (1.0 + m) ** powers[name[0]]
    heavier[0, PARAMETERS.index("mu1")] *= 1.0 + m
    heavier[1, [PARAMETERS.index("mu1"), PARAMETERS.index("mu2")]] /= 1.0 + m
    u = told(2.0, 2)
    batch = Batch(rigs(2), [[Hidden("added_mass", at, {"m": m})] for at in ("x1", "beam")])
    np.testing.assert_allclose(batch.motion(u), linear_response(Rigs(heavier), u), atol=1e-12)


def test_forces_do_the_work_that_their_places_say():
    """At any state, the kinetic energy changes by the powers of all forces: each acts and reacts as it should."""
    rng = np.random.default_rng(5)
    keys = [(name, place) for name in ELEMENT_LAWS for place in PLACES]
    effects = [[Hidden(name, place, dict.fromkeys(ELEMENT_LAWS[name].parameters, 0.7))] for name, place in keys]
    batch = Batch(rigs(len(keys)), effects)
    n, mu1, mu2 = len(keys), *(declared("own")[PARAMETERS.index(x)] for x in ("mu1", "mu2"))
    state, out = rng.normal(size=batch.states) * 0.01, np.empty(batch.states)
    batch.rates(0.3, state, np.zeros((3, n)), out)
    d, v, a = (x.reshape(3, n) for x in (state[: 3 * n], state[3 * n : 6 * n], out[3 * n : 6 * n]))
    absolute = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    masses = np.array([mu1, mu2, 1.0])
    power = (masses[:, None] * (absolute @ v) * (absolute @ a)).sum(axis=0)
    power += (masses[:, None] * (batch.rigs.stiffness * d + batch.rigs.damping * v) * v).sum(axis=0)
    weight = dict(zip(PLACES, (mu1, mu2, 1.0, mu1, mu2, mu1), strict=True))
    reads = np.vstack((np.eye(3), [[1, 0, 1], [0, 1, 1], [1, -1, 0]]))
    for group in batch.groups:
        place, row = np.divmod(group.at, n)
        z = state[group.states].reshape(group.law.states, len(row))
        here, moves = ((reads[place] * x.T[row]).sum(axis=1) for x in (d, v))
        force = group.law.force(Motion(here, moves, z, 0.3), group.values)
        power[row] += np.array([weight[PLACES[p]] for p in place]) * force * moves
    np.testing.assert_allclose(power, 0.0, atol=1e-12)


def test_convergence_of_order_four():
    u = told(2.0, 2)
    effects = [
        [Hidden("hardening_spring", "spring1", {"k3": 3e6})],
        [Hidden("gravity_force", "beam", {"a": 0.1, "r": 2e-3})],
    ]
    finest, *others = (Batch(rigs(2), effects).motion(u, substeps=n) for n in (8, 1, 2))
    coarse, fine = (np.abs(x - finest).max(axis=(0, 1)) for x in others)
    assert (np.log2(coarse / fine) > 3.7).all()
    assert (SENSOR_GAIN * coarse < 1e-7).all()


def test_twins_are_the_same():
    (w1, _, w3), (c1, _, c3) = declared("own")[:3], declared("own")[PARAMETERS.index("c1") :][:3]
    fc, x0 = 5e-3, 2e-4
    groups = [
        [
            Hidden("constant_force", "beam", {"f0": 0.02}),
            Hidden("sensor_offset", "s3", {"e0": -SENSOR_GAIN * 0.02 / w3**2}),
            Hidden("actuator_offset", "V3", {"u0": -0.02 / c3}),
        ],
        [
            Hidden("constant_force", "spring1", {"f0": 0.02}),
            Hidden("sensor_offset", "s1", {"e0": -SENSOR_GAIN * 0.02 / w1**2}),
            Hidden("actuator_offset", "V1", {"u0": -0.02 / c1}),
        ],
        [
            Hidden("dahl_friction", "spring2", {"fc": fc, "x0": x0}),
            Hidden("hysteresis", "spring2", {"k": fc / x0, "zmax": x0, "beta": 1.0, "n": 1.0}),
            Hidden("lugre_friction", "spring2", {"fc": fc, "fs": fc, "vst": 0.01, "s0": fc / x0, "s1": 0.0, "s2": 0.0}),
        ],
        [
            Hidden("bilinear_spring", "spring1", {"k": 9.0}),
            Hidden("stop", "spring1", {"k": 9.0, "edge": 0.0, "c": 0.0, "side": 1.0}),
        ],
    ]
    effects = [[one] for group in groups for one in group]
    batch = Batch(rigs(len(effects)), effects)
    readings = batch.readings(batch.motion(told(2.0, len(effects)), substeps=1))
    row = 0
    for group in groups:
        for other in range(1, len(group)):
            np.testing.assert_allclose(readings[:, :, row + other], readings[:, :, row], atol=1e-11)
        row += len(group)
    case = hidden.cases("parameter", noise=1e-4, damping="own", count=1)[0]
    assert hidden.acceptable(case) == {("parameter", "w1"), ("linear_spring", "spring1")}
    case = replace(case, effect="dry_friction", at="beam")
    assert hidden.acceptable(case) == {("dry_friction", "beam")}
    assert ("stribeck_friction", "beam") in hidden.kin(case)
    assert ("constant_force", "spring2") in hidden.acceptable(replace(case, effect="actuator_offset", at="V2"))


@pytest.mark.parametrize("shapes", [training, validation])
def test_excitation_keeps_the_limits(shapes):
    u = commands(shapes, 10.0, [[1], [2]], ["own", "light"])
    assert np.abs(u).max() <= LARGEST_COMMAND
    for row, damping in enumerate(("own", "light")):
        moved = np.abs(linear_response(rigs(1, damping), u[:, :, row : row + 1])).max()
        assert moved == pytest.approx(STROKE, rel=1e-9) or np.abs(u[:, :, row]).max() == pytest.approx(LARGEST_COMMAND)


@pytest.mark.parametrize(
    ("damping", "count"),
    [
        ("own", 2),
        pytest.param("own", 14, marks=pytest.mark.search),
        pytest.param("light", 14, marks=pytest.mark.search),
    ],
)
def test_strengths_are_as_intended(damping, count):
    kinds = {"stiffness_drift", "quantisation"}  # one grows with time, the other has fixed steps
    drawn = hidden.cases("effect", noise=1e-4, damping=damping, count=count, seed=4, seconds=15.0)
    made = [case for case in drawn if case.effect not in kinds]
    chi = hidden.gaps(made, 15.0).max(axis=1)
    ratio = chi / [CHI[case.strength] for case in made]
    assert ((ratio > 1.0 / 3.0) & (ratio < 3.0)).all(), dict(zip([c.name for c in made], ratio, strict=True))


def test_families_draw_what_they_should():
    assert len({entry.effect for entry in EFFECTS}) >= 25
    one = hidden.cases("two", noise=3e-3, damping="own", count=1, seconds=10.0)
    assert all(len(case.hidden) == len(hidden.answers(case)) == 2 and case.strength != "weak" for case in one)
    (dirty,) = hidden.cases("dirty_none", noise=1e-3, damping="own", count=1, seconds=10.0)
    assert not dirty.hidden
    assert 0.001 < hidden.gaps([dirty], 10.0).max() < 0.008
    truth = hidden.truth(dirty)
    assert np.abs(np.array(list(truth.rig.values())) / declared("own") - 1.0).max() <= 0.01
    for case in one:
        assert {(case.effect, case.at), (case.second.effect, case.second.at)} <= hidden.acceptable(case)


def test_seeds_reproduce(tmp_path):
    made = hidden.cases("dirty", noise=1e-3, damping="light", count=2, seed=7)
    assert made == hidden.cases("dirty", noise=1e-3, damping="light", count=2, seed=7)
    first, again = (hidden.generate(made, 0.5, 0.3) for _ in range(2))
    hidden.save(tmp_path / "batch.npz", first)
    for one, other, kept in zip(first, again, hidden.load(tmp_path / "batch.npz"), strict=True):
        assert one[0] == other[0] == kept[0]
        for mine, its, loaded in zip(one[1:], other[1:], kept[1:], strict=True):
            assert mine.readings.shape == mine.commands.shape == (len(mine.t), 3)
            np.testing.assert_array_equal(mine.readings, its.readings)
            np.testing.assert_array_equal(mine.readings, loaded.readings)
    alone = hidden.generate(made[1:], 0.5, 0.3)
    np.testing.assert_allclose(alone[0][1].readings, first[1][1].readings, atol=1e-12)
    assert not np.allclose(first[0][1].commands, first[1][1].commands)


def test_nothing_is_shared_with_what_is_judged():
    for path in Path(hidden.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = (
                [a.name for a in node.names] if isinstance(node, ast.Import) else [getattr(node, "module", "") or ""]
            )
            assert not any(name.split(".")[0] == "masking" for name in names)
