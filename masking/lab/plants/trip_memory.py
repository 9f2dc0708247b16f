"""Memory of a plant's last trip: a server that is started anew knows it, too."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Final, final

import platformdirs

from masking.errors import RecordError
from masking.lab.records.file_replacement import replacing

_LONGEST: Final = 10_000  # characters of a cause


@final
class TripMemory:
    """The `cause` of the end of a plant's last session, until somebody acknowledges it; empty where it did not trip.

    With the `address` of a plant that is no twin, it is kept in a file of this user, one for each address. A
    RecordError where that cannot be read or written.
    """

    def __init__(self, address: str | None = None) -> None:
        self.cause, self._file = "", None if address is None else _file(address)
        try:
            if self._file is not None and self._file.exists():
                self.cause = self._file.read_text(encoding="utf-8", errors="replace")[:_LONGEST]
        except OSError as error:
            raise RecordError(f"{self._file}: the last trip cannot be read ({error.strerror})") from error

    def keep(self, cause: str) -> None:
        """Keep a reason, on disk once this returns; an empty one is forgotten."""
        if cause == self.cause:
            return
        self.cause, file = cause, self._file
        if file is None:
            return
        try:
            if not cause:
                file.unlink(missing_ok=True)
                return
            file.parent.mkdir(parents=True, exist_ok=True)
            with replacing(file) as stream:
                stream.write(cause.encode())
        except OSError as error:
            raise RecordError(f"{file}: the trip cannot be kept ({error.strerror})") from error


def _file(address: str) -> Path:
    number = hashlib.sha256(address.encode(errors="surrogateescape")).hexdigest()[:16]
    return platformdirs.user_state_path("masking") / "trips" / number
