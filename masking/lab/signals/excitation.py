"""Excitation: the samples of one or more channels that a rig is given, in memory and on disk.

NAME.csv        a header `t [s],V1 [V],...` and one row for each sample, numbers that read back bit for bit
NAME.parquet    a recording (`records.recording`) with columns t and input.<channel>, units and meta in its manifest

Both are records, which `records.readers` reads.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import ModelError, RecordError, nearest
from masking.lab.records.file_replacement import replacing
from masking.lab.records.recording import Recording
from masking.lab.signals.signal_arguments import is_plain, names, positive

KIND: Final = "excitation"
PREFIX: Final = "input."


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
        write = {".csv": self._csv, ".parquet": self.recording().write}.get(path.suffix.lower())
        if write is None:
            raise RecordError(f"{path}: an excitation is written to .csv or .parquet, not to '{path.suffix}'")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as stream:
                write(stream)
        except OSError as error:
            raise RecordError(f"{path}: the excitation cannot be written: {error.strerror or error}") from error
        return path

    def _csv(self, stream: BinaryIO) -> None:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["t [s]", *(f"{n} [{u}]" for n, u in zip(self.channels, self.units, strict=True))])
        writer.writerows(np.column_stack([self.times, self.values]).tolist())  # the csv module writes floats by repr
        stream.write(text.getvalue().encode())

    def _index(self, channel: str) -> int:
        if channel in self.channels:
            return self.channels.index(channel)
        raise ModelError(f"{self.name} has no channel '{channel}'; {nearest(channel, self.channels)}")
