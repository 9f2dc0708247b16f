"""What nobody has foreseen, as a sentence for whoever runs the program, and a file for whoever corrects it."""

from __future__ import annotations

import contextlib
import os
import platform
import sys
import tempfile
import traceback
from collections.abc import Sequence
from importlib.metadata import version
from typing import Final

from masking.errors import MaskingError

DEFECT: Final = 70  # exit status: EX_SOFTWARE of sysexits.h
_LONGEST: Final = 300  # characters of an error's own text


def said(error: Exception, arguments: Sequence[str]) -> tuple[str, int]:
    """Sentence on an error that no other part of the program has put into words, and the exit status.

    The sentence names a file, which only this user can read, with the traceback, the versions and the arguments.
    """
    text = "".join(c if c.isprintable() else " " for c in str(error))[:_LONGEST]
    log = _log(error, arguments)
    more = f"; {log} has the details" if log else ""
    if isinstance(error, MemoryError):
        given = f" ({text})" if text else ""
        return f"there is not enough memory{given}: give fewer runs, samples or columns at once{more}", 1
    if isinstance(error, RecursionError):
        return f"what was given is nested deeper than can be followed; make it flatter{more}", 2
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}{more}", MaskingError.exit_status
    report = f"; please report it, with {log}" if log else "; please report it"
    return f"a defect of this program: {type(error).__name__}: {text}{report}", DEFECT


def _log(error: Exception, arguments: Sequence[str]) -> str:
    """Path of a new file on an error; empty where none can be written."""
    with contextlib.suppress(OSError):
        handle, path = tempfile.mkstemp(prefix="masking-", suffix=".log")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            versions = [f"{name} {version(name)}" for name in ("masking", "numpy", "scipy", "sympy", "numba")]
            print("arguments:", *map(repr, arguments), file=file)
            print(
                "versions:", f"Python {sys.version.split()[0]}", *versions, platform.platform(), sep="\n  ", file=file
            )
            print(*traceback.format_exception(error), sep="", file=file)
        return path
    return ""
