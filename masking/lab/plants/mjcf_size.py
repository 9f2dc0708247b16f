"""How many elements a model in MJCF has once its copies are made, found without making them.

A line that asks for a billion copies keeps MuJoCo for years; it cannot be interrupted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from masking.errors import PlantMismatchError
from masking.lab.records import named_files

MOST: Final = 20_000  # elements; measured: MuJoCo takes some seconds for 10 000 copies, and four times that for twice
MOST_NUMBERS: Final = 10_000_000  # that one element asks for
_LARGEST: Final = 2**25  # bytes of a file
_COPYING: Final = ("replicate", "composite", "flexcomp")


def check(path: str | Path) -> None:
    """Refuse a model that MuJoCo would not come to an end with, or whose files are none that can be read.

    A PlantMismatchError where a file, or one that it includes, is no regular one or no XML, or all of them have more
    than `MOST` elements.
    """
    total = 0
    for element, times in _elements(Path(path), 1, set()):
        total += times
        if total > MOST:
            raise PlantMismatchError(
                f"{path}: with its copies made, the model has more than {MOST} elements; the last one is "
                f"'{element.tag}': ask for fewer copies"
            )


def _elements(path: Path, times: int, seen: set[Path]) -> Iterator[tuple[ElementTree.Element, int]]:
    """Each element of a file and of those that it includes, and how many there will be of it."""
    seen.add(path.resolve())
    try:
        text = named_files.content(path, _LARGEST)
    except OSError as error:
        raise PlantMismatchError(f"{path}: the model cannot be read ({error.strerror or error})") from error
    if b"<!DOCTYPE" in text:
        raise PlantMismatchError(f"{path}: a document type is not allowed; remove the line with <!DOCTYPE")
    try:
        open_ones = [(ElementTree.fromstring(text), times)]  # noqa: S314  # there are no entities
    except ElementTree.ParseError as error:
        raise PlantMismatchError(f"{path}: no XML ({error}); correct the file") from error
    while open_ones:
        element, number = open_ones.pop()
        number *= _copies(element)
        yield element, number
        named = path.parent / element.get("file", "")
        if element.tag == "include" and named.exists() and named.resolve() not in seen:
            yield from _elements(named, number, seen)
        elif element.get("file") and named.exists() and not named.is_file():
            raise PlantMismatchError(f"{path}: {named} is no regular file; name one that is")
        sizes = [text for name, text in element.items() if name in {"nrow", "ncol"} or name.startswith("nuser_")]
        if _product(sizes) > MOST_NUMBERS:
            raise PlantMismatchError(
                f"{path}: '{element.tag}' asks for more than {MOST_NUMBERS} numbers; make it smaller"
            )
        open_ones += [(child, number) for child in element]


def _copies(element: ElementTree.Element) -> int:
    """How many copies of what stands inside an element it asks for."""
    counts = element.get("count", "").split() if element.tag in _COPYING else []
    return max(1, int(min(_product(counts), MOST + 1.0)))


def _product(texts: Sequence[str]) -> float:
    """Product of numbers; 1 where they are none, which MuJoCo refuses."""
    try:
        found = math.prod(map(float, texts))
    except ValueError:
        return 1.0
    return 1.0 if math.isnan(found) else found
