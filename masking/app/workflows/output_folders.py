"""Folders that results are saved in: they can be written, and hold no other result of the same verb."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from masking.errors import RecordError
from masking.lab.records import stream
from masking.lab.records.recording import MANIFEST, TABLE

RUN: Final = (TABLE, MANIFEST, stream.MANIFEST)  # what every run saves, and what one that was killed leaves
_REMEDY: Final = "name another folder with --out, or replace it with --overwrite (in Python, out= and overwrite=True)"


def beside(record: str | Path) -> Path:
    """Folder of a recording, in which what is made of it lies by default."""
    path = Path(record)
    return path if path.is_dir() else path.parent


def check_folder(out: str | Path | None, *files: str, overwrite: bool = True) -> None:
    """Refuse a folder that cannot be written, or one that holds an earlier result, before anything is run.

    `files` are paths below the folder that every result of the verb has. A `RecordError` says that it is a file, may
    not be written, or holds one of these that may not be replaced.
    """
    if out is None:
        return
    path = Path(out)
    existing = next(p for p in (path, *path.absolute().parents) if p.exists())
    if not existing.is_dir():
        raise RecordError(f"{existing} is a file; name a folder to save in")
    if not os.access(existing, os.W_OK):
        raise RecordError(f"{existing} may not be written; name another folder to save in")
    held = [name for name in files if (path / name).exists()]
    if stream.MANIFEST in held and not overwrite:
        raise RecordError(f"{path} holds the stream of a run that did not end in order; {stream.MEND.format(path)}")
    if held and not overwrite:
        raise RecordError(f"{path} holds an earlier result, {held[0]}; {_REMEDY}")
