"""Files that several processes may make at the same time, and that are executed: only what this user wrote is read.

A file stands behind a checksum of its name and content. One that is damaged, that another user owns or may write, or
that is no regular file is not read, with one line of notice; whoever wants it makes it anew. Where it cannot be written
it goes to a private folder that lasts as long as the process, with one line of notice, too.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import os
import shutil
import stat
import sys
import tempfile
from functools import cache
from pathlib import Path

SEAL = hashlib.sha256().digest_size
LARGEST = 2**28  # bytes of a file that is read
_OTHERS = stat.S_IWGRP | stat.S_IWOTH


class UntrustedError(OSError):
    """What is at a path must not be executed; says why."""


def keep(target: Path, content: bytes) -> None:
    """Write a sealed file, or if it cannot be written there, one in the private folder of this process; or none."""
    try:
        write_sealed(target, content)
    except OSError as error:
        try:
            other = elsewhere(target)
            write_sealed(other, content)
            where = f"they are kept in {other.parents[1]} until this process ends"
        except OSError:
            where = "they are made anew in each process"
        reason = str(error) if isinstance(error, UntrustedError) or not error.strerror else error.strerror
        notice("kept", f"generated files cannot be kept in {target.parents[1]} ({reason}): {where}")


def find(source: Path) -> bytes | None:
    """Content of a sealed file, or of the one in the private folder of this process; None without either."""
    content = read_sealed(source)
    return read_sealed(elsewhere(source)) if content is None and _private.cache_info().currsize else content


def elsewhere(target: Path) -> Path:
    """Path in the private folder of this process that stands for a path that cannot be written."""
    return _private() / target.parent.name / target.name


def write_whole(target: Path, content: bytes) -> None:
    """Write a file whole or not at all; a reader sees the old file or the new one, also after a power cut."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=target.parent, suffix=".tmp", delete=False) as file:  # of mode 0600
        try:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())  # it is on the disk before it gets its name
            Path(file.name).replace(target)
        except BaseException:
            Path(file.name).unlink(missing_ok=True)
            raise


def write_sealed(target: Path, content: bytes) -> None:
    """Write a file behind a checksum of its name and content; an `OSError` says that the folder is not this user's."""
    target.parent.mkdir(parents=True, exist_ok=True)
    if os.name == "posix":
        held = target.parent.stat()
        if held.st_uid == os.geteuid() and held.st_mode & _OTHERS:  # this user's folder is closed to the others
            target.parent.chmod(stat.S_IMODE(held.st_mode) & ~_OTHERS)
            held = target.parent.stat()
        _check(held, "the folder")
    write_whole(target, _seal(target, content) + content)


def read_sealed(source: Path) -> bytes | None:
    """Content of a sealed file; None if there is none that may be trusted.

    A file that was cut off, changed, or put in the place of another has another checksum.
    """
    try:
        data = _read(source)
    except UntrustedError as error:
        notice("trusted", f"{source} is not executed: {error}; it is made anew")
        return None
    except OSError:  # none is there; whoever writes it tells why that cannot be
        return None
    seal, content = data[:SEAL], data[SEAL:]
    if seal == _seal(source, content):
        return content
    notice("whole", f"{source} is damaged or another file; it is made anew")
    return None


def _read(source: Path) -> bytes:
    """Read a regular file in a folder, both of this user's and for no one else to write; else an `UntrustedError`."""
    if os.name != "posix":
        return source.read_bytes()
    folder = os.open(source.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        _check(os.fstat(folder), "its folder")
        if stat.S_ISLNK(os.stat(source.name, dir_fd=folder, follow_symlinks=False).st_mode):
            raise UntrustedError("it is a symbolic link")
        file = os.open(source.name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=folder)
    finally:
        os.close(folder)
    with os.fdopen(file, "rb") as stream:
        held = os.fstat(stream.fileno())
        if not stat.S_ISREG(held.st_mode) or held.st_size > LARGEST:
            raise UntrustedError("it is no file of this program")
        _check(held, "it")
        return stream.read(LARGEST)


def _check(held: os.stat_result, what: str) -> None:
    if held.st_uid != os.geteuid():
        raise UntrustedError(f"{what} belongs to another user")
    if held.st_mode & _OTHERS:
        raise UntrustedError(f"other users may write {'it' if what == 'it' else 'into ' + what}")


def _seal(path: Path, content: bytes) -> bytes:
    return hashlib.sha256(path.name.encode() + b"\0" + content).digest()


@cache
def _private() -> Path:
    """New folder that only this user may enter, removed when this process ends."""
    folder = Path(tempfile.mkdtemp(prefix="masking-"))
    owner = os.getpid()

    def remove() -> None:
        if os.getpid() == owner:  # a fork ends before
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return folder


_told: set[str] = set()


def notice(kind: str, text: str) -> None:
    """Print a line, once of each kind in a process."""
    if kind not in _told:
        _told.add(kind)
        with contextlib.suppress(OSError, ValueError):  # whoever reads it may be gone
            print(f"masking: {text}", file=sys.stderr, flush=True)
