"""Numbers as text: decimals in ASCII, and nothing else that Python takes for a number, such as `1_000`."""

from __future__ import annotations

import re

_DECIMAL = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
_MISSING = re.compile(r"[-+]?(?:nan|inf(?:inity)?)", re.IGNORECASE)


def is_decimal(text: str) -> bool:
    """Whether a text is a decimal number, such as -1.5e-3, without blanks around it."""
    return _DECIMAL.fullmatch(text) is not None


def is_number(text: str) -> bool:
    """Whether a text stands for a number: a decimal, or nan or inf, with which programs fill gaps."""
    return is_decimal(text) or _MISSING.fullmatch(text) is not None
