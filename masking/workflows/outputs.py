"""Folders that results are saved in."""

from __future__ import annotations

import os
from pathlib import Path

from masking.errors import RecordError


def check_folder(out: str | Path | None) -> None:
    """Refuse a folder that nothing can be written into, before anything is run.

    Raises:
        RecordError: it is a file, or it is or lies in a folder that may not be written.
    """
    if out is None:
        return
    path = Path(out)
    existing = next(p for p in (path, *path.absolute().parents) if p.exists())
    if not existing.is_dir():
        raise RecordError(f"{existing} is a file; name a folder to save in")
    if not os.access(existing, os.W_OK):
        raise RecordError(f"{existing} may not be written; name another folder to save in")
