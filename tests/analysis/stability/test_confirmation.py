"""Interval proofs: exact decimals enter them, mpmath confirms them, and what is not continuous is refused."""

import mpmath
import numpy as np
import pytest
import sympy as sp
from mpmath import iv

from masking.analysis.stability.confirmation import enclosed_again, has_root
from masking.analysis.stability.crosscheck import contradiction, misjudged
from masking.analysis.stability.energy_certificate import certificate
from masking.analysis.stability.equilibria import equilibria, stability_of
from masking.analysis.stability.free_equations import Motion, jumps
from masking.analysis.stability.hypotheses import Hypotheses
from masking.analysis.stability.modes import eigenvalues
from masking.compile.codegen.graph import Graph
from masking.compile.codegen.intervals import Interval, enclose

X = sp.Symbol("x", real=True)
FUNCTIONS = {
    "sin(x)": mpmath.sin,
    "cos(2*x)": lambda x: mpmath.cos(2 * x),
    "exp(-x)/(2 + x**2)": lambda x: mpmath.exp(-x) / (2 + x**2),
    "tanh(x) - sinh(x)*cosh(x)": lambda x: mpmath.tanh(x) - mpmath.sinh(x) * mpmath.cosh(x),
    "atan(x)*sqrt(1 + x**2)": lambda x: mpmath.atan(x) * mpmath.sqrt(1 + x**2),
    "Max(x, 0.3)**2 + Abs(x) - Min(x, 0.1)": lambda x: (
        max(x, mpmath.mpf("0.3")) ** 2 + abs(x) - min(x, mpmath.mpf("0.1"))
    ),
    "log(3 + x)*tan(x/2)": lambda x: mpmath.log(3 + x) * mpmath.tan(x / 2),
}


def oscillator(declared, force, energy=None, **parameters):
    more = {"energy": energy} if energy else {}
    return declared(
        coordinates={"x": {"initial": 0.5}},
        parameters={n: {"value": x} for n, x in parameters.items()},
        equations={"x''": force},
        **more,
    )


@pytest.mark.parametrize("text", FUNCTIONS)
def test_both_enclosures_hold_the_values_of_mpmath(text):
    graph = Graph()
    x = graph.symbol("x", varying=True)
    node = graph.lower(sp.sympify(text, locals={"x": X}), {X: x})
    for low in np.linspace(-1.2, 1.0, 9):
        box = Interval.of(low, low + 0.2)
        (first,), (second,) = enclose(graph, [node], {x: box}), enclosed_again(graph, [node], {x: box})
        for at in np.linspace(low, low + 0.2, 7):
            with mpmath.workprec(200):
                value = FUNCTIONS[text](mpmath.mpf(float(at)))
            assert first.low <= value <= first.high
            assert value in second
        assert abs(float(second.delta) - float(first.width)) < 1e-12


@pytest.mark.parametrize(
    "number", [sp.Rational(1, 10), sp.Rational(3, 4), sp.sqrt(2), sp.pi / 7, sp.Rational(10**17 + 1)]
)
def test_an_enclosure_holds_the_exact_number(number):
    box = Interval.around(number)
    assert sp.Rational(float(box.low)) <= number <= sp.Rational(float(box.high))
    assert float(box.width) <= 5 * np.spacing(abs(float(number)))
    assert (float(box.width) == 0.0) is (number == sp.Rational(3, 4))


def test_mpmath_confirms_a_root_and_nothing_beside_it():
    graph = Graph()
    x = graph.symbol("x", varying=True)
    force, slope = graph.lower(X**2 - 2, {X: x}), graph.lower(2 * X, {X: x})
    for at, is_root in ((np.sqrt(2.0), True), (1.3, False)):
        box = Interval.of(np.array([at - 1e-12]), np.array([at + 1e-12]))
        assert has_root(graph, [force], [slope], [x], given={}, box=box) is is_root
    assert iv.prec == 53  # the precision of others is left alone


def test_what_mpmath_does_not_confirm_is_not_proved(declared, monkeypatch):
    model = oscillator(declared, "x - x**3 - x'", "x'**2/2 - x**2/2 + x**4/4")
    assert len(equilibria(model, {"x": (-3, 3)}).points) == 3
    monkeypatch.setattr("masking.analysis.stability.equilibria.has_root", lambda *_, **__: False)
    found = equilibria(model, {"x": (-3, 3)})
    assert not found.points
    assert not found.is_complete
    assert "not decided" in str(found)


def test_a_proof_on_a_box_is_taken_away_where_mpmath_does_not_confirm_it(declared, monkeypatch):
    model = oscillator(declared, "-x - (1 - x**2)*x'", "(x'**2 + x**2)/2")
    box = {"x": (-0.9, 0.9), "x'": (-1.0, 1.0)}
    assert certificate(model, box).status == "proved"
    monkeypatch.setattr("masking.analysis.stability.dissipation._Hessian.is_confirmed", lambda *_: False)
    assert certificate(model, box).status == "supported numerically"


def test_a_term_that_is_0_in_decimals_refutes_nothing(declared):
    """0.1 + 0.2 - 0.3 is 0, but 5.6e-17 in floating point: V' = -x'^4 would be positive for fast y."""
    model = declared(
        coordinates={"x": {"initial": 0.5}, "y": {"initial": 0.5}},
        parameters={"a": {"value": 0.1}, "d": {"value": 0.2}, "c": {"value": 0.3}},
        equations={"x''": "-x - x'**3 + (a + d - c)*y'**3", "y''": "-y"},
        energy="(x'**2 + y'**2 + x**2 + y**2)/2",
    )
    assert certificate(model).status != "refuted"


def test_a_bound_of_equilibria_holds_for_nearly_singular_stiffness(declared):
    """Stiffness [[1, 1], [1, 1 + 1e-12]]: y near -1e12, beyond what a rounded inverse bounds."""
    model = declared(
        coordinates={"x": {"initial": 0.1}, "y": {"initial": 0.1}},
        equations={"x''": "-x - y + sin(x)/2 + 1", "y''": "-x - (1 + 1e-12)*y"},
    )
    found = equilibria(model)
    assert not (found.is_global and found.is_complete and not found.points)


@pytest.mark.parametrize(
    ("expression", "edges"),
    [
        (sp.sign(X), ["x = 0"]),
        (X * sp.sign(X), []),
        (X**2 * sp.Heaviside(X - 1, sp.Rational(1, 2)), ["x - 1 = 0"]),
        ((X - 1) * sp.Heaviside(X - 1, sp.Rational(1, 2)), []),
        (sp.floor(X), ["floor(x) is a whole number"]),
        (sp.Max(X, 0) + sp.Abs(X), []),
        (sp.Piecewise((X, X < 1), (1, True)), []),
        (sp.Piecewise((X, X < 1), (2, True)), ["x < 1"]),
    ],
)
def test_jumps_are_told_from_kinks(expression, edges):
    assert jumps(expression) == edges


@pytest.mark.parametrize("force", ["-x - 0.1*sign(x')", "-x + 2*sign(x) - x'"])
def test_no_list_of_equilibria_is_complete_where_forces_jump(declared, force):
    """Dry friction 0.1 holds every |x| <= 0.1; -x + 2 sign x vanishes at 2, -2 and, between both sides, at 0."""
    with pytest.raises(Exception, match=r"the forces jump where x'? = 0"):
        equilibria(oscillator(declared, force))


@pytest.mark.parametrize(
    ("force", "words"),
    [
        ("-x - 0.1*x' + 2*abs(x')", "not decided by its eigenvalues"),  # +1.9 x' one way, -2.1 x' the other
        ("-x - 0.1*x' + 2*max(x', 0)", "not decided by its eigenvalues"),
        ("-x - x'", "asymptotically stable"),
        ("-x - 1e-11*x'", "asymptotically stable"),
        ("-x + 1e-11*x'", "unstable"),
        ("-x", "not decided by its eigenvalues"),
        ("-x**3", "not decided by its eigenvalues"),  # a double eigenvalue 0
    ],
)
def test_what_eigenvalues_tell(declared, force, words):
    assert stability_of(oscillator(declared, force), {"x": 0.0})[1] == words


def test_errors_of_eigenvalues_bound_what_rounding_does():
    """A Jordan block of size 3 with eigenvalue -1e-6 has eigenvalues off by the cube root of rounding, near 1e-5."""
    rng = np.random.default_rng(0)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    block = np.diag([-1e-6] * 3) + np.diag([1.0, 1.0], 1)
    values, errors = eigenvalues(turn @ block @ turn.T)
    assert np.all(np.abs(values + 1e-6) <= errors)


def test_words_of_an_equilibrium_are_compared_with_its_eigenvalues(declared):
    model = oscillator(declared, "x - x**3 - x'")
    assert not misjudged(model, [({"x": 0.0}, "unstable (proved)"), ({"x": 1.0}, "stable, the energy has a minimum")])
    assert misjudged(model, [({"x": 0.0}, "stable, the energy has a minimum there (proved)")]) == (
        "(x = 0) is unstable by its eigenvalues"
    )
    assert "asymptotically stable" in misjudged(model, [({"x": 1.0}, "unstable, it has an eigenvalue (proved)")])
    assert not misjudged(model, [({"x": 1.0}, "its stability is not shown")])


def test_a_motion_on_a_box_counts_until_it_leaves(declared):
    """V' = -(1 - x^2) x'^2 is negative inside of |x| < 1, and positive outside of it."""
    model = oscillator(declared, "-x - (1 - x**2)*x'", "(x'**2 + x**2)/2")
    motion = Motion(model, Hypotheses(model))
    assert not contradiction(motion, box={"x": (-0.9, 0.9), "x'": (-2.0, 2.0)})
    assert "gains energy" in contradiction(motion, box={"x": (-1.9, 1.9), "x'": (-1.9, 1.9)})


def test_a_minimum_of_an_energy_with_negative_kinetic_part_proves_nothing(declared):
    """x'' = x + x^3 + x' grows from 0, although its potential has a minimum there."""
    model = declared(
        coordinates={q: {"initial": 0.1} for q in ("x", "y")},
        equations={f"{q}''": f"{q} + {q}**3 + {q}'" for q in ("x", "y")},
        energy="(x**2 + y**2 - x'**2 - y'**2)/2 + (x**4 + y**4)/4",
    )
    (point,) = certificate(model).others
    assert point.stability == "unstable (by its eigenvalues)"
