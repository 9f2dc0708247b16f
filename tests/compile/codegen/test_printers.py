"""Compiled code: the same numbers as sympy, mpmath and a C compiler, and modules that are found again."""

import ctypes
import json
import math
import operator
import os
import shutil
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import mpmath
import numpy as np
import pytest
import sympy as sp
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from masking import load_model
from masking.compile.codegen import content_hashes, llvm_text, machine_code, module_store
from masking.compile.codegen.c_functions import EXTREMES
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.graph import Graph
from masking.compile.codegen.graph_values import values_of
from masking.compile.codegen.printers import C, statements
from masking.compile.codegen.taylor_coefficients import Dynamics, degree, factored, is_analytic, with_common_factors
from masking.compile.codegen.taylor_loops import Loops
from masking.compile.codegen.trusted_files import write_whole
from masking.compile.numerics import runge_kutta
from masking.compile.numerics.rig_sizes import LANES
from masking.errors import ModelError
from masking.inference.discovery import compiled_laws
from masking.model.declaration import registry
from masking.model.declaration.expression import Expression
from masking.model.declaration.operations import FUNCTIONS
from masking.model.effects import EFFECTS
from masking.model.modelling.lowering import module
from masking.model.modelling.model import Model
from tests.benchmarks import many
from tests.support.python_language import PYTHON

NAMES = ("x", "y", "z")
SYMBOLS = {name: sp.Symbol(name, real=True) for name in NAMES}
POINTS = ((0.7, -1.3, 0.25), (-0.4, 0.9, 1.7), (1.1, 0.2, -0.6))


def trees():
    """Return expressions over all functions whose values and derivatives stay of order 1 to 100."""
    leaves = st.sampled_from([*NAMES, *NAMES, "2", "0.5", "1/3", "pi", "1.7"])

    def grow(inner):
        wrapped = [f"{f}({{}})" for f in ("sin", "cos", "tanh", "atan", "abs", "sign", "heaviside", "-")] + [
            f"{f}(tanh({{}}))" for f in ("exp", "sinh", "cosh", "asin", "acos", "tan")
        ]
        wrapped += [
            "sqrt(1 + ({})**2)",
            "log(2 + abs({}))",
            "(1.5 + tanh({}))**2.5",
            "({})**2",
            "tanh({})**-2",
            "2**tanh({})",
        ]
        one = st.tuples(st.sampled_from(wrapped), inner).map(lambda pair: pair[0].format(pair[1]))
        two = st.tuples(
            st.sampled_from(
                ["({}) + {}", "({}) - ({})", "({})*({})", "({})/(2 + abs({}))", "min({}, {})", "max({}, {})",
                 "atan2({}, {})", "(1.2 + tanh({}))**tanh({})"]
            ),
            inner,
            inner,
        ).map(lambda parts: parts[0].format(*parts[1:]))  # fmt: skip
        choice = st.tuples(inner, st.sampled_from(["<", "<=", ">", ">="]), inner, inner, inner).map(
            lambda p: f"where({p[0]} {p[1]} {p[2]}, {p[3]}, {p[4]})"
        )
        return st.one_of(one, two, two, choice)

    return st.recursive(leaves, grow, max_leaves=6)


def lowered(texts):
    """Return a graph and the node of each expression."""
    graph = Graph()
    known = {SYMBOLS[name]: graph.symbol(name, varying=True) for name in NAMES}
    return graph, [graph.lower(Expression(text).to_sympy(SYMBOLS), known) for text in texts]


def python_source(texts):
    graph, nodes = lowered(texts)
    body = ["x, y, z = v[0], v[1], v[2]", *statements(graph, [(f"out[{i}]", n) for i, n in enumerate(nodes)], PYTHON)]
    return "\n".join(["def f(v, out):", *(f"    {line}" for line in body)])


def run_llvm(texts, points):
    graph, nodes = lowered(texts)
    results = [(f"out[{i}]", node) for i, node in enumerate(nodes)]

    def build():
        made = Module("test", {})
        made.add("f(v, out)", graph, results, {name: f"v[{i}]" for i, name in enumerate(NAMES)})
        return made

    return evaluate(module_store.load(module_store.key({"test": texts}), build).function("f"), texts, points)


def run_lanes(texts, points):
    """Run expressions in lanes, a point in each; the last have copies."""
    graph, nodes = lowered(texts)
    results = [(f"out[{i}]", node) for i, node in enumerate(nodes)]

    def build():
        made = Module("test", {})
        loads = {name: f"v[{i}]" for i, name in enumerate(NAMES)}
        made.add("f(v: Matrix, out: Matrix)", graph, results, loads, lanes=LANES)
        return made

    function, found = module_store.load(module_store.key({"lanes": texts}), build).function("f"), []
    for first in range(0, len(points), LANES):
        part, out = np.resize(points[first : first + LANES], (LANES, len(NAMES))), np.empty((len(texts), LANES))
        function(np.ascontiguousarray(part.T), out)
        found.append(out.T)
    return np.concatenate(found)[: len(points)]


def run_c(texts, points, folder):
    graph, nodes = lowered(texts)
    body = [f"const double {name} = v[{i}];" for i, name in enumerate(NAMES)]
    body += statements(graph, [(f"out[{i}]", n) for i, n in enumerate(nodes)], C)
    source, library = folder / "f.c", folder / "f.so"
    extremes = [EXTREMES[name].format(real="double") for name in ("smaller", "larger")]
    source.write_text("\n".join(["#include <math.h>", *extremes, "void f(const double *v, double *out) {", *body, "}"]))
    subprocess.run(
        ["gcc", "-O2", "-Wall", "-Werror", "-Wno-unused", "-shared", "-fPIC", source, "-lm", "-o", library], check=True
    )
    pointer = ctypes.POINTER(ctypes.c_double)
    function = ctypes.CDLL(str(library)).f
    function.argtypes, function.restype = [pointer, pointer], None
    return evaluate(lambda v, out: function(v.ctypes.data_as(pointer), out.ctypes.data_as(pointer)), texts, points)


def evaluate(function, texts, points):
    found = []
    for point in points:
        out = np.empty(len(texts))
        function(np.array(point), out)
        found.append(out)
    return np.array(found)


def truth(texts, points):
    """Return the values as plain arithmetic of the declared text gives them, without sympy."""
    return np.array([[Expression(t).evaluate(dict(zip(NAMES, p, strict=True))) for t in texts] for p in points])


def assert_same(found, expected, texts):
    error = np.abs(found - expected) / np.maximum(1.0, np.abs(expected))
    row, column = np.unravel_index(np.argmax(np.where(np.isnan(error), np.inf, error)), error.shape)
    assert error[row, column] <= 1e-12, (texts[column], POINTS[row], found[row, column], expected[row, column])


# Compiling is slow, so many expressions go into one function; a batch that fails names the expression.
BATCH = settings(max_examples=4, deadline=None, derandomize=True, phases=[Phase.generate])


@BATCH
@given(st.lists(trees(), min_size=30, max_size=30, unique=True))
def test_printed_for_llvm_expressions_keep_their_values(texts):
    expected = truth(texts, POINTS)
    for run in (run_llvm, run_lanes):
        assert_same(run(texts, POINTS), expected, texts)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc to compile the printed C with")
def test_printed_as_c_expressions_keep_their_values(tmp_path_factory):
    @BATCH
    @given(st.lists(trees(), min_size=30, max_size=30, unique=True))
    def check(texts):
        found = run_c(texts, POINTS, tmp_path_factory.mktemp("c"))
        assert_same(found, truth(texts, POINTS), texts)
        assert np.array_equal(found, run_llvm(texts, POINTS))  # to the last bit: what is exported is what ran here

    check()


INVERSE = {"asin": "arcsin", "acos": "arccos", "atan": "arctan"}  # as numpy calls them


@pytest.mark.parametrize("name", ["sin", "cos", "exp", "log", "tan", "sinh", "cosh", "tanh", *INVERSE])
def test_a_function_in_lanes_is_right_to_a_few_units_in_the_last_place(name):
    edges = [0.0, -0.0, np.inf, -np.inf, np.nan, 5e-324, 1e-310, 709.7, 710.5, -745.0, -746.0]
    points = [*edges, -2.0, np.pi, 1e5, 0.5**0.5, *np.linspace(-20.0, 20.0, 101), *np.geomspace(1e-300, 1e300, 20)]
    points = [x for x in points if name in {"exp", "log"} or not 1e6 < abs(x) < np.inf]
    found = run_lanes([f"{name}(x)"], [(x, 0.0, 0.0) for x in points])[:, 0]
    with np.errstate(all="ignore"):
        expected = getattr(np, INVERSE.get(name, name))(points)
    finite = np.isfinite(expected)
    assert np.array_equal(found[~finite], expected[~finite], equal_nan=True)
    with mpmath.workdps(60):
        exact = [getattr(mpmath, name)(mpmath.mpf(x)) for x in np.array(points)[finite]]
        errors = [float(abs(mpmath.mpf(x) - y)) for x, y in zip(found[finite], exact, strict=True)]
    units = 2.0 if name in {"sin", "cos", "exp", "log"} else 3.0
    least = 1e-20 if name in {"sin", "cos", "tan"} else 0.0
    assert np.all(errors <= units * np.spacing(np.abs(expected[finite])) + least)


def test_values_rounded_to_single_precision_are_computed_with_in_it():
    """To the last bit as numpy does; beside numbers in double precision they are such, too."""
    x, y = np.float64(1.0) / np.arange(3.0, 3.0 + LANES), np.linspace(-2.0, 3.0, LANES)
    graph = Graph()
    single = [graph.apply("single", graph.symbol(name, varying=True)) for name in "xy"]
    a, b = graph.mul(single[0], graph.number(0.1)), graph.sub(*single)
    nodes = [
        a,
        graph.div(a, b),
        graph.apply("max", a, b),
        graph.apply("abs", b),
        graph.apply("where", graph.apply("lt", a, b), a, b),
    ]
    nodes += [graph.add(graph.symbol("x", varying=True), a), graph.apply("double", a)]
    nodes += [graph.apply(name, graph.apply("abs", b)) for name in ("rough_log2", "rough_exp2")]

    def build():
        made, results = Module("test", {}), [(f"out[{i}]", node) for i, node in enumerate(nodes)]
        results += [("s[1]", b)]
        signature = "f(v: Matrix, out: Matrix, s: Matrix)"
        made.add(signature, graph, results, {"x": "v[0]", "y": "v[1]"}, lanes=LANES, singles={"s"})
        return made

    out, s = np.empty((len(nodes), LANES)), np.empty((2, LANES))
    module_store.load(module_store.key({"test": "single"}), build).function("f")(np.stack([x, y]), out, s)
    p, q = np.float32(x), np.float32(y)
    a, b = p * np.float32(0.1), p - q
    expected = [a, a / b, np.maximum(a, b), np.abs(b), np.where(a < b, a, b), x + a, a]
    assert np.array_equal(out[:7], np.array(expected, dtype=float))
    assert np.array_equal(s.view(np.float32).ravel()[LANES : 2 * LANES], b)
    assert np.abs(out[7] - np.log2(np.abs(b))).max() < 1e-4
    assert np.abs(out[8] / np.exp2(np.abs(b)) - 1.0).max() < 1e-4


def test_names_of_arguments_are_free():
    def build():
        made, graph = Module("test", {}), Graph()
        x = [graph.symbol(name, varying=True) for name in ("r", "x1", "value", "found")]
        total = graph.apply("add", x[0], graph.apply("mul", graph.apply("sub", x[1], x[2]), x[3]))
        made.add("f(r: float, x1: float, value: float, found: float)", graph, [], {}, total)
        return made

    assert module_store.load(module_store.key({"test": "names"}), build).function("f")(1.0, 7.0, 2.0, 3.0) == 16.0


@settings(max_examples=150, deadline=None, derandomize=True)
@given(trees())
def test_printed_expressions_equal_those_of_sympy_to_many_digits(text):
    space = {"math": Quiet(), "np": np, "abs": abs, "min": min, "max": max}
    exec(python_source([text]), space)  # noqa: S102  (as above)
    expression = Expression(text).to_sympy(SYMBOLS)
    for point in POINTS:
        out = np.empty(1)
        with np.errstate(all="ignore"):
            space["f"]([np.float64(x) for x in point], out)
        exact = float(
            expression.subs({SYMBOLS[n]: sp.Float(x, 40) for n, x in zip(NAMES, point, strict=True)}).evalf(30)
        )
        assert out[0] == pytest.approx(exact, rel=1e-12, abs=1e-12)


class Quiet:
    """The functions of `math`, which give no number instead of an error, as compiled code does."""

    def __getattr__(self, name):
        return getattr(np, {"asin": "arcsin", "acos": "arccos", "atan": "arctan", "atan2": "arctan2"}.get(name, name))


def test_every_function_of_declarations_is_printed_in_every_language(tmp_path):
    two = {"atan2": "x, z", "min": "x, y, z", "max": "x, y, z", "where": "x < y, x, z"}
    two |= dict.fromkeys(("interpolate", "interpolate_monotone"), "x, -1, 0.3, 0.2, 1, 0.5, 0.4, 2, -1")
    printed = sorted({*FUNCTIONS} - {"delay"})  # the past is read by the integrators
    texts = [f"{name}({two.get(name, 'x')})" for name in printed]
    texts += ["x**2", "x**-3", "x**0.5", "x**1.3", "x**z", "-x", "x - y*z/x", "where(x <= z, y, where(y > x, 1, x))"]
    texts += ["tan(x + pi/2)", "exp(-x)/exp(2)", "x*-1", "0*x", "-(-x)", "x - x", "1/(x*z**2)", "abs(x)**3"]
    texts += ["floor(3*x)", "-floor(-3*x)", "floor(x + 2)", "x*floor(10*z)/floor(7*y)"]
    assert PYTHON.templates.keys() == C.templates.keys()
    points = [(0.7, -1.3, 0.25), (0.3, 0.9, 0.35)]
    expected = truth(texts, points)
    for run in (run_llvm, run_lanes):
        np.testing.assert_allclose(run(texts, points), expected, rtol=1e-12, atol=1e-15)
    if shutil.which("gcc"):
        np.testing.assert_allclose(run_c(texts, points, tmp_path), expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        (sp.gamma(SYMBOLS["x"]), "the function gamma has no compiled form"),
        (sp.Symbol("other"), "the symbol other has no compiled form"),
        (sp.I * SYMBOLS["x"], "the equations contain the constant I; constants must be real"),
        (SYMBOLS["x"] + sp.Float("1e400"), "the equations contain the constant inf; constants must be finite"),
        (
            sp.Piecewise((1, SYMBOLS["x"] < 0)),
            "has no value where none of its conditions hold; end it with a last case",
        ),
    ],
)
def test_what_cannot_be_compiled_is_refused_in_words(expression, message):
    graph = Graph()
    with pytest.raises(ModelError) as caught:
        graph.lower(expression, {SYMBOLS["x"]: graph.symbol("x", varying=True)})
    assert str(caught.value).endswith(message)


# Each operation that has a recurrence, of an argument g = 3/10 + t/2 + t^2/5, and mpmath's own series of it.
G = "(0.3 + t/2 + t**2/5)"
SERIES = {
    "sin": (f"sin({G})", lambda g, t: mpmath.sin(g)),
    "cos": (f"cos({G})", lambda g, t: mpmath.cos(g)),
    "sin and cos": (f"sin({G}) - 2*cos({G})", lambda g, t: mpmath.sin(g) - 2 * mpmath.cos(g)),
    "tan": (f"tan({G})", lambda g, t: mpmath.tan(g)),
    "asin": (f"asin({G})", lambda g, t: mpmath.asin(g)),
    "acos": (f"acos({G})", lambda g, t: mpmath.acos(g)),
    "atan": (f"atan({G})", lambda g, t: mpmath.atan(g)),
    "sinh": (f"sinh({G})", lambda g, t: mpmath.sinh(g)),
    "cosh": (f"cosh({G})", lambda g, t: mpmath.cosh(g)),
    "sinh and cosh": (f"sinh({G})*cosh({G})", lambda g, t: mpmath.sinh(g) * mpmath.cosh(g)),
    "tanh": (f"tanh({G})", lambda g, t: mpmath.tanh(g)),
    "exp": (f"exp({G})", lambda g, t: mpmath.exp(g)),
    "log": (f"log({G})", lambda g, t: mpmath.log(g)),
    "sqrt": (f"sqrt({G})", lambda g, t: mpmath.sqrt(g)),
    "pow": (f"{G}**1.7", lambda g, t: g ** mpmath.mpf("1.7")),
    "pow negative": (f"{G}**-0.7", lambda g, t: g ** mpmath.mpf("-0.7")),
    "pow integer": (f"{G}**5", lambda g, t: g**5),
    "pow varying": (f"{G}**t", lambda g, t: g**t),
    "neg and sub": (f"1 - t - {G}", lambda g, t: 1 - t - g),
    "mul": (f"{G}*sin(t)", lambda g, t: g * mpmath.sin(t)),
    "mul and constant": (f"3*{G}*{G}/7", lambda g, t: 3 * g**2 / 7),
    "div": (f"cos(t)/{G}", lambda g, t: mpmath.cos(t) / g),
    "div constant": (f"2/{G}", lambda g, t: 2 / g),
    "div by constant": (f"sin({G})/3", lambda g, t: mpmath.sin(g) / 3),
    "nested": (
        f"exp(-sin({G})**2)/sqrt(1 + t**2)",
        lambda g, t: mpmath.exp(-mpmath.sin(g) ** 2) / mpmath.sqrt(1 + t**2),
    ),
}  # fmt: skip


def series_of(equations, start, order=14, time=0.0, copies=0):
    """Return the Taylor coefficients (order + 1, n) of y' = f(t, y) from the printed recurrences.

    With copies, they are those of each of so many equal systems side by side, in loops.
    """
    graph, count = Graph(), max(copies, 1)
    symbols = {name: sp.Symbol(name, real=True) for name in ("t", *equations)}
    t = graph.symbol("t", varying=True)
    states = {name: [graph.symbol(f"{name}{i}", varying=True) for i in range(count)] for name in equations}
    derivatives = [
        graph.lower(
            Expression(text).to_sympy(symbols),
            {symbols["t"]: t} | {symbols[name]: nodes[i] for name, nodes in states.items()},
        )
        for text in equations.values()
        for i in range(count)
    ]
    assert is_analytic(graph, derivatives)
    given, health = [node for nodes in states.values() for node in nodes], graph.number(1.0)
    loads = {str(graph.operations[node][1]): f"y[{i}]" for i, node in enumerate(given)}
    printed, dynamics = Module("test", {}), Dynamics(graph, t, given, derivatives, health, loads)
    if copies:
        loops = Loops.of(dynamics)
        printed.add_coefficients_in_loops(loops, loads, {"": order})
    else:
        printed.add_coefficients(dynamics, {"": order})
    c = np.full((order + 1, loops.width if copies else len(given)), np.nan)
    generated = module_store.load(module_store.key({"test": printed.text()}), lambda: printed)
    none = np.zeros(0)
    assert (
        generated.function("coefficients")(time, np.repeat(np.array(start, dtype=float), count), none, none, c) == 1.0
    )
    found = c[:, : len(given)].reshape(order + 1, len(equations), count)
    np.testing.assert_allclose(found, found[:, :, :1] + np.zeros_like(found), rtol=1e-12, atol=1e-15)
    return found[:, :, -1]


# What is written, and what becomes of it, of fixed a, b, c and varying x, y.
FACTORED = {
    "a x (b x)": (
        lambda g, a, b, c, x, y: g.mul(g.mul(a, x), g.mul(b, x)),
        lambda g, a, b, c, x, y: g.mul(g.mul(a, b), g.mul(x, x)),
    ),
    "-(a x) sin(b x) / c": (
        lambda g, a, b, c, x, y: g.div(g.mul(g.apply("neg", g.mul(a, x)), g.apply("sin", g.mul(b, x))), c),
        lambda g, a, b, c, x, y: g.apply("neg", g.mul(g.div(a, c), g.mul(x, g.apply("sin", g.mul(b, x))))),
    ),
    "-(a x) + a y": (
        lambda g, a, b, c, x, y: g.add(g.apply("neg", g.mul(a, x)), g.mul(a, y)),
        lambda g, a, b, c, x, y: g.mul(a, g.sub(y, x)),
    ),
    "a x y - x y a": (
        lambda g, a, b, c, x, y: g.sub(g.mul(g.mul(a, x), y), g.mul(g.mul(x, y), a)),
        lambda g, a, b, c, x, y: g.number(0.0),
    ),
    "a x / (b y)": (
        lambda g, a, b, c, x, y: g.div(g.mul(a, x), g.mul(b, y)),
        lambda g, a, b, c, x, y: g.mul(g.div(a, b), g.div(x, y)),
    ),
    "(-a) (x + 1) - b y": (
        lambda g, a, b, c, x, y: g.sub(g.mul(g.apply("neg", a), g.add(x, g.number(1.0))), g.mul(b, y)),
        lambda g, a, b, c, x, y: g.sub(g.apply("neg", g.mul(a, g.add(x, g.number(1.0)))), g.mul(b, y)),
    ),
    "1 / (a x) + c": (
        lambda g, a, b, c, x, y: g.add(g.div(g.number(1.0), g.mul(a, x)), c),
        lambda g, a, b, c, x, y: g.add(g.mul(g.div(g.number(1.0), a), g.div(g.number(1.0), x)), c),
    ),
    "a x y^2 + b sin(x) y - c x y - sin(x)": (
        lambda g, a, b, c, x, y: g.sub(
            g.sub(g.add(g.mul(a, g.mul(x, g.mul(y, y))), g.mul(b, g.mul(y, g.apply("sin", x)))), g.mul(c, g.mul(x, y))),
            g.apply("sin", x),
        ),
        lambda g, a, b, c, x, y: g.sub(
            g.mul(y, g.add(g.mul(x, g.sub(g.mul(a, y), c)), g.mul(b, g.apply("sin", x)))), g.apply("sin", x)
        ),
    ),
    "x + a x": (
        lambda g, a, b, c, x, y: g.add(x, g.mul(a, g.mul(x, y))),
        lambda g, a, b, c, x, y: g.mul(x, g.add(g.number(1.0), g.mul(a, y))),
    ),
}


@pytest.mark.parametrize(("written", "expected"), FACTORED.values(), ids=FACTORED)
def test_factors_that_do_not_vary_leave_products(written, expected):
    graph = Graph()
    symbols = [graph.symbol(name, varying=name in "xy") for name in "abcxy"]
    rules = {name: getattr(operator, name) for name in ("add", "sub", "mul", "neg")}
    rules |= {"div": operator.truediv, "sin": math.sin, "number": float, "square": lambda x: x * x}
    given = written(graph, *symbols)
    (found,) = with_common_factors(graph, factored(graph, [given]))
    assert found == expected(graph, *symbols)
    values = dict(zip(symbols, (2.0, -3.0, 5.0, 0.7, 1.9), strict=True))
    assert values_of(graph, [found], values, rules, "value")[0] == pytest.approx(
        values_of(graph, [given], values, rules, "value")[0], rel=1e-14, abs=1e-14
    )


@pytest.mark.parametrize("copies", [0, 11])
@pytest.mark.parametrize("name", SERIES)
def test_a_series_is_that_of_mpmath(name, copies):
    text, function = SERIES[name]
    at = mpmath.mpf("0.25")
    with mpmath.workdps(60):
        series = mpmath.taylor(lambda t: function(mpmath.mpf("0.3") + t / 2 + t**2 / 5, t), at, 13)
    expected = [0.0, *(float(c) / (k + 1) for k, c in enumerate(series))]
    # of the time itself, and of a state that follows it: s = 3/10 + t/2 + t^2/5
    by_time = series_of({"y": text}, [0.0], time=0.25, copies=copies)[:, 0]
    following = {"y": text.replace(G, "s"), "s": "1/2 + 2*t/5"}
    by_state = series_of(following, [0.0, 0.3 + 0.125 + 0.0125], time=0.25, copies=copies)[:, 0]
    for found in (by_time, by_state):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("copies", [0, 1, 7])
@pytest.mark.parametrize(
    ("equation", "start", "solution"),
    [
        ("1 + y**2", 0.5, lambda t: mpmath.tan(t + mpmath.atan(mpmath.mpf("0.5")))),
        ("y", 1.0, mpmath.exp),
        ("y*(1 - y)", 0.5, lambda t: 1 / (1 + mpmath.exp(-t))),
        ("1/(2*y)", 2.0, lambda t: mpmath.sqrt(t + 4)),
        ("exp(-y)", 0.0, lambda t: mpmath.log(1 + t)),
        ("sqrt(1 - y**2)", 0.5, lambda t: mpmath.sin(t + mpmath.asin(mpmath.mpf("0.5")))),
        ("cos(y)", 0.0, lambda t: 2 * mpmath.atan(mpmath.tanh(t / 2))),
        ("-t*y", 1.0, lambda t: mpmath.exp(-(t**2) / 2)),
        ("3", 1.0, lambda t: 1 + 3 * t),
    ],
)
def test_the_series_of_a_solution_is_that_of_its_closed_form(equation, start, solution, copies):
    with mpmath.workdps(60):
        expected = [float(c) for c in mpmath.taylor(solution, 0, 14)]
    np.testing.assert_allclose(
        series_of({"y": equation}, [start], copies=copies)[:, 0], expected, rtol=1e-9, atol=1e-14
    )


@pytest.mark.parametrize(
    ("equation", "is_smooth"),
    [
        ("-x*abs(x)", False), ("-sign(x')", False), ("-max(x, 0)", False), ("-min(x, p)", False),
        ("-where(x < 1, x, 2*x)", False), ("-heaviside(x)", False), ("-floor(x)", False), ("-atan2(x, 2 + x')", False),
        ("-x - tanh(x')", False),  # a switch that the series does not show from afar
        ("-abs(p)*x", True), ("-x - tanh(p)", True), ("-max(p, 1)*sin(x)", True), ("-x**3", True),
        ("-x**p", False),  # p may be an integer, and then x may pass through zero
        ("-(1 + x**2)**0.7", True),
        ("-x**17", True), ("-x**18", False),  # from x = 0 its series begins beyond order 18
    ],
)  # fmt: skip
def test_only_smooth_models_are_integrated_by_series(declared, equation, is_smooth):
    model = declared(
        coordinates={"x": {"initial": 1}},
        parameters={"p": 2} if "p" in equation else {},
        equations={"x''": equation},
    )
    method = "taylor" if is_smooth else "runge_kutta"
    assert model.kernels.meta["method"] == method
    assert ("solve_taylor" in model.kernels.meta["functions"]) == is_smooth


@pytest.mark.parametrize(("system", "n"), [("beam", 9), ("chain", 30)])
def test_many_like_products_are_integrated_in_loops(system, n):
    model = load_model(many.MANY / many.MODELS[system], {"N": n})
    size, values, times = len(model.coordinates), model.parameter_values(), np.linspace(0.0, 3.0, 4)
    assert model.kernels.meta["method"] == "taylor"
    assert "solve_in_lanes" not in model.kernels.meta["functions"]
    found = model.simulate(times, tolerance=1e-13)

    def rates(_, y):
        return [*y[size:], *many.accelerations(np, system, y[:size], y[size:], values)]

    start = np.array(model.initial_state({}))
    expected = solve_ivp(rates, (0.0, 3.0), start, "DOP853", times, rtol=1e-13, atol=1e-14).y.T
    np.testing.assert_allclose(found.states, expected, atol=1e-10)
    name = model.coordinates[0]
    each = model.simulate(times, tolerance=1e-13, ensemble={name: [start[0], 0.1]})
    np.testing.assert_array_equal(each.states[0], found.states)


def test_unlike_products_are_not(declared):
    # three links whose products are all different
    shapes = [(i, j) for i in range(1, 4) for j in range(1, 4) if i != j]
    kinetic = " + ".join(f"a{i}'**2" for i in range(1, 4))
    coupled = " + ".join(f"{0.1 * i * j:.2f}*a{i}'*a{j}'*cos(a{i} - a{j})/2" for i, j in shapes)
    model = declared(
        coordinates={f"a{i}": {"initial": 0.3 * i} for i in range(1, 4)},
        lagrangian=f"{kinetic} + {coupled} + cos(a1) + 2*cos(a2) + 3*cos(a3)",
    )
    assert model.kernels.meta["method"] == "runge_kutta"


def test_a_model_that_is_not_smooth_falls_back(declared):
    # x'' = -sign(x) from rest at 1/2 falls to 0 in time 1, and swings with period 4 between parabolas
    model = declared(coordinates={"x": {"initial": 0.5}}, equations={"x''": "-sign(x)"})
    found = model.simulate(np.array([0.0, 0.5, 1.0, 2.0, 4.0]))
    np.testing.assert_allclose(found["x"], [0.5, 0.375, 0.0, -0.5, 0.5], atol=1e-7)


def test_the_degree_of_a_product_is_counted():
    for text, expected in (("2", 0), ("x", 1), ("x*y + z", 2), ("x**7", 7), ("sin(x**3)*y", 4), ("x**2/y", 2)):
        graph, (node,) = lowered([text])
        assert degree(graph, [node]) == expected, text


FRESH = """
import json, sys
import numpy as np
from masking.model.declaration import registry
from masking.model.modelling.lowering import module
from masking.model.modelling.model import Model
"""


def fresh(code, **environment):
    """Run Python in a process of its own; return what it prints as JSON."""
    done = subprocess.run(
        [sys.executable, "-c", FRESH + code],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_generated_text_is_the_same_in_every_process():
    names = ("duffing", "huygens_lagrangian")
    here = {n: module_text(n) for n in names}
    assert here["duffing"] == module_text("duffing")
    code = f"print(json.dumps({{n: module(Model(registry.load_model(n)).equations).text() for n in {names!r}}}))"
    assert fresh(code, PYTHONHASHSEED="1") == here  # this process has a random seed, or 0 under xdist


def module_text(name):
    return module(Model(registry.load_model(name)).equations).text()


def test_a_second_process_starts_from_the_cache_without_sympy_and_numba():
    model = Model(registry.load_model("duffing"))
    times = np.linspace(0.0, 10.0, 11)
    here = model.simulate(times).states

    def files():
        every = (file for file in module_store.directory().rglob("*") if file.is_file())
        return {file: (file.stat().st_mtime_ns, file.stat().st_ino, file.stat().st_size) for file in every}

    before = files()
    assert model.kernels.generated.path in before
    found = fresh(
        "model = Model(registry.load_model('duffing')).with_parameters(th1=0.3).with_parameters(th1=1/3)\n"
        "states = model.simulate(np.linspace(0.0, 10.0, 11)).states\n"
        "print(json.dumps([states.tolist(), [m for m in ('sympy.core', 'numba.core') if m in sys.modules]]))"
    )
    np.testing.assert_array_equal(found[0], here)
    assert found[1] == []
    assert before.items() <= files().items()  # tests beside this one may add functions of the same model


def test_equations_make_the_key_and_values_do_not(declared):
    def key(**changes):
        parts = {
            "coordinates": {"x": {"initial": 1}},
            "parameters": {"w": {"value": 2, "bounds": [0, None]}},
            "equations": {"x''": "-w**2*x"},
        }
        return module_store.key({"model": declared(**(parts | changes)).structure()})

    assert key() == key(parameters={"w": {"value": 3}}, coordinates={"x": {"initial": 5, "meaning": "way"}})
    different = {
        key(),
        key(equations={"x''": "-w**2*x - x"}),
        key(energy="x'**2/2 + w**2*x**2/2"),
        key(outputs={"force": {"expression": "w*x"}}),
        key(inputs={"u": {"meaning": "force"}}, equations={"x''": "-w**2*x + u"}),
        key(parameters={"w": 2, "b": 1}, equations={"x''": "-w**2*x - b*x'"}),
        key(parameters={"b": 1, "w": 2}, equations={"x''": "-w**2*x - b*x'"}),
    }
    assert len(different) == 7
    assert Model(registry.load_model("setup")).structure() == Model(registry.load_model("setup_undamped")).structure()


def test_concurrent_writers_leave_one_whole_file(tmp_path):
    target = tmp_path / "deep" / "module.py"
    texts = [letter * 300_000 for letter in (b"a", b"b", b"c", b"d", b"e", b"f", b"g", b"h")]
    seen = set()

    def write(text):
        write_whole(target, text)
        seen.add(target.read_bytes())

    threads = [threading.Thread(target=write, args=(text,)) for text in texts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert seen <= set(texts)
    assert target.read_bytes() in texts
    assert list(target.parent.iterdir()) == [target]


def test_a_module_that_cannot_be_built_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setenv("MASKING_CACHE", str(tmp_path))

    def fail():
        raise ModelError("no")

    with pytest.raises(ModelError):
        module_store.load("0123", fail)
    assert not module_store.exists("0123")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Return a copy of the package whose sources are hashed in place of those that run, and what forgets its hashes."""
    copy = tmp_path / "masking"
    shutil.copytree(content_hashes.PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__", "shipped"))
    monkeypatch.setattr(content_hashes, "PACKAGE", copy)

    def forget():
        content_hashes.sources.cache_clear()
        content_hashes.source_of.cache_clear()

    forget()
    yield copy, forget
    monkeypatch.undo()
    forget()


def test_every_source_of_the_package_is_part_of_the_key(package, monkeypatch):
    copy, forget = package
    files, content, read = sorted(copy.rglob("*.py")), Path.read_bytes, []
    with monkeypatch.context() as patch:
        patch.setattr(Path, "read_bytes", lambda file: read.append(file) or content(file))
        before = module_store.key({"a": 1})
    assert sorted(read) == files  # printers, laws, filters: all of them
    for file in files[::20]:
        text = file.read_bytes()
        file.write_bytes(text + b"\n")
        forget()
        assert module_store.key({"a": 1}) != before, file
        file.write_bytes(text)
    laws = copy / "inference" / "discovery" / "compiled_laws.py"
    laws.rename(laws.with_name("lows.py"))
    forget()
    assert module_store.key({"a": 1}) != before


def printed(**others):
    """Return the content hashes of a small module; `others` replace parts of it."""
    graph = Graph()
    x = graph.symbol("x", varying=True)
    made = Module("test", {})
    made.add("slope(t: float, y, u, p, dy)", graph, [("dy[0]", graph.apply("sin", x))], {"x": "y[0]"})
    made.add("energy(t: float, y)", graph, [], {"x": "y[0]"}, returns=graph.mul(x, x))
    made.add_factory("advance", runge_kutta.steps_of_runge_kutta_4, "slope", others.get("size", 1), work=(5, 1))
    made.add_factory("solve", runge_kutta.runge_kutta, "slope", 1, work=(24, 1))
    return module_store.described(made)[0]


def test_what_a_function_is_made_of_is_its_content_and_nothing_else(package, monkeypatch):
    copy, forget = package
    before = printed()
    assert printed() == before
    for name in ("runge_kutta", "dop853_coefficients"):  # a table that a kernel imports, and where that takes it from
        file = copy / "compile" / "numerics" / f"{name}.py"
        text = file.read_bytes()
        file.write_bytes(text + b"\n")
        forget()
        assert {name for name, found in printed().items() if found != before[name]} == {"solve"}
        file.write_bytes(text)
    (copy / "control" / "rig" / "twin.py").write_text("", encoding="utf-8")
    forget()
    assert printed() == before
    assert {name for name, found in printed(size=2).items() if found != before[name]} == {"advance"}
    monkeypatch.setitem(llvm_text.INTRINSICS, "sin", "cos")
    assert {name for name, found in printed().items() if found != before[name]} == {"slope", "advance", "solve"}
    name_of_files = machine_code.processor.__wrapped__()
    monkeypatch.setattr(machine_code, "versions", lambda: "another numba")
    assert machine_code.processor.__wrapped__() != name_of_files


@pytest.mark.parametrize("language", [PYTHON, C], ids=["python", "c"])
def test_every_template_of_a_printer_shows_in_the_text(language, monkeypatch):
    graph = Graph()
    symbols = [graph.symbol(name, varying=True) for name in NAMES]
    counts = {"where": 3, **dict.fromkeys(("pow", "min", "max", "atan2", "lt", "le"), 2)}
    for name, template in language.templates.items():
        node = graph.apply(name, *symbols[: counts.get(name, 1)])
        before = statements(graph, [("out[0]", node)], language)
        monkeypatch.setitem(language.templates, name, "other" + template)
        assert statements(graph, [("out[0]", node)], language) != before, name


def test_every_law_shows_in_the_content():
    for name, effect in compiled_laws.known(EFFECTS).items():
        kinds = [{name: effect}, {name: replace(effect, expression=f"2*({effect.expression})")}]
        first, second = (module_store.described(compiled_laws.printed(one))[0][compiled_laws.LAW] for one in kinds)
        assert first != second, name
