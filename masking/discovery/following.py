"""Following: what an effect makes of a motion that is known at the samples of a record."""

from __future__ import annotations

import numpy as np

from masking.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.numerics.arrays import Array

FINER, FINEST = 4, 256  # times as many steps that are compared, and most of them between samples
ALIKE = 0.01  # of the largest value, by which finer steps may change what is followed


def follow(
    rig: AugmentedModel,
    instance: EffectInstance,
    x: Array,
    rate: Array,
    *,
    period: float,
    steps: int = 1,
    free: tuple[int, ...] = (),
    finest: int = 0,
) -> Array:
    """Return what an effect makes of a motion (m, 1 + f), with its slopes by some of its parameters.

    A measured motion moves where a simulated one sticks, and the state of a friction that builds up over a short
    displacement would run away there in the steps of a simulation: `finest` lets them become finer.

    Args:
        rig: that has the effect.
        instance: the effect with its values.
        x: displacement, command or reading that it acts on (m,).
        rate: of it (m,).
        period: of the samples, s.
        steps: of integration between samples, in which an internal state of the effect is stable.
        free: parameters (f,) by which there are slopes.
        finest: steps up to which they become finer, until that changes next to nothing; 0 where they do not.
    """
    samples = np.arange(len(x))

    def made_in(steps: int) -> Array:
        if steps == 1 or not instance.entry.states:
            return rig.along(instance, x, rate, period, free)
        between = np.arange((len(x) - 1) * steps + 1) / steps
        moved, moving = np.interp(between, samples, x), np.interp(between, samples, rate)
        return np.ascontiguousarray(rig.along(instance, moved, moving, period / steps, free)[::steps])

    made = made_in(steps)
    while instance.entry.states and steps < finest:
        steps, before = FINER * steps, made[:, 0]
        made = made_in(steps)
        with np.errstate(over="ignore", invalid="ignore"):  # what ran away differs by more than it is
            if np.abs(made[:, 0] - before).max() <= ALIKE * np.abs(made[:, 0]).max():
                break
    return made
