"""Checks of what a signal is asked to be: each refuses with what was given, what is allowed, and the remedy."""

from __future__ import annotations

import math
import numbers
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from masking.compile.numerics.arrays import Array
from masking.display.characters import visible_line
from masking.errors import ModelError


def real(what: str, value: object) -> float:
    """Finite number; a ModelError where it is none."""
    if isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value):
        return float(value)
    raise ModelError(f"{what} is {value!r}; give a finite number")


def positive(what: str, value: object, unit: str = "") -> float:
    """Positive, finite number; a ModelError where it is none, with its name and unit."""
    found = real(what, value)
    if found > 0.0:
        return found
    raise ModelError(f"{what} is {found:g}{f' {unit}' * bool(unit)}; give a number above 0")


def count(what: str, value: object, least: int = 1) -> int:
    """Whole number of at least `least`; a ModelError where it is none."""
    if isinstance(value, numbers.Integral) and not isinstance(value, bool) and int(value) >= least:
        return int(value)
    raise ModelError(f"{what} is {value!r}; give a whole number of at least {least}")


def row(what: str, values: ArrayLike, length: int | None = None) -> Array:
    """Finite numbers as a read-only array (length,), one number repeated.

    A ModelError where they are no such numbers; any number of them will do where no length is given. `what` is their
    name, in the plural.
    """
    try:
        found = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ModelError(f"the {what} are not real numbers ({error})") from None
    if found.ndim == 0:
        found = np.full(1 if length is None else length, float(found))
    if found.ndim != 1 or not len(found):
        raise ModelError(f"the {what} have shape {found.shape}; give one number or a list of numbers")
    if length is not None and len(found) != length:
        raise ModelError(f"{len(found)} {what} for {length} lines; give one for each line, or one for all")
    bad = np.flatnonzero(~np.isfinite(found))
    if len(bad):
        what = f"number {bad[0]} of the {what} (they count from 0) is {found[bad[0]]}"
        raise ModelError(f"{what}; give finite numbers")
    found.flags.writeable = False
    return found


def below_nyquist(what: str, frequency: float, rate: float) -> None:
    """Refuse a frequency that is not below half the rate, both in Hz, with a ModelError."""
    if frequency >= rate / 2:
        raise ModelError(
            f"{what} {frequency:.6g} Hz is not below half the rate {rate:g} Hz; take a rate above "
            f"{2 * frequency:.6g} Hz, or leave out what lies at or above {rate / 2:g} Hz"
        )


def samples(what: str, seconds: float, rate: float, least: int) -> int:
    """How many samples a part of a signal lasts, s at a rate in Hz; a ModelError where there are fewer than `least`."""
    found = round(seconds * rate)
    if found < least:
        raise ModelError(
            f"{what} of {seconds:g} s has {found} samples at {rate:g} Hz, at least {least} are needed; take "
            f"{least / rate:g} s or more, or a rate of {least / seconds:g} Hz or more"
        )
    return found


def names(what: str, values: Sequence[str]) -> tuple[str, ...]:
    """Different texts, not empty and without brackets, which hold units in a csv; a ModelError where they are none."""
    found = (values,) if isinstance(values, str) else tuple(values)
    for name in found:
        if not is_plain(name) or not name or name != name.strip():
            raise ModelError(f"{what} {name!r} is not a name; give a text without brackets or spaces around it")
        if found.count(name) > 1:
            raise ModelError(f"{what} '{name}' appears more than once; give each channel a name of its own")
    return found


def is_plain(text: object) -> bool:
    """Whether something is a text in a line, without brackets and control characters."""
    return isinstance(text, str) and not set(text) & set("[]") and text == visible_line(text)
