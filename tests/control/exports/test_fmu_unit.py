"""Exported FMUs: valid by fmpy, compiled from their sources, and the same numbers as the compiled kernels."""

import platform
import re
import shutil
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import masking
from masking.control.exports import fmu_unit
from masking.control.exports.controller_units import sampled_unit
from masking.control.exports.fmu_unit import has_binary, write
from masking.control.exports.rig_units import twin_unit
from masking.lab.runs.experiment import Experiment
from masking.model.declaration import catalogue
from tests.benchmarks import exported
from tests.control.exports.test_controller_units import by_kernel
from tests.support.compiled_unit import GCC

fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed: pip install 'masking[fmu]'")
validation = pytest.importorskip("fmpy.validation")
Slave = pytest.importorskip("tests.support.fmu_slave").Slave
pytestmark = [
    pytest.mark.skipif(not has_binary(), reason=f"FMUs get no binary on {platform.system()} {platform.machine()}"),
    pytest.mark.filterwarnings("ignore"),  # fmpy's own
]
EXACT = 1e-12
SWING = """
name: a mass on a spring
coordinates: {x: {meaning: displacement, unit: mm, initial: 10}}
parameters:
  m: {value: 2, unit: kg, meaning: mass}
  k: {value: 0.05, unit: N/mm, meaning: stiffness}
  c: {value: 1, unit: N*s/m, meaning: damping}
  doubled: {value: 2*m, unit: kg, meaning: twice the mass}
equations:
  x'': -(k*x + c*x')*2/doubled
"""
CASES = [("huygens_rig", "experiment"), ("duffing", "experiment"), ("tue_rig", "plant"), ("huygens", "model")]


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_an_fmu_is_valid_and_its_sources_give_its_binary(name, kind, tmp_path):
    rate = 1000.0 if kind == "plant" else None
    for path in masking.export(name, to="fmu", kind=kind, rate=rate, out=tmp_path).files:
        assert validation.validate_fmu(str(path)) == []
        result = fmpy.simulate_fmu(str(path), stop_time=0.01, step_size=0.001, output_interval=0.001)
        assert all(np.all(np.isfinite(result[name])) for name in result.dtype.names)
        with zipfile.ZipFile(path) as archive:
            sources = [n for n in archive.namelist() if n.endswith(".c")]
            archive.extractall(tmp_path / path.stem)
        files = [tmp_path / path.stem / source for source in sources]
        strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-fsyntax-only"]
        subprocess.run([GCC, *strict, *files], check=True)
        assert len(sources) == 2


QUICK = {"cart_bristles", "cart_felt_observer", "delayed_oscillators_rig", "duffing", "huygens_rig"}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in QUICK else pytest.mark.search)
        for name in catalogue.names("experiment")
        if exported.is_exported(name)
    ],
)
def test_every_exported_controller_is_a_valid_fmu(name, tmp_path, monkeypatch):
    monkeypatch.setattr(
        fmu_unit, "has_binary", lambda: False
    )  # which gcc makes in its time, and fmpy does not look into
    experiment = Experiment.load(name)
    case = exported.Sampled if experiment.has_observer else exported.Law
    for path in write(case(experiment, name).unit, tmp_path):
        assert validation.validate_fmu(str(path)) == []


@pytest.mark.parametrize("name", [pytest.param("cart_felt", marks=pytest.mark.search), "cart_felt_observer"])
def test_an_fmu_feels_the_push_that_the_kernel_feels(name, tmp_path):
    case = exported.Sampled(Experiment.load(name), name)
    case.samples = 300
    for path in write(case.unit, tmp_path):
        assert case.of_fmu(Slave(path, tmp_path / path.stem)) <= EXACT


@pytest.mark.skipif(not shutil.which("nm"), reason="there is no nm")
@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_has_every_function_of_the_standard(version, tmp_path):
    text = (Path(fmpy.__path__[0]) / "c-code" / f"fmi{version}FunctionTypes.h").read_text()
    declared = set(re.findall(rf"\b(fmi{version}\w+)TYPE\b", text))
    path = masking.export("duffing", to="fmu", out=tmp_path).files[version - 2]
    with zipfile.ZipFile(path) as archive:
        (binary,) = [n for n in archive.namelist() if n.endswith(".so")]
        archive.extract(binary, tmp_path)
    shown = subprocess.run(["nm", "-D", tmp_path / binary], capture_output=True, text=True, check=True).stdout
    there = {line.split()[-1] for line in shown.splitlines()}
    missing = declared - there
    exchange = ("Event", "Continuous", "NewDiscrete", "Completed", "SetTime", "GetDerivatives", "Nominals")
    assert {name for name in missing if not (version == 2 and any(word in name for word in exchange))} == set()


@pytest.mark.parametrize("version", [2, 3])
def test_fmus_of_controller_and_rig_move_as_the_twin_under_the_kernel(version, tmp_path):
    experiment = Experiment.load("huygens_rig")
    made, twin, count = experiment.sampled, experiment.twin, 6000
    _, commands, _ = by_kernel(experiment, count)
    units = (sampled_unit(made, "controller", 0.02), twin_unit(twin, "rig", made.rate))
    control, rig = (Slave(write(unit, tmp_path)[version - 2], tmp_path / f"{unit.name}{version}") for unit in units)
    generator, h = np.random.default_rng(experiment.declaration.seed), 1.0 / made.rate
    rig.begin([0.0, 0.0, 0.0, *generator.standard_normal(3)])
    control.begin(rig.get())
    worst = 0.0
    for index in range(count):
        control.set(rig.get())
        control.step(index * h, h)
        worst = max(worst, np.max(np.abs(control.get() - commands[index])))
        rig.set([*control.get(), *generator.standard_normal(3)])
        rig.step(index * h, h)
    assert np.max(np.abs(commands)) > 1e-3
    assert worst <= EXACT * np.max(np.abs(commands))


def test_a_step_that_is_no_multiple_of_the_period_is_refused(tmp_path):
    path = masking.export("huygens_rig", to="fmu", out=tmp_path).files[0]
    with pytest.raises(Exception, match="fmi2DoStep"):
        fmpy.simulate_fmu(str(path), stop_time=0.01, step_size=0.0015, output_interval=0.0015)


def test_the_state_of_an_fmu_can_be_kept_and_set(tmp_path):
    slave = Slave(masking.export("tue_rig", to="fmu", rate=1000.0, out=tmp_path).files[0], tmp_path / "rig")
    slave.begin(np.zeros(6))
    slave.set([0.2, 0.0, 0.1, 0.0, 0.0, 0.0])
    for k in range(20):
        slave.step(k * 1e-3, 1e-3)
    kept = slave.fmu.getFMUstate()
    slave.step(0.02, 0.005)
    first = slave.get()
    slave.fmu.setFMUstate(kept)
    slave.step(0.02, 0.005)
    assert np.array_equal(slave.get(), first)


def simulated(path, seconds, start, step=0.01):
    """Return the outputs at the end of a run of an FMU by fmpy, with start values that it is given."""
    result = fmpy.simulate_fmu(str(path), stop_time=seconds, step_size=step, output_interval=step, start_values=start)
    return np.array([result[name][-1] for name in result.dtype.names if name != "time"])


@pytest.mark.parametrize("version", [2, 3])
def test_a_master_sets_parameters_and_start_values(version, tmp_path):
    # a swing of mass, spring and damper in closed form, and one of the package with the same parameters
    folder = tmp_path / "swing.yaml"
    folder.write_text(SWING)
    path = masking.export(folder, to="fmu", rate=100.0, out=tmp_path).files[version - 2]
    assert validation.validate_fmu(str(path)) == []
    k, c, x0, v0, end = 30.0, 0.4, 0.02, -0.3, 2.0
    start = {"parameter.k": k, "parameter.c": c, "state.x": x0, "state.x'": v0}
    found = simulated(path, end, start)
    decay, turn = c / 4.0, np.sqrt(k / 2.0 - (c / 4.0) ** 2)
    swing = (v0 + decay * x0) / turn
    exact = np.exp(-decay * end) * (x0 * np.cos(turn * end) + swing * np.sin(turn * end))
    assert found[0] == pytest.approx(exact, abs=1e-7)
    own = masking.load_model(folder).with_parameters(k=0.03, c=c)  # k is declared in N/mm
    assert found[0] == pytest.approx(own.simulate([0.0, end], {"x": 1e3 * x0, "x'": 1e3 * v0})["x"][-1], abs=1e-7)
    assert simulated(path, end, {})[0] == pytest.approx(
        masking.load_model(folder).simulate([0.0, end])["x"][-1], abs=1e-7
    )


def test_what_depends_on_other_parameters_is_not_set_alone(tmp_path):
    folder = tmp_path / "swing.yaml"
    folder.write_text(SWING)
    path = masking.export(folder, to="fmu", rate=100.0, out=tmp_path).files[0]
    names = {v.name for v in fmpy.read_model_description(str(path)).modelVariables if v.causality == "parameter"}
    assert names == {"parameter.k", "parameter.c"}  # doubled follows m


@pytest.mark.parametrize("version", [2, 3])
def test_a_start_value_is_set_before_the_first_step_and_a_parameter_at_any_time(version, tmp_path):
    folder = tmp_path / "swing.yaml"
    folder.write_text(SWING)
    slave = Slave(masking.export(folder, to="fmu", rate=100.0, out=tmp_path).files[version - 2], tmp_path / "swing")
    places = {v.name: v.valueReference for v in slave.description.modelVariables}
    write_one = slave.fmu.setReal if slave.is_2 else slave.fmu.setFloat64
    write_one([places["state.x"]], [0.5])
    slave.begin([])
    assert slave.get()[0] == 0.5
    with pytest.raises(Exception, match=r"Set(Real|Float64)"):
        write_one([places["state.x"]], [0.1])
    write_one([places["parameter.k"]], [0.0])
    write_one([places["parameter.c"]], [0.0])
    slave.step(0.0, 0.5)
    assert slave.get()[0] == pytest.approx(0.5)  # nothing pulls at it
    slave.fmu.reset()
    slave.begin([])
    assert slave.get()[0] == pytest.approx(0.01)


def test_units_are_defined_by_their_si_base_units(tmp_path):
    folder = tmp_path / "swing.yaml"
    folder.write_text(SWING)
    defined = {}
    for path in masking.export(folder, to="fmu", rate=100.0, out=tmp_path).files:
        with zipfile.ZipFile(path) as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))  # noqa: S314  # of our own
        defined[path.stem] = {u.get("name"): u.find("BaseUnit").attrib for u in root.find("UnitDefinitions")}
    expected = {"N/m": {"kg": "1", "s": "-2"}, "m": {"m": "1"}, "m/s": {"m": "1", "s": "-1"}, "kg": {"kg": "1"}}
    expected |= {"N*s/m": {"kg": "1", "s": "-1"}, "N": {"kg": "1", "m": "1", "s": "-2"}}
    for found in defined.values():
        assert {name: found[name] for name in found} == {name: expected[name] for name in found}
        assert {"N/m", "m", "m/s"} <= set(found)


@pytest.mark.parametrize(
    ("unit", "base"),
    [
        ("deg/s", {"rad": "1", "s": "-1", "factor": repr(np.pi / 180.0)}),
        ("mm", {"m": "1", "factor": "0.001"}),
        ("V", {"kg": "1", "m": "2", "s": "-3", "A": "-1"}),
        ("1", {}),
        ("m**0.5", None),
        ("scales", None),
    ],
)
def test_a_unit_is_powers_and_a_factor(unit, base):
    assert fmu_unit._base_unit(unit) == base


def test_a_rig_with_samples_of_delay_wants_the_rate_that_they_are_of(tmp_path):
    with pytest.raises(masking.MaskingError, match=r"the delay of cart is 1 samples.*--rate 500"):
        masking.export("cart", kind="plant", to="fmu", out=tmp_path)
    found = masking.export("cart", kind="plant", to="c", rate=500.0, out=tmp_path)
    assert "The delay of 1 samples is 0.002 s." in found.notes


def test_a_controller_without_homing_says_that_the_rig_stays_at_rest(tmp_path):
    notes = {
        name: " ".join(masking.export(name, to="c", out=tmp_path).notes) for name in ("cart_bristles", "two_carts")
    }
    assert all(("stays at rest" in text) == (not Experiment.load(name).sampled.homing) for name, text in notes.items())
    assert any("stays at rest" in text for text in notes.values())
