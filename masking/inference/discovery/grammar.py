"""Grammar: the closed forms that a law without a name is written in.

A form is a sum of terms with a factor each; a term is a shape of the displacement or of the rate, or a product of both.
Shapes are of u, displacement or rate over the largest in the record; at most three numbers shape a form.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from masking.compile.codegen.graph import Graph
from masking.compile.codegen.graph_values import ARRAYS, function_of
from masking.compile.numerics.arrays import Array
from masking.inference.discovery.augmented_model import EffectInstance
from masking.lazy_imports import sympy as sp
from masking.model.declaration.expression import Expression

MOST_SHAPES = 3  # numbers that shape a form
_TINY = "1e-9"  # of the largest displacement or rate: powers have derivatives from there on
_BASES = {"d": "d/x0", "v": "d_rate/v0"}


@dataclass(frozen=True)
class Shape:
    """A function of u with numbers that shape it."""

    name: str  # of the shape
    text: str  # over u and the numbers, in braces
    noun: str  # what it is, of x, with the numbers in braces
    tried: Mapping[str, tuple[float, ...]]  # values from which fits start, by number
    bounds: Mapping[str, tuple[float, float]]  # of each number
    grows: bool = True  # whether a force of this shape grows with its displacement or rate


def _shape(name: str, text: str, noun: str, /, **tried: Sequence[float]) -> Shape:
    values = {key: tuple(values) for key, values in tried.items()}
    return Shape(name, text, noun, values, {key: _BOUNDS[key] for key in values}, name not in _FALLING)


_FALLING = {"constant", "sign", "peak", "wave", "bell", "growth"}
_BOUNDS = {"n": (0.1, 9.0), "b": (1e-3, 1e3), "e": (-1e3, 1e3), "r": (1.02, 1e3), "l": (-1e3, -1.02), "p": (-4.0, 4.0)}
_POWERS = (0.35, 0.6, 1.35, 1.7, 2.0, 2.5, 3.0, 3.5, 4.5, 6.0)
_SIDES = (1.0, 1.5, 2.0, 3.0)
_WIDTHS = (0.05, 0.12, 0.25, 0.5, 1.0)
_SIZE = f"max(abs({{u}}), {_TINY})"
CONSTANT = _shape("constant", "1", "nothing that moves")
SIGN = _shape("sign", "tanh({u}/0.002)", "the direction of the {x}")
LINEAR = _shape("linear", "{u}", "the {x}")
EVEN = _shape("even power", f"{_SIZE}**{{n}}", "the {n} power of the {x}, alike on both sides", n=_POWERS)
RATES: tuple[Shape, ...] = (
    LINEAR,
    _shape("odd power", f"sign({{u}})*{_SIZE}**{{n}}", "the {n} power of the {x}", n=_POWERS),
    _shape("tanh", "tanh({u}/{b})", "the {x} up to a limit", b=_WIDTHS),
    _shape("peak", "{u}/(1 + ({u}/{b})**2)", "the {x} up to a peak, beyond which it falls", b=_WIDTHS),
)
BOTH: tuple[Shape, ...] = (
    _shape("growth", "exp({u}/{e})", "an exponential of the {x}", e=(0.2, 0.4, 0.8, 1.6, -0.2, -0.4, -0.8, -1.6)),
    _shape("wave", "sin({u}/{b} + {p})", "a sine of the {x}", b=(0.1, 0.18, 0.3, 0.5), p=(-1.6, -0.8, 0.0, 0.8, 1.6)),
    _shape("upper pole", "1/(1 - {u}/{r})**2", "the inverse square of the distance to a {x} above the travel",
           r=(1.15, 1.5, 2.2, 4.0)),
    _shape("lower pole", "1/(1 - {u}/{l})**2", "the inverse square of the distance to a {x} below the travel",
           l=(-1.15, -1.5, -2.2, -4.0)),
)  # fmt: skip
AT_REST = {"growth": "1", "wave": "sin({p})", "upper pole": "1", "lower pole": "1"}  # values at rest
ALONE = tuple(replace(one, text=f"({one.text} - {AT_REST[one.name]})") for one in BOTH)
DISPLACEMENTS: tuple[Shape, ...] = (
    *RATES,
    EVEN,
    *ALONE,
    _shape("upper side", f"max({{u}}, {_TINY})**{{n}}", "the {n} power of the {x} above rest", n=_SIDES),
    _shape("lower side", f"max(-{{u}}, {_TINY})**{{n}}", "the {n} power of the {x} below rest", n=_SIDES),
    _shape("sinh", "sinh({u}/{b})", "a hyperbolic sine of the {x}", b=(0.15, 0.3, 0.6)),
    _shape("arc tangent", "atan({u}/{b})", "an arc tangent of the {x}", b=_WIDTHS),
    _shape("tangent", "tan({u}/{r}*pi/2)", "a tangent of the {x}", r=(1.05, 1.3, 1.8, 3.0)),
    _shape("bell", "{u}*exp(-({u}/{b})**2)", "the {x} near rest alone", b=(0.1, 0.25, 0.5)),
    _shape("logarithm", "sign({u})*log(1 + abs({u})/{b})", "the logarithm of the {x}", b=(0.01, 0.05, 0.2)),
)


@dataclass(frozen=True)
class Atom:
    """A term of a form, without its factor: shapes of displacement and rate, one or both."""

    of_d: Shape | None
    of_v: Shape | None

    @cached_property
    def shapes(self) -> tuple[tuple[str, Shape], ...]:
        """Shapes with what they are of."""
        return tuple((of, shape) for of, shape in (("d", self.of_d), ("v", self.of_v)) if shape is not None)

    def starts(self) -> list[tuple[float, ...]]:
        """Values from which fits start, one after the other."""
        return [*itertools.product(*(values for _, shape in self.shapes for values in shape.tried.values()))]

    @property
    def count(self) -> int:
        """How many numbers shape it."""
        return sum(len(shape.tried) for _, shape in self.shapes)

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Bounds of these numbers."""
        return [bounds for _, shape in self.shapes for bounds in shape.bounds.values()]

    def text(self, names: Sequence[str]) -> str:
        """Term over `d`, `d_rate`, `x0`, `v0` and named numbers."""
        parts, left = [], list(names)
        for of, shape in self.shapes:
            known = {key: left.pop(0) for key in shape.tried}
            parts.append(shape.text.format(u=f"({_BASES[of]})", **known))
        return "*".join(parts)

    def along(self, motion: Mapping[str, Array | float], values: Sequence[float]) -> Array:
        """Values (m,) along displacements and rates `d` and `d_rate` (m,), of largest sizes `x0` and `v0`."""
        names = [f"p{i}" for i in range(self.count)]
        return np.broadcast_to(
            evaluated(self.text(names), {**motion, **dict(zip(names, values, strict=True))}), np.shape(motion["d"])
        )

    def words(self, values: Sequence[float], nouns: Mapping[str, str]) -> str:
        """Phrase for the force of the term, with the values of its numbers and nouns of displacement and rate."""
        left, said = [*values], []
        for of, shape in reversed(self.shapes):
            numbers = [left.pop() for _ in shape.tried][::-1]
            known = {key: _ordinal(value) for key, value in zip(shape.tried, numbers, strict=True)}
            said.append(shape.noun.format(x=nouns[of], **known))
        return f"{'grows with' if self.shapes[-1][1].grows else 'follows'} {', times '.join(said)}"

    @property
    def name(self) -> str:
        """Shapes that it is made of."""
        return " x ".join(f"{shape.name} of {of}" for of, shape in self.shapes)


def atoms(has_displacement: bool, has_rate: bool) -> list[Atom]:
    """Every term of a law at a place that has a displacement, a rate, or both."""
    found = [Atom(shape, None) for shape in (CONSTANT, *(DISPLACEMENTS if has_displacement else ()))]
    if has_rate:
        turning = (SIGN, *RATES)
        found += [Atom(None, shape) for shape in (*turning, EVEN, *ALONE[:1])]
        factors = (EVEN, *BOTH, LINEAR) if has_displacement else ()
        found += [Atom(a, b) for a in factors for b in turning if len(a.tried) + len(b.tried) <= MOST_SHAPES]
    return found


def _ordinal(value: float) -> str:
    """Power as one says it: 2nd, 1.7th."""
    text = f"{value:.3g}"
    return text + {"1": "st", "2": "nd", "3": "rd"}.get(text, "th")


@cache
def _function(text: str, names: tuple[str, ...]) -> Callable[[Iterable[Any]], list[Any]]:
    """Function that an expression is, of arrays by symbol."""
    graph = Graph()
    nodes = {sp.Symbol(name, real=True): graph.symbol(name, varying=True) for name in names}
    value = graph.lower(Expression(text).to_sympy({symbol.name: symbol for symbol in nodes}), nodes)
    return function_of(graph, [value], {}, ARRAYS, "value", variables=[*nodes.values()])


def evaluated(text: str, known: Mapping[str, Array | float]) -> Array:
    """Values of an expression (m,) for columns (m,) or numbers by symbol."""
    with np.errstate(all="ignore"):
        (found,) = _function(text, tuple(known))(known.values())
    return np.asarray(found, dtype=float)


def force(instance: EffectInstance, x: Array, rate: Array) -> Array:
    """Force of a law at displacements and rates (m,)."""
    values = dict(zip(instance.entry.parameters, instance.values, strict=True))
    found = evaluated(instance.entry.expression, {**values, "d": x, "d_rate": rate})
    return np.broadcast_to(found, np.shape(x))
