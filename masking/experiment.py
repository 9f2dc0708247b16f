"""Experiment: a declaration brought to life, run, and recorded."""

from __future__ import annotations

import datetime
import platform
import subprocess
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from masking.blocks import Transform, check_actuation
from masking.closed_loop import ClosedLoop
from masking.controller import Controller
from masking.declaration import meeting, registry, schema
from masking.errors import DeclarationError, Problem
from masking.fidelity import fidelity
from masking.kernels import Array
from masking.loop import Run, rig_state, run_continuous, run_sampled
from masking.model import Model
from masking.recording import Recording

# A continuous run is recorded so many times per unit of virtual time, where nothing else is asked for.
ROWS_PER_UNIT = 10
LIBRARIES = ("masking", "numpy", "numba", "sympy")


@dataclass(frozen=True)
class Experiment:
    """Which plant moves as which virtual system, from where, for how long, under which controller."""

    assembly: registry.Assembly

    @classmethod
    def load(
        cls, name_or_path: str | Path, *, plant: str | None = None, changes: Mapping[str, float] | None = None
    ) -> Experiment:
        """Load an experiment and all it refers to.

        Args:
            name_or_path: an experiment file, or the name of a packaged one.
            plant: replaces the experiment's plant.
            changes: parameters of the virtual system that replace the declared ones, in the declared units.

        Raises:
            DeclarationError: a declaration is wrong; lists every problem with its place.
        """
        declaration = registry.load_experiment(name_or_path)
        if changes:
            wrong = [name for name, value in changes.items() if not isinstance(value, int | float)]
            if wrong:
                raise DeclarationError(Problem(None, wrong[0], f"must be a number, not {changes[wrong[0]]!r}"))
            declaration = declaration.model_copy(update={"parameters": {**declaration.parameters, **changes}})
        return cls(registry.assemble(declaration, plant))

    @property
    def declaration(self) -> schema.ExperimentDeclaration:
        """Return the content of the experiment file."""
        return self.assembly.experiment

    @cached_property
    def plant(self) -> Model:
        """Return the model of the plant, in SI units."""
        return Model(self.assembly.plant_model, self.assembly.plant.parameters)

    @cached_property
    def virtual(self) -> Model:
        """Return the virtual system, in its scales where it declares any."""
        model = Model(self.assembly.virtual_model, self.declaration.parameters)
        return model.dimensionless() if model.declaration.scales else model

    @cached_property
    def controller(self) -> Controller:
        """Return the controller."""
        settings = self.declaration.controller
        overrides = {} if settings.model else self.assembly.plant.parameters
        believed = Model(self.assembly.believed_model, {**overrides, **settings.parameters})
        transform = Transform(believed, self.virtual, self.declaration.transform)
        return Controller(believed, self.virtual, transform, self.time_scale, self.declaration.transform.parameters)

    @property
    def time_scale(self) -> float:
        """Return the seconds of the rig per unit of virtual time."""
        if self.declaration.time_scale is not None:
            return self.declaration.time_scale
        if self.plant.units.is_plain or not self.virtual.declaration.scales:
            return 1.0
        return self.virtual.units.size("s", self.virtual.overrides)

    @cached_property
    def loop(self) -> ClosedLoop:
        """Return controller and plant, compiled together."""
        return ClosedLoop(self.controller, self.plant)

    @property
    def stem(self) -> str:
        """Return the name of the experiment's file, without its ending."""
        return Path(next(iter(self.declaration.files), self.declaration.name)).stem

    @property
    def is_compiled(self) -> bool:
        """Tell whether the closed loop has been compiled before and is kept on disk."""
        return self.loop.is_compiled

    def validate(self) -> None:
        """Refuse what can be refused without running.

        Raises:
            MaskingError: a model is wrong, the rig's inputs cannot accelerate every virtual coordinate, or no rig
                position gives the initial state.
        """
        for model in (self.plant, self.controller.model, self.virtual):
            model.validate()
        problems = [*registry.check_units(self.assembly), *self._check_size()]
        if problems:
            raise DeclarationError(problems)
        check_actuation(self.controller.model, self.controller.transform)
        self.virtual.initial_state(self.declaration.initial)

    def _check_size(self) -> list[Problem]:
        rows = meeting.recorded_rows(self.declaration, self.time_scale, ROWS_PER_UNIT)
        columns = meeting.count_columns(self.assembly.plant_model, self.assembly.virtual_model)
        return meeting.check_size(self.declaration, rows, columns)

    def run(self, progress: Callable[[float], None] | None = None) -> Recording:
        """Run the closed loop, integrate the virtual system by itself, and compare.

        Args:
            progress: called with the part done.

        Raises:
            DeclarationError: a unit of the plant does not fit, or the recording would not fit into memory.
            ActuationError: the rig's inputs cannot accelerate every virtual coordinate.
            SingularityError: the decoupling matrix became singular on the way.
            IntegrationError: the run could not go on.
        """
        clock = time.perf_counter()
        problems = (
            self._check_size() if self.is_compiled else [*self._check_size(), *registry.check_units(self.assembly)]
        )
        if problems:
            raise DeclarationError(problems)
        declaration, time_scale = self.declaration, self.time_scale
        rate = declaration.controller.rate
        for name in ("transform", "along", "solve_runge_kutta" if rate is None else "run_sampled"):
            getattr(self.loop.kernels, name).prepare()
        getattr(self.virtual.kernels, f"solve_{self.virtual.kernels.meta['method']}").prepare()
        compiled = time.perf_counter()
        initial = self.virtual.initial_state(declaration.initial)
        state = rig_state(self.loop, initial)
        duration = declaration.duration * time_scale
        prepared = time.perf_counter()
        if rate is None:
            times = np.linspace(0.0, duration, max(2, round(ROWS_PER_UNIT * declaration.duration) + 1))
            if declaration.record:
                times = np.arange(int(duration * declaration.record.rate * (1.0 + 1e-12)) + 1) / declaration.record.rate
            run = run_continuous(self.loop, state, times, tolerance=declaration.tolerance, progress=progress)
        else:
            every = max(1, round(rate / declaration.record.rate)) if declaration.record else 1
            run = run_sampled(self.loop, state, rate=rate, duration=duration, every=every, progress=progress)
        ran = time.perf_counter()
        ideal = self.virtual.kernels.integrate(
            run.times / time_scale,
            initial,
            np.zeros(len(self.virtual.inputs)),
            self.virtual.values(),
            tolerance=min(declaration.tolerance, 1e-12),
        )
        timing = {
            "compilation": compiled - clock,
            "preparation": prepared - compiled,
            "run": ran - prepared,
            "ideal": time.perf_counter() - ran,
        }
        return self._record(run, ideal.states, timing)

    def _record(self, run: Run, ideal: Array, timing: Mapping[str, float]) -> Recording:
        virtual = self.virtual.coordinates
        columns = {"t": run.times}
        units: dict[str, dict[str, str]] = {"t": {"unit": "s", "meaning": "time"}}
        for prefix, model, states in (
            ("rig", self.plant, run.rig),
            ("virtual", self.virtual, run.virtual),
            ("ideal", self.virtual, ideal),
        ):
            n = len(model.coordinates)
            for i, (name, coordinate) in enumerate(model.declaration.coordinates.items()):
                unit = "1" if model.is_dimensionless else model.units.conversions[coordinate.unit].si
                for prime, offset in (("", 0), ("'", n)):
                    columns[f"{prefix}.{name}{prime}"] = np.ascontiguousarray(states[:, offset + i])
                    what = coordinate.meaning if not prime else f"rate of {name}"
                    unit = f"{unit}/s" if prime and not model.is_dimensionless else unit
                    units[f"{prefix}.{name}{prime}"] = {"unit": unit, "meaning": what}
        for i, (name, port) in enumerate(self.plant.declaration.inputs.items()):
            columns[f"input.{name}"] = np.ascontiguousarray(run.inputs[:, i])
            units[f"input.{name}"] = {"unit": port.unit, "meaning": port.meaning}
        chi = {c: fidelity(columns[f"virtual.{c}"], columns[f"ideal.{c}"]) for c in virtual}
        return Recording(columns, self._manifest(units, chi, timing))

    def _manifest(
        self, columns: Mapping[str, Mapping[str, str]], chi: Mapping[str, float], timing: Mapping[str, float]
    ) -> dict[str, Any]:
        declaration, assembly = self.declaration, self.assembly
        rate = declaration.controller.rate
        limits = assembly.plant.limits.inputs
        files = {**declaration.files, **assembly.plant.files}
        for model in (assembly.plant_model, assembly.virtual_model, assembly.believed_model):
            files |= model.files
        return {
            "format": "masking recording 1",
            "name": declaration.name,
            "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "seed": declaration.seed,
            "versions": {"python": platform.python_version(), **{name: version(name) for name in LIBRARIES}},
            "commit": _commit(files),
            "files": {Path(path).name: digest for path, digest in files.items()},
            "declarations": {
                "experiment": declaration.canonical(),
                "plant": assembly.plant.canonical(),
                "plant_model": assembly.plant_model.canonical(),
                "virtual": assembly.virtual_model.canonical(),
                "controller_model": assembly.believed_model.canonical(),
            },
            "parameters": self.virtual.parameter_values(),
            "columns": dict(columns),
            "time_scale": self.time_scale,
            "virtual_name": self.virtual.name,
            "plant_name": assembly.plant.name,
            "oscillators": list(self.virtual.oscillators),
            "mode": "continuous" if rate is None else "sampled",
            "rate": rate,
            "limits": {name: {"max": limit.max, "unit": limit.unit} for name, limit in limits.items()},
            "fidelity": dict(chi),
            "timing": dict(timing),
        }


def _commit(files: Mapping[str, str]) -> str | None:
    """Return the git commit of the folder that the experiment was read from, if it is in a repository."""
    folder = Path(next(iter(files))).resolve().parent if files else Path.cwd()
    try:
        found = subprocess.run(  # the user's own git, wherever it is
            ["git", "rev-parse", "HEAD"],  # noqa: S607
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
            timeout=5,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return found.stdout.strip() or None
