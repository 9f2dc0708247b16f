"""Files that somebody names: regular ones alone, since to open another may wait for ever, and never comes to an end."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO, Final

LARGEST: Final = 2**27  # bytes of a file that is read whole; of JSON, they take some ten times as many in memory


def opened(path: str | Path) -> BinaryIO:
    """Open a file to be read; an OSError where that is not possible, or it is a pipe, a device, a socket or a folder.

    Links are followed: what counts is where they end.
    """
    if stat.S_ISREG(Path(path).stat().st_mode):
        flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
        handle = os.open(path, flags)
        if stat.S_ISREG(os.fstat(handle).st_mode):  # and not another since
            return os.fdopen(handle, "rb")
        os.close(handle)
    raise OSError(errno.EINVAL, "it is no regular file", str(path))


def content(path: str | Path, most: int = LARGEST) -> bytes:
    """Read a whole file; an OSError as of `opened`, and where it has more than `most` bytes."""
    with opened(path) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EINVAL, f"it has more than {most} bytes", str(path))
    return data
