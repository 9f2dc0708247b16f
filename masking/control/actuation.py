"""Whether the inputs of a rig can accelerate each virtual coordinate by itself, and which of them they cannot."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from masking.control.blocks import Transform
from masking.errors import ActuationError, ModelError
from masking.lazy_imports import sympy as sp
from masking.model.modelling.model import Model


def check_actuation(model: Model, transform: Transform) -> None:
    """Refuse a rig whose inputs cannot accelerate each virtual coordinate independently of the others.

    The rank of W = J B is taken at random states and parameters, where it is as large as it can be. Coordinates that no
    virtual one stands for stay as the rig has them, and need no input. An ActuationError names the virtual coordinates
    that cannot be masked; a ModelError where the transform is not invertible.
    """
    s = model.equations.symbols
    generator = np.random.default_rng(0)
    symbols = (s.t, *s.q, *s.v, *s.s, *s.p, *transform.parameter_symbols)
    point = dict(zip(symbols, map(sp.Float, generator.uniform(0.5, 1.5, len(symbols))), strict=True))

    def number(matrix: sp.Matrix) -> np.ndarray:
        return np.array([0.0 if x == 0 else float(x.xreplace(point)) for x in matrix]).reshape(matrix.shape)

    slope = number(transform.jacobian)
    if np.linalg.matrix_rank(slope) < len(slope):
        unused = [c for c, column in zip(model.coordinates, slope.T, strict=True) if not column.any()]
        is_square = len(slope) == len(model.coordinates)
        why = f"none depends on {', '.join(unused)}" if unused and is_square else "they depend on each other"
        raise ModelError(
            f"transform: not invertible: {', '.join(transform.virtual.coordinates)} do not move independently of each "
            f"other with the rig's coordinates; {why}"
        )
    decoupling = slope @ np.linalg.solve(number(model.equations.mass), number(model.equations.input_force))
    reachable = decoupling @ np.linalg.pinv(decoupling) if decoupling.size else np.zeros((len(decoupling),) * 2)
    names = transform.virtual.coordinates
    missed = [name for i, name in enumerate(names) if abs(reachable[i, i] - 1.0) > 1e-8]
    if missed:
        have = ", ".join(model.inputs) or "none"
        pushed = _pushed(model, number(model.equations.mass), point)
        left = _undriven(decoupling, slope @ number(model.equations.input_force))
        raise ActuationError(
            f"{model.name} cannot be masked as {transform.virtual.name}: its inputs ({have}) cannot accelerate "
            f"{', '.join(missed)} independently of the other coordinates, {len(names) - len(left)} of {len(names)} at "
            f"most; add actuators, or leave {', '.join(names[i] for i in left)} out of the virtual system: what it "
            f"does not name is passive and moves as the rig lets it{pushed}",
            missed,
        )


def _pushed(model: Model, mass: np.ndarray, point: Mapping[sp.Symbol, sp.Float]) -> str:
    """Derivative of each rig coordinate in which an input appears first, in words, at a point where all is general.

    An acceleration that an input changes is the second; one that depends on a velocity, or a coordinate, which the
    input changes in its r-th derivative, changes in its next one, or the one after that.
    """
    s, n = model.equations.symbols, len(model.coordinates)
    if not model.inputs:
        return ""

    def depends(symbols: Sequence[sp.Symbol]) -> np.ndarray:
        slopes = [[float(sp.diff(f, x).xreplace(point)) for x in symbols] for f in model.equations.force]
        return np.abs(np.linalg.solve(mass, np.array(slopes))) > 0.0

    with_inputs = dict.fromkeys(s.u, sp.Float(0))
    point = {**point, **with_inputs}
    order = np.where(depends(s.u).any(axis=1), 2.0, np.inf)
    by_place, by_rate = depends(s.q), depends(s.v)
    for _ in range(2 * n):
        through = [np.where(by, order + step, np.inf).min(axis=1) for by, step in ((by_place, 2.0), (by_rate, 1.0))]
        order = np.minimum(order, np.minimum(*through))
    groups: dict[float, list[str]] = {}
    for name, derivative in zip(model.coordinates, order.tolist(), strict=True):
        groups.setdefault(derivative, []).append(name)
    first = [
        f"{'never in' if math.isinf(r) else f'in derivative {r:.0f} of'} {', '.join(n)}"
        for r, n in sorted(groups.items())
    ]
    remedy = f": mask {', '.join(groups[2.0])}, or a combination that contains one of them" if 2.0 in groups else ""
    return f". An input appears first {', '.join(first)}{remedy}"


def _undriven(decoupling: np.ndarray, forced: np.ndarray) -> list[int]:
    """Fewest virtual coordinates without which the others can be driven; such as no input acts on directly.

    `decoupling` are accelerations of the virtual coordinates by the inputs, `forced` forces on them (k, inputs).
    """
    if not decoupling.size:
        return list(range(len(decoupling)))
    driven = list[int]()
    for i in sorted(range(len(decoupling)), key=lambda i: not forced[i].any()):
        if np.linalg.matrix_rank(decoupling[[*driven, i]]) > len(driven):
            driven.append(i)
    return [i for i in range(len(decoupling)) if i not in driven]
