"""The compared systems as someone would write them for each of the other programs; values from the registry."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import cos, sin
from typing import Any

import numpy as np

from masking.model.declaration import registry
from masking.model.modelling.model import Model

Array = np.ndarray
Values = Mapping[str, float]


@dataclass(frozen=True)
class System:
    """A model of the registry over a span of time, its exact-enough solution, and how others are told of it."""

    name: str
    span: float
    plain: Callable[[Values], Callable[[float, Array], Array]]
    symbolic: Callable[[Values], list[Any]]
    points: int = 2000
    model: Model = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "model", Model(registry.load_model(self.name)))

    @cached_property
    def times(self) -> Array:
        """Give the output times (points,)."""
        return np.linspace(0.0, self.span, self.points)

    @cached_property
    def start(self) -> Array:
        """Give the initial state (2 n,)."""
        return self.model.initial_state({})

    @cached_property
    def reference(self) -> Array:
        """Give the states (points, 2 n), each step of the integration right to 1e-14."""
        return np.array(self.model.simulate(self.times, tolerance=1e-14).states)

    def error(self, states: Array) -> float:
        """Give the largest difference from the reference over all points and states, per largest state."""
        reference = self.reference[: len(states)]
        return float(np.max(np.abs(states - reference)) / np.max(np.abs(reference)))


def duffing_plain(p: Values) -> Callable[[float, Array], Array]:
    """Write (7.5)-(7.7) as one would for scipy."""
    w1, w2, w3, th1, th2, mu1, mu2, z3 = (p[n] for n in ("w1", "w2", "w3", "th1", "th2", "mu1", "mu2", "z3"))

    def rhs(t: float, y: Array) -> Array:
        x1, x2, x3, v1, v2, v3 = y
        f1 = w1**2 * (x1 - x3) + th1 * (x1 - x3) ** 3
        f2 = w2**2 * (x2 - x3) + th2 * (x2 - x3) ** 3
        return np.array([v1, v2, v3, -f1, -f2, mu1 * f1 + mu2 * f2 - w3**2 * x3 - 2 * z3 * w3 * v3])

    return rhs


def huygens_plain(p: Values) -> Callable[[float, Array], Array]:
    """Write (9.10), the equations solved for the accelerations, as one would for scipy."""
    w1, w2, om, z, mu1, mu2 = (p[n] for n in ("w1", "w2", "Om", "z", "mu1", "mu2"))

    def rhs(t: float, y: Array) -> Array:
        th1, th2, x, v1, v2, v = y
        s1, c1, s2, c2 = sin(th1), cos(th1), sin(th2), cos(th2)
        top = mu1 / 3 * s1 * (c1 + v1**2 / w1**2) + mu2 / 3 * s2 * (c2 + v2**2 / w2**2) - om**2 * x - 2 * z * om * v
        a = top / (1 - mu1 / 3 * c1**2 - mu2 / 3 * c2**2)
        return np.array([v1, v2, v, -(w1**2) * (a * c1 + s1), -(w2**2) * (a * c2 + s2), a])

    return rhs


def duffing_symbolic(p: Values) -> list[Any]:
    """Write (7.5)-(7.7) in heyoka's expressions."""
    import heyoka as hy

    x1, x2, x3, v1, v2, v3 = hy.make_vars("x1", "x2", "x3", "v1", "v2", "v3")
    d1, d2 = x1 - x3, x2 - x3
    f1, f2 = d1 * (p["w1"] ** 2 + p["th1"] * d1**2), d2 * (p["w2"] ** 2 + p["th2"] * d2**2)  # its fastest form
    a3 = p["mu1"] * f1 + p["mu2"] * f2 - p["w3"] ** 2 * x3 - 2 * p["z3"] * p["w3"] * v3
    return [(x1, v1), (x2, v2), (x3, v3), (v1, -f1), (v2, -f2), (v3, a3)]


def huygens_symbolic(p: Values) -> list[Any]:
    """Write (9.10) in heyoka's expressions."""
    import heyoka as hy

    th1, th2, x, v1, v2, v = hy.make_vars("th1", "th2", "x", "v1", "v2", "v")
    s1, c1, s2, c2 = hy.sin(th1), hy.cos(th1), hy.sin(th2), hy.cos(th2)
    w1, w2, om, z = p["w1"] ** 2, p["w2"] ** 2, p["Om"], p["z"]
    m1, m2 = p["mu1"] / 3, p["mu2"] / 3
    top = m1 * s1 * (c1 + v1**2 / w1) + m2 * s2 * (c2 + v2**2 / w2) - om**2 * x - 2 * z * om * v
    a = top / (1.0 - m1 * c1**2 - m2 * c2**2)
    return [(th1, v1), (th2, v2), (x, v), (v1, -w1 * (a * c1 + s1)), (v2, -w2 * (a * c2 + s2)), (v, a)]


SYSTEMS = {
    "duffing": System("duffing", 2500.0, duffing_plain, duffing_symbolic),
    "huygens": System("huygens", 400.0, huygens_plain, huygens_symbolic),
}
