"""A certificate beside the truth: whether it is wrong, and how much of the truth it proves."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
import sympy as sp

from masking.analysis.stability.energy_certificate import Certificate
from tests.benchmarks.certificates.entry import BOUNDED, NONE
from tests.benchmarks.certificates.truth import ROWS, Truth

STAYS = 0.5  # of the distance at first: a motion that is as far at the end does not converge

FAR = 1e4  # of the initial size: a motion that is this far is not bounded


def claimed(found: Certificate, truth: Truth) -> list[list[sp.Expr]]:
    """Return the sets that a certificate says motions converge to; none where it says nothing."""
    if found.status != "proved" or " converges to " not in found.conclusion:
        return []
    families = [[truth.read(str(r)) for r in family.relations] for family in found.invariant.families]
    sets = [[_modulo_turns(relation, truth) for relation in family] for family in families]
    if found.others is None:
        return [*sets, truth.at_rest]
    for point in found.others:
        position = [_difference(q, _place(point.position, q, truth), truth) for q in truth.q]
        sets.append([*position, *truth.v])
    return sets


def _modulo_turns(relation: sp.Expr, truth: Truth) -> sp.Expr:
    """Return a relation of angles modulo one turn; others as they are."""
    names = [s.name for s in relation.free_symbols]
    return 2 * sp.sin(relation / 2) if all(truth.entry.units.get(name) == "rad" for name in names) else relation


def _place(position: Mapping[str, str], q: sp.Symbol, truth: Truth) -> sp.Expr:
    """Return where an equilibrium is, without its unit."""
    return truth.read(position[q.name].removesuffix(f" {truth.entry.units.get(q.name, '')}"))


def _difference(q: sp.Symbol, value: sp.Expr, truth: Truth) -> sp.Expr:
    """Return how far an angle or a length is from its value."""
    return 2 * sp.sin((q - value) / 2) if truth.entry.units.get(q.name) == "rad" else q - value


def wrong(found: Certificate, truth: Truth) -> str:
    """Return what is not so in a certificate; '' where simulations, eigenvalues and Newton's method find nothing."""
    if found.status == "refuted":
        return _wrong_growth(found, truth)
    if found.status != "proved":
        return ""
    if found.dissipation.box is None and truth.gain() > (1e-2 if truth.entry.is_rough else 1e-5):
        return f"the energy grows by {truth.gain():.3g}"
    everywhere = found.boundedness.is_shown and found.dissipation.box is None
    n = len(truth.q)
    for path in truth.motions if everywhere else ():
        lines = [i for i, q in enumerate(truth.q) if truth.entry.units.get(q.name) != "rad"]
        if len(path) < ROWS or np.max(np.abs(path[:, [*lines, *range(n, 2 * n)]])) > FAR * max(
            1.0, np.max(np.abs(path[0]))
        ):
            return f"a motion from {path[0]} is not bounded"
    return _wrong_sets(found, truth) or _wrong_points(found, truth)


def _wrong_growth(found: Certificate, truth: Truth) -> str:
    state = {x: found.dissipation.counterexample[str(x).replace("_v", "'")] for x in (*truth.q, *truth.v)}
    rate = sum(sp.diff(truth.energy, q) * v for q, v in zip(truth.q, truth.v, strict=True))
    rate += sum(sp.diff(truth.energy, v) * a for v, a in zip(truth.v, truth.accelerations, strict=True))
    at = {x: sp.Rational(str(value)) for x, value in state.items()}
    return "" if rate.subs(at) > 0 else f"V' = {rate.subs(at)} at {state}"


def _wrong_sets(found: Certificate, truth: Truth) -> str:
    sets = claimed(found, truth)
    n, is_every = len(truth.q), found.boundedness.is_shown
    if "no motion is bounded" in found.conclusion:
        still = [path[0] for path in truth.motions if len(path) == ROWS and _is_bounded(path, n)]
        return f"motion from {still[0]} is bounded" if still else ""
    if not sets or truth.entry.duration == 0.0:
        return ""
    for path in truth.motions:
        if not is_every and not (len(path) == ROWS and _is_bounded(path, n)):
            continue
        distance = truth.distances(sets, path)
        first, last = float(np.max(distance[: ROWS // 10])), float(np.max(distance[-ROWS // 10 :]))
        size = max(truth.entry.size, float(np.max(np.abs(path[0]))))
        if last > (2 * truth.entry.near * size if truth.limits else max(STAYS * first, 1e-6)):
            return f"a motion from {path[0]} stays {last:.3g} away from what it is said to converge to"
    return _wrong_modes(sets, truth, is_every)


def _wrong_modes(sets: list[list[sp.Expr]], truth: Truth, is_every: bool) -> str:
    """Compare with the eigenvalues of a linear model."""
    state = [*truth.q, *truth.v]
    slopes = sp.Matrix(truth.accelerations).jacobian(state)
    if slopes.free_symbols or len(sets) != 1 or any(a.subs(dict.fromkeys(state, 0)) != 0 for a in truth.accelerations):
        return ""
    values, vectors = truth.eigenvalues([0] * len(truth.q))
    forms = np.array(sp.Matrix(sets[0]).jacobian(state).evalf(), dtype=float)
    forms /= np.max(np.abs(forms), axis=1, keepdims=True)
    slack = 1e-11 * float(np.max(np.abs(values)))
    for value, vector in zip(values, vectors.T, strict=True):
        stays = abs(value.real) <= slack or (is_every and value.real > slack)
        is_still = abs(value) <= 1e-7 * float(np.max(np.abs(values)))  # several zeros move apart by rounding
        if stays and not is_still and np.max(np.abs(forms @ vector)) > 1e-6 * np.max(np.abs(vector)):
            return f"the mode {value:.6g} does not decay and is outside of the set"
    return ""


def _is_bounded(path: np.ndarray, n: int) -> bool:
    half = len(path) // 2
    return bool(np.max(np.abs(path[half:, :n])) <= 1.2 * np.max(np.abs(path[:half, :n])))


def _wrong_points(found: Certificate, truth: Truth) -> str:
    """Compare equilibria with eigenvalues, and a complete list with what Newton's method finds."""
    for point in found.others or ():
        at = [_place(point.position, q, truth) for q in truth.q]
        largest = float(np.max(truth.eigenvalues(at)[0].real))
        says = re.match(r"(asymptotically stable|stable|unstable)?", point.stability)[1]
        if (says == "unstable" and largest < 1e-9) or (says and says != "unstable" and largest > 1e-7):
            return f"{point}: the largest real part of an eigenvalue is {largest:.3g}"
    sets = claimed(found, truth)
    if not sets or found.others is None:
        return ""
    for at in truth.rests():
        state = np.concatenate([at, np.zeros(len(at))])[None]
        if truth.distances(sets, state)[0] > 1e-4:
            return f"the equilibrium {at} is in none of the sets"
    return ""


def proved(found: Certificate, truth: Truth) -> str:
    """Say how much of the truth a certificate proves: all, less, nothing; 'none' where there is nothing to prove."""
    if truth.entry.truth == NONE:
        return "none"
    if found.status != "proved":
        return "nothing"
    is_every = found.boundedness.is_shown and found.dissipation.box is None
    if truth.entry.truth == BOUNDED:
        return "all" if is_every else "less"
    sets = claimed(found, truth)
    if not sets or not (is_every or found.conclusion.startswith("every motion converges")):
        return "less"
    if found.others is None and "rest" not in truth.entry.truth:
        return "less"
    return "all" if max(_free(s, truth) for s in sets) <= max(_free(s, truth) for s in truth.limits) else "less"


def _free(one: list[sp.Expr], truth: Truth) -> int:
    """Return how many dimensions a set has."""
    state = [*truth.q, *truth.v]
    if one == truth.at_rest:
        return 0
    at = {x: sp.Rational(k + 3, 7) for k, x in enumerate(state)}
    slopes = np.array(sp.Matrix(one).jacobian(state).subs(at).evalf(), dtype=float)
    return len(state) - int(np.linalg.matrix_rank(slopes, tol=1e-9))
