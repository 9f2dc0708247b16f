"""Followed sensors: what sensors tell of a rig whose inputs act through dynamics of their own, and which are used."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.compile.numerics.newton import STEP, jacobian
from masking.control.known_instruments import Instruments
from masking.control.law import Controller

HIDDEN = 1e-6  # of a slope: what is smaller is rounding of differences
UNUSED = 1e6  # times the noise of a sensor that is not followed


def tells_forces(law: Controller, known: Instruments, end: Array, internal: Sequence[float], *, order: int) -> bool:
    """Whether accelerations that the model lacks are estimated beside what adds to the inputs.

    They are where readings tell constant ones from inputs that are off, since none of them hides behind another state:
    the matrix of a steady state has full rank. Their derivatives that the law asks for must be estimated, too: `order`
    of the disturbance is how many. `end` are the coordinates (n,) of the rig's initial state, `internal` its internal
    states there.
    """
    n, m = len(end), len(law.model.inputs)
    if max(law.degrees) > 1 + order or len(known.sensors) < n + m:
        return False
    model, p, near = known.model, known.model.values(), np.concatenate([end, np.zeros(n), internal])
    names = [*model.state_names, *(f"{c}''" for c in model.coordinates)]

    def steady(y: Array) -> Array:  # rates and readings by states, accelerations that the model lacks, and inputs
        x, forced, u = np.split(y, [len(near), len(near) + n])
        dx = np.empty(len(x))
        model.kernels.derivative(0.0, x, u, p, dx)
        dx[n : 2 * n] += forced
        values = model.parameter_values() | dict(zip(names, [*x, *dx[n : 2 * n]], strict=True))
        return np.array([*dx, *(known.measured(one, values) for one in known.plant.sensors.values())])

    sizes = np.concatenate([np.tile(model.lengths, 2), np.ones(len(near) - n + m)])
    slope = jacobian(steady, np.concatenate([near, np.zeros(n + m)]), STEP * sizes)
    slope /= np.maximum(np.abs(slope).max(axis=1, keepdims=True), 1e-300)
    slope /= np.maximum(np.abs(slope).max(axis=0), 1e-300)
    return bool(np.linalg.matrix_rank(slope, tol=HIDDEN) == slope.shape[1])


def unused(known: Instruments) -> tuple[str, ...]:
    """Sensors that are not followed: of internal states and accelerations, where others tell the coordinates.

    The model alone ties what they read to the coordinates; where it is wrong, and no force makes up for that, they
    would move these.
    """
    names = {*known.model.states, *(f"{c}''" for c in known.model.coordinates)}
    behind = tuple(name for name, sensor in known.plant.sensors.items() if sensor.measures.symbols & names)
    return behind if len(known.sensors) - len(behind) >= len(known.model.coordinates) else ()
