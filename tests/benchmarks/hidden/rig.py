"""The rig of the benchmark: Rijlaarsdam (2008), (4.1)-(4.6) and Table B.1, written again in plain numpy.

States of a record are (d1, d2, x3) in m and their rates in m/s, where d_i = x_i - x3 is what sensor i measures.
Commands are (V1, V2, V3) in V and are held over each sample of 1 ms, from the sample on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Damping = Literal["own", "light"]

RATE = 1000.0  # samples per second
SENSOR_GAIN = 200.0  # V/m: 1 V is the stroke of 5 mm
LARGEST_COMMAND = 0.42  # V
STROKE = 3.5e-3  # m: the largest displacement that an excitation causes in the rig without effects
LIGHT = 0.02  # the three damping ratios of the variant with light damping

PARAMETERS = ("w1", "w2", "w3", "z1", "z2", "z3", "mu1", "mu2", "c1", "c2", "c3")
OWN = (12.5521, 14.0337, 9.7369, 0.3362, 0.4296, 0.0409, 0.0411, 0.0578, 20.9218, 23.2465, 1.2589)

ELEMENTS = ("spring1", "spring2", "beam")
PLACES = (*ELEMENTS, "x1", "x2", "x1-x2")  # where a force may act; of the last three, x1 and x2 are from the ground
SENSORS = ("s1", "s2", "s3")
ACTUATORS = ("V1", "V2", "V3")
ALL_ACTUATORS = "actuators"  # the place of a delay, which all actuators share


@dataclass(frozen=True)
class Rigs:
    """The eleven parameters of each rig of a batch: `values` (batch, 11), in the order of `PARAMETERS`.

    Units: w in rad/s, z and mu without, c in m/s**2/V.
    """

    values: Array

    def __getitem__(self, name: str) -> Array:
        """Return one parameter of all rigs (batch,)."""
        return self.values[:, PARAMETERS.index(name)]

    @property
    def stiffness(self) -> Array:
        """Return the stiffness per mass of spring1, spring2 and beam (3, batch), in 1/s**2."""
        return np.array([self["w1"] ** 2, self["w2"] ** 2, self["w3"] ** 2])

    @property
    def damping(self) -> Array:
        """Return the damping per mass of spring1, spring2 and beam (3, batch), in 1/s."""
        return np.array([2.0 * self[f"z{i}"] * self[f"w{i}"] for i in (1, 2, 3)])

    @property
    def passed_on(self) -> Array:
        """Return what a force in spring1, spring2 and beam adds to x3'' (3, batch): mu1, mu2 and -1."""
        return np.array([self["mu1"], self["mu2"], -np.ones(len(self.values))])

    def acceleration(self, commands: Array) -> Array:
        """Return what commands (..., 3, batch) in V add to d1'', d2'' and x3'' (..., 3, batch), in m/s**2.

        The actuators of the oscillators push against the beam: what adds c_i V_i to x_i'' takes mu_i c_i V_i from x3'',
        where (4.3) has c_3 V_i.
        """
        v1, v2, v3 = commands[..., 0, :], commands[..., 1, :], commands[..., 2, :]
        beam = self["c3"] * v3 - self["mu1"] * self["c1"] * v1 - self["mu2"] * self["c2"] * v2
        return np.stack((self["c1"] * v1 - beam, self["c2"] * v2 - beam, beam), axis=-2)

    def linear(self) -> tuple[Array, Array]:
        """Return A (batch, 6, 6) and B (batch, 6, 3) of (d, d')' = A (d, d') + B V for the rig without effects."""
        size = len(self.values)
        forces = np.zeros((size, 3, 3))  # what the unit force of each element adds to d1'', d2'' and x3''
        passed = self.passed_on.T
        forces[:, 0] = forces[:, 1] = -passed
        forces[:, 2] = passed
        forces[:, 0, 0] -= 1.0
        forces[:, 1, 1] -= 1.0
        a = np.zeros((size, 6, 6))
        a[:, :3, 3:] = np.eye(3)
        a[:, 3:, :3] = forces * self.stiffness.T[:, None, :]
        a[:, 3:, 3:] = forces * self.damping.T[:, None, :]
        b = np.zeros((size, 6, 3))
        units = np.repeat(np.eye(3)[:, :, None], size, axis=2)
        b[:, 3:] = self.acceleration(units).transpose(2, 1, 0)
        return a, b


def declared(damping: Damping) -> Array:
    """Return the eleven parameters that the model of the rig declares (11,), with its own or with light damping."""
    values = np.array(OWN)
    if damping == "light":
        values[[PARAMETERS.index(f"z{i}") for i in (1, 2, 3)]] = LIGHT
    return values


def exponential(matrices: Array) -> Array:
    """Return exp(matrix) of each small matrix (batch, n, n), by its Taylor series after halving, squared again."""
    halvings = max(0, int(np.ceil(np.log2(max(1e-3, np.abs(matrices).sum(axis=-1).max())))) + 3)
    scaled = matrices / 2.0**halvings
    term = total = np.broadcast_to(np.eye(matrices.shape[-1]), matrices.shape)
    for order in range(1, 14):
        term = term @ scaled / order
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total)


def linear_response(rigs: Rigs, commands: Array) -> Array:
    """Return d1, d2 and x3 (samples, 3, batch) in m of rigs without effects, exactly, from rest.

    `commands` (samples, 3, batch) in V are held over each sample.
    """
    a, b = rigs.linear()
    joint = np.zeros((len(a), 9, 9))
    joint[:, :6, :6], joint[:, :6, 6:] = a, b
    step = exponential(joint / RATE)[:, :6]
    state = np.zeros((len(a), 9, 1))
    inputs = np.ascontiguousarray(commands.transpose(0, 2, 1))[..., None]
    response = np.empty((len(commands), len(a), 3))
    for k, now in enumerate(inputs):
        response[k] = state[:, :3, 0]
        state[:, 6:] = now
        state[:, :6] = step @ state
    return response.transpose(0, 2, 1)
