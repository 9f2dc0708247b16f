"""Recording: the series of one run and the manifest that says what they are; one folder on disk.

    recording.parquet   the columns, zstd-compressed, with the manifest inside
    manifest.json       the same manifest as text, for people and other programs

Column names: `t` (time of the plant), `rig.<coord>` and `rig.<coord>'` (the plant's coordinates and velocities),
`virtual.<coord>` and `virtual.<coord>'` (the same motion seen through the transform T), `ideal.<coord>` and
`ideal.<coord>'` (the virtual system integrated by itself), `input.<name>`; further columns are kept as they are.
Each column of the table has its unit and its meaning in the metadata of its field.

A long recording stays on disk: `between` reads a part of it, `chunks` one part after the other.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from masking.display import thinning
from masking.display.characters import visible, visible_line
from masking.display.json_text import json_text
from masking.errors import RENAMED, RecordError, nearest
from masking.lab.records import named_files
from masking.lab.records.columns_on_disk import StoredColumns, read
from masking.lab.records.file_replacement import replacing
from masking.lab.records.time_slice import Part
from masking.lazy_imports import axes, parquet, series_views

FORMAT: Final = "masking recording 1"
TABLE: Final = "recording.parquet"
MANIFEST: Final = "manifest.json"
_DRAWN: Final = 2**15  # samples of a recording on disk that a picture in a notebook has
_REMEDY = f"give a folder that holds {TABLE}, such as results/duffing"


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """The series of one run and its manifest.

    `columns` are 1-D, equally long, finite and kept as read-only float64; `t` is one of them and strictly increasing.
    Anything else is a `RecordError` that names the column and the first bad row (rows count from 0). Those of a
    recording that would take more than 256 MiB stay on disk when it is loaded, and are checked when they are read.
    `manifest` holds whatever JSON can hold; numpy scalars and arrays become numbers and lists when it is saved, and
    numbers that JSON lacks become the texts "inf", "-inf" and "nan", which `float()` reads back.
    `notes` are sentences about how it was read, which the report repeats; they are not saved. `text` makes what `print`
    shows, which the verb run gives it.
    """

    columns: Mapping[str, NDArray[np.float64]]
    manifest: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    text: Callable[[Recording], str] = repr

    def __str__(self) -> str:
        return self.text(self)

    def __post_init__(self) -> None:
        if isinstance(self.columns, StoredColumns):
            return
        object.__setattr__(self, "columns", {name: _column(name, values) for name, values in self.columns.items()})
        _check(self.columns)

    def __getitem__(self, column: str) -> NDArray[np.float64]:
        """One column (samples,)."""
        try:
            return self.columns[column]
        except KeyError:
            raise RecordError(f"the recording has no column '{column}'; {nearest(column, self.columns)}") from None

    def __len__(self) -> int:
        return self.columns.rows if isinstance(self.columns, StoredColumns) else len(self.columns["t"])

    def __repr__(self) -> str:
        name = self.manifest.get("name", "without a name")
        size = f"{len(self)} samples of {len(self.columns)} columns"
        first, last = self.span
        return f"<Recording {name}: {size}, t = {first:g} to {last:g}>"

    def _repr_html_(self) -> str:
        chi = self.manifest.get("masking_error") or {}
        errors = ", ".join(f"{name} {float(value):.2g}" for name, value in chi.items())
        first, last = self.span
        size = f"{len(self)} samples, t = {first:g} to {last:g} {self.units.get('t', '')}".rstrip()
        subtitle = f"{size}; masking error chi: {errors}" if errors else size
        return series_views.card(self.name or "Recording", subtitle, self._drawn.columns, self.units, self.meanings)

    @property
    def _drawn(self) -> Recording:
        return self.thinned(_DRAWN) if self.is_on_disk else self

    @property
    def is_on_disk(self) -> bool:
        """Whether its columns are on disk, and read where they are asked for."""
        return isinstance(self.columns, StoredColumns)

    @property
    def path(self) -> Path | None:
        """File that its columns are read from where they are asked for; None where they are in memory."""
        return self.columns.table.path if isinstance(self.columns, StoredColumns) else None

    @property
    def name(self) -> str:
        """Name of the run, "" where it has none."""
        return str(self.manifest.get("name") or "")

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column that has one, by name; numbers without a unit have none."""
        return {name: unit for name, unit in self._declared("unit").items() if unit not in {"1", "dimensionless"}}

    @property
    def meanings(self) -> dict[str, str]:
        """Meaning of each column that has one, by name."""
        return self._declared("meaning")

    def _declared(self, key: str) -> dict[str, str]:
        entries = self.manifest.get("columns")
        entries = entries if isinstance(entries, Mapping) else {}
        found = {name: entries[name] for name in self.columns if isinstance(entries.get(name), Mapping)}
        return {name: str(entry[key]) for name, entry in found.items() if entry.get(key)}

    @property
    def t(self) -> NDArray[np.float64]:
        """Time of the plant, shape (samples,)."""
        return self.columns["t"]

    @property
    def span(self) -> tuple[float, float]:
        """First and last time."""
        if isinstance(self.columns, StoredColumns):
            return self.columns.spans[0][0], self.columns.spans[-1][-1]
        return float(self.t[0]), float(self.t[-1])

    def between(self, start: float | None = None, end: float | None = None) -> Recording:
        """Part of it, in memory: the samples from one time on, and before another; times stay as they are.

        Args:
            start: s; None for its beginning.
            end: s; None for its end.

        Raises:
            RecordError: it does not reach so far, or no sample lies between them.
        """
        words = ["" if time is None else f"{time:.9g}" for time in (start, end)]
        part, (first, last) = Part(f"{self.name or 'the recording'}@{':'.join(words)}", Path(), start, end), self.span
        step = (last - first) / max(1, len(self) - 1)
        limits = part.within(first, last, step)
        found = self.columns.around(*limits) if isinstance(self.columns, StoredColumns) else self.columns
        rows = slice(*np.searchsorted(found["t"], limits, side="left"))
        if rows.start == rows.stop:
            raise part.empty(first, last, step)
        return replace(self, columns={name: column[rows] for name, column in found.items()})

    def chunks(self, names: Sequence[str] | None = None) -> Iterator[Mapping[str, NDArray[np.float64]]]:
        """Columns by name, all or some of them, one stretch of time after the other; a single one in memory."""
        if isinstance(self.columns, StoredColumns):
            yield from self.columns.chunks(names)
        else:
            yield {name: self[name] for name in (self.columns if names is None else names)}

    def thinned(self, most: int, sampled: Collection[str] = (), names: Sequence[str] | None = None) -> Recording:
        """Recording with fewer samples, evenly in time, in memory; itself if it has no more than `most`.

        Args:
            most: samples.
            sampled: names of columns that are sampled; of the others, the least and the greatest value of each stretch
                of time are kept, as a picture shows them.
            names: of the columns, the clock among them; by default all.
        """
        step = thinning.step_for(len(self), most)
        if step == 1 and not self.is_on_disk:
            return self
        return replace(self, columns=thinning.thinned(self.chunks(names), step, {"t", *sampled}))

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the virtual system's coordinates, in the order of the columns."""
        return self.names("virtual")

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the plant's inputs, in the order of the columns."""
        return self.names("input")

    def names(self, prefix: str | None = None) -> tuple[str, ...]:
        """Names behind `prefix.`, derivatives left out; without a prefix, the names of all columns.

        Args:
            prefix: "rig", "virtual", "ideal", "input" or any other.
        """
        if prefix is None:
            return tuple(self.columns)
        start = f"{prefix}."
        return tuple(c.removeprefix(start) for c in self.columns if c.startswith(start) and not c.endswith("'"))

    def array(self, prefix: str, derivative: int = 0) -> NDArray[np.float64]:
        """Stack the columns of one prefix side by side: of a motion those of coordinates, without internal states.

        Args:
            prefix: "rig", "virtual", "ideal" or "input".
            derivative: 0 for the coordinates, 1 for their velocities.

        Returns:
            (samples, channels), channels in the order of the columns.

        Raises:
            RecordError: there are no such columns.
        """
        names = self.names(prefix)
        if not names:
            prefixes = dict.fromkeys(c.split(".")[0] for c in self.columns if "." in c)
            raise RecordError(f"the recording has no columns '{prefix}.*'; {nearest(prefix, prefixes)}")
        primes, names = "'" * derivative, tuple(n for n in names if f"{prefix}.{n}'" in self.columns) or names
        return np.column_stack([self[f"{prefix}.{name}{primes}"] for name in names])

    def to_pandas(self) -> Any:  # noqa: ANN401  # pandas is optional
        """Pandas DataFrame over the time, with `units` and `meanings` in its `attrs`; a RecordError without pandas."""
        return series_views.frame(self.columns, self.units, self.meanings)

    def to_xarray(self) -> Any:  # noqa: ANN401  # xarray is optional
        """Xarray Dataset over the time `t`; variables have `units` and `long_name`. A RecordError without xarray."""
        return series_views.dataset(self.columns, self.units, self.meanings, self.name)

    def plot(self, *columns: str) -> axes.NotebookFigure:
        """Draw columns over the time, one row of axes for each argument; a notebook shows the figure.

        Args:
            columns: names, such as "virtual.x1", or prefixes, such as "input"; by default the virtual motion, with that
                of the virtual system by itself as dashed lines, and the inputs.

        Raises:
            RecordError: there is no such column or prefix.
        """
        prefixes = dict.fromkeys(name.partition(".")[0] for name in self.columns if "." in name)
        usual = [name for name in prefixes if name in {"virtual", "input"}] or [*prefixes]
        usual = usual or [name for name in self.columns if name != "t"]
        rows = []
        for name in columns or usual:
            if name not in self.columns and name not in prefixes:
                allowed = [*prefixes, *self.columns]
                raise RecordError(f"the recording has no column or prefix '{name}'; {nearest(name, allowed)}")
            rows.append([name] if name in self.columns else [f"{name}.{short}" for short in self.names(name)])
        return series_views.figure(self._drawn.columns, self.units, rows, self.name)

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write both files into `folder`, made if need be, and return it; after an error the folder is as it was.

        Args:
            folder: where to.
            overwrite: whether a recording that is there may be replaced.

        Raises:
            RecordError: it cannot be written, or holds a recording that may not be replaced.
        """
        with writing(Path(folder), overwrite=overwrite) as (manifest, table):
            manifest.write(self.write(table))
        return Path(folder)

    def write(self, table: BinaryIO) -> bytes:
        """Write the table to a stream, with the manifest inside, and return the manifest as text."""
        text = json_text({"format": FORMAT, **self.manifest}).encode()
        with parquet.Writer(table, text) as writer:
            for chunk in self.chunks():
                writer.add(chunk, {"unit": self.units, "meaning": self.meanings})
            writer.close()
        return text

    @classmethod
    def load(cls, path: str | Path) -> Recording:
        """Read a recording from its folder or its parquet file.

        The manifest inside the table is what counts; a `manifest.json` beside it that is absent, broken or different
        is reported in `notes`.

        Raises:
            RecordError: it is no recording of ours, or damaged.
        """
        path = Path(path)
        if path.is_dir():
            path /= TABLE
        if not path.is_file():
            remedy = "" if path.parent.is_dir() else f"; the folder {path.parent} does not exist"
            raise RecordError(f"{path}: no such recording{remedy}; {_REMEDY}")
        columns, text = read(path)
        if text is None:
            raise RecordError(f"{path}: not a recording: the table carries no manifest")
        try:
            manifest = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise RecordError(f"{path}: the manifest inside the table is not JSON ({error})") from error
        if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
            found = manifest.get("format") if isinstance(manifest, dict) else None
            raise RecordError(f"{path}: its format is '{found}'; this program reads '{FORMAT}'")
        for old in RENAMED.keys() & manifest.keys():
            raise RecordError(
                f"{path}: an older version of this program wrote it: '{old}' in its manifest is called "
                f"'{RENAMED[old]}' now; make the record again, or read its columns from a csv file"
            )
        try:
            return cls(columns, _shown(manifest), _notes(path, manifest))
        except RecordError as error:
            raise RecordError(f"{path}: {error}") from error


@contextmanager
def writing(folder: Path, *, overwrite: bool = False) -> Iterator[tuple[BinaryIO, BinaryIO]]:
    """Streams of both files of a recording, manifest and table, in a folder that is made if need be.

    After an error the folder is as it was. A RecordError where it cannot be written, or holds a recording and
    `overwrite` is not given.
    """
    held = next((name for name in (TABLE, MANIFEST) if (folder / name).exists()), None)
    if held and not overwrite:
        raise RecordError(f"{folder} holds an earlier recording, {held}; name another folder, or give overwrite=True")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with replacing(folder / MANIFEST) as manifest, replacing(folder / TABLE) as table:
            yield manifest, table
    except OSError as error:
        raise RecordError(f"{folder}: the recording cannot be written: {error.strerror or error}") from error


def _notes(table: Path, manifest: Mapping[str, Any]) -> tuple[str, ...]:
    """How the manifest beside a table differs from the one inside it; nothing for a table that lies alone."""
    if table.name != TABLE:
        return ()
    try:
        if json.loads(named_files.content(table.with_name(MANIFEST))) == manifest:
            return ()
        what = "says something else"
    except FileNotFoundError:
        what = "is missing"
    except (OSError, ValueError, RecursionError):
        what = "cannot be read"
    return (f"{MANIFEST} {what}: the copy inside {TABLE} was used.",)


def _shown(content: Any) -> Any:  # noqa: ANN401  # what JSON holds
    """A tree of values with texts that can be shown."""
    match content:
        case str():
            return visible(content)
        case dict():
            return {visible_line(key): _shown(value) for key, value in content.items()}
        case list():
            return [_shown(value) for value in content]
    return content


def _column(name: str, values: Any) -> NDArray[np.float64]:  # noqa: ANN401  # whatever numpy can make an array of
    if not isinstance(name, str) or not name:
        raise RecordError(f"a column's name must be a text, not {name!r}")
    try:
        column = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RecordError(f"column '{name}' does not hold real numbers ({error})") from error
    if np.ndim(values) != 1:
        raise RecordError(f"column '{name}' has shape {np.shape(values)}; a column is 1-D")
    column = column.view()
    column.flags.writeable = False
    return column


def _check(columns: Mapping[str, NDArray[np.float64]]) -> None:
    if "t" not in columns:
        raise RecordError(f"the recording has no column 't'; {nearest('t', columns)}")
    t = columns["t"]
    if not len(t):
        raise RecordError("the recording has no samples")
    for name, column in columns.items():
        if len(column) != len(t):
            raise RecordError(f"column '{name}' has {len(column)} samples, 't' has {len(t)}")
        finite = np.isfinite(column)
        if not finite.all():
            row = int(np.argmin(finite))
            at = f" (t = {t[row]:.9g})" if name != "t" else ""
            count = len(column) - int(np.count_nonzero(finite))
            rest = f"; {count} such rows in all" if count > 1 else ""
            raise RecordError(f"column '{name}' is {column[row]} in row {row}{at}{rest}")
    rising = np.diff(t) > 0
    if not rising.all():
        row = int(np.argmin(rising)) + 1
        raise RecordError(f"column 't' must increase strictly: row {row} is {t[row]:.9g} after {t[row - 1]:.9g}")
