"""Owner of a folder: one process, with those that it hands the lock on to, writes results into it.

    .masking-owner    process, and what it does; locked until the last of its owners has ended, and removed then

A lock goes with its processes: after a crash, a power cut or SIGKILL the folder is free.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from pathlib import Path
from typing import Final, Self, final

from masking.errors import RecordError

if sys.platform != "win32":
    import fcntl

OWNER: Final = ".masking-owner"
_LOOK: Final = 0.05  # s between looks at a lock


@final
class OwnedFolder:
    """A folder, made if need be, into which only this process writes; a context.

    Another owner is waited for `patience` s. `handle` is what a child process inherits to be an owner, too. A
    RecordError where the folder cannot be written, or another process owns it. On Windows, whose locks no child
    inherits, folders have no owners.
    """

    def __init__(self, folder: str | Path, patience: float = 0.0) -> None:
        self.folder, self.handle = Path(folder), -1
        self._made = [path for path in (self.folder, *self.folder.absolute().parents) if not path.exists()]
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if sys.platform != "win32":
                self.handle = self._locked(time.monotonic() + patience)
        except OSError as error:
            self._leave()
            message = f"{self.folder} cannot be written: {error.strerror or error}; name another folder"
            raise RecordError(message) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.handle >= 0:
            (self.folder / OWNER).unlink(missing_ok=True)  # first: whoever waits for it sees that it is another's
            os.close(self.handle)
        self._leave()

    def _leave(self) -> None:
        """Remove the folders that were made, where nothing was saved."""
        for path in self._made:
            with contextlib.suppress(OSError):
                path.rmdir()

    def _locked(self, until: float) -> int:
        """Handle of the file that says who owns the folder, once it is this process's."""
        path = self.folder / OWNER
        while True:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            try:
                if _is_had(handle, path):
                    with contextlib.suppress(OSError):  # a full disk: the folder is owned all the same
                        os.ftruncate(handle, os.write(handle, f"process {os.getpid()}".encode()))
                    return handle
                owner = os.read(handle, 100).decode(errors="replace")
            except BaseException:
                os.close(handle)
                raise
            os.close(handle)
            if time.monotonic() > until:
                who = owner if owner.isprintable() and owner else "another process"
                remedy = "wait for its end, stop it, or name another folder"
                raise RecordError(f"{who} writes into {self.folder}; {remedy}")
            time.sleep(_LOOK)


def _is_had(handle: int, path: Path) -> bool:
    """Lock a file; tell whether it is this process's, and still the one of that name."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:  # its last owner has removed it meanwhile
        return False
