"""Arrays in a numpy file: bounded by what its headers say before anything is unpacked, and never unpickled."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import IO

import numpy as np
from numpy.lib import format as npy

from masking.lab.records import unpacked_size
from masking.lab.records.nested_data import parsed


def read(file: Path) -> object:
    """Array or the arrays by their names; refuses what is damaged, holds Python objects, or unpacks to too much."""
    with parsed(file, "the numpy file"):
        if zipfile.is_zipfile(file):
            with zipfile.ZipFile(file) as packed:
                members = [one for one in packed.infolist() if one.filename.endswith(".npy")]
                unpacked_size.check(file, sum(one.file_size for one in members))
                total = 0
                for one in members:
                    with packed.open(one) as stream:
                        total += _size(stream, one.file_size)
                unpacked_size.check(file, total)
        else:
            with file.open("rb") as stream:
                unpacked_size.check(file, _size(stream, file.stat().st_size))
        with file.open("rb") as stream:
            held = np.load(stream, allow_pickle=False)
            return held if isinstance(held, np.ndarray) else dict(held)


def _size(stream: IO[bytes], length: int) -> int:
    """How many bytes an array takes as float64, from its header, with which it has `length` bytes in the file.

    A ValueError where it is no array of numbers, or the header says that it is longer than the file.
    """
    header = npy.read_array_header_1_0 if npy.read_magic(stream) == (1, 0) else npy.read_array_header_2_0
    shape, _, dtype = header(stream)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are not unpickled")
    if math.prod(shape) * dtype.itemsize > length:
        raise ValueError(f"an array of shape {shape} does not fit into {length} bytes")
    return 8 * math.prod(shape)
