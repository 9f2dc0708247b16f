"""Events in models: a bouncing ball in closed form, an escapement against scipy, and what is refused."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from masking.errors import DeclarationError, IntegrationError, ModelError
from masking.model.declaration import registry
from masking.model.modelling.input_series import Series
from masking.model.modelling.model import load_model

BALL = """
name: ball
coordinates: {x: {meaning: height, initial: 1}}
states: {n: impacts}
parameters: {g: 9.81, e: {value: 0.8, bounds: [0, 1]}}
equations: {x'': -g, n': 0}
events:
  impact: {when: -x, jumps: {x': -e*x', n: n + 1}}
"""


@cache
def made(tmp, text):
    path = tmp / f"model_{abs(hash(text))}.yaml"
    path.write_text(text, encoding="utf-8")
    return load_model(path)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    folder = tmp_path_factory.mktemp("events")
    return lambda text: made(folder, text)


def impacts(g, e, count):
    """Return the times of impact of a ball that falls from a height of 1."""
    speed = np.sqrt(2.0 * g)
    return np.cumsum(np.append(speed / g, 2.0 * speed / g * e ** np.arange(1, count)))


@pytest.mark.parametrize("e", [0.5, 0.8, 1.0])
def test_a_ball_with_restitution_bounces_as_in_closed_form(model, e):
    end, g = 1.3 if e < 0.8 else 3.0, 9.81
    times = np.linspace(0.0, end, 1501)
    found = model(BALL).with_parameters(e=e).simulate(times)
    expected = impacts(g, e, 40)
    expected = expected[expected < end]
    assert [name for _, name in found.events] == ["impact"] * len(expected)
    assert np.max(np.abs([t for t, _ in found.events] - expected)) <= 1e-12
    k = np.searchsorted(expected, times)  # impacts so far
    since = times - np.append(0.0, expected)[k]
    start = np.where(k > 0, e**k * np.sqrt(2.0 * g), 0.0)
    assert np.max(np.abs(found["x"] - (np.where(k > 0, 0.0, 1.0) + start * since - 0.5 * g * since**2))) <= 1e-11
    assert np.max(np.abs(found["x'"] - (start - g * since))) <= 1e-10
    assert np.array_equal(found["n"], k)


ESCAPEMENT = """
name: clock
coordinates: {x: {meaning: angle, initial: 0.4}}
states: {d: drive, n: beats}
parameters: {w: 1.3, z: 0.04, F: 0.1, b: 0.2}
equations: {x'': -w**2*sin(x) - 2*z*w*x' + d, d': 0, n': 0}
events:
  push: {when: x, jumps: {d: F, n: n + 1}}
  leave: {when: x - b, jumps: {d: 0}}
  pull: {when: -x, jumps: {d: -F, n: n + 1}}
  release: {when: -x - b, jumps: {d: 0}}
"""


def escapement(times):
    """Return angle, speed and drive by scipy, from event to event, and the events' times."""

    def slope(_, y, drive):
        return [y[1], -(1.3**2) * np.sin(y[0]) - 2.0 * 0.04 * 1.3 * y[1] + drive]

    conditions = [lambda _, y, __, a=a, s=s: s * y[0] - a for s in (1.0, -1.0) for a in (0.0, 0.2)]
    for one in conditions:
        one.terminal, one.direction = True, 1.0
    t, y, drive, found, happened, last = 0.0, [0.4, 0.0], 0.0, np.empty((3, len(times))), [], None
    while t < times[-1]:
        watched = [one for one in conditions if one is not last]  # scipy would find that where it begins
        run = solve_ivp(
            slope, (t, times[-1]), y, "DOP853", events=watched, args=(drive,), rtol=1e-12, atol=1e-14, dense_output=True
        )
        rows = (times >= t) & (times <= run.t[-1])
        found[:2, rows], found[2, rows] = run.sol(times[rows]), drive
        t, y = run.t[-1], run.y[:, -1]
        if run.status == 1:
            last = next(one for one, at in zip(watched, run.t_events, strict=True) if len(at))
            drive = {0: 0.1, 1: 0.0, 2: -0.1, 3: 0.0}[conditions.index(last)]
            happened.append(t)
    return found, np.array(happened)


def test_an_escapement_moves_as_from_event_to_event_of_scipy(model):
    times = np.linspace(0.0, 60.0, 3001)
    found, (expected, happened) = model(ESCAPEMENT).simulate(times, tolerance=1e-12), escapement(times)
    assert len(found.events) == len(happened) > 40
    assert np.max(np.abs([t for t, _ in found.events] - happened)) <= 1e-9
    assert np.max(np.abs(np.array([found["x"], found["x'"]]) - expected[:2])) <= 1e-9
    assert np.array_equal(found["d"], expected[2])


def test_the_time_of_an_event_has_the_order_of_the_integrator(model):
    # x = cos t + 2 exp(-t / 2) crosses 0.2 downwards.
    text = """
name: crossing
coordinates: {x: {meaning: swing, initial: 1}}
states: {z: {meaning: decays, initial: 2}, at: when it crossed}
equations: {x'': -x, z': -z/2, at': 0}
events: {crossed: {when: 0.2 - x - z, jumps: {at: t}}}
"""
    from scipy.optimize import brentq

    truth = brentq(lambda t: np.cos(t) + 2.0 * np.exp(-t / 2.0) - 0.2, 1.0, 3.0, xtol=1e-15)
    system, errors = model(text), []
    state = system.initial_state({})
    for step in (0.8, 0.4, 0.2):
        run = system.kernels.integrate(
            np.array([0.0, 4.0]), state, np.empty(0), system.values(), tolerance=1e-10, fixed_step=step
        )
        errors.append(abs(run.events[0][0] - truth))
        assert run["at"][-1] == run.events[0][0]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert 6.5 <= orders.min() <= orders.max() <= 9.5


def test_a_condition_that_only_touches_is_found_between_the_points_of_a_step(model):
    # x = cos t is above 1 - 1e-4 for 0.028 about each top; steps are about 1 long.
    text = """
name: top
coordinates: {x: {meaning: swing, initial: 0, initial_velocity: 1}}
states: {n: tops}
equations: {x'': -x, n': 0}
events: {top: {when: x - 0.9999, jumps: {n: n + 1}}}
"""
    found = model(text).simulate(np.linspace(0.0, 100.0, 11), tolerance=1e-10)
    expected = 0.5 * np.pi - np.arccos(0.9999) + 2.0 * np.pi * np.arange(16)
    assert np.max(np.abs([t for t, _ in found.events] - expected)) <= 1e-6  # its slope there is 0.014
    assert found["n"][-1] == 16


def test_events_at_one_instant_follow_each_other_in_declared_order(model):
    text = """
name: order
states: {a: rises, b: first, c: second, k: chain}
equations: {a': 1, b': 0, c': 0, k': 0}
outputs: {y: a}
events:
  one: {when: a - 1, jumps: {b: b + 1, a: 0}}
  two: {when: t - 1, jumps: {c: 10*b + k}}
  three: {when: b - 0.5, jumps: {k: 7}}
"""
    found = model(text).simulate(np.array([0.0, 1.5]))
    assert [name for _, name in found.events][:1] == ["one"]
    assert sorted(name for _, name in found.events) == ["one", "three", "two"]
    assert found["a"][-1] == pytest.approx(0.5)
    assert found["b"][-1] == 1.0
    assert found["c"][-1] in {10.0, 17.0}
    assert found["k"][-1] == 7.0


def test_events_with_inputs_that_are_series(model):
    text = BALL.replace("parameters:", "inputs: {F: a push}\nparameters:").replace("x'': -g", "x'': -g + F")
    times = np.linspace(0.0, 2.0, 201)
    driven = model(text).simulate(times, inputs={"F": Series([0.0, 1.0, 2.0], [0.0, 0.0, 0.0], "previous")})
    alone = model(BALL).simulate(times)
    assert np.max(np.abs(driven.states - alone.states)) <= 1e-9
    assert np.allclose([t for t, _ in driven.events], [t for t, _ in alone.events], atol=1e-9)


@pytest.mark.parametrize("e", [1e-6, 0.01, 0.5, 0.99])
def test_events_without_end_are_an_error_that_names_event_and_time(model, e):
    end = np.sqrt(2.0 / 9.81) * (1.0 + 2.0 * e / (1.0 - e))
    with pytest.raises(IntegrationError, match="event 'impact' comes again and again, without end, at t = ") as error:
        model(BALL).with_parameters(e=e).simulate(np.linspace(0.0, 2.0 * end, 11))
    said = float(str(error.value).split("t = ")[1].split(";")[0])
    assert said == pytest.approx(end, rel=1e-6)
    assert "bouncing_ball.yaml" in str(error.value)


def test_events_that_follow_each_other_at_one_instant_without_end_are_an_error(model):
    text = "name: flip\nstates: {a: rises, b: {meaning: flips, initial: -1}}\nequations: {a': 1, b': 0}\n"
    text += "outputs: {y: a}\nevents:\n  up: {when: a - 1, jumps: {b: 1}}\n"
    text += "  forth: {when: b, jumps: {b: -1}}\n  back: {when: -b, jumps: {b: 1}}\n"
    with pytest.raises(IntegrationError, match="comes again and again, without end, at t = 1;"):
        model(text).simulate(np.array([0.0, 2.0]))


def test_events_are_integrated_forwards_only(model):
    with pytest.raises(IntegrationError, match="forwards only"):
        model(BALL).simulate(np.array([1.0, 0.0]))


WRONG = [
    ("{when: -x, jumps: {}}", "an event without jumps does nothing; write what jumps, such as 'jumps: {x: 0}'"),
    ("{when: -x, jumps: {y: 1}}", "'y' is not a coordinate, a velocity or an internal state.*allowed: x, x', n"),
    ("{when: g*e, jumps: {x': 0}}", "the condition does not change, so that it never crosses zero"),
    ("{when: x'', jumps: {x': -e*x'}}", "'x''' is an acceleration, which an event may not contain"),
    ("{when: fast, jumps: {x': -e*x'}}", "'fast' contains an acceleration, which an event may not contain"),
    ("{when: pushed, jumps: {x': -e*x'}}", "'pushed' contains an input, which an event may not contain"),
    ("{when: -x, jumps: {x': F}}", "'F' may not be used here"),
    ("{when: 'delay(x, 1)', jumps: {x': -e*x'}}", "may not be delayed here"),
    ("{when: -x, jump: {x': -e*x'}}", "the key 'jump' is not known"),
    ("{jumps: {x': -e*x'}}", "the key 'when' is missing"),
]


@pytest.mark.parametrize(("event", "message"), WRONG)
def test_what_is_wrong_with_an_event_is_said_with_its_place(tmp_path, event, message):
    text = BALL.replace("parameters:", "inputs: {F: a push}\ndefinitions: {pushed: F + x, fast: x''}\nparameters:")
    text = text.replace("x'': -g", "x'': -g + pushed + 0*fast*e")
    text = text[: text.index("events:")] + f"events:\n  impact: {event}\n"
    (tmp_path / "ball.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(DeclarationError, match=message) as error:
        registry.load_model(tmp_path / "ball.yaml")
    assert "ball.yaml:" in str(error.value)


def test_units_of_jumps_are_checked(tmp_path):
    text = BALL.replace("meaning: height", "unit: m").replace("g: 9.81", "g: {value: 9.81, unit: m/s**2}")
    (tmp_path / "ball.yaml").write_text(text.replace("-e*x'", "-e*x"), encoding="utf-8")
    with pytest.raises(DeclarationError, match="what jumps is m/s, its value afterwards m"):
        load_model(tmp_path / "ball.yaml").validate()


def test_a_model_has_events_or_delays(tmp_path):
    (tmp_path / "ball.yaml").write_text(BALL.replace("x'': -g", "x'': '-g - 0.1*delay(x, 1)'"), encoding="utf-8")
    with pytest.raises(DeclarationError, match="a model has events or delays, not both"):
        registry.load_model(tmp_path / "ball.yaml")


def test_what_knows_no_events_refuses_them(model):
    ball = model(BALL)
    for refuse in (ball.linearise, ball.to_control):
        with pytest.raises(ModelError, match=r"ball has events, which .* does not take: its states jump"):
            refuse()
