"""Text of a file in its encoding: UTF-8, or another one that is named, with a line feed at the end of each line."""

from __future__ import annotations

import codecs
from pathlib import Path

from masking.display.characters import UNFIT, code_point
from masking.errors import RecordError

LARGEST = 2**29  # bytes; what is read takes some times as much memory
_NO_TEXT = {"unicode_escape", "raw_unicode_escape", "idna", "punycode", "utf_7"}  # that turn text into other text
_OTHERS = "--encoding latin-1, gbk or utf-16"


def text(file: Path, encoding: str | None = None) -> str:
    """Text of a file, by default in UTF-8; a RecordError where it is in another, no text, or too large."""
    codec = _codec(file, encoding)
    try:
        if file.stat().st_size > LARGEST:
            raise RecordError(f"{file}: the table has more than {LARGEST} bytes; cut it, or give a .parquet file")
        data = file.read_bytes()
    except OSError as error:
        raise RecordError(f"{file}: the table cannot be read ({error.strerror})") from error
    if encoding is None and data[:2] in {b"\xff\xfe", b"\xfe\xff"}:
        raise RecordError(f"{file}: the table is in UTF-16; give --encoding utf-16, or save it as UTF-8")
    try:
        found = data.decode(codec)
    except UnicodeDecodeError as error:
        line, column = _position(data[: error.start].decode(codec, errors="replace"))
        raise RecordError(
            f"{file}: the table cannot be read: line {line}, character {column} is not {encoding or 'UTF-8'}; give its "
            f"encoding, such as {_OTHERS}, or save it as UTF-8"
        ) from None
    except UnicodeError:
        raise RecordError(f"{file}: the table cannot be read in {encoding}; give another, such as {_OTHERS}") from None
    found = found.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
    if wrong := UNFIT.search(found):
        line, column = _position(found[: wrong.start()])
        raise RecordError(
            f"{file}: the table cannot be read: line {line}, character {column} is {code_point(wrong[0])}, which no "
            f"text holds; is it damaged, or in UTF-16? If so, give its encoding, such as {_OTHERS}"
        )
    return found


def _codec(file: Path, encoding: str | None) -> str:
    try:
        known = codecs.lookup(encoding or "utf-8")
        "a".encode(known.name)  # a LookupError where it encodes no text
    except (LookupError, ValueError):
        known = None
    if known is None or known.name.replace("-", "_") in _NO_TEXT:
        raise RecordError(f"{file}: there is no encoding '{encoding}'; give one, such as {_OTHERS}")
    return known.name


def _position(before: str) -> tuple[int, int]:
    return before.count("\n") + 1, len(before) - before.rfind("\n")
