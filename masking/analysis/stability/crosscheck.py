"""Cross-check of a certificate: modes of a linear model, and simulated motions.

It proves nothing: it can only contradict a proof, which is then withdrawn. A motion contradicts it that gains energy,
on a box before it leaves that, or that keeps to V' = 0 although it moves outside of the largest invariant set found
there; eigenvalues contradict what is said of an equilibrium.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import mpmath
import numpy as np
import sympy as sp
from scipy.integrate import solve_ivp

from masking.analysis.stability.dissipation import along, default_box
from masking.analysis.stability.equilibria import STABLE, UNSTABLE, Box, stability_of
from masking.analysis.stability.free_equations import Motion
from masking.analysis.stability.lasalle import InvariantSet
from masking.analysis.stability.modes import state_matrix
from masking.compile.codegen.graph import Graph
from masking.compile.numerics.arrays import Array
from masking.errors import ModelError
from masking.model.modelling.model import Model

_NEUTRAL = 1e-12  # of the largest eigenvalue: a real part below this is the rounding of one that is 0
_DIGITS = 60  # of exact eigenvalues
_DECAY = 1e-20  # of the largest: a mode that decays has a real part below minus this
_OUTSIDE = 1e-6  # of the largest amplitude: further from a relation than this, a mode is outside of a set
_RADIANS = 20.0  # of the fastest mode: duration of a simulation
_ROWS = 41
_RANDOM = 4  # initial states
_RANDOM_ON_BOX = 16  # many leave it at once
_MOST_RATES = 4000  # evaluations of the rates, after which a motion is too stiff to be followed
_GAIN = 1e-5  # of the largest kinetic energy: far more than the integration errs by
_STILL = 1e-6  # of the largest speed: forms below this are 0
_MOVING = 1e-2  # of the initial motion


class _StiffError(Exception):
    """A motion takes too many steps, or leaves the numbers."""


def misjudged(model: Model, points: Iterable[tuple[Mapping[str, float], str]]) -> str:
    """Equilibrium, of positions and what is said of them, whose eigenvalues contradict that; '' where there is none."""
    for position, words in points:
        opposite = STABLE if words.startswith(UNSTABLE) else UNSTABLE if "stable" in words.split(",")[0].split() else ""
        if opposite and stability_of(model, position)[1] == opposite:
            where = ", ".join(f"{n} = {x:.6g}" for n, x in position.items())
            return f"({where}) is {opposite} by its eigenvalues"
    return ""


def contradiction(
    motion: Motion,
    forms: Sequence[sp.Expr] = (),
    found: InvariantSet | None = None,
    *,
    is_bounded: bool = False,
    box: Box | None = None,
) -> str:
    """Sentence that contradicts a proof that energy does not grow, before motion leaves a box; '' where nothing does.

    V' is 0 where the forms, linear in the velocities, are; `found` is the largest invariant set there, None where it
    was not looked for.
    """
    found = found if found is not None and found.is_found else None
    try:
        matrix = state_matrix(motion.model)
    except ModelError:  # at a kink, or where an operation has no slope
        matrix = np.zeros((2 * len(motion.q),) * 2)
    matrix = matrix if np.all(np.isfinite(matrix)) else np.zeros_like(matrix)
    values, vectors = np.linalg.eig(matrix)
    slack = _NEUTRAL * float(np.max(np.abs(values), initial=0.0))
    if motion.is_linear and found is not None:
        relations = [r for family in found.families for r in family.relations]
        rows = [[float(motion.given.at_values(sp.diff(r, x))) for x in (*motion.q, *motion.v)] for r in relations]
        slopes = np.array(rows).reshape(len(relations), 2 * len(motion.q))
        slopes /= np.maximum(np.max(np.abs(slopes), axis=1, keepdims=True, initial=0.0), 1e-300)
        for value, vector in zip(values, vectors.T, strict=True):
            stays = value.real >= -slack and (is_bounded or value.real <= slack)
            is_outside = np.max(np.abs(slopes @ vector), initial=0.0) > _OUTSIDE * np.max(np.abs(vector))
            if stays and is_outside and not (value.real <= slack and _decays(motion, value)):
                return (
                    f"a mode of frequency {abs(value.imag):.6g} does not decay (eigenvalue {value:.4g}) and is outside "
                    "of this set"
                )
    neutral = [vectors[:, i] for i in range(len(values)) if abs(values[i].real) <= slack < values[i].imag]
    try:
        return _Motions(motion, forms, found, box).contradiction(neutral if box is None else ())
    except ModelError:  # a function that cannot be evaluated
        return ""


def _decays(motion: Motion, near: complex) -> bool:
    """Whether the eigenvalue of a linear motion nearest to a number has a negative real part, at the exact values."""
    state = (*motion.q, *motion.v)
    slopes = sp.Matrix([*motion.v, *motion.accelerations]).jacobian(state)
    with mpmath.workdps(_DIGITS):
        exact = slopes.applyfunc(lambda x: sp.N(motion.given.at_values(x), _DIGITS))
        values, _ = mpmath.eig(mpmath.matrix(exact.tolist()))
        found = min(values, key=lambda x: abs(x - mpmath.mpmathify(near)))
        return bool(found.real < -_DECAY * max(abs(x) for x in values))


class _Motions:
    """Simulated motions of a model, its energy along them, and what is 0 on the invariant set."""

    def __init__(self, motion: Motion, forms: Sequence[sp.Expr], found: InvariantSet | None, box: Box | None) -> None:
        self.motion, self.forms, self.found, graph = motion, forms, found, Graph()
        state = (*motion.q, *motion.v)
        symbols, values = motion.on(graph, state)
        at = [symbols[x] for x in state]
        energy = motion.energy or sp.Integer(0)
        watched = [energy, energy - energy.subs(dict.fromkeys(motion.v, 0)), *forms]
        self.families = [[*f.relations] for f in found.families] if found else []
        watched += [r for family in self.families for r in family]
        rates, seen = ([graph.lower(x, symbols) for x in some] for some in (motion.accelerations, watched))
        self.rates, self.watched = (along(graph, nodes, at, values) for nodes in (rates, seen))
        self.is_box, sides = box is not None, default_box(motion, box or {})
        self.low, self.high = (np.array([sides[x.name][k] for x in state]) for k in (0, 1))

    def contradiction(self, neutral: Sequence[Array]) -> str:
        """Contradiction by motions from states of neutral modes (2 n,) and random ones; '' for none."""
        n, size = len(self.motion.q), float(np.max(self.high[: len(self.motion.q)], initial=0.0))
        starts = []
        for shape in neutral:
            largest = shape[np.argmax(np.abs(shape[:n]))]
            if largest != 0.0:
                starts.append(0.5 * size * (shape / largest).real)
        part, count = (1.0, _RANDOM_ON_BOX) if self.is_box else (0.5, _RANDOM)
        starts += list(np.random.default_rng(0).uniform(part * self.low, part * self.high, (count, 2 * n)))
        for start in starts:
            try:
                path = self._run(start)
            except _StiffError:
                continue
            if self.is_box:
                outside = np.any((path < self.low) | (path > self.high), axis=1)
                path = path[: int(np.argmax(outside)) if np.any(outside) else len(path)]
            if words := self._words(path):
                where = zip((*self.motion.q, *self.motion.v), start, strict=True)
                return f"the simulated motion from {', '.join(f'{x} = {y:.4g}' for x, y in where)} {words}"
        return ""

    def _words(self, path: Array) -> str:
        n, count = len(self.motion.q), len(self.forms)
        energy, kinetic, *rest = (np.broadcast_to(x, len(path)) for x in self.watched(path))
        gain, most = float(np.max(energy - np.minimum.accumulate(energy))), float(np.max(np.abs(kinetic)))
        if gain > _GAIN * most > 0.0:
            return f"gains energy: V rises by {gain:.3g}"
        speed = np.max(np.abs(path[:, n:]), axis=1)
        if self.found is None or not count or speed[-_ROWS // 4 :].max() <= _MOVING * speed.max():
            return ""
        if max(float(np.max(np.abs(form))) for form in rest[:count]) > _STILL * speed.max():
            return ""
        relations, size = iter(rest[count:]), float(np.max(np.abs(path)))
        away = [max(float(np.max(np.abs(next(relations)))) for _ in family) for family in self.families]
        return "keeps its energy outside of this set" if all(x > _MOVING * size for x in away) else ""

    def _run(self, start: Array) -> Array:
        """States (rows, 2 n) of one motion."""
        n, count = len(self.motion.q), 0

        def rate(_: float, y: Array) -> Array:
            nonlocal count
            count += 1
            found = np.concatenate([y[n:], self.rates(y)])
            if count > _MOST_RATES or not np.all(np.isfinite(found)):
                raise _StiffError
            return found

        fast = float(np.max(self.high[n:])) / max(float(np.max(self.high[:n])), 1e-300)
        times = np.linspace(0.0, _RADIANS / fast, _ROWS)
        scale = 1e-12 * float(np.max(np.abs(start)))
        run = solve_ivp(rate, (0.0, times[-1]), start, "DOP853", t_eval=times, rtol=1e-9, atol=scale)
        if not run.success:
            raise _StiffError
        return np.asarray(run.y.T)
