"""Synchronisation with respect to any functional of the motions: definitions 5.1 and 5.2."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from masking.analysis.synchronisation.measures import Series, interpolate, synchronisation_time
from masking.errors import RecordError

_EXACT = 1e-9  # of the outputs: rounding, and the tolerance of an integrator
_LAST = 0.2  # part of the record that stands for "t -> infinity"


@dataclass(frozen=True, slots=True)
class Held:
    """How nearly functionals of k motions vanish.

    Args:
        t: time (samples,): the part of the record that holds all shifted outputs.
        g: values of the functionals (samples, functionals), each in the unit of its formula.
        eps: largest |g_j| over the last fifth of that part (functionals,): approximate synchronisation holds for any
            larger one (definition 5.2).
        wanted: the eps that was asked for (functionals,).
        time: first time after which all |g_j| stay below `wanted` (definition 8.1); NaN where they do not.
        is_exact: whether all g_j have vanished but for rounding (definition 5.1).
    """

    t: Series
    g: Series
    eps: Series
    wanted: Series
    time: float
    is_exact: bool

    @property
    def is_approximate(self) -> bool:
        """Whether definition 5.2 holds for the eps that was asked for."""
        return bool(np.all(self.eps <= self.wanted))

    def __str__(self) -> str:
        most = ", ".join(f"{e:.3g}" for e in self.eps)
        if self.is_exact:
            return f"synchronised exactly (definition 5.1), from t = {self.time:.6g} on within eps"
        if not self.is_approximate:
            allowed = ", ".join(f"{e:.3g}" for e in self.wanted)
            return f"not synchronised: |g| is up to {most} at last, more than {allowed}"
        return f"synchronised with eps = {most} (definition 5.2), within eps from t = {self.time:.6g} on"


def held(
    t: Series,
    outputs: Sequence[Series],
    *functionals: Callable[..., Series],
    eps: float | Sequence[float],
    shifts: Sequence[float] = (),
) -> Held:
    """Find out whether motions are synchronised with respect to functionals.

        g_j(sigma_tau1 y_1, ..., sigma_tauk y_k, t),    (sigma_tau y)(t) = y(t + tau)

    Anti-phase of unequal amplitudes is `held(t, [a, b], lambda t, a, b: a - alpha * b, shifts=[0, T / 2], eps=0.01)`.

    Args:
        t: time (samples,), strictly increasing.
        outputs: y_i, each (samples,), any unit.
        functionals: `g(t, y_1, ..., y_k)`, each returns (samples,).
        eps: what |g_j| is to stay below: one for all, or one for each, in the unit of its formula.
        shifts: tau_i of each output, unit of `t`; none where not given.

    Raises:
        RecordError: the series do not fit each other, or the shifts leave nothing of the record.
    """
    t = np.asarray(t, dtype=float)
    taus = [*shifts] if shifts else [0.0] * len(outputs)
    wanted = np.broadcast_to(np.asarray(eps, dtype=float), (len(functionals),)).copy()
    if not functionals or not outputs or len(taus) != len(outputs) or any(np.shape(y) != t.shape for y in outputs):
        raise RecordError(
            f"{len(outputs)} outputs of shapes {', '.join(str(np.shape(y)) for y in outputs)}, {len(taus)} shifts and "
            f"{len(functionals)} functionals for {t.shape} times: give at least one functional, outputs of the shape "
            "of the times, and a shift for each output or none"
        )
    first, last = t[0] - min(0.0, *taus), t[-1] - max(0.0, *taus)
    inside = t[(t >= first) & (t <= last)]
    if len(inside) < 2:
        raise RecordError(f"shifts of {', '.join(f'{tau:g}' for tau in taus)} leave nothing of a record from {t[0]:g} "
                          f"to {t[-1]:g}; shift by less")  # fmt: skip
    shifted = [interpolate(t, np.asarray(y, float), inside + tau) for y, tau in zip(outputs, taus, strict=True)]
    g = np.column_stack([np.broadcast_to(f(inside, *shifted), inside.shape) for f in functionals])
    tail = inside >= inside[-1] - _LAST * (inside[-1] - inside[0])
    found = np.abs(g[tail]).max(axis=0)
    scale = max(float(np.abs(y).max()) for y in shifted)
    return Held(
        t=inside,
        g=g,
        eps=found,
        wanted=wanted,
        time=synchronisation_time(inside, np.max(np.abs(g) / wanted, axis=1), 1.0),
        is_exact=bool(np.all(found <= _EXACT * scale)),
    )
