"""Memory: what is computed of a discovery is computed once, and kept for as long as the discovery lives."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

from masking.discovery.discovery import Discovery

Made = TypeVar("Made")


def once(function: Callable[[Discovery], Made]) -> Callable[[Discovery], Made]:
    """Let a function of a discovery be called once for each; it holds arrays, and has no hash to be found by."""
    known: dict[int, Made] = {}

    @wraps(function)
    def remembered(found: Discovery) -> Made:
        if id(found) not in known:
            known[id(found)] = function(found)
            weakref.finalize(found, known.pop, id(found), None)
        return known[id(found)]

    return remembered
