"""Rigs whose inputs act through dynamics of their own: degrees by hand, and motions beside those of scipy."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson, solve_ivp

from masking import Experiment
from masking.control.law import Controller
from masking.control.relative_degree import relative_degrees
from masking.control.transform import Transform
from masking.errors import ActuationError, DeclarationError, ModelError
from masking.model.declaration import schema
from masking.model.modelling.model import Model

EXACT = 1e-8


def rig(motion, states=()):
    content = {"name": "rig", "coordinates": dict.fromkeys(motion, ""), "inputs": {"u": ""}}
    content |= {"states": {name: "" for name, _ in states}} if states else {}
    content["equations"] = {f"{c}''": right for c, right in motion.items()} | {f"{n}'": r for n, r in states}
    return Model(schema.ModelDeclaration.model_validate(content))


def one(name):
    content = {"name": "wanted", "coordinates": {name: ""}, "equations": {f"{name}''": f"-{name}"}}
    return Model(schema.ModelDeclaration.model_validate(content))


DEGREES = {  # by hand
    "force": (rig({"b": "u - b"}), 2),
    "spring": (rig({"a": "u - (a - b)", "b": "a - b"}), 4),
    "damper": (rig({"a": "u - (a' - b')", "b": "a' - b'"}), 3),
    "two springs": (rig({"a": "u - (a - c)", "c": "a - 2*c + b", "b": "c - b"}), 6),
    "lagged force": (rig({"b": "i - b"}, [("i", "u - i")]), 3),
    "two lags": (rig({"b": "i - b"}, [("i", "j - i"), ("j", "u - j")]), 4),
    "square of an input that lags": (rig({"b": "i - b"}, [("i", "u**2 - i")]), 3),
    "force and lagged force": (rig({"b": "i + 2*u - b"}, [("i", "u - i")]), 2),
}


@pytest.mark.parametrize("kind", DEGREES)
def test_degrees(kind):
    model, degree = DEGREES[kind]
    assert relative_degrees(model, Transform(model, one("b"), schema.Transform())) == (degree,)


def test_what_an_input_never_reaches_is_said():
    model = rig({"a": "u - a", "b": "-b**3"})
    with pytest.raises(ActuationError, match=r"\. No input ever appears in b$"):
        relative_degrees(model, Transform(model, one("b"), schema.Transform()))


# Ideal rigs in continuous time. What is wanted is one equation with several parameters, so that a rig is compiled once.

WANTED = """
    name: wanted
    coordinates: {x: {unit: m, initial: 0.01, initial_velocity: 0.05}}
    parameters:
      a: {value: 0, unit: 1/s**2}
      b: {value: 0, unit: 1/m**2/s**2}
      c: {value: 0, unit: 1/s}
      d: {value: 0, unit: m/s**2}
      f: {value: 0, unit: m/s**2}
      w: {value: 7, unit: rad/s}
      l: {value: 0.02, unit: m}
    equations: {x'': -a*x - b*x**3 - c*((x/l)**2 - 1)*x' - d*sin(x/l) + f*cos(w*t)}
"""
KINDS = {
    "Van der Pol": {"a": 40, "c": 4},
    "Duffing": {"a": -20, "b": 3e5, "f": 0.4},
    "pendulum": {"d": 0.8},
}


def wanted(t, y, *, a=0, b=0, c=0, d=0, f=0):
    x, v = y
    turn = c * ((x / 0.02) ** 2 - 1) * v + d * np.sin(x / 0.02)
    return [v, -a * x - b * x**3 - turn + f * np.cos(7 * t)]


RIGS = {
    "voice coil driven by voltage": """
        coordinates: {x: {unit: m}}
        states: {i: {meaning: current, unit: A}}
        inputs: {u: {unit: V}}
        parameters:
          m: {value: 0.5, unit: kg}
          k: {value: 200, unit: N/m}
          b: {value: 1.5, unit: N*s/m}
          K: {value: 8, unit: N/A}
          R: {value: 4, unit: ohm}
          L: {value: 0.02, unit: H}
        equations: {x'': (K*i - k*x - b*x')/m, i': (u - R*i - K*x')/L}
    """,
    "force behind a current loop that lags": """
        coordinates: {x: {unit: m}}
        states: {i: {meaning: current, unit: A}}
        inputs: {u: {unit: A}}
        parameters:
          m: {value: 0.5, unit: kg}
          k: {value: 200, unit: N/m}
          K: {value: 8, unit: N/A}
          tau: {value: 0.01, unit: s}
        equations: {x'': (K*i - k*x)/m, i': (u - i)/tau}
    """,
    "hydraulic cylinder": """
        coordinates: {x: {unit: m}}
        states:
          f: {meaning: force of the actuator, unit: N}
          q: {meaning: flow, unit: N/s}
          r: {meaning: rate of the flow, unit: N/s**2}
        inputs: {u: {unit: m}}
        parameters:
          m: {value: 29.13, unit: kg}
          k: {value: 1190e3, unit: N/m}
          c: {value: 114.2, unit: N*s/m}
          a2: {value: 4.2297e6, unit: N/m}
          a3: {value: 3.3, unit: 1/s}
          b1: {value: 425, unit: 1/s}
          b2: {value: 9.9976e4, unit: 1/s**2}
          g: {value: 2.1283e13, unit: N/m/s**3}
        equations:
          x'': (f - k*x - c*x')/m
          f': q - a3*f - a2*x'
          q': r
          r': g*(u - x) - b1*r - b2*q
    """,
    "mass behind a hardening spring": """
        coordinates: {x: {unit: m}, y: {unit: m}}
        inputs: {u: {unit: N}}
        parameters:
          m: {value: 0.5, unit: kg}
          k: {value: 200, unit: N/m}
          h: {value: 3e4, unit: N/m**3}
          b: {value: 1.5, unit: N*s/m}
        equations:
          x'': (-k*(x - y) - h*(x - y)**3 - b*x')/m
          y'': (u - k*(y - x) - h*(y - x)**3 - b*y')/m
    """,
}
ORDERS = dict(zip(RIGS, (3, 3, 5, 4), strict=True))


def written(tmp_path, model, virtual=WANTED, **sections):
    (tmp_path / "model.yaml").write_text("name: rig\n" + "\n".join(line[8:] for line in model.splitlines()))
    (tmp_path / "wanted.yaml").write_text("\n".join(line[4:] for line in virtual.splitlines()))
    (tmp_path / "plant.yaml").write_text("name: rig\nmodel: model.yaml\n")
    (tmp_path / "run.yaml").write_text("name: run\nplant: plant.yaml\nvirtual: wanted.yaml\nduration: 5\n")
    found = Experiment.load(tmp_path / "run.yaml")
    return found.changed(**sections) if sections else found


@pytest.mark.parametrize("name", RIGS)
def test_ideal_rigs_move_as_scipy_integrates_what_is_wanted(tmp_path, name):
    written(tmp_path, RIGS[name])
    for changes in KINDS.values():
        experiment = Experiment.load(tmp_path / "run.yaml", changes=changes)
        assert experiment.law.degrees == (ORDERS[name],)
        made = experiment.run()
        settings = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-15, "t_eval": made.t}
        x = solve_ivp(lambda t, y, p=changes: wanted(t, y, **p), (0, 5), [0.01, 0.05], **settings).y[0]
        assert np.linalg.norm(made["rig.x"] - x) <= EXACT * np.linalg.norm(x)
        assert made.manifest["masking_error"]["x"] <= EXACT


# Stored energy and the power that changes it, momentum and the force that does, from columns of a recording.
BALANCES = {
    "voice coil driven by voltage": (
        lambda x, v, r: (
            0.25 * v**2 + 100 * x**2 + 0.01 * r["rig.i"] ** 2,
            r["input.u"] * r["rig.i"] - 4 * r["rig.i"] ** 2 - 1.5 * v**2,
        ),
        lambda x, v, r: (0.5 * v, 8 * r["rig.i"] - 200 * x - 1.5 * v),
    ),
    "force behind a current loop that lags": (
        lambda x, v, r: (0.25 * v**2 + 100 * x**2, 8 * r["rig.i"] * v),
        lambda x, v, r: (0.5 * v, 8 * r["rig.i"] - 200 * x),
    ),
    "hydraulic cylinder": (
        lambda x, v, r: (29.13 / 2 * v**2 + 595e3 * x**2, r["rig.f"] * v - 114.2 * v**2),
        lambda x, v, r: (29.13 * v, r["rig.f"] - 1190e3 * x - 114.2 * v),
    ),
    "mass behind a hardening spring": (
        lambda x, v, r: (
            0.25 * (v**2 + r["rig.y'"] ** 2) + 100 * (x - r["rig.y"]) ** 2 + 0.75e4 * (x - r["rig.y"]) ** 4,
            r["input.u"] * r["rig.y'"] - 1.5 * (v**2 + r["rig.y'"] ** 2),
        ),
        lambda x, v, r: (0.5 * (v + r["rig.y'"]), r["input.u"] - 1.5 * (v + r["rig.y'"])),
    ),
}


@pytest.mark.parametrize("name", RIGS)
def test_power_and_momentum_are_balanced(tmp_path, name):
    """The spring between two masses pushes both, and no force or power is left out of what is recorded."""
    written(tmp_path, RIGS[name])
    found = Experiment.load(tmp_path / "run.yaml", changes=KINDS["Van der Pol"]).changed(record={"rate": "4 kHz"})
    made = found.run()
    for balance in BALANCES[name]:
        stored, given = balance(made["rig.x"], made["rig.x'"], made)
        flown = cumulative_simpson(given, x=made.t, initial=0)
        assert np.ptp(stored) > 0
        np.testing.assert_allclose(stored - stored[0], flown, atol=1e-6 * np.max(np.abs(flown)))


ARM = """
        coordinates: {a: {unit: rad}, b: {unit: rad}, p: {unit: rad}, q: {unit: rad}}
        inputs: {T1: {unit: N*m}, T2: {unit: N*m}}
        parameters:
          m: {value: 0.8, unit: kg}
          l: {value: 0.3, unit: m}
          g: {value: 9.81, unit: m/s**2}
          J: {value: 0.01, unit: kg*m**2}
          k: {value: 60, unit: N*m}
        lagrangian: >-
          m*l**2*(a'**2 + (a' + b')**2/2 + a'*(a' + b')*cos(b)) + m*g*l*(2*cos(a) + cos(a + b))
          + J*(p'**2 + q'**2)/2 - k*((p - a)**2 + (q - b)**2)/2
        forces: {p: T1, q: T2}
"""
MIXED = """
        coordinates: {a: {unit: rad}, b: {unit: rad}}
        states: {i: {unit: A, meaning: current}}
        inputs: {u: {unit: V}, F: {unit: N*m}}
        parameters:
          m: {value: 0.5, unit: kg*m**2}
          k: {value: 200, unit: N*m}
          K: {value: 8, unit: N*m/A}
          R: {value: 4, unit: ohm}
          L: {value: 0.02, unit: H}
        equations:
          a'': (K*i - k*(a - b))/m
          b'': (F - k*(b - a) + 0.2*K*i)/m
          i': (u - R*i - K*(a' - b'))/L
"""
COUPLED = """
    name: coupled
    coordinates: {a: {unit: rad, initial: 0.5}, b: {unit: rad, initial: -0.3, initial_velocity: 1}}
    parameters:
      w: {value: 5, unit: rad/s}
      c: {value: 4, unit: 1/s**2}
      h: {value: 30, unit: 1/s**2}
      v: {value: 1, unit: 1/s}
    equations:
      a'': -w**2*a - c*(a - b) - h*a**3
      b'': -2*w**2*sin(b) - c*(b - a) - v*(b**2 - 0.3)*b'
"""


@pytest.mark.parametrize(("model", "degrees"), [(ARM, (4, 4)), (MIXED, (3, 2))], ids=["arm", "mixed"])
def test_several_coordinates_with_degrees_of_their_own(tmp_path, model, degrees):
    experiment = written(tmp_path, model, COUPLED)
    assert experiment.law.degrees == degrees
    made = experiment.run()

    def rates(t, y):
        a, b, va, vb = y
        away = -50 * np.sin(b) - 4 * (b - a) - (b**2 - 0.3) * vb
        return [va, vb, -25 * a - 4 * (a - b) - 30 * a**3, away]

    settings = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14, "t_eval": made.t}
    found = solve_ivp(rates, (0, 5), [0.5, -0.3, 0, 1], **settings).y
    for name, x in zip("ab", found, strict=False):
        assert np.linalg.norm(made[f"rig.{name}"] - x) <= EXACT * np.linalg.norm(x)


AIRCRAFT = """
        coordinates: {a: {unit: m}, b: {unit: m}, th: {unit: rad}}
        inputs: {F: {unit: N}, T: {unit: N*m}}
        parameters: {m: {value: 0.5, unit: kg}, J: {value: 0.02, unit: kg*m**2}, g: {value: 9.81, unit: m/s**2}}
        equations: {a'': -F*sin(th)/m, b'': F*cos(th)/m - g, th'': T/J}
"""
FLOWN = """
    name: coupled
    coordinates: {a: {unit: m, initial: 0.5}, b: {unit: m, initial: -0.3, initial_velocity: 1}}
    parameters: {w: {value: 2, unit: rad/s}, c: {value: 1, unit: 1/s**2}, h: {value: 3, unit: 1/m**2/s**2}}
    equations:
      a'': -w**2*a - c*(a - b) - h*a**3
      b'': -w**2*b - c*(b - a)
"""


def test_an_aircraft_needs_integrators_before_its_thrust(tmp_path):
    """Thrust acts along one direction at once: what turns the aircraft appears with it behind two integrators."""
    with pytest.raises(
        ActuationError, match="integrators before F may let the others appear: declare F as an internal"
    ):
        written(tmp_path, AIRCRAFT, FLOWN).validate()
    states = (
        "states: {F: {unit: N, meaning: thrust, initial: 4.905}, G: {unit: N/s, meaning: its rate}}\n        inputs:"
    )
    extended = AIRCRAFT.replace("inputs:", states).replace("F: {unit: N},", "u: {unit: N/s**2},", 1)
    experiment = written(tmp_path, extended.replace("T/J}", "T/J, F': G, G': u}"), FLOWN)
    assert experiment.law.degrees == (4, 4)
    made = experiment.run()

    def rates(t, y):
        a, b, va, vb = y
        return [va, vb, -4 * a - (a - b) - 3 * a**3, -4 * b - (b - a)]

    settings = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14, "t_eval": made.t}
    for name, x in zip("ab", solve_ivp(rates, (0, 5), [0.5, -0.3, 0, 1], **settings).y, strict=False):
        assert np.linalg.norm(made[f"rig.{name}"] - x) <= EXACT * np.linalg.norm(x)


def test_the_rig_comes_to_the_wanted_accelerations_with_the_bandwidth(tmp_path):
    """A current that is off decays at the bandwidth, for a virtual system without damping: e' = -w e by hand."""
    experiment = written(tmp_path, RIGS["voice coil driven by voltage"], controller={"actuator_bandwidth": 30})
    loop, state = experiment.loop, np.array([0.004, -0.03, 0.2])
    p, dy, u = loop.values(), np.empty(3), np.zeros(1)

    def off(y):
        out = np.empty(1)
        loop.kernels.off(0.0, y[:1].copy(), y[1:].copy(), p, out)
        return out[0]

    loop.kernels.derivative(0.0, state, u, p, dy)
    step = 1e-6
    slope = (off(state + step * dy) - off(state - step * dy)) / (2 * step)
    assert off(state) == pytest.approx((8 * 0.2 - 200 * 0.004 + 1.5 * 0.03) / 0.5, rel=1e-12)  # wanted is 0
    assert slope == pytest.approx(-30 * off(state), rel=1e-6)


def test_a_propeller_pushes_with_the_square_of_a_speed_that_lags(tmp_path):
    arm = """
        coordinates: {x: {unit: rad}}
        states: {w: {meaning: speed of the propeller, unit: rad/s, initial: 100}}
        inputs: {u: {unit: rad/s}}
        parameters:
          J: {value: 0.02, unit: kg*m**2}
          c: {value: 3e-6, unit: N*m*s**2/rad**2}
          g: {value: 0.4, unit: N*m}
          d: {value: 0.01, unit: N*m*s}
          tau: {value: 0.08, unit: s}
        equations: {x'': (c*w**2 - g*sin(x) - d*x')/J, w': (u - w)/tau}
    """
    swinging = """
    name: wanted
    coordinates: {x: {unit: rad, initial: 1.2, initial_velocity: 0}}
    parameters:
      a: {value: 9, unit: 1/s**2}
      m: {value: 1, unit: rad}
      c: {value: 1, unit: 1/s}
      l: {value: 0.2, unit: rad}
    equations: {x'': -a*(x - m) - c*(((x - m)/l)**2 - 1)*x'}
    """
    made = written(tmp_path, arm, swinging).run()

    def rates(t, y):
        return [y[1], -9 * (y[0] - 1) - (((y[0] - 1) / 0.2) ** 2 - 1) * y[1]]

    x = solve_ivp(rates, (0, 5), [1.2, 0], method="DOP853", rtol=1e-12, atol=1e-14, t_eval=made.t).y[0]
    assert np.linalg.norm(made["rig.x"] - x) <= EXACT * np.linalg.norm(x)


def test_internal_states_begin_in_their_units(tmp_path):
    """A force of 2 N that fades, declared in mN: the rig is moved by it, and the controller cancels that."""
    fading = """
        coordinates: {x: {unit: m}}
        states: {f: {meaning: force that fades, unit: mN, initial: 2000}}
        inputs: {u: {unit: N}}
        parameters: {m: {value: 0.5, unit: kg}, tau: {value: 1, unit: s}}
        equations: {x'': (u + f)/m, f': -f/tau}
    """
    made = written(tmp_path, fading).run()
    assert made.manifest["masking_error"]["x"] <= EXACT
    np.testing.assert_allclose(made["input.u"], -2 * np.exp(-made.t), rtol=1e-6)  # what is wanted is 0


# What the virtual system does not determine: textbook systems behind a voice coil, and what their zero dynamics are.

PENDULUM = """
        coordinates: {x: {unit: m}, th: {unit: rad}}
        states: {i: {meaning: current, unit: A}}
        inputs: {u: {unit: V}}
        parameters:
          M: {value: 0.5, unit: kg}
          m: {value: 0.1, unit: kg}
          l: {value: 0.2, unit: m}
          g: {value: 9.81, unit: m/s**2}
          K: {value: 8, unit: N/A}
          R: {value: 4, unit: ohm}
          L: {value: 0.02, unit: H}
        equations:
          (M + m)*x'' + m*l*cos(th)*th'': K*i + m*l*sin(th)*th'**2
          l*th'' + cos(th)*x'': -g*sin(th)
          i': (u - R*i - K*x')/L
"""
SECOND_CART = """
        coordinates: {x: {unit: m}, y: {unit: m}}
        states: {i: {meaning: current, unit: A}}
        inputs: {u: {unit: V}}
        parameters:
          m: {value: 0.5, unit: kg}
          k: {value: 20, unit: N/m}
          c: {value: 0.4, unit: N*s/m}
          K: {value: 8, unit: N/A}
          R: {value: 4, unit: ohm}
          L: {value: 0.02, unit: H}
        equations: {x'': (K*i - k*(x - y))/m, y'': (k*(x - y) - c*y')/m, i': (u - R*i - K*x')/L}
"""
DAMPER = """
        coordinates: {x: {unit: m}, y: {unit: m}}
        inputs: {u: {unit: N}}
        parameters: {m: {value: 0.5, unit: kg}, b: {value: 1.5, unit: N*s/m}}
        equations: {x'': -b*(x' - y')/m, y'': (u - b*(y' - x'))/m}
"""
SWING = np.sqrt(9.81 / 0.2)
REMAINDERS = {  # rig, verdict, and the eigenvalues of what is left over while x is held
    "hanging pendulum": (PENDULUM, "marginal", [1j * SWING, -1j * SWING]),
    "inverted pendulum": (PENDULUM.replace("9.81", "-9.81"), "unstable", [SWING, -SWING]),
    "second cart behind a spring": (SECOND_CART, "stable", np.roots([0.5, 0.4, 20])),
    "second mass behind a damper": (DAMPER, "marginal", [0]),
}


@pytest.mark.parametrize("name", REMAINDERS)
def test_zero_dynamics_where_inputs_act_through_dynamics(tmp_path, name):
    rig, verdict, eigenvalues = REMAINDERS[name]
    found = written(tmp_path, rig).passive.zero_dynamics
    assert found.verdict == verdict
    for value in eigenvalues:
        assert np.min(np.abs(found.eigenvalues - value)) <= 1e-6 * max(1, abs(value))
    assert len(found.eigenvalues) == len(eigenvalues)


def test_what_is_left_over_moves_as_the_wanted_motion_drives_it(tmp_path):
    written(tmp_path, PENDULUM)
    changes = KINDS["Duffing"]
    made = Experiment.load(tmp_path / "run.yaml", changes=changes).changed(initial={"th": 0.2}).run()

    def rates(t, y):
        x, v, th, w = y
        a = wanted(t, (x, v), **changes)[1]
        return [v, a, w, (-9.81 * np.sin(th) - a * np.cos(th)) / 0.2]

    settings = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14, "t_eval": made.t}
    x, _, th, _ = solve_ivp(rates, (0, 5), [0.01, 0.05, 0.2, 0], **settings).y
    assert np.linalg.norm(made["rig.x"] - x) <= EXACT * np.linalg.norm(x)
    assert np.linalg.norm(made["rig.th"] - th) <= EXACT * np.linalg.norm(th)
    assert made.manifest["passive"]["verdict"] == "marginal"


def test_a_cart_with_a_pendulum_and_a_voice_coil_is_masked_from_its_encoder(tmp_path):
    """The pendulum is followed by the model: no sensor reads it."""
    damped = PENDULUM.replace("-g*sin(th)", "-g*sin(th) - c*th'")
    written(tmp_path, damped.replace("parameters:", "parameters:\n          c: {value: 0.1, unit: m/s}"))
    (tmp_path / "plant.yaml").write_text("\n".join(line[8:] for line in SENSING.splitlines()))
    found = Experiment.load(tmp_path / "run.yaml", changes=KINDS["Van der Pol"])
    made = found.changed(controller={"rate": "1 kHz", "homing": 2}, initial={"x": 0.01, "x'": 0}).run()
    assert made.manifest["masking_error"]["x"] <= 0.005
    assert made.manifest["passive"]["coordinates"] == ["th"]


SENSING = """
        name: rig
        model: model.yaml
        sensors: {encoder: {measures: x, gain: {value: 1000, unit: mm/m}, unit: mm}}
        limits: {inputs: {u: {max: 24, unit: V}}}
        effects:
          noise: {effect: noise, at: encoder, parameters: {sigma: 0.001}}
          steps: {effect: quantisation, at: encoder, parameters: {step: 0.001}}
          delay: {effect: delay, parameters: {samples: 1}}
"""


NEGLECTED = """
name: coil without inductance
coordinates: {x: {unit: m}}
inputs: {u: {unit: V}}
parameters:
  m: {value: 0.5, unit: kg}
  k: {value: 200, unit: N/m}
  b: {value: 1.5, unit: N*s/m}
  K: {value: 8, unit: N/A}
  R: {value: 4, unit: ohm}
equations: {x'': (K*(u - K*x')/R - k*x - b*x')/m}
"""


def test_a_voice_coil_is_masked_from_its_encoder(tmp_path):
    """At 1 kHz, with a sample of delay, and with an inductance, a resistance and a motor constant that are 5 % off.

    A controller that neglects the inductance, whose time constant is 5 ms, is at least five times worse.
    """
    written(tmp_path, RIGS["voice coil driven by voltage"])
    (tmp_path / "plant.yaml").write_text("\n".join(line[8:] for line in SENSING.splitlines()))
    settings = {"rate": "1 kHz", "homing": 1}
    found = Experiment.load(tmp_path / "run.yaml", changes=KINDS["Van der Pol"])
    exact = found.changed(controller=settings, initial={"x": 0.01, "x'": 0}).run()
    wrong = {"L": 0.021, "R": 4.2, "K": 7.6}
    off = found.changed(controller=settings | {"parameters": wrong}, initial={"x": 0.01, "x'": 0}).run()
    assert exact.manifest["masking_error"]["x"] <= 0.002
    assert off.manifest["masking_error"]["x"] <= 0.015
    (tmp_path / "slow.yaml").write_text(NEGLECTED)
    neglected = found.changed(controller=settings | {"model": "slow.yaml"}, initial={"x": 0.01, "x'": 0}).run()
    assert neglected.manifest["masking_error"]["x"] >= 5 * exact.manifest["masking_error"]["x"]


FURTHER = {  # sensors of the voice coil with their noise, and the masking error with parameters that are 5 % off
    "current": ({"encoder": ("x", "m", 1e-6), "amp": ("i", "A", 0.001)}, 0.03),
    "force": ({"encoder": ("x", "m", 1e-6), "load": ("K*i", "N", 0.005)}, 0.03),
    "acceleration": ({"encoder": ("x", "m", 1e-6), "accelerometer": ("x''", "m/s**2", 0.01)}, 0.03),
    "current alone": ({"amp": ("i", "A", 0.001)}, None),
}


@pytest.mark.parametrize("name", FURTHER)
def test_a_voice_coil_is_masked_from_what_it_has_of_sensors(tmp_path, name):
    """A current alone tells the velocity by the voltage that it induces, as far as the coil is known."""
    sensors, off = FURTHER[name]
    written(tmp_path, RIGS["voice coil driven by voltage"])
    plant = {
        "name": "rig",
        "model": "model.yaml",
        "sensors": {n: {"measures": text, "unit": unit} for n, (text, unit, _) in sensors.items()},
        "limits": {"inputs": {"u": {"max": 24, "unit": "V"}}},
        "effects": {"delay": {"effect": "delay", "parameters": {"samples": 1}}}
        | {f"{n}_noise": {"effect": "noise", "at": n, "parameters": {"sigma": s}} for n, (_, _, s) in sensors.items()},
    }
    (tmp_path / "plant.yaml").write_text(json.dumps(plant))
    found = Experiment.load(tmp_path / "run.yaml", changes=KINDS["pendulum"])
    settings = {"rate": "1 kHz", "homing": 1}
    exact = found.changed(controller=settings, initial={"x": 0.01, "x'": 0}).run()
    assert exact.manifest["masking_error"]["x"] <= 0.02
    if off is not None:
        wrong = settings | {"parameters": {"L": 0.021, "R": 4.2, "K": 7.6}}
        made = found.changed(controller=wrong, initial={"x": 0.01, "x'": 0}).run()
        assert made.manifest["masking_error"]["x"] <= off


STOREY = """
        name: rig
        model: model.yaml
        sensors: {lvdt: {measures: x, unit: m}, cell: {measures: f, unit: N}}
        limits: {inputs: {u: {max: 1, unit: m}}}
        effects:
          noise: {effect: noise, at: lvdt, parameters: {sigma: 1e-5}}
          more: {effect: noise, at: cell, parameters: {sigma: 2}}
"""


def test_a_load_cell_is_followed_where_the_masses_are_known(tmp_path):
    """A valve whose stiffness is 10 % off does not count then; without the load cell it is 45 times worse."""
    written(tmp_path, RIGS["hydraulic cylinder"])
    (tmp_path / "plant.yaml").write_text("\n".join(line[8:] for line in STOREY.splitlines()))
    found = Experiment.load(tmp_path / "run.yaml", changes=KINDS["Duffing"] | {"a": 300, "f": 4})
    settings = {"rate": "4 kHz", "parameters": {"b2": 1.1e5}}
    errors = {}
    for at in (None, "inputs"):
        changed = found.changed(controller=settings | {"observer": {"at": at}}, initial={"x": 0, "x'": 0})
        assert changed.sampled.unused == (() if at else ("cell",))
        errors[at] = changed.run().manifest["masking_error"]["x"]
    assert errors["inputs"] <= 0.015
    assert errors[None] >= 20 * errors["inputs"]


def test_where_a_disturbance_acts_is_refused_where_it_cannot_be_told(tmp_path):
    written(tmp_path, RIGS["hydraulic cylinder"])
    (tmp_path / "plant.yaml").write_text("\n".join(line[8:] for line in STOREY.splitlines()))
    found = Experiment.load(tmp_path / "run.yaml")
    settings = {"rate": "4 kHz", "observer": {"at": "masses"}}
    with pytest.raises(
        ModelError, match=r"observer\.at: masses: the sensors \(lvdt, cell\) do not tell a force on a mass"
    ):
        found.changed(controller=settings, initial={"x": 0, "x'": 0}).validate()
    mass = """
        coordinates: {x: {unit: m}}
        inputs: {u: {unit: N}}
        parameters: {m: {value: 1, unit: kg}}
        equations: {x'': u/m}
    """
    written(tmp_path, mass)
    lines = SENSING.replace("unit: V", "unit: N").splitlines()
    (tmp_path / "plant.yaml").write_text("\n".join(line[8:] for line in lines))
    found = Experiment.load(tmp_path / "run.yaml")
    with pytest.raises(ModelError, match=r"observer\.at: the inputs of rig change accelerations at once"):
        found.changed(controller={"rate": "1 kHz", "observer": {"at": "inputs"}}, initial={"x": 0, "x'": 0}).validate()


def test_where_a_disturbance_acts_is_said_of_one_that_is_estimated(tmp_path):
    found = written(tmp_path, RIGS["hydraulic cylinder"])
    with pytest.raises(
        DeclarationError, match=r"controller\.observer\.at: at says where a disturbance acts, and 'kalman'"
    ):
        found.changed(controller={"rate": "4 kHz", "observer": {"kind": "kalman", "at": "inputs"}})


def test_a_run_without_homing_begins_where_something_holds_the_rig(tmp_path):
    """The mass is 10 mm out: the other end of the spring is there, too, and no force acts."""
    written(tmp_path, ELASTIC)
    lines = SENSING.replace("unit: V", "unit: N").splitlines()
    (tmp_path / "plant.yaml").write_text("\n".join(line[8:] for line in lines))
    found = Experiment.load(tmp_path / "run.yaml", changes=KINDS["Van der Pol"])
    made = found.changed(controller={"rate": "1 kHz"}, initial={"x": 0.01, "x'": 0}).run()
    assert made["rig.x"][0] == pytest.approx(0.01, abs=1e-4)
    assert made["rig.y"][0] == pytest.approx(0.01, abs=1e-4)
    assert made.manifest["masking_error"]["x"] <= 0.1


def test_a_bandwidth_without_dynamics_of_actuators_is_refused(tmp_path):
    mass = """
        coordinates: {x: {unit: m}}
        inputs: {u: {unit: N}}
        parameters: {m: {value: 1, unit: kg}}
        equations: {x'': u/m}
    """
    found = written(tmp_path, mass, controller={"actuator_bandwidth": 30})
    with pytest.raises(ModelError, match="actuator_bandwidth: the inputs of rig change accelerations at once"):
        found.validate()


def test_a_pendulum_that_the_sensors_do_not_tell_is_named(tmp_path):
    """It stands on a cart that does not feel it."""
    model = """
        coordinates: {x: {unit: m}, th: {unit: rad}}
        states: {i: {unit: N}}
        inputs: {u: {unit: N}}
        parameters:
          m: {value: 1, unit: kg}
          tau: {value: 0.1, unit: s}
          g: {value: 9.81, unit: m/s**2}
          l: {value: 0.3, unit: m}
        equations: {m*x'': i, l*th'': g*sin(th) + x''*cos(th), i': (u - i)/tau}
    """
    written(tmp_path, model)
    lines = SENSING.replace("unit: V", "unit: N").splitlines()
    (tmp_path / "plant.yaml").write_text("\n".join(line[8:] for line in lines))
    found = Experiment.load(tmp_path / "run.yaml")
    with pytest.raises(
        ModelError, match=r"^the sensors \(encoder\) do not tell th, and in the model it does not come to"
    ):
        found.changed(controller={"rate": "1 kHz"}, initial={"x": 0.01, "x'": 0}).validate()


def test_differences_do_not_tell_a_current(tmp_path):
    written(tmp_path, RIGS["voice coil driven by voltage"])
    (tmp_path / "plant.yaml").write_text("\n".join(line[8:] for line in SENSING.splitlines()))
    settings = {"rate": "1 kHz", "observer": "differences"}
    found = Experiment.load(tmp_path / "run.yaml", changes=KINDS["pendulum"])
    with pytest.raises(ModelError, match="differences do not tell the internal states through which the inputs act"):
        found.changed(controller=settings, initial={"x": 0.01, "x'": 0}).validate()


def test_an_energy_is_balanced_by_accelerations():
    model, _ = DEGREES["lagged force"]
    law = Controller(model, one("b"), Transform(model, one("b"), schema.Transform()), 1.0, {}, None, (0.3, 1.0))
    with pytest.raises(ModelError, match="first in derivative 3 of b, and an energy is balanced where inputs change"):
        law.checked()


ELASTIC = """
        coordinates: {x: {unit: m}, y: {unit: m}}
        inputs: {u: {unit: N}}
        parameters: {m: {value: 0.5, unit: kg}, k: {value: 2000, unit: N/m}, b: {value: 1.5, unit: N*s/m}}
        equations: {x'': (-k*(x - y) - b*x')/m, y'': (u - k*(y - x) - b*y')/m}
"""


def test_a_mass_behind_a_spring_is_masked_from_one_encoder(tmp_path):
    written(tmp_path, ELASTIC)
    lines = SENSING.replace("unit: V", "unit: N").splitlines()
    (tmp_path / "plant.yaml").write_text("\n".join(line[8:] for line in lines))
    found = Experiment.load(tmp_path / "run.yaml", changes=KINDS["Van der Pol"])
    made = found.changed(controller={"rate": "1 kHz", "homing": 2}, initial={"x": 0.01, "x'": 0}).run()
    assert made.manifest["masking_error"]["x"] <= 0.002


def test_a_held_output_acts_as_the_law_to_fourth_order(tmp_path):
    """A pendulum of 6 rad/s by a rig of 431 rad/s, whose forces cancel to a thousandth."""
    written(tmp_path, RIGS["hydraulic cylinder"])
    sensing = SENSING.replace("max: 24, unit: V", "max: 1, unit: m").replace(": 0.001", ": 1e-9")
    (tmp_path / "plant.yaml").write_text("\n".join(line[8:] for line in sensing.splitlines()))
    found = Experiment.load(tmp_path / "run.yaml", changes=KINDS["pendulum"])
    errors = []
    for rate in (4, 8):
        settings = {"rate": f"{rate} kHz", "homing": 1, "actuator_bandwidth": 80}
        made = found.changed(controller=settings, initial={"x": 0.01, "x'": 0}).run()
        errors.append(made.manifest["masking_error"]["x"])
    assert errors[1] <= 0.001
    assert np.log2(errors[0] / errors[1]) >= 3.5


def test_delays_of_the_virtual_system_have_no_derivative(tmp_path):
    late = WANTED.replace("    equations: {x'': -a*x ", "    equations:\n      x'': -a*delay(x, tau) ").replace(
        "w*t)}", "w*t)"
    )
    late = late.replace("parameters:", "parameters:\n      tau: {value: 0.1, unit: s}")
    with pytest.raises(ModelError, match="wanted has delays: a rig whose inputs act through dynamics of their own"):
        written(tmp_path, RIGS["voice coil driven by voltage"], late).run()
