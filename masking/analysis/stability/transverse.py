"""Transverse stability of a synchronisation manifold: whether motion near it comes nearer to it.

The manifold is a linear set of states, such as x1 + x2 = 0 with the beam at rest. Variations across it evolve by
themselves, Psi = N^T Phi N with orthonormal N across the manifold, and grow like e^(lambda t): the transverse Lyapunov
exponents. Source: Pecora and Carroll (1998), Physical Review Letters 80, 2109; Benettin and others (1980), Meccanica
15, 9.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from masking.analysis.stability.modes import pair_of
from masking.analysis.stability.variational_equations import Variational
from masking.compile.numerics.arrays import Array
from masking.errors import ModelError
from masking.model.modelling.model import Model

_LEAVES = 1e-9  # relative: rates across the manifold beyond this show that it is not invariant
_SAMPLES = 16


@dataclass(frozen=True)
class Transverse:
    """Transverse Lyapunov exponents."""

    exponents: Array  # largest first, in 1/s or per unit of time; the manifold attracts where all are below 0
    spread: float  # by how much the largest is another over the last half of the time: how well it has converged
    duration: float  # that was averaged over


def anti_phase(model: Model) -> Array:
    """Forms that vanish in anti-phase: the sum of two oscillators, and every other coordinate (k, n)."""
    first, second = (model.coordinates.index(c) for c in pair_of(model))
    rows = np.eye(len(model.coordinates))
    rows[first, second] = 1.0
    return np.delete(rows, second, axis=0)


def in_phase(model: Model) -> Array:
    """Form that vanishes in phase: the difference of two oscillators (1, n)."""
    first, second = (model.coordinates.index(c) for c in pair_of(model))
    rows = np.eye(len(model.coordinates))
    return rows[[first]] - rows[[second]]


def transverse(
    model: Model,
    forms: Array,
    initial: Mapping[str, float] | None = None,
    *,
    duration: float = 500.0,
    pieces: int = 100,
    tolerance: float = 1e-11,
) -> Transverse:
    """Transverse Lyapunov exponents of a manifold along a motion on it.

    Args:
        model: without internal states, in SI units or in its scales.
        forms: linear forms of the coordinates that vanish on the manifold (k, n), such as `anti_phase(model)`.
        initial: of the motion, in declared units; what is not on the manifold is taken off.
        duration: of the motion, in units of the model's time.
        pieces: parts after each of which variations are made orthonormal again.
        tolerance: local relative error of integration.

    Raises:
        ModelError: the manifold is not invariant, or the model has internal states.
        IntegrationError: the integrator could not go on.
    """
    if model.states:
        raise ModelError(f"{model.name} has internal states; transverse exponents are for models without")
    n, rows = len(model.coordinates), np.atleast_2d(np.asarray(forms, dtype=float))
    if rows.ndim != 2 or rows.shape[1] != n:
        raise ModelError(f"forms of {n} coordinates have {n} columns; got shape {rows.shape}")
    across, _ = np.linalg.qr(np.kron(np.eye(2), rows).T)
    along = np.eye(2 * n) - across @ across.T
    y = along @ model.initial_state(initial or {})
    _check_invariant(model, along, across, y)
    made, step = Variational(model), duration / pieces
    frame, logs = np.eye(across.shape[1]), []
    for piece in range(pieces):
        y, phi = made.flow(y, step, tolerance, begin=piece * step)
        y = along @ y
        frame, grown = orthonormal(across.T @ phi @ across @ frame)
        logs.append(grown)
    exponents, spread = mean_growth(np.array(logs), step)
    return Transverse(exponents, spread, duration)


def orthonormal(columns: Array) -> tuple[Array, Array]:
    """Orthonormal directions of small motions (r, k), and the logarithms of their lengths across each other (k,)."""
    frame, upper = np.linalg.qr(columns)
    return frame, np.log(np.maximum(np.abs(np.diag(upper)), np.finfo(float).tiny))


def mean_growth(logs: Array, step: float) -> tuple[Array, float]:
    """Mean growths of small motions (k,), the largest first, and by how much the largest is another over the last half.

    They are made orthonormal after each step; `logs` are the logarithms of their lengths before that (pieces, k).
    """
    pieces = len(logs)
    # Slopes of the sums over time, after the frame has turned towards the fastest growth: turns of complex pairs, which
    # a mean keeps until they have been averaged away, hardly touch them.
    sums, times = np.cumsum(logs, axis=0), np.asarray(step * np.arange(1, pieces + 1), dtype=np.float64)
    order = np.argsort(-_slopes(times, sums, pieces // 5))
    exponents, late = (_slopes(times, sums, first)[order] for first in (pieces // 5, pieces // 2))
    return exponents, float(abs(exponents[0] - late[0]))


def _slopes(times: Array, sums: Array, first: int) -> Array:
    """Slope of each column (k,) from a piece on, by least squares."""
    centred = times[first:] - np.mean(times[first:])
    return np.asarray(centred @ sums[first:] / (centred @ centred), dtype=float)


def _check_invariant(model: Model, along: Array, across: Array, state: Array) -> None:
    """Refuse a manifold that motion leaves: rates across it at states on it."""
    rng = np.random.default_rng(0)
    size, rate = float(np.max(np.abs(state))) or 1.0, np.empty(len(state))
    for _ in range(_SAMPLES):
        at = along @ (size * rng.uniform(-1.0, 1.0, len(state)))
        model.kernels.derivative(0.0, at, np.zeros(len(model.inputs)), model.values(), rate)
        if np.max(np.abs(across.T @ rate)) > _LEAVES * max(float(np.max(np.abs(rate))), 1e-300):
            raise ModelError(
                f"{model.name}: motion leaves this manifold, it is not invariant: the oscillators are not alike, or "
                "another coordinate must vanish, too"
            )
