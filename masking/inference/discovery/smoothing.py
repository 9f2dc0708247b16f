"""Smoothing: the motion of a rig and the latent forces on it, from a record of positions.

A force on each coordinate is added to the model as a random walk, and without coordinates on the rate of each state and
on each output that forces act on; a Kalman filter and a backward pass with the constant gains of the rig at rest give
the motion, its velocities and these forces, with their covariance. No differences are taken. How strongly the forces
may walk is found from the likelihood of the record.
Source: Rauch, Tung and Striebel (1965), AIAA Journal 3(8), 1445-1450; Alvarez, Luengo and Lawrence (2009), Latent Force
Models, AISTATS.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array, Complex
from masking.compile.numerics.kernel_arguments import LatentRig, Steps
from masking.compile.numerics.steady_kalman import discretised, steady_filter
from masking.errors import IntegrationError
from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.estimation.identification_data import is_first_order
from masking.inference.estimation.initial_states import guessed_state
from masking.model.effects import Effect

WALKS = (1e-2, 1e-1, 1.0, 1e1, 1e2)  # intensities that are tried, of that which moves the sensors as their noise does
QUICK = 0.3  # rad, times the rate of a record: how fast forces on states and outputs are followed, to begin with
FURTHER = (1e-6, 1e-4)  # intensities that are tried before the others if latent forces act on nothing else
FADING = 1e-3  # rad, times the rate of a record: how fast forces fade that the sensors do not separate
# Times the speed of the rig: how fast forces fade where accelerometers do not show constant ones, whose springs balance
# them. If these forces lasted, noise would make them and the displacements drift.
MOVING = 3.0
STRONGER = (1e3, 1e4)  # intensities that are tried, too, where readings follow forces at once
UNSEEN = 1e-200  # intensity of a force that no sensor shows at once: it is not estimated
SHORT = 8000  # samples of the record by which the intensity is chosen


@dataclass(frozen=True)
class Motion:
    """A smoothed record."""

    states: Array  # of the rig (m, n)
    forces: Array  # latent, on each degree (m, degrees): coordinates, in their unit of acceleration, states and outputs
    deviation: Array  # standard deviation of these forces (degrees,); infinite where no sensor shows a force at once
    displacement: Array  # of each place (m, places)
    rate: Array  # of each place (m, places)
    # of each place (m, places): what the rig's own equations make of the motion, the commands and these forces.
    # Differences of velocities would miss what commands change within a sample
    acceleration: Array

    def acted_on(self, effect: Effect, at: int) -> tuple[Array, Array]:
        """Motion that an effect in an element follows at a place: displacement (m,) or acceleration, and rate (m,)."""
        x = self.acceleration if effect.is_inertia else self.displacement
        return x[:, at], self.rate[:, at]


# Part by which states decay in a sample where the readings leave a direction of them undetermined that stays as it is,
# such as a displacement less the elastic part of it, or a tank behind another that is at rest: a filter is steady then.
FORGETTING = 1e-4
WORST_CONDITION = 1e14  # of a covariance that is divided by


@dataclass(frozen=True)
class _Gains:
    forward: Array
    backward: Array
    deviation: Array
    spread: Array
    kept: float  # of the forces, from one sample to the next


def smooth(problem: EstimationProblem, theta: Array, start: Array) -> Motion:
    """Motion and the latent forces of a record, with the parameters (k,) of the rig and its initial states (w, states).

    An IntegrationError says that readings do not tell all coordinates, or that the motion is no longer finite.
    """
    rig, record, sigma = problem.rig, problem.record, problem.sigma
    part = replace(problem, record=record.first(SHORT / record.rate))
    unit, walks = _unit(rig, theta, sigma, record.rate), WALKS if rig.coordinates else (*FURTHER, *WALKS)
    walks = (*walks, *STRONGER) if rig.coordinates and rig.twin.is_fed else walks
    costs = []
    for walk in walks:
        gains = _gains(rig, theta, record.rate, sigma, walk * unit)
        innovations, _, _ = _filter(part, theta, start, gains)
        with decompositions.decomposed():
            root = linalg.cholesky(gains.spread, lower=True)
            whitened = linalg.solve_triangular(root, innovations.T, lower=True)
        costs.append((whitened**2).mean() + 2.0 * np.log(np.diag(root)).mean())
    gains = _gains(rig, theta, record.rate, sigma, walks[int(np.argmin(costs))] * unit)
    _, states, predicted = _filter(problem, theta, start, gains)
    rig.kernels.smooth_backward(len(record), gains.backward, states, predicted)
    n = len(rig.twin.state_names)
    seen = unit > UNSEEN
    states[:, n:] = np.where(seen, states[:, n:], 0.0)
    placed = np.empty((len(record), 3 * len(rig.seats)))
    acting = np.ascontiguousarray(record.acting)
    p = rig.basis(theta)[0]
    rig.kernels.motions(len(record), 1.0 / record.rate, rig.sizes.coordinates, rig.latent, p, states, acting, placed)
    parts = (part[:, : len(rig.places)] for part in np.split(placed, 3, axis=1))
    displacement, rate, acceleration = (np.ascontiguousarray(part) for part in parts)
    with np.errstate(over="ignore"):
        if not all(np.isfinite(np.linalg.norm(table)) for table in (states, displacement, rate)):
            raise IntegrationError("the record cannot be followed: the smoothed motion is no longer finite")
    return Motion(
        np.ascontiguousarray(states[:, :n]), states[:, n:], np.where(seen, gains.deviation, np.inf),
        displacement, rate, acceleration,
    )  # fmt: skip


def _filter(problem: EstimationProblem, theta: Array, start: Array, gains: _Gains) -> tuple[Array, Array, Array]:
    """Innovations (m, sensors), filtered and predicted states with forces (m, n + degrees)."""
    rig, record = problem.rig, problem.record
    size = start.shape[1] + len(rig.degrees)
    states, predicted = np.empty((len(record), size)), np.empty((len(record), size))
    x = np.concatenate([start[0], np.zeros(len(rig.degrees))])
    p, _ = rig.basis(theta)
    acting = np.ascontiguousarray(record.acting)
    steps = Steps(len(record), problem.dt, problem.substeps, is_first_order(record.hold))
    latent = LatentRig(rig.latent, x, p.copy(), gains.forward, gains.kept)
    status = rig.kernels.follow(steps, latent, acting, record.readings, states, predicted)
    if status or not np.isfinite(states).all():
        raise IntegrationError("the record cannot be followed: the motion is no longer finite")
    sensed = np.empty_like(record.readings)
    rig.kernels.read(len(record), 1.0 / record.rate, rig.latent, p.copy(), predicted, acting, sensed)
    return record.readings - sensed, states, predicted


def linearised(rig: AugmentedModel, theta: Array) -> tuple[Array, Array, Array, Array]:
    """A (n, n), B (n, degrees), C (sensors, n), D (sensors, degrees) at rest; an IntegrationError without slopes."""
    count, y = len(rig.coordinates), rig.rest
    jy, jp = rig.slopes(theta)
    js, jps = rig.reading(theta, y)[1], rig.direct(theta)
    jy[:count, count : 2 * count] = np.eye(count)
    columns = [rig.columns[1][i] for i in rig.degree_places]
    if not all(np.isfinite(table).all() for table in (jy, jp[:, columns], js, jps[:, columns])):
        state = ", ".join(f"{name} = {value:g}" for name, value in zip(rig.twin.state_names, y, strict=True))
        raise IntegrationError(f"the equations have no slopes at rest ({state}); give states an initial value in use")
    return jy, jp[:, columns], js, jps[:, columns]


def centred(problem: EstimationProblem) -> EstimationProblem:
    """Problem whose rig is linearised around the mean of the motion, where it would fall from its zero.

    A pendulum whose angle counts from straight up is an example.
    """
    rig, record, theta = problem.rig, problem.record, problem.prior.mean
    if not rig.coordinates or not _falls(rig, problem):
        return problem
    times, n = np.arange(len(record)) / record.rate, len(rig.coordinates)
    at_rest = rig.reading(theta, rig.rest, record.acting[0])
    mean = guessed_state(rig.rest, at_rest, rig.twin.free, times, record.readings, n=n, degree=0)[:n]
    other = replace(rig, at=tuple(mean.tolist()))
    return problem if _falls(other, problem) else replace(problem, rig=other)


def _falls(rig: AugmentedModel, problem: EstimationProblem) -> bool:
    """Whether a motion near rest grows e-fold within the record."""
    return float(modes(rig, problem.prior.mean).real.max()) * len(problem.record) > problem.record.rate


def modes(rig: AugmentedModel, theta: Array) -> Complex:
    """Eigenvalues of the rig at rest, rad/s (n,)."""
    return decompositions.eigenvalues(linearised(rig, theta)[0])


def fastest(rig: AugmentedModel, theta: Array) -> complex:
    """Eigenvalue of largest magnitude of the rig at rest, rad/s; 0 of a rig that has no states."""
    found = modes(rig, theta) if rig.twin.state_names else np.zeros(1)
    return complex(found[int(np.argmax(np.abs(found)))])


def sizes(problem: EstimationProblem) -> Array:
    """Sizes of states by the largest readings (states,); 0 of those that no sensor sees."""
    rig, mean, record = problem.rig, problem.prior.mean, problem.record
    n, (at_rest, jacobian) = len(rig.coordinates), rig.reading(mean, rig.rest, record.acting[0])
    found = np.abs(decompositions.inverse(jacobian)) @ np.abs(record.readings - at_rest).max(axis=0)
    found[n : 2 * n] = np.maximum(found[n : 2 * n], abs(fastest(rig, mean)) * found[:n])
    return np.asarray(found)


def _unit(rig: AugmentedModel, theta: Array, sigma: Array, rate: float) -> Array:
    """Intensity (degrees,) whose walk over the time of a motion moves sensors by their noise.

    A force on a state or an output is followed with the speed w where its intensity is s^2 w^4 / rate or
    s^2 w^2 / rate, for a state or output that is read with a deviation of s in each sample.
    """
    _, _, c, d = linearised(rig, theta)
    count = len(rig.coordinates)
    speed, quick = abs(fastest(rig, theta)) or 1.0, QUICK * rate
    moving = c[:, :count] + 1j * speed * c[:, count : 2 * count]  # readings of a motion at that speed
    reached = np.abs(decompositions.inverse(moving)) @ sigma * speed**2
    states = [rig.twin.state_names.index(name) for name in rig.degrees[count:] if name in rig.twin.state_names]
    of_states = np.abs(decompositions.inverse(c[:, states])) @ sigma * quick**2
    of_outputs = np.abs(decompositions.inverse(d[:, count + len(states) :])) @ sigma * quick
    walked = np.concatenate([of_states, of_outputs]) ** 2 / rate
    return np.concatenate([np.maximum(reached, 1e-300) ** 2 * speed, np.maximum(walked, 1e-300)])


def _gains(rig: AugmentedModel, theta: Array, rate: float, sigma: Array, intensity: Array) -> _Gains:
    a, b, c, d = linearised(rig, theta)
    n, m = len(a), b.shape[1]
    flow = np.zeros((n + m, n + m))
    flow[:n, :n], flow[:n, n:] = a, b
    fading = 0.0
    if np.linalg.matrix_rank(np.vstack([np.hstack([a, b]), np.hstack([c, d])])) < n + m:
        # Sensors do not separate the forces: what they leave open stays small.
        fading = MOVING * abs(fastest(rig, theta)) if d[:, : len(rig.coordinates)].any() else FADING * rate
    flow[n:, n:] = -fading * np.eye(m)
    moved, noise = discretised(flow, np.concatenate([np.zeros(n), intensity]), 1.0 / rate)
    # In scaled states, and in readings of unit variance, the equation is well conditioned.
    scale = np.sqrt(np.maximum(np.diag(noise), 1e-300))
    size = np.maximum(scale, 1e-12 * scale.max())
    for forgotten in (0.0, FORGETTING):
        step = (1.0 - forgotten) * moved * size / size[:, None]
        try:
            found = steady_filter(step, noise / np.outer(size, size), np.hstack([c, d]) * size / sigma[:, None])
            break
        except (np.linalg.LinAlgError, ValueError) as error:
            why = error
    else:
        what = "coordinates" if rig.coordinates else ", ".join(rig.degrees)
        raise IntegrationError(f"the sensors do not determine the motion of all {what} ({why})")
    ahead, now = found.predicted, found.corrected
    with decompositions.decomposed():
        is_regular = np.linalg.cond(ahead) < WORST_CONDITION
    if is_regular:
        backward = np.linalg.solve(ahead, step @ now).T
    else:  # a state that nothing moves at rest, such as that of a friction, is known
        backward = (decompositions.inverse(ahead, 1.0 / WORST_CONDITION, hermitian=True) @ step @ now).T
    # A direction that nothing moves stays as it is: 1 is an eigenvalue.
    with decompositions.decomposed(), warnings.catch_warnings():
        warnings.simplefilter("ignore", linalg.LinAlgWarning)
        steady = linalg.solve_discrete_lyapunov(backward, now - backward @ ahead @ backward.T)
    deviation = np.sqrt(np.maximum(np.diag(steady)[n:], 0.0)) * size[n:]
    return _Gains(
        np.ascontiguousarray(found.gain * size[:, None] / sigma),
        np.ascontiguousarray(backward * size[:, None] / size),
        deviation, found.innovation * np.outer(sigma, sigma), float(np.exp(-fading / rate)),
    )  # fmt: skip
