"""The Silverbox, a measured benchmark: an electronic circuit with a cubic spring, identified and simulated freely.

Wigren and Schoukens, Three free data sets for development and benchmarking in nonlinear system identification, European
Control Conference (2013), 2933-2938; split as the loader of nonlinearbenchmark.org splits it.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import io

from masking.control.rig.twin import Twin
from masking.inference.estimation.fit import fit
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.sensitivity import Sensitivity
from masking.inference.estimation.simulation import nearest

FILE = Path(__file__).parents[4] / "shared" / "data" / "silverbox" / "SNLS80mV.mat"
pytestmark = pytest.mark.skipif(not FILE.exists(), reason=f"the measurements are not at {FILE}")

MODEL = """
name: circuit with a cubic spring
coordinates: {y: {unit: V}}
inputs: {u: {unit: V}}
parameters:
  w: {value: 440, unit: 1/s}
  z: {value: 0.05}
  c: {value: 2e5, unit: 1/s**2}
  b: {value: 0, unit: V/s**2}
  k3: {value: 0, unit: 1/(V**2*s**2)}
equations: {"y''": "c*u + b - w**2*y - 2*z*w*y' - k3*y**3"}
"""
PLANT = """
name: Silverbox
model: circuit.yaml
sensors: {s: {measures: y, gain: 1, unit: V}}
"""
LINEAR = ("w", "z", "c", "b")
CUBIC = (*LINEAR, "k3")
RATE = 1e7 / 2**14  # samples per second
TRAIN = slice(40650, 57034)  # a quarter of what is given to fit
MULTISINE, ARROW, WITHIN = slice(105712, 127400), slice(100, 40575), slice(100, 32100)
FIRST = 50  # samples of a test that tell its initial state


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    folder = tmp_path_factory.mktemp("silverbox")
    (folder / "circuit.yaml").write_text(MODEL)
    (folder / "box.yaml").write_text(PLANT)
    return Twin.load(folder / "box.yaml")


@pytest.fixture(scope="module")
def measured():
    found = io.loadmat(FILE)
    u, y = found["V1"].ravel(), found["V2"].ravel()
    return Data("SNLS80mV", RATE, (u - u[:50].mean())[:, None], y[:, None], hold="first-order")


def part(record, samples):
    return replace(record, commands=record.commands[samples], readings=record.readings[samples])


def fitted(twin, record, names):
    """Return the twin with parameters fitted to the training part of a record."""
    return fit(twin, part(record, TRAIN), names, shared=CUBIC).twin


def error(twin, record, samples):
    """Return the rms error in mV of a simulation that knows the first 50 readings of a test, and its inputs."""
    test, sensing, none = part(record, samples), Sensitivity(twin, (), CUBIC), np.empty(0)
    start, _ = nearest(sensing, none, part(test, slice(FIRST)), np.ones(1))
    settings = {"rate": RATE, "substeps": twin.substeps(RATE), "hold": test.hold}
    simulated = sensing.simulate(none, start, test.commands, **settings)
    return 1e3 * np.sqrt(np.mean((test.readings - simulated)[FIRST:] ** 2))


@pytest.fixture(scope="module")
def straight(twin, measured):
    """Return the linear model, and the one with a cubic spring that is fitted from there."""
    linear = fitted(twin, measured, LINEAR)
    return linear, fitted(linear, measured, CUBIC)


@pytest.mark.parametrize(("test", "linear", "cubic"), [(ARROW, 14.1, 0.96), (MULTISINE, 7.0, 0.91)])
def test_a_cubic_spring_is_what_the_linear_model_lacks(straight, measured, test, linear, cubic):
    without, with_spring = (error(made, measured, test) for made in straight)
    assert without == pytest.approx(linear, rel=0.05)
    assert with_spring == pytest.approx(cubic, rel=0.1)


def test_inputs_that_were_measured_are_not_held(measured, straight):
    """Held from sample to sample, they come half a sample late."""
    held = replace(measured, hold="zero-order")
    assert error(fitted(straight[1], held, CUBIC), held, MULTISINE) > 10 * error(straight[1], measured, MULTISINE)


@pytest.fixture(scope="module")
def smooth(measured, straight):
    return fitted(straight[1], measured.band_limited(), CUBIC)


@pytest.mark.parametrize(("test", "largest"), [(ARROW, 0.5), (WITHIN, 0.4), (MULTISINE, 0.4)])
def test_inputs_that_were_filtered_are_smooth(straight, smooth, measured, test, largest):
    assert error(smooth, measured.band_limited(), test) < min(largest, 0.5 * error(straight[1], measured, test))
