"""Following: what an effect makes of a motion that is known at the samples of a record."""

from __future__ import annotations

import numpy as np

from masking.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.numerics.arrays import Array


def follow(
    rig: AugmentedModel,
    instance: EffectInstance,
    x: Array,
    rate: Array,
    *,
    period: float,
    steps: int = 1,
    free: tuple[int, ...] = (),
) -> Array:
    """Return what an effect makes of a motion (m, 1 + f), with its slopes by some of its parameters.

    Args:
        rig: that has the effect.
        instance: the effect with its values.
        x: displacement, command or reading that it acts on (m,).
        rate: of it (m,).
        period: of the samples, s.
        steps: of integration between samples, in which an internal state of the effect is stable.
        free: parameters (f,) by which there are slopes.
    """
    if steps == 1 or not instance.entry.states:
        return rig.along(instance, x, rate, period, free)
    samples = np.arange(len(x))
    between = np.arange((len(x) - 1) * steps + 1) / steps
    x, rate = np.interp(between, samples, x), np.interp(between, samples, rate)
    return np.ascontiguousarray(rig.along(instance, x, rate, period / steps, free)[::steps])
