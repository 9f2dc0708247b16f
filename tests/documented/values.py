"""The values that stand between markers, each computed by the package as its page says."""

from __future__ import annotations

import contextlib
import io
import runpy
import statistics
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from masking import sweep
from masking.analysis.stability.equilibria import Equilibrium, equilibria
from masking.app import cli
from masking.control.rig.twin import Twin
from masking.lab.records.recording import Recording
from masking.lab.runs.experiment import Experiment
from masking.model.modelling.model import load_model
from tests.app.workflows import test_discover, test_discover_components, test_measure
from tests.benchmarks import (
    authentication,
    by_hand,
    clocks,
    components,
    exported,
    held,
    hidden,
    loop,
    many,
    masking_error_table,
    official,
    rths,
    rules,
    step,
    wishes,
)
from tests.campaigns.rerun import rerun

ROOT: Final = Path(__file__).parents[2]
SEEDS: Final = range(5)
WIDTH: Final = 120


@dataclass(frozen=True)
class Value:
    """One registered value: its function, which takes the words of the marker, and whether it takes minutes."""

    function: Callable[..., str]
    is_slow: bool = False


VALUES: Final[dict[str, Value]] = {"python": Value(str)}


def value(function: Callable[..., str]) -> Callable[..., str]:
    """Register a value that the gate checks."""
    VALUES[function.__name__] = Value(function)
    return function


def slow_value(function: Callable[..., str]) -> Callable[..., str]:
    """Register a value that `make docs-check` checks."""
    VALUES[function.__name__] = Value(function, is_slow=True)
    return function


def listing(text: str) -> str:
    """Return lines as an indented block of Markdown, long ones broken."""
    lines = [
        part
        for line in text.strip("\n").splitlines()
        for part in textwrap.wrap(line, WIDTH - 4, subsequent_indent=" " * (len(line) - len(line.lstrip()))) or [""]
    ]
    return textwrap.indent("\n".join(lines), "    ")


def spread(values: list[float]) -> str:
    """Return the mean of a figure over seeds, and its standard deviation, to two digits of the larger uncertainty."""
    mean, deviation = float(np.mean(values)), float(np.std(values, ddof=1))
    if deviation < 1e-3 * abs(mean):
        return f"{mean:.2g}"
    digits = max(0, 1 - int(np.floor(np.log10(deviation))) - 1)
    return f"{mean:.{digits}f} ± {deviation:.{digits}f}"


def printed(*words: str) -> str:
    """Return what a command prints."""
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()):
        cli.main([*words])
    return out.getvalue()


def worst(experiment: Experiment) -> float:
    """Return the masking error chi of the worst coordinate of a run."""
    return float(max(experiment.run().manifest["masking_error"].values()))


# Runs.


@value
def command(*words: str) -> str:
    """Return what a command prints, as a listing."""
    return listing(printed(*words[1:]))


VALUES["slow_command"] = Value(command, is_slow=True)


@value
def masking_error_of_50_units(controller: str) -> str:
    """Return the masking error of the README's experiment over 50 units of time, with a controller of a kind."""
    settings = {
        "disturbance": {"rate": "1 kHz", "observer": {"kind": "disturbance", "noise": 1e-4}},
        "exact": {"rate": "1 kHz", "observer": "exact"},
        "continuous": {"rate": "continuous"},
    }[controller]
    found = worst(Experiment.load("duffing").changed(controller=settings, duration=50.0, record=None))
    return f"{found:.1g}" if found > 1e-8 else "below 1e-8"


@slow_value
def observer_error(kind: str, order: str = "2") -> str:
    """Return chi of the worst coordinate of `huygens_rig` over 400 units of time with an observer, over seeds."""
    observer = {"kind": kind, "order": int(order)} if kind == "disturbance" else kind
    settings = {"rate": "1 kHz", "model": "setup_springs", "observer": observer}
    changed = Experiment.load("huygens_rig").changed(controller=settings, duration=400.0)
    return spread([worst(changed.changed(seed=seed)) for seed in SEEDS])


@slow_value
def held_table() -> str:
    """Return the table of the error of a held output over the rate, with its order."""
    return held.table()


@slow_value
def authentication_cost(which: str) -> str:
    """Return the time that a tag takes, rounded up: `ours`, or `theirs` with HMAC-SHA256."""
    return authentication.bound(authentication.microseconds()[("ours", "theirs").index(which)])


@slow_value
def loop_time(way: str, figure: str) -> str:
    """Return what controller, safety chain and row take, rounded up: `alone`, or with `all` beside; `p50` or `p99`."""
    ways = {"alone": loop.ALONE, "all": loop.ALL}
    return authentication.bound(statistics.median(_loop_times()[f"work {figure}"][ways[way]]))


@cache
def _loop_times() -> dict[str, dict[str, list[float]]]:
    return loop.measure(3)


@slow_value
def step_times() -> str:
    """Return the table of what a call of a controller takes from Python."""
    return step.table()


@slow_value
def clocks_table(seeds: str) -> str:
    """Return the table of the clocks over seeds, with errors that their controller does not know."""
    return "\n".join(clocks.rows(int(seeds)))


@slow_value
def clocks_figure(which: str, at: str) -> str:
    """Return a figure of the clocks over seeds: `chi` up to a time in %, or over the last 400 units before it.

    These are the amplitude over the ideal one (`amplitude`), and |th1 + th2| over the amplitude in % (`sum`).
    """
    return spread([_clocks_figures(seed)[which, at] for seed in range(clocks.SEEDS)])


@cache
def _clocks_figures(seed: int) -> dict[tuple[str, str], float]:
    run, found = clocks.clocks({}, seed), dict[tuple[str, str], float]()
    for at in clocks.TIMES:
        amplitude, total = clocks.figures(run, at, 400.0)
        kinds = {"amplitude": amplitude, "sum": 100.0 * total, "chi": 100.0 * clocks.chi(run, at)}
        found |= {(kind, f"{at:g}"): x for kind, x in kinds.items()}
    return found


@slow_value
def masking_errors() -> str:
    """Return the table of the worst chi of each packaged system on the twin, in both ways."""
    lines = ["| system | units of time | differences | disturbance observer |", "|---|---|---|---|"]
    for name in masking_error_table.SYSTEMS:
        found = {way: masking_error_table.experiment(name, way) for way in masking_error_table.WAYS}
        cells = [spread([worst(x.changed(seed=seed)) for seed in SEEDS]) for x in found.values()]
        lines.append(f"| `{name}` | {found['thesis'].declaration.duration:g} | {' | '.join(cells)} |")
    return "\n".join(lines)


@slow_value
def official_benchmarks(*names: str) -> str:
    """Return the table of measured benchmarks in their official form."""
    return official.table(names)


@slow_value
def actuators_by_hand() -> str:
    """Return the table of rigs whose actuators have dynamics, by our controller and by two others."""
    return "\n".join(by_hand.table())


@slow_value
def rths_benchmark() -> str:
    """Return the table of the public benchmark of hybrid simulation, with the nominal plants."""
    return "\n".join(rths.table())


@slow_value
def rths_perturbed(count: str) -> str:
    """Return the table of the worst of so many perturbed plants of each of its cases."""
    return "\n".join(rths.worst(int(count)))


@slow_value
def wishes_table() -> str:
    """Return the table of what a new user asks for, beside a controller written by hand."""
    return "\n".join(wishes.rows())


@slow_value
def exported_table() -> str:
    """Return the table of every packaged experiment exported."""
    return "\n".join(exported.rows())


@slow_value
def many_table(system: str) -> str:
    """Return the table of a system of 2 to 200 coordinates: the `chain` or the `beam`."""
    return many.table(system)


# Sweeps.


@value
def clocks_in_anti_phase(points: str, starts: str) -> str:
    """Return the part of Huygens' clocks that end in anti-phase, over the map of docs/sweeps.md with fewer points."""
    over = {"mu1,mu2": f"0.02:0.3:{points}", "z": f"0.02:0.6:{points}", "th2": "uniform:-0.785:0.785"}
    found = sweep(
        "huygens", over=over, runs=int(starts), sampling="latin", measure=["end"], virtual=True, workers=1, out="clocks"
    )
    return f"{100.0 * float(np.mean([kind == 'anti-phase' for kind in found['end']])):.0f} %"


@value
def fastest_damping() -> str:
    """Return the damping at which the sum of the discs decays fastest, as `examples/scripts/15_sweeps.py` finds it."""
    with contextlib.redirect_stdout(io.StringIO()):
        return f"{runpy.run_path(str(ROOT / 'examples' / 'scripts' / '15_sweeps.py'))['damping']():.2f}"


# Identification.


@slow_value
def measured(procedure: str) -> str:
    """Return the sentence of a procedure, from the record of the twin that its tests use."""
    rig, folder = Twin.load("tue_rig"), Path.cwd()
    records, words = {
        "springs": (test_measure.ramp_record, ["--plant", "tue_rig", "--sensor", "s1"]),
        "actuators": (test_measure.balance_record, ["--sensor", "s3"]),
        "friction": (test_measure.red_records, ["--plant", "tue_rig", "--sensor", "s2"]),
        "response": (test_measure.multisine_records, ["--plant", "tue_rig", "--sensor", "s1"]),
    }[procedure]
    made = records(rig, folder)
    paths = [str(path) for path in (made if isinstance(made, list) else [made])]
    return listing(printed("measure", procedure, *paths, *words, "--overwrite", "--out", "page").splitlines()[0])


# Discovery.


@cache
def _refined() -> dict[str, object]:
    with contextlib.redirect_stdout(io.StringIO()):
        return runpy.run_path(str(ROOT / "examples" / "scripts" / "10_discover_and_refine.py"))


@slow_value
def refined(*parts: str) -> str:
    """Return what `10_discover_and_refine.py` prints: what was found, what the masking gains, or both."""
    text = str(_refined()["found"]).splitlines()
    begin = next(i for i, line in enumerate(text) if line.startswith("With "))
    table = next(i for i, line in enumerate(text) if line.strip().startswith("masking error chi"))
    end = table + 3
    chosen = {"found": text[:1], "gain": text[begin:table], "table": text[table:end]}
    return listing("\n".join(line for part in parts for line in chosen[part]))


@slow_value
def discovered(case: str, part: str = "all") -> str:
    """Return what discovery prints about a record of the tests with hidden friction, or its first paragraph."""
    if case == "damper":
        Path("damper.yaml").write_text(test_discover_components.MODELS["damper"], encoding="utf-8")
        for seed, name in ((1, "train"), (2, "valid")):
            components.save(test_discover_components.RECORDS["damper/dahl_friction"](seed), Path(f"{name}.csv"))
        words = ["train.csv", "--validate", "valid.csv", "--model", "damper.yaml"]
    else:
        Path("plant.yaml").write_text(test_discover.PLANT, encoding="utf-8")
        ((_, *records),) = hidden.generate([test_discover.CASES["friction"]], 20.0, 20.0)
        for name, record in zip(("train", "valid"), records, strict=True):
            Recording(test_discover.table(record), {"name": name}).save(name, overwrite=True)
        words = ["train", "--validate", "valid", "--plant", "plant.yaml"]
    text = printed("discover", *words, "--overwrite", "--out", "results/discovered")
    return listing(text if part == "all" else text.split("\nAll of the")[0])


@slow_value
def decision_rules(*records: str) -> str:
    """Return what each decision rule changes in records when it is halved and doubled."""
    known = rules.measured(Path("answers.jsonl"), records, rules.MOST)
    return f"{rules.answers(known)}\n\n{rules.table(known)}"


# Stability.


def _further(nu: float) -> list[Equilibrium]:
    """Return the equilibria of the discs of Table 8.4, but for 0, with a strength of gravity."""
    model = load_model("discs_eccentric").dimensionless().with_parameters(nu1=nu, nu2=nu)
    return [point for point in equilibria(model).points if max(map(abs, point.position.values())) > 1e-6]


@value
def further_equilibria(nu: str, which: str = "all") -> str:
    """Return how many there are, all or the stable ones."""
    return str(sum(which == "all" or point.verdict == f"asymptotically {which}" for point in _further(float(nu))))


@slow_value
def first_further_equilibria() -> str:
    """Return the strength of gravity at which the first ones appear, by bisection."""
    low, high = 1.0, 2.0
    while high - low > 1e-3:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _further(middle) else (middle, high)
    return f"{high:.2f}"


@slow_value
def faults_table() -> str:
    """Return the faults with what is expected, and which pass; numbers that vary from run to run are left out."""
    rows = [
        f"| {found.number} | {found.injected} | {found.expected} | {'pass' if found.passes else 'fail'} |"
        for found in rerun(is_quick=True)
    ]
    passing = sum(row.endswith("| pass |") for row in rows[1:])
    head = "| # | fault | expected | |\n|---|---|---|---|"
    return f"\n\n{head}\n" + "\n".join(rows) + f"\n\n{passing} of {len(rows) - 1} pass.\n\n"
