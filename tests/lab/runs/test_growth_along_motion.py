"""Small motions of passive coordinates along a wanted motion: against Mathieu's tables, and the equations in scipy."""

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import mathieu_a, mathieu_b

from masking.app import cli
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.feasibility import feasibility

DEPTH = 0.4  # of the stiffness of `modulated`, in the wanted motion of amplitude 0.1
GRAVITY, LENGTH, PIVOT, MASS, STROKE, SCALE = 9.81, 0.2, 0.001, 0.1, 0.005, 0.1  # of cart_pendulum, s per unit of time


def written(folder, force, virtual="{x'': -x}", start="{x: {initial: 0.1}}", duration=60, **parameters):
    """Experiment on a cart that is driven and others that are passive, under forces given by the name of each."""
    given = {"k": (0.25, "N/m"), "c": (0.0, "N*s/m"), "q": (4.0, "1/m")}
    forces = force if isinstance(force, dict) else {"z": force}
    lines = [f"  m*{name}'': {one}" for name, one in forces.items()]
    used = [n for n in given if any(f"{n}*" in line for line in lines)]
    table = "".join(f"  {n}: {{value: {float(parameters.get(n, given[n][0]))!r}, unit: {given[n][1]}}}\n" for n in used)
    every = ("x", *forces)
    (folder / "carts.yaml").write_text(
        f"name: carts\ncoordinates: {{{', '.join(f'{n}: {{unit: m, initial: 0}}' for n in every)}}}\n"
        f"inputs: {{F: {{unit: N}}}}\nparameters:\n  m: {{value: 1, unit: kg}}\n{table}"
        "equations:\n  m*x'': F\n" + "\n".join(lines) + "\n"
    )
    (folder / "rig.yaml").write_text(
        f"name: rig\nmodel: carts.yaml\nsensors: {{{', '.join(f's{n}: {{measures: {n}, unit: m}}' for n in every)}}}\n"
        "limits: {inputs: {F: {max: 100, unit: N}}}\n"
    )
    (folder / "one.yaml").write_text(f"name: one\ncoordinates: {start}\nequations: {virtual}\n")
    (folder / "e.yaml").write_text(
        f"name: e\nplant: rig.yaml\nvirtual: one.yaml\ncontroller: {{rate: continuous}}\nduration: {duration}\n"
    )
    return folder / "e.yaml"


def along(path):
    """Zero dynamics at rest and along the wanted motion."""
    return feasibility(Experiment.load(path)).zero_dynamics


def transition(matrix, span, size):
    """Transition matrix of x' = matrix(t) x over a span."""

    def slope(t, x):
        return (matrix(t) @ x.reshape(size, size)).ravel()

    return solve_ivp(slope, span, np.eye(size).ravel(), "DOP853", rtol=1e-12, atol=1e-14).y[:, -1].reshape(size, size)


MODULATED = "-k*(1 + q*x)*z - c*z'"  # z'' + 0.25 (1 + 0.4 cos t) z + c z' = 0


@pytest.mark.parametrize("damping", [0.0, 0.05])
def test_multipliers_of_a_modulated_spring(tmp_path, damping):
    """Stable with the cart held, unstable as it moves; half the frequency, as in the first tongue of Mathieu."""
    held, moving = along(written(tmp_path, MODULATED, c=damping))
    truth = transition(
        lambda t: np.array([[0.0, 1.0], [-0.25 * (1 + DEPTH * np.cos(t)), -damping]]), (0.0, 2 * np.pi), 2
    )
    assert moving.period == pytest.approx(2 * np.pi, rel=1e-9)
    np.testing.assert_allclose(np.sort(moving.multipliers.real), np.sort(np.linalg.eigvals(truth)), atol=1e-8)
    assert held.verdict == ("stable" if damping else "marginal")
    assert moving.verdict == "unstable"
    assert str(moving).startswith(
        "z passive, zero dynamics unstable along the wanted motion (period 6.283 s): grows to 1."
    )
    assert str(moving).endswith("at half the frequency of the motion")


@pytest.mark.parametrize(("side", "verdict"), [(1e-3, "marginal"), (-1e-3, "unstable")])
@pytest.mark.parametrize("edge", ["upper", "lower"])
def test_edges_of_the_first_tongue(tmp_path, side, verdict, edge):
    """Z'' + (a - 2 r cos 2 s) z = 0 with s = t/2 grows where b_1(r) < a < a_1(r)."""
    r = 0.3
    a = mathieu_a(1, r) + side if edge == "upper" else mathieu_b(1, r) - side
    _, moving = along(written(tmp_path, MODULATED, k=a / 4, q=-20 * r / a))
    assert moving.verdict == verdict


def test_a_motion_that_holds_what_falls_at_rest(tmp_path):
    """Z'' = (0.5 + 20 sin 10 t) z: the mean of the fast motion gives 0.5 - 20^2/(2 10^2) = -1.5."""
    path = written(tmp_path, "k*(1 + q*x)*z", "{x'': -100*x}", "{x: {initial: 0}}", 20, k=0.5, q=400.0)
    path.write_text(path.read_text() + "initial: {x': 1}\n")
    held, moving = along(path)
    truth = transition(lambda t: np.array([[0.0, 1.0], [0.5 + 20 * np.sin(10 * t), 0.0]]), (0.0, np.pi / 5), 2)
    assert held.verdict == "unstable"
    assert held.how == "grows like exp(0.707 t), t in s"
    assert moving.verdict == "marginal"
    assert np.trace(moving.matrix) == pytest.approx(np.trace(truth), abs=1e-8)


def test_two_passive_carts_that_the_motion_couples(tmp_path):
    """The sum of both frequencies, 1 and 2 rad/s, is that of the motion: they grow together."""
    forces = {"y": "-k*y + k*q*x*z", "z": "-4*k*z + k*q*x*y"}
    _, moving = along(written(tmp_path, forces, "{x'': -9*x}", k=1.0, q=2.0))

    def matrix(t):
        f = 0.2 * np.cos(3 * t)
        return np.block([[np.zeros((2, 2)), np.eye(2)], [np.array([[-1.0, f], [f, -4.0]]), np.zeros((2, 2))]])

    truth = np.abs(np.linalg.eigvals(transition(matrix, (0.0, 2 * np.pi / 3), 4)))
    np.testing.assert_allclose(np.sort(np.abs(moving.multipliers)), np.sort(truth), atol=1e-7)
    assert moving.verdict == "unstable"


def test_a_pendulum_under_a_cart_on_a_limit_cycle():
    """The run begins off the cycle and off the swing that repeats with it; both are found."""
    _, moving = along("cart_alone")

    def slope(t, y):
        x, v, th, w = y[:4]
        a = (1 - x * x) * v - x
        pull, damping = STROKE / SCALE**2 * a, PIVOT / (MASS * LENGTH**2)
        bend = (-GRAVITY * np.sin(th) - pull * np.cos(th)) / LENGTH - damping * w
        turn = (-GRAVITY * np.cos(th) + pull * np.sin(th)) / LENGTH
        beside = (y[6], y[7], turn * y[4] - damping * y[6], turn * y[5] - damping * y[7]) if len(y) > 4 else ()
        return [v / SCALE, a / SCALE, w, bend, *beside]

    def turned(t, y):
        return y[1]

    turned.direction = -1
    settled = solve_ivp(slope, (0.0, 90.0), [2.0, 0, 0, 0], "DOP853", events=turned, rtol=1e-11, atol=1e-12)
    times, states = settled.t_events[0], settled.y_events[0]
    period, again = times[-1] - times[-2], [*states[-2], *np.eye(2).ravel()]
    truth = solve_ivp(slope, (0.0, period), again, "DOP853", rtol=1e-12, atol=1e-14).y[4:, -1].reshape(2, 2)
    assert moving.period == pytest.approx(period, rel=1e-8)
    order = np.argsort(moving.multipliers.imag)
    np.testing.assert_allclose(moving.multipliers[order], np.sort_complex(np.linalg.eigvals(truth)), atol=1e-6)
    assert moving.verdict == "stable"


def test_a_motion_that_does_not_repeat(tmp_path):
    """Two frequencies without a common period; growth of the transition matrix, typed out for scipy."""
    virtual = "{x'': -x - 0.2*x' + 0.1*cos(t) + 0.05*cos(sqrt(5)*t)}"
    _, moving = along(written(tmp_path, MODULATED, virtual, duration=400))

    def slope(t, y):
        x, v, z, w = y
        drive = 0.1 * np.cos(t) + 0.05 * np.cos(np.sqrt(5) * t)
        return [v, -x - 0.2 * v + drive, w, -0.25 * (1 + 4 * x) * z]

    times = np.linspace(80.0, 400.0, 3201)
    y = solve_ivp(slope, (0.0, 400.0), [0.1, 0.0, 1.0, 0.3], "DOP853", times, rtol=1e-10, atol=1e-12).y
    rate = np.polyfit(times, np.log(np.hypot(y[2], 2 * y[3])), 1)[0]
    assert moving.period is None
    assert moving.verdict == "unstable"
    assert moving.slowest.real == pytest.approx(rate, rel=0.02)
    assert "along the wanted motion (not periodic, over 400 s): grows like exp(" in str(moving)


def test_too_short_a_run_does_not_tell(tmp_path):
    _, moving = along(written(tmp_path, MODULATED, duration=3))
    assert str(moving) == (
        "z passive, zero dynamics marginal along the wanted motion (not periodic, over 3 s): decays or grows by less "
        "than exp(0.33 t), t in s"
    )


def test_a_free_cart_drifts_along_the_motion(tmp_path):
    _, moving = along(written(tmp_path, "0*k*z"))
    np.testing.assert_allclose(moving.multipliers, 1.0, atol=1e-4)
    assert moving.how == "drifts away in proportion to the time"


def test_jumps_of_the_virtual_system_are_followed(tmp_path):
    """A relay pushes the cart by 1 m/s2 towards the middle, from 0.05 m: parabolas of a quarter of sqrt(0.1) s."""
    path = written(tmp_path, MODULATED, "{x'': -s, s': 0}", "{x: {initial: 0.05}}", 20)
    one = tmp_path / "one.yaml"
    events = "{left: {when: -x, jumps: {s: -1}}, right: {when: x, jumps: {s: 1}}}"
    one.write_text(one.read_text() + f"states: {{s: {{initial: 1}}}}\nevents: {events}\n")
    _, moving = along(path)
    quarter = np.sqrt(0.1)

    def matrix(t):
        side = 1.0 if (t + quarter) % (4 * quarter) < 2 * quarter else -1.0
        at = (t + quarter) % (2 * quarter) - quarter
        return np.array([[0.0, 1.0], [-0.25 * (1 + 4 * side * (0.05 - at**2 / 2)), 0.0]])

    truth = transition(matrix, (quarter, 3 * quarter), 2) @ transition(matrix, (-quarter, quarter), 2)
    assert moving.period == pytest.approx(4 * quarter, rel=1e-6)
    assert np.trace(moving.matrix) == pytest.approx(np.trace(truth), abs=1e-6)


def test_internal_states_of_the_rig_belong_to_what_is_passive(tmp_path):
    """A force that lags by 0.5 s behind the spring: z'' = -4 z - s, s' = 2 (4 z - s)."""
    path = written(tmp_path, "-k*z - s", k=4.0)
    rig = tmp_path / "carts.yaml"
    lag = "  s': (k*z - s)/T\nstates: {s: {unit: N, initial: 0}}\n"
    rig.write_text(rig.read_text().replace("  m: {", "  T: {value: 0.5, unit: s}\n  m: {") + lag)
    _, moving = along(path)
    truth = np.linalg.eigvals([[0.0, 1.0, 0.0], [-4.0, 0.0, -1.0], [8.0, 0.0, -2.0]])
    assert moving.slowest.real == pytest.approx(truth.real.max(), rel=1e-6)
    found = np.sort(np.abs(moving.multipliers))
    np.testing.assert_allclose(found, np.sort(np.exp(2 * np.pi * truth.real)), rtol=1e-6, atol=1e-6)


def test_delays_are_said_not_to_be_followed(tmp_path):
    found = feasibility(Experiment.load(written(tmp_path, MODULATED, '{"x\'\'": "-x - 0.1*delay(x, 1)"}')))
    assert "z passive, zero dynamics unknown along the wanted motion: delays of" in found.notes[1]
    assert len(found.zero_dynamics) == 1


def test_check_says_what_grows_along_which_motion(tmp_path, capsys):
    path = written(tmp_path, MODULATED, c=0.05)
    assert cli.main(["check", str(path)]) == 0
    out = capsys.readouterr().out
    assert "z passive, zero dynamics stable at rest: 0.5916 rad/s, damping ratio 0.0423" in out
    assert (
        "z passive, zero dynamics unstable along the wanted motion (period 6.283 s): grows to 1.169 of itself each "
        "period, like exp(0.0248 t), t in s, at half the frequency of the motion"
    ) in out
    cli.main(["check", str(path), "--json"])
    held, moving = json.loads(capsys.readouterr().out)[0]["feasibility"]["zero_dynamics"]
    assert (held["about"], held["verdict"], held["rest"]) == ("at rest", "stable", {"z": 0.0})
    assert (moving["coordinates"], moving["verdict"]) == (["z"], "unstable")
    assert moving["period"] == pytest.approx(2 * np.pi)
    assert min(m[0] for m in moving["multipliers"]) == pytest.approx(-1.16869772, abs=1e-7)
