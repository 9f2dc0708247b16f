"""Measured benchmarks: what a linear model of each is missing, by name, from the files as they are published.

Silverbox: Wigren and Schoukens, European Control Conference (2013), 2933-2938. EMPS: Janot, Gautier and Brunot (2019),
Workshop on Nonlinear System Identification Benchmarks. Bouc-Wen: Noel and Schoukens (2016), the same workshop,
simulated by its authors.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy import io, signal

import masking
from masking.app import cli

DATA = Path(__file__).parents[4] / "shared" / "data"
pytestmark = pytest.mark.skipif(not DATA.exists(), reason=f"the measurements are not at {DATA}")

CIRCUIT = """
name: circuit
coordinates: {y: {unit: V}}
inputs: {u: {unit: V}}
parameters:
  w: {value: 440, unit: 1/s, std: 50}
  z: {value: 0.05, std: 0.05}
  c: {value: 2e5, unit: 1/s**2, std: 1e5}
equations: {"y''": "c*u - w**2*y - 2*z*w*y'"}
elements: {spring: {displacement: y, unit: V/s**2, acts: {y: -1}}}
"""
DRIVE = """
name: drive
coordinates: {q: {unit: m}}
inputs: {u: {unit: V}}
parameters:
  M: {value: 100, unit: kg, std: 20}
  Fv: {value: 200, unit: N*s/m, std: 50}
  g: {value: 35.150651, unit: N/V, meaning: of the drive}
equations: {"q''": "(g*u - Fv*q')/M"}
elements: {guide: {displacement: q, unit: N, acts: {q: -1/M}}}
"""
OSCILLATOR = """
name: oscillator
coordinates: {y: {unit: m}}
inputs: {u: {unit: N}}
parameters:
  m: {value: 2, unit: kg}
  c: {value: 10, unit: N*s/m, std: 10}
  k: {value: 8e4, unit: N/m, std: 3e4}
equations: {"y''": "(u - c*y' - k*y)/m"}
elements: {spring: {displacement: y, unit: N, acts: {y: -1/m}}}
"""


def discovered(folder, model, record, validation, *options):
    """Return the numbers that the command line writes."""
    (folder / "model.yaml").write_text(model)
    arguments = ["discover", str(record), "--validate", str(validation), "--model", str(folder / "model.yaml")]
    assert cli.main([*arguments, "--out", str(folder / "found"), *options]) == 0
    found = json.loads((folder / "found" / "discovery.json").read_text(encoding="utf-8"))
    assert Path(found["model"]).exists()
    return found


@pytest.mark.search
def test_silverbox_has_a_cubic_spring(tmp_path):
    """Published k3/w**2 is not needed: what counts is the error in mV on the multisine that was not used."""
    file = DATA / "silverbox" / "SNLS80mV.mat"
    found = discovered(
        tmp_path, CIRCUIT, f"{file}@66.6:76.6", f"{file}@173.2:208.7",
        "--map", "u=V1,y=V2", "--dt", "0.0016384", "--hold", "band-limited",
    )  # fmt: skip
    first = found["effects"][0]
    assert (first["name"], first["on"]) == ("hardening_spring", "spring")
    measured = io.loadmat(file)["V2"].ravel()[105712:127400]
    error = 1e3 * found["simulation_error"]["validation"]["after"]["y"] * np.sqrt(np.mean(measured**2))
    assert error < 0.5  # 1.08 mV with a cubic spring in the README of the data, 7.0 mV without


@pytest.mark.search
def test_emps_has_friction_that_differs_between_directions(tmp_path):
    """Published, by inverse dynamics: Fc 20.3935 N, offset -3.1648 N, M 95.1089 kg, Fv 203.5034 N s/m.

    Damping that differs between directions leaves less of the force than the offset, by the same inverse dynamics.
    """
    train, test = DATA / "emps" / "DATA_EMPS.mat", DATA / "emps" / "DATA_EMPS_PULSES.mat"
    (tmp_path / "drive.yaml").write_text(DRIVE)
    found = masking.discover(
        train,
        validation=test,
        model=tmp_path / "drive.yaml",
        columns={"u": "vir", "q": "qm"},
        parameters=("M", "Fv"),
        shooting_interval=0.2,
    )
    causes = {(cause.name, cause.on): cause for cause in found.effects}
    assert set(causes) == {("dry_friction", "guide"), ("asymmetric_damping", "guide")}
    mass, viscous = (float(value) for value in found.explanation.hypothesis.theta)
    dry, more = (
        causes["dry_friction", "guide"].parameters["fc"][0],
        causes["asymmetric_damping", "guide"].parameters["c"][0],
    )

    def friction(v):
        return viscous * v + dry * np.sign(v) + more * np.maximum(v, 0.0)

    def published(v):
        return 203.5034 * v + 20.3935 * np.sign(v) - 3.1648

    speed = np.linspace(0.02, 0.13, 50)  # m/s; the record reaches 0.13
    for sign in (1.0, -1.0):
        assert friction(sign * speed) == pytest.approx(published(sign * speed), abs=1.1 * 3.1648)  # no more than that
    assert mass == pytest.approx(95.1089, rel=0.05)
    for file in (train, test):
        assert latent(file, mass, friction) < 0.95 * latent(file, 95.1089, published)
    before, after = found.simulation_error.validation
    assert after["q"] < 0.1 * before["q"]
    for name, value, std in zip(("M", "Fv"), found.explanation.hypothesis.theta, found.deviations, strict=False):
        declared, prior = {"M": (100.0, 20.0), "Fv": (200.0, 50.0)}[name]
        assert abs(value - declared) < 2.0 * prior, name
        assert std < 2.0 * prior, name


def latent(file, mass, friction):
    """Return the part of the force below 20 Hz that inverse dynamics do not give, with friction over the rate."""
    held = io.loadmat(file)
    force, q = held["gtau"].ravel()[0] * held["vir"].ravel(), held["qm"].ravel()
    smooth = signal.filtfilt(*signal.butter(4, 100.0 / 500.0), q)
    v = np.gradient(smooth) * 1e3
    modelled = mass * np.gradient(v) * 1e3 + friction(v)
    moving = np.abs(v) > 1e-3
    low = [signal.filtfilt(*signal.butter(4, 20.0 / 500.0), x)[moving] for x in (force, force - modelled)]
    return np.sqrt(np.mean(low[1] ** 2) / np.mean(low[0] ** 2))


@pytest.mark.search
def test_bouc_wen_is_hysteresis(tmp_path):
    train, test = DATA / "boucwen" / "train.h5", DATA / "boucwen" / "test.h5"
    found = discovered(
        tmp_path, OSCILLATOR, f"{train}@:20", test,
        "--map", "u=multisine/u,y=multisine/y", "--dt", str(1.0 / 750.0), "--hold", "band-limited",
    )  # fmt: skip
    (cause,) = found["effects"]
    assert (cause["name"], cause["on"], found["verdict"]) == ("bouc_wen_hysteresis", "spring", "named")
    # In the form of the dictionary: k = alpha, x0 = 1/(beta gamma) (z in units of displacement), delta = delta/gamma.
    told = {name: one["value"] for name, one in cause["parameters"].items()}
    assert told == pytest.approx({"k": 5e4, "x0": 1.0 / 800.0, "delta": -1.1 / 0.8}, rel=0.01)
    assert (
        found["simulation_error"]["validation"]["after"]["y"] * 6.67e-4 < 1.87e-5
    )  # m: the best published figure in the README
