"""Tabulated law: a free law as an effect whose expression holds its curves as tables."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.free_law import FreeLaw
from masking.inference.discovery.spline_bases import Curve, Term
from masking.model.effects import EffectParameter

DIGITS = 8  # of the numbers of a table
LEAST = 1e-4  # of the strongest part of a surface: weaker ones are left out
_UNITS = {"f": "F", "c": "F*s/D", "x": "D", "v": "D/s", "s": "D/s"}
_MEANINGS = {
    "f": "force at 1 in the table",
    "c": "damping at 1 in the table",
    "x": "displacement at 1 in the table",
    "v": "rate at 1 in the table",
    "s": "rate below which the sign of the rate is smooth",
}


def tabulated(law: FreeLaw) -> EffectInstance:
    """Free law as one effect at its place, in tables of displacement and rate."""
    parts, values, kinds = [], dict[str, float](), [term.kind for term in law.terms]
    factors = np.split(law.factors, np.cumsum([term.size for term in law.terms])[:-1])
    if {"free_spring", "free_damping"} <= {*kinds}:  # what the curve over the rate is at rest goes to the other
        one, other = kinds.index("free_damping"), kinds.index("free_spring")
        at_rest = float((law.terms[one].curves[0].values(np.zeros(1)) @ factors[one])[0])
        factors[one], factors[other] = factors[one] - at_rest, factors[other] + at_rest  # B-splines add up to 1
    for i, (term, of_term) in enumerate(zip(law.terms, factors, strict=True)):
        parts += [*_written(term, of_term, "" if i == 0 else str(i + 1), values)]
    parameters = {name: EffectParameter(_UNITS[name[0]], _MEANINGS[name[0]]) for name in values}
    return law.written(" + ".join(parts), parameters, values.values())


def _written(term: Term, factors: Array, label: str, values: dict[str, float]) -> Iterator[str]:
    """Parts of a term as text; adds their parameters with their values."""
    f, x, v, s, c = (f"{letter}{label or 0}" for letter in "fxvsc")
    match term.kind:
        case "free_friction":
            values |= {f: float(factors[0]), s: term.sharp}
            yield f"{f}*tanh(d_rate/{s})"
        case "free_surface":
            along, across = term.curves
            of_rate = along.values(along.points) @ factors.reshape(along.size, across.size)
            heights = of_rate @ across.values(across.points).T
            left, sizes, right = decompositions.svd(heights)
            values |= {f: float(sizes[0]) or 1.0, x: _reach(along), v: _reach(across)}
            for size, a, b in zip(sizes, left.T, right, strict=True):
                if size > LEAST * sizes[0]:
                    of_x, of_v = _table(along, f"d/{x}", a), _table(across, f"d_rate/{v}", b * size / values[f])
                    yield f"{f}*{of_x}*{of_v}"
        case kind:
            (curve,) = term.curves
            heights = curve.values(curve.points) @ factors
            by, at = (c, x) if kind == "free_resistance" else (f, v) if kind == "free_damping" else (f, x)
            values |= {by: float(np.abs(heights).max()) or 1.0, at: _reach(curve)}
            table = _table(curve, f"{'d_rate' if at == v else 'd'}/{at}", heights / values[by])
            turned = {"free_resistance": "d_rate*", "free_rub": f"tanh(d_rate/{s})*"}.get(kind, "")
            values |= {s: term.sharp} if kind == "free_rub" else {}
            yield f"{by}*{turned}{table}"


def _reach(curve: Curve) -> float:
    return float(np.abs(curve.points).max())


def _table(curve: Curve, of: str, heights: Array) -> str:
    pairs = zip(curve.points / _reach(curve), heights, strict=True)
    return f"interpolate({of}, {', '.join(f'{a:.{DIGITS}g}, {b:.{DIGITS}g}' for a, b in pairs)})"
