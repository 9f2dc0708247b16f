"""Estimates: parameters that were found, whatever the method, as JSON and as lines to read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from masking.identification.fit import Fit
    from masking.identification.innovations import KalmanFit

T_95 = 1.959963984540054


def parameters(found: Fit | KalmanFit) -> dict[str, Any]:
    """Return values and deviations as JSON can hold them."""
    pairs = zip(found.names, found.values, found.std, strict=True)
    return {name: {"value": float(value), "std": float(std)} for name, value, std in pairs}


def lines(found: Fit | KalmanFit) -> list[str]:
    """Return a line for each parameter, with half its 95 % interval, and one for the errors."""
    width = max(map(len, found.names), default=0)
    rows = [
        f"  {name:{width}}  {value:<12.6g} +- {T_95 * std:.2g}"
        for name, value, std in zip(found.names, found.values, found.std, strict=True)
    ]
    told = [f"chi {_each(found.chi)}"]
    if found.validation:
        told.append(f"on unseen data {_each(found.validation)}")
    return [*rows, "; ".join([*told, f"the noise alone {_each(found.floor)}"])]


def _each(errors: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in errors.items())
