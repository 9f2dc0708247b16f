"""Nesting: a simple law begun from the values of a richer one that it is a special case of."""

from __future__ import annotations

import numpy as np

from masking.discovery.augmented_model import EffectInstance


def begun(simple: EffectInstance, richer: EffectInstance) -> EffectInstance:
    """Return a simple law with the fitted values of a richer one.

    Factors without a namesake, as the one level of dry friction for the two of an asymmetric one, begin at the mean.

    Args:
        simple: the law, with values of its own for what the richer one does not have.
        richer: the fitted law.
    """
    values = dict(zip(richer.names, richer.estimated, strict=True))
    levels = [values[name] for name in richer.entry.factors if name in values]
    starts = {name: float(np.mean(levels)) for name in simple.entry.factors if levels} | values
    shared = [i for i, name in zip(simple.free, simple.names, strict=True) if name in starts]
    return simple.with_values(shared, (starts[name] for name in simple.names if name in starts))
