"""sympy, imported where it is first used: what has been compiled runs without it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader as lazy

if TYPE_CHECKING:
    import sympy as sp
else:
    sp = lazy.load("sympy")

__all__ = ["sp"]
