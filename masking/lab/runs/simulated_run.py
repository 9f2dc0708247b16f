"""Simulated run: a closed loop run from an initial state, in continuous time, at a controller's rate, or around a twin.

Each is run whole, or in chunks of rows whose state is handed on: together they are the same numbers to the last bit.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, Final, TypeAlias, TypeVar

import numpy as np

from masking.compile.codegen.compiled_functions import InPieces, Kernels, steps_between
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.kernel_arguments import Recorded, Rig, Samples, States, Unit
from masking.compile.numerics.newton import STEP, jacobian, root
from masking.control.closed_loop import ClosedLoop
from masking.control.sampled_controller import SampledController
from masking.control.twin_loop import SampledLoop
from masking.errors import ModelError, RootError
from masking.lab.runs.stopping import check_status
from masking.model.modelling.input_series import Schedule, integrate

Progress = Callable[[float], None]

PIECES = 100
STEPS_AT_A_SWITCH = 2**16  # of a sample: what is lost is 1e-5 of what the plant makes of a step in one sample
MANIFOLD = 1e-13  # of the size of each, that derivatives of virtual coordinates are off by at the start
MOST_AT_SWITCHES = 2**24  # in all samples: some seconds
CHUNK: Final = 2**16  # rows after which an integrator with step size control begins anew, in whatever chunks it runs


@dataclass(frozen=True)
class Run:
    """What happened in a run, at the recorded instants."""

    times: Array  # (m,), seconds of the rig
    rig: Array  # rig coordinates then velocities (m, 2 n), SI units
    virtual: Array  # virtual coordinates, velocities and internal states (m, .), in the virtual system's units
    inputs: Array  # (m, inputs)


@dataclass(frozen=True)
class TwinRun:
    """What happened in a run around a twin, at the recorded samples."""

    times: Array  # (m,), seconds since the release
    states: Array  # states of the twin (m, states), as `Twin.state_names` says, SI units
    estimates: Array  # what the controller took for coordinates, velocities and internal states (m, .), SI units
    readings: Array  # of the sensors (m, sensors), in their units
    demanded: Array  # commands before limits (m, actuators), in the actuators' units
    applied: Array  # commands after limits (m, actuators)
    # mean power of each actuator as the controller reckons it (m, actuators), W; 0 where it is not limited
    power: Array
    disturbances: Array  # accelerations that the controller's model lacks, as far as it estimates them (m, .), SI units
    lasting: Array  # what the controller took for lasting of each push before the first sample (1, pushes), SI units


_AnyRun = TypeVar("_AnyRun", bound=Run | TwinRun)


def cut(run: _AnyRun, rows: int) -> _AnyRun:
    """First rows of a run."""
    return replace(run, **{part.name: getattr(run, part.name)[:rows] for part in fields(run)})


def joined(chunks_of_run: Iterable[_AnyRun]) -> _AnyRun:
    """Chunks of a run as one."""
    runs = [*chunks_of_run]
    if len(runs) == 1:
        return runs[0]
    names = [part.name for part in fields(runs[0]) if part.name != "lasting"]
    parts: dict[str, Any] = {name: np.concatenate([getattr(run, name) for run in runs]) for name in names}
    return replace(runs[0], **parts)


def samples_until(duration: float, rate: float) -> int:
    """Samples from time 0 to a duration in s, both included."""
    return int(np.floor(duration * rate * (1.0 + 1e-12))) + 1


def chunks(kernels: Kernels, rows: int) -> range:
    """First row of each chunk in which dynamics are integrated; a single one if they jump, or depend on their past."""
    return range(0, rows, max(1, rows) if kernels.meta.get("lags") or kernels.meta.get("events") else CHUNK)


def continuous_chunks(
    loop: ClosedLoop,
    state: Array,
    rows: int,
    instants: Callable[[int, int], Array],
    *,
    tolerance: float,
    schedule: Schedule | None = None,
    progress: Progress | None = None,
) -> Iterator[Run]:
    """Run a closed loop whose controller acts in continuous time, in chunks of `CHUNK` rows.

    The state at the first time is that of `loop_state`; `instants` returns the times of the rows from one number to
    before another; `schedule` changes parameters of the control law on the way. A SingularityError, which holds the
    state, where the decoupling matrix became singular; an IntegrationError where the integrator could not go on.
    """
    p, _ = loop.values(), loop.controller.virtual.delays()
    inputs, y, before = np.zeros(len(loop.plant.inputs)), state, np.empty(0)
    starts = chunks(loop.kernels, rows)
    for begin in starts:
        times = instants(begin, min(begin + starts.step, rows))
        found = integrate(
            loop.kernels, np.concatenate([before, times]), y, inputs, p,
            schedule=schedule, tolerance=tolerance, pieces=InPieces(PIECES, _within(progress, begin, len(times), rows)),
        )  # fmt: skip
        states = found.states[len(before) :]
        y, before = states[-1, : len(state)].copy(), times[-1:]
        yield complete(loop, times, states, p, schedule)


def _within(progress: Progress | None, begin: int, count: int, rows: int) -> Progress | None:
    return None if progress is None else lambda part: progress((begin + part * count) / rows)


def sampled_chunks(
    loop: ClosedLoop,
    state: Array,
    *,
    rate: float,
    duration: float,
    every: int = 1,
    schedule: Schedule | None = None,
    progress: Progress | None = None,
    most: int | None = None,
) -> Iterator[Run]:
    """Run a closed loop whose controller reads the state at a fixed rate and holds its outputs, in chunks of rows.

    The plant takes as many integration steps between samples as its motion about the initial state asks for. One sample
    of `every` is recorded; a chunk has at most `most` rows, and by default there is one. Raises what
    `continuous_chunks` does.
    """
    loop.controller.virtual.check_ordinary("a controller with 'observer: exact'")
    if not (rate > 0.0 and duration > 0.0 and every >= 1):
        raise ModelError(f"rate {rate:g}, duration {duration:g}, every {every}: all must be positive")
    substeps, samples = _substeps(loop, state, rate), samples_until(duration, rate)
    y, u, p, first = np.array(state, dtype=float), np.zeros(len(loop.plant.inputs)), loop.values(), 0.0
    changes = [] if schedule is None else np.ceil(schedule.instants * rate * (1.0 - 1e-12)).astype(int).tolist()
    steps = _steps_at_switches(loop.kernels.instants(0.0, duration, u, p), rate, substeps)
    span = every * (most or samples)
    remedy = f"sampled at {rate:g} Hz, inputs are held and act late; raise controller.rate, or try 'rate: continuous'"
    for begin, end in itertools.pairwise(_bounds(0, samples, span, {*changes, *_around(steps)})):
        if begin % span == 0:
            rows = np.arange(begin, min(begin + span, samples), every)
            out_y, out_u = np.empty((len(rows), len(y))), np.empty((len(rows), len(u)))
        count = end - begin
        row = -(-(begin % span) // every)
        if schedule is not None:
            schedule.set(begin / rate * (1.0 + 1e-12), p)
        status, done, first = loop.kernels.run_sampled(
            Samples(begin, count, 1.0 / rate, steps.get(begin, substeps), every),
            y, u, p, first, States(out_y[row:], out_u[row:]),
        )  # fmt: skip
        check_status(loop.kernels, status, (begin + done) / rate, y, remedy)
        if progress is not None:
            progress(end / samples)
        if end % span == 0 or end == samples:
            found = complete(loop, rows / rate, out_y, p, schedule)
            yield Run(found.times, found.rig, found.virtual, out_u)


def _steps_at_switches(instants: Array, rate: float, substeps: int) -> dict[int, int]:
    """Integration steps of the samples in which a plant switches with time: one of them goes over the switch."""
    samples = np.unique(np.floor(instants * rate).astype(int)).tolist()
    fine = max(substeps, min(STEPS_AT_A_SWITCH, MOST_AT_SWITCHES // max(1, len(samples))))
    return dict.fromkeys(samples, fine)


def _around(samples: Iterable[int]) -> set[int]:
    return {cut for sample in samples for cut in (sample, sample + 1)}


def _bounds(first: int, samples: int, span: int, cuts: Iterable[int] = ()) -> list[int]:
    """Where the pieces of a run begin and end: those of progress, of chunks of a span, and cuts besides."""
    pieces = {first + (samples - first) * piece // PIECES for piece in range(PIECES + 1)}
    return sorted(pieces | {*range(0, samples, span)} | {cut for cut in cuts if first < cut < samples})


def run_twin(
    loop: SampledLoop, start: Array, *, duration: float, seed: int, every: int = 1, progress: Progress | None = None
) -> TwinRun:
    """Run a sampled controller around a twin.

    With homing, the twin starts at rest and unpowered, and the record begins at the release. Without one, the twin is
    held at its coordinates `start` (n,), SI units, by the controller's own commands until the first command that was
    made for the release acts. One sample of `every` is recorded, for a duration in s after the release; `seed` is that
    of the sensors' noise. Raises what `continuous_chunks` does.
    """
    return joined(twin_chunks(loop, start, duration=duration, seed=seed, every=every, progress=progress))


def twin_chunks(
    loop: SampledLoop,
    start: Array,
    *,
    duration: float,
    seed: int,
    every: int = 1,
    progress: Progress | None = None,
    most: int | None = None,
) -> Iterator[TwinRun]:
    """Run a controller around a twin as `run_twin` does, in chunks of at most `most` rows; the rest is the same."""
    sampled, twin, kernels = loop.sampled, loop.twin, loop.kernels
    rate, sizes, p = sampled.rate, sampled.sizes, twin.values()
    generator = np.random.default_rng(seed)
    before = sampled.before
    samples = samples_until(duration, rate)
    span = every * (most or samples)
    held = sampled.internal if twin.model.states == sampled.controller.model.states else None
    y, first, substeps = twin.unpowered() if sampled.homing else twin.rest(start, held), 0.0, twin.substeps(rate)
    noise = generator.standard_normal((1, len(twin.sensors)))
    reading = np.empty(len(twin.sensors))
    twin.kernels.sense(-before / rate, y, p, noise[0], reading)
    memory = sampled.begin(reading)
    late = twin.late(rate)
    queue = np.tile(memory.holding, (1 + math.ceil(late.max(initial=0.0)), 1))
    rig, unit = Rig(y, p, queue, late), Unit(memory.x, memory.p, sampled.gain, sampled.limits)
    widths = (len(y), len(memory.x), len(twin.sensors), sizes.actuators, sizes.actuators)
    lasting = np.empty((1, 0))
    remedy = "lower controller.observer.bandwidth, correct controller.model, or raise controller.rate"
    steps = _steps_at_switches(kernels.instants(-before / rate, duration, np.empty(0), p), rate, substeps)
    for begin, end in itertools.pairwise(_bounds(-before, samples, span, _around(steps))):
        if begin == -before or begin % span == 0:
            rows = np.arange(max(0, begin), min(max(0, begin) + span, samples), every)
            out = [np.empty((len(rows), width)) for width in widths]
        count = end - begin
        if begin == 0:
            lasting = sampled.feed.lasting(memory.p)
        more = generator.standard_normal((count - len(noise), len(twin.sensors)))
        noise = np.concatenate([noise, more]) if len(noise) else more
        row = max(0, -(-(begin % span) // every)) if begin > 0 else 0
        piece = Samples(begin, count, 1.0 / rate, steps.get(begin, substeps), every)
        kept = Recorded(*(table[row:] for table in out))
        status, done, first = kernels.run(piece, rig, unit, noise, first, kept)
        check_status(kernels, status, (begin + done) / rate, y, remedy)
        noise = noise[:0]
        if progress is not None:
            progress((end + before) / (samples + before))
        if end > 0 and (end % span == 0 or end == samples):
            states, memories, readings, demanded, applied = out
            estimates, power = memories[:, : sizes.states], memories[:, sizes.power]
            disturbances = memories[:, sizes.states : sizes.states + (sizes.disturbed if sizes.order else 0)]
            yield TwinRun(rows / rate, states, estimates, readings, demanded, applied, power, disturbances, lasting)


def _substeps(loop: ClosedLoop, state: Array, rate: float) -> int:
    """Integration steps between samples that resolve the plant's fastest motion near a state."""
    p, u = loop.values(), np.zeros(len(loop.plant.inputs))

    def slope(y: Array, out: Array) -> None:
        loop.kernels.plant_derivative(0.0, y, u, p, out)

    return steps_between(slope, state, np.resize(loop.match.lengths, len(state)), rate)


Mapped: TypeAlias = ClosedLoop | SampledController
"""A control law with a compiled transform."""


def rig_state(loop: Mapped, virtual_state: Array, passive: Array | None = None, near: Array | None = None) -> Array:
    """Rig state (2 n,) that the transform maps to a virtual state, by Newton's method.

    `virtual_state` has virtual coordinates then velocities (2 k,); what follows is not looked at. `passive` are
    coordinates, then velocities, of those that no virtual one stands for (2 (n - k),); 0 by default, as coordinates
    `near` (n,) at which Newton's method begins. A ModelError where no rig position gives the virtual coordinates.
    """
    lengths = loop.match.lengths
    k = len(loop.controller.virtual.coordinates)
    eta, rate = virtual_state[:k], virtual_state[k : 2 * k] / loop.controller.time_scale
    free = list(loop.match.mapping.passive)
    beside = np.zeros(2 * len(free)) if passive is None else passive
    whole, rates = np.append(eta, beside[: len(free)]), np.append(rate, beside[len(free) :])
    generator = np.random.default_rng(0)
    random = (lengths * generator.uniform(-1.0, 1.0, len(lengths)) for _ in range(50))

    def system(q: Array) -> tuple[Array, Array]:
        value, slope = _map(loop, q)
        return value - whole, slope

    error = 1e-13 * (1.0 + float(np.max(np.abs(whole))))
    first = np.zeros(len(lengths)) if near is None else near.copy()
    first[free] = beside[: len(free)]
    for start in itertools.chain([first], random):
        with contextlib.suppress(RootError):
            q, slope = root(system, start, error=error, lengths=lengths, longest=2.0)
            return np.concatenate([q, np.linalg.lstsq(slope, rates, rcond=None)[0]])
    wanted = ", ".join(f"{n} = {value:g}" for n, value in zip(loop.controller.virtual.coordinates, eta, strict=True))
    raise ModelError(
        f"transform: no rig position gives the initial {wanted}; start elsewhere, or change the transform so that its "
        "range includes this state"
    )


def loop_state(loop: ClosedLoop, virtual_state: Array, rig: Array, internal: Array | None = None) -> Array:
    """State of a closed loop whose virtual system is in a state: the rig's (2 n,), then `ClosedLoop.internal`.

    Where the inputs act through dynamics of their own, it is the nearest in which the rig has the wanted accelerations,
    and what the virtual system does not determine as given; a ModelError where there is none. The rig's internal states
    are near `internal`, by default as declared.
    """
    begun = np.concatenate([rig, loop.plant.first_internal if internal is None else internal])
    moving = begun if loop.controller.is_direct else _accelerating(loop, virtual_state, begun)
    return np.concatenate([moving, virtual_state[2 * len(loop.controller.virtual.coordinates) :]])


def _accelerating(loop: ClosedLoop, virtual_state: Array, begun: Array) -> Array:
    """State of the rig (states,) with a virtual state and the accelerations that are wanted there; see `loop_state`."""
    k, n, p = len(loop.controller.virtual.coordinates), len(loop.plant.coordinates), loop.values()
    mapped, off = np.empty(2 * k), np.empty(sum(loop.controller.degrees) - 2 * k)
    remembered, is_same = virtual_state[2 * k :], loop.plant.state_names == loop.controller.model.state_names
    kept = list(loop.controller.remainder) if is_same else []

    def residual(x: Array) -> Array:
        q, rest = x[:n].copy(), np.concatenate([x[n:], remembered])
        loop.kernels.transform(0.0, q, rest, p, mapped)
        loop.kernels.off(0.0, q, rest, p, off)
        return np.concatenate([mapped - virtual_state[: 2 * k], off, x[kept] - begun[kept]])

    def system(x: Array) -> tuple[Array, Array]:
        value, slope = residual(x), jacobian(residual, x, STEP * np.maximum(np.abs(x), sizes))
        scale = np.maximum(np.abs(slope) @ np.maximum(np.abs(x), sizes), 1e-300)  # rows are of any unit
        return value / scale, slope / scale[:, None]

    sizes = np.concatenate([np.resize(loop.match.lengths, 2 * n), np.ones(len(begun) - 2 * n)])
    try:
        return root(system, begun, error=MANIFOLD).at
    except RootError as error:
        raise ModelError(
            f"{loop.plant.name} has the wanted accelerations in no state near the initial one; start elsewhere, or "
            "give its internal states another initial value"
        ) from error


def _map(loop: Mapped, q: Array) -> tuple[Array, Array]:
    """Virtual coordinates with the passive ones (n,) behind them, and their slope by the rig's (n, n)."""
    n, k = len(q), len(loop.controller.virtual.coordinates)
    p, out = loop.values(), np.empty(2 * k)
    jacobian = np.empty((k, n))
    for i in range(n):
        loop.kernels.transform(0.0, q, np.eye(n)[i], p, out)
        jacobian[:, i] = out[k:] / loop.controller.time_scale
    free = list(loop.match.mapping.passive)
    return np.append(out[:k], q[free]), np.concatenate([jacobian, np.eye(n)[free]])


def complete(loop: ClosedLoop, times: Array, states: Array, p: Array, schedule: Schedule | None) -> Run:
    """Run of a closed loop whose states (m, .), SI units, are known at increasing times (m,).

    `schedule` changes parameters of the loop's array `p` on the way.
    """
    virtual = np.empty((len(times), 2 * len(loop.controller.virtual.coordinates)))
    inputs = np.empty((len(times), len(loop.plant.inputs)))
    for begin, end in schedule.spans(times) if schedule else [(0, len(times))]:
        if schedule is not None:
            schedule.set(float(times[begin]), p)
        rows = slice(begin, end)
        loop.kernels.along(times[rows], states[rows], p, virtual[rows], inputs[rows])
    last = 2 * len(loop.plant.coordinates) + len(loop.internal)
    remembered = states[:, last - len(loop.controller.virtual.states) : last]
    return Run(times, states, np.hstack([virtual, remembered]), inputs)
