"""What is declared in deg, mm and rpm comes back in them: columns, sweeps, trips, comparisons."""

import numpy as np
import pytest

from masking import Experiment, compare, sweep
from masking.analysis.stability.study import study
from masking.errors import DeclarationError
from masking.lab.plants.safety_chain import Chain
from masking.lab.records.recording import Recording
from masking.lab.runs import safety_limits
from masking.model.modelling.model import load_model
from masking.reports import run_report
from masking.reports.animation import Animation
from masking.reports.run_study import Study

FILES = {
    "model.yaml": """name: cart and pendulum
coordinates:
  x: {meaning: displacement of the cart, unit: mm}
  th: {meaning: angle of the pendulum, unit: deg}
inputs: {F: {unit: N}, T: {unit: N*mm}}
parameters:
  m: {value: 500, unit: g}
  k: {value: 0.02, unit: N/mm}
  J: {value: 0.01, unit: kg*m**2}
  kt: {value: 2, unit: N*mm/deg}
  l: {value: 100, unit: mm}
equations:
  m*x'': F - k*x
  J*th'': T - kt*th
drawing: [{arm: {pivot: [x, 0], length: l, angle: th}}]
""",
    "plant.yaml": """name: rig
model: model.yaml
sensors:
  enc: {measures: x, gain: {value: 1, unit: mm/mm}, unit: mm, range: [-60, 60]}
  ang: {measures: th, gain: {value: 1, unit: deg/deg}, unit: deg, range: [-90, 90]}
limits:
  inputs: {F: {max: 5, unit: N}, T: {max: 2000, unit: N*mm}}
  coordinates: {th: {max: 80, unit: deg}, x: {max: 50, unit: mm}}
  velocities: {th: {max: 100, unit: rpm}}
effects:
  noise: {effect: noise, at: [enc, ang], parameters: {sigma: 0.001}}
""",
    "virtual.yaml": """name: springs in mm and deg
coordinates:
  x: {unit: mm, initial: 10}
  th: {unit: deg, initial: 30}
states: {n: {unit: rpm, initial: 60}}
parameters:
  w: {value: 6, unit: rad/s}
  tau: {value: 800, unit: ms}
equations: {"x''": "-w**2*x", "th''": "-(w/2)**2*th", "n'": "-n/tau"}
""",
    "run.yaml": """name: degrees
plant: plant.yaml
virtual: virtual.yaml
controller: {rate: continuous}
duration: 8
""",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with an experiment in deg, mm and rpm."""
    made = tmp_path_factory.mktemp("degrees")
    for name, text in FILES.items():
        (made / name).write_text(text)
    return made


@pytest.fixture(scope="module")
def ran(folder):
    """Return the recording of its run, read from its file."""
    made = Experiment.load(folder / "run.yaml").run()
    made.save(folder / "result")
    return Recording.load(folder / "result")


def test_columns_are_in_the_declared_units(ran):
    t = ran.t
    truth = {
        "x": (10.0 * np.cos(6.0 * t), "mm"), "x'": (-60.0 * np.sin(6.0 * t), "mm/s"),
        "th": (30.0 * np.cos(3.0 * t), "deg"), "th'": (-90.0 * np.sin(3.0 * t), "deg/s"),
        "n": (60.0 * np.exp(-t / 0.8), "rpm"),
    }  # fmt: skip
    for prefix in ("rig", "virtual", "ideal"):
        for name, (values, unit) in truth.items():
            if f"{prefix}.{name}" in ran.columns:
                assert ran.units[f"{prefix}.{name}"] == unit
                np.testing.assert_allclose(ran[f"{prefix}.{name}"], values, atol=1e-6)
    # J*th'' = T - kt*th, so that T = (2 N mm/deg - 0.01 kg m^2 * 9/s^2 in N mm/deg) th.
    per_degree = 2.0 - 0.01 * 9.0 * np.deg2rad(1.0) * 1e3
    np.testing.assert_allclose(ran["input.T"], per_degree * truth["th"][0], atol=1e-4)
    assert ran.units["input.T"] == "N*mm"


def test_sums_of_mm_and_degrees_are_not_stated(ran):
    run = Study(ran)
    assert (run.sum_peak, run.anti_phase) == (None, None)
    assert run.no_sum == "x is in mm, th in deg; declare one unit for both"
    text = run_report.summary(ran)
    assert "sum        not given: x is in mm, th in deg; declare one unit for both" in text
    assert "come to rest" not in text  # 0.01 m are little beside 0.5 rad, and no rest


def test_a_drawing_and_its_traces(ran):
    scene = Animation(ran).scenes[0]
    assert scene.drawing.unit == "m"
    np.testing.assert_allclose(scene.sizes, [1e-3, np.pi / 180.0])
    data = Animation(ran).data()
    assert data["scenes"][0]["q"][1]["size"] == pytest.approx(np.deg2rad(30.0), rel=1e-6)
    traces = {line["name"]: (str(line["label"]), line["y"]["size"]) for line in data["traces"][0]["lines"]}
    assert traces["th"][0].endswith("(deg)")
    assert traces["th"][1] == pytest.approx(30.0, rel=1e-6)


def test_a_comparison(ran, folder):
    rows = {row.name: row.first for row in compare(folder / "result", folder / "result").measures}
    assert rows["rms of th (deg)"] == pytest.approx(30.0 / np.sqrt(2.0), rel=0.05)


def test_what_varies_and_what_is_measured_in_a_sweep(folder, tmp_path):
    names = ["maxima.th", "end.th", "end.n", "section.x@th'"]
    found = sweep(folder / "run.yaml", over={"th": [20, 40]}, measure=names, virtual=True, out=tmp_path, workers=1)
    np.testing.assert_allclose(found["end.th"], np.array([20.0, 40.0]) * np.cos(24.0), atol=1e-4)
    np.testing.assert_allclose(found["end.n"], 60.0 * np.exp(-10.0), atol=1e-6)
    np.testing.assert_allclose([one.max() for one in found["maxima.th"]], [20.0, 40.0], rtol=1e-3)
    assert found.facts["over"][0]["unit"] == "deg"
    assert found.as_dict()["units"] == dict(zip(names, ("deg", "deg", "rpm", "mm"), strict=True))
    assert "end.th 8.484 to 16.97 deg, median 12.73" in found.sentence


@pytest.mark.parametrize(
    ("measure", "virtual", "expected"),
    [
        ("peak", False, "peak: is no measure of these runs; F is in N, T is in N*mm: name one input, such as peak.F"),
        ("alpha", True,
         "alpha: is no measure of these runs; x is in mm, th is in deg: declare one unit for all oscillators"),
        ("chi.th", True, "chi.th: is no measure of these runs; the virtual system runs by itself, without a rig; leave "
         "--virtual out, or this measure"),
    ],
)  # fmt: skip
def test_measures_without_a_unit_are_refused(measure, virtual, expected, folder, tmp_path):
    with pytest.raises(DeclarationError) as caught:
        sweep(folder / "run.yaml", over={"th": [20]}, measure=[measure], virtual=virtual, out=tmp_path)
    assert str(caught.value) == expected


def test_the_end_of_one_oscillator(folder, tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    one = FILES["virtual.yaml"].replace("  th: {unit: deg, initial: 30}\n", "")
    (tmp_path / "virtual.yaml").write_text(one.replace(""" "th''": "-(w/2)**2*th",""", ""))
    with pytest.raises(DeclarationError) as caught:
        sweep(tmp_path / "run.yaml", over={"w": [6]}, measure=["end"], virtual=True, out=tmp_path / "out")
    assert str(caught.value) == (
        "end: is no measure of these runs; it compares two oscillators, and there is one, x; end.x is the value of x "
        "at the end"
    )


@pytest.mark.parametrize(
    ("readings", "unit", "expected"),
    [
        ((60.0, 0.0), "mm", "SENSOR_RANGE: the reading of enc is 60 mm, at or beyond the end of its range, 60 mm; "),
        ((0.0, 81.0), "deg", "POSITION_LIMIT: th is 81 deg, beyond its limit of 80.01 deg; "),
    ],
)
def test_trips(folder, readings, unit, expected):
    experiment = Experiment.load(folder / "run.yaml")
    chain = Chain(safety_limits.limits(experiment.instruments, 500.0))
    assert chain.watch(0, np.zeros(2)) is None
    trip = chain.watch(1, np.array(readings))
    assert str(trip).startswith(f"tick 1: {expected}")
    assert trip.as_dict()["unit"] == unit


def test_a_trip_of_a_speed(folder):
    experiment = Experiment.load(folder / "run.yaml")
    chain = Chain(safety_limits.limits(experiment.instruments, 500.0))
    speed = 2.0 * 100.0 * 360.0 / 60.0  # deg/s: twice the limit
    trips = (chain.watch(i, np.array([0.0, -40.0 + speed * i / 500.0])) for i in range(30))
    trip = next(one for one in trips if one is not None)
    said = "VELOCITY_LIMIT: the rate of th is 200 rpm, beyond its limit of 100 rpm"
    assert str(trip).partition(": ")[2].startswith(said)


def test_equilibria_and_the_box(tmp_path):
    (tmp_path / "m.yaml").write_text("""name: pendulum
coordinates: {th: {unit: deg, initial: 30}}
parameters: {w: {value: 60, unit: rpm}, z: {value: 0.02}}
equations: {"th''": "-w**2*sin(th) - 2*z*w*th'"}
energy: th'**2/2 + w**2*(1 - cos(th))
""")
    found = study(load_model(tmp_path / "m.yaml"), {"th": (-90.0, 200.0)})
    assert str(found.rest) == "2 equilibria in the box th in [-90, 200 deg], and no other (proved)"
    assert [point.words for point in found.rest.points] == ["th = 0 deg", "th = 180 deg"]
    content = found.as_dict()["equilibria"]
    assert content["units"] == {"th": "deg"}
    assert [point["position"]["th"] for point in content["points"]] == pytest.approx([0.0, 180.0])
    assert "equilibrium (th = 180 deg): unstable" in str(found.certificate)
