"""Long run: a simulated run whose rows go to disk while it goes on, in as much memory for a day as for minutes.

Its recording is what `Experiment.run` returns, to the last bit: the same chunks, one behind the other.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from masking.display.json_text import json_text
from masking.errors import ModelError, RecordError
from masking.lab.records import parquet
from masking.lab.records.columns_on_disk import LARGE
from masking.lab.records.recording import FORMAT, Recording, writing
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.recording_columns import Columns
from masking.lab.runs.simulated_run import CHUNK, Progress, Run, TwinRun, cut
from masking.model.declaration import experiment_checks


def is_long(experiment: Experiment) -> bool:
    """Whether the recording of an experiment is so large that it goes to disk while it runs, if it can."""
    return size(experiment) > LARGE and not experiment.ideal.needs_memory


def size(experiment: Experiment) -> float:
    """Bytes of the recording of an experiment."""
    rows, columns = experiment.table_size
    return 8.0 * rows * columns


def run(
    experiment: Experiment, folder: str | Path, *, overwrite: bool = False, progress: Progress | None = None
) -> Recording:
    """Run an experiment, with its recording in a folder; the recording that is returned is on disk if it is large.

    The folder is made if need be; after an error it is as it was. Fails as `Experiment.run` does, and where a virtual
    system needs the whole run in memory, or there is no room on disk.
    """
    folder, stages = Path(folder), [time.perf_counter()]
    if experiment.ideal.needs_memory:
        raise ModelError(f"{experiment.declaration.name} cannot run in chunks: {experiment.ideal.needs_memory}")
    experiment.prepare(experiment_checks.LARGEST_ON_DISK)
    stages.append(time.perf_counter())
    simulate = experiment.simulation(CHUNK)
    stages.append(time.perf_counter())
    summary, is_over = experiment.summary(), False
    with writing(folder, overwrite=overwrite) as (manifest, table), parquet.Writer(table) as writer:
        _check_room(experiment, folder)
        for made, is_stopped in _chunks(experiment, simulate(progress=progress)):
            facts = {key: {name: unit[key] for name, unit in made.units.items()} for key in ("unit", "meaning")}
            writer.add(made.columns, facts)
            summary.add(made.columns)
            is_over = is_stopped
        stages.append(time.perf_counter())
        timing = dict(zip(("compilation", "preparation", "run"), np.diff(stages).tolist(), strict=True))
        text = json_text({"format": FORMAT, **experiment.manifest(made, summary, timing, is_stopped=is_over)}).encode()
        manifest.write(text)
        writer.close(text)
    return Recording.load(folder)


def _chunks(experiment: Experiment, runs: Iterator[Run | TwinRun]) -> Iterator[tuple[Columns, bool]]:
    """Columns of each chunk of a run, and whether its stop condition ends it there."""
    condition, reached = experiment.stop_condition, None
    watch = None if condition is None else condition.watch()
    for chunk in runs:
        row = None if watch is None else watch(experiment.seen(chunk))
        columns, reached = experiment.columns(chunk if row is None else cut(chunk, row + 1), reached)
        yield columns, row is not None
        if row is not None:
            return


def _check_room(experiment: Experiment, folder: Path) -> None:
    free, needed = shutil.disk_usage(folder).free, size(experiment)
    if needed > free:
        raise RecordError(
            f"{folder}: the recording takes up to {needed / 2**30:.3g} GiB, and {free / 2**30:.3g} GiB are free; make "
            "room, name another folder, or record less: 'record: {rate: ...}'"
        )
