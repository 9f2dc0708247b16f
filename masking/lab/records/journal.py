"""Journal: what happened, a line each, which is on disk before anything else is done.

    {"event": ..., ...}<tab>CRC-32 of that, 8 hexadecimal digits

A line that a crash cut off has no end; it is left out, and written over by the next.
"""

from __future__ import annotations

import json
import os
import zlib
from pathlib import Path
from typing import Any, Self, final

from masking.errors import RecordError
from masking.lab.records import foreign_json, named_files


@final
class Journal:
    """A journal of a folder that this process owns; a context.

    Its file is made if need be; `entries` is all that is in it, in order. A RecordError where the file cannot be
    written, or a line was changed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise RecordError(f"{path} cannot be written ({error}); name another folder") from error
        try:
            self.entries = self._read()
        except BaseException:
            os.close(self._handle)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._handle)

    def _read(self) -> list[dict[str, Any]]:
        """Entries; leave out a last line that is cut off."""
        found, good = list[dict[str, Any]](), 0
        lines = named_files.content(self.path).splitlines(keepends=True)
        for number, line in enumerate(lines, 1):
            text, _, check = line[:-1].rpartition(b"\t")
            is_whole = check == _check(text)
            if not (line.endswith(b"\n") and is_whole):
                if number < len(lines) or line.endswith(b"\n") or is_whole:  # one that was cut off has no end
                    raise RecordError(f"{self.path}: line {number} was changed; begin anew in another folder")
                break
            found.append(foreign_json.parsed(text, dict[str, Any], f"{self.path}: line {number}"))
            good += len(line)
        os.ftruncate(self._handle, good)
        os.lseek(self._handle, good, os.SEEK_SET)
        return found

    def add(self, **entry: Any) -> None:  # noqa: ANN401
        """Add an entry, as JSON can hold it, and bring it to disk; where no place is left, take it back."""
        text = json.dumps(entry, ensure_ascii=False).encode()
        line, begin = text + b"\t" + _check(text) + b"\n", os.lseek(self._handle, 0, os.SEEK_CUR)
        try:
            written = os.write(self._handle, line)
            if written < len(line):
                raise OSError("no place is left")
            os.fsync(self._handle)
        except OSError as error:
            os.ftruncate(self._handle, begin)
            os.lseek(self._handle, begin, os.SEEK_SET)
            remedy = "make room, then start the same again"
            raise RecordError(f"{self.path} cannot be written ({error}); {remedy}") from error
        self.entries.append(json.loads(text))


def _check(text: bytes) -> bytes:
    return b"%08x" % zlib.crc32(text)
