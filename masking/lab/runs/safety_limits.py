"""Safety limits: the `Rules` that `plants.safety_chain` holds a rig to, from a plant file and the model of the rig.

What is limited is an expression of coordinates. Where the sensors determine it, it is computed from their readings,
else from the controller's estimate. How fast a reading may change, and how it answers commands, follows from the
controller's model at rest and from what the twin has beyond it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from masking.compile.numerics import safety_tables
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.controller_sizes import LARGEST
from masking.control.known_instruments import Instruments
from masking.control.rig.twin import Twin
from masking.errors import ModelError
from masking.lab.plants.safety_chain import OFF, ControlledStop, Rules, unknown
from masking.model.declaration.expression import Expression
from masking.model.declaration.instrument_declaration import Limit

_EXACT: Final = 1e-6  # relative: of a linear expression, and of what readings determine
_MARGIN: Final = 1.1  # of the largest speed that follows from the limits
_UNKNOWN: Final = 0.02  # of the acceleration of the largest commands: what a model does not explain, at least
_PART: Final = 0.25  # of the largest command, which a response is to tell
_LONGEST: Final = 0.1  # s over which a speed or a response is taken
_NOISY: Final = 0.1  # of a limited speed: what noise may be of it
_LAG: Final = 0.5  # rad of the fastest mode, by which a speed may be late
_SLOWEST: Final = 1e-3  # of the fastest mode: what is slower has no spring
_PROBES: Final = (0.01, 0.1, 1.0)  # parts of the fastest motion


@dataclass(frozen=True, eq=False)
class _Linear:
    """An expression that is linear in [q, v]: its value at zero, and its slopes (2 n,)."""

    zero: float
    slopes: Array


def rules(instruments: Instruments, rate: float, twin: Twin | None = None, estimate: Array | None = None) -> Rules:
    """Rules that the safety chain holds a rig to.

    Without its twin, which has what it does wrong, a quarter of the largest commands is not explained. `estimate` is
    where the controller has its estimate of [q, v, ...], SI units, if it has one. A ModelError where an actuator has no
    largest command.
    """
    return _Builder(instruments, rate, twin, 0 if estimate is None else len(estimate)).rules()


def limits(instruments: Instruments, rate: float) -> Rules:
    """Rules of a plant for whoever drives it: its limits, as far as its sensors show them; raises what `rules` does."""
    return _Builder(instruments, rate, None, 0).limits()


def without_model(rules: Rules) -> Rules:
    """Rules for a run without a controller, on a rig whose model is still to be found.

    What follows from how the model moves is not watched, nor what only an estimate gives.
    """
    readings = rules.readings.copy()
    readings[:, safety_tables.SPAN] = 0.0
    kept = rules.limits[:, safety_tables.ESTIMATED] == 0.0
    return replace(
        rules,
        readings=readings,
        half=0,
        stop=None,
        limited=tuple(name for name, is_kept in zip(rules.limited, kept, strict=True) if is_kept),
        units=(*rules.units[:2], tuple(x for x, is_kept in zip(rules.units[2], kept, strict=True) if is_kept)),
        limits=rules.limits[kept],
        weights=rules.weights[kept],
        estimated=rules.estimated[kept],
    )


class _Builder:
    """The tables of a chain, one after the other."""

    def __init__(self, instruments: Instruments, rate: float, twin: Twin | None, states: int) -> None:
        self.instruments, self.rate, self.twin, self.states = instruments, rate, twin, states
        self.model, self.count = instruments.model, len(instruments.model.coordinates)
        self.commands = self._commands()
        self.notes: list[str] = []
        self.table = unknown(len(instruments.sensors))
        gains = instruments.gains()
        self.read: list[_Linear | None] = []
        for gain, sensor in zip(gains, instruments.plant.sensors.values(), strict=True):
            found = self._linear(sensor.measures)
            moves = np.flatnonzero(found.slopes) if found else np.empty(0)  # nothing: a live input, such as a knob
            is_position = len(moves) and moves.max() < self.count
            self.read.append(_Linear(gain * found.zero, gain * found.slopes) if found and is_position else None)
        known = [i for i, found in enumerate(self.read) if found is not None]
        self.known, self.sensing = known, np.array([self.read[i].slopes[: self.count] for i in known])  # type: ignore[union-attr]
        self.sensing = self.sensing.reshape(len(known), self.count)

    def rules(self) -> Rules:
        places = [(e, x, self._linear(e)) for e, x in self.instruments.plant.limits.coordinates.items()]
        self._declared()
        motion = self._motion()
        self._jumps(places)
        for name, row in zip(self.instruments.sensors, self.table, strict=True):
            if not row[safety_tables.SPAN] and not row[safety_tables.NOISE]:
                self.notes.append(f"whether {name} sticks is not watched: declare its noise")
        half, delay = self._half(motion), self.instruments.delay
        return replace(self._within(), motion=motion, half=half, delay=delay, stop=self._stop())

    def _stop(self) -> ControlledStop | None:
        """Controlled stop that the plant file declares.

        Brakes make each coordinate slow down by its own speed: a force of -c M v, whatever the masses M are, takes
        energy out in each motion. c is that of critical damping of the slowest mode, or less where delays or noise are
        large. A ModelError where the sensors do not read every coordinate, or the actuators do not push each.
        """
        declared, n = self.instruments.plant.limits.stop, self.count
        samples = math.ceil(declared.time * self.rate)
        if declared.kind != "brake":
            return ControlledStop(samples) if declared.kind == "hold" else None
        dynamics, driven = self.instruments.linear()
        pushed = driven @ self.instruments.allocation
        if min(np.linalg.matrix_rank(x) if x.size else 0 for x in (self.sensing, pushed)) < n:
            raise ModelError(
                f"{self.instruments.plant.name}: 'stop: brake' needs sensors that read every coordinate and actuators "
                "that push each: write 'stop: hold' or leave it out"
            )
        inverse, off = np.linalg.pinv(self.sensing), self.table[:, safety_tables.OFF]
        modes = np.sqrt(np.abs(np.linalg.eigvals(dynamics[n:, :n])))
        fastest, moving = modes.max(), modes[modes > _SLOWEST * modes.max()]
        longest = int(min(_LONGEST, _LAG / fastest if fastest else _LONGEST) * self.rate)
        span = max(1, min(longest, int(self.table[:, safety_tables.SPAN].max())))
        still = 2.0 * off * self.rate / span
        commands = np.zeros((len(self.commands), len(self.table)))
        commands[:, self.known] = -np.linalg.pinv(pushed) @ inverse
        noisy = float((np.abs(commands) @ still / (_PART * self.commands[:, LARGEST])).max())
        lag = (0.5 * span + self.instruments.delay + 1.0) / self.rate
        damping = min(0.5 * _LAG / lag, 2.0 * moving.min(initial=np.inf), 1.0 / noisy if noisy else np.inf)
        settled = round(0.5 * math.pi / moving.min() * self.rate) if moving.size else span
        return ControlledStop(samples, damping * commands, span, still, settled)

    def limits(self) -> Rules:
        """Rules of what is limited alone: readings are finite and within their range."""
        self._declared()
        if self.instruments.plant.limits.stop.kind == "brake":
            self._motion()  # over how many samples a speed is taken
        stop = self._stop()
        self.table[:, safety_tables.STEP], self.table[:, safety_tables.NOISE] = np.inf, 0.0
        self.table[:, safety_tables.SPAN] = 0.0
        return replace(self._within(), stop=stop)

    def _within(self) -> Rules:
        """Rules of what is limited, with the table of sensors as it is."""
        declared = self.instruments.plant.limits
        rows = [*self._limited(declared.coordinates, is_rate=False), *self._limited(declared.velocities, is_rate=True)]
        names, units, limits, weights, estimated = zip(*rows, strict=True) if rows else ((), (), (), (), ())
        sensors, states = len(self.table), max(1, self.states)
        return Rules(
            self.rate, self.instruments.sensors, self.instruments.actuators, self.commands, self.table,
            np.zeros((sensors, sensors + len(self.commands))),
            units=(*self.instruments.units, tuple(units)),
            limited=tuple(names),
            limits=np.array(limits).reshape(len(names), safety_tables.LIMIT_COLUMNS),
            weights=np.array(weights).reshape(len(names), sensors),
            estimated=np.array(estimated).reshape(len(names), states),
            missed=1.0 if declared.missed is None else declared.missed,
            notes=tuple(self.notes),
        )  # fmt: skip

    def _commands(self) -> Array:
        """Table of limits of the actuators (actuators, 6), in their units."""
        known, declared, rows = self.instruments, self.instruments.plant.limits.inputs, []
        table = known.limits()  # of the same actuators: each is declared
        for name in known.actuators:
            limit = declared[name]
            size = known.factors[limit.unit] / known.factors[known.unit(name)]
            rows.append((math.inf if limit.rate is None else limit.rate * size, limit.expiry * size))
        return np.hstack([table, rows])

    def _linear(self, expression: Expression, unit: float = 1.0) -> _Linear | None:
        """Expression of [q, v] that is linear, as a multiple of a unit; None where it is not."""
        names = [*self.model.coordinates, *(f"{c}'" for c in self.model.coordinates)]
        values = self.model.parameter_values()
        if not set(expression.names) <= {*names, *values}:
            return None
        sizes = np.tile(self.model.lengths, 2)

        def at(point: Array) -> float:
            return float(expression.evaluate(values | dict(zip(names, map(float, point), strict=True)))) / unit

        zero = at(np.zeros(len(names)))
        slopes = np.array([(at(row) - zero) / size for row, size in zip(np.diag(sizes), sizes, strict=True)])
        for part in (-1.0, 0.37):  # beside where the slopes are from
            point = part * sizes * np.linspace(1.0, 2.0, len(sizes))
            near = _EXACT * float(sizes.max()) / unit
            if not math.isclose(at(point), zero + slopes @ point, rel_tol=_EXACT, abs_tol=near):
                return None
        return _Linear(zero, slopes)

    def _declared(self) -> None:
        for row, (name, sensor) in zip(self.table, self.instruments.plant.sensors.items(), strict=True):
            if sensor.range is not None:
                row[safety_tables.LEAST], row[safety_tables.MOST] = sensor.range
            if sensor.jump is not None:
                row[safety_tables.STEP] = sensor.jump
            row[safety_tables.NOISE] = self.instruments.noise.get(name, 0.0)
            row[safety_tables.OFF] = OFF * row[safety_tables.NOISE]

    def _motion(self) -> Array:
        """Second derivatives of readings by readings and commands, noted where known (sensors, sensors + actuators)."""
        sensors, channels = len(self.table), len(self.commands)
        motion, pushed, n = np.zeros((sensors, sensors + channels)), np.zeros(sensors), self.count
        if not self.known:
            return motion
        dynamics, driven = self.instruments.linear()
        largest, known = self.commands[:, LARGEST], self.known
        motion[known, sensors:] = self.sensing @ driven @ self.instruments.allocation
        pushed = np.abs(motion[:, sensors:]) @ largest
        if np.linalg.matrix_rank(self.sensing) < n:
            return motion
        inverse = np.linalg.pinv(self.sensing)
        motion[np.ix_(known, known)] = self.sensing @ dynamics[n:, :n] @ inverse
        unexplained = (_UNKNOWN if self._is_known else _PART) * pushed
        unexplained[known] += np.abs(self.sensing) @ self._unexplained(dynamics)
        for i in known:
            row, found = self.table[i], self.read[i]
            row[safety_tables.ORIGIN] = 0.0 if found is None else found.zero
            row[safety_tables.UNEXPLAINED] = unexplained[i]
            if row[safety_tables.OFF] > 0.0 and unexplained[i] > 0.0:
                span = math.sqrt(2.0 * row[safety_tables.OFF] / unexplained[i])
                row[safety_tables.SPAN] = max(1, round(min(span, _LONGEST) * self.rate))
        return motion

    @property
    def _is_known(self) -> bool:
        """Whether a twin shows what the rig has beyond the model."""
        return self.twin is not None and self.twin.model.coordinates == self.model.coordinates

    def _unexplained(self, dynamics: Array) -> Array:
        """Accelerations (n,) of the twin that the linear model without damping does not have."""
        n, found = self.count, np.zeros(self.count)
        if self.twin is None or not self._is_known:
            return found
        rest, p, out = self.twin.unpowered(), self.twin.values(), np.empty(len(self.twin.state_names))
        commands = np.zeros(len(self.twin.actuators))
        fastest = float(np.sqrt(np.abs(np.linalg.eigvals(dynamics[n:, :n])).max()))
        speeds = fastest * self._reach()
        for part in _PROBES:
            for moving in (*np.diag(speeds), *-np.diag(speeds)):
                state = rest.copy()
                state[n : 2 * n] = part * moving
                self.twin.kernels.twin_derivative(0.0, state, commands, p, out)
                found = np.maximum(found, np.abs(out[n : 2 * n] - dynamics[n:, :n] @ rest[:n]))
        return found if np.isfinite(found).all() else np.full(n, np.inf)

    def _reach(self) -> Array:
        """How far each coordinate goes (n,): its own limit, or else the least of the limits, or its unit."""
        declared = self.instruments.plant.limits.coordinates
        bounds = [x.max * self.instruments.factors[x.unit] for x in declared.values()]
        reach = np.full(self.count, min(bounds)) if bounds else self.model.lengths.copy()
        for i, name in enumerate(self.model.coordinates):
            own = [b for e, b in zip(declared, bounds, strict=True) if e.text == name]
            reach[i] = own[0] if own else reach[i]
        return np.asarray(reach)

    def _pushed(self) -> Array:
        """Second derivatives of readings (sensors,), by what moves the model at its place and its largest commands."""
        model, found = self.model, np.zeros(len(self.table))
        p, internal, out = model.values(), model.first_internal, np.empty(2 * self.count + len(model.first_internal))
        state = np.concatenate([model.first_place, np.zeros(self.count), internal])

        def read(inputs: Array) -> Array:
            model.kernels.derivative(0.0, state, inputs, p, out)
            return self.sensing @ out[self.count : 2 * self.count]

        still = read(np.zeros(len(model.inputs)))
        pushes = np.ascontiguousarray((self.instruments.allocation * self.commands[:, LARGEST]).T)
        by_each = [np.maximum(np.abs(read(u) - still), np.abs(read(-u) - still)) for u in pushes]
        found[self.known] = np.abs(still) + sum(by_each)
        return found

    def _jumps(self, places: list[tuple[Expression, Limit, _Linear | None]]) -> None:
        """Fill in how far each reading may change in a sample, where a speed follows from the limits.

        A reading that may reach R, in a rig whose fastest motion has the angular frequency w and whose commands push it
        with a, has at most the speed sqrt(w^2 R^2 + 4 a R): what a spring holds there, and the work of a over 2 R.
        """
        factors, n, pushed = self.instruments.factors, self.count, self._pushed()
        dynamics, _ = self.instruments.linear() if self.known else (np.zeros((2 * n, 2 * n)), None)
        fastest = float(np.abs(np.linalg.eigvals(dynamics)).max(initial=0.0))
        reaches = [(x.max * factors[x.unit], e.slopes[:n]) for _, x, e in places if e is not None]
        rates = [
            (x.max * factors[x.unit], e.slopes[:n])
            for text, x in self.instruments.plant.limits.velocities.items()
            if (e := self._linear(text)) is not None
        ]
        for i, name in enumerate(self.instruments.sensors):
            row, found = self.table[i], self.read[i]
            if math.isfinite(row[safety_tables.STEP]):
                continue
            speed = math.inf
            if found is not None:
                speed = _reached(found.slopes[:n], rates)
                far = min(
                    _reached(found.slopes[:n], reaches),
                    max(abs(row[safety_tables.LEAST] - found.zero), abs(row[safety_tables.MOST] - found.zero)),
                )
                speed = min(speed, math.sqrt(fastest**2 * far**2 + 4.0 * pushed[i] * far))
            if math.isfinite(speed):
                row[safety_tables.STEP] = _MARGIN * speed / self.rate + 2.0 * row[safety_tables.OFF]
            else:
                self.notes.append(f"jumps of {name} are not watched: give sensors.{name}.jump")

    def _limited(
        self, declared: Mapping[Expression, Limit], *, is_rate: bool
    ) -> Iterator[tuple[str, str, Array, Array, Array]]:
        """Name, unit, row of the table, and weights in readings and in the estimate of each limit, in its own unit."""
        for expression, limit in declared.items():
            found, bound = self._linear(expression, self.instruments.factors[limit.unit]), limit.max
            row, weights = np.zeros(safety_tables.LIMIT_COLUMNS), np.zeros(len(self.table))
            estimated, slopes = np.zeros(max(1, self.states)), np.zeros(2 * self.count)
            row[safety_tables.BOUND] = bound
            if found is not None:
                slopes = found.slopes
                row[safety_tables.AT_ZERO] = 0.0 if is_rate else found.zero
                if self.known and not slopes[self.count :].any():
                    weights[self.known] = np.linalg.pinv(self.sensing.T) @ slopes[: self.count]
            left = np.abs(weights[self.known] @ self.sensing - slopes[: self.count]).max(initial=0.0)
            by_readings = weights.any() and left <= _EXACT * np.abs(slopes).max()
            if by_readings:
                zeros = sum(weights[i] * one.zero for i in self.known if (one := self.read[i]) is not None)
                row[safety_tables.AT_ZERO] -= 0.0 if is_rate else zeros
                noise = float(np.abs(weights) @ self.table[:, safety_tables.OFF])
                row[safety_tables.BOUND] += 0.0 if is_rate else noise  # which is no motion
                least = math.ceil(noise / (_NOISY * bound) * self.rate)
                row[safety_tables.OVER] = max(1, min(least, round(_LONGEST * self.rate))) if is_rate else 0
            elif found is not None and self.states >= 2 * self.count:
                weights[:] = 0.0
                first = self.count if is_rate else 0
                estimated[first : 2 * self.count] = slopes[: 2 * self.count - first]
                row[safety_tables.ESTIMATED], row[safety_tables.OVER] = 1.0, float(is_rate)
            else:
                what = f"the rate of {expression.text}" if is_rate else expression.text
                self.notes.append(f"{what} is limited and not watched: neither the sensors nor an estimate give it")
                continue
            yield expression.text, limit.unit, row, weights, estimated

    def _half(self, motion: Array) -> int:
        """Half the window in which the response to a part of the largest command is clear of noise."""
        sensors = len(self.table)
        spans = []
        for j, largest in enumerate(self.commands[:, LARGEST]):
            seen = [i for i in range(sensors) if self.table[i, safety_tables.SPAN] and motion[i, sensors + j]]
            noise = 8.0 * safety_tables.CLEAR * self.table[:, safety_tables.OFF]
            own = [noise[i] / (_PART * largest * abs(motion[i, sensors + j])) for i in seen]
            if own:
                spans.append(math.sqrt(min(own)))
        return min(max(2, math.ceil(max(spans) * self.rate)), round(_LONGEST * self.rate)) if spans else 0


def _reached(slopes: Array, limited: list[tuple[float, Array]]) -> float:
    """How large a combination of limited expressions may become, infinite where it is none of them."""
    if not limited:
        return math.inf
    rows = np.array([row for _, row in limited])
    parts = np.linalg.pinv(rows.T) @ slopes
    if np.abs(parts @ rows - slopes).max() > _EXACT * np.abs(slopes).max():
        return math.inf
    return float(np.abs(parts) @ np.array([bound for bound, _ in limited]))
