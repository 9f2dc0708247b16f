"""Following: the force of a law with states along a known motion, which may settle many times between samples.

The truth is Dahl's friction in closed form: along a straight piece of the motion, z = s + (z0 - s) exp(-|x - x0|/l);
and the frequency response of an oscillator that is carried along.
"""

import numpy as np
import pytest

from masking.compile.numerics import effect_table
from masking.control.rig.twin import Twin
from masking.inference.discovery import compiled_laws
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.model.declaration import dictionary_checks

FORCE, LENGTH, RATE = 3.0, 2e-6, 100.0
MODEL = """
name: slide
coordinates: {x: {unit: m}}
inputs: {f: {unit: N}}
parameters: {m: {value: 1, unit: kg}}
equations: {m*x'': f}
elements: {guide: {displacement: x, unit: N, acts: {x: -1}}}
"""
PLANT = "name: slide\nmodel: model.yaml\nsensors: {x: {measures: x, unit: m}}\n"


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    folder = tmp_path_factory.mktemp("slide")
    (folder / "model.yaml").write_text(MODEL)
    (folder / "plant.yaml").write_text(PLANT)
    twin = Twin.load(folder / "plant.yaml")
    return AugmentedModel(twin, twin.equation_parameters())


def test_a_dictionary_may_have_the_states_that_kernels_hold():
    assert dictionary_checks.MOST_STATES == effect_table.MOST_STATES


def zigzag():
    """Return a displacement of 1 mm back and forth, 20 samples each way, and its rate (m,)."""
    x = 5e-4 * np.abs((np.arange(201) / 10.0 + 1.0) % 4.0 - 2.0) - 5e-4
    return x, np.gradient(x) * RATE


def dahl(x, length):
    """Return the friction along straight pieces between samples (m,)."""
    z = np.zeros(len(x))
    for i, step in enumerate(np.diff(x)):
        z[i + 1] = np.sign(step) + (z[i] - np.sign(step)) * np.exp(-abs(step) / length)
    return FORCE * z


@pytest.mark.parametrize("samples", [20, 40, 80, 160])
def test_a_force_is_followed_as_well_where_a_turn_has_more_samples(rig, samples):
    turns = np.pi * np.arange(10 * samples + 1) / samples
    x, rate = 5e-4 * (1.0 - np.cos(turns)), 5e-4 * np.pi / samples * RATE * np.sin(turns)
    assert 1 <= compiled_laws.pieces(x, rate, 1.0 / RATE) <= compiled_laws.MOST_PIECES
    instance = EffectInstance("dahl_friction", "guide", (FORCE, 100 * LENGTH), ())
    force = rig.along(instance, x, rate, 1.0 / RATE)[:, 0]
    slides = np.abs(np.sin(turns)) > 1e-6
    assert np.abs(force - dahl(x, 100 * LENGTH))[slides].max() < 0.01 * FORCE


@pytest.mark.parametrize("length", [LENGTH, 100 * LENGTH])
def test_a_force_that_builds_up_over_any_length_is_followed_in_steps_of_samples(rig, length):
    turns = np.pi * np.arange(201) / 20.0
    x, rate = 5e-4 * (1.0 - np.cos(turns)), 5e-4 * np.pi / 20.0 * RATE * np.sin(turns)
    instance = EffectInstance("dahl_friction", "guide", (FORCE, length), (0,))
    force, slope = rig.along(instance, x, rate, 1.0 / RATE, (0,)).T
    slides = np.abs(np.sin(turns)) > 1e-6  # where it turns, the force depends on the rate's last digit
    assert np.abs(force - dahl(x, length))[slides].max() < 0.01 * FORCE
    np.testing.assert_allclose(slope, force / FORCE, atol=1e-9)


def test_a_friction_is_drawn_along_a_motion_in_stable_steps(rig):
    x, rate = zigzag()
    instance = EffectInstance("dahl_friction", "guide", (FORCE, LENGTH), (0,))
    force = rig.along(instance, x, rate, 1.0 / RATE)[:, 0]
    assert np.abs(force).max() < 1.001 * FORCE  # no step of it runs away
    sliding = np.abs(rate) > 0.9 * np.abs(rate).max()
    np.testing.assert_allclose(np.median(force[sliding & (rate > 0.0)]), FORCE, rtol=1e-3)
    np.testing.assert_allclose(np.median(force[sliding & (rate < 0.0)]), -FORCE, rtol=1e-3)


def carried(nu, m=0.4, zeta=0.1, of=2.0):
    """Return m s^2 (w^2 + 2 zeta w s)/(s^2 + 2 zeta w s + w^2), the force of a unit of displacement at a frequency."""
    s, w = 2j * np.pi * of, 2.0 * np.pi * nu
    return m * s**2 * (w**2 + 2.0 * zeta * w * s) / (s**2 + 2.0 * zeta * w * s + w**2)


@pytest.mark.parametrize("nu", [0.2, 1.9, 2.1, 8.0])
def test_an_oscillator_that_is_carried_along_has_its_frequency_response(rig, nu):
    t = np.arange(10000) / RATE
    x, rate = np.sin(4.0 * np.pi * t), 4.0 * np.pi * np.cos(4.0 * np.pi * t)
    instance = EffectInstance("attached_oscillator", "guide", (0.4, nu, 0.1), (0, 1, 2))
    force, by_mass, by_nu = rig.along(instance, x, rate, 1.0 / RATE, (0, 1))[-100:].T
    slope = (carried(nu * 1.0001) - carried(nu)) / 1e-4
    for made, of in ((force, carried(nu)), (0.4 * by_mass, carried(nu)), (nu * by_nu, slope)):
        assert np.abs(made - (of * np.exp(4j * np.pi * t[-100:])).imag).max() < 0.01 * max(abs(carried(nu)), abs(of))
