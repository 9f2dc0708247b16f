"""The sampled loop around a twin: compiled whole, beside the same as Python loops over compiled pieces.

The pieces are numba's own compiled functions, called with arrays that are made before the loop: in one loop the
equations alone (sensors, rig, model, control law, allocation), with integrators, prediction, hold and limits in numpy;
in the other whole boxes, so that Python only passes arrays from one to the next.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from masking.compile.numerics import sampled_loop as sampling
from masking.compile.numerics.kernel_arguments import Recorded, Rig, Samples, Unit
from masking.control.stepwise_controller import SampledStep
from masking.lab.runs.experiment import Experiment
from tests.benchmarks.table import Row, interleaved, judged, missing, ratio, told

Rate = Callable[[float, np.ndarray, np.ndarray], None]

SAMPLES = 5_000
ROUNDS = 10
LARGEST_DIFFERENCE = 1e-9
WHAT = "sampled loop with twin and disturbance observer"


def rows() -> Iterator[Row]:
    """Measure the Duffing experiment on both packaged rigs at 1 kHz."""
    for plant in ("linear_rig", "tue_rig"):
        controller = {"rate": "1 kHz", "observer": "disturbance"}
        found = Experiment.load("duffing", plant=plant).changed(controller=controller, record=None)
        loops = {"whole": Whole(found), "equations": Equations(found), "boxes": Boxes(found), "step": Step(found)}
        loops["boxes"]()  # compiles
        seconds = interleaved(loops, ROUNDS)
        each = {name: f"{min(s) / SAMPLES * 1e9:.4g} ns" for name, s in seconds.items()}
        states = loops["whole"].states
        for name in ("equations", "boxes"):
            difference = float(np.max(np.abs(states - loops[name].states)) / np.max(np.abs(states)))
            what, times = f"{WHAT}, {plant}: masking / loop over {name}", ratio(seconds, name, "whole")
            note = f"per sample, shortest of {ROUNDS} runs of {SAMPLES} samples; states differ by {difference:.1e}"
            if difference > LARGEST_DIFFERENCE:
                yield missing(what, f"states differ by {difference:.1e}")
            elif name == "equations":
                yield judged(what, each["whole"], each[name], times, at_least=20.0, note=note)
            else:
                yield told(what, each["whole"], each[name], times, note)
        yield told(f"one step of the controller, called from Python, {plant}", each["step"])


class Whole:
    """The compiled loop."""

    def __init__(self, found: Experiment) -> None:
        self.found, self.sampled, self.twin = found, found.sampled, found.twin
        self.substeps, self.p = self.twin.substeps(self.sampled.rate), self.twin.values()
        self.noise = np.random.default_rng(0).standard_normal((SAMPLES, len(self.twin.sensors)))
        self.reading, self.late = np.empty(len(self.twin.sensors)), self.twin.late(self.sampled.rate)
        self.states = np.zeros((SAMPLES, len(self.twin.state_names)))

    def begin(self) -> tuple[np.ndarray, Any, np.ndarray]:
        """Return the rig's state, the controller's memory, and the commands under way."""
        y = self.twin.rest(self.sampled.end)
        self.twin.kernels.sense(0.0, y, self.p, np.zeros_like(self.reading), self.reading)
        memory = self.sampled.begin(self.reading)
        return y, memory, np.tile(memory.holding, (self.twin.delay + 1, 1))

    def __call__(self) -> None:
        y, memory, queue = self.begin()
        sizes = self.sampled.sizes
        out = [np.empty((SAMPLES, n)) for n in (len(memory.x), len(self.reading), sizes.actuators, sizes.actuators)]
        self.found.sampled_loop.kernels.run(
            Samples(0, SAMPLES, 1.0 / self.sampled.rate, self.substeps, 1), Rig(y, self.p, queue, self.late),
            Unit(memory.x, memory.p, self.sampled.gain, self.sampled.limits), self.noise, 0.0,
            Recorded(self.states, *out),
        )  # fmt: skip


class Loop(Whole):
    """The same in Python."""

    def __init__(self, found: Experiment) -> None:
        super().__init__(found)
        self.made = found.sampled_loop.kernels
        sizes = self.sampled.sizes
        self.h, self.delay = 1.0 / self.sampled.rate, self.sampled.delay
        self.n, self.size, self.order = sizes.coordinates, sizes.states, sizes.order
        self.expected = np.empty(len(self.twin.sensors))
        self.u, self.demanded = np.empty(sizes.inputs), np.empty(sizes.actuators)

    def __call__(self) -> None:
        sampled, sizes, made, h = self.sampled, self.sampled.sizes, self.made, self.h
        y, memory, queue = self.begin()
        x, p, u = memory.x, memory.p, self.u
        z, power = x[sizes.next].copy(), x[sizes.power].copy()
        under_way, commands = list(x[sizes.fixed :].reshape(self.delay, sizes.inputs).copy()), list(queue[:-1])
        for index in range(SAMPLES):
            t = index * h
            self.states[index] = y
            made.sense(t, y, self.p, self.noise[index], self.reading)
            made.measure(t, z, p, self.expected)
            z += sampled.gain @ (self.reading - self.expected)
            ahead = z.copy()
            for j, inputs in enumerate(under_way):
                ahead = self.predicted(t + j * h, ahead, inputs, p)
                if j == 0:
                    z = ahead.copy()
            self.hold(t + self.delay * h, ahead, p, u)
            made.allocate(u, p, self.demanded)
            applied = self.limited(self.demanded, power)
            acting = np.empty_like(u)
            made.wire(applied, p, acting)
            under_way.append(acting)
            if self.delay == 0:
                z = self.predicted(t, z, acting, p)
            under_way.pop(0)
            commands.append(applied)
            y = self.advanced(t, y, commands.pop(0))


class Equations(Loop):
    """Compiled equations; the rest in numpy."""

    def __init__(self, found: Experiment) -> None:
        super().__init__(found)
        self.slopes = np.empty((4, self.size))
        self.twin_slopes = np.empty((4, len(self.twin.state_names)))
        self.r, self.g = np.empty((2, self.n)), np.empty((3, self.n))
        self.inputs = np.empty((3, len(self.u)))

    def predicted(self, t: float, z: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the estimate after a sample."""
        n, size, h = self.n, self.size, self.h
        lacking = z[size : size + n] + 0.5 * h * z[size + n :]

        def rate(t: float, y: np.ndarray, out: np.ndarray) -> None:
            self.made.rate(t, y, u, p, out)
            out[n : 2 * n] += lacking

        moved = runge_kutta(rate, t, z[:size], h, self.slopes)
        return np.concatenate([moved, z[size : size + n] + h * z[size + n :], z[size + n :]])

    def hold(self, acts: float, z: np.ndarray, p: np.ndarray, u: np.ndarray) -> None:
        """Write the inputs that are held, as `masking.compile.numerics.sampled_loop.hold` does."""
        n, size, h, (r0, r2), (g0, g1, g2) = self.n, self.size, self.h, self.r, self.g
        u0, u1, u2 = self.inputs
        law, d, slope = self.made.law, z[size : size + n], z[size + n :]
        q, v, rest = z[:n], z[n : 2 * n], z[2 * n : size]
        law(acts, acts, z[:size], d, p, u0, r0, g0)
        end = np.concatenate([q + h * (v + 0.5 * h * r0), v + h * r0, rest])
        law(acts + h, acts, end, d + h * slope, p, u2, r2, g2)
        v = v + h / 12.0 * (g2 - g0)
        law(acts, acts, np.concatenate([q, v, rest]), d, p, u0, r0, g0)
        half = np.concatenate([q + 0.5 * h * v + h * h / 48.0 * (5.0 * r0 + r2), v + h / 8.0 * (3.0 * r0 + r2), rest])
        r1 = np.empty(n)
        law(acts + 0.5 * h, acts, half, d + 0.5 * h * slope, p, u1, r1, g1)
        end = np.concatenate([q + h * v + h * h / 6.0 * (2.0 * r0 + r2), v + 0.5 * h * (r0 + r2), rest])
        law(acts + h, acts, end, d + h * slope, p, u2, r2, g2)
        u[:] = 4.0 / 3.0 * u1 - (u0 + u2) / 6.0

    def limited(self, demanded: np.ndarray, power: np.ndarray) -> np.ndarray:
        """Return the commands within the limits; brings the mean powers to the next sample."""
        largest, heating, most, time = self.sampled.limits.T
        part = -np.expm1(-self.h / time)
        bound = np.minimum(largest, np.sqrt(np.maximum(0.0, most - (1.0 - part) * power) / (part * heating)))
        applied = np.clip(demanded, -bound, bound)
        power += part * (heating * applied**2 - power)
        return applied

    def advanced(self, t: float, y: np.ndarray, command: np.ndarray) -> np.ndarray:
        """Return the twin's state after a sample."""
        step = self.h / self.substeps

        def rate(t: float, y: np.ndarray, out: np.ndarray) -> None:
            self.made.twin_derivative(t, y, command, self.p, out)

        for i in range(self.substeps):
            y = runge_kutta(rate, t + i * step, y, step, self.twin_slopes)
        return y


def runge_kutta(rate: Rate, t: float, y: np.ndarray, h: float, k: np.ndarray) -> np.ndarray:
    """Return y after a step of the classical method."""
    rate(t, y, k[0])
    rate(t + 0.5 * h, y + 0.5 * h * k[0], k[1])
    rate(t + 0.5 * h, y + 0.5 * h * k[1], k[2])
    rate(t + h, y + h * k[2], k[3])
    return y + h / 6.0 * (k[0] + 2.0 * (k[1] + k[2]) + k[3])


class Boxes(Loop):
    """Compiled boxes: prediction, hold with the law, limits, and the rig's motion over a sample."""

    def __init__(self, found: Experiment) -> None:
        super().__init__(found)
        sizes = self.sampled.sizes
        self.predict = sampling.predict(self.made.rate, sizes)
        self.held = sampling.hold(self.made.law, self.made.rate, sizes)
        self.limit = sampling.limiter(sizes)
        self.work = np.empty((sizes.work[0], self.found.sampled_loop.width))

    def predicted(self, t: float, z: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the estimate after a sample, in place."""
        self.predict(t, z, u, p, self.h, self.work[13:17], self.work[17])
        return z

    def hold(self, acts: float, z: np.ndarray, p: np.ndarray, u: np.ndarray) -> None:
        """Write the inputs that are held."""
        self.held(acts, acts, z, p, self.h, u, self.work)

    def limited(self, demanded: np.ndarray, power: np.ndarray) -> np.ndarray:
        """Return the commands within the limits; brings the mean powers to the next sample."""
        applied = np.empty_like(demanded)
        self.limit(demanded, self.sampled.limits, power, self.h, applied)
        return applied

    def advanced(self, t: float, y: np.ndarray, command: np.ndarray) -> np.ndarray:
        """Return the twin's state after a sample, in place."""
        self.made.advance(t, y, command, self.p, self.h, self.substeps, self.work)
        return y


class Step(Whole):
    """One step of the controller after the other, as a rig calls it."""

    def __init__(self, found: Experiment) -> None:
        super().__init__(found)
        self.step = SampledStep(self.sampled)

    def __call__(self) -> None:
        self.step.reset(self.reading)
        for index in range(SAMPLES):
            self.step(self.reading, index)
