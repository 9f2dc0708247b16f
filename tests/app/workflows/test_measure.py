"""The verb measure: each procedure on a record of the twin, what it writes, and what it refuses; and a filter's fit."""

import json
import os

import numpy as np
import pytest
from scipy import linalg, signal

import masking
from masking.app import cli
from masking.control.rig.twin import Twin
from masking.errors import DeclarationError, RecordError
from masking.inference.procedures import measurement
from masking.inference.procedures.channel_names import Source
from masking.inference.procedures.measured_response import repeats, response
from masking.lab.records.recording import Recording
from tests.inference.procedures.test_measurement import (
    ACTING,
    BALANCE,
    MEASURED,
    STROKE,
    VOLTS,
    alone,
    driven,
    teeth,
    without,
)

RATE = 250.0
UNITS = {f"input.V{i}": {"unit": "V", "meaning": ""} for i in (1, 2, 3)}
UNITS |= {f"sensor.s{i}": {"unit": "V", "meaning": ""} for i in (1, 2, 3)}
PNG = b"\x89PNG\r\n"


def saved(folder, name, commands, metres, rate=RATE, **manifest):
    columns = {"t": np.arange(len(commands)) / rate}
    columns |= {f"input.V{i + 1}": commands[:, i] for i in range(3)}
    columns |= {f"sensor.s{i + 1}": 200.0 * metres[:, i] for i in range(3)}
    Recording(columns, {"columns": UNITS, **manifest}).save(folder / name)
    return folder / name


@pytest.fixture(scope="module")
def rig():
    return Twin.load("tue_rig")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("records")


def ramp_record(rig, folder):
    command = alone(0, teeth([0.04], RATE, slope=4 * 0.04 / 60))
    return saved(folder, "ramp", command, driven(rig, command, RATE))


def balance_record(rig, folder):
    """The red oscillator is held, as in `test_procedures.swept`; the commands have no unit."""
    t = np.arange(round(60 * RATE)) / RATE
    gain = np.interp(t, [0.0, 30.0, 60.0], [0.4, 1.9, 0.4])
    wave = 0.2 * np.sin(2 * np.pi * 2.0 * t)
    commands = alone(2, wave)
    commands[:, 1] = gain * wave
    return saved(folder, "balance", commands, driven(rig, commands, RATE, held=1), columns={})


def red_records(rig, folder):
    """Saw-teeth, and ramps that go beyond 6 mm; the barrier is taken away."""
    rate, free = 200.0, without(rig, "red_stop")
    force = teeth(0.04 * np.arange(1, 5) / 4, rate, slope=4 * 0.04 / 40)
    ramps = np.interp(np.arange(16000) % 8000 / 8000, [0, 0.5, 1], [-0.05, 0.2, -0.05])
    pushed = np.concatenate([np.linspace(0, -0.05, 1000), ramps])
    return [
        saved(folder, name, alone(1, values), driven(free, alone(1, values), rate), rate)
        for name, values in (("teeth", force), ("push", pushed))
    ]


def multisine_records(rig, folder):
    """Two realisations of an odd multisine of 4 s, four periods each."""
    found, lines = [], [n for n in range(1, 28, 2) if n % 6 != 3]
    for seed in range(2):
        phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(lines))
        t = np.arange(round(16 * RATE)) / RATE
        wave = np.cos(2 * np.pi / 4.0 * np.outer(t, lines) + phases).sum(axis=1)
        commands = alone(0, 0.08 * wave / np.abs(wave).max())
        found.append(saved(folder, f"multisine{seed}", commands, driven(rig, commands, RATE, seed=seed)))
    return found


def each(make):
    """Return the fixture that makes records once for the module."""
    return pytest.fixture(scope="module")(make)


ramp, balance, red, multisines = (each(make) for make in (ramp_record, balance_record, red_records, multisine_records))


def run(capsys, *arguments):
    status = cli.main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def measured(capsys, out, *arguments):
    status, printed, _ = run(capsys, "measure", *arguments, "--out", out, "--json")
    assert status == 0
    told = json.loads(printed)
    written = json.loads((out / f"{arguments[0]}.json").read_text(encoding="utf-8"))
    assert written["values"] == told["values"]
    assert told["summary"] in (out / f"{arguments[0]}.html").read_text(encoding="utf-8").replace("&#39;", "'")
    assert (out / f"{arguments[0]}.png").read_bytes().startswith(PNG)
    return told["values"], written


# Procedures.


def test_springs_are_those_of_table_b_4(capsys, tmp_path, ramp):
    values, written = measured(capsys, tmp_path, "springs", ramp, "--plant", "tue_rig", "--sensor", "s1")
    assert values["scale"] == {"value": STROKE, "std": None, "unit": "m", "meaning": "unit of x of the coefficients"}
    assert values["force_scale"]["value"] == VOLTS
    x = np.linspace(values["lowest"]["value"], values["highest"]["value"], 50) / STROKE
    found = np.polynomial.polynomial.polyval(x, [values[f"rho{j}"]["value"] for j in range(6)])
    true = np.polynomial.polynomial.polyval(x, MEASURED[0]) / ACTING[0]  # volts of command, not those that act
    assert np.abs(found - true).max() < 0.01 * np.abs(true).max()
    assert values["stiffness"]["unit"] == "V/m"
    assert values["stiffness"]["std"] == pytest.approx(values["rho1"]["std"] * VOLTS / STROKE, rel=1e-6)
    assert 0.0 < values["half_gap"]["value"] < 1e-3
    assert written["columns"]["force"] == {"column": "input.V1", "unit": "V"}
    assert len(written["series"]["band"]) == len(written["series"]["displacement"])


def test_without_a_plant_a_displacement_is_in_the_unit_of_the_reading(capsys, tmp_path, ramp):
    status, out, _ = run(capsys, "measure", "springs", ramp, "--sensor", "s1", "--order", "3", "--out", tmp_path)
    assert status == 0
    assert out.startswith("The spring of s1 has a stiffness of 0.04")
    assert "V/V at 0 V" in out
    assert "note: displacement is in the unit of the sensor's reading; name the plant" in out
    assert f"page: {tmp_path / 'springs.html'}" in out


def test_actuators_balance_at_the_ratio_of_allocation_and_gains(capsys, tmp_path, balance):
    values, written = measured(capsys, tmp_path, "actuators", balance, "--sensor", "s3")
    assert values["ratio"]["value"] == pytest.approx(BALANCE[1], rel=0.005)
    assert 0.0 < values["ratio"]["std"] < 0.01
    assert values["frequency"]["value"] == pytest.approx(2.0, abs=1e-3)
    assert values["sign"]["value"] == 1.0
    assert written["columns"]["first"]["column"] == "input.V3"
    assert "only if the oscillator was held" in written["notes"][0]


def test_a_gain_is_found_between_commands_of_any_sign(balance):
    record = Recording.load(balance)
    columns = {**record.columns, "input.V2": -record["input.V2"]}
    flipped = measurement.actuators(
        Source("flipped", Recording(columns)), first="V3", second="V2", sensor="s3", frequency=2.0
    )
    assert flipped.found.ratio == pytest.approx(BALANCE[1], rel=0.005)
    assert {row.key: row.value for row in flipped.rows}["sign"] == -1.0


def test_friction_shifts_the_equilibrium_and_engages_at_6_mm(capsys, tmp_path, red):
    values, written = measured(capsys, tmp_path, "friction", *red, "--plant", "tue_rig", "--sensor", "s2")
    assert values["is_found"]["value"] == 1.0
    assert values["edge"]["value"] == pytest.approx(6e-3, abs=2e-4)  # the width over which it begins
    assert values["edge"]["unit"] == "m"
    # 2 (k zmax / w2^2 + friction / stiffness), with what the twin declares, and viscous forces on top.
    dry = 2.0 * 0.02 * 5e-4
    assert dry < values["largest_shift"]["value"] < 10 * dry
    assert values["constant"]["std"] > 0.0
    assert len(written["series"]["travel"]) == 4
    assert written["notes"] == []


def test_a_ramp_alone_tells_where_friction_is_but_no_shift(red):
    found = masking.measure("friction", red[1], plant="tue_rig", sensor="s2", input="V2")
    assert found.found.shift is None
    assert found.found.place.is_found
    assert found.notes[0].startswith(f"no shift of the equilibrium from {red[1]}: ")


def test_response_with_its_confidence_and_distortion(capsys, tmp_path, multisines):
    arguments = ["response", *multisines, "--plant", "tue_rig", "--sensor", "s1", "--period", "4"]
    values, written = measured(capsys, tmp_path, *arguments)
    series = written["series"]
    assert series["frequency_V1"][0] == 0.25
    still = STROKE / VOLTS * ACTING[0] / MEASURED[0][1]  # a slow force moves the spring
    size = np.hypot(series["real_s1_V1"][0], series["imaginary_s1_V1"][0])
    assert size == pytest.approx(still, rel=0.05)
    assert values["realisations"]["value"] == 2.0
    assert values["peak_s1_V1"]["unit"] == "m/V"
    assert values["noise_s1"]["value"] < values["odd_s1"]["value"] < 0.1
    assert (tmp_path / "distortion.png").read_bytes().startswith(PNG)


def test_the_period_is_found_and_several_inputs_are_told_apart(multisines):
    record = Recording.load(multisines[0])
    columns = dict(record.columns) | {"input.V2": np.cos(2 * np.pi * 0.5 * record.t)}  # on a line of its own
    columns["sensor.s1"] = 2.0 * columns["input.V1"] - 3.0 * columns["input.V2"]
    made = Source("made", Recording(columns))
    assert repeats(np.column_stack([columns["input.V1"], columns["input.V2"]]), 1e-3) == 1000
    found = response(made, sensors=["s1"])
    np.testing.assert_allclose(found.found.responses["V1"].response[:, 0, 0], 2.0, atol=1e-9)
    np.testing.assert_allclose(found.found.responses["V2"].response[:, 0, 0], -3.0, atol=1e-9)
    assert any("it takes an excitation of one input" in note for note in found.notes)


def test_a_part_of_a_period_at_the_end_is_left_out(multisines):
    record = Recording.load(multisines[0])
    cut = Recording({name: column[:-300] for name, column in record.columns.items()})
    found = response(Source("cut", cut), sensors=["s1"])
    assert "the last 2.8 s, no whole period, are left out" in found.notes


# What is refused.


@pytest.fixture
def records(request, monkeypatch, folder):
    """Work in the folder that has all the records."""
    for name in ("ramp", "balance", "red", "multisines"):
        request.getfixturevalue(name)
    monkeypatch.chdir(folder)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["springs", "ramp"], "it has 3 sensors: s1, s2, s3; say which one is meant, such as --sensor s1"),
        (["springs", "ramp", "--sensor", "s9"], "there is no sensor 's9'; its sensors are s1, s2, s3; did you mean"),
        (["springs", "ramp", "--sensor", "s1", "--input", "V2"], "force is constant at 0; see that it is connected"),
        (["springs", "balance", "--sensor", "s3"], "it has 2 inputs that move: V2, V3; say which one is meant"),
        (["springs", "ramp", "--sensor", "s1", "--plant", "nowhere"], "nowhere"),
        (["actuators", "ramp", "--sensor", "s3"], "it has 1 inputs that move: V1; say which has the sine of constant"),
        (["actuators", "balance", "--sensor", "s3", "--frequency", "0"], "frequency is 0.0; give a finite number"),
        (["actuators", "ramp", "--first", "V3", "--second", "V1", "--sensor", "s3"], "first is constant at 0"),
        (["response", "multisine0", "--period", "3"], "there is no period of 3 s in the record"),
        (["response", "multisine0", "--period", "3"], "they repeat every 4 s: correct --period"),
        (["response", "ramp"], "there is no period in the record: over its 60 s the commands do not repeat"),
        (["response", "multisine0", "--period", "8"], "the record has 2 periods, of which 1 are discarded"),
        (["response", "multisine0", "push"], "push 200; give records of one rate"),
        (["friction", "multisine0", "--sensor", "s1"], "multisine0: the ramp is too fast: inertia takes"),
        (["response", "missing"], "no such recording"),
    ],
)
@pytest.mark.usefixtures("records")
def test_what_cannot_be_measured_is_said_and_nothing_is_written(capsys, tmp_path, arguments, said):
    status, printed, err = run(capsys, "measure", *arguments, "--out", tmp_path / "out")
    assert status == 2
    assert printed == ""
    assert said in err
    assert not (tmp_path / "out").exists()


def test_a_procedure_that_there_is_not_is_refused(capsys, ramp):
    with pytest.raises(SystemExit) as caught:
        cli.main(["measure", "spring", str(ramp)])
    assert caught.value.code == 2
    assert "invalid choice: 'spring'" in capsys.readouterr().err
    with pytest.raises(DeclarationError, match="there is no procedure 'spring'; did you mean 'springs'"):
        masking.measure("spring", ramp)
    with pytest.raises(DeclarationError, match="bins: springs has no such setting; allowed: input, sensor, order"):
        masking.measure("springs", ramp, bins=10)
    with pytest.raises(RecordError, match="springs takes one record; 2 are given"):
        masking.measure("springs", ramp, ramp)


def test_a_folder_that_cannot_be_written_is_refused_first(capsys, tmp_path):
    occupied = tmp_path / "occupied"
    occupied.write_text("mine", encoding="utf-8")
    status, _, err = run(capsys, "measure", "springs", tmp_path / "missing", "--out", occupied)
    assert status == 2
    assert f"{occupied} is a file; name a folder to save in" in err
    assert occupied.read_text(encoding="utf-8") == "mine"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission_is_refused(capsys, tmp_path, ramp):
    (tmp_path / "shut").mkdir(mode=0o500)
    status, _, err = run(capsys, "measure", "springs", ramp, "--sensor", "s1", "--out", tmp_path / "shut" / "out")
    assert status == 2
    assert "may not be written" in err


# Fits: the figures beside their files, and the filter.

MODEL = """\
name: one mass
coordinates: {x: {unit: m}}
inputs: {u: {unit: N}}
parameters:
  w: {value: 9.5, unit: rad/s, bounds: [0, null]}
  z: {value: 0.15, unit: 1}
  g: {value: 1, unit: 1/kg}
equations:
  x'': -w**2*x - 2*z*w*x' + g*u
scales:
  time: {value: 1/w, unit: s}
  length: {value: 0.01, unit: m}
  force: {value: 1, unit: N}
"""
PLANT = """\
name: one mass
kind: simulated
model: model.yaml
sensors:
  s: {measures: x, gain: {value: 100, unit: V/m}, unit: V}
"""


@pytest.fixture(scope="module")
def mass(tmp_path_factory):
    """Return a plant file with w = 9.5 rad/s, and two records of one with 9 rad/s: exact over each held sample."""
    folder = tmp_path_factory.mktemp("mass")
    (folder / "model.yaml").write_text(MODEL, encoding="utf-8")
    (folder / "plant.yaml").write_text(PLANT, encoding="utf-8")
    a, b = np.array([[0.0, 1.0], [-81.0, -2 * 0.1 * 9]]), np.array([0.0, 1.0])
    whole = linalg.expm(np.block([[a, b[:, None]], [np.zeros((1, 3))]]) * 0.01)
    for seed in (0, 1):
        generator = np.random.default_rng(seed)
        u, y, x = generator.standard_normal(500).repeat(4), np.zeros(2), []
        for force in u:
            x.append(y[0])
            y = whole[:2, :2] @ y + whole[:2, 2] * force
        readings = 100 * np.array(x) + 1e-3 * generator.standard_normal(len(u))
        columns = {"t": np.arange(len(u)) / 100.0, "input.u": u, "sensor.s": readings}
        Recording(columns, {}).save(folder / f"r{seed}")
    return folder


@pytest.mark.parametrize("method", ["least-squares", "kalman"])
def test_inputs_that_were_measured_go_in_straight_lines(capsys, tmp_path, mass, method):
    """A record by scipy of the mass under such inputs; held, they come half a sample late."""
    generator, t = np.random.default_rng(2), np.arange(2000) / 100.0
    u = np.interp(t, t[::8], generator.standard_normal(250))
    system = ([[0.0, 1.0], [-81.0, -2 * 0.1 * 9]], [[0.0], [1.0]], [[100.0, 0.0]], [[0.0]])
    x = signal.lsim(system, u, t, interp=True)[1] + 1e-3 * generator.standard_normal(len(t))
    Recording({"t": t, "input.u": u, "sensor.s": x}, {}).save(tmp_path / "record")
    arguments = ["identify", tmp_path / "record", "--plant", mass / "plant.yaml", "--parameters", "w,z"]
    arguments += ["--method", method, "--out", tmp_path / "out", "--overwrite", "--json", "--hold"]
    found = []
    for between in ("first-order", "zero-order"):
        status, printed, _ = run(capsys, *arguments, between)
        assert status == 0
        found.append(json.loads(printed))
    assert found[0]["chi"]["train"]["s"] < 1.1 * found[0]["floor"]["s"] < 0.6 * found[1]["chi"]["train"]["s"]
    assert found[0]["parameters"]["w"]["value"] == pytest.approx(9.0, rel=2e-3)
    assert found[0]["page"] == str(tmp_path / "out" / "fit.html")


def test_a_filter_identifies_and_draws_its_estimates(capsys, tmp_path, mass):
    arguments = ["identify", mass / "r0", "--plant", mass / "plant.yaml", "--parameters", "w,z", "--method", "kalman"]
    status, printed, _ = run(capsys, *arguments, "--validate", mass / "r1", "--out", tmp_path, "--json")
    assert status == 0
    told = json.loads(printed)
    assert told["parameters"]["w"]["value"] == pytest.approx(9.0, rel=5e-3)
    assert told["parameters"]["z"]["value"] == pytest.approx(0.1, rel=2e-2)
    assert told["chi"]["validation"]["s"] < 0.05
    assert "nis" in told
    assert Twin.load(tmp_path / "plant.yaml").parameter_value("w") == pytest.approx(9.0, rel=5e-3)
    for name in ("fit", "validation", "estimates"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(PNG)
    page = (tmp_path / "fit.html").read_text(encoding="utf-8")
    assert page.count("<img ") == 3
    assert "In the validation record the residual is " in page


def test_least_squares_draw_the_fit_too(tmp_path, mass):
    found = masking.identify(mass / "r0", plant=mass / "plant.yaml", parameters=["w", "z"], out=tmp_path)
    assert found.values == pytest.approx([9.0, 0.1], rel=2e-3)
    assert {path.name for path in tmp_path.iterdir()} == {"fit.html", "fit.json", "fit.png", "model.yaml", "plant.yaml"}
    sheet = json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))["sheet"]
    assert [value for _, value, *_ in map(dict.values, sheet["tiles"])] == [f"{x:.7g}" for x in found.values]
    assert sheet["errors"]["fitted"] == found.chi
    assert sheet["errors"]["as declared"]["s"] > sheet["errors"]["fitted"]["s"]
    assert sheet["sections"]["What was found"][0].partition(": ")[0] in (tmp_path / "fit.html").read_text(
        encoding="utf-8"
    )
    assert masking.report(tmp_path, one_page=True).path.read_bytes().startswith(b"%PDF-")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["r0", "r1", "--method", "kalman"], "the filter takes one record, 2 are given; filter one after the other"),
        (
            ["r0", "--method", "kalman", "--shooting-interval", "1"],
            "shooting_interval: a filter has none; leave it out",
        ),
        (["r0", "--square-root"], "square roots and iterations are settings of the filter; give the method kalman"),
        (["r0", "--method", "kalman", "--iterated", "0"], "iterated is 0: give the times"),
    ],
)
def test_settings_of_another_method_are_refused(capsys, tmp_path, mass, arguments, said):
    arguments = [mass / text if text in {"r0", "r1"} else text for text in arguments]
    status, _, err = run(capsys, "identify", *arguments, "--plant", mass / "plant.yaml", "--out", tmp_path / "out")
    assert status == 2
    assert said in err
    assert not (tmp_path / "out").exists()
