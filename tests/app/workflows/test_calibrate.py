"""Calibration, unattended: a rig whose plant file is wrong is excited, fitted, and judged by an unseen record."""

import dataclasses
import html.parser
import json
import re
import signal
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from masking.app import cli
from masking.app.workflows.calibrate import Calibration, RigCalibration, Stage, calibrate
from masking.app.workflows.calibration_excitation import Rig
from masking.compile.numerics import safety_tables
from masking.control.known_instruments import Instruments
from masking.control.rig.twin import Twin
from masking.errors import MaskingError, ModelError, PlantMismatchError, RecordError
from masking.inference.estimation.fit import fit
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.records.recording import Recording
from masking.lab.runs import safety_limits
from masking.lab.runs.self_test import self_test
from masking.model.declaration import registry


def settings(out, **changes):
    return RigCalibration(**{"out": out, "seconds": 20.0, "lockstep": True} | changes)


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    """Return the full twin's calibration by a plant file whose friction and hysteresis are far off, and its folder."""
    rig = Twin.load("tue_rig")
    off = {"friction1_fc": 2e-3, "friction2_fc": 2e-3, "friction3_fc": 2e-3}
    off |= {f"hysteresis{i}_{name}": value for i in (1, 2, 3) for name, value in (("k", 2.0), ("zmax", 7e-4))}
    out = tmp_path_factory.mktemp("calibration") / "out"
    return calibrate(rig.with_parameters(off), SimulatedPlant(rig, 3), settings(out, model="setup_springs")), out


def test_springs_and_friction_bring_the_error_on_unseen_data_near_the_noise(full):
    """The document's linear model errs by 0.0649, 0.1025 and 0.2267 (Table 4.3), its best one by 0.0545 and more."""
    found, _ = full
    linear, springs, whole = (stage.fit.validation for stage in found.stages)
    assert max(linear.values()) > 0.05
    assert max(springs.values()) < max(linear.values())
    assert max(whole.values()) < 0.005
    assert found.best is found.stages[-1]


def test_a_model_that_has_all_that_the_rig_does_leaves_nothing_but_noise(full):
    """Rounded readings are compared with what they were before: otherwise the error is 1.2 times the noise."""
    found, _ = full
    for name, chi in found.best.fit.validation.items():
        assert chi == pytest.approx(found.unseen_floor[name], rel=0.03)
    assert [e.enabled for e in Twin.load(full[1] / "plant.yaml").effects if e.kind == "quantisation"] == [True] * 3


def test_a_fit_of_what_is_written_leaves_nothing_but_noise(full):
    """The plant file rounds readings, and a fit by itself compares with what they were before."""
    found, out = full
    twin = Twin.load(out / "plant.yaml")
    made = fit(twin, found.records.unseen, (), shared=found.best.parameters)
    for name, chi in made.chi.items():
        assert chi == pytest.approx(found.unseen_floor[name], rel=0.03)
    assert made.twin.noise() == twin.noise()


def test_the_spring_curves_are_those_of_the_document(full):
    """(4.14): c nu sum_j rho_j (d / l)^j, with c of Table B.1 and Table B.4, where spring 2 is as spring 1."""
    rho = (
        (0.000234722612437, 0.091796394850297, -0.005071505003798, 0.001755823061963, -0.00049532192, 0.00045535841),
        (0.000234722612437, 0.091796394850297, -0.005071505003798, 0.001755823061963, -0.00049532192, 0.00045535841),
        (-0.003305403062789, 0.680504615284765, 0.089803957869115, 0.203236186622692, -0.06447393360, 0.01710517533),
    )
    curves = full[0].curves
    assert [curve.element for curve in curves] == ["spring1", "spring2", "beam"]
    for curve, coefficients, gain in zip(curves, rho, (20.9218, 23.2465, 1.2589), strict=True):
        truth = gain * 0.42 * np.polyval(coefficients[::-1], curve.displacement / 0.005)
        inside = (curve.displacement > curve.low) & (curve.displacement < curve.high)
        errors = np.abs(curve.force - truth)[inside]
        assert errors.max() < 2e-3 * np.ptp(truth)
        assert np.mean(errors < 3.0 * curve.std[inside] + 1e-4 * np.ptp(truth)) > 0.9


def test_it_ends_in_a_report_that_needs_no_other_file(full):
    found, out = full
    page = (out / "index.html").read_text(encoding="utf-8")
    html.parser.HTMLParser().feed(page)
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", "", re.sub(r"src=\"data:[^\"]*\"", "", page)))
    assert "setup_springs with dry friction and hysteresis reproduces an unseen multisine to 0.0" in text
    assert "; the noise floor is 0.0" in text
    for number in ("0.0649", "0.1025", "0.2267", "0.0545", "0.1307", "0.0869"):  # Tables 4.3 and 4.5
        assert number in text
    for name in found.best.fit.names:
        assert name in text or name.rstrip("0123456789") in text
    assert not re.search(r"(src|href)=\"(?!data:)", page)
    for name in ("unseen", "residuals", "spectra", "springs", "excitation"):
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((out / "calibration.json").read_text())["report"] == str(out / "index.html")


def test_what_was_excited_is_what_the_limits_allow(full):
    found, _ = full
    lines = [set(np.round(20.0 * each.lines).astype(int)) for each in found.excited]
    assert set.union(*lines) == set(range(1, 81))
    assert sum(map(len, lines)) == 80
    for each in found.excited:
        assert each.peak == pytest.approx(found.records.size * 0.42)
        assert each.peak / each.rms < 1.7


def test_the_simpler_of_two_equal_models_is_taken(tmp_path):
    def stages(*errors):
        made = (Stage(str(i), SimpleNamespace(validation={"s1": error})) for i, error in enumerate(errors))
        return Calibration(None, None, tuple(made), tmp_path).best.name

    assert stages(0.1003, 0.1) == "0"
    assert stages(0.11, 0.1, 0.0999) == "1"


def test_friction_is_found_where_it_sits(full):
    """fc = 0.0012 l (w1 + w2)^2 / 4 in every element."""
    fitted = full[0].best.fit
    values = dict(zip(fitted.names, fitted.values, strict=True))
    truth = 0.0012 * 0.005 * (12.5521 + 14.0337) ** 2 / 4
    assert [values[f"friction{i}_fc"] for i in (1, 2, 3)] == pytest.approx([truth] * 3, rel=0.1)


def test_the_largest_record_stays_within_the_stroke(full):
    """5 mm, which reads 1 V."""
    table = json.loads((full[1] / "calibration.json").read_text())
    assert table["best"] == full[0].best.name
    for name in ("fit", "unseen"):
        record = Recording.load(full[1] / "records" / name)
        assert 0.3 < max(np.abs(record[f"sensor.{sensor}"]).max() for sensor in ("s1", "s2")) < 1.0


def test_the_calibrated_plant_can_be_masked(full):
    assert cli.main(["check", str(full[1] / "plant.yaml")]) == 0
    Twin.load(full[1] / "plant.yaml").validate()


def test_the_command_line_goes_on_where_it_stopped(tmp_path, capsys):
    arguments = ["rig", "calibrate", "linear_rig", "--seconds", "20", "--out", str(tmp_path / "out"), "--json"]
    assert cli.main(arguments) == 0
    first = capsys.readouterr()
    told = json.loads(first.out)["stages"]["the model alone"]
    for name, value in (("w1", 12.5521), ("z2", 0.4296), ("c3", 1.2589), ("mu2", 0.0578)):
        found = told["parameters"][name]
        assert found["value"] == pytest.approx(value, rel=5e-3)
    for name, floor in told["floor"].items():
        assert told["chi"]["validation"][name] < 1.5 * floor
    assert "fit: recording 20 s" in first.err
    assert cli.main(arguments) == 2
    assert "holds an earlier result, calibration.json" in capsys.readouterr().err
    assert cli.main([*arguments, "--overwrite"]) == 0
    again = capsys.readouterr()
    assert "fit: recorded before" in again.err
    assert json.loads(again.out) == json.loads(first.out)


def test_a_rig_of_ones_own_is_calibrated_wherever_one_is(tmp_path):
    """The plant file names its model by a path from itself, and gives a parameter a value of its own."""
    (model,), (packaged,) = registry.load_model("setup").files, registry.load_plant("linear_rig").files
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "own_model.yaml").write_text(Path(model).read_text())
    text = Path(packaged).read_text().replace("model: setup", "model: own_model.yaml\nparameters: {l: 6}")
    (tmp_path / "mine" / "own_rig.yaml").write_text(text)
    twin = Twin.load(tmp_path / "mine" / "own_rig.yaml")
    parts = []
    found = calibrate(twin, SimulatedPlant(twin), settings(tmp_path / "out", progress=parts.append))
    assert parts == sorted(parts)
    assert parts[-1] == 1.0
    made = Twin.load(tmp_path / "out" / "plant.yaml")
    assert made.model.value("l") == pytest.approx(0.006)
    assert made.model.value("w1") == pytest.approx(12.5521, rel=5e-3)
    assert max(found.best.fit.validation.values()) < 0.01


class Interrupting(SimulatedPlant):
    """A twin during whose n-th session an interrupt comes."""

    def __init__(self, twin, session):
        super().__init__(twin)
        self.left = session

    def configure(self, settings):
        super().configure(settings)
        self.left -= 1

    def write(self, index, command):
        super().write(index, command)
        if index == 500 and not self.left:
            signal.raise_signal(signal.SIGINT)


class Skipping(SimulatedPlant):
    """A twin of whose samples one in a hundred is missed."""

    def read(self):
        sample = super().read()
        if sample.index % 100 == 99:
            super().write(sample.index, self._queue[-1].copy())
            sample = super().read()
        return sample


@pytest.fixture
def _interruptible():
    """Heed interrupts, which a shell has its background jobs ignore."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_interruptible")
def test_an_interrupted_recording_is_not_kept_and_what_there_was_before_is(tmp_path):
    class StopError(Exception):
        """Records are all there is to see."""

    def say(text):
        told.append(text)
        if text.startswith("fitting"):
            raise StopError

    twin = Twin.load("linear_rig")
    for session, kept in ((2, ["small"]), (1, ["small"])):
        told = []
        with pytest.raises(MaskingError, match="the recording was interrupted and is not kept; run the same again"):
            calibrate(twin, Interrupting(twin, session), settings(tmp_path, say=say))
        assert sorted(path.name for path in (tmp_path / "records").glob("*")) == kept
    told = []
    with pytest.raises(StopError):
        calibrate(twin, Skipping(twin), settings(tmp_path, say=say))
    assert [text for text in told if "record" in text] == [
        "small: recorded before",
        "fit: recording 20 s",
        "unseen: recording 20 s",
    ]
    record = Recording.load(tmp_path / "records" / "unseen")
    assert record.manifest["rig"]["counters"]["missed"] > 100
    s1, missed = record["sensor.s1"], np.arange(99, len(record) - 1, 100)
    assert s1[missed] == pytest.approx(0.5 * (s1[missed - 1] + s1[missed + 1]), abs=1e-12)
    assert (record["input.V1"][missed] == record["input.V1"][missed - 1]).all()


def test_records_made_with_other_settings_are_refused(full):
    _, out = full
    rig = Twin.load("tue_rig")
    limits = rig.declaration.limits
    lower = limits.inputs | {"V2": limits.inputs["V2"].model_copy(update={"max": 0.3})}
    careful = dataclasses.replace(
        rig, declaration=rig.declaration.model_copy(update={"limits": limits.model_copy(update={"inputs": lower})})
    )
    end = r"; give another folder with --out, or delete .*records to record anew"
    for twin, plant, changes, said in (
        (rig, SimulatedPlant(rig, 3), {"seconds": 30.0}, "seconds 20 instead of 30"),
        (careful, SimulatedPlant(rig, 3), {}, "limits V1 0.42, V2 0.42, V3 0.42 instead of V1 0.42, V2 0.3, V3 0.42"),
        (rig, SimulatedPlant(rig.with_parameters({"friction1_fc": 0.1}), 3), {}, "of another twin"),
    ):
        with pytest.raises(RecordError, match=f"small was recorded with other settings: {said}{end}"):
            calibrate(twin, plant, settings(out, overwrite=True, **changes))


def test_records_that_do_not_tell_their_settings_are_refused(tmp_path):
    twin = Twin.load("linear_rig")
    Recording({"t": np.arange(3.0)}).save(tmp_path / "records" / "small")
    with pytest.raises(RecordError, match="small does not say with which settings it was recorded; give another"):
        calibrate(twin, SimulatedPlant(twin), settings(tmp_path))


def test_a_plant_with_other_channels_is_refused_before_it_moves(tmp_path):
    twin = Twin.load("linear_rig")
    plant = SimulatedPlant(twin)
    plant.sensors = ("s2", "s1", "s3")
    said = (
        "the plant's sensors are s2, s1, s3; the calibration is for linear_rig, whose sensors are s1, s2, s3, in this "
        "order: calibrate that plant, or give the plant file of the one that is there"
    )
    with pytest.raises(PlantMismatchError) as caught:
        calibrate(twin, plant, settings(tmp_path / "out"))
    assert str(caught.value) == said
    assert not (tmp_path / "out").exists()


def test_a_rig_without_limits_is_not_excited(tmp_path):
    (packaged,) = registry.load_plant("linear_rig").files
    lines = [line for line in Path(packaged).read_text().splitlines() if not line.startswith("  inputs: {V1")]
    (tmp_path / "bare.yaml").write_text("\n".join(lines))
    twin = Twin.load(tmp_path / "bare.yaml")
    with pytest.raises(ModelError, match=r"no largest command of V1, V2, V3: write it under limits\.inputs"):
        calibrate(twin, SimulatedPlant(twin), settings(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_records_shorter_than_a_period_are_refused(tmp_path):
    twin = Twin.load("linear_rig")
    with pytest.raises(ModelError, match="records of 5 s are shorter than the excitation's period; give at least 20 s"):
        calibrate(twin, SimulatedPlant(twin), settings(tmp_path / "out", seconds=5.0))
    for length in (float("nan"), float("inf")):
        with pytest.raises(ModelError, match="are no records; give at least 20 s"):
            calibrate(twin, SimulatedPlant(twin), settings(tmp_path / "out", seconds=length))


def test_a_rig_that_falls_without_commands_is_refused_for_that_and_no_jump_of_its_sensor_is_seen(tmp_path):
    """A ball falls 10 mm in sqrt(2 * 10 mm / g) = 45.2 ms, at 0.443 m/s then."""
    twin = Twin.load("magnet")
    with pytest.raises(ModelError, match=r"twin does not stay .* \(tick 23: POSITION_LIMIT: x is 20.*rest without"):
        self_test(twin, SimulatedPlant(twin))  # at 500 Hz
    with pytest.raises(ModelError, match=r"does not rest within its limits .* \(.*tick 46: POSITION_LIMIT"):
        calibrate(twin, SimulatedPlant(twin), settings(tmp_path / "out"))
    jump = safety_limits.rules(Instruments.of(twin), 500.0, twin).readings[0, safety_tables.STEP]
    assert jump > 443.0 / 500.0  # mm


def test_a_plant_file_without_sensors_is_refused(tmp_path):
    twin = Twin.load("cart")
    blind = dataclasses.replace(twin, declaration=twin.declaration.model_copy(update={"sensors": {}, "effects": {}}))
    with pytest.raises(ModelError, match=r"no sensor shows what an actuator does; declare some under sensors"):
        calibrate(blind, SimulatedPlant(twin), settings(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "lowest", "highest"), [("cart", 1.5, 4.1), ("storey", 40.0, 100.0), ("tue_rig", 3.0, 8.0)]
)
def test_the_excitation_covers_the_natural_frequencies_of_a_rig(name, lowest, highest):
    """Of 1.0, 32.2 and at most 2.26 Hz: the power of each actuator's wave lies below and beyond them."""
    twin = Twin.load(name)
    rig = Rig(twin, SimulatedPlant(twin), lockstep=True)
    made = rig.waves(1, 20.0)
    power = np.abs(np.fft.rfft(made, axis=0)) ** 2
    at = np.fft.rfftfreq(len(made), 1e-3)
    assert lowest < at[(power > 1e-6 * power.max()).any(axis=1)].max() < highest
    assert at[(power > 1e-6 * power.max()).any(axis=1)].min() < 0.2
    assert np.abs(made).max(axis=0) == pytest.approx(1.0)
    slow = Rig(twin, SimulatedPlant(twin), 10.0, lockstep=True)
    assert slow.highest <= 2.5
