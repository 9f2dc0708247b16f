"""Relative degree: the derivative of each virtual coordinate in which the inputs of a rig first appear.

A force shows in the second derivative. An input that acts through dynamics of its own, such as the inductance of a coil
or the oil of a cylinder, or through other coordinates of the rig, shows in a higher one.
Source: Isidori (1995), Nonlinear Control Systems, sections 4.1 and 5.1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.graph_values import ARRAYS, function_of
from masking.compile.codegen.tangent import along, copied, derivatives
from masking.compile.numerics.arrays import Array
from masking.control.transform import Transform
from masking.errors import ActuationError, ModelError
from masking.lazy_imports import sympy as sp
from masking.model.modelling.lowering import LoweredEquations
from masking.model.modelling.model import Model

SEEN = 1e-9  # of the largest slope by an input: smaller ones are rounding
POINTS = 5  # random states and parameters at which slopes are looked at


class Derivatives:
    """Derivatives of virtual coordinates along the motion of a rig, in a graph of their own.

    Args:
        model: of the rig, affine in its inputs.
        transform: the virtual coordinates by those of the rig.
    """

    def __init__(self, model: Model, transform: Transform) -> None:
        self.graph = graph = Graph()
        s = model.equations.symbols

        def made(kind: str, names: Sequence[object]) -> list[Node]:
            return [graph.symbol(f"{kind}_{name}", varying=True) for name in names]

        (t,), q, v, z = made("t", [s.t]), made("q", s.q), made("v", s.v), made("z", s.s)
        self.states = [*q, *v, *z]
        p, own, lengths, u = (
            made(kind, names) for kind, names in (("p", s.p), ("o", transform.parameters), ("l", s.q), ("u", s.u))
        )
        unmodelled, changing = made("d", s.q), made("e", s.q)  # accelerations that the model lacks
        self.symbols = [t, *q, *v, *z, *p, *own, *lengths, *unmodelled, *changing]
        placed, moving = ([graph.div(x, length) for x, length in zip(xs, lengths, strict=True)] for xs in (q, v))
        known = dict(zip((s.t, *s.q, *s.v, *s.s, *s.p), (t, *q, *v, *z, *p), strict=True))
        free, driven = (
            LoweredEquations.of(model.equations, graph, known={**known, **dict(zip(s.u, given, strict=True))})
            for given in ([graph.number(0.0)] * len(u), u)
        )
        accelerations = [graph.add(a, d) for a, d in zip(free.accelerations, unmodelled, strict=True)]
        rates = (graph.number(1.0), *v, *accelerations, *free.rates, *changing)
        self._drift: Mapping[Node, Node] = dict(zip((t, *q, *v, *z, *unmodelled), rates, strict=True))
        slopes = derivatives(graph, [*driven.accelerations, *driven.rates], u)
        self._pushes = [dict(zip((*v, *z), column, strict=True)) for column in zip(*slopes, strict=True)]
        mapped = transform.lower(graph, placed, moving, own)
        self._known = [mapped.eta, mapped.rate]

    def of_order(self, order: int) -> list[Node]:
        """Derivatives of an order of the virtual coordinates without inputs (k,); of order 0, they themselves."""
        while len(self._known) <= order:
            self._known.append(along(self.graph, self._known[-1], self._drift))
        return self._known[order]

    def by_inputs(self, order: int) -> list[list[Node]]:
        """What a unit of each input adds to the derivatives of an order, at least 2 (k, inputs)."""
        before = self.of_order(order - 1)
        columns = [along(self.graph, before, push) for push in self._pushes]
        return [[column[i] for column in columns] for i in range(len(before))]

    def within(self, graph: Graph, nodes: Sequence[Node], values: Sequence[Node]) -> list[Node]:
        """Nodes of another graph, in which the symbols have values."""
        return copied(self.graph, nodes, self.symbols, graph, values)

    def determined(self, degrees: Sequence[int]) -> list[Node]:
        """Virtual coordinates and their derivatives that the inputs do not change at once, one coordinate at a time."""
        return [self.of_order(order)[i] for i, degree in enumerate(degrees) for order in range(degree)]

    def slopes(self, order: int) -> Array:
        """Derivatives of an order by the inputs at random states and parameters (points, k, inputs)."""
        return self.at_random(self.by_inputs(order))

    def at_random(self, rows: Sequence[Sequence[Node]]) -> Array:
        """Values of a matrix of nodes at random states and parameters (points, rows, columns)."""
        points = np.random.default_rng(0).uniform(0.5, 1.5, (len(self.symbols), POINTS))
        made = function_of(self.graph, [x for row in rows for x in row], {}, ARRAYS, "value", variables=self.symbols)
        with np.errstate(all="ignore"):
            found = [np.broadcast_to(np.asarray(x, dtype=float), POINTS) for x in made(points)]
        return np.moveaxis(np.array(found).reshape(len(rows), -1, POINTS), 2, 0)


def relative_degrees(model: Model, transform: Transform) -> tuple[int, ...]:
    """Derivative of each virtual coordinate in which an input appears first, where the inputs drive each by itself.

    The slopes by the inputs are taken at random states and parameters, where their rank is as large as it can be.
    Coordinates that no virtual one stands for stay as the rig has them, and need no input.

    Raises:
        ActuationError: the inputs do not; it names the virtual coordinates that cannot be masked.
        ModelError: the transform is not invertible, or an input acts by more than one curve.
    """
    _check_invertible(model, transform)
    model = model.affine
    known = Derivatives(model, transform)
    direct, many = known.slopes(2), len(transform.virtual.coordinates)
    if _rank(direct) == many:
        return (2,) * many
    degrees, slopes = [math.inf] * many, np.zeros_like(direct)
    for order in range(2, len(model.coordinates) * 2 + len(model.states) + 1):
        found = known.slopes(order) if order > 2 else direct
        for i, row in enumerate(np.moveaxis(found, 1, 0)):
            if math.isinf(degrees[i]) and np.nanmax(np.abs(row), initial=0.0) > SEEN:
                degrees[i], slopes[:, i] = order, row
        if not any(map(math.isinf, degrees)):
            break
    if any(map(math.isinf, degrees)) or _rank(slopes) < many:
        raise _refused(model, transform, direct, degrees)
    return tuple(map(int, degrees))


def remainder(model: Model, transform: Transform, degrees: Sequence[int]) -> tuple[int, ...]:
    """Where states of a rig [q, v, s] that its virtual coordinates do not determine are among them, by their degrees.

    Where the inputs act on each acceleration at once, they are the coordinates that no virtual one stands for, and
    their velocities. Else they are, of these, of internal states and of others, as many as determine the state.
    """
    n, passive = len(model.coordinates), transform.passive
    if max(degrees, default=2) == 2:
        return (*passive, *(n + i for i in passive))
    known = Derivatives(model.affine, transform)
    slopes = known.at_random(derivatives(known.graph, known.determined(degrees), known.states))
    size = slopes.shape[2]
    pairs = [(i, n + i) for i in passive]
    found = list[int]()
    for more in (*pairs, *((i,) for i in (*range(2 * n, size), *range(2 * n)))):
        rows = np.eye(size)[[*found, *more]]
        if _rank(np.array([np.concatenate([one, rows]) for one in slopes])) == slopes.shape[1] + len(rows):
            found += more
    return tuple(sorted(found))


def _numbers(matrix: sp.Matrix, model: Model, transform: Transform) -> Array:
    """Matrix at a random state and random parameters."""
    s, generator = model.equations.symbols, np.random.default_rng(0)
    symbols = (s.t, *s.q, *s.v, *s.s, *s.p, *transform.parameter_symbols)
    point = dict(zip(symbols, map(sp.Float, generator.uniform(0.5, 1.5, len(symbols))), strict=True))
    return np.array([0.0 if x == 0 else float(x.xreplace(point)) for x in matrix]).reshape(matrix.shape)


def _check_invertible(model: Model, transform: Transform) -> None:
    slope = _numbers(transform.jacobian, model, transform)
    if np.linalg.matrix_rank(slope) < len(slope):
        unused = [c for c, column in zip(model.coordinates, slope.T, strict=True) if not column.any()]
        is_square = len(slope) == len(model.coordinates)
        why = f"none depends on {', '.join(unused)}" if unused and is_square else "they depend on each other"
        raise ModelError(
            f"transform: not invertible: {', '.join(transform.virtual.coordinates)} do not move independently of each "
            f"other with the rig's coordinates; {why}"
        )


def _rank(slopes: Array) -> int:
    """Largest rank of finite slopes at some points (points, k, inputs)."""
    finite = [one for one in slopes if np.isfinite(one).all()]
    return max((int(np.linalg.matrix_rank(one)) for one in finite if one.size), default=0)


def _refused(model: Model, transform: Transform, direct: Array, degrees: Sequence[float]) -> ActuationError:
    names, have = transform.virtual.coordinates, ", ".join(model.inputs) or "none"
    at = next((one for one in direct if np.isfinite(one).all()), np.zeros(direct.shape[1:]))
    reachable = at @ np.linalg.pinv(at) if at.size else np.zeros((len(names),) * 2)
    missed = [name for i, name in enumerate(names) if abs(reachable[i, i] - 1.0) > SEEN]
    forced = _numbers(transform.jacobian * model.equations.input_force, model, transform)
    left = _undriven(at, forced)
    first = dict[float, list[str]]()
    for name, degree in zip(names, degrees, strict=True):
        first.setdefault(degree, []).append(name)
    never = first.pop(math.inf, [])
    parts = [f"in derivative {r:.0f} of {', '.join(n)}" for r, n in sorted(first.items())]
    appears = f". An input appears first {', '.join(parts)}" if parts else ""
    appears += f"{'; no' if parts else '. No'} input ever appears in {', '.join(never)}" if never else ""
    if not any(map(math.isinf, degrees)) and len(have.split(", ")) >= len(names):
        soon = next(name for name, column in zip(model.inputs, at.T, strict=True) if column.any())
        appears += (
            f"; integrators before {soon} may let the others appear: declare {soon} as an internal state of the model, "
            "and its rate, or the rate of that, as the input"
        )
    return ActuationError(
        f"{model.name} cannot be masked as {transform.virtual.name}: its inputs ({have}) cannot accelerate "
        f"{', '.join(missed)} independently of the other coordinates, {len(names) - len(left)} of {len(names)} at "
        f"most; add actuators, or leave {', '.join(names[i] for i in left)} out of the virtual system: what it "
        f"does not name is passive and moves as the rig lets it{appears}",
        missed,
    )


def _undriven(direct: Array, forced: Array) -> list[int]:
    """Fewest virtual coordinates without which the others can be driven; such as no input acts on directly.

    `direct` are accelerations of the virtual coordinates by the inputs, `forced` forces on them (k, inputs).
    """
    if not direct.size:
        return list(range(len(direct)))
    driven = list[int]()
    for i in sorted(range(len(direct)), key=lambda i: not forced[i].any()):
        if np.linalg.matrix_rank(direct[[*driven, i]]) > len(driven):
            driven.append(i)
    return [i for i in range(len(direct)) if i not in driven]
