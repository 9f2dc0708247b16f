"""Pages: what the files of a stream are made of.

    part    "MASKSTRM"  number of the part  hash of this head  chain before its first page
    page    "MASKPAGE"  sequence  first row  rows  width  kind  bytes of the payload  hash of this head
            payload     float64, a row after the other; or JSON
            chain       BLAKE2b of the chain before the page, its head and its payload

All numbers are little-endian. The chain starts with the hash of the manifest, whose text is also the first page. A file
that is cut anywhere is read up to its last whole page. A byte that was changed, and a page that was removed or
exchanged, break the chain there; the pages behind it are sound again.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import blake2b
from typing import Final

DATA, CONTENT, END = range(3)  # kinds of pages
PART_HEAD: Final = 48
CHAIN: Final = 16  # bytes of a hash of the chain
_CHECK: Final = 8  # bytes of the hash of a head
_PART, _PAGE = b"MASKSTRM", b"MASKPAGE"
_HEAD: Final = struct.Struct("<8sQQIIII")
_PAGE_HEAD: Final = _HEAD.size + _CHECK


def hash_of(*parts: bytes, size: int = CHAIN) -> bytes:
    """Hash of bytes, one part behind the other."""
    made = blake2b(digest_size=size)
    for part in parts:
        made.update(part)
    return made.digest()


def part_head(number: int, chain: bytes) -> bytes:
    """First bytes of a part, which goes on behind a chain."""
    head = _PART + struct.pack("<Q", number)
    return head + hash_of(head, chain) + chain


def page_bytes(
    chain: bytes, sequence: int, kind: int, payload: bytes, *, first: int = 0, rows: int = 0, width: int = 0
) -> bytes:
    """Page number `sequence` behind the chain of the one before it; its own chain is its last bytes.

    It has `rows` rows of `width` numbers, from the number `first` on; `kind` says what the payload is.
    """
    head = _HEAD.pack(_PAGE, sequence, first, rows, width, kind, len(payload))
    return b"".join([head, hash_of(head, size=_CHECK), payload, hash_of(chain, head, payload)])


@dataclass(frozen=True)
class Page:
    """A page as it was found, or bytes that are none: those have no sequence."""

    start: int  # where its first byte is
    stop: int  # behind its last byte
    is_sound: bool = False  # whether it is what was written behind the page before it
    sequence: int = -1  # number of the page, -1 for bytes that are no page
    kind: int = -1  # what its payload is
    first: int = 0  # number of its first row
    rows: int = 0  # how many rows
    payload: bytes = b""  # without its head
    chain: bytes = b""  # behind it


def pages_of(memory: mmap.mmap, at: int, chain: bytes | None) -> Iterator[Page]:
    """Page after page, and the bytes between them; without a page that the end of the file cuts off.

    The first is looked for from a byte on, behind a chain; None where that is the one which stands there.
    """
    while at < len(memory):
        page = _page(memory, at, chain)
        if page is None:
            begin = _next_page(memory, at)
            if begin is None:
                if not _is_cut(memory, at):
                    yield Page(at, len(memory))
                return
            yield Page(at, begin)
            at, chain = begin, None
            continue
        yield page
        at, chain = page.stop, page.chain


def _has_head(memory: mmap.mmap, at: int) -> bool:
    head, check = memory[at : at + _HEAD.size], memory[at + _HEAD.size : at + _PAGE_HEAD]
    return head.startswith(_PAGE) and check == hash_of(head, size=_CHECK)


def _next_page(memory: mmap.mmap, at: int) -> int | None:
    """Where the next whole page begins behind a place."""
    while (at := memory.find(_PAGE, at + 1)) >= 0:
        if _page(memory, at, None) is not None:
            return at
    return None


def _is_cut(memory: mmap.mmap, at: int) -> bool:
    """Whether the last bytes are a page that was not written to its end."""
    rest = len(memory) - at
    if rest < _PAGE_HEAD:
        return memory[at : at + len(_PAGE)] == _PAGE[:rest]
    return _has_head(memory, at)


def _page(memory: mmap.mmap, at: int, chain: bytes | None) -> Page | None:
    """Page at a place; None where there is none, or its end is missing."""
    if not _has_head(memory, at):
        return None
    head = memory[at : at + _HEAD.size]
    _, sequence, first, rows, width, kind, size = _HEAD.unpack(head)
    begin = at + _PAGE_HEAD
    stop = begin + size + CHAIN
    if stop > len(memory) or (kind == DATA and size != 8 * rows * width):
        return None
    payload, found = memory[begin : begin + size], memory[begin + size : stop]
    before = {memory[at - CHAIN : at], chain or b""}
    is_sound = any(hash_of(one, head, payload) == found for one in before if one)
    made = found if is_sound else hash_of(chain or memory[at - CHAIN : at], head, payload)
    return Page(at, stop, is_sound, sequence, kind, first, rows, payload, made)
