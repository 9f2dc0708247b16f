"""Chattering: a switch that the motion crosses again and again without end, since both sides lead back to it.

A switch is an expression s(t, y) at whose sign an operation jumps. By Filippov's condition the motion slides along
s = 0 where s falls on the side above and grows on the side below; no integrator by steps gets on there. Source:
Filippov, Differential Equations with Discontinuous Righthand Sides (1988), section 4.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np

from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.printers import C, arguments, needed, statements
from masking.compile.numerics.arrays import Array

JUMPS = {"sign", "heaviside", "lt", "le"}  # the others have corners: the motion gets over these
NEAR = 1e-6  # of the time: how long before a switch the motion counts as being there
APART = 1e-6  # of the state, and of its size at the start: by how much the sides of a switch are apart
LONGEST = 60  # characters of a switch in a message
TEXTS = {r"\b[quspz]_(\w+)": r"\1", r"\bv_(\w+)": r"\1'"}  # symbols of a graph, and their names


def switches(graph: Graph, rates: Sequence[Node]) -> list[tuple[Node, str]]:
    """Expressions at whose sign rates of states jump, and their texts."""
    found = dict[Node, str]()
    for node in needed(graph, rates):
        name, inner = str(graph.operations[node][0]), arguments(graph, node)
        if name in JUMPS and graph.varies(node):
            zero, _ = graph.without_constants(graph.sub(*inner) if len(inner) == 2 else inner[0])
            found.setdefault(zero, _text(graph, zero))
    return list(found.items())


def _text(graph: Graph, node: Node) -> str:
    """Expression as it would be written, or words where that is long."""
    *lines, text = (line.rstrip(";").partition(" = ")[2] for line in statements(graph, [("s", node)], C))
    if lines:
        return "a switch of the equations"
    for pattern, name in TEXTS.items():
        text = re.sub(pattern, name, text)
    return text if len(text) <= LONGEST else "a switch of the equations"


def sliding(
    values: Callable[[float, Array], Array], slope: Callable[[float, Array], Array], t: float, y: Array, span: float
) -> int:
    """Number of the switch along which the motion slides at a time and a state (n,), or -1.

    `values` gives the switches (k,), `slope` the rates (n,); `span` is the time that is integrated.
    """
    apart = APART * (np.max(abs(y), initial=0.0) + APART)
    gradients = np.array([values(t, y + step) - values(t, y - step) for step in apart * np.eye(len(y))]) / (2.0 * apart)
    late = NEAR * span
    in_time = (values(t + late, y) - values(t - late, y)) / (2.0 * late)
    for i, (value, gradient) in enumerate(zip(values(t, y), gradients.T, strict=True)):
        size = gradient @ gradient
        if not size > 0.0:
            continue
        side = apart * np.sqrt(size)
        above, below = (
            gradient @ slope(t, y + gradient * ((sign * side - value) / size)) + in_time[i] for sign in (1.0, -1.0)
        )
        if above < 0.0 < below and abs(value) <= late * max(-above, below):
            return i
    return -1
