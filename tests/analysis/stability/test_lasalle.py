"""Energy certificates of many oscillators on a damped beam: which of them go on, and which come to rest."""

import itertools

import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from masking.analysis.stability.energy_certificate import certificate
from masking.model.modelling.model import load_model


def relations(found):
    """Return each family as a set of texts, without those of velocities."""
    return [{str(r) for r in family.relations if "'" not in str(r)} for family in found.invariant.families]


def duffing(declared, a, b, mu):
    """Oscillators x_i'' = -a_i (x_i - y) - b_i (x_i - y)^3 on a damped beam y, with mass ratios mu_i."""
    xs = [f"x{i + 1}" for i in range(len(a))]
    force = [f"(a{i + 1}*({x} - y) + b{i + 1}*({x} - y)**3)" for i, x in enumerate(xs)]
    stored = [f"mu{i + 1}*({x}'**2/2 + a{i + 1}*({x} - y)**2/2 + b{i + 1}*({x} - y)**4/4)" for i, x in enumerate(xs)]
    values = {f"{n}{i + 1}": v for n, list_ in (("a", a), ("b", b), ("mu", mu)) for i, v in enumerate(list_)}
    return declared(
        coordinates={**{x: {"initial": 0.1} for x in xs}, "y": {"initial": 0}},
        oscillators=xs,
        parameters={name: {"value": value} for name, value in {**values, "d": 0.5}.items()},
        equations={
            **{f"{x}''": f"-{f}" for x, f in zip(xs, force, strict=True)},
            "y''": " + ".join(f"mu{i + 1}*{f}" for i, f in enumerate(force)) + " - y - d*y'",
        },
        energy=" + ".join(stored) + " + (y'**2 + y**2)/2",
    )


def simulate(a, b, mu, start, duration):
    """Return x_i - y (rows, n) and y (rows,) over the last twentieth of a simulation from rest."""
    a, b, mu = (np.array(x, dtype=float) for x in (a, b, mu))
    n = len(a)

    def rate(_, s):
        x, y, v = s[:n] - s[n], s[n], s[n + 1 :]
        force = a * x + b * x**3
        return [*v, *-force, mu @ force - y - 0.5 * v[n]]

    run = solve_ivp(rate, (0, duration), [*start, 0.0, *np.zeros(n + 1)], "DOP853", rtol=1e-8, atol=1e-10)
    late = run.y[:, run.t > 0.95 * duration]
    return (late[:n] - late[n]).T, late[n]


def pairings(names):
    """Return each way to take names two and two, one being left where they are odd."""
    if len(names) < 2:
        return [frozenset(names)]
    first, *rest = names
    with_first = [{f"{first} + {other}"} | p for other in rest for p in pairings([x for x in rest if x != other])]
    if len(names) % 2:
        with_first += [{first} | p for p in pairings(rest)]
    return [frozenset(p) for p in with_first]


@pytest.mark.parametrize("n", [3, pytest.param(5, marks=pytest.mark.search)])
def test_duffing_oscillators_that_are_alike_end_in_pairs(declared, n):
    found = certificate(duffing(declared, [1.0] * n, [1.0] * n, [0.1] * n))
    assert found.status == "proved"
    names = [f"x{i + 1}" for i in range(n)]
    assert sorted(map(sorted, relations(found))) == sorted(sorted(p | {"y"}) for p in pairings(names))
    assert found.others == ()


def test_three_duffing_oscillators_do_end_in_pairs():
    late, beam = simulate([1] * 3, [4.0] * 3, [0.3] * 3, [1.0, -0.85, 0.15], 2500.0)
    assert np.abs(beam).max() < 5e-3
    distances = [max(np.abs(late[:, i] + late[:, j]).max(), np.abs(late[:, 3 - i - j]).max()) for i, j in [(0, 1)]]
    assert min(distances) < 0.1
    assert np.abs(late).max() > 0.5


@pytest.mark.parametrize("amplitudes", [(0.3, 0.31), (1.0, 1.5), (2.0, 9.0)])
@pytest.mark.parametrize("a", [0.0, 1.0, 5.0])
def test_poles_are_nearer_the_larger_the_amplitude(amplitudes, a):
    """x = A cn(Om t, k) has its nearest poles at K'(k)/Om from each extremum, as the integral in the module says."""
    heights = []
    for size in amplitudes:
        fast = mpmath.sqrt(a + size**2)
        m = size**2 / (2 * fast**2)
        heights.append(mpmath.ellipk(1 - m) / fast)
        integral = mpmath.quad(
            lambda u, size=size: 2 / mpmath.sqrt((2 + u**2) * (a + size**2 * (2 + 2 * u**2 + u**4) / 2)),
            [0, 1, mpmath.inf],
        )  # s = 1 + u^2
        assert mpmath.almosteq(heights[-1], integral, 1e-12)
    assert heights[0] > heights[1]


def test_linear_oscillators_go_on_with_any_phases_and_cubic_ones_do_not(declared):
    """Three phases a third of a period apart add up to 0 where all is linear."""
    (stays,) = relations(certificate(duffing(declared, [1.0] * 3, [0.0] * 3, [0.1] * 3)))
    assert stays == {"x1 + x2 + x3", "y"}


def test_oscillators_that_differ_come_to_rest(declared):
    found = certificate(duffing(declared, [1.0, 1.2, 1.5], [1.0] * 3, [0.1] * 3))
    assert found.conclusion.startswith("every motion converges to the equilibrium (x1 = 0, x2 = 0, x3 = 0, y = 0)")
    assert {"a1 - a2 != 0", "a1 - a3 != 0", "a2 - a3 != 0"} <= set(found.hypotheses)
    late, _ = simulate([1.0, 1.2, 1.5], [1.0] * 3, [0.4] * 3, [0.9, -0.8, 0.2], 1500.0)
    assert np.abs(late).max() < 0.06


def test_an_oscillator_that_does_not_act_on_the_beam_is_not_said_to_rest(declared):
    """x3 swings by itself where the beam rests: its force on the beam is (p - q) x3 with p = q."""
    xs = ("x1", "x2", "x3")
    force = {x: f"({x} - y + ({x} - y)**3)" for x in xs[:2]}
    model = declared(
        coordinates={x: {"initial": 0.1} for x in (*xs, "y")},
        parameters={"p": {"value": 1.0}, "q": {"value": 1.0}, "d": {"value": 0.5}},
        equations={
            **{f"{x}''": f"-{f}" for x, f in force.items()},
            "x3''": "-x3 - x3**3 - (p - q)*(x3 - y)",
            "y''": f"{force['x1']} + {force['x2']} + (p - q)*(x3 - y) - y - d*y'",
        },
        energy=" + ".join(f"{x}'**2/2 + ({x} - y)**2/2 + ({x} - y)**4/4" for x in xs[:2])
        + " + (x3'**2 + x3**2 + (p - q)*(x3 - y)**2 + y'**2 + y**2)/2 + x3**4/4",
    )
    found = certificate(model)
    assert found.status == "open" or relations(found) == [{"x1 + x2", "y"}]


@pytest.mark.search
def test_a_heavy_oscillator_balances_two_light_ones(declared):
    found = certificate(duffing(declared, [1.0] * 3, [1.0] * 3, [0.1, 0.1, 0.2]))
    assert relations(found) == [{"-x1 + x2", "x1 + x3", "y"}, {"x1 + x2", "x3", "y"}]
    assert "2*mu - mu3 = 0" in found.hypotheses
    other = certificate(duffing(declared, [1.0] * 3, [1.0] * 3, [0.1, 0.1, 0.21]))
    assert relations(other) == [{"x1 + x2", "x3", "y"}]


@pytest.mark.search
def test_three_oscillators_that_are_alike_may_balance_a_fourth_that_is_not(declared):
    """Elliptic functions a third of a period apart add up to one with a third of the period."""
    m = mpmath.mpf("0.2")
    fast = 1 / mpmath.sqrt(1 - 2 * m)
    period = 4 * mpmath.ellipk(m) / fast
    m4 = mpmath.mfrom(q=mpmath.qfrom(m=m) ** 3)
    fast4 = 12 * mpmath.ellipk(m4) / period
    a4 = fast4**2 * (1 - 2 * m4)

    def cn(t, fast, m):
        return mpmath.sqrt(2 * m) * fast * mpmath.ellipfun("cn", fast * t, m=m)  # of x'' = -a x - x^3

    for t in (0.1, 0.7, 1.9):
        total = sum(cn(t + k * period / 3, fast, m) for k in range(3))
        assert mpmath.almosteq(total, cn(t, fast4, m4), 1e-12)
    found = certificate(duffing(declared, [1.0] * 3 + [float(a4)], [1.0] * 4, [0.1] * 4))
    assert found.status == "open"
    assert "the poles of " in " ".join(found.invariant.steps)


def clocks(declared, lengths):
    """Pendula of 50 g on a damped carriage."""
    n = len(lengths)
    pendulum = "m*(l{0}**2*th{0}'**2/2 + l{0}*x'*th{0}'*cos(th{0}) + g*l{0}*cos(th{0}))"
    values = {"M": (0.8, "kg"), "k": (70, "N/m"), "b": (10, "N*s/m"), "g": (9.81, "m/s**2"), "m": (0.05, "kg")}
    values |= {f"l{i + 1}": (x, "m") for i, x in enumerate(lengths)}
    angles = [f"th{i + 1}" for i in range(n)]
    return declared(
        coordinates={**{x: {"initial": 0.1, "unit": "rad"} for x in angles}, "x": {"initial": 0, "unit": "m"}},
        oscillators=angles,
        parameters={name: {"value": value, "unit": unit} for name, (value, unit) in values.items()},
        lagrangian=f"(M + {n}*m)*x'**2/2 - k*x**2/2 + " + " + ".join(pendulum.format(i + 1) for i in range(n)),
        dissipation="b*x'**2/2",
    )


@pytest.mark.parametrize("n", [3, pytest.param(5, marks=pytest.mark.search)])
def test_clocks_that_are_alike_end_in_pairs_and_one_hangs_or_stands(declared, n):
    found = certificate(clocks(declared, [0.25] * n))
    names = [f"th{i + 1}" for i in range(n)]
    expected = []
    for pairing in pairings(names):
        (one,) = (x for x in pairing if "+" not in x)
        expected += [pairing | {"x"}, pairing - {one} | {f"{one} - pi", "x"}]
    assert sorted(map(sorted, relations(found))) == sorted(map(sorted, expected))
    assert found.others == ()


@pytest.mark.parametrize("n", [2, pytest.param(3, marks=pytest.mark.search)])
def test_clocks_of_different_lengths_come_to_rest(declared, n):
    found = certificate(clocks(declared, [0.25, 0.3, 0.35][:n]))
    assert found.status == "proved"
    assert found.conclusion == f"every motion converges to one of {2**n} equilibria"
    places = {tuple(p.position.values()) for p in found.others}
    assert places == {(*p, "0") for p in itertools.product(("0", "pi"), repeat=n)}


@pytest.mark.search
def test_a_chain_of_cubic_springs_that_is_damped_at_its_end_comes_to_rest(declared):
    """Where x1 rests, its equation holds x2 alone, so that x2 rests, and so on; cubic springs let x1 = c, but not 0."""
    springs = ["x1**3 + x1", "(x2 - x1)**3 + (x2 - x1)", "(x3 - x2)**3 + (x3 - x2)"]
    chain = {
        "coordinates": {x: {"initial": 0.1} for x in ("x1", "x2", "x3")},
        "parameters": {"d": {"value": 0.1}},
        "energy": "(x1'**2 + x2'**2 + x3'**2 + x1**2 + (x2 - x1)**2 + (x3 - x2)**2)/2"
        " + (x1**4 + (x2 - x1)**4 + (x3 - x2)**4)/4",
    }
    forces = [f"-({springs[0]}) + {springs[1]}", f"-({springs[1]}) + {springs[2]}", f"-({springs[2]})"]
    for damped in (0, 2):
        equations = {f"x{i + 1}''": f + (f" - d*x{i + 1}'" if i == damped else "") for i, f in enumerate(forces)}
        found = certificate(declared(equations=equations, **chain))
        assert found.conclusion.startswith("every motion converges to the equilibrium (x1 = 0, x2 = 0, x3 = 0)")
    # In the middle, the masses at both ends may move so that their forces cancel.
    equations = {f"x{i + 1}''": f + (" - d*x2'" if i == 1 else "") for i, f in enumerate(forces)}
    assert "converges to the equilibrium" not in certificate(declared(equations=equations, **chain)).conclusion


@pytest.mark.parametrize(
    ("change", "hypothesis"),
    [
        ({"w2": 1.1}, "w1 - w2 != 0"),
        pytest.param({"nu2": 0.5}, "nu1 - nu2 != 0", marks=pytest.mark.search),
        pytest.param({"mu2": 0.15}, "mu1 - mu2 != 0", marks=pytest.mark.search),
    ],
)
def test_discs_that_differ_come_to_rest(change, hypothesis):
    """In anti-phase the middle disc rests only if all of their springs, masses and eccentricities agree."""
    found = certificate(load_model("discs_eccentric").with_parameters(**change).dimensionless())
    assert found.conclusion.startswith("every motion converges to the equilibrium (th1 = 0, th2 = 0, th3 = 0)")
    assert hypothesis in found.hypotheses
