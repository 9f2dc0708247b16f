"""Files that several processes may make at the same time."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path


def write_once(target: Path, content: bytes) -> None:
    """Write a file whole or not at all; where several processes write it, the first one wins."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=target.parent, suffix=".tmp", delete=False) as file:
        file.write(content)
    with contextlib.suppress(FileExistsError):
        os.link(file.name, target)
    Path(file.name).unlink()
