"""Measured benchmarks in the form in which they are published: `python -m tests.benchmarks.official [NAME ...]`.

Each begins with the model in `examples/measured`, which an engineer would write. `discover` runs on its own answer
until it names nothing more; `identify` then fits all parameters to the whole estimation part; `simulate` gives the
error on the test parts, from an initial state of the first readings of each. Nothing is chosen by a test part. Named
effects, of an unknown cause the nearest, are kept in place of a law without a name, whose tables have no parameters
that `identify` could fit.

Source of the published figures: Champneys, Beintema, Toth, Schoukens and Rogers (2024), arXiv:2405.10779, and the
sources that it names; Fakhrizadeh Esfahani et al. (2018), arXiv:1705.00178, for Bouc-Wen. Form of the F-16: Noel and
Schoukens (2017), Workshop on Nonlinear System Identification Benchmarks.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import scipy.signal

import masking
from masking.app.workflows import discovery_inputs
from masking.control.rig.twin import Twin
from masking.errors import IntegrationError, ModelError
from masking.model.declaration import registry
from masking.reports import discovery_page
from masking.reports.discovery_files import Origin

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"
MOST_ROUNDS = 3  # runs of discover on its own answer
MOST_PARAMETERS = 12
HEAD = (
    "| benchmark | test part | RMSE of ours | best published | of the model as declared | parameters | found "
    "| processor time |\n"
    "|---|---|---|---|---|---|---|---|"
)


@dataclass(frozen=True)
class Test:
    """A test part: its name, record, samples of the initial state, and the best published RMSE in the unit, if any."""

    name: str
    record: str
    initial: int
    published: float | None = None


@dataclass(frozen=True)
class Case:
    """A benchmark.

    Args:
        name: of its model in `examples/measured`.
        title: in the table.
        record: that causes are sought in.
        validation: that they are validated by; the end of the record if none is given.
        estimation: that the parameters are fitted to at the end.
        tests: the test parts.
        unit: of the table, and its size in that of the readings.
        settings: how the files are read.
        search: further settings of discover.
        of_tests: how the test parts are read, where that is different.
    """

    name: str
    title: str
    record: str
    validation: str | None
    estimation: tuple[str, ...]
    tests: tuple[Test, ...]
    unit: tuple[str, float]
    settings: Mapping[str, Any]
    search: Mapping[str, Any] = field(default_factory=dict)
    of_tests: Mapping[str, Any] = field(default_factory=dict)


def part(file: str, dt: float, first: int, end: int) -> str:
    """Return the part of a record from one sample to before another."""
    return f"{file}@{max(first - 0.5, 0.0) * dt:.9g}:{(end - 0.5) * dt:.9g}"


def silverbox(_: Path) -> Case:
    """Ten multisines: the first 75 % for estimation, the last 25 % and the arrow for tests."""
    file, dt = str(DATA / "silverbox" / "SNLS80mV.mat"), 2.0**14 / 1e7
    tests = (
        Test("multisine", part(file, dt, 105_712, 127_400), 50, 0.301),
        Test("arrow", part(file, dt, 100, 40_575), 50, 0.26),
        Test("arrow without extrapolation", part(file, dt, 100, 32_100), 50, 0.259),
    )
    return Case(
        "silverbox",
        "Silverbox",
        part(file, dt, 40_650, 40_650 + 8192),
        part(file, dt, 105_712 - 8192, 105_712),
        (part(file, dt, 40_650, 105_712),),
        tests,
        ("mV", 1e-3),
        {"columns": {"u": "V1", "y": "V2"}, "dt": dt, "hold": "band-limited"},
    )


def boucwen(_: Path) -> Case:
    """A multisine for estimation and one for the test, both simulated by the authors of the benchmark."""
    train, dt = str(DATA / "boucwen" / "train.h5"), 1.0 / 750.0
    tests = (Test("multisine", str(DATA / "boucwen" / "test.h5"), 50, 18.7),)
    return Case(
        "boucwen",
        "Bouc-Wen",
        part(train, dt, 0, 16_384),
        part(train, dt, 16_384, 24_576),
        (part(train, dt, 0, 40_960),),
        tests,
        ("µm", 1e-6),
        {"columns": {"u": "multisine/u", "y": "multisine/y"}, "dt": dt, "hold": "band-limited"},
    )


def emps(_: Path) -> Case:
    """A trajectory for estimation, the same with pulses for the test, both simulated in open loop."""
    train, test = str(DATA / "emps" / "DATA_EMPS.mat"), str(DATA / "emps" / "DATA_EMPS_PULSES.mat")
    search = {"parameters": ["M", "Fv"], "shooting_interval": 0.2}
    tests = (Test("pulses", test, 20, 2.64),)
    settings = {"columns": {"u": "vir", "q": "qm"}}
    return Case("emps", "EMPS", f"{train}@:17", f"{train}@17:", (train,), tests, ("mm", 1e-3), settings, search)


def drives(folder: Path) -> list[str]:
    """Write the two records of the drives as tables of u and y, and return their files: train.csv and test.csv."""
    files = []
    for name in ("train", "test"):
        columns = [np.loadtxt(DATA / "coupled_drives" / f"{kind}_{name}.txt", skiprows=1) for kind in "XY"]
        files.append(str(folder / f"{name}.csv"))
        np.savetxt(files[-1], np.column_stack(columns), delimiter=",", header="u,y", comments="")
    return files


def coupled_drives(folder: Path) -> Case:
    """The first 400 samples of both records for estimation, the last 100 of each for tests."""
    dt, files = 0.02, drives(folder)
    tests = tuple(
        Test(f"record {number}", part(file, dt, 400, 500), 4, best)
        for number, (file, best) in enumerate(zip(files, (0.096, 0.074), strict=True), 1)
    )
    first, second = (part(file, dt, 0, 400) for file in files)
    return Case("coupled_drives", "Coupled drives", second, first, (first, second), tests, ("1/s", 1.0), {"dt": dt})


def cascaded_tanks(folder: Path) -> Case:
    """One record for estimation, its last part for validation, another record for the test."""
    held = np.genfromtxt(DATA / "cascaded_tanks" / "dataBenchmark.csv", delimiter=",", names=True)
    train, test = str(folder / "train.npz"), str(folder / "test.npz")
    np.savez(train, u=held["uEst"], y=held["yEst"])
    np.savez(test, u=held["uVal"], y=held["yVal"])
    tests, dt = (Test("validation", test, 50, 0.191),), 4.0
    return Case("cascaded_tanks", "Cascaded tanks", train, None, (train,), tests, ("V", 1.0), {"dt": dt})


def wings(folder: Path) -> list[str]:
    """Write a steady period of the F-16 at 100 Hz as tables of u and a1 ... a3, and return their files by level."""
    files = []
    for level in (1, 3, 5, 7):
        held = scipy.io.loadmat(DATA / "f16_gvt" / f"F16Data_FullMSine_Level{level}.mat")
        whole = np.vstack([held["Force"], held["Acceleration"]])
        period = scipy.signal.decimate(whole, 4, ftype="fir", axis=1)[:, 2048:4096]
        files.append(str(folder / f"level{level}.npz"))
        np.savez(files[-1], **dict(zip(("u", "a1", "a2", "a3"), period, strict=True)))
    return files


def f16(folder: Path) -> Case:
    """A steady period of each of levels 1, 3, 5 and 7 for estimation, levels 2, 4 and 6 as published for tests."""
    files = wings(folder)
    levels = [(level, DATA / "f16_gvt" / f"F16Data_FullMSine_Level{level}_Validation.mat") for level in (2, 4, 6)]
    tests = tuple(Test(f"level {level}", str(file), 50) for level, file in levels)
    columns = {"u": "Force", **{f"a{axis}": f"Acceleration/{axis}" for axis in (1, 2, 3)}}
    settings, of_tests = {"dt": 0.01, "hold": "band-limited"}, {"columns": columns, "dt": 0.0025}
    search = {"parameters": ["w1", "w2", "z1", "z2"]}  # shapes and masses of modes do not depend on the level
    return Case("f16", "F-16", files[2], files[1], tuple(files), tests, ("m/s²", 1.0), settings, search, of_tests)


CASES = {one.__name__: one for one in (coupled_drives, emps, silverbox, boucwen, cascaded_tanks, f16)}


def rows(case: Case, folder: Path) -> list[str]:
    """Return the rows of a benchmark; its files are written to a folder."""
    clock, model = time.process_time(), ROOT / "examples" / "measured" / f"{case.name}.yaml"
    plant, names = None, list[str]()
    for number in range(MOST_ROUNDS):
        given = {"model": model} if plant is None else {"plant": plant}
        out = folder / f"found{number}"
        settings = {**case.settings, **case.search, "validation": case.validation}
        try:
            found = masking.discover(case.record, **given, **settings)
        except IntegrationError:  # what was found does not run through the record from the declared initial state
            if plant is None:
                raise
            break
        causes = [cause for cause in found.effects if cause.name in found.twin.dictionary]
        sizes = found.simulation_error.validation
        print(case.name, found.verdict, [(c.name, c.on, c.probability) for c in found.effects], sizes, flush=True)
        if plant is not None and (not causes or found.verdict == "unknown"):
            break
        if not causes and found.law is None:
            break
        kept = replace(found, law=None) if causes else found
        discovery_page.save(kept, out, Origin({}))
        plant = out / "plant.yaml"
        names += [f"{name.replace('_', ' ')} ({on})" for name, on in kept.written.names]
        if found.closed:
            break
    if plant is None:
        plant = alone(model, folder)
    free = estimated(Twin.load(plant), case)
    fitted = folder / "fitted"
    masking.identify(*case.estimation, plant=plant, parameters=free, out=fitted, **case.settings)
    taken, made = time.process_time() - clock, []
    for test in case.tests:
        ours, declared = (errors(case, which, test) for which in (fitted / "plant.yaml", model))
        published = "none found" if test.published is None else f"{test.published:.3g} {case.unit[0]}"
        numbers = f"{len(free)}{'' if len(free) <= MOST_PARAMETERS else f', more than {MOST_PARAMETERS}'}"
        cells = (case.title, test.name, ours, published, declared, numbers, ", ".join(names) or "no name", below(taken))
        made.append(f"| {' | '.join(cells)} |")
        print(made[-1], flush=True)
    return made


def alone(model: Path, folder: Path) -> Path:
    """Write the rig of a model alone, in which nothing was found, into a folder, and return its plant file."""
    folder.mkdir(exist_ok=True)
    file = folder / "plant.yaml"
    declared = discovery_inputs.rig(model, None).declaration.model_dump(mode="json", exclude_defaults=True)
    file.write_text(json.dumps(declared), encoding="utf-8")
    return file


def below(seconds: float) -> str:
    """Return a time as the next larger one that is usually named: figures of a page must not change from run to run."""
    return next((f"below {most} s" for most in (30, 60, 120, 300, 600, 1200) if seconds < most), "above 1200 s")


def estimated(twin: Twin, case: Case) -> list[str]:
    """Return what discover estimated: parameters with a deviation, and those of effects of sensors and actuators."""
    known, declared = twin.base.parameters, registry.load_model(ROOT / "examples" / "measured" / f"{case.name}.yaml")
    held = {*declared.parameters} - {*case.search.get("parameters", declared.parameters)}
    of_model = [n for n in twin.equation_parameters() if known[n].std and n not in held]
    return [*of_model, *(n for n, effect in twin.parameter_names.items() if effect is not None)]


def errors(case: Case, model: str | Path, test: Test) -> str:
    """Return the root mean square of each error over a test part, without the samples of the initial state."""
    (unit, size), settings = case.unit, {**case.settings, **case.of_tests}
    try:
        made = masking.simulate(model, test.record, initial=test.initial * settings.get("dt", 1e-3), **settings)
    except ModelError:
        return "the motion is not finite"
    sizes = np.sqrt(np.mean(made.residual[test.initial :] ** 2, axis=0)) / size
    return f"{' / '.join(f'{one:.3g}' for one in sizes)} {unit}"


def table(names: Sequence[str]) -> str:
    """Return the table of some benchmarks."""
    with tempfile.TemporaryDirectory() as folder:
        cases = [CASES[name](Path(folder)) for name in names]
        return "\n".join([HEAD, *(row for case in cases for row in rows(case, Path(folder) / case.name))])


def main() -> int:
    """Measure the chosen benchmarks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(CASES)}; all by default")
    chosen = parser.parse_args().names or [*CASES]
    if not {*chosen} <= {*CASES}:
        parser.error(f"the benchmarks are {', '.join(CASES)}")
    print(table(chosen))
    return 0


if __name__ == "__main__":
    sys.exit(main())
