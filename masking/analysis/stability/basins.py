"""Basins: at which motion a system ends, over a grid of initial states."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from masking.analysis.stability.modes import pair_of
from masking.compile.numerics.arrays import Array
from masking.errors import ModelError
from masking.model.modelling.model import Model

LABELS: Final = ("rest", "in-phase", "anti-phase", "other", "lost")
_ROWS = 400  # samples of the last part
_REST = 1e-3  # of the largest value of the grid: what stays below is at rest
_TOLERANCE = 1e-8  # local relative error of integration, far below what tells two ends apart


@dataclass(frozen=True)
class Basins:
    """At which motion each initial state ends."""

    names: tuple[str, str]  # of the two states that are varied
    first: Array  # values of the first (m,), in declared units
    second: Array  # values of the second (k,)
    ends: NDArray[np.int64]  # index into `LABELS` (m, k)

    def shares(self) -> dict[str, float]:
        """Part of the grid that ends at each motion."""
        return {label: float(np.mean(self.ends == i)) for i, label in enumerate(LABELS)}


def basins(
    model: Model,
    first: tuple[str, Array],
    second: tuple[str, Array],
    *,
    duration: float,
    last: float,
    initial: Mapping[str, float] | None = None,
    near: float = 0.1,
    progress: Callable[[float], None] | None = None,
) -> Basins:
    """Simulate from a grid of initial states and tell where each motion ends.

    Args:
        model: with two oscillators, in SI units or in its scales.
        first: a coordinate or velocity (`x1'`), and its values in declared units.
        second: another.
        duration: of each motion, in units of the model's time.
        last: the last part of it, some periods, from which the end is classified.
        initial: of all other states; as declared where not given.
        near: in phase where |a - b|, in anti-phase where |a + b| of the oscillations a and b about their means stays
            below this part of the larger one; at rest where both stay below 0.1 % of the largest value of the grid.
        progress: called with the part done.

    Raises:
        ModelError: there are not two oscillators, or a state is unknown.
    """
    pair = pair_of(model)
    if not 0.0 < last < duration:
        raise ModelError(f"the last part, {last:g}, must be shorter than the duration, {duration:g}, and positive")
    a, b = np.asarray(first[1], dtype=float), np.asarray(second[1], dtype=float)
    times = np.concatenate([[0.0], np.linspace(duration - last, duration, _ROWS)])
    starts = model.initial_state({**(initial or {}), first[0]: a[:, None], second[0]: b})
    size = float(np.max(np.abs(starts[..., : len(model.coordinates)]))) or 1.0
    ends = np.zeros((len(a), len(b)), dtype=np.int64)
    for i, value in enumerate(a):
        ensemble = {first[0]: np.full(len(b), value), second[0]: b}
        found = model.simulate(times, initial, tolerance=_TOLERANCE, ensemble=ensemble)
        ends[i] = end_of(found[pair[0]][:, 1:], found[pair[1]][:, 1:], near, _REST * size)
        if progress is not None:
            progress((i + 1) / len(a))
    return Basins((first[0], second[0]), a, b, ends)


def end_of(a: Array, b: Array, near: float, rest: float | Array) -> NDArray[np.int64]:
    """Index into `LABELS` of the last part of two oscillations (m,) of one unit, or those of several runs (runs,).

    Oscillations of several runs are (runs, m). `near` is as `basins` has it, `rest` the size below which both are at
    rest, or of each run (runs,).
    """
    with np.errstate(invalid="ignore"):  # what is infinite is lost
        a, b = (x - np.mean(x, axis=-1, keepdims=True) for x in (a, b))
        one, other, apart, together = (np.max(np.abs(x), axis=-1) for x in (a, b, a - b, a + b))
        larger = np.maximum(one, other)
    cases = [~np.isfinite(larger), larger < rest, apart < near * larger, together < near * larger]
    kinds = [LABELS.index(kind) for kind in ("lost", "rest", "in-phase", "anti-phase")]
    return np.asarray(np.select(cases, kinds, LABELS.index("other")), dtype=np.int64)
