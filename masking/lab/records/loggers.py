"""Files of data loggers: TDMS of LabVIEW, MDF 4 of vehicle buses, MCAP of robots; each by its own optional package.

A channel is named by its group or topic: `rig/x`, and has a clock of its own. That of the group, or of its first
channel, is beside the channels: `rig/time`, in s.
"""

from __future__ import annotations

import gc
import importlib
import json
import re
import struct
import sys
import traceback
from collections import Counter, defaultdict
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from masking.errors import RecordError
from masking.lab.records import unpacked_size
from masking.lab.records.nested_data import parsed, vectors, without_doubles
from masking.lab.records.time_base import Channels

Nested = Mapping[str, object]
TIME = "time"
_MDF_DEFLATED = (0, 1)  # plain and transposed


def read(file: Path) -> Channels:
    """Read the channels of numbers in a .tdms, .mf4 or .mcap file, with their clocks, by the package for it.

    Samples that the logger marked as invalid are NaN.
    """
    known = {".tdms": ("nptdms", _tdms), ".mf4": ("asammdf", _mdf), ".mcap": ("mcap.reader", _mcap)}
    package, reader = known[file.suffix.lower()]
    try:
        module = importlib.import_module(package)
    except ImportError:
        name = package.partition(".")[0]
        raise RecordError(f"{file}: it is read by the package {name}: pip install 'masking[loggers]'") from None
    with parsed(file, "the file"):
        held, timed = reader(file, module)
        found, clocks = dict(vectors("", held)), dict(vectors("", timed))
    if not found:
        raise RecordError(f"{file}: it holds no channels of numbers")
    matrices = {path: clocks[of] for path in found if path not in clocks and (of := path.rpartition("/")[0]) in clocks}
    return Channels(found, clocks | matrices)


def _tdms(file: Path, nptdms: ModuleType) -> tuple[Nested, Nested]:
    """Channels by group, and the clock of each with a waveform's increment; that of the first is beside them.

    Clocks count from the earliest start of a waveform in the file.
    """
    described = nptdms.TdmsFile.read_metadata(file)
    if sum(len(c) for group in described.groups() for c in group.channels()) > file.stat().st_size:
        raise ValueError("it says that it has more samples than bytes")
    groups = nptdms.TdmsFile.read(file).groups()
    starts = [c.properties.get("wf_start_time") for group in groups for c in group.channels()]
    origin = min((start for start in starts if isinstance(start, np.datetime64)), default=None)
    made: dict[str, dict[str, object]] = {}
    clocks: dict[str, dict[str, object]] = {}
    for group in groups:
        made[group.name] = channels = {c.name: _since(c[:], origin) for c in group.channels()}
        clocks[group.name] = timed = {}
        for channel in group.channels():
            if channel.properties.get("wf_increment", 0.0) > 0.0:
                start = channel.properties.get("wf_start_time")
                late = float(_since(start, origin)) if isinstance(start, np.datetime64) else 0.0
                timed[channel.name] = late + channel.time_track()
                timed[TIME] = channels.setdefault(TIME, timed[channel.name])
    return made, clocks


def _since(values: Any, origin: np.datetime64 | None) -> Any:  # noqa: ANN401  (an array or a number)
    """Instants in s since another, by default the first of them; other values as they are."""
    if np.asarray(values).dtype.kind != "M" or not np.size(values):
        return values
    return (values - (np.ravel(values)[0] if origin is None else origin)) / np.timedelta64(1, "s")


def _mdf(file: Path, asammdf: ModuleType) -> tuple[Nested, Nested]:
    """Channels of each group that has a name of its own by that, of the others by their numbers from 1; and clocks."""
    unpacked_size.check(file, _unpacked_mdf(file))
    with _opened_mdf(file, asammdf) as opened:
        unpacked_size.check(file, sum(8 * g.channel_group.cycles_nr * len(g.channels) for g in opened.groups))
        named = [group.channel_group.acq_name for group in opened.groups]
        often = Counter(named)
        groups = [n if n and often[n] == 1 else str(i) for i, n in enumerate(named, 1)]
        made: dict[str, dict[str, object]] = defaultdict(dict)
        clocks: dict[str, dict[str, object]] = defaultdict(dict)
        for signal in opened.iter_channels():
            group = groups[signal.group_index]
            timed = clocks[group].setdefault(TIME, signal.timestamps)
            made[group] |= {signal.name: _valid(signal), TIME: timed}
            clocks[group][signal.name] = timed
        return (made, clocks) if len(made) > 1 else (next(iter(made.values()), {}), next(iter(clocks.values()), {}))


def _valid(signal: Any) -> Any:  # noqa: ANN401  (of an optional package)
    """Samples of a signal of MDF; NaN where the logger marked them as invalid."""
    samples, bits = signal.samples, signal.invalidation_bits
    if bits is None or samples.dtype.kind not in "fiub":
        return samples
    invalid = np.asarray(bits, dtype=bool).reshape(-1, *[1] * (samples.ndim - 1))
    return np.where(invalid, np.nan, samples.astype(np.float64))


def _opened_mdf(file: Path, asammdf: ModuleType) -> Any:  # noqa: ANN401  (of an optional package)
    """Open an MDF file; where that fails, the package closes it without a line on stderr."""
    said, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        return asammdf.MDF(file)
    except Exception as error:
        left: BaseException | None = error
        while left is not None:
            traceback.clear_frames(left.__traceback__)
            left = left.__context__
        gc.collect()
        raise
    finally:
        sys.unraisablehook = said


def _unpacked_mdf(file: Path) -> int:
    """How many bytes the compressed blocks of an MDF file unpack to; a ValueError where one says too few."""
    data, total = file.read_bytes(), 0
    for block in re.finditer(b"##DZ", data):
        head = data[block.start() + 24 : block.start() + 48]
        if len(head) == 24:
            _, kind, _, _, original, size = struct.unpack("<2sBBIQQ", head)
            total += int(original)
            packed = data[block.start() + 48 :][:size]
            is_read = kind in _MDF_DEFLATED and original <= unpacked_size.limit(file)
            if is_read and unpacked_size.inflated(packed, original) > original:
                raise ValueError("a block unpacks to more than it says")
    return total


def _unpacked_mcap(file: Path) -> int:
    """How many bytes the chunks of an MCAP file unpack to; a ValueError where one says too few."""
    streams, total, most = importlib.import_module("mcap.stream_reader"), 0, unpacked_size.limit(file)
    with file.open("rb") as stream:
        for one in streams.StreamReader(stream, emit_chunks=True, record_size_limit=file.stat().st_size).records:
            if type(one).__name__ == "Chunk":
                said, found = one.uncompressed_size, one.uncompressed_size
                if one.compression == "zstd":
                    found = importlib.import_module("zstandard").frame_content_size(one.data)
                elif one.compression == "lz4" and said <= most:
                    unpacking = importlib.import_module("lz4.frame").LZ4FrameDecompressor()
                    found = len(unpacking.decompress(one.data, said + 1))
                if found > said:
                    raise ValueError("a chunk unpacks to more than it says")
                total += said
    return total


def _mcap(file: Path, reader: ModuleType) -> tuple[Nested, Nested]:
    """Fields of the JSON messages of each topic, and its clock, which begins with the record."""
    samples: dict[str, list[dict[str, object]]] = defaultdict(list)
    clocks: dict[str, list[int]] = defaultdict(list)  # ns
    others = set()
    unpacked_size.check(file, _unpacked_mcap(file))
    with file.open("rb") as stream:
        for _, channel, message in reader.make_reader(stream, validate_crcs=True).iter_messages():
            if channel.message_encoding != "json":
                others.add(f"{channel.topic} ({channel.message_encoding or 'no encoding'})")
                continue
            content = json.loads(message.data, object_pairs_hook=without_doubles)
            fields = content if isinstance(content, dict) else {"value": content}
            topic = channel.topic.strip("/")
            samples[topic].append(_flat("", fields))
            clocks[topic].append(message.log_time)
    if others and not samples:
        unread = ", ".join(sorted(others))
        raise RecordError(f"{file}: only messages in JSON are read, not {unread}; export them as csv")
    start = min((min(clock) for clock in clocks.values()), default=0)
    made: dict[str, dict[str, object]] = {}
    timed: dict[str, dict[str, object]] = {}
    for topic, rows in samples.items():
        made[topic] = {name: [row.get(name) for row in rows] for name in dict.fromkeys(n for row in rows for n in row)}
        made[topic][TIME] = [(when - start) * 1e-9 for when in clocks[topic]]
        timed[topic] = dict.fromkeys(made[topic], made[topic][TIME])
    return made, timed


def _flat(path: str, fields: Mapping[str, object]) -> dict[str, object]:
    """Nested fields of numbers by their paths."""
    made: dict[str, object] = {}
    for name, value in fields.items():
        if isinstance(value, dict):
            made |= _flat(f"{path}{name}/", value)
        elif isinstance(value, int | float):
            made[f"{path}{name}"] = value
    return made
