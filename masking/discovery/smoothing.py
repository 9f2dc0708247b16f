"""Smoothing: the motion of a rig and the force that its model lacks, from a record of positions.

A force on each coordinate is added to the model as a random walk; a Kalman filter and a backward pass with the constant
gains of the rig at rest give the motion, its velocities and these forces, with their covariance. No differences are
taken. How strongly the forces may walk is found from the likelihood of the record.
Source: Rauch, Tung and Striebel (1965), AIAA Journal 3(8), 1445-1450; Alvarez, Luengo and Lawrence (2009), Latent Force
Models, AISTATS.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from masking.discovery.evidence import Evidence
from masking.discovery.opened import OpenRig
from masking.effects import Effect
from masking.errors import IntegrationError
from masking.kernels import Array
from masking.sensitivity import is_straight

WALKS = (1e-2, 1e-1, 1.0, 1e1, 1e2)  # intensities that are tried, of that which moves the sensors as their noise does
DOUBLINGS = 24  # of the samples over which smoothing settles
SHORT = 8.0  # s of the record by which the intensity is chosen


@dataclass(frozen=True)
class Motion:
    """A smoothed record.

    Args:
        states: of the rig (m, n).
        forces: that the model lacks, on each coordinate (m, coordinates), in its unit of acceleration.
        deviation: standard deviation of these forces (coordinates,).
        innovations: what each reading adds to the past, in standard deviations (m, sensors).
        displacement: of each place (m, places).
        rate: of each place (m, places).
        acceleration: of each place (m, places): what the rig's own equations make of the motion, the commands and these
            forces. Differences of velocities would miss what commands change within a sample.
    """

    states: Array
    forces: Array
    deviation: Array
    innovations: Array
    displacement: Array
    rate: Array
    acceleration: Array

    def acted_on(self, effect: Effect, at: int) -> tuple[Array, Array]:
        """Return what an effect in an element follows at a place (m,): displacement and rate, or the acceleration."""
        x = self.acceleration if effect.is_inertia else self.displacement
        return x[:, at], self.rate[:, at]


@dataclass(frozen=True)
class _Gains:
    forward: Array
    backward: Array
    deviation: Array
    spread: Array


def smooth(evidence: Evidence, theta: Array, start: Array) -> Motion:
    """Return the motion and the lacking forces of a record.

    Args:
        evidence: the record and the rig.
        theta: its parameters (k,).
        start: its first state, of each window the first (windows, states).

    Raises:
        IntegrationError: the readings do not tell all coordinates, or the motion is no longer finite.
    """
    rig, record, sigma = evidence.rig, evidence.record, evidence.sigma
    part = replace(evidence, record=record.first(SHORT)) if len(record) > SHORT * record.rate else evidence
    unit = _unit(rig, theta, sigma)
    costs = []
    for walk in WALKS:
        gains = _gains(rig, theta, record.rate, sigma, walk * unit)
        innovations, _, _ = _filter(part, theta, start, gains)
        whitened = linalg.solve_triangular(linalg.cholesky(gains.spread, lower=True), innovations.T, lower=True)
        costs.append((whitened**2).mean() + 2.0 * np.log(np.diag(linalg.cholesky(gains.spread))).mean())
    gains = _gains(rig, theta, record.rate, sigma, WALKS[int(np.argmin(costs))] * unit)
    innovations, states, predicted = _filter(evidence, theta, start, gains)
    rig.kernels.back(len(record), gains.backward, states, predicted)
    n = len(rig.twin.state_names)
    placed = np.empty((len(record), 3 * len(rig.places)))
    acting = np.ascontiguousarray(record.acting)
    rig.kernels.motions(len(record), 1.0 / record.rate, rig.basis(theta)[0], states, acting, placed)
    displacement, rate, acceleration = (np.ascontiguousarray(part) for part in np.split(placed, 3, axis=1))
    return Motion(
        np.ascontiguousarray(states[:, :n]), states[:, n:], gains.deviation,
        innovations / np.sqrt(np.diag(gains.spread)), displacement, rate, acceleration,
    )  # fmt: skip


def _filter(evidence: Evidence, theta: Array, start: Array, gains: _Gains) -> tuple[Array, Array, Array]:
    """Return innovations (m, sensors), filtered and predicted states with forces (m, n + coordinates)."""
    rig, record = evidence.rig, evidence.record
    size = start.shape[1] + len(rig.coordinates)
    states, predicted = np.empty((len(record), size)), np.empty((len(record), size))
    x = np.concatenate([start[0], np.zeros(len(rig.coordinates))])
    p, _ = rig.basis(theta)
    status = rig.kernels.follow(
        len(record), evidence.dt, evidence.substeps, is_straight(record.between), x, p.copy(), gains.forward,
        np.ascontiguousarray(record.acting), record.readings, states, predicted,
    )  # fmt: skip
    if status or not np.isfinite(states).all():
        raise IntegrationError("the record cannot be followed: the motion is no longer finite")
    sensed = np.empty_like(record.readings)
    rig.kernels.read(len(record), 1.0 / record.rate, p, predicted, sensed)
    return record.readings - sensed, states, predicted


def linearised(rig: OpenRig, theta: Array) -> tuple[Array, Array, Array]:
    """Return A (n, n), B of forces on the coordinates (n, coordinates) and C (sensors, n) of the rig at rest."""
    n, count = len(rig.twin.state_names), len(rig.coordinates)
    p, _ = rig.basis(theta)
    y, u = rig.twin.rest(np.zeros(count)), np.zeros(len(rig.twin.actuators))
    jy, jp, dy = np.zeros((n, n)), np.zeros((n, rig.affected)), np.zeros(n)
    rig.kernels.slopes(0.0, y, u, p, dy, jy, jp)
    _, js = rig.reading(theta, y)
    jy[:count, count : 2 * count] = np.eye(count)
    columns = [rig.columns[1][i] for i in rig.coordinate_places]
    return jy, jp[:, columns], js


def _unit(rig: OpenRig, theta: Array, sigma: Array) -> Array:
    """Return the intensity (coordinates,) whose walk over the time of a motion moves sensors by their noise."""
    a, _, c = linearised(rig, theta)
    speed = np.abs(linalg.eigvals(a)).max() or 1.0
    reached = np.abs(np.linalg.pinv(c[:, : len(rig.coordinates)])) @ sigma * speed**2
    return np.asarray(np.maximum(reached, 1e-300) ** 2 * speed)


def _gains(rig: OpenRig, theta: Array, rate: float, sigma: Array, intensity: Array) -> _Gains:
    a, b, c = linearised(rig, theta)
    n, m = len(a), b.shape[1]
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[:n, n:] = a, b
    moved = linalg.expm(whole / rate)
    sensing = np.hstack([c, np.zeros((len(c), m))])
    # Van Loan: the noise of a random walk over a sample, seen by every state.
    q = np.zeros_like(whole)
    q[n:, n:] = np.diag(intensity)
    block = np.zeros((2 * (n + m), 2 * (n + m)))
    block[: n + m, : n + m], block[: n + m, n + m :], block[n + m :, n + m :] = -whole, q, whole.T
    exp = linalg.expm(block / rate)
    noise = exp[n + m :, n + m :].T @ exp[: n + m, n + m :]
    noise = 0.5 * (noise + noise.T)
    scale = np.sqrt(np.maximum(np.diag(noise), 1e-300))
    # In scaled states the equation is well conditioned.
    size = np.concatenate([np.full(n, 1.0), np.ones(m)]) * np.maximum(scale, 1e-12 * scale.max())
    f, h = moved * size / size[:, None], sensing * size
    qs, r = noise / np.outer(size, size), np.diag(sigma**2)
    try:
        ahead = linalg.solve_discrete_are(f.T, h.T, qs, r)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise IntegrationError(f"the sensors do not tell the motion of all coordinates ({error})") from None
    spread = h @ ahead @ h.T + r
    gain = np.linalg.solve(spread, h @ ahead).T
    now = ahead - gain @ h @ ahead
    backward = np.linalg.solve(ahead, f @ now).T
    steady, power = now - backward @ ahead @ backward.T, backward
    for _ in range(DOUBLINGS):  # the sum of all powers: Smith (1968), SIAM J. Appl. Math. 16(1), 198-201
        steady, power = steady + power @ steady @ power.T, power @ power
    deviation = np.sqrt(np.maximum(np.diag(steady)[n:], 0.0)) * size[n:]
    return _Gains(
        np.ascontiguousarray(gain * size[:, None]), np.ascontiguousarray(backward * size[:, None] / size),
        deviation, spread,
    )  # fmt: skip
