"""Numbers as text: decimals in ASCII, and nothing else that Python takes for a number, such as `1_000`.

Also whether commas in them are decimal commas.
"""

from __future__ import annotations

import re

_DECIMAL = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
_GROUPED = re.compile(r"(?<![0-9.,])[1-9][0-9]{0,2}(?:,[0-9]{3})+(?![0-9.,eE])")  # 1,234: a comma of either kind
_DECIMAL_COMMA = re.compile(r"(?<![0-9,])0[0-9]*,[0-9]|,[0-9]{1,2}(?![0-9])|,[0-9]{4}|,[0-9]+[eE]")
_MISSING = re.compile(r"[-+]?(?:nan|inf(?:inity)?)", re.IGNORECASE)


def is_decimal(text: str) -> bool:
    """Whether a text is a decimal number, such as -1.5e-3, without blanks around it."""
    return _DECIMAL.fullmatch(text) is not None


def is_number(text: str) -> bool:
    """Whether a text stands for a number: a decimal, or nan or inf, with which programs fill gaps."""
    return is_decimal(text) or _MISSING.fullmatch(text) is not None


def decimal_commas(text: str, separator: str | None) -> tuple[bool, re.Match[str] | None]:
    """Whether commas in a text of numbers are decimal ones, and a number whose comma may stand for thousands.

    That is None where the others, or what separates the numbers, settle it.
    """
    if separator == "," or "," not in text:
        return False, None
    settled = separator == ";" or _DECIMAL_COMMA.search(text) is not None
    return True, None if settled else _GROUPED.search(text)
