"""Dissipation: whether the rate V' of a declared energy is nowhere positive.

Tried in this order: V' as minus a sum of squares of velocities, by completing squares; a state at which V' > 0, which
intervals confirm; V' <= 0 on a box, by intervals, where V' and its slope vanish at rest and its Hessian in the
velocities is negative semidefinite all over the box.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import lazy_loader as lazy
import numpy as np

from masking.compile.graph import Graph
from masking.errors import ModelError
from masking.kernels import Array
from masking.model import Model
from masking.stability.algebra import normal
from masking.stability.boundedness import Square, squares
from masking.stability.intervals import Interval, enclose
from masking.stability.modes import state_matrix
from masking.stability.motion import Motion

if TYPE_CHECKING:
    import sympy as sp
else:
    sp = lazy.load("sympy")

Status = Literal["proved", "refuted", "supported numerically", "open"]
Box = Mapping[str, tuple[float, float]]

_SAMPLES = 20_000
_MOST_BOXES = 50_000
_ROUNDS = 40
_FURTHER = (1.0, 10.0, 100.0)  # times a side that is not given: how far a state at which V' > 0 is looked for


@dataclass(frozen=True)
class Dissipation:
    """What is known of V'.

    Args:
        rate: V', in normal form.
        status: 'proved': V' <= 0, everywhere or on `box`; 'refuted': V' > 0 at `counterexample`; 'supported
            numerically': V' <= 0 at all sampled states; 'open' where it could not be looked at.
        method: how that was found.
        squares: of which -V' is the sum, where it is seen to be one.
        box: where it holds; None for everywhere.
        counterexample: a state at which V' > 0, at the declared values, in SI units, and `growth`, the least V' there.
    """

    rate: sp.Expr
    status: Status
    method: str
    squares: tuple[Square, ...] = ()
    box: dict[str, tuple[float, float]] | None = None
    counterexample: dict[str, float] | None = None
    growth: float = 0.0


def dissipation(motion: Motion, box: Box | None = None) -> Dissipation:  # noqa: PLR0911  # one way each
    """Find out whether the energy of a model can grow.

    Args:
        motion: the equations; its hypotheses get those that the proof needs.
        box: least and largest values of coordinates and velocities (`x1'`), in SI units, for what is not proved
            everywhere; where not given, twice the largest declared initial value, times the largest eigenvalue, and
            states at which V' > 0 are looked for up to a hundred times as far, too.

    Raises:
        ModelError: the model has no energy.
    """
    rate = motion.energy_rate
    if rate == 0:
        return Dissipation(rate, "proved", "V' vanishes identically: the energy is constant")
    found = _sum_of_squares(rate, motion)
    if found is not None:
        return Dissipation(rate, "proved", "a sum of squares of velocities", found)
    if _is_sum_of_resistances(rate, motion):
        return Dissipation(rate, "proved", "a sum of velocities times forces against them")
    sides = _sides(motion, box or {})
    try:
        field = _Field(motion, rate, sides)
        for further in _FURTHER if not sides.keys() <= (box or {}).keys() else (1.0,):
            reach = {
                n: side if n in (box or {}) else (further * side[0], further * side[1]) for n, side in sides.items()
            }
            state, growth = field.largest(reach)
            if growth > 0.0:
                return Dissipation(rate, "refuted", "a state at which V' > 0", counterexample=state, growth=growth)
        if field.is_negative():
            return Dissipation(rate, "proved", "interval arithmetic on a box", box=sides)
    except ModelError as error:
        return Dissipation(rate, "open", f"not looked at by intervals: {error}")
    return Dissipation(rate, "supported numerically", f"V' <= 0 at {_SAMPLES} sampled states", box=sides)


def _sum_of_squares(rate: sp.Expr, motion: Motion) -> tuple[Square, ...] | None:
    """Return the squares of which -V' is the sum: of a quadratic form, or of monomials with even powers."""
    v = motion.v
    expanded = sp.expand(-rate)
    if not expanded.is_polynomial(*v):
        return None
    polynomial = sp.Poly(expanded, *v)
    if polynomial.is_homogeneous and polynomial.total_degree() == 2:
        return squares(sp.hessian(expanded, v) / 2, v, motion.given)
    found = []
    for powers, coefficient in polynomial.terms():
        is_even = all(n % 2 == 0 for n in powers) and any(powers)
        if not is_even or motion.given.declared_sign(normal(coefficient)) != 1:
            return None
        form = sp.Mul(*(x ** (n // 2) for x, n in zip(v, powers, strict=True)))
        found.append(Square(coefficient, form))
    return tuple(found)


def _is_sum_of_resistances(rate: sp.Expr, motion: Motion) -> bool:
    """Tell whether -V' is a sum of terms such as c v tanh(k v) or c |v|, which are never negative.

    A term has the sign that it has with x for odd increasing functions of x, and x^2 for |x|.
    """
    odd = {sp.tanh, sp.atan, sp.sinh, sp.asinh, sp.sign}
    for term in sp.Add.make_args(sp.expand(-rate)):
        plain = term.replace(lambda x: x.func in odd, lambda x: x.args[0]).replace(sp.Abs, lambda x: x**2)
        if motion.given.declared_sign(plain, strictly=False) not in {0, 1}:
            return False
    return True


def _sides(motion: Motion, box: Box) -> dict[str, tuple[float, float]]:
    """Return a box of coordinates and velocities, in SI units."""
    names = [*map(str, motion.q), *map(str, motion.v)]
    for name in box:
        if name not in names:
            raise ModelError(f"the box names '{name}'; {motion.model.name} has {', '.join(names)}")
    model = Model(motion.model.declaration, motion.model.overrides)
    declared = model.declaration.coordinates
    state = model.initial_state({c: 0.0 for c, d in declared.items() if d.initial is None})
    n = len(motion.q)
    reach = 2.0 * float(np.max(np.abs(state[:n]), initial=0.0)) or 1.0
    linear = state_matrix(model)
    rates = np.abs(np.linalg.eigvals(linear)) if np.all(np.isfinite(linear)) else np.ones(1)
    fast = max(float(np.max(rates, initial=0.0)), 1e-3)
    default = dict.fromkeys(names[:n], (-reach, reach)) | dict.fromkeys(names[n:], (-reach * fast, reach * fast))
    return {name: box.get(name, default[name]) for name in names}


class _Field:
    """V' and its Hessian in the velocities, on a graph, at the declared values."""

    def __init__(self, motion: Motion, rate: sp.Expr, sides: dict[str, tuple[float, float]]) -> None:
        self.motion, self.rate = motion, rate
        state = (*motion.q, *motion.v)
        self.state = [x for x in state if x in rate.free_symbols]
        self.used = [v for v in motion.v if v in rate.free_symbols]
        self.low = np.array([sides[x.name][0] for x in self.state])
        self.high = np.array([sides[x.name][1] for x in self.state])
        self.graph = Graph()
        symbols = {x: self.graph.symbol(f"x_{x.name}", varying=True) for x in self.state}
        self.at = list(symbols.values())
        self.values = {}
        own = {str(s): (s, motion.given.values[n]) for n, s in motion.given.symbols.items() if not s.is_number}
        for name, (symbol, value) in own.items():
            symbols[symbol] = self.graph.symbol(f"p_{name}", varying=False)
            self.values[symbols[symbol]] = Interval.of(value)
        self.node = self.graph.lower(rate, symbols)
        self.hessian = [self.graph.lower(x, symbols) for x in sp.hessian(rate, self.used)] if self.used else []

    def enclose(self, nodes: list[int], low: Array, high: Array) -> list[Interval]:
        """Return enclosures over boxes (m, states used)."""
        given = self.values | {n: Interval.of(low[:, i], high[:, i]) for i, n in enumerate(self.at)}
        return enclose(self.graph, nodes, given)

    def largest(self, sides: dict[str, tuple[float, float]]) -> tuple[dict[str, float], float]:
        """Return the state of the largest V' among samples of a box, its numbers short, and the least V' there."""
        rng = np.random.default_rng(0)
        lowest, highest = (np.array([sides[x.name][k] for x in self.state]) for k in (0, 1))
        points = rng.uniform(lowest, highest, (_SAMPLES, len(self.state)))
        # Also samples at few places at a time: growth may need a coordinate to be 0.
        points[::3] *= rng.integers(0, 2, (len(points[::3]), len(self.state)))
        span = float(np.max(np.abs([lowest, highest])))
        digits = 2 - int(np.floor(np.log10(span)))
        points = np.clip(np.round(points, digits), lowest, highest)
        (found,) = self.enclose([self.node], points, points)
        best = int(np.argmax(found.low))
        state = {x.name: 0.0 for x in (*self.motion.q, *self.motion.v)}
        state |= {x.name: float(value) for x, value in zip(self.state, points[best], strict=True)}
        return state, float(found.low[best])

    def is_negative(self) -> bool:
        """Tell whether V' <= 0 on the box: V' and its slope in the velocities vanish at rest, and it is concave."""
        still = dict.fromkeys(self.used, 0)
        slopes = [self.rate, *(sp.diff(self.rate, v) for v in self.used)]
        if not self.used or any(normal(x.subs(still)) != 0 for x in slopes):
            return False
        inside = [(h >= -1e-300) and (low <= 1e-300) for low, h in zip(self.low, self.high, strict=True)]
        if not all(ok for ok, x in zip(inside, self.state, strict=True) if x in self.used):
            return False
        low, high = self.low[None], self.high[None]
        n = len(self.used)
        for _ in range(_ROUNDS):
            entries = self.enclose(self.hessian, low, high)
            m = len(low)
            a = np.stack([np.broadcast_to(x.low, m) for x in entries], 1).reshape(m, n, n)
            b = np.stack([np.broadcast_to(x.high, m) for x in entries], 1).reshape(m, n, n)
            # Gershgorin: every eigenvalue is at most the diagonal plus what stands beside it.
            beside = np.maximum(np.abs(a), np.abs(b))
            beside[:, range(n), range(n)] = 0.0
            edge = b[:, range(n), range(n)] + beside.sum(axis=2) * (1.0 + 1e-12)
            bad = np.any(edge > 1e-300, axis=1)
            low, high = low[bad], high[bad]
            if not len(low):
                return True
            if 2 * len(low) > _MOST_BOXES:
                return False
            axis = np.argmax((high - low) / (self.high - self.low), axis=1)
            rows = np.arange(len(low))
            middle = 0.5 * (low[rows, axis] + high[rows, axis])
            first, second = high.copy(), low.copy()
            first[rows, axis], second[rows, axis] = middle, middle
            low, high = np.concatenate([low, second]), np.concatenate([first, high])
        return False
