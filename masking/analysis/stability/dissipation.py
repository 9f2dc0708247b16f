"""Dissipation: whether the rate V' of a declared energy is nowhere positive.

Tried in this order: V' as minus a sum of squares of velocities, by completing squares; a state at which V' > 0; V' <= 0
on a box, by intervals, where V' and its slope vanish at rest and its Hessian in the velocities is negative semidefinite
all over the box. States are tried in floating point. What is found there is confirmed, by intervals, or, where an
operation has no enclosure, such as `max` or `heaviside`, by exact arithmetic: state and parameters are fractions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import sympy as sp

from masking.analysis.stability.algebra import Square, normal, squares, without_void
from masking.analysis.stability.confirmation import enclosed_again
from masking.analysis.stability.equilibria import Box, check_box, halves
from masking.analysis.stability.free_equations import Motion, jumps_of
from masking.analysis.stability.hypotheses import factors
from masking.analysis.stability.modes import state_matrix
from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.graph_values import ARRAYS, function_of
from masking.compile.codegen.intervals import Interval, enclose
from masking.compile.numerics.arrays import Array
from masking.errors import ModelError

Status = Literal["proved", "refuted", "supported numerically", "open"]

_MOST_BOXES = 50_000
_ROUNDS = 40
_ODD = (sp.tanh, sp.atan, sp.sinh, sp.asinh)  # smooth, with the sign of their argument
_KINKS = (sp.sign, sp.Heaviside, sp.Abs, sp.Min, sp.Max, sp.Piecewise, sp.floor, sp.ceiling)
_MOST_CONFIRMED = 500  # boxes, spread evenly
_ZERO = 1e-300  # where rounding outward has moved 0
_FURTHER = (1.0, 10.0, 100.0)  # times a side that is not given: how far a state at which V' > 0 is looked for
_FARTHEST = (1e4, 1e8, 1e16, 1e32)  # the same, where neither such a state nor a proof was found
SAMPLES = 20_000
_MOST_TRIED = 20  # of the states where the expression is largest
_ROUNDING = 1e-15  # of an exact value, written as a floating-point number
_DISTINCT = 1e-20  # an exact value is taken to be positive above this: it is evaluated to 30 digits
_KIND = "value in floating point"


@dataclass(frozen=True)
class Dissipation:
    """What is known of V'."""

    rate: sp.Expr  # V', in normal form
    # 'proved': V' <= 0, everywhere or on `box`; 'refuted': V' > 0 at `counterexample`; 'supported numerically': V' <= 0
    # at all sampled states; 'open' where it could not be looked at, or the energy jumps
    status: Status
    method: str  # how that was found
    squares: tuple[Square, ...] = ()  # of which -V' is the sum, where it is seen to be one
    forms: tuple[sp.Expr, ...] = ()  # of velocities, that are 0 along every motion on which V' is, as far as it is seen
    box: dict[str, tuple[float, float]] | None = None  # where it holds; None for everywhere
    # a state at which V' > 0, at the declared values, in the units of the model, and `growth`, the least V' there
    counterexample: dict[str, float] | None = None
    growth: float = 0.0


def dissipation(motion: Motion, box: Box | None = None) -> Dissipation:  # noqa: PLR0911  # one way each
    """Whether the energy of a model can grow.

    Args:
        motion: the equations; its hypotheses get those that the proof needs.
        box: least and largest values of coordinates and velocities (`x1'`), in the units of the model, for what is not
            proved everywhere; where not given, twice the largest declared initial value, times the largest eigenvalue,
            and states at which V' > 0 are looked for up to a hundred times as far, too.

    Raises:
        ModelError: the model has no energy.
    """
    rate = motion.energy_rate
    pieces = motion.energy.atoms(sp.Piecewise) if motion.energy is not None else ()
    unsure = {str(condition) for piece in pieces for condition in jumps_of(piece)}
    if unsure:
        at = ", ".join(sorted(unsure))
        return Dissipation(rate, "open", f"the energy may jump at the edge of {at}; declare one that is continuous")
    if rate == 0:
        return Dissipation(rate, "proved", "V' vanishes identically: the energy is constant")
    losses = _losses(rate, motion)
    if losses is not None:
        found, forms = losses
        method = "a sum of squares of velocities" if found else "a sum of velocities times forces against them"
        return Dissipation(rate, "proved", method, found, forms)
    sides = default_box(motion, box or {})
    try:
        growth = Growth(motion, rate)
    except ModelError as error:
        return Dissipation(rate, "open", f"not looked at: {error}")
    if (grown := _grown(growth, rate, sides, box or {}, _FURTHER)) is not None:
        return grown
    if rate.has(sp.DiracDelta):
        at = ", ".join(sorted({f"{f.args[0]} = 0" for f in rate.atoms(sp.DiracDelta)}))
        return Dissipation(rate, "open", f"the energy jumps at {at}; declare one that is continuous")
    if _is_negative(motion, rate, sides):
        return Dissipation(rate, "proved", "interval arithmetic on a box", box=sides)
    if (grown := _grown(growth, rate, sides, box or {}, _FARTHEST)) is not None:
        return grown
    return Dissipation(rate, "supported numerically", f"V' <= 0 at {SAMPLES} sampled states", box=sides)


def _grown(
    growth: Growth, rate: sp.Expr, sides: dict[str, tuple[float, float]], box: Box, further: tuple[float, ...]
) -> Dissipation | None:
    """State at which V' > 0, looked for on multiples of the sides that no box gives."""
    for times in further if not sides.keys() <= box.keys() else (1.0,):
        reach = {n: side if n in box else (times * side[0], times * side[1]) for n, side in sides.items()}
        if (found := growth.search(reach)) is not None:
            state, least = found
            return Dissipation(rate, "refuted", "a state at which V' > 0", counterexample=state, growth=least)
    return None


def _losses(rate: sp.Expr, motion: Motion) -> tuple[tuple[Square, ...], tuple[sp.Expr, ...]] | None:
    """-V' as a sum of terms even in the velocities, and of resistances such as c v tanh(k v) and c |v| v^2.

    None of the terms is ever negative. Those that are squares, none where some are of another kind, and forms of the
    velocities that are 0 where the terms are; a term may have no form.
    """
    v, given = motion.v, motion.given
    left, forms = sp.expand(-rate, power_exp=False), list[sp.Expr]()  # exp(a + b) is not split: parts may underflow
    held = [f for f in left.atoms(*_ODD, sp.sign, sp.Abs) if f.args[0].free_symbols & {*v}]
    for resistance in sorted(held, key=sp.default_sort_key):
        part = sum((term for term in sp.Add.make_args(left) if term.has(resistance)), sp.Integer(0))
        (argument,) = resistance.args
        by = normal(part / resistance / (1 if resistance.func == sp.Abs else argument))
        if by.has(*held) or given.declared_sign(by, strictly=False) not in {0, 1}:
            return None
        left -= part
        forms += _zeros(normal(by / argument**2), argument, motion) or _zeros(by, argument, motion)
    if not left.is_polynomial(*v):
        return None
    found, by_degree = list[Square](), dict[int, sp.Expr]()
    for powers, coefficient in sp.Poly(left, *v).terms() if left != 0 else ():
        monomial = sp.Mul(*(x**n for x, n in zip(v, powers, strict=True)))
        term = without_void(coefficient, given) * monomial
        by_degree[sum(powers)] = by_degree.get(sum(powers), sp.Integer(0)) + term
    for degree, part in by_degree.items():
        terms = _even(part, degree, motion)
        if terms is None:
            return None
        found += terms
        forms += [z for term in terms for z in _zeros(term.coefficient, term.form.as_base_exp()[0], motion)]
    is_lipschitz = not any(f.has(sp.sign, sp.Heaviside, sp.floor, sp.ceiling) for f in motion.force)
    return () if held else tuple(found), tuple(dict.fromkeys(forms)) if is_lipschitz else ()


def _even(part: sp.Expr, degree: int, motion: Motion) -> list[Square] | None:
    """Sum of terms of one degree in the velocities as squares, their coefficients nowhere negative."""
    v, given = motion.v, motion.given
    if degree == 2 and (whole := squares(sp.hessian(part, v) / 2, v, given)) is not None:
        return list(whole)
    terms = sp.Poly(part, *v).terms() if part != 0 else []
    if any(n % 2 for powers, _ in terms for n in powers):  # perhaps a power of one form
        held = [(f, n) for f, n in sp.factor_list(part)[1] if f.free_symbols & {*v}]
        if len(held) != 1 or held[0][1] % 2:
            return None
        ((form, power),) = held
        found = [Square(normal(part / form**power), form ** (power // 2))]
    else:
        found = [Square(c, sp.Mul(*(x ** (n // 2) for x, n in zip(v, n_, strict=True)))) for n_, c in terms]
    is_fine = all(given.declared_sign(normal(x.coefficient), strictly=False) in {0, 1} and x.form != 1 for x in found)
    return found if is_fine else None


def _zeros(coefficient: sp.Expr, form: sp.Expr, motion: Motion) -> list[sp.Expr]:
    """Form of the velocities if it vanishes along every motion on which coefficient * form^2 does.

    So it does where the coefficient is positive. It may vanish, too, as an analytic function of the one coordinate
    whose velocity the form is: either that is constant, or the form vanishes.
    """
    form = sp.Mul(*(f for f in sp.Mul.make_args(form) if f.free_symbols & {*motion.v}))
    held = coefficient.free_symbols & {*motion.q, *motion.v}
    own = {q for q, x in zip(motion.q, motion.v, strict=True) if x == form}
    if motion.given.declared_sign(coefficient) == 1:
        return [form]
    fixed = [f for f, _ in factors(coefficient) if not f.free_symbols & {*motion.q, *motion.v}]
    if held <= own and not coefficient.has(*_KINKS) and all(motion.given.is_nonzero(f) for f in fixed):
        return [form]
    return []


def default_box(motion: Motion, box: Box) -> dict[str, tuple[float, float]]:
    """Sides of all coordinates and velocities, in the units of the model: as given, or by default."""
    model, names = motion.model, [*map(str, motion.q), *map(str, motion.v)]
    check_box(model, box)
    state = model.initial_state({})
    n = len(motion.q)
    reach = 2.0 * float(np.max(np.abs(state[:n]), initial=0.0)) or 1.0
    try:
        linear = state_matrix(model)
    except ModelError:  # at a kink, or where an operation has no slope: nothing is known of how fast the motion is
        linear = np.full((1, 1), np.nan)
    rates = np.abs(np.linalg.eigvals(linear)) if np.all(np.isfinite(linear)) else np.ones(1)
    fast = max(float(np.max(rates, initial=0.0)), 1e-3)
    default = dict.fromkeys(names[:n], (-reach, reach)) | dict.fromkeys(names[n:], (-reach * fast, reach * fast))
    return {name: box.get(name, default[name]) for name in names}


def _is_negative(motion: Motion, rate: sp.Expr, sides: dict[str, tuple[float, float]]) -> bool:
    """Whether V' <= 0 on a box: V' and its slope in the velocities vanish at rest, and it is concave in them.

    False, too, where V' has kinks or jumps in the velocities, and where its Hessian has no enclosure by intervals.
    """
    state = [x for x in (*motion.q, *motion.v) if x in rate.free_symbols]
    used = [v for v in motion.v if v in state]
    if any(f.free_symbols & {*used} for f in rate.atoms(*_KINKS)):
        return False
    still = dict.fromkeys(used, 0)
    if not used or any(normal(x.subs(still)) != 0 for x in (rate, *(sp.diff(rate, v) for v in used))):
        return False
    low, high = (np.array([sides[x.name][k] for x in state]) for k in (0, 1))
    inside = [(b >= -1e-300) and (a <= 1e-300) for a, b in zip(low, high, strict=True)]
    if not all(ok for ok, x in zip(inside, state, strict=True) if x in used):
        return False
    try:
        return _Hessian(motion, rate, state, used).is_negative(low, high)
    except (ModelError, ArithmeticError):
        return False


class _Hessian:
    """The Hessian of V' in the velocities, on a graph, at the declared values."""

    def __init__(self, motion: Motion, rate: sp.Expr, state: list[sp.Symbol], used: list[sp.Symbol]) -> None:
        self.graph, self.n = Graph(), len(used)
        symbols, _ = motion.on(self.graph, state)
        self.at, self.values = [symbols[x] for x in state], motion.enclosed(symbols)
        self.entries = [self.graph.lower(x, symbols) for x in sp.hessian(rate, used)]

    def edge(self, boxes: Interval) -> Array:
        """Upper bounds of the eigenvalues, for each box (m, states) and row (m, n)."""
        given = self.values | {node: boxes[:, i] for i, node in enumerate(self.at)}
        m, n = len(boxes.low), self.n
        entries = Interval.stacked(enclose(self.graph, self.entries, given), m)
        # Gershgorin: every eigenvalue is at most the diagonal plus what stands beside it.
        beside = np.maximum(np.abs(entries.low), np.abs(entries.high)).reshape(m, n, n)
        beside[:, range(n), range(n)] = 0.0
        return np.asarray(entries.high[:, :: n + 1] + beside.sum(axis=2) * (1.0 + 1e-12))

    def is_confirmed(self, box: Interval) -> bool:
        """Whether mpmath's intervals show that no eigenvalue is above 0 on a box (states,)."""
        n = self.n
        found = enclosed_again(self.graph, self.entries, self.values | {x: box[i] for i, x in enumerate(self.at)})
        rows = [found[i : i + n] for i in range(0, n * n, n)]
        return all(x[i].b + sum(abs(x[k]).b for k in range(n) if k != i) <= _ZERO for i, x in enumerate(rows))

    def is_negative(self, lowest: Array, highest: Array) -> bool:
        """Whether it is negative semidefinite all over a box."""
        boxes, shown = Interval(lowest[None], highest[None]), list[Interval]()
        for _ in range(_ROUNDS):
            is_shown = np.all(self.edge(boxes) <= _ZERO, axis=1)
            shown += [boxes[i] for i in np.flatnonzero(is_shown)]
            boxes = boxes[~is_shown]
            if not len(boxes.low):
                return all(self.is_confirmed(box) for box in shown[:: 1 + len(shown) // _MOST_CONFIRMED])
            if 2 * len(boxes.low) > _MOST_BOXES:
                return False
            boxes = halves(boxes, np.argmax(boxes.width / (highest - lowest), axis=1))
        return False


class Growth:
    """An expression of the state of a motion on a graph, at the declared values, and the edges across which it jumps.

    At an edge, such as v = 0 of sign(v), the expression has no one value: no state there counts.

    Raises:
        ModelError: a function in the expression cannot be evaluated.
    """

    def __init__(self, motion: Motion, expression: sp.Expr) -> None:
        self.motion = motion
        self.smooth = expression.replace(sp.DiracDelta, lambda *_: sp.Integer(0))
        self.state = [x for x in (*motion.q, *motion.v) if x in expression.free_symbols]
        jumps = [f.args[0] for f in expression.atoms(sp.sign, sp.Heaviside, sp.DiracDelta)]
        jumps += [r.lhs - r.rhs for r in expression.atoms(sp.core.relational.Relational)]
        self.graph = Graph()
        symbols, self.values = motion.on(self.graph, self.state)
        self.at, self.exact = [symbols[x] for x in self.state], motion.enclosed(symbols)
        self.node = self.graph.lower(self.smooth, symbols)
        self.edges = [self.graph.lower(x, symbols) for x in dict.fromkeys(jumps)]

    def search(self, sides: Mapping[str, tuple[float, float]]) -> tuple[dict[str, float], float] | None:
        """State of a box, its numbers short, and the least that the expression is there, which is positive.

        None where there is no such state among those tried.
        """
        rng = np.random.default_rng(0)
        low, high = (np.array([sides[x.name][k] for x in self.state]) for k in (0, 1))
        points = rng.uniform(low, high, (SAMPLES, len(self.state)))
        # Also samples at few places at a time: growth may need a coordinate to be 0.
        points[::3] *= rng.integers(0, 2, (len(points[::3]), len(self.state)))
        span = float(np.max(np.abs([low, high]), initial=0.0)) or 1.0
        digits = 2 - int(np.floor(np.log10(span)))
        points = np.clip(np.round(points, digits), low, high)
        found = along(self.graph, [self.node, *self.edges], self.at, self.values)(points)
        value, *edges = (np.broadcast_to(x, SAMPLES) for x in found)
        is_fit = np.isfinite(value) & np.all([edge != 0.0 for edge in edges], axis=0)
        value = np.where(is_fit, value, -np.inf)
        for best in np.argsort(-value, kind="stable")[:_MOST_TRIED]:
            if value[best] <= 0.0:
                return None
            growth = self._confirmed(points[best])
            if growth > 0.0:
                state = {x.name: 0.0 for x in (*self.motion.q, *self.motion.v)}
                return state | {x.name: float(y) for x, y in zip(self.state, points[best], strict=True)}, growth
        return None

    def _confirmed(self, point: Array) -> float:
        """Number that the expression is not below at a state; -inf where none is found."""
        given = self.exact | {n: Interval.of(float(x)) for n, x in zip(self.at, point, strict=True)}
        try:
            low = float(enclose(self.graph, [self.node], given)[0].low)
            return low if low <= 0.0 or enclosed_again(self.graph, [self.node], given)[0].a > 0.0 else -np.inf
        except ModelError:
            at = {x: sp.Rational(float(y)) for x, y in zip(self.state, point, strict=True)}
            value = self.motion.given.at_values(self.smooth.subs(at))
            if not (value.is_number and value.is_real and value.is_finite):
                return -np.inf
            about = sp.N(value, 30)
            return float(about) * (1.0 - _ROUNDING) if value.is_Rational or about > _DISTINCT else -np.inf


def along(
    graph: Graph, nodes: list[Node], variables: Sequence[Node], given: Mapping[Node, Any]
) -> Callable[[Array], list[Any]]:
    """Function of states (..., variables) that gives nodes of a graph at each, in floating point."""
    with np.errstate(all="ignore"):
        function = function_of(graph, nodes, given, ARRAYS, _KIND, variables=variables)

    def at(states: Array) -> list[Any]:
        with np.errstate(all="ignore"):
            return function(np.moveaxis(states, -1, 0))

    return at
