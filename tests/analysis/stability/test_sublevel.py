"""Sublevel sets of the energy as inner estimates of basins: against passes in closed form, and simulations."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from masking.analysis.stability.energy_certificate import certificate


def single(declared, force, potential, damping="b", **unit):
    return declared(
        coordinates={"x": {"initial": 0.5, **unit}},
        parameters={"b": {"value": 0.3}},
        equations={"x''": f"{force} - {damping}*x'"},
        energy=f"x'**2/2 + {potential}",
    )


CASES = {  # force, potential, damping, {equilibrium: the lowest pass around it}
    "double well": ("x - x**3", "-x**2/2 + x**4/4", "b", {-1.0: 0.0, 1.0: 0.0}),
    "pendulum": ("-sin(x)", "-cos(x)", "b", {0.0: 1.0}),
    "softening spring": ("-x + x**3", "x**2/2 - x**4/4", "b", {0.0: 0.25}),
    "open to one side": ("-x + x**2", "x**2/2 - x**3/3", "b", {0.0: 1 / 6}),
    # V' = -b (1 - x^2) x'^2 <= 0 where |x| <= 1: van der Pol's oscillator with time reversed
    "damping that turns into drive": ("-x", "x**2/2", "b*(1 - x**2)", {0.0: 0.5}),
}


@pytest.mark.parametrize("name", CASES)
def test_a_basin_reaches_up_to_the_lowest_pass(declared, name):
    force, potential, damping, passes = CASES[name]
    unit = {"unit": "rad"} if name == "pendulum" else {}
    found = certificate(single(declared, force, potential, damping, **unit)).basins
    levels = {basin.position["x"]: basin.level for basin in found}
    assert levels.keys() == passes.keys()
    for x, level in levels.items():
        assert passes[x] - 2e-3 <= level <= passes[x]


@pytest.mark.parametrize("name", CASES)
def test_motion_that_starts_in_a_basin_ends_at_its_equilibrium(declared, name):
    force, potential, damping, _ = CASES[name]
    model = single(declared, force, potential, damping, **({"unit": "rad"} if name == "pendulum" else {}))
    names = {"sin": np.sin, "cos": np.cos, "b": 0.3}

    texts = (force, potential, damping)
    known = {text: eval(f"lambda x: {text}", names) for text in texts}  # noqa: S307  # the texts are of this file

    def at(text, x):
        return known[text](x)

    rng = np.random.default_rng(1)
    for basin in certificate(model).basins:
        rest = basin.position["x"]
        for share in rng.uniform(0.5, 0.999, 3):
            # On the level, between the equilibrium and the pass, with what is missing as kinetic energy.
            x = rest + rng.uniform(-0.5, 0.5) * 0.9
            level = basin.least + share * (basin.level - basin.least)
            if at(potential, x) > level:
                x = rest
            v = rng.choice([-1.0, 1.0]) * np.sqrt(2 * (level - at(potential, x)))
            run = solve_ivp(
                lambda _, y: [y[1], at(force, y[0]) - at(damping, y[0]) * y[1]], (0, 400), [x, v], rtol=1e-9, atol=1e-11
            )
            assert abs(run.y[0, -1] - rest) < 1e-3


def test_the_level_cannot_be_raised():
    """Over the pass at x = 1 of x'' = -x + x^3 - b x', motion runs away: V = 0.2502 at first."""
    over = lambda _, y: abs(y[0]) - 3.0  # noqa: E731  # solve_ivp wants it to have an attribute
    over.terminal = True
    run = solve_ivp(lambda _, y: [y[1], -y[0] + y[0] ** 3 - 0.3 * y[1]], (0, 50), [1.0, 0.02], events=over)
    assert len(run.t_events[0]) == 1


def test_two_coordinates_stay_below_the_three_passes_of_henon_and_heiles(declared):
    model = declared(
        coordinates={"x": {"initial": 0.1}, "y": {"initial": 0.1}},
        parameters={"b": {"value": 0.3}},
        equations={"x''": "-x - 2*x*y - b*x'", "y''": "-y - x**2 + y**2 - b*y'"},
        energy="(x'**2 + y'**2 + x**2 + y**2)/2 + x**2*y - y**3/3",
    )
    (basin,) = certificate(model).basins
    assert basin.position == {"x": 0.0, "y": 0.0}
    assert 0.166 < basin.level <= 1 / 6


def test_a_double_pendulum_that_cannot_turn_over_ends_hanging(declared):
    model = declared(
        coordinates={name: {"initial": 0.5, "unit": "rad"} for name in ("th1", "th2")},
        parameters={"c": {"value": 0.1}, "r": {"value": 0.5}},
        lagrangian="(1 + r)*th1'**2/2 + r*th2'**2/2 + r*th1'*th2'*cos(th1 - th2) + (1 + r)*cos(th1) + r*cos(th2)",
        dissipation="c*(th1'**2 + (th2' - th1')**2)/2",
    )
    (basin,) = certificate(model).basins
    assert basin.level == pytest.approx(-1.5 + 0.5, abs=1e-4)  # the lower arm stands
    assert basin.level <= -1.0
    assert basin.least == pytest.approx(-2.0, abs=1e-12)


@pytest.mark.parametrize(
    ("force", "potential", "damping"),
    [
        ("-x", "x**2/2", "b*(x**2 - 1)"),  # driven at 0
        ("x", "-x**2/2", "b"),  # no minimum
        ("-x", "x**2/2", "0*b"),  # nothing is lost
    ],
)
def test_where_nothing_attracts_there_is_no_basin(declared, force, potential, damping):
    assert certificate(single(declared, force, potential, damping)).basins == ()


def test_saying_where_a_basin_is(declared):
    found = certificate(single(declared, "-x + x**3", "x**2/2 - x**4/4"))
    (line,) = (line for line in str(found).splitlines() if "basin of attraction" in line)
    assert "every motion that starts where V < 0.249999, in the connected part of this set around (x = 0)" in line
    assert line.endswith("that part lies in -1 <= x <= 1")
    (entry,) = found.as_dict()["basins"]
    assert entry["position"] == {"x": 0.0}
