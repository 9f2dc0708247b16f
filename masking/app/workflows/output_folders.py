"""Folders that results are saved in: they can be written, and hold no other result of the same verb."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from masking.errors import RecordError
from masking.lab.records import stream
from masking.lab.records.owned_folder import OwnedFolder
from masking.lab.records.recording import MANIFEST, TABLE

RUN: Final = (TABLE, MANIFEST, stream.MANIFEST)  # what every run saves, and what one that was killed leaves
_REMEDY: Final = "name another folder with --out, or replace it with --overwrite (in Python, out= and overwrite=True)"


def beside(record: str | Path) -> Path:
    """Folder of a recording, in which what is made of it lies by default."""
    path = Path(record)
    return path if path.is_dir() else path.parent


def check_folder(out: str | Path) -> Path:
    """Folder as a path; a `RecordError` says that it is a file, or may not be written."""
    path = Path(out)
    existing = next(p for p in (path, *path.absolute().parents) if p.exists())
    if not existing.is_dir():
        raise RecordError(f"{existing} is a file; name a folder to save in")
    if not os.access(existing, os.W_OK):
        raise RecordError(f"{existing} may not be written; name another folder to save in")
    return path


@contextmanager
def own_folder(out: str | Path | None, *files: str, overwrite: bool = True) -> Iterator[None]:
    """Context in which no other process writes results into a folder, if there is one.

    `files` are paths below the folder that every result of the verb has. Before anything is run, a `RecordError` says
    what `check_folder` does, that another process owns the folder, or that it holds one of these that may not be
    replaced.
    """
    if out is None:
        yield
        return
    path = check_folder(out)
    with OwnedFolder(path):
        if not overwrite:
            refuse_earlier(path, *files)
        yield


def refuse_earlier(folder: Path, *files: str, remedy: str = _REMEDY) -> None:
    """Refuse a folder that holds one of some files of a result, or the stream of a run, by a `RecordError`."""
    held = [name for name in files if (folder / name).exists()]
    if stream.MANIFEST in held:
        raise RecordError(f"{folder} holds the stream of a run that did not end in order; {stream.MEND.format(folder)}")
    if held:
        raise RecordError(f"{folder} holds an earlier result, {held[0]}; {remedy}")
