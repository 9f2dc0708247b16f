"""What a motion asks of a rig, against closed forms and scaling laws; what remedies it, against a second simulation."""

import json
import math

import numpy as np
import pytest

from masking.app import cli
from masking.errors import DeclarationError, ModelError
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.feasibility import FASTER, SLOWER, Motion, evaluate, feasibility, mean_power
from masking.model.declaration.expression import Expression

M, K, GAIN, LENGTH = 2.0, 50.0, 4.0, 0.25  # kg, N/m, N/V, m
AMPLITUDE = 0.1  # m

RIG = """\
name: one oscillator
coordinates: {x: {unit: m}}
inputs: {u: {unit: V}}
parameters:
  m: {value: 2, unit: kg}
  k: {value: %(k)r, unit: N/m}
  c: {value: 4, unit: N/V}
equations: {m*x'': -k*x + c*u}
"""
PLANT = """\
name: one oscillator with limits
model: rig.yaml
sensors: {s: {measures: x, gain: {value: 1, unit: V/m}, unit: V}}
limits:
  inputs: {u: {max: %(most)r, unit: V}}
  coordinates: {x: {max: 200, unit: mm}}
  power: {value: 8, unit: W, heating: {value: 0.5, unit: W/V**2}, time: %(time)r}
"""
VIRTUAL = """\
name: another oscillator
coordinates: {y: {unit: m, initial: 0.1}}
parameters: {w: {value: %(w)r, unit: rad/s}}
equations: {y'': -w**2*y}
"""
EXPERIMENT = """\
name: one as the other
plant: plant.yaml
virtual: virtual.yaml
transform: {expressions: {y: %(map)s}}
controller: {rate: continuous}
initial: {y: %(initial)r}
time_scale: %(scale)r
duration: %(duration)r
"""

LINK = """\
name: link with one bending mode, clamped at its hub
coordinates: {hub: {unit: deg}, d: {unit: mm}}
inputs: {T: {unit: N*m}}
parameters:
  J: {value: 2e-3, unit: kg*m**2}
  m: {value: 65, unit: g}
  L: {value: 420, unit: mm}
  k: {value: 20, unit: N/m}
  c: {value: 0.02, unit: N*s/m}
equations:
  (J + m*L**2/3)*hub'' + 0.2845*m*L*d'': T
  0.25*m*d'' + 0.2845*m*L*hub'': -k*d - c*d'
"""
LINK_PLANT = """\
name: link
model: link.yaml
limits:
  inputs: {T: {max: 0.5, unit: N*m}}
  coordinates: {hub: {max: 90, unit: deg}, d: {max: 50, unit: mm}}
"""
SWING = """\
name: swing
coordinates: {y: {unit: deg, initial: 40}}
parameters: {w: {value: 4, unit: rad/s}}
equations: {y'': -w**2*y}
"""


@pytest.fixture
def link(tmp_path):
    """Return a function that writes an experiment in which a flexible link swings, and gives its path."""

    def make(output, duration=1.0):
        experiment = (
            f"name: swing\nplant: plant.yaml\nvirtual: virtual.yaml\nduration: {duration}\ncontroller: "
            f"{{rate: continuous}}\ntransform: {{expressions: {{y: {output}}}}}\n"
        )
        texts = {"link": LINK, "plant": LINK_PLANT, "virtual": SWING, "experiment": experiment}
        for name, text in texts.items():
            (tmp_path / f"{name}.yaml").write_text(text, encoding="utf-8")
        return tmp_path / "experiment.yaml"

    return make


@pytest.fixture
def write(tmp_path):
    """Return a function that writes an experiment with one oscillator, and gives its path."""

    def make(**changes):
        values = {"k": K, "most": 1e3, "time": 10.0, "w": 8.0, "map": "x", "scale": 1.0, "duration": 20.0}
        values |= {"initial": AMPLITUDE} | changes
        for name, text in (("rig", RIG), ("plant", PLANT), ("virtual", VIRTUAL), ("experiment", EXPERIMENT)):
            (tmp_path / f"{name}.yaml").write_text(text % values, encoding="utf-8")
        return tmp_path / "experiment.yaml"

    return make


def find(path):
    experiment = Experiment.load(path)
    experiment.validate()
    return feasibility(experiment)


def check(capsys, *arguments):
    status = cli.main(["check", *map(str, arguments)])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


@pytest.mark.parametrize("w", [2.0, 5.0, 8.0])
def test_voltage_stroke_and_mean_power_have_their_closed_form(write, w):
    # m x'' = -k x + c u with x = A cos(w t): u = (k - m w^2) A cos(w t) / c.
    found = find(write(w=w, time=0.5, duration=30.0))
    voltage = abs(K - M * w**2) * AMPLITUDE / GAIN
    assert found["u"].needed == pytest.approx(voltage, rel=1e-3, abs=1e-6)
    assert found["x"].needed == pytest.approx(1e3 * AMPLITUDE, rel=1e-4)  # mm
    assert found["x"].part == pytest.approx(0.5, rel=1e-4)
    # The mean of 0.5 u^2 settles at half its peak, with a ripple of a first-order filter at 2 w.
    ripple = 1.0 + 1.0 / math.hypot(1.0, 2.0 * w * 0.5)
    settled = 0.5 * voltage**2 / 2.0 * ripple
    assert found["mean power of u"].needed == pytest.approx(settled, rel=0.15, abs=1e-9)
    assert found["mean power of u"].needed >= settled * (1.0 - 1e-3)
    assert found.fits
    assert found.remedies == ()


def test_a_long_mean_power_is_half_the_square_of_the_peak(write):
    found = find(write(w=8.0, time=10.0, duration=100.0))
    assert found["mean power of u"].needed == pytest.approx(0.5 * found["u"].needed ** 2 / 2.0, rel=0.01)


def test_inertia_alone_asks_for_the_inverse_square_of_the_time_scale(write):
    needed = [find(write(k=0.0, scale=scale))["u"].needed for scale in (1.0, 2.0, 3.0)]
    assert needed[0] / needed[1] == pytest.approx(4.0, rel=1e-3)
    assert needed[0] / needed[2] == pytest.approx(9.0, rel=1e-3)


def test_a_tip_that_is_non_minimum_phase_is_refused_as_such(link):
    """With T eliminated, d moves by (1/4 - 0.2845) m d'' + c d' + k d = 0 while hub + d/L rests."""
    mass, stiffness, damping = 0.065, 20.0, 0.02
    growth = max(np.roots([(0.25 - 0.2845) * mass, damping, stiffness]).real)
    found = find(link("hub + d/0.42", duration=5.0))
    assert found.zero_dynamics[0].eigenvalues.real.max() == pytest.approx(growth, rel=1e-6)
    assert not found.fits
    assert found.verdict.endswith(
        "While the virtual coordinates follow, what is passive (d) grows: in these coordinates the rig is non-minimum "
        "phase. Mask others, whose zero dynamics are stable"
    )
    assert found["T"].used == "over 100000 %"
    assert "e+" not in str(found)
    assert find(link("hub", duration=5.0)).fits


@pytest.mark.parametrize("what", ["transform", "initial"])
def test_what_is_passive_begins_where_it_rests_beside_a_smaller_motion(link, what):
    """Half of a linear motion asks for half of everything."""
    motion = Motion(Experiment.load(link("hub")))
    whole, half = motion.uses(1001), motion.uses(1001, what, 0.5)
    assert [use.part for use in half] == pytest.approx([0.5 * use.part for use in whole], rel=1e-6)


def test_the_remedies_have_their_closed_form(write):
    # Needed at w = 8: |50 - 128| 0.1 / 4 = 1.95 V of 1 V.
    found = find(write(most=1.0))
    assert not found.fits
    time, transform, initial = found.remedies
    assert time.factor == pytest.approx(8.0 / math.sqrt((K + 40.0) / M), rel=1e-3)  # m w^2 - k = 40 N/m
    assert transform.factor == pytest.approx(1.0 / 1.95, rel=1e-3)
    assert initial.factor == pytest.approx(1.0 / 1.95, rel=1e-3)
    assert found.verdict == (
        "does not fit: u needs 195 % of 1 V. To fit: time_scale x 1.2 (a virtual system 1.2 times slower), "
        "or a transform that maps to 0.51 of the stroke, or initial values x 0.51"
    )


@pytest.mark.parametrize(
    "changed",
    [
        lambda remedies, way: {"scale": remedies[0].factor / way},
        lambda remedies, way: {"map": f"x/{remedies[1].factor * way}"},
        lambda remedies, way: {"initial": AMPLITUDE * remedies[2].factor * way},
    ],
    ids=["time_scale", "transform", "initial"],
)
def test_what_is_remedied_fits_and_2_per_cent_less_does_not(write, changed):
    remedies = find(write(most=1.0)).remedies
    assert find(write(most=1.0, **changed(remedies, 1.0))).fits
    assert not find(write(most=1.0, **changed(remedies, 1.02))).fits


def test_a_rig_too_stiff_for_a_slow_motion_is_told_to_be_faster(write):
    # u = (k - m w^2) A / c is 4.8 V, and tends to 5 V for a slower motion; 2 V are reached where k - m w^2 = 80 N/m.
    found = find(write(k=200.0, w=2.0, most=2.0))
    time = found.remedies[0]
    assert time.factor == pytest.approx(2.0 / math.sqrt((200.0 - 80.0) / M), rel=1e-3)
    assert "times faster" in str(time)


def test_no_time_scale_remedies_a_stroke_that_is_too_long(write):
    found = find(write(initial=0.5))
    assert found["x"].part == pytest.approx(2.5, rel=1e-4)
    time, transform, initial = found.remedies
    assert time.factor is None
    assert [use.label for use in time.left] == ["x"]
    assert str(time) == "another time_scale alone does not help: x needs 250 % of 200 mm even then"
    assert transform.factor == pytest.approx(0.4, rel=1e-3)
    assert initial.factor == pytest.approx(0.4, rel=1e-3)


def test_a_limit_cycle_is_not_made_smaller_by_its_initial_values(write, tmp_path):
    path = write(most=0.5, duration=60.0)
    (tmp_path / "virtual.yaml").write_text(
        "name: Van der Pol\ncoordinates: {y: {unit: m, initial: 0.1}}\n"
        "parameters: {w: {value: 8, unit: rad/s}, a: {value: 0.05, unit: m}, b: {value: 4, unit: 1/s}}\n"
        "equations: {y'': -w**2*y + b*(1 - (y/a)**2)*y'}\n",
        encoding="utf-8",
    )
    initial = find(path).remedies[2]
    assert initial.factor is None
    assert str(initial).startswith("smaller initial values alone do not help: u needs ")


def test_a_transform_that_becomes_singular_on_the_way_is_a_problem_with_its_place(write, capsys):
    path = write(map="x**2/0.1")  # y swings through 0, where dy/dx = 0
    with pytest.raises(DeclarationError) as caught:
        find(path)
    (problem,) = caught.value.problems
    assert problem.path == "transform"
    assert problem.place.line == 4
    status, out, _ = check(capsys, path)
    assert status == 2
    assert f"{path}:4:" in out
    assert "the transform or the decoupling matrix becomes singular on the way" in out
    assert "choose a transform that is invertible" in out


def test_a_virtual_system_that_blows_up_is_a_problem_with_its_place(write, tmp_path, capsys):
    path = write()
    (tmp_path / "virtual.yaml").write_text(
        "name: explosion\ncoordinates: {y: {unit: m, initial: 0.1}}\nparameters: {a: {value: 1000, unit: 1/(m*s**2)}}\n"
        "equations: {y'': a*y**2}\n",
        encoding="utf-8",
    )
    status, out, _ = check(capsys, path)
    assert status == 2
    assert "initial: the virtual motion cannot be followed to its end: " in out
    assert f"{path}:6:" in out


def test_without_limits_it_says_so(write, tmp_path, capsys):
    path = write()
    plant = (tmp_path / "plant.yaml").read_text(encoding="utf-8")
    (tmp_path / "plant.yaml").write_text(plant[: plant.index("limits:")], encoding="utf-8")
    with pytest.raises(ModelError, match=r"no largest command of u: write it under limits\.inputs, such as"):
        find(path)
    status, out, _ = check(capsys, path)
    assert status == 0
    assert "a sound experiment\n  whether it fits is unknown: " in out
    assert json.loads(check(capsys, path, "--json")[1])[0]["feasibility"] is None


def test_check_tells_the_table_and_the_verdict(write, capsys):
    status, out, _ = check(capsys, write())
    assert status == 0
    rows = [line.split() for line in out.splitlines()]
    assert ["needed", "limit", "used"] in rows
    assert ["x", "100", "mm", "200", "mm", "50", "%"] in rows
    assert out.splitlines()[-1] == "  fits: x needs 50 % of 200 mm at most"


def test_check_gives_status_1_for_what_does_not_fit_and_the_same_in_json(write, capsys):
    path = write(most=1.0)
    status, out, _ = check(capsys, path)
    assert status == 1
    assert "a sound experiment" in out
    assert "does not fit: u needs 195 % of 1 V" in out
    status, out, _ = check(capsys, path, "--json")
    assert status == 1
    (told,) = json.loads(out)
    assert told["problems"] == []
    fit = told["feasibility"]
    assert fit["fits"] is False
    assert [limit["name"] for limit in fit["limits"]] == ["u", "u", "x"]
    assert [limit["kind"] for limit in fit["limits"]] == ["command", "power", "coordinate"]
    assert fit["limits"][0]["used"] == pytest.approx(1.95, rel=1e-3)
    assert [remedy["change"] for remedy in fit["remedies"]] == ["time_scale", "transform", "initial"]
    assert fit["verdict"].startswith("does not fit: u needs 195 % of 1 V. To fit: time_scale x 1.2")


def test_check_says_on_stderr_that_it_compiles_and_once_only(write, capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("MASKING_CACHE", str(tmp_path / "cache"))
    path = write()
    assert "compiling; this takes some ten seconds" in check(capsys, path, "--json")[2]
    assert check(capsys, path)[2] == ""


def test_power_without_heating_is_noted(capsys):
    found = find("duffing")
    assert found.fits
    assert [use.kind for use in found.uses] == ["command"] * 3 + ["coordinate"] * 2
    assert "mean power is unknown: the plant file has no limits.power.heating" in str(found)


def test_the_mean_power_of_a_step_approaches_it_exponentially():
    times = np.linspace(0.0, 3.0, 301)
    found = mean_power(np.full(301, 2.0), times[1], 0.7)
    np.testing.assert_allclose(found, 2.0 * (1.0 - np.exp(-times / 0.7)), rtol=1e-12, atol=1e-15)


def test_an_expression_over_columns_is_that_over_numbers():
    x, v = np.linspace(-2.0, 2.0, 41), np.linspace(0.0, 1.0, 41)
    for text in ("x - v", "sqrt(x**2 + v)/k", "where(x > 0, log(x + 1), -x)", "min(x, v, k)", "abs(x)*sin(x')", "k"):
        columns = {"x": x, "v": v, "x'": x * v, "k": 3.0}
        expected = [
            Expression(text).evaluate(dict(zip(columns, row, strict=True)))
            for row in zip(x, v, x * v, [3.0] * 41, strict=True)
        ]
        np.testing.assert_array_equal(np.broadcast_to(evaluate(Expression(text), columns), 41), expected)


def test_the_ladders_begin_next_to_1():
    assert 1.0 < SLOWER[0] < 1.2
    assert 0.8 < FASTER[0] < 1.0
