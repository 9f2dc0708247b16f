"""The truth of a model: its texts read again by sympy, motions by scipy, eigenvalues by numpy. Nothing here is ours."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np
import sympy as sp
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import root

from tests.benchmarks.certificates.entry import BOUNDED, NONE, Entry

FUNCTIONS = {"max": sp.Max, "min": sp.Min, "abs": sp.Abs, "heaviside": lambda x: sp.Heaviside(x, sp.Rational(1, 2))}
ROWS = 801
SEEDS = 3
LARGEST = 1e6  # of the initial size: a motion that has left the numbers


class Truth:
    """A model of the corpus."""

    def __init__(self, entry: Entry) -> None:
        self.entry = entry
        names = entry.coordinates
        self.q = sp.symbols(names, real=True)
        self.v = sp.symbols([f"{x}_v" for x in names], real=True)
        self.t = sp.Symbol("t", real=True)
        self.symbols = {s.name: s for s in (*self.q, *self.v, self.t)}
        for name, value in entry.parameters.items():
            self.symbols[name] = self.read(str(value))
        for name, text in entry.definitions.items():
            self.symbols[name] = self.read(text)
        self.symbols |= dict.fromkeys(entry.inputs, sp.Integer(0))
        if isinstance(entry.equations, dict):
            self.accelerations = [self.read(text) for text in entry.equations.values()]
            self.energy = self.read(entry.energy) if entry.energy else sp.Integer(0)
        else:
            self._of_lagrangian(self.read(entry.equations), self.read(entry.dissipation or "0"))

    def read(self, text: str) -> sp.Expr:
        """Return an expression of a text in which x' is the velocity of x."""
        plain = re.sub(r"([a-z]\w*)'", r"\1_v", text)
        return sp.sympify(plain, locals=FUNCTIONS | self.symbols, rational=True)

    def _of_lagrangian(self, lagrangian: sp.Expr, lost: sp.Expr) -> None:
        mass = sp.hessian(lagrangian, self.v)
        force = sp.Matrix(
            [
                sp.diff(lagrangian, q)
                - sum(sp.diff(lagrangian, v, p) * w for p, w in zip(self.q, self.v, strict=True))
                - sp.diff(lost, v)
                for q, v in zip(self.q, self.v, strict=True)
            ]
        )
        self.accelerations = list(mass.LUsolve(force))
        self.energy = sum(v * sp.diff(lagrangian, v) for v in self.v) - lagrangian

    @cached_property
    def rates(self):
        """Return the function of t and the state that gives the accelerations."""
        return sp.lambdify([self.t, [*self.q, *self.v]], self.accelerations, "numpy")

    def values(self, expressions: Sequence[sp.Expr], states: np.ndarray) -> np.ndarray:
        """Return expressions (m,) at states (rows, 2 n)."""
        found = sp.lambdify([*self.q, *self.v], list(expressions), "numpy")(*states.T)
        return (
            np.stack([np.broadcast_to(x, len(states)) for x in found], axis=1) if found else np.zeros((len(states), 0))
        )

    def motion(self, start: Sequence[float]) -> np.ndarray:
        """Return the states (rows, 2 n) of a motion; fewer rows where it leaves the numbers."""
        n, limit = len(self.q), LARGEST * max(1.0, float(np.max(np.abs(start))))
        duration = self.entry.duration

        def rate(t: float, y: np.ndarray) -> np.ndarray:
            return np.array([*y[n:], *self.rates(t, y)])

        def far(_: float, y: np.ndarray) -> float:
            return limit - float(np.max(np.abs(y)))

        far.terminal = True
        if self.entry.is_rough:
            return _by_small_steps(rate, np.array(start, dtype=float), duration)
        if self.matrix is not None:
            return _linear(self.matrix, np.array(start, dtype=float), duration / (ROWS - 1))
        times = np.linspace(0.0, duration, ROWS)
        run = solve_ivp(rate, (0.0, duration), start, "DOP853", times, rtol=1e-8, atol=1e-11, events=far)
        return run.y.T

    @cached_property
    def matrix(self) -> np.ndarray | None:
        """Return A of y' = A y with y = (q, v, 1); None where the model is not linear."""
        state = [*self.q, *self.v]
        slopes = sp.Matrix(self.accelerations).jacobian(state)
        if slopes.free_symbols or any(a.has(self.t) for a in self.accelerations):
            return None
        n, force = len(self.q), [a.subs(dict.fromkeys(state, 0)) for a in self.accelerations]
        found = np.zeros((2 * n + 1, 2 * n + 1))
        found[:n, n : 2 * n] = np.eye(n)
        found[n : 2 * n] = np.array(sp.Matrix.hstack(slopes, sp.Matrix(force)).evalf(), dtype=float)
        return found

    @cached_property
    def motions(self) -> list[np.ndarray]:
        """Return motions from states at random, and from the state of the entry."""
        rng = np.random.default_rng(1)
        starts = list(self.entry.size * rng.uniform(-1.0, 1.0, (SEEDS, 2 * len(self.q))))
        return [self.motion(start) for start in [*starts, *([self.entry.start] if self.entry.start else [])]]

    @cached_property
    def at_rest(self) -> list[sp.Expr]:
        """Return what vanishes at equilibria."""
        still = dict.fromkeys(self.v, 0)
        return [*self.v, *(a.subs(still) for a in self.accelerations)]

    @cached_property
    def limits(self) -> list[list[sp.Expr]]:
        """Return the sets that every motion converges to, as expressions that vanish."""
        if self.entry.truth in {BOUNDED, NONE}:
            return []
        return [self.set_of(text) for text in self.entry.truth.split("|")]

    def set_of(self, text: str) -> list[sp.Expr]:
        """Return what vanishes on a set, time derivatives of coordinates with it."""
        if text.strip() == "rest":
            return self.at_rest
        found = []
        for part in text.split(","):
            relation = self.read(part.strip())
            found.append(relation)
            if not relation.free_symbols & {*self.v}:
                found.append(sum(sp.diff(relation, q) * v for q, v in zip(self.q, self.v, strict=True)))
        return found

    def distances(self, sets: Sequence[Sequence[sp.Expr]], states: np.ndarray) -> np.ndarray:
        """Return how far states (rows, 2 n) are from the nearest of sets (rows,)."""
        return np.min([np.max(np.abs(self.values(one, states)), axis=1, initial=0.0) for one in sets], axis=0)

    def mismatch(self) -> str:
        """Return where simulation contradicts the truth that the entry states; '' where nowhere."""
        entry, n = self.entry, len(self.q)
        if entry.duration == 0.0:
            return ""
        for path in self.motions:
            size = float(np.max(np.abs(path[0])))
            late = path[-len(path) // 10 :]
            if entry.truth not in {BOUNDED, NONE}:
                left = float(np.max(self.distances(self.limits, late)))
                if not left <= entry.near * max(size, entry.size):
                    return f"{left:.3g} away at the end, from {path[0]}"
            elif entry.truth == BOUNDED and (len(path) < ROWS or np.max(np.abs(path[:, n:])) > 100 * size):
                return f"grows from {path[0]}"
        if entry.start:
            path = self.motions[-1]
            fast = float(np.max(np.abs(path[-len(path) // 10 :, n:])))
            scale = max(entry.start) if any(entry.start) else 1.0
            if len(path) == ROWS and fast < 0.03 * scale and np.max(np.abs(path[-1])) < 3 * scale:
                return f"comes to rest from {entry.start}"
        return ""

    def gain(self) -> float:
        """Return the largest gain of energy along the motions, of the largest energy."""
        most = 0.0
        for whole in self.motions:
            path = whole[np.max(np.abs(whole), axis=1) < 10.0 * max(1.0, float(np.max(np.abs(whole[0]))))]
            energy = self.values([self.energy], path)[:, 0]
            rise = energy - np.minimum.accumulate(energy)
            most = max(most, float(np.max(rise)) / max(float(np.max(np.abs(energy))), 1e-12))
        return most

    def eigenvalues(self, position: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """Return the eigenvalues and eigenvectors of the model linearised at rest."""
        n = len(self.q)
        at = dict(zip(self.q, position, strict=True)) | dict.fromkeys(self.v, 0)
        lower = np.array(sp.Matrix(self.accelerations).jacobian([*self.q, *self.v]).subs(at).evalf(), dtype=float)
        return np.linalg.eig(np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), lower]))

    def rests(self) -> Iterator[np.ndarray]:
        """Return equilibria that Newton's method finds from many places, each alone in its place."""
        still = dict.fromkeys(self.v, 0)
        f = sp.lambdify([[*self.q]], [a.subs(still) for a in self.accelerations], "numpy")
        rng = np.random.default_rng(2)
        for guess in 3.0 * rng.uniform(-1.0, 1.0, (40, len(self.q))):
            found = root(lambda x: np.array(f(x), dtype=float), guess, method="hybr", tol=1e-13)
            if not found.success or np.max(np.abs(found.fun)) > 1e-11:
                continue
            steps = 1e-6 * np.eye(len(self.q))
            slopes = np.array([np.array(f(found.x + h)) - np.array(f(found.x - h)) for h in steps])
            if np.linalg.cond(slopes) < 1e4:
                yield found.x


def _linear(matrix: np.ndarray, state: np.ndarray, step: float) -> np.ndarray:
    """Return a motion of y' = A y with y = (q, v, 1), exactly; fewer rows where it leaves the numbers."""
    ahead, rows = expm(step * matrix), [np.array([*state, 1.0])]
    while len(rows) < ROWS and np.max(np.abs(rows[-1])) < LARGEST:
        rows.append(ahead @ rows[-1])
    return np.array(rows)[:, :-1]


def _by_small_steps(rate, state: np.ndarray, duration: float) -> np.ndarray:
    """Return a motion under forces that jump, by the method of Runge and Kutta of order 4."""
    step, rows = 2e-3, [state]
    count = round(duration / step)
    for k in range(count):
        a = rate(0.0, state)
        b = rate(0.0, state + 0.5 * step * a)
        c = rate(0.0, state + 0.5 * step * b)
        d = rate(0.0, state + step * c)
        state = state + step * (a + 2 * b + 2 * c + d) / 6
        if (k + 1) * (ROWS - 1) // count > k * (ROWS - 1) // count:
            rows.append(state)
    return np.array(rows)
