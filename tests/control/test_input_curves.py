"""Inputs that act nonlinearly: values by closed form, and motions beside those of scipy."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

from masking import Experiment
from masking.errors import CommandError, DeclarationError, ModelError, UnreachableError
from masking.lab.runs.feasibility import feasibility
from masking.model.declaration import schema
from masking.model.modelling.model import Model

EXACT = 1e-8
# About a middle m, a limit cycle, a hardening spring with a periodic force, or a pendulum.
WANTED = """
name: wanted
coordinates: {x: {unit: m, initial: 0.011, initial_velocity: 0.02}}
parameters:
  m: {value: 0.01, unit: m}
  a: {value: 0, unit: 1/s**2}
  b: {value: 0, unit: 1/m**2/s**2}
  c: {value: 0, unit: 1/s}
  d: {value: 0, unit: m/s**2}
  f: {value: 0, unit: m/s**2}
  w: {value: 7, unit: rad/s}
  l: {value: 0.002, unit: m}
equations:
  x'': -a*(x - m) - b*(x - m)**3 - c*(((x - m)/l)**2 - 1)*x' - d*sin((x - m)/l) + f*cos(w*t)
"""
KINDS = {
    "Van der Pol": {"a": 40, "c": 4},
    "Duffing": {"a": 20, "b": 3e6, "f": 0.04},
    "pendulum": {"d": 0.08},
}


def wanted(t, y, *, a=0, b=0, c=0, d=0, f=0):
    e, v = y[0] - 0.01, y[1]
    return [v, -a * e - b * e**3 - c * ((e / 0.002) ** 2 - 1) * v - d * np.sin(e / 0.002) + f * np.cos(7 * t)]


RIGS = {  # degree, largest input, and the rig
    "magnet": (
        2,
        "5, unit: A",
        """
coordinates: {x: {meaning: gap, unit: m, initial: 0.01}}
inputs: {u: {meaning: current, unit: A}}
parameters:
  m: {value: 0.5, unit: kg}
  C: {value: 1e-4, unit: N*m**2/A**2}
  g: {value: 9.81, unit: m/s**2}
equations: {x'': g - C*u**2/(m*x**2)}
""",
    ),
    "thrust that lags": (
        3,
        "900, unit: rad/s",
        """
coordinates: {x: {meaning: height, unit: m}}
states: {F: {meaning: thrust, unit: N, initial: 4.9}}
inputs: {u: {meaning: speed, unit: rad/s}}
parameters:
  m: {value: 0.5, unit: kg}
  c: {value: 2e-5, unit: N*s**2/rad**2}
  g: {value: 9.81, unit: m/s**2}
  tau: {value: 0.08, unit: s}
equations: {x'': F/m - g, F': (c*u**2 - F)/tau}
""",
    ),
    "saturating amplifier": (
        2,
        "20, unit: V",
        """
coordinates: {x: {unit: m}}
inputs: {u: {unit: V}}
parameters:
  m: {value: 0.5, unit: kg}
  k: {value: 20, unit: N/m}
  F: {value: 3, unit: N}
  s: {value: 5, unit: V}
equations: {x'': (F*tanh(u/s) - k*x)/m}
""",
    ),
    "drag of a fin": (
        2,
        "3, unit: m/s",
        """
coordinates: {x: {unit: m}}
inputs: {u: {meaning: speed of the fin, unit: m/s}}
parameters: {m: {value: 0.5, unit: kg}, k: {value: 20, unit: N/m}, c: {value: 0.6, unit: N*s**2/m**2}}
equations: {x'': (c*abs(u)*u - k*x)/m}
""",
    ),
    "table of an amplifier": (
        2,
        "10, unit: V",
        """
coordinates: {x: {unit: m}}
inputs: {u: {unit: V}}
parameters: {m: {value: 0.5, unit: kg}, k: {value: 20, unit: N/m}, F: {value: 1, unit: N}, V: {value: 1, unit: V}}
equations:
  x'': (F*interpolate_monotone(u/V, -20, -3, -5, -2, -1, -0.1, 0, 0, 2, 0.4, 6, 2.1, 20, 3) - k*x)/m
""",
    ),
    "valve": (
        3,
        "0.002, unit: m",
        """
coordinates: {x: {unit: m}}
states: {p: {meaning: pressure of the load, unit: Pa}}
inputs: {u: {meaning: opening, unit: m}}
parameters:
  m: {value: 20, unit: kg}
  k: {value: 2e4, unit: N/m}
  A: {value: 5e-4, unit: m**2}
  s: {meaning: supply, value: 5e6, unit: Pa}
  c: {value: 3e-5, unit: m**2/s/Pa**0.5}
  e: {value: 1e11, unit: Pa/m**3}
equations: {x'': (A*p - k*x)/m, p': e*(c*u*sqrt(s - sign(u)*p) - A*x')}
""",
    ),
}


def written(folder, name):
    _, largest, model = RIGS[name]
    (folder / "model.yaml").write_text(f"name: rig\n{model}")
    (folder / "wanted.yaml").write_text(WANTED)
    (folder / "plant.yaml").write_text(f"name: rig\nmodel: model.yaml\nlimits: {{inputs: {{u: {{max: {largest}}}}}}}\n")
    (folder / "run.yaml").write_text("name: run\nplant: plant.yaml\nvirtual: wanted.yaml\nduration: 5\n")


@pytest.mark.parametrize("name", RIGS)
def test_ideal_rigs_move_as_scipy_integrates_what_is_wanted(tmp_path, name):
    written(tmp_path, name)
    for changes in KINDS.values():
        experiment = Experiment.load(tmp_path / "run.yaml", changes=changes)
        assert experiment.law.degrees == (RIGS[name][0],)
        made = experiment.run()
        settings = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-15, "t_eval": made.t}
        x = solve_ivp(lambda t, y, p=changes: wanted(t, y, **p), (0, 5), [0.011, 0.02], **settings).y[0]
        assert np.linalg.norm(made["rig.x"] - x) <= EXACT * np.linalg.norm(x)


SENSING = """
sensors: {encoder: {measures: x, gain: {value: 1000, unit: mm/m}, unit: mm}}
effects:
  noise: {effect: noise, at: encoder, parameters: {sigma: 0.001}}
  steps: {effect: quantisation, at: encoder, parameters: {step: 0.001}}
  delay: {effect: delay, parameters: {samples: 1}}
"""


@pytest.mark.parametrize(("name", "most"), [("magnet", 0.001), ("thrust that lags", 0.015), ("valve", 0.005)])
def test_such_a_rig_is_masked_from_its_encoder(tmp_path, name, most):
    """At 1 kHz, with noise of a micrometre and a sample of delay."""
    written(tmp_path, name)
    with (tmp_path / "plant.yaml").open("a") as file:
        file.write(SENSING)
    settings = {"rate": "1 kHz", **({"homing": 1} if name == "valve" else {})}
    for changes in KINDS.values():
        found = Experiment.load(tmp_path / "run.yaml", changes=changes)
        made = found.changed(controller=settings, initial={"x'": 0}).run()
        assert made.manifest["masking_error"]["x"] <= most


def test_a_force_that_the_magnet_cannot_make_stops_the_run_with_its_cause(tmp_path):
    """A ball that shall fall faster than it can: no current pushes."""
    written(tmp_path, "magnet")
    falling = Experiment.load(tmp_path / "run.yaml", changes={"d": -20})
    cause = r"no u gives what is wanted of u\*\*2, which has one sign on its branch: the rig cannot do what is "
    cause += "wanted of it, "
    with pytest.raises(UnreachableError, match=cause + r"at t = 0.001\d* \(x = 0.011"):
        falling.run()
    with pytest.raises(DeclarationError, match="virtual: the virtual motion asks for what no input gives: no u gives"):
        feasibility(falling)
    step = falling.controller()
    with pytest.raises(CommandError, match=cause + "at t = 0.1 s; look at what it was given"):
        step(0.1, [0.012, 0.0])
    with (tmp_path / "plant.yaml").open("a") as file:
        file.write(SENSING)
    sampled = Experiment.load(tmp_path / "run.yaml", changes={"d": -20})
    sampled = sampled.changed(controller={"rate": "1 kHz"}, initial={"x'": 0})
    with pytest.raises(UnreachableError, match=cause):
        sampled.run()
    step = sampled.controller()
    with pytest.raises(CommandError, match=cause + r"at sample -?\d; look at what it was given"):
        [step([12.0]) for _ in range(9)]


def test_a_current_beyond_the_limit_is_cut_off_there(tmp_path):
    """1.21 A lift the ball at 11 mm, and 1.6 A as fast as it is wanted."""
    written(tmp_path, "magnet")
    plant = (tmp_path / "plant.yaml").read_text().replace("max: 5", "max: 2.5")
    (tmp_path / "plant.yaml").write_text(plant + SENSING)
    found = Experiment.load(tmp_path / "run.yaml", changes={"d": 5})
    made = found.changed(controller={"rate": "1 kHz"}, initial={"x'": 0, "x": 0.0115}, duration=0.1).run()
    assert np.max(made["demanded.u"]) > 2.5 == np.max(made["input.u"])


def test_a_force_beyond_a_curve_is_cut_off_at_the_limit(tmp_path):
    """A saturating amplifier that would have to push with more than it can: as any input beyond its limit."""
    written(tmp_path, "saturating amplifier")
    with (tmp_path / "plant.yaml").open("a") as file:
        file.write(SENSING)
    found = Experiment.load(tmp_path / "run.yaml", changes={"a": 2000})
    made = found.changed(controller={"rate": "1 kHz"}, initial={"x'": 0, "x": 0.02}, duration=0.2).run()
    assert np.max(np.abs(made["input.u"])) == 20 < np.max(np.abs(made["demanded.u"])) <= 40


def test_a_table_that_is_flat_at_its_ends_does_not_turn(tmp_path):
    written(tmp_path, "table of an amplifier")
    model = (tmp_path / "model.yaml").read_text()
    flat = model.replace("20, 3)", "10, 3, 20, 3)").replace("-20, -3,", "-20, -3, -10, -3,")
    (tmp_path / "model.yaml").write_text(flat)
    made = Experiment.load(tmp_path / "run.yaml", changes=KINDS["pendulum"]).run()
    assert made.manifest["masking_error"]["x"] <= EXACT


def test_inputs_of_one_bracket_are_told_apart():
    """Two propellers: their thrusts add, and their difference turns."""
    content = {"name": "rig", "coordinates": {"z": "", "ph": ""}, "inputs": {"u": "", "w": ""}}
    content["equations"] = {"z''": "3*(u**2 + w**2)*cos(ph) - 9", "ph''": "2*(w**2 - u**2)"}
    model = Model(schema.ModelDeclaration.model_validate(content))
    e, (_, ph) = model.affine.equations, model.equations.symbols.q
    assert e.input_force.tolist() == [[3 * sp.cos(ph), 3 * sp.cos(ph)], [-2, 2]]


def declared(equation):
    content = {"name": "rig", "coordinates": {"x": ""}, "inputs": {"u": "", "w": ""}, "equations": {"x''": equation}}
    return Model(schema.ModelDeclaration.model_validate(content))


REFUSED = {
    "u*w + u": r"u acts together with w in the equation of x, by u\*w \+ u; masking needs what each",
    "u*x'' + w": "u multiplies an acceleration; masking needs inputs that add to forces",
}


@pytest.mark.parametrize("equation", REFUSED)
def test_inputs_that_act_together_are_refused(equation):
    with pytest.raises(ModelError, match=REFUSED[equation]):
        _ = declared(equation).affine.equations.force


def test_an_input_with_two_curves_is_refused():
    content = {"name": "rig", "coordinates": {"x": "", "y": ""}, "inputs": {"u": ""}}
    content["equations"] = {"x''": "u**2 - x", "y''": "u"}
    model = Model(schema.ModelDeclaration.model_validate(content))
    with pytest.raises(
        ModelError, match=r"the equation of y holds u in u, and the equation of x in u\*\*2; masking needs"
    ):
        _ = model.affine.equations.force


def test_a_curve_that_turns_within_the_limit_is_refused(tmp_path):
    written(tmp_path, "saturating amplifier")
    model = (tmp_path / "model.yaml").read_text()
    (tmp_path / "model.yaml").write_text(model.replace("tanh(u/s)", "sin(u/s)"))
    with pytest.raises(
        ModelError, match=r"sin\(u/s\) neither rises nor falls all the way from u = 0 to 40 or to -40 \(SI\), 2"
    ):
        Experiment.load(tmp_path / "run.yaml").run()


def test_without_a_limit_it_is_asked_for(tmp_path):
    written(tmp_path, "magnet")
    (tmp_path / "plant.yaml").write_text("name: rig\nmodel: model.yaml\n")
    with pytest.raises(ModelError, match=r"no largest command of u: write it under limits\.inputs"):
        Experiment.load(tmp_path / "run.yaml").run()
