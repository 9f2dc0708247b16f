"""Energy certificates of pendula that a damper joins, and of double pendula, against simulations."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from masking.analysis.stability.energy_certificate import certificate

G = 9.81


def relations(found):
    """Return each family as a set of texts."""
    return [{str(r) for r in family.relations} for family in found.invariant.families]


def places(found):
    """Return the equilibria outside of the families, and whether each is proved to be unstable."""
    return {tuple(p.position.values()): p.is_unstable for p in found.others}


def joined(declared, lengths, masses=(1.0, 1.0), sign="-"):
    """Two pendula with a damper between their joints; its torque goes with th1' - th2'."""
    lost = f"(th1' {sign} th2')"
    pendulum = "m{0}*(l{0}**2*th{0}'**2/2 + g*l{0}*cos(th{0}))"
    return declared(
        coordinates={name: {"initial": 0.5, "unit": "rad"} for name in ("th1", "th2")},
        parameters={
            "g": {"value": G, "unit": "m/s**2"},
            "c": {"value": 0.2, "unit": "N*m*s"},
            **{f"l{i + 1}": {"value": x, "unit": "m"} for i, x in enumerate(lengths)},
            **{f"m{i + 1}": {"value": x, "unit": "kg"} for i, x in enumerate(masses)},
        },
        lagrangian=f"{pendulum.format(1)} + {pendulum.format(2)}",
        dissipation=f"c*{lost}**2/2",
    )


def swing(lengths, start, duration=400.0):
    """Return angles (rows, 2) of the two over the last part of a simulation with unit masses."""
    a, b = lengths

    def rate(_, y):
        torque = 0.2 * (y[2] - y[3])
        return [y[2], y[3], -G / a * np.sin(y[0]) - torque / a**2, -G / b * np.sin(y[1]) + torque / b**2]

    run = solve_ivp(rate, (0, duration), start, "DOP853", rtol=1e-9, atol=1e-11)
    return run.y[:2, run.t > 0.9 * duration].T


@pytest.mark.parametrize("masses", [(1.0, 1.0), (1.0, 3.0)])
def test_two_pendula_of_one_length_that_a_damper_joins_swing_together(declared, masses):
    found = certificate(joined(declared, (1.0, 1.0), masses))
    assert found.status == "proved"
    assert relations(found) == [{"th1 - th2", "th1' - th2'"}]
    assert places(found) == {("0", "pi"): True, ("pi", "0"): True}
    late = swing((1.0, 1.0), [1.0, -0.4, 0.0, 0.0])
    assert np.abs(late[:, 0] - late[:, 1]).max() < 1e-3
    assert np.abs(late).max() > 0.1


def test_two_pendula_of_unlike_lengths_that_a_damper_joins_come_to_rest(declared):
    found = certificate(joined(declared, (1.0, 1.5)))
    assert found.status == "proved"
    assert relations(found) == []
    assert "l1 - l2 != 0" in found.hypotheses
    assert set(places(found)) == {("0", "0"), ("0", "pi"), ("pi", "0"), ("pi", "pi")}
    assert np.abs(swing((1.0, 1.5), [1.0, -0.4, 0.0, 0.0])).max() < 1e-3


def test_a_damper_of_the_sum_leaves_the_anti_phase(declared):
    found = certificate(joined(declared, (1.0, 1.0), sign="+"))
    assert relations(found) == [{"th1 + th2", "th1' + th2'"}]


def double(declared, coupling=1.0, damped=("th1'", "th2' - th1'")):
    """The double pendulum of point masses, angles from the vertical; physical where the coupling is 1."""
    return declared(
        coordinates={name: {"initial": 0.5, "unit": "rad"} for name in ("th1", "th2")},
        parameters={
            "g": {"value": G, "unit": "m/s**2"},
            "c": {"value": 0.1, "unit": "N*m*s"},
            "l1": {"value": 1.0, "unit": "m"},
            "l2": {"value": 0.7, "unit": "m"},
            "m1": {"value": 1.0, "unit": "kg"},
            "m2": {"value": 0.5, "unit": "kg"},
        },
        lagrangian="(m1 + m2)*l1**2*th1'**2/2 + m2*l2**2*th2'**2/2"
        f" + {coupling}*m2*l1*l2*th1'*th2'*cos(th1 - th2) + (m1 + m2)*g*l1*cos(th1) + m2*g*l2*cos(th2)",
        dissipation=" + ".join(f"c*({v})**2/2" for v in damped),
    )


def test_a_double_pendulum_with_damped_joints_hangs_in_the_end(declared):
    found = certificate(double(declared))
    assert found.status == "proved"
    assert found.conclusion == "every motion converges to one of 4 equilibria"
    assert places(found) == {("0", "0"): False, ("0", "pi"): True, ("pi", "0"): True, ("pi", "pi"): True}
    assert found.reasons[-1].endswith("almost every motion converges to (th1 = 0, th2 = 0).")
    # Linearised by hand at each of them: M a + C v + K q = 0 has an eigenvalue with positive real part but at (0, 0).
    for (one, two), is_unstable in places(found).items():
        signs = np.array([1.0 if x == "0" else -1.0 for x in (one, two)])
        mass = np.array([[1.5, 0.35 * signs.prod()], [0.35 * signs.prod(), 0.245]])
        lost, stiffness = 0.1 * np.array([[2.0, -1.0], [-1.0, 1.0]]), np.diag([1.5 * G, 0.35 * G] * signs)
        inverse = np.linalg.inv(mass)
        matrix = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiffness, -inverse @ lost]])
        assert (np.linalg.eigvals(matrix).real.max() > 0.0) == is_unstable


def test_a_kinetic_energy_that_is_not_positive_bounds_no_motion(declared):
    """With three times the coupling, its determinant is negative where the arms are in line."""
    found = certificate(double(declared, coupling=3.0))
    assert not found.boundedness.is_shown
    assert "every motion that is bounded" in found.conclusion or found.status != "proved"


def test_a_double_pendulum_that_is_damped_at_one_joint_is_not_said_to_come_to_rest(declared):
    found = certificate(double(declared, damped=("th2' - th1'",)))
    assert found.status == "open"
    assert found.boundedness.is_shown


def test_the_kinetic_energy_of_three_arms_is_positive_by_intervals(declared):
    """T of three unit masses on unit arms: its third minor has no sign by its form alone."""
    arms = range(1, 4)
    speeds = [[" + ".join(f"th{i}'*{wave}(th{i})" for i in range(1, k + 1)) for wave in ("cos", "sin")] for k in arms]
    model = declared(
        coordinates={f"th{k}": {"initial": 0.1, "unit": "rad"} for k in arms},
        parameters={"m": {"value": 1.0}},
        lagrangian=" + ".join(f"m*(({x})**2 + ({y})**2)/2" for x, y in speeds)
        + " + m*(3*cos(th1) + 2*cos(th2) + cos(th3))",
        dissipation="m*(th1'**2 + (th2' - th1')**2 + (th3' - th2')**2)/2",
    )
    found = certificate(model)
    assert found.conclusion == "every motion converges to one of 8 equilibria"
    assert "and, as to the kinetic energy, m = 1" in found.hypotheses
    assert [p for p, is_unstable in places(found).items() if not is_unstable] == [("0", "0", "0")]


def test_gyroscopic_forces_may_hold_a_saddle_that_damping_by_the_cube_does_not_move(declared):
    """Linearised, x'' = x + 4 y' and y'' = y - 4 x' have imaginary eigenvalues: it is not proved to be unstable."""
    found = certificate(
        declared(
            coordinates={"x": {"initial": 0.1}, "y": {"initial": 0.1}},
            equations={"x''": "x + 4*y' - x'**3", "y''": "y - 4*x' - y'**3"},
            energy="(x'**2 + y'**2 - x**2 - y**2)/2",
        )
    )
    matrix = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [1, 0, 0, 4], [0, 1, -4, 0]])
    assert np.abs(np.linalg.eigvals(matrix).real).max() < 1e-12
    assert not any(p.is_unstable for p in found.others or ())
