"""Laws along known motions: the effects of a dictionary as functions with derivatives.

A law without states is computed for all samples at once; the others are compiled, distinguished by a number.

Each function takes what the effect acts on (displacement and rate of an element, its acceleration where the effect is
an inertia, or the value of a sensor or actuator), its internal states and its parameters, and gives a row for the force
or value, and one for the rate of each state: the value itself, then its derivatives by displacement, rate, states and
parameters. They do not know any model, and follow any known motion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from masking.compile.codegen import module_store
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.graph_values import ARRAYS, function_of
from masking.compile.codegen.machine_code import NativeFunction
from masking.compile.codegen.tangent import copied, derivatives
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.effect_table import (
    BY_DISPLACEMENT,
    BY_PARAMETER,
    BY_RATE,
    BY_STATE,
    LAW_ROWS,
    MOST_STATES,
    VALUE,
)
from masking.compile.numerics.kernel_arguments import Course
from masking.lazy_imports import sympy as sp
from masking.model import effects
from masking.model.declaration.dictionary_checks import MOST_PARAMETERS
from masking.model.declaration.expression import Expression
from masking.model.effects import Effect

WIDTH = BY_PARAMETER + MOST_PARAMETERS  # of a row
LAW = "_law"
SIGNATURE = f"{LAW}(kind: int, t: float, x: float, rate: float, z: float, z2: float, theta, rows: Matrix)"
SUBJECTS = {"element": "d", "sensor": "s", "actuator": "u"}
_AT = effects.EffectParameter("D", "knot")
_KNOTS = {f"t{i}": _AT for i in range(5)}
_RATES = {name: effects.EffectParameter("D/s", "knot") for name in _KNOTS}
_FACTOR = {"a": effects.EffectParameter("F", "factor")}
_EVEN = {"x0": effects.EffectParameter("D", "middle"), "w": effects.EffectParameter("D", "width")}
_ALONG = {"v0": effects.EffectParameter("D/s", "middle"), "wv": effects.EffectParameter("D/s", "width")}
_TURN = {"vs": effects.EffectParameter("D/s", "rate at which a sign has 76 % of its size")}

MOST_PIECES = 4  # of a sample, in which the state of a law is integrated along a motion
FINE = 16.0  # pieces in the time in which a motion turns by one radian: its forces are then right to 1 %


def pieces(x: Array, rate: Array, dt: float) -> int:
    """Pieces of a sample, dt in s, in which the state of a law is integrated along a motion (m,).

    The rate is 0 where none is known, as of a command.
    """
    moved = dt * rate if rate.any() else np.diff(x)
    radians = float(np.linalg.norm(moved)) / max(float(np.linalg.norm(x - x.mean())), 1e-300)
    return math.ceil(float(np.clip(FINE * radians, 1.0, MOST_PIECES)))


def _spline(x: str) -> str:
    """Cubic B-spline on five knots, a divided difference of truncated cubes."""
    apart = ["*".join(f"(t{i} - t{j})" for j in range(5) if j != i) for i in range(5)]
    parts = [f"max({x} - t{i}, 0)**3/({those})" for i, those in enumerate(apart)]
    return f"(t4 - t0)*({' + '.join(parts)})"


def _even(x: str) -> str:
    return f"(max(2 - abs({x}), 0)**3 - 4*max(1 - abs({x}), 0)**3)/6"


def _basis(name: str, meaning: str, expression: str, parameters: Mapping[str, effects.EffectParameter]) -> Effect:
    return Effect(name, meaning, expression, {**_FACTOR, **parameters}, is_searched=False)


# Functions that a law without a name is made of, see `bases`.
BASES: Mapping[str, Effect] = {
    effect.name: effect
    for effect in (
        _basis("free_spring", "A piece of a curve over the displacement.", f"a*{_spline('d')}", _KNOTS),
        _basis("free_damping", "A piece of a curve over the rate.", f"a*{_spline('d_rate')}", _RATES),
        _basis("free_friction", "The sign of the rate.", "a*tanh(d_rate/vs)", _TURN),
        _basis("free_resistance", "The rate times a piece of a curve over the displacement.",
               f"a*d_rate*{_spline('d')}", _KNOTS),
        _basis("free_rub", "The sign of the rate times a piece of a curve over the displacement.",
               f"a*tanh(d_rate/vs)*{_even('((d - x0)/w)')}", {**_EVEN, **_TURN}),
        _basis("free_surface", "A piece of a surface over displacement and rate.",
               f"a*{_even('((d - x0)/w)')}*{_even('((d_rate - v0)/wv)')}", {**_EVEN, **_ALONG}),
    )
}  # fmt: skip

# What an effect takes from an element in whose place it stands: the whole displacement and the whole rate.
ALL_TAKEN = {f"all_{x}": Effect(f"all_{x}", "", x, {}) for x in ("d", "d_rate")}
DEAD_TIME = "tau"  # what is estimated of a delay, in s; a plant file has whole samples
_LATE = replace(  # has no expression: the commands are read earlier
    effects.DELAY,
    parameters={DEAD_TIME: effects.EffectParameter("s", "dead time", bounds=(0.0, None))},
    where="actuator",
    grows_with=DEAD_TIME,
)
DELAY = _LATE.name
USUAL: Mapping[str, Effect] = {**effects.EFFECTS, DELAY: _LATE}  # laws of the package, as they are fitted


def known(dictionary: Mapping[str, Effect]) -> dict[str, Effect]:
    """Effects that can be tried, in the order of their numbers: no more states than kernels hold, and an expression."""
    found = {
        name: effect
        for name, effect in dictionary.items()
        if effect.expression and effect.where in SUBJECTS
        if len(effect.states) <= MOST_STATES and len(effect.parameters) <= MOST_PARAMETERS
    }
    rates = {name: replace(e, expression=e.takes_rate) for name, e in found.items() if e.takes_rate}
    return {**found, **{rate_of(name): effect for name, effect in rates.items()}, **ALL_TAKEN}


def rate_of(name: str) -> str:
    """Name of the law by which an effect in series takes up a rate."""
    return f"{name}_rate"


def library(kinds: Mapping[str, Effect]) -> NativeFunction:
    """Laws as machine code of their own, to which the kernels of every rig are linked."""
    made_from = {"laws": {name: effect.structure() for name, effect in kinds.items()}}
    return module_store.load(module_store.key(made_from), lambda: printed(kinds)).function(LAW)


def printed(kinds: Mapping[str, Effect]) -> Module:
    """Laws as a module of one function, which chooses by their number."""
    module = Module("laws of effects", {})
    zeros = [f"rows[{i}, {j}]" for i in range(LAW_ROWS) for j in range(WIDTH)]
    module.add_choice(SIGNATURE, zeros, [*map(_law, kinds.values())])
    return module


def lowered(graph: Graph, effect: Effect, nodes: Mapping[str, Node]) -> list[Node]:
    """Force or value of an effect, then the rates of its states, for nodes of all that it follows and holds."""
    texts = effect.expression, *(state.rate for state in effect.states.values())
    law, names, rows = _alone(texts)
    given = {**nodes, "xi": graph.number(0.0)}
    return copied(law, rows, [law.symbol(name, varying=True) for name in names], graph, [given[name] for name in names])


@cache
def _alone(texts: tuple[str, ...]) -> tuple[Graph, tuple[str, ...], list[Node]]:
    """Expressions as nodes of a graph of their own, and the names of its symbols."""
    found = [Expression(text) for text in texts]
    names, graph = tuple(sorted({name for one in found for name in one.symbols})), Graph()
    symbols = {name: sp.Symbol(name, real=True) for name in names}
    by_symbol = {symbols[name]: graph.symbol(name, varying=True) for name in names}
    return graph, names, [graph.lower(one.to_sympy(symbols), by_symbol) for one in found]


def along(law: Effect, course: Course, dt: float, values: Mapping[str, float], by: Sequence[str]) -> Array:
    """Value of a law without states along what it acts on (m,), with dt in s between two.

    Then come its derivatives by parameters, whose values are by name (m, 1 + c).
    """
    graph, symbols, nodes = _with_derivatives(law.expression, tuple(by))
    signals = {_subject(law): course.x, "d_rate": course.rate, "t": dt * np.arange(len(course.x))}
    held = {symbols[name]: value for name, value in {**values, "xi": 0.0}.items() if name in symbols}
    moving = {symbols[name]: signal for name, signal in signals.items() if name in symbols}
    found = np.empty((len(course.x), len(nodes)))
    with np.errstate(all="ignore"):  # where a condition does not choose what it computes
        value = function_of(graph, nodes, held, ARRAYS, "value in numbers", variables=[*moving])
        for column, result in zip(found.T, value(moving.values()), strict=True):
            column[:] = result
    return found


@cache
def _with_derivatives(text: str, by: tuple[str, ...]) -> tuple[Graph, dict[str, Node], list[Node]]:
    """Expression and its derivatives by some of its symbols as nodes of a graph of their own, and its symbols."""
    law, names, rows = _alone((text,))
    graph = Graph()
    symbols = {name: graph.symbol(name, varying=True) for name in names}
    rows = copied(law, rows, [law.symbol(name, varying=True) for name in names], graph, [*symbols.values()])
    columns = derivatives(graph, rows, [graph.symbol(name, varying=True) for name in by])
    return graph, symbols, [*rows, *columns[0]]


def _subject(effect: Effect) -> str:
    return "d_acc" if effect.is_inertia else SUBJECTS[effect.where]


def estimable(effect: Effect) -> set[str]:
    """Parameters of an effect that may be estimated: of pieces of curves, the factor alone."""
    return {*_FACTOR} if effect.name in BASES else {*effect.parameters}


def _law(effect: Effect) -> tuple[Graph, list[tuple[str, int]], dict[str, str]]:
    """Graph of a law, its rows, and what its symbols read."""
    graph = Graph()
    subject = _subject(effect)
    reads = {"t": "t", subject: "x", "d_rate": "rate", **dict(zip(effect.states, ("z", "z2"), strict=False))}
    reads |= {p: f"theta[{i}]" for i, p in enumerate(effect.parameters)}
    nodes = {symbol: graph.symbol(f"s_{symbol}", varying=True) for symbol in reads}
    rows = lowered(graph, effect, nodes)
    wanted = {subject: BY_DISPLACEMENT, "d_rate": BY_RATE}
    wanted |= {state: BY_STATE + i for i, state in enumerate(effect.states)}
    wanted |= {p: BY_PARAMETER + i for i, p in enumerate(effect.parameters) if p in estimable(effect)}
    columns = derivatives(graph, rows, [nodes[symbol] for symbol in wanted])
    results = [(f"rows[{i}, {VALUE}]", node) for i, node in enumerate(rows)]
    results += [
        (f"rows[{i}, {column}]", node)
        for i, row in enumerate(columns)
        for column, node in zip(wanted.values(), row, strict=True)
        if not graph.is_number(node, 0.0)
    ]
    return graph, results, {f"s_{symbol}": read for symbol, read in reads.items()}
