"""The verb simulate: records by closed forms beside the simulation of a model."""

import json

import numpy as np
import pytest
from scipy import integrate

import masking
from masking.app import cli
from masking.errors import DeclarationError, ModelError, RecordError

W, Z, START, NOISE, RATE = 12.0, 0.02, 0.01, 1e-5, 200.0
OSCILLATOR = """
name: oscillator
coordinates: {x: {unit: m}}
parameters: {w: {value: 12, unit: rad/s}, z: {value: 0.02}}
equations: {"x''": "-w**2*x - 2*z*w*x'"}
"""


@pytest.fixture
def folder(tmp_path):
    """A free decay from rest at `START`, in closed form, with noise."""
    t = np.arange(4000) / RATE
    damped = W * np.sqrt(1 - Z**2)
    x = START * np.exp(-Z * W * t) * (np.cos(damped * t) + Z * W / damped * np.sin(damped * t))
    read = x + NOISE * np.random.default_rng(0).standard_normal(len(t))
    np.savetxt(tmp_path / "decay.csv", np.column_stack([t, read]), delimiter=",", header="time,x", comments="")
    (tmp_path / "oscillator.yaml").write_text(OSCILLATOR)
    return tmp_path


def test_the_true_model_leaves_the_noise(folder):
    made = masking.simulate(folder / "oscillator.yaml", folder / "decay.csv", columns={"t": "time"})
    assert made.residual.std() == pytest.approx(NOISE, rel=0.05)
    rms = np.sqrt(np.mean(made.record.readings**2))
    assert made.chi["x"] == pytest.approx(NOISE / rms, rel=0.05)
    assert made.floor["x"] == pytest.approx(NOISE / rms, rel=0.15)


def test_the_initial_state_may_be_that_of_the_first_readings(folder):
    """The last half of the record is shifted: a start that all readings decide is off, one of the first is not."""
    record = np.loadtxt(folder / "decay.csv", delimiter=",", skiprows=1)
    record[2000:, 1] += START
    np.savetxt(folder / "decay.csv", record, delimiter=",", header="time,x", comments="")
    model, early = folder / "oscillator.yaml", slice(0, 2000)
    made = masking.simulate(model, folder / "decay.csv", columns={"t": "time"}, initial=2.0)
    assert made.residual[early].std() == pytest.approx(NOISE, rel=0.1)
    assert made.residual[2000:].mean() == pytest.approx(START, rel=0.01)
    with pytest.raises(DeclarationError, match=r"initial: 99 s do not hold 2 readings or more of the record; give"):
        masking.simulate(model, folder / "decay.csv", columns={"t": "time"}, initial=99.0)


def test_each_shooting_interval_has_its_own_initial_state(folder):
    """The last half of the record begins with another phase: two intervals leave the noise, one does not."""
    record = np.loadtxt(folder / "decay.csv", delimiter=",", skiprows=1)
    record[2000:, 1] *= -1.0
    np.savetxt(folder / "decay.csv", record, delimiter=",", header="time,x", comments="")
    given = folder / "oscillator.yaml", folder / "decay.csv"
    whole, halves = (masking.simulate(*given, columns={"t": "time"}, shooting_interval=one) for one in (None, 10.0))
    assert (whole.shooting_interval, halves.shooting_interval) == (None, 10.0)
    assert whole.chi["x"] > 20.0 * halves.chi["x"]
    assert halves.residual.std() == pytest.approx(NOISE, rel=0.05)
    for wrong, said in (
        ({"shooting_interval": 99.0}, "99 s do not hold"),
        ({"initial": 1.0}, "give only one of initial and"),
    ):
        with pytest.raises(DeclarationError, match=said):
            masking.simulate(*given, columns={"t": "time"}, **{"shooting_interval": 10.0, **wrong})


def test_a_wrong_model_is_said_in_a_sentence_a_table_and_a_page(folder, capsys):
    (folder / "oscillator.yaml").write_text(OSCILLATOR.replace("value: 12", "value: 12.6"))
    words = ["simulate", str(folder / "oscillator.yaml"), str(folder / "decay.csv"), "--map", "t=time"]
    assert cli.main([*words, "--out", str(folder / "out")]) == 0
    out = capsys.readouterr().out
    assert out.startswith("In the record the residual is above the noise floor")
    assert [line.split()[0] for line in out.splitlines()[1:]] == ["x", "error", "noise", "page:"]
    numbers = json.loads((folder / "out" / "simulation.json").read_text())
    assert numbers["chi"]["x"] > 10 * numbers["floor"]["x"]
    page = (folder / "out" / "simulation.html").read_text(encoding="utf-8")
    assert "the residual is above the noise floor" in page
    for name in ("simulation", "overview"):
        assert (folder / "out" / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_a_plant_file_brings_its_own_model(folder):
    (folder / "rig.yaml").write_text(
        "name: rig\nmodel: oscillator.yaml\nsensors: {x: {measures: x, gain: {value: 1, unit: m/m}, unit: m}}\n"
    )
    alone = masking.simulate(folder / "oscillator.yaml", folder / "decay.csv", columns={"t": "time"})
    rig = masking.simulate(folder / "rig.yaml", folder / "decay.csv", columns={"t": "time"})
    assert rig.chi["x"] == pytest.approx(alone.chi["x"], rel=1e-6)


def test_a_lag_of_a_sensor_begins_anywhere(folder):
    """The reading is the steady response of the lag to the decay, and a decay of its own that no motion explains."""
    t, tau, rate = np.arange(4000) / RATE, 0.5, W * (-Z + 1j * np.sqrt(1 - Z**2))
    read = (START * np.exp(rate * t) / (1 + rate * tau)).real + 2 * START * np.exp(-t / tau)
    read += NOISE * np.random.default_rng(0).standard_normal(len(t))
    np.savetxt(folder / "late.csv", np.column_stack([t, read]), delimiter=",", header="time,x", comments="")
    (folder / "rig.yaml").write_text(
        "name: rig\nmodel: oscillator.yaml\nsensors: {x: {measures: x, gain: {value: 1, unit: m/m}, unit: m}}\n"
        "effects: {lag: {effect: sensor_lag, at: x, parameters: {tau: 0.5}}}\n"
    )
    made = masking.simulate(folder / "rig.yaml", folder / "late.csv", columns={"t": "time"})
    assert made.residual.std() == pytest.approx(NOISE, rel=0.05)


def test_what_cannot_be_simulated_is_refused_with_the_remedy(folder):
    with pytest.raises(RecordError, match=r"there is no column .* name that with --plant \(in Python, plant=\)$"):
        masking.simulate("setup", folder / "decay.csv", columns={"t": "time"})
    with pytest.raises(RecordError, match="there is no column") as error:
        masking.simulate("setup", folder / "decay.csv", plant="tue_rig", columns={"t": "time"})
    assert "--plant" not in str(error.value)
    (folder / "oscillator.yaml").write_text(OSCILLATOR.replace("-w**2*x", "1e6*w**2*x"))
    with pytest.raises(ModelError, match=r"is not finite; check signs and units .*decay\.csv@0:1"):
        masking.simulate(folder / "oscillator.yaml", folder / "decay.csv", columns={"t": "time"})


def test_steps_between_samples_resolve_what_rest_does_not_show(tmp_path):
    """A mass flies through a gap between two springs, which it does not touch at rest: closed form."""
    w, gap, speed, rate = 800.0, 2e-3, 0.1, 2000.0
    t = np.arange(1000) / rate
    half = np.pi / w + gap / speed  # half a sine outside of the gap, and the way through it
    into = (t + 0.5 * gap / speed) % (2 * half)  # since the mass left one spring
    late = into % half
    inside = -gap / 2 + speed * late
    outside = gap / 2 + speed / w * np.sin(w * (late - gap / speed))
    x = np.where(late < gap / speed, inside, outside) * np.where(into < half, 1, -1)
    np.savetxt(tmp_path / "flight.csv", np.column_stack([t, x + 1e-6 * np.random.default_rng(0).standard_normal(1000)]))
    (tmp_path / "gap.yaml").write_text(f"""
name: gap
coordinates: {{x: position}}
equations: {{"x''": "-{w**2}*(x - min(max(x, -{gap / 2}), {gap / 2}))"}}
""")
    made = masking.simulate(tmp_path / "gap.yaml", tmp_path / "flight.csv", columns=["t", "x"])
    assert made.residual.std() == pytest.approx(1e-6, rel=0.1)


@pytest.mark.parametrize("parts", [(0.0, 0.99), (0.0, 1.0), (1.0, 1.0)], ids=["one in part", "one", "both"])
@pytest.mark.parametrize("start", [0.01, -0.01])
def test_sensors_without_sign_begin_on_either_side(tmp_path, start, parts):
    """At rest it reads next to nothing, so that a line through its first readings ends where the spring runs away."""
    times, first = np.arange(2000) / RATE, [0.004, start, 0.0, 0.0]

    def rates(t, y):
        between = 60.0 * (y[1] - y[0])
        return [y[2], y[3], -100.0 * y[0] + between - 0.2 * y[2], -80.0 * y[1] - between - 3e8 * y[1] ** 5 - 0.2 * y[3]]

    made = integrate.solve_ivp(rates, (0.0, times[-1]), first, t_eval=times, rtol=1e-10, atol=1e-13).y
    noise = NOISE * np.random.default_rng(1).standard_normal((2, len(times)))
    read = [(1.0 - part) * x + part * np.abs(x) for part, x in zip(parts, made[:2], strict=True)]
    table = np.column_stack([times, *(read + noise)])
    np.savetxt(tmp_path / "decay.csv", table, delimiter=",", header="t,s1,s2", comments="")
    (tmp_path / "model.yaml").write_text(
        "name: pair\n"
        "coordinates: {x1: {unit: m}, x2: {unit: m}}\n"
        "parameters:\n"
        "  a: {value: 100, unit: s**-2}\n"
        "  b: {value: 80, unit: s**-2}\n"
        "  c: {value: 60, unit: s**-2}\n"
        "  d: {value: 0.2, unit: 1/s}\n"
        "  k: {value: 3e8, unit: m**-4*s**-2}\n"
        "equations:\n"
        '  "x1\'\'": "-a*x1 + c*(x2 - x1) - d*x1\'"\n'
        '  "x2\'\'": "-b*x2 - c*(x2 - x1) - k*x2**5 - d*x2\'"\n'
    )
    (tmp_path / "rig.yaml").write_text(
        "name: rig\n"
        "model: model.yaml\n"
        "sensors:\n"
        "  s1: {measures: x1, gain: {value: 1, unit: m/m}, unit: m}\n"
        "  s2: {measures: x2, gain: {value: 1, unit: m/m}, unit: m}\n"
        "effects:\n"
        f"  first: {{effect: sensor_magnitude, at: s1, parameters: {{r: {parts[0]}}}}}\n"
        f"  second: {{effect: sensor_magnitude, at: s2, parameters: {{r: {parts[1]}}}}}\n"
    )
    found = masking.simulate(tmp_path / "rig.yaml", tmp_path / "decay.csv")
    assert found.residual.std(axis=0) == pytest.approx([NOISE, NOISE], rel=0.05)


PLAY = """
name: a mass that drags a slider
coordinates: {x: {unit: m}}
parameters:
  w: {value: 4, unit: rad/s}
  f: {value: 3e-3, unit: m/s**2}
  h: {value: 700, unit: 1/s}
  g: {value: 2e-3, unit: m}
  b: {value: 1e-5, unit: m}
states: {s: {unit: m, size: g}}
definitions: {beyond: "x - s - min(max(x - s, -g), g)"}
equations: {"x''": "-w**2*x - f*min(max(beyond/b, -1), 1)", "s'": "h*beyond"}
"""  # at rest the slider stands still; dragged, it follows faster than steps that suit the mass


def test_what_is_fast_only_in_motion_is_followed(tmp_path):
    (tmp_path / "play.yaml").write_text(PLAY)
    t = np.arange(900) / 37.0

    def slope(_, y):
        beyond = y[0] - y[2] - np.clip(y[0] - y[2], -2e-3, 2e-3)
        return [y[1], -16.0 * y[0] - 3e-3 * np.clip(beyond / 1e-5, -1.0, 1.0), 700.0 * beyond]

    found = integrate.solve_ivp(slope, (0.0, t[-1]), [0.02, 0.0, 0.018], "LSODA", t, rtol=1e-9, atol=1e-12)
    read = found.y[0] + 1e-6 * np.random.default_rng(0).standard_normal(len(t))
    np.savez(tmp_path / "dragged.npz", t=t, x=read)
    made = masking.simulate(tmp_path / "play.yaml", tmp_path / "dragged.npz")
    assert made.residual.std() == pytest.approx(1e-6, rel=0.2)


def test_a_mass_that_no_sensor_reads_does_not_run_away(tmp_path):
    """Two masses swing together, on a spring between them that gives way 30 mm apart; only one is read, 0.1 m away."""
    kept, between, reach = 100.0, 1000.0, 0.03

    def rates(_, y):
        d = y[0] - y[1]
        force = between * d * (1.0 - (d / reach) ** 4)
        return [y[2], y[3], -kept * y[0] - force, -1.1 * kept * y[1] + force]

    t, noise = np.arange(3000) / 500.0, 1e-5
    x = integrate.solve_ivp(rates, (0.0, t[-1]), [0.1, 0.095, 0.0, 0.1], t_eval=t, rtol=1e-10, atol=1e-12).y[0]
    np.savetxt(
        tmp_path / "read.csv", np.column_stack([t, x + noise * np.random.default_rng(0).standard_normal(len(t))])
    )
    (tmp_path / "pair.yaml").write_text(f"""
name: pair
coordinates: {{x: position, y: position of the other}}
definitions: {{force: "{between}*(x - y)*(1 - ((x - y)/{reach})**4)"}}
equations: {{"x''": "-{kept}*x - force", "y''": "-{1.1 * kept}*y + force"}}
""")
    (tmp_path / "rig.yaml").write_text("name: rig\nmodel: pair.yaml\nsensors: {x: {measures: x}}\n")
    made = masking.simulate(tmp_path / "rig.yaml", tmp_path / "read.csv", columns=["t", "x"])
    assert made.residual.std() == pytest.approx(noise, rel=0.1)
