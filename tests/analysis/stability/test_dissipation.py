"""Energy certificates by the way in which energy is lost, and where motion may go on for ever: against simulations."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from masking.analysis.stability.energy_certificate import certificate


def pair(declared, loss, *, on="-"):
    """Two masses, each on a spring of 1, with one between them; the loss acts on the first, or between both."""
    return declared(
        coordinates={"x": {"initial": 0.5}, "y": {"initial": 0.2}},
        equations={"x''": f"-2*x + y - {loss}", "y''": f"-2*y + x + {loss}" if on == "-" else "-2*y + x"},
        energy="(x'**2 + y'**2 + x**2 + y**2 + (x - y)**2)/2",
    )


AT_REST = "every motion converges to the equilibrium (x = 0, y = 0)"
IN_PHASE = "every motion converges to the set x - y = 0, x' - y' = 0"


@pytest.mark.parametrize(
    ("loss", "on", "conclusion"),
    [
        ("tanh(5*x')", "x", AT_REST),
        ("abs(x')*x'", "x", AT_REST),
        ("x'**3", "x", AT_REST),
        ("x**2*x'", "x", AT_REST),  # where x = 0 stays, x' = 0, too
        ("(x' - y')**3", "-", IN_PHASE),
        ("atan(x' - y')", "-", IN_PHASE),
        ("sign(x')", "x", "the energy never grows; every motion is bounded"),  # sticks where the spring is weaker
        ("(1 + sign(y))*x'", "x", "the energy never grows; every motion is bounded"),  # no loss where y < 0
    ],
)
def test_what_each_loss_proves(declared, loss, on, conclusion):
    found = certificate(pair(declared, loss, on=on))
    assert found.status == "proved"
    assert found.conclusion.startswith(conclusion)


@pytest.mark.parametrize(
    ("loss", "on", "left"),
    [
        (lambda x, y, v, w: np.tanh(5 * v), "x", lambda x, y: (x, y)),
        (lambda x, y, v, w: np.arctan(v - w), "-", lambda x, y: (x - y,)),
    ],
)
def test_losses_take_the_energy_that_they_are_said_to_take(loss, on, left):
    def rate(_, s):
        x, y, v, w = s
        force = loss(*s)
        return [v, w, -2 * x + y - force, -2 * y + x + (force if on == "-" else 0.0)]

    run = solve_ivp(rate, (0, 200), [0.5, 0.2, 0.0, 0.0], rtol=1e-9, atol=1e-11)
    assert max(abs(z[-1]) for z in left(run.y[0], run.y[1])) < 1e-4


@pytest.mark.parametrize(("b", "is_lost"), [(1.0, False), (0.5, True)])
def test_a_loss_that_parameters_cancel_is_none(declared, b, is_lost):
    """x'' = -x - (a - b) x^2 x': with a = b nothing is lost."""
    found = certificate(
        declared(
            coordinates={"x": {"initial": 0.5}},
            parameters={"a": {"value": 1.0}, "b": {"value": b}},
            equations={"x''": "-x - (a - b)*x**2*x'"},
            energy="(x'**2 + x**2)/2",
        )
    )
    assert ("converges to the equilibrium (x = 0)" in found.conclusion) is is_lost


@pytest.mark.parametrize("loss", ["-tanh(5*x')", "x'**3 - x'", "(x' - y')**3*x**3", "-abs(x')*x'"])
def test_a_loss_with_the_wrong_sign_is_refuted(declared, loss):
    assert certificate(pair(declared, loss)).status == "refuted"


def test_steps_that_cancel_are_none(declared):
    """A stop: the slope of max(x - 1, 0)^2/2 is max(x - 1, 0) times a step."""
    model = declared(
        coordinates={"x": {"initial": 0.5}},
        parameters={"k": {"value": 4.0}, "d": {"value": 0.1}},
        equations={"x''": "-x - k*max(x - 1, 0) - d*x'"},
        energy="(x'**2 + x**2 + k*max(x - 1, 0)**2)/2",
    )
    found = certificate(model)
    assert found.conclusion.startswith("every motion converges to the equilibrium (x = 0)")
    wrong = declared(
        coordinates={"x": {"initial": 0.5}},
        equations={"x''": "-x - max(x - 1, 0) + max(x - 1, 0)*x' - x'/10"},
        energy="(x'**2 + x**2 + max(x - 1, 0)**2)/2",
    )
    assert certificate(wrong).status == "refuted"


@pytest.mark.parametrize(
    ("forces", "potential", "conclusion", "is_adrift"),
    [
        (("y - x - x'", "x - y"), "(x - y)**2/2", "every motion converges to the set -x + y = 0, x' = 0, y' = 0", True),
        (("y - x - x' - sin(x)", "x - y - sin(y)"), "(x - y)**2/2 - cos(x) - cos(y)", "every motion converges", True),
        # With a spring from one to the wall.
        (
            ("y - x - x' - sin(x) - x", "x - y - sin(y)"),
            "(x - y)**2/2 - cos(x) - cos(y) + x**2/2",
            "every motion",
            False,
        ),
        # Periods in no ratio: no displacement changes nothing.
        (
            ("y - x - x' - sin(x)", "x - y - sqrt(2)*sin(sqrt(2)*y)"),
            "(x - y)**2/2 - cos(x) - cos(sqrt(2)*y)",
            "every motion that is bounded converges",
            False,
        ),
        # Dry ground that slopes: V is not the same further down.
        (("y - x - x' + 1", "x - y + 1"), "(x - y)**2/2 - x - y", "every motion that is bounded", False),
    ],
)
def test_motion_that_may_go_on_for_ever_is_looked_at_modulo_what_changes_nothing(
    declared, forces, potential, conclusion, is_adrift
):
    found = certificate(
        declared(
            coordinates={"x": {"initial": 0.5}, "y": {"initial": 0.2}},
            equations={"x''": forces[0], "y''": forces[1]},
            energy=f"(x'**2 + y'**2)/2 + {potential}",
        )
    )
    assert found.conclusion.startswith(conclusion) or found.conclusion.startswith("no motion is bounded")
    assert found.boundedness.is_adrift is is_adrift
    if is_adrift:
        assert not found.boundedness.is_shown


def test_a_pendulum_on_a_damped_carriage_comes_to_rest(declared):
    """Where x = c, the rail's force is a function of th alone by the pendulum's energy: 3 sin(2 th)/2 + 2 E sin(th)."""
    found = certificate(
        declared(
            coordinates={"x": {"initial": 0.0}, "th": {"initial": 1.0, "unit": "rad"}},
            parameters={"M": {"value": 1.0}, "k": {"value": 1.0}, "b": {"value": 0.3}},
            lagrangian="(M + 1)*x'**2/2 + th'**2/2 + x'*th'*cos(th) + cos(th) - k*x**2/2",
            dissipation="b*x'**2/2",
        )
    )
    assert found.status == "proved"
    assert {tuple(p.position.values()): p.is_unstable for p in found.others} == {("0", "0"): False, ("0", "pi"): True}

    def rate(_, s):
        x, th, v, w = s
        mass = np.array([[2.0, np.cos(th)], [np.cos(th), 1.0]])
        return [v, w, *np.linalg.solve(mass, [w**2 * np.sin(th) - x - 0.3 * v, -np.sin(th)])]

    run = solve_ivp(rate, (0, 400), [0.0, 2.5, 0.0, 0.5], rtol=1e-9, atol=1e-11)
    assert abs(np.sin(run.y[1, -1] / 2)) + abs(run.y[0, -1]) < 1e-3
