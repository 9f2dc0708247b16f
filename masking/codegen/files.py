"""Files that several processes may make at the same time, and that are not read if they have been damaged."""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path


def write_whole(target: Path, content: bytes) -> None:
    """Write a file whole or not at all; a reader sees the old file or the new one."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=target.parent, suffix=".tmp", delete=False) as file:
        file.write(content)
    Path(file.name).replace(target)


def write_sealed(target: Path, content: bytes) -> None:
    """Write a file behind a checksum of its name and content."""
    write_whole(target, _seal(target, content) + content)


def read_sealed(source: Path) -> bytes | None:
    """Return the content of a sealed file; None if there is none, or its checksum is not that of its name and content.

    A file that was cut off, changed, or put in the place of another has another checksum.
    """
    try:
        seal, content = (data := source.read_bytes())[:SEAL], data[SEAL:]
    except FileNotFoundError:
        return None
    return content if seal == _seal(source, content) else None


SEAL = hashlib.sha256().digest_size


def _seal(path: Path, content: bytes) -> bytes:
    return hashlib.sha256(path.name.encode() + b"\0" + content).digest()
