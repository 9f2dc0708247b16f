"""Estimates: parameters that were found, whatever the method, as JSON and as lines to read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from masking.numerics.arrays import Array

Z_975 = 1.959963984540054  # quantile of the normal distribution


class Estimate(Protocol):
    """Parameters found by any method."""

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the parameters."""

    @property
    def values(self) -> Array:
        """Return the values (k,)."""

    @property
    def std(self) -> Array:
        """Return the standard deviations (k,)."""

    @property
    def chi(self) -> dict[str, float]:
        """Return the relative error by sensor."""

    @property
    def validation(self) -> dict[str, float]:
        """Return the relative error by sensor on validation records."""

    @property
    def floor(self) -> dict[str, float]:
        """Return the relative error that the noise alone makes, by sensor."""


def parameters(found: Estimate) -> dict[str, Any]:
    """Return values and deviations as JSON can hold them."""
    pairs = zip(found.names, found.values, found.std, strict=True)
    return {name: {"value": float(value), "std": float(std)} for name, value, std in pairs}


def lines(found: Estimate) -> list[str]:
    """Return a line for each parameter, with half its 95 % interval, and one for the errors."""
    width = max(map(len, found.names), default=0)
    rows = [
        f"  {name:{width}}  {value:<12.6g} +- {Z_975 * std:.2g}"
        for name, value, std in zip(found.names, found.values, found.std, strict=True)
    ]
    text = [f"chi {_each(found.chi)}"]
    if found.validation:
        text.append(f"on unseen data {_each(found.validation)}")
    return [*rows, "; ".join([*text, f"the noise alone {_each(found.floor)}"])]


def _each(errors: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in errors.items())
