"""Excitation: the samples of one or more channels that a rig is given, in memory and on disk.

NAME.csv        a header `t [s],V1 [V],...` and one row for each sample, numbers that read back bit for bit
NAME.parquet    a recording (`records.recording`) with columns t and input.<channel>, units and meta in its manifest
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import ModelError, RecordError, nearest
from masking.lab.records import named_files
from masking.lab.records.file_replacement import replacing
from masking.lab.records.recording import FORMAT, Recording
from masking.lab.signals.signal_arguments import is_plain, names, positive
from masking.lazy_imports import parquet

KIND: Final = "excitation"
PREFIX: Final = "input."
UNEVEN: Final = 1e-3  # of a sample, that the clock of a file may be off: more than rounding, less than a slipped one
_LARGEST: Final = 2**30  # bytes of a csv
RATE_DIGITS: Final = 10  # of a rate that is read from a clock: beyond them is what rounding does
_HEADER = re.compile(r"(?P<name>[^\[\]]*[^\[\]\s])\s*(?:\[(?P<unit>[^\[\]]*)\])?\s*")


@dataclass(frozen=True, eq=False, repr=False)
class Excitation:
    """The samples of one or more channels at one rate.

    A ModelError where a value is not finite, a name appears twice, or numbers of channels differ.
    """

    name: str  # of the signal, such as "multisine"
    rate: float  # samples per second, Hz
    values: Array  # (samples, channels), each in the unit of its channel; kept as read-only float64
    channels: tuple[str, ...]  # names, such as the actuators of a plant file
    units: tuple[str, ...]  # of the channels; one text for all of them, or one for each
    meta: Mapping[str, Any] = field(default_factory=dict)  # how the signal was made, whatever JSON can hold

    def __post_init__(self) -> None:
        channels = names("channel", self.channels)
        units = (self.units,) * len(channels) if isinstance(self.units, str) else tuple(self.units)
        if not all(map(is_plain, units)):
            raise ModelError(f"{self.name}: the units are {units!r}; give texts without brackets, such as 'V'")
        try:
            values = np.array(self.values, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ModelError(f"{self.name}: the values are not real numbers ({error}); give an array") from None
        if values.ndim != 2 or values.shape[1] != len(channels) or not len(values):
            raise ModelError(
                f"{self.name}: values of shape {values.shape} for {len(channels)} channel{'s' * (len(channels) != 1)}; "
                f"give an array (samples, {len(channels)}) with at least one sample"
            )
        if len(units) != len(channels):
            message = f"{self.name}: {len(units)} units for {len(channels)} channels"
            raise ModelError(f"{message}; give one for each, or one for all")
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            sample, channel = bad[0]
            what = f"{channels[channel]} is {values[sample, channel]} at sample {sample} (they count from 0)"
            raise ModelError(f"{self.name}: {what}; give finite numbers")
        values.flags.writeable = False
        object.__setattr__(self, "rate", positive("rate", self.rate, "Hz"))
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "channels", channels)
        object.__setattr__(self, "units", units)

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, channel: str) -> Array:
        """Samples of one channel (samples,)."""
        return np.asarray(self.values[:, self._index(channel)])

    def __repr__(self) -> str:
        return f"<Excitation {self.name}: {', '.join(self.channels)}, {self.duration:g} s at {self.rate:g} Hz>"

    @property
    def times(self) -> Array:
        """Times of the samples, s (samples,); the first is 0."""
        return np.arange(len(self.values)) / self.rate

    @property
    def duration(self) -> float:
        """How long the signal lasts, s: its samples over its rate."""
        return len(self.values) / self.rate

    @property
    def peaks(self) -> dict[str, float]:
        """The largest absolute value of each channel, in its unit."""
        return dict(zip(self.channels, np.abs(self.values).max(axis=0).tolist(), strict=True))

    def scaled(self, factor: float) -> Excitation:
        """Excitation with all values multiplied by a factor above 0."""
        factor = positive("factor", factor)
        scale = factor * float(self.meta.get("scale", 1.0))
        return replace(self, values=factor * self.values, meta={**self.meta, "scale": scale})

    def within(self, limits: Mapping[str, float]) -> Excitation:
        """Excitation if it keeps the limits; nothing is ever cut off.

        Args:
            limits: the largest absolute value for each channel, in its unit.

        Raises:
            ModelError: a channel passes its limit (says where, and which factor for `scaled` makes all channels fit),
                has none, or is unknown.
        """
        for name in limits:
            self._index(name)
        over, factor = [], 1.0
        for name, unit, peak in zip(self.channels, self.units, self.peaks.values(), strict=True):
            if name not in limits:
                raise ModelError(f"{self.name}: no limit of {name}; give one in {unit}, such as {name}: {peak:.6g}")
            limit = positive(f"limit of {name}", limits[name], unit)
            if peak > limit:
                sample = int(np.argmax(np.abs(self[name]) > limit))
                most = int(np.argmax(np.abs(self[name])))
                over.append(
                    f"{name} passes its limit of {limit:g} {unit} first at t = {sample / self.rate:.6g} s (sample "
                    f"{sample}) and reaches {self[name][most]:.6g} {unit} at t = {most / self.rate:.6g} s"
                )
                factor = min(factor, limit / peak)
        if over:
            # Rounded down, so that the factor as printed fits too.
            power = 10.0 ** (4 - math.floor(math.log10(factor)))
            remedy = f"scale the signal by {math.floor(factor * power) / power:.5g} or less, or change the limit"
            raise ModelError(f"{self.name}: {'; '.join(over)}; {remedy}")
        return self

    def recording(self) -> Recording:
        """Excitation as a recording: columns t and input.<channel>, with units and meta in the manifest."""
        columns = {"t": self.times, **{f"{PREFIX}{name}": self[name] for name in self.channels}}
        described = {"t": {"unit": "s", "meaning": "time"}}
        for name, unit in zip(self.channels, self.units, strict=True):
            described[f"{PREFIX}{name}"] = {"unit": unit, "meaning": f"{self.name} on {name}"}
        manifest = {"name": self.name, "kind": KIND, "rate": self.rate, "columns": described, "meta": dict(self.meta)}
        return Recording(columns, manifest)

    def save(self, path: str | Path) -> Path:
        """Write the excitation to a file that ends in .csv or .parquet, and return its path.

        The folder is made if need be; after an error the file is as it was.

        Raises:
            RecordError: the ending is another, or the file cannot be written.
        """
        path = Path(path)
        write = {".csv": self._csv, ".parquet": self._parquet}.get(path.suffix.lower())
        if write is None:
            raise RecordError(f"{path}: an excitation is written to .csv or .parquet, not to '{path.suffix}'")
        content = write()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as stream:
                stream.write(content)
        except OSError as error:
            raise RecordError(f"{path}: the excitation cannot be written: {error.strerror or error}") from error
        return path

    @classmethod
    def load(cls, path: str | Path) -> Excitation:
        """Read an excitation from a file that `save` wrote, or from any csv with a header and an even clock `t`.

        A csv carries no meta, its name is that of the file, and its rate is that of the clock to 10 digits; a column
        without a unit has the unit "".

        Raises:
            RecordError: there is no such file, it is damaged or no excitation, or its clock is uneven.
        """
        path = Path(path)
        suffix = path.suffix.lower()
        if suffix not in {".csv", ".parquet"}:
            raise RecordError(f"{path}: an excitation is read from .csv or .parquet, not from '{suffix}'")
        if suffix == ".csv":
            return _from_csv(path)
        recording = Recording.load(path)
        manifest = recording.manifest
        channels = tuple(name.removeprefix(PREFIX) for name in recording.columns if name.startswith(PREFIX))
        if manifest.get("kind") != KIND or not channels:
            raise RecordError(f"{path}: a recording, but no excitation: give a file that Excitation.save wrote")
        values = np.column_stack([recording[f"{PREFIX}{name}"] for name in channels])
        try:
            units = tuple(str(manifest["columns"][f"{PREFIX}{name}"]["unit"]) for name in channels)
            return cls(str(manifest["name"]), manifest["rate"], values, channels, units, dict(manifest["meta"]))
        except (KeyError, TypeError, ValueError, ModelError) as error:
            what = f"its manifest lacks {error}" if isinstance(error, KeyError) else str(error)
            raise RecordError(f"{path}: {what}; give a file that Excitation.save wrote") from None

    def _csv(self) -> bytes:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["t [s]", *(f"{n} [{u}]" for n, u in zip(self.channels, self.units, strict=True))])
        writer.writerows(np.column_stack([self.times, self.values]).tolist())  # the csv module writes floats by repr
        return text.getvalue().encode()

    def _parquet(self) -> bytes:
        recording, stream = self.recording(), io.BytesIO()
        try:
            manifest = json.dumps({"format": FORMAT, **recording.manifest}, ensure_ascii=False, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise RecordError(f"{self.name}: its meta holds what JSON cannot ({error})") from error
        facts = {"unit": recording.units, "meaning": recording.meanings}
        parquet.write(stream, recording.columns, manifest.encode(), facts)
        return stream.getvalue()

    def _index(self, channel: str) -> int:
        if channel in self.channels:
            return self.channels.index(channel)
        raise ModelError(f"{self.name} has no channel '{channel}'; {nearest(channel, self.channels)}")


def _from_csv(path: Path) -> Excitation:
    try:
        text = named_files.content(path, _LARGEST).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        what = getattr(error, "strerror", None) or error
        raise RecordError(f"{path}: the excitation cannot be read: {what}") from error
    rows = [row for row in csv.reader(io.StringIO(text)) if row]
    if len(rows) < 3:
        raise RecordError(f"{path}: {len(rows)} rows; a header and at least two samples are needed")
    heads = [_HEADER.fullmatch(cell.strip()) for cell in rows[0]]
    for cell, head in zip(rows[0], heads, strict=True):
        if head is None:
            raise RecordError(f"{path}: row 1: '{cell}' is no name with a unit; write such as 'V1 [V]'")
    found = [(head["name"], head["unit"] or "") for head in heads if head is not None]
    clock, channels = found[0], found[1:]
    if clock[0] != "t" or clock[1] not in {"", "s"} or not channels:
        raise RecordError(f"{path}: the columns are {', '.join(rows[0])}; the first must be 't [s]', then the channels")
    numbers = np.empty((len(rows) - 1, len(found)))
    for line, cells in enumerate(rows[1:], start=2):
        if len(cells) != len(found):
            raise RecordError(f"{path}: row {line} has {len(cells)} values, the header {len(found)}")
        try:
            numbers[line - 2] = [float(cell) for cell in cells]
        except ValueError as error:
            raise RecordError(f"{path}: row {line} holds what is no number ({error})") from None
    try:
        rate = _rate(numbers[:, 0])
        return Excitation(path.stem, rate, numbers[:, 1:], tuple(n for n, _ in channels), tuple(u for _, u in channels))
    except ModelError as error:
        raise RecordError(f"{path}: {error}") from None


def _rate(times: Array) -> float:
    """Rate of an even clock that starts at 0, Hz."""
    if not np.isfinite(times).all():
        raise ModelError(f"the clock is {times[~np.isfinite(times)][0]} in a sample; give finite times")
    step = (times[-1] - times[0]) / (len(times) - 1)
    if step <= 0.0 or times[0] != 0.0:
        raise ModelError(f"the clock runs from {times[0]:g} to {times[-1]:g} s; it must start at 0 and increase")
    off = np.abs(times - step * np.arange(len(times)))
    worst = int(np.argmax(off))
    if off[worst] > UNEVEN * step:
        raise ModelError(
            f"the clock is uneven: sample {worst} is at {times[worst]:.9g} s, {off[worst]:.3g} s off one sample each "
            f"{step:.6g} s; give samples at one rate"
        )
    return float(f"{1.0 / step:.{RATE_DIGITS}g}")
