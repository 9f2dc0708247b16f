"""Unit check: units, signs and clocks that are not as declared are said before anything is fitted; motion by scipy."""

import numpy as np
import pytest
from scipy import signal

import masking
from masking.errors import RecordError

M, C, K, RATE = 2.0, 4.0, 300.0, 100.0
MODEL = """
name: mass on a spring
coordinates: {x: {unit: m}}
inputs: {f: {unit: N}}
parameters:
  m: {value: 2.02, unit: kg}
  c: {value: 3.9, unit: N*s/m}
  k: {value: 302, unit: N/m}
  l: {value: 3.3333333333, unit: m, std: 0}
equations: {m*x'': f - c*x' - k*x}
outputs:
  position: {expression: x, unit: m}
  tilt: {expression: x/l, unit: rad}
  turning: {expression: x'/l, unit: rad/s}
"""
# From u in V, the speed of a body that a drive pulls along: v' = (b u - v)/T.
DRIVE = """
name: drive
states: {v: {unit: m/s}}
inputs: {u: {unit: V}}
parameters: {b: {value: 2.0, unit: m/s/V}, T: {value: 0.5, unit: s}}
equations: {v': (b*u - v)/T}
"""


@pytest.fixture(scope="module")
def columns():
    rng, t = np.random.default_rng(0), np.arange(900) / RATE
    f = 5.0 * signal.sosfiltfilt(signal.butter(4, 0.12, output="sos"), rng.standard_normal(len(t)))
    a, b = np.array([[0.0, 1.0], [-K / M, -C / M]]), np.array([[0.0], [1.0 / M]])
    rig = signal.cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), 1.0 / RATE)
    x, v = signal.dlsim((*rig[:4], 1.0 / RATE), f)[1].T
    clean = {"position": x, "tilt": 0.3 * x, "turning": 0.3 * v}
    read = {name: y + 1e-3 * y.std() * rng.standard_normal(len(t)) for name, y in clean.items()}
    return {"t": t, "f": f, **read}


def written(folder, columns, model=MODEL):
    np.savez(folder / "record.npz", **columns)
    (folder / "model.yaml").write_text(model)
    return folder / "record.npz", folder / "model.yaml"


def simulated(folder, columns, model=MODEL):
    record, given = written(folder, columns, model)
    return masking.simulate(given, record)


def suspected(notes):
    return [note for note in notes if "look" in note and " as if " in note]


@pytest.mark.parametrize(
    "case",
    [
        ("position", 1e3, "'position' looks as if it were in mm, not m: say so with --map \"position=position:mm\""),
        ("tilt", 180.0 / np.pi, "'tilt' looks as if it were in deg, not rad: say so with --map \"tilt=tilt:deg\""),
        ("turning", 30.0 / np.pi, "'turning' looks as if it were in rpm, not rad/s: say so with --map \"turning="),
        ("f", 1e-3, "'f' looks as if it were in kN, not N: say so with --map \"f=f:kN\""),
        ("tilt", -1.0, "'tilt' looks as if it had its sign reversed: reverse it in the record or in the model"),
    ],
)
@pytest.mark.parametrize("verb", ["simulate", "identify"])
def test_a_channel_in_another_unit_is_said_with_the_map_that_mends_it(tmp_path, columns, verb, case):
    channel, factor, said = case
    given = {**columns, channel: factor * columns[channel]}
    if verb == "simulate":
        notes = simulated(tmp_path, given).record.notes
    else:
        record, model = written(tmp_path, given)
        notes = masking.identify(record, model=model).notes
    (note,) = suspected(notes)
    assert note.startswith(said)


def test_the_map_that_is_proposed_mends_the_record(tmp_path, columns):
    record, model = written(tmp_path, {**columns, "tilt": 180.0 / np.pi * columns["tilt"]})
    made = masking.simulate(model, record, columns={"tilt": "tilt:deg"})
    assert not suspected(made.record.notes)
    assert made.chi["tilt"] < 0.03


@pytest.mark.parametrize(("unit", "times"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_a_clock_that_is_not_in_seconds_is_refused_before_anything_is_simulated(tmp_path, columns, unit, times):
    given = {"time": times * columns["t"], **{name: values for name, values in columns.items() if name != "t"}}
    record, model = written(tmp_path, given)
    said = f'\'t\' looks as if it were in {unit}, not s: say so with --map "t=time:{unit}".*"t=time:s"'
    with pytest.raises(RecordError, match=said):
        masking.simulate(model, record, columns={"t": "time"})
    with pytest.raises(RecordError, match=said):
        masking.identify(record, model=model, columns={"t": "time"})
    made = masking.simulate(model, record, columns={"t": f"time:{unit}"})
    assert max(made.chi.values()) < 0.03


@pytest.mark.parametrize(("k", "c"), [(302.0, 3.9), (390.0, 3.9), (302.0, 12.0), (150.0, 2.0), (600.0, 8.0)])
def test_right_units_are_not_suspected_where_a_model_is_moderately_wrong(tmp_path, columns, k, c):
    model = MODEL.replace("value: 302", f"value: {k:g}").replace("value: 3.9", f"value: {c:g}")
    assert not suspected(simulated(tmp_path, columns, model).record.notes)


def test_units_that_the_record_says_are_not_doubted(tmp_path, columns):
    given = {**columns, "position": 1e3 * columns["position"]}
    record, model = written(tmp_path, given)
    notes = masking.simulate(model, record, columns={"position": "position:m", "f": "f:N"}).record.notes
    assert not any("'position'" in note or "'f'" in note for note in suspected(notes))


def test_a_straight_line_says_nothing_of_the_clock(tmp_path):
    """A carriage that friction holds at one speed: without that friction it would run away, in ns hardly move."""
    rng, t = np.random.default_rng(1), np.arange(800) / 100.0
    cart = "name: cart\ncoordinates: {x: {unit: m}}\ninputs: {f: {unit: N}}\nparameters: {m: {value: 1, unit: kg}}\n"
    given = {"t": t, "f": 2.0 + 0.1 * np.sin(9.0 * t), "x": 0.2 * t + 1e-3 * rng.standard_normal(len(t))}
    made = simulated(tmp_path, given, f"{cart}equations: {{m*x'': f}}\n")
    assert max(made.chi.values()) > 0.5
    assert not suspected(made.record.notes)


def drive(b):
    rng, count, dt = np.random.default_rng(2), 800, 0.02
    u, v, part = np.repeat(rng.standard_normal(count // 20), 20), np.zeros(count), np.exp(-dt / 0.5)
    for i in range(count - 1):  # held between samples
        v[i + 1] = part * v[i] + (1.0 - part) * b * u[i]
    return {"t": dt * np.arange(count), "u": u, "v": v + 1e-3 * v.std() * rng.standard_normal(count)}


@pytest.mark.parametrize(("times", "stands"), [(2.9, False), (3.6, True)])
def test_a_parameter_that_a_fit_moves_moderately_settles_a_doubt(tmp_path, times, stands):
    record, model = written(tmp_path, drive(times * 2.0), DRIVE)
    before = suspected(masking.simulate(model, record).record.notes)
    after = suspected(masking.identify(record, model=model).notes)
    assert before[0].startswith("'v' looks as if it were in km/h, not m/s")
    assert after == (before if stands else [])
