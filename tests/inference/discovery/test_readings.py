"""Units: channels in other units than declared are suspected before anything is searched; motion by scipy."""

import numpy as np
import pytest
from scipy import signal
from scipy.integrate import solve_ivp

import masking
from masking.app.workflows import discovery_inputs
from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.latent_force import element_units
from masking.inference.discovery.readings import is_gain
from masking.inference.estimation.unit_check import UnitDoubt
from masking.reports import discovery_text

M, C, K, RATE = 2.0, 4.0, 300.0, 100.0
MODEL = """
name: mass on a spring
coordinates: {x: {unit: m}}
inputs: {f: {unit: N}}
parameters:
  m: {value: 2.02, unit: kg}
  c: {value: 3.9, unit: N*s/m}
  k: {value: 302, unit: N/m}
  l: {value: 3.3333333333, unit: m}
equations: {m*x'': f - c*x' - k*x}
outputs: {position: {expression: x, unit: m}, tilt: {expression: x/l, unit: rad}}
"""


@pytest.fixture(scope="module")
def record():
    rng, t = np.random.default_rng(0), np.arange(1200) / RATE
    f = 5.0 * signal.sosfiltfilt(signal.butter(4, 0.12, output="sos"), rng.standard_normal(len(t)))
    a, b, c = np.array([[0.0, 1.0], [-K / M, -C / M]]), np.array([[0.0], [1.0 / M]]), np.array([[1.0, 0.0]])
    rig = signal.cont2discrete((a, b, c, np.zeros((1, 1))), 1.0 / RATE)
    x = signal.dlsim((*rig[:4], 1.0 / RATE), f)[1][:, 0]
    noise = 1e-3 * x.std() * rng.standard_normal((len(t), 2))
    return {"t": t, "f": f, "position": x + noise[:, 0], "tilt": 0.3 * (x + noise[:, 1])}


def discovered(folder, columns):
    np.savez(folder / "record.npz", **columns)
    (folder / "model.yaml").write_text(MODEL)
    return masking.discover(folder / "record.npz", model=folder / "model.yaml")


@pytest.mark.parametrize(
    ("channel", "factor", "said"),
    [
        ("position", 1e3, "'position' looks as if it were in mm, not m: say so with --map \"position=position:mm\""),
        ("tilt", 180.0 / np.pi, "'tilt' looks as if it were in deg, not rad: say so with --map \"tilt=tilt:deg\""),
        ("f", 1e-3, "'f' looks as if it were in kN, not N: say so with --map \"f=f:kN\""),
        ("tilt", -1.0, "'tilt' looks as if it had its sign reversed: reverse it in the record or in the model"),
        ("f", -1.0, "'f' looks as if it had its sign reversed: reverse it in the record or in the model"),
        ("t", 1e3, "'t' looks as if it were in ms, not s: say so with --map \"t=t:ms\""),
    ],
)
def test_a_channel_in_another_unit_is_suspected_and_the_record_taken_so(tmp_path, record, channel, factor, said):
    found = discovered(tmp_path, {**record, channel: factor * record[channel]})
    assert discovery_text.sentence(found).startswith(said)
    assert found.as_dict()["unit"]["channels"] == [channel]
    assert found.verdict in {"none", "parameter"}
    assert max(found.simulation_error.validation[1].values()) < 0.01


def test_units_that_are_right_are_not_suspected(tmp_path, record):
    found = discovered(tmp_path, record)
    assert found.unit is None
    assert found.as_dict()["unit"] is None


def test_a_clock_by_which_the_model_moves_for_periods_between_samples_is_in_ms(tmp_path):
    damping, count = 0.3, 1500  # N s/m: it rings long, and the model's stiffness is 20 % off
    t = np.arange(count) / RATE
    f = 5.0 * signal.sosfiltfilt(signal.butter(4, 0.12, output="sos"), np.random.default_rng(3).standard_normal(count))
    a, b = np.array([[0.0, 1.0], [-K / M, -damping / M]]), np.array([[0.0], [1.0 / M]])
    rig = signal.cont2discrete((a, b, np.array([[1.0, 0.0]]), np.zeros((1, 1))), 1.0 / RATE)
    x = signal.dlsim((*rig[:4], 1.0 / RATE), f)[1][:, 0]
    x += 1e-3 * x.std() * np.random.default_rng(4).standard_normal(count)
    np.savez(tmp_path / "record.npz", t=1e3 * t, f=f, x=x)
    known = "m: {value: 2, unit: kg}, c: {value: 0.3, unit: N*s/m}, k: {value: 360, unit: N/m}"
    text = "name: mass\ncoordinates: {x: {unit: m}}\ninputs: {f: {unit: N}}\nparameters: {" + known + "}\n"
    (tmp_path / "model.yaml").write_text(text + "equations: {m*x'': f - c*x' - k*x}\n")
    found = masking.discover(tmp_path / "record.npz", model=tmp_path / "model.yaml")
    assert discovery_text.sentence(found).startswith(
        "'t' looks as if it were in ms, not s: say so with --map \"t=t:ms\""
    )
    assert found.verdict == "parameter"
    assert [(one.name, one.parameters["k"][0]) for one in found.effects] == [("k", pytest.approx(K, rel=1e-2))]


def test_a_motion_that_is_faster_than_the_record_samples_is_no_other_clock_and_simulated(tmp_path):
    m, c, k, rate = 1.35, 390.0, 5.3e4, 50.0  # of 200 rad/s: classical Runge-Kutta steps of a sample diverge
    u = np.repeat(np.random.default_rng(5).standard_normal(200), 5)
    rig = signal.cont2discrete(
        (np.array([[0, 1], [-k / m, -c / m]]), np.array([[0], [1 / m]]), np.array([[1.0, 0]]), np.zeros((1, 1))),
        1 / rate,
    )
    x = signal.dlsim((*rig[:4], 1 / rate), u)[1][:, 0]
    x += 1e-3 * x.std() * np.random.default_rng(6).standard_normal(len(x))
    np.savez(tmp_path / "record.npz", t=np.arange(len(u)) / rate, u=u, x=x)
    known = "m: {value: 1.35, unit: kg}, c: {value: 392, unit: N*s/m}, k: {value: 5.7e4, unit: N/m}"
    text = "name: valve\ncoordinates: {x: {unit: m}}\ninputs: {u: {unit: N}}\nparameters: {" + known + "}\n"
    (tmp_path / "model.yaml").write_text(text + "equations: {m*x'': u - c*x' - k*x}\n")
    found = masking.discover(tmp_path / "record.npz", model=tmp_path / "model.yaml")
    assert (found.unit, found.verdict) == (None, "parameter")
    assert [(one.name, one.parameters["k"][0]) for one in found.effects] == [("k", pytest.approx(k, rel=1e-2))]


def test_quantities_at_an_element_are_in_the_units_of_their_values(tmp_path):
    turning = "name: disc\ncoordinates: {th: {unit: deg}}\ninputs: {u: {unit: N*mm}}\n"
    turning += "parameters: {J: {value: 2, unit: g*m**2}}\nequations: {J*th'': u}\n"
    turning += "elements: {bearing: {displacement: th, unit: N*mm, acts: {th: -1}}}\n"
    (tmp_path / "model.yaml").write_text(turning)
    twin = discovery_inputs.rig(tmp_path / "model.yaml", None)
    rig = AugmentedModel(twin, tuple(twin.equation_parameters()))
    assert element_units(rig, "bearing") == ("N*m", "rad", "rad/s")


HARD = 2.5e5  # N/m^3
SPRING = """
name: mass on a spring
coordinates: {x: {unit: m}}
inputs: {f: {unit: N}}
parameters: {m: {value: 2.02, unit: kg}, c: {value: 3.9, unit: N*s/m}, k: {value: 302, unit: N/m}}
equations: {m*x'': f}
elements: {spring: {displacement: x, unit: N, acts: {x: -1}, force: k*d + c*d_rate}}
"""


def hard_spring(t, rng):
    """Return force and displacement (m,) of the mass on a spring that hardens, the force held between samples."""
    f = 20.0 * signal.sosfiltfilt(signal.butter(4, 0.12, output="sos"), rng.standard_normal(len(t)))
    y, xs = np.zeros(2), np.empty(len(t))
    for i, force in enumerate(f):  # held between samples
        xs[i] = y[0]
        made = solve_ivp(
            lambda _, z, force=force: [z[1], (force - C * z[1] - K * z[0] - HARD * z[0] ** 3) / M],
            (0.0, 1.0 / RATE), y, "DOP853", rtol=1e-10, atol=1e-12,
        )  # fmt: skip
        y = made.y[:, -1]
    return f, xs


def test_units_are_suspected_beside_a_law_that_the_model_lacks(tmp_path):
    rng, t = np.random.default_rng(0), np.arange(1200) / RATE
    f, xs = hard_spring(t, rng)
    x = 1e3 * (xs + 1e-3 * xs.std() * rng.standard_normal(len(t)))
    np.savez(tmp_path / "record.npz", t=t, f=f, x=x)
    (tmp_path / "model.yaml").write_text(SPRING)
    found = masking.discover(tmp_path / "record.npz", model=tmp_path / "model.yaml")
    said = discovery_text.sentence(found)
    assert said.startswith("'x' looks as if it were in mm, not m: say so with --map \"x=x:mm\"")
    assert "does not tell that from 'f' in kN" in said  # readings and forces scale alike
    assert [(one.name, one.on) for one in found.effects] == [("hardening_spring", "spring")]
    assert found.effects[0].parameters["k3"][0] == pytest.approx(HARD, rel=0.02)
    assert found.as_dict()["unit"]["alike"] == [{"channels": ["f"], "unit": "kN", "sign": 1}]


LEVEL = """
name: level
states: {x: {unit: m, initial: 1.0}}
inputs: {u: {unit: V}}
parameters: {b: {value: 0.1, unit: m/s/V}, a: {value: 0.1, unit: 1/s}}
equations: {x': b*u - a*x}
outputs: {s: {expression: x, unit: m}}
"""


def test_a_level_that_moves_little_about_its_mean_says_nothing_of_the_clock(tmp_path):
    rng, count, dt = np.random.default_rng(2), 900, 0.5
    u = 1.0 + np.repeat(rng.uniform(-0.5, 0.5, count // 30), 30)
    x, b = np.ones(count), 1.0 - np.exp(-0.1 * dt)
    for k in range(count - 1):
        x[k + 1] = x[k] + b * (min(u[k], 1.1) - x[k])  # a valve that opens no further
    np.savez(tmp_path / "record.npz", t=dt * np.arange(count), u=u, s=x + 1e-3 * rng.standard_normal(count))
    (tmp_path / "model.yaml").write_text(LEVEL)
    found = masking.discover(tmp_path / "record.npz", model=tmp_path / "model.yaml")
    assert found.unit is None
    assert [(one.name, one.on) for one in found.effects] == [("saturation", "u")]


@pytest.mark.parametrize(
    ("kind", "name", "unit", "times", "expected"),
    [
        ("sensor", "sensor_gain", "rpm", 30.0 / np.pi, True),  # a speed in rpm reads 9.5 times as much as in rad/s
        ("sensor", "sensor_gain", "rpm", np.pi / 30.0, False),
        ("actuator", "actuator_gain", "kN", 1e3, True),  # a command in kN does a thousand times as much as in N
        ("actuator", "actuator_gain", "kN", 300.0, False),
    ],
)
def test_a_gain_that_is_a_factor_between_units_is_that_unit(kind, name, unit, times, expected):
    factor = {"rpm": np.pi / 30.0, "kN": 1e3}[unit]
    doubt = UnitDoubt(("s",), kind, unit, "as declared", factor, otherwise=(((name, "s"), times),))
    assert is_gain(doubt) is expected


@pytest.mark.parametrize("off", [0.0, pytest.param(0.3, marks=pytest.mark.search)])
def test_what_is_found_in_other_units_is_written_in_these(tmp_path, off):
    """A cubic spring and an offset, of readings in mm with a range and noise that a plant declares in m."""
    rng, t = np.random.default_rng(5), np.arange(1200) / RATE
    f, x = hard_spring(t, rng)
    offset = off * x.std()
    np.savez(tmp_path / "record.npz", t=t, f=f, s=1e3 * (x + offset + 1e-3 * x.std() * rng.standard_normal(len(t))))
    (tmp_path / "model.yaml").write_text(SPRING)
    (tmp_path / "plant.yaml").write_text(
        "name: rig\nmodel: model.yaml\nsensors: {s: {measures: x, unit: m, range: [-0.2, 0.2], jump: 0.1}}\n"
        "effects: {steps: {effect: quantisation, at: s, parameters: {step: 1.0e-7}}}\n"
    )
    out = tmp_path / "found"
    found = masking.discover(tmp_path / "record.npz", plant=tmp_path / "plant.yaml", out=out)
    assert 'say so with --map "s=s:mm"' in discovery_text.sentence(found)
    beside = {("sensor_offset", "s")} if off else set()
    assert {(one.name, one.on) for one in found.effects} == {("hardening_spring", "spring")} | beside
    made = discovery_inputs.rig(None, out / "plant.yaml")
    sensor = made.declaration.sensors["s"]
    assert (sensor.unit, sensor.range, sensor.jump) == ("mm", (-200.0, 200.0), 100.0)
    steps, *found_there = made.declaration.effects.values()
    assert steps.parameters["step"] == pytest.approx(1e-4)
    assert [one.parameters["e0"] for one in found_there] == [pytest.approx(1e3 * offset, rel=0.01)] * bool(off)
    simulated = masking.simulate(out / "plant.yaml", tmp_path / "record.npz")
    assert simulated.chi["s"] < 1.1 * simulated.floor["s"]
