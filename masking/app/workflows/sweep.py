"""The verb sweep: many runs of an experiment, or of its virtual system by itself, as rows of a table.

Rows that are on disk are done: an interrupted sweep goes on with the others (`lab.records.table_chunks`).
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.app.workflows.output_folders import own_folder
from masking.app.workflows.sweep_work import ERROR, Measure, Plan, work
from masking.display import fragments
from masking.display.json_text import json_text
from masking.display.printed_result import Printed
from masking.errors import DeclarationError, Problem, RecordError
from masking.lab.records import foreign_json, table_chunks
from masking.lab.records.file_replacement import replacing
from masking.lab.records.table_chunks import Columns
from masking.lab.runs import manifest
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.sweep_values import Design, Sampling, Values
from masking.model.declaration.units import pretty
from masking.reports import html, run_measures, sweep_page

PLAN: Final = "sweep.json"
ROWS: Final = "rows"
CHECK: Final = "sha256"  # of all else in the plan
_SHOWN: Final = 12  # rows in a notebook
Tell = Callable[[str, float], None]


@dataclass(frozen=True, repr=False)
class Sweep(Printed):
    """The rows of a sweep."""

    folder: Path  # of the results; `rows` in it is one parquet data set
    name: str  # of the experiment
    columns: Columns  # of the rows that are done, in order: number, parameters, measures, error
    rows: int  # number of all runs of the sweep
    sentence: str  # what happened
    facts: Mapping[str, Any]  # what varies, and what was measured

    def __getitem__(self, name: str) -> Any:  # noqa: ANN401  # an array, or a list of texts or arrays
        """Column."""
        return self.columns[name]

    def __len__(self) -> int:
        return len(self.columns["run"])

    def as_dict(self) -> dict[str, Any]:
        """Summary as JSON can hold it."""
        failed = sum(bool(text) for text in self.columns[ERROR])
        words = [name for name in self.facts["measures"] if name in run_measures.WORDS]
        return {
            "name": self.name, "runs": self.rows, "done": len(self), "failed": failed, "sentence": self.sentence,
            "over": self.facts["over"], "measures": self.facts["measures"],
            "units": self.facts.get("units", {}),
            "counts": {name: sweep_page.counts(self[name]) for name in words}, "rows": str(self.folder / ROWS),
        }  # fmt: skip

    def __str__(self) -> str:
        return self.sentence

    def _repr_html_(self) -> str:
        shown = {name: values for name, values in self.columns.items() if np.ndim(values[0]) == 0}
        rows = [
            [str(x) if isinstance(x, str) else f"{x:.5g}" for x in row] for row in zip(*shown.values(), strict=True)
        ]
        size = f"{len(self)} of {self.rows} runs" + f", the first {_SHOWN} here" * (len(rows) > _SHOWN)
        return fragments.card(self.name, f"{size}. {self.sentence}", fragments.table([*shown], rows[:_SHOWN]))


def sweep(
    experiment: str | Path | Experiment,
    *,
    over: Mapping[str, Values] | None = None,
    runs: int | None = None,
    seed: int = 0,
    measure: Sequence[Measure] = (),
    sampling: Sampling = "random",
    virtual: bool = False,
    continuation: bool = False,
    trajectories: bool = False,
    changes: Mapping[str, float] | None = None,
    duration: float | None = None,
    part: tuple[int, int] = (1, 1),
    workers: int | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    tell: Tell | None = None,
) -> Sweep:
    """Run an experiment many times, with other values each time, and measure each run.

        masking.sweep("huygens", over={"mu1,mu2": "0.01:0.2:50"}, measure=["alpha", "verdict"])

    Finished runs are on disk: after an interruption, the same call makes the runs that are missing. Where functions of
    a script are measures, call it there under `if __name__ == "__main__":`, since other processes import the script.

    Args:
        experiment: an experiment file, the name of a packaged one, or an `Experiment`.
        over: what varies, by parameter, coordinate or velocity of the virtual system (`z3`, `x1'`), `EFFECT.PARAMETER`
            of the plant, `plant.PARAMETER` of its model, or a number of the experiment (`duration`), several with
            commas between them: values, a frozen distribution of scipy.stats, or a text such as '0.1:0.4:50',
            '0.1:0.4:50:log', '1,2,5', 'normal:0.2:0.01', 'uniform:0:1', 'loguniform:0.1:10', each after 'x:' for
            multiples of the declared value; 'fit:FILE' for `plant`, which draws from the covariance of a fit.
        runs: drawn from distributions at each point of the grid; a plant's noise has another seed in each.
        seed: of what is drawn.
        measure: of each run: 'alpha', 'eps', 'tau_s', 'phase', 'verdict', 'end', 'period', 'chi', 'peak', 'used',
            'chi.x1', 'peak.V1', 'maxima.x1', "section.x1@x2'", 'end.x1', or functions of a recording that return a
            number; by default those of two oscillators, and of the rig.
        sampling: 'random', 'latin' (hypercube) or 'sobol'.
        virtual: integrate the virtual system by itself, without a rig, which is much faster.
        continuation: of the virtual system: follow the last grid up and down, each run from the end of the one before.
        trajectories: keep the virtual motion of each run.
        changes: parameters of the virtual system that all runs have, in the declared units.
        duration: of each run, in units of virtual time; by default as declared.
        part: k and n: make the k-th of n parts; copy the `rows` of all into one folder, and sweep there without part.
        workers: processes; by default as many as there are cores.
        out: folder of the results; by default results/EXPERIMENT_sweep.
        overwrite: whether another sweep in that folder may be replaced.
        tell: called with what is done and how long the rest takes, and the fraction done.

    Raises:
        DeclarationError: a declaration, a name, values or a measure is wrong.
        RecordError: the folder cannot be written, or holds another sweep.
        MaskingError: a process of the sweep ended: finished runs are kept.
    """
    whole = experiment if isinstance(experiment, Experiment) else Experiment.load(experiment)
    sections: dict[str, Any] = {}
    if changes:
        sections["parameters"] = {**whole.declaration.parameters, **changes}
    if duration is not None:
        sections["duration"] = duration
    whole = whole.changed(**sections) if sections else whole
    design = Design.of(over or {}, runs, seed, sampling)
    kind = (virtual, continuation, trajectories)
    plan = Plan(whole, design, tuple(measure), *kind)
    plan = plan if plan.measures else replace(plan, measures=plan.measurable.defaults)
    plan.check()
    first, last = _range(plan, part)
    folder = Path(out or f"results/{whole.stem}_sweep")
    facts = _facts(plan)
    with own_folder(folder):
        _begin(folder, facts, overwrite=overwrite)
        missing = table_chunks.missing(table_chunks.done(folder / ROWS), first, last)
        count = min(workers or os.cpu_count() or 1, max(1, sum(b - a for a, b in missing) // plan.chain))
        begun, before, done, todo = 0.0, 0, 0, sum(b - a for a, b in missing)
        for a, b, columns, _ in work(plan, missing, workers=count):
            table_chunks.write(folder / ROWS, a, b, columns, facts["identity"])
            done += b - a
            if not begun:  # the first chunk waits for compilers
                begun, before = time.monotonic(), done
            if tell is not None:
                left = (time.monotonic() - begun) * (todo - done) / max(done - before, 1)
                finished = last - first - todo + done
                more = f", {_clock(left)} left" if done > before else ""
                tell(f"{finished} of {last - first} runs{more}", finished / (last - first))
        found = load_sweep(folder)
        sweep_page.save(facts, found.columns, found.sentence, folder)
    return found


def load_sweep(folder: str | Path) -> Sweep:
    """Load the rows of a sweep that are done.

    Args:
        folder: of the sweep.

    Raises:
        RecordError: the folder holds no sweep, or no rows.
    """
    path = Path(folder)
    facts = _read(path)
    columns = table_chunks.read(path / ROWS, facts["identity"])
    return Sweep(path, facts["name"], columns, facts["rows"], sweep_page.sentence(facts, columns), facts)


def _range(plan: Plan, part: tuple[int, int]) -> tuple[int, int]:
    """Rows of a part: first, and one more than the last."""
    k, n = part
    chains = plan.rows // plan.chain
    if not 1 <= k <= n:
        raise DeclarationError(Problem(None, "part", f"there is no part {k}/{n}", "give 1/4 to 4/4 for four parts"))
    return chains * (k - 1) // n * plan.chain, chains * k // n * plan.chain


def _facts(plan: Plan) -> dict[str, Any]:
    """Description of a sweep as JSON, with a hash of all that its rows depend on."""
    experiment, design = plan.experiment, plan.design
    declared = manifest.content(experiment.assembly, experiment.virtual, {})["declarations"]
    names = [one if isinstance(one, str) else one.__name__ for one in plan.measures]
    kind = {"virtual": plan.virtual, "continuation": plan.continuation, "trajectories": plan.trajectories}
    over = [
        {"name": axis.label, "grid": None if axis.values is None else axis.values.tolist(), "factor": axis.is_factor}
        for axis in design.axes
    ]
    units = {one: plan.measurable.unit(one) for one in plan.measures if isinstance(one, str)}
    for one, places in zip(over, plan.places, strict=True):
        one["unit"] = "" if places[0].unit == "1" else pretty(places[0].unit)
    every = [declared, over, names, units, kind, design.runs, design.seed]
    given = json.dumps(every, sort_keys=True, default=str).encode()
    identity = hashlib.sha256(given + np.ascontiguousarray(design.points).tobytes()).hexdigest()
    return {
        "name": experiment.declaration.name, "identity": identity, "rows": plan.rows, "runs": design.runs,
        "seed": design.seed, "sampling": design.sampling, "over": over, "measures": names, "units": units, **kind,
    }  # fmt: skip


def _begin(folder: Path, facts: Mapping[str, Any], *, overwrite: bool) -> None:
    """Write what a sweep is into its folder, unless it is there."""
    path = folder / PLAN
    if path.exists() and _read(folder)["identity"] != facts["identity"]:
        if not overwrite:
            raise RecordError(
                f"{folder} holds another sweep: what varies, the measures or the experiment have changed; name another "
                "folder with --out, or replace it with --overwrite (in Python, out= and overwrite=True)"
            )
        shutil.rmtree(folder / ROWS, ignore_errors=True)
        path.unlink()
    if not path.exists():
        with html.writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            with replacing(path) as stream:
                stream.write(json_text({**facts, CHECK: _check(facts)}).encode())
    table_chunks.clear(folder / ROWS)


def _read(folder: Path) -> dict[str, Any]:
    path = folder / PLAN
    try:
        found: dict[str, Any] = foreign_json.load(path, dict[str, Any])
    except RecordError as error:
        raise RecordError(f"{folder} holds no sweep: there is no {PLAN} in it that can be read ({error})") from None
    if found.pop(CHECK, "") != _check(found):  # else it is what this program wrote, all of it
        raise RecordError(f"{path} was changed since it was written; begin anew in another folder")
    return found


def _check(facts: Mapping[str, Any]) -> str:
    return hashlib.sha256(json_text(facts).encode()).hexdigest()


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
