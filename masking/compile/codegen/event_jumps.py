"""Jumps: what happens at the events of compiled dynamics while they are integrated."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn, Protocol

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.compile.numerics.stop_codes import EVENT, TOO_SMALL_STEP
from masking.errors import IntegrationError

INSTANT = 1e-9  # part of the time within which an event does not come twice, if it does not come without end
FIRST_STEP = 0.1  # of the time since the last event
SHORTEST = 1e-12  # first step, as a part of the time: integrators refuse shorter ones


class Functions(Protocol):
    """The functions of a generated module."""

    @property
    def meta(self) -> Mapping[str, Any]:
        """Description of the module."""

    def __getattr__(self, name: str) -> Callable[..., Any]: ...


class Jumps:
    """The events of one integration, over times (m,) that increase (else an `IntegrationError`), from the first state.

    `state` is this state, and behind it what the integrator knows of the events, changed in place; `log`, the time and
    the name of each event.
    """

    def __init__(self, kernels: Functions, times: Array, state: Array, parameters: Array) -> None:
        if times[-1] < times[0]:
            raise IntegrationError("events are integrated forwards only: let times increase")
        meta = kernels.meta
        self.names: Sequence[str] = meta["events"]
        self.log: list[tuple[float, str]] = []
        self._kernels, self._p, self._size = kernels, parameters, len(state)
        self._values, self._last = np.empty(len(self.names) + len(meta["targets"])), float(times[0])
        self._span = max(float(times[-1] - times[0]), abs(float(times[0])))
        kernels.conditions(self._last, np.array(state, dtype=float), parameters, self._values)
        below = (self._values[: len(self.names)] < 0.0).astype(float)
        self.state = np.concatenate([state, below, [math.inf]])
        self._latest = dict.fromkeys(self.names, -math.inf)

    def follow(self, status: int, t: float) -> bool:
        """Jump if an integration stopped at an event, and tell whether it did; refuses one that comes without end."""
        events = slice(self._size, self._size + len(self.names))
        self.state[-1] = math.inf
        if status != EVENT:
            recent = [name for at, name in self.log[-1:] if t - at <= self._resolved(t)]
            if status == TOO_SMALL_STEP and recent:
                self._refuse(recent[0], t)
            return False
        counts = np.zeros(len(self.names))
        state = self.state[: self._size]
        has_ended = self._kernels.jump(t, state, self._p, self.state[events], counts, self._values)
        happened = [name for name, count in zip(self.names, counts, strict=True) for _ in range(int(count))]
        self.log += [(t, name) for name in happened]
        if not has_ended:
            self._refuse(self.names[int(np.argmax(counts))], t)
        for name in set(happened):
            if t - self._latest[name] <= self._resolved(t):
                self._refuse(name, t)
            self._latest[name] = t
        self.state[-1] = max(FIRST_STEP * (t - self._last), SHORTEST * max(abs(t), self._span))
        self._last = t
        return True

    def _resolved(self, t: float) -> float:
        return INSTANT * max(abs(t), self._span)

    def _refuse(self, name: str, t: float) -> NoReturn:
        raise IntegrationError(
            f"the event '{name}' comes again and again, without end, at t = {t:.9g}; end the times before that, or "
            "write what brings the motion to rest there as a force, as the contact of models/bouncing_ball.yaml"
        )
