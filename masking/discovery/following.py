"""Following: what an effect makes of a motion that is known at the samples of a record."""

from __future__ import annotations

import numpy as np

from masking.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.numerics.arrays import Array

FINER, MOST = 4, 256  # times as many steps that are compared, and most of them between samples
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


def followed(
    rig: AugmentedModel,
    instance: EffectInstance,
    x: Array,
    rate: Array,
    *,
    period: float,
    steps: int = 1,
    free: tuple[int, ...] = (),
) -> Array:
    """Return what an effect makes of a motion (m, 1 + f), in steps of which finer ones change next to nothing.

    A measured motion moves where a simulated one sticks, and the state of a friction that builds up over a short
    displacement would run away there in the steps of a simulation.

    Args:
        rig: that has the effect.
        instance: the effect with its values.
        x: displacement, command or reading that it acts on (m,).
        rate: of it (m,).
        period: of the samples, s.
        steps: of integration between samples to begin with.
        free: parameters (f,) by which there are slopes.
    """
    made = follow(rig, instance, x, rate, period=period, steps=steps, free=free)
    while instance.entry.states and steps < MOST:
        steps, before = FINER * steps, made[:, 0]
        made = follow(rig, instance, x, rate, period=period, steps=steps, free=free)
        with np.errstate(over="ignore", invalid="ignore"):  # what ran away differs by more than it is
            if np.abs(made[:, 0] - before).max() <= ALIKE * np.abs(made[:, 0]).max():
                break
    return made
