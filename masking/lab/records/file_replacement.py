"""Replacement of a file: its new content is whole and on disk before it has the name."""

from __future__ import annotations

import glob
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from masking.lab.records.stop_switch import is_running
from masking.lab.records.stream import sync_folder


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Stream whose bytes become the file `path` once all are on disk; after an error `path` is untouched.

    What processes that were killed had begun of it is removed.
    """
    for left in path.parent.glob(f".{glob.escape(path.name)}.*-*.partial"):
        process = left.name.removesuffix(".partial").rpartition(".")[2].partition("-")[0]
        if process.isdigit() and not is_running(int(process)):
            left.unlink(missing_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.partial")
    try:
        with partial.open("wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)  # the new name itself must survive a power cut too
