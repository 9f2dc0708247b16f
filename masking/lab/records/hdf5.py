"""Vectors of numbers in an HDF5 file, which a MATLAB file of version 7.3 is, too; each is named by its path.

This module alone touches h5py, so that whoever reads no such file does not pay for loading it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from masking.errors import RecordError
from masking.lab.records import unpacked_size
from masking.lab.records.nested_data import MOST_COLUMNS, parsed, vectors

# What MATLAB calls numbers. Text, tables and objects are kept as integers, too, with another class beside them.
_MATLAB = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
DEEPEST_NESTING = 1000  # of groups
MOST_OBJECTS = 10_000  # measured: they are looked at in two seconds
_MOST_INFLATED = 1032  # times as many bytes as are stored


def is_hdf5(file: Path) -> bool:
    """Whether a file has the signature of HDF5, whatever its name ends in."""
    return bool(h5py.is_hdf5(file))


def read(file: Path) -> dict[str, NDArray[np.float64]]:
    """Read every vector of numbers as float64, by its path in the file, such as `multisine/u`.

    Vectors and columns of matrices are as in `nested_data.vectors`. Scalars, texts, compounds and references are left
    out, and what only MATLAB understands. Nothing is read from other files: a file with external links, external
    storage or virtual datasets is refused, as is one that is damaged, unpacks to too much, or holds no vectors.
    """
    total = 0
    found: dict[str, NDArray[np.float64]] = {}
    with parsed(file, "the HDF5 file"), h5py.File(file, "r") as opened:
        for path, held in _datasets(file, opened):
            if held.is_virtual or held.external:
                raise _elsewhere(file, path, "a virtual dataset" if held.is_virtual else "stored in another file")
            if _has_vectors(held):
                total += 8 * held.size
                unpacked_size.check(file, total)
                _check_chunks(file, held)
                found.update(vectors(path, held[()]))
    if not found:
        raise RecordError(f"{file}: it holds no vectors of numbers")
    return found


def _datasets(file: Path, opened: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Each dataset by its first path, the groups and datasets of a group in the order of their names.

    Links by name are not followed. A RecordError where there are too many objects, or groups too deep.
    """
    seen, waiting = set[int](), [("", opened)]
    while waiting:
        path, held = waiting.pop()
        if (address := int(h5py.h5o.get_info(held.id).addr)) in seen:
            continue
        seen.add(address)
        if isinstance(held, h5py.Dataset):
            yield path, held
        if not isinstance(held, h5py.Group):
            continue
        if path.count("/") >= DEEPEST_NESTING:
            raise RecordError(f"{file}: its groups are nested deeper than {DEEPEST_NESTING}; write the data into fewer")
        if len(seen) + len(waiting) + len(held) > MOST_OBJECTS:
            raise RecordError(
                f"{file}: it holds more than {MOST_OBJECTS} groups and datasets; write a matrix of columns"
            )
        inside = list[tuple[str, h5py.HLObject]]()
        for name in held:
            inner, link = f"{path}/{name}".lstrip("/"), held.get(name, getlink=True)
            if isinstance(link, h5py.ExternalLink):
                raise _elsewhere(file, inner, "an external link")
            # MATLAB's own begin with #: what cells and objects refer to
            if isinstance(link, h5py.HardLink) and not name.startswith("#"):
                inside.append((inner, held[name]))
        waiting += reversed(inside)


def _elsewhere(file: Path, path: str, what: str) -> RecordError:
    return RecordError(f"{file}: {path} is {what}, and other files are not read; copy the data into this one")


def _check_chunks(file: Path, held: h5py.Dataset) -> None:
    """Refuse chunks that unpack to more than they should: HDF5 unpacks all that there is."""
    if held.chunks is None or held.compression != "gzip":
        return
    size, inside = math.prod(held.chunks) * held.dtype.itemsize, 4096  # and what stands around the numbers
    for number in range(held.id.get_num_chunks()):
        stored = held.id.get_chunk_info(number)
        if stored.size * _MOST_INFLATED <= unpacked_size.SMALL:
            continue
        skipped, data = held.id.read_direct_chunk(stored.chunk_offset)
        if not skipped and unpacked_size.inflated(data, size + inside) > size + inside:
            raise RecordError(f"{file}: {held.name} is damaged: a chunk unpacks to more than its {size} bytes")


def _has_vectors(held: h5py.Dataset) -> bool:
    sides = sorted(held.shape or ())
    if not held.size or held.size < 2 or held.size > sides[-1] * MOST_COLUMNS:
        return False
    try:
        kind = held.dtype.kind
    except TypeError:  # HDF5 has kinds of numbers that numpy lacks, such as bit fields
        return False
    if kind not in "fiu" or "MATLAB_empty" in held.attrs or "MATLAB_sparse" in held.parent.attrs:
        return False  # of MATLAB: the shape of what is empty; one part of a matrix
    known = held.attrs.get("MATLAB_class", b"double")  # which may be another of its kinds, in integers
    return (known.decode() if isinstance(known, bytes) else str(known)) in _MATLAB
