"""Inputs of the virtual system of an experiment: series from files and signals, and what a run alone knows."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self, final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.control.known_instruments import Instruments
from masking.control.law import Controller
from masking.control.sampled_controller import SampledController
from masking.control.virtual_inputs import Feed, FromPush, FromSensor
from masking.errors import DeclarationError, MaskingError, Problem, RecordError, nearest
from masking.lab import signals
from masking.lab.records import column_units, readers
from masking.lab.runs.simulated_run import TwinRun
from masking.model.declaration import registry, schema
from masking.model.declaration.input_definitions import CELLS, cell
from masking.model.declaration.input_source import InputSource
from masking.model.modelling.input_series import Schedule, Series
from masking.model.modelling.model import Model


@dataclass(frozen=True, eq=False)
class InputColumn:
    """A column of a file that an input comes from, as it was when it was read."""

    times: Array  # (m,), s
    values: Array  # (m,)
    sha256: str  # of the file


@final
class InputFiles:
    """Files that inputs come from: each column is read once, whatever becomes of its file."""

    def __init__(self) -> None:
        self._known: dict[tuple[Path, str], InputColumn] = {}

    def column(self, experiment: schema.ExperimentDeclaration, name: str) -> InputColumn:
        """Column of an input of an experiment, that of the input's name where none is named.

        Its file is looked up from the folder of the experiment; a RecordError where there is no such column.
        """
        source = experiment.inputs[name]
        folder = registry.refer(experiment, f"inputs.{name}.file").folder
        path, wanted = ((folder or Path()) / str(source.file)).absolute(), source.column or name
        if (path, wanted) not in self._known:
            recording = readers.read(path)
            names = (wanted, column_units.split(wanted)[0], f"input.{wanted}")
            column = next((c for c in names if c in recording.columns), None)
            if column is None:
                raise RecordError(f"{path}: no column '{wanted}'; {nearest(wanted, [*recording.columns])}")
            self._known[path, wanted] = InputColumn(recording.t, recording[column], readers.digest(path))
        return self._known[path, wanted]

    def read(self, experiment: schema.ExperimentDeclaration) -> Self:
        """Read the files of all inputs of an experiment, and return these files."""
        for name, source in experiment.inputs.items():
            if source.file is not None:
                self.column(experiment, name)
        return self


@dataclass(frozen=True)
class VirtualInputs:
    """What the inputs of a virtual system are that are no expressions."""

    experiment: schema.ExperimentDeclaration  # the declaration, with the sources
    virtual: Model  # the virtual system, whose inputs have become definitions
    law: Controller  # the control law
    files: InputFiles  # that inputs come from

    @cached_property
    def series(self) -> dict[str, Series]:
        """Inputs known point by point, in the virtual system's units and time; a DeclarationError if unreadable."""
        given = {name: source for name, source in self.experiment.inputs.items() if source.is_series}
        return {name: self._read(name, source) for name, source in given.items()}

    def _read(self, name: str, source: InputSource) -> Series:
        try:
            if source.file:
                read = self.files.column(self.experiment, name)
                times, values = read.times, read.values
            else:
                times, values = _signal(source)
            unit, size = self._unit(name)
            own = self.virtual.units.conversions[unit].factor / size
            return Series(times, values * own, source.interpolation or "linear")
        except MaskingError as error:
            path = f"inputs.{name}"
            raise DeclarationError(Problem(self.experiment.key_place(path), path, str(error))) from None

    def _unit(self, name: str) -> tuple[str, float]:
        """Declared unit of an input, and the size in it of what the virtual system counts in: 1 but for its scales."""
        unit, units = self.virtual.declaration.parameters[cell(name, "c0")].unit, self.virtual.units
        is_scaled = self.virtual.is_dimensionless and not units.is_plain
        return unit, units.size(unit, self.virtual.overrides) if is_scaled else 1.0

    def _cells(self, name: str) -> list[int]:
        return [self.virtual.parameters.index(cell(name, part)) for part in CELLS]

    @cached_property
    def schedule(self) -> Schedule | None:
        """How series change the parameters of the virtual system, in its time; None where there are none."""
        return self._schedule(self.series)

    def _schedule(self, series: Mapping[str, Series], time_scale: float = 1.0) -> Schedule | None:
        found = [(one, self._cells(name)) for name, one in series.items()]
        return Schedule.of(found, time_scale) if found else None

    def of_rig(self, time_scale: float) -> Schedule | None:
        """How series change the parameters of the control law, in seconds of the rig."""
        found = self._schedule(self.series, time_scale)
        return None if found is None else found.moved(self._offset)

    @property
    def _offset(self) -> int:
        return len(self.law.model.parameters)

    def feed(self, instruments: Instruments) -> Feed:
        """Inputs that a sampled controller feeds to the virtual system, from sensors of its instruments."""
        sources, offset = self.experiment.inputs, self._offset
        first = {name: offset + self._cells(name)[0] for name, one in sources.items() if one.expression is None}
        sensors, gains = [], dict(zip(instruments.sensors, instruments.gains(), strict=True))
        pushes = []
        for name, one in sources.items():
            if not one.is_live:
                continue
            factor = one.factor / self._unit(name)[1]
            if one.sensor is not None:
                sensor = instruments.sensors.index(one.sensor)
                sensors.append(FromSensor(first[name], sensor, factor / gains[one.sensor]))
            elif one.push is not None:
                along = self.law.model.coordinates.index(one.push)
                pushes.append(FromPush(first[name], along, factor, one.above or 0.0))
        scale = offset + len(self.virtual.parameters) + len(self.law.transform.parameters) + len(self.law.lengths)
        series = tuple((first[name], one) for name, one in self.series.items())
        return Feed(scale, series, tuple(sensors), tuple(pushes))

    def along(self, times: Array, live: Mapping[str, Array]) -> Schedule | None:
        """Schedule of the virtual system by itself, with what was read or estimated in a run.

        `times` are those of the rig in units of virtual time (m,); `live` has each input that the run alone knows (m,).
        """
        more = {name: Series(times, values, "linear") for name, values in live.items()}
        return self._schedule({**self.series, **more})

    def columns(self, times: Array, live: Mapping[str, Array]) -> dict[str, Array]:
        """Every input that is no expression at times in units of virtual time (m,)."""
        return {name: one.at(times) for name, one in self.series.items()} | dict(live)

    def entry(self) -> dict[str, Any]:
        """Where each input comes from, for the manifest."""
        found: dict[str, Any] = {}
        for name, source in self.experiment.inputs.items():
            found[name] = source.model_dump(mode="json", exclude_defaults=True)
            if source.file is not None:
                found[name]["sha256"] = self.files.column(self.experiment, name).sha256
        return found


def live_inputs(sampled: SampledController, run: TwinRun, inputs: VirtualInputs) -> dict[str, Array]:
    """Inputs of the virtual system that only a run knows, at its times (m,), in the system's units."""
    feed, sources = sampled.feed, inputs.experiment.inputs
    names = [name for name, one in sources.items() if one.sensor is not None]
    found = {n: one.factor * run.readings[:, one.sensor] for n, one in zip(names, feed.sensors, strict=True)}
    names = [name for name, one in sources.items() if one.push is not None]
    if not names or not run.disturbances.shape[1]:
        return found
    p, forces = sampled.values(), np.empty((len(run.times), len(names)))
    for t, y, d, row in zip(run.times, run.estimates, run.disturbances, forces, strict=True):
        sampled.kernels.push(float(t), y.copy(), d.copy(), p, row)
    for name, one, force, low in zip(names, feed.pushes, forces.T, run.lasting[0], strict=True):
        found[name] = one.factor * (force - _slow(run.times, force, one.above, low, 1.0 / sampled.rate))
    return found


def _slow(times: Array, values: Array, speed: float, low: float, period: float) -> Array:
    """Slow part of a series (m,): a low-pass of first order at a speed, that was `low` a period before."""
    found, steps = np.empty(len(values)), np.diff(times, prepend=times[0] - period)
    for i, part in enumerate(-np.expm1(-speed * steps)):
        low += part * (values[i] - low)
        found[i] = low
    return found


def _signal(source: InputSource) -> tuple[Array, Array]:
    """Times and values of a signal; its seconds are units of virtual time."""
    given: dict[str, Any] = dict(source.arguments)
    make = getattr(signals, str(source.signal))
    wave = {name: given.pop(name) for name in ("frequencies", "amplitudes", "phases", "base") if name in given}
    for counted in ("number", "periods"):
        if counted in given:
            given[counted] = int(given[counted])
    made = [signals.Multisine(**wave)] if source.signal == "multisine" and "frequencies" in wave else []
    known = inspect.signature(make).parameters
    unknown = [name for name in (*given, *(() if made else wave)) if name not in known]
    missing = [n for n, p in known.items() if p.default is p.empty and n not in given and not (made and n == "signal")]
    if unknown or missing:
        words = [f"'{unknown[0]}' is none of its arguments"] if unknown else []
        words += [f"it needs {', '.join('frequencies' if n == 'signal' else n for n in missing)}"] if missing else []
        raise RecordError(f"signal {source.signal}: {'; '.join(words)}")
    found = make(*made, **given)
    return found.times, found.values[:, 0]
