"""Calibration findings: fits from the simplest model to the plant's own, curves and errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.display.printed_result import Printed, aligned
from masking.inference.estimation.fit import Fit
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.simulation import noise_alone, simulate

PERIOD: Final = 20.0  # s, of the excitation; its lines are the harmonics
HIGHEST: Final = 4.0  # Hz, of these lines, on a rig whose motions are neither faster nor much slower
NAMES: Final = ("small", "fit", "unseen")  # of the records
PAGE: Final = "index.html"
ALIKE: Final = 0.01  # part by which errors may differ for the simpler model to be taken
STRAIGHT: Final = 1e-6  # of a spring's force: less than this from a straight line is rounding
_POINTS = 121  # of a curve
_MARGIN = 1.1  # times the displacement that was reached: how far a curve is drawn
_STEP = 1e-4  # of a parameter, relative, for differences


@dataclass(frozen=True)
class Records:
    """Records of a rig under multisines: the one to fit, and the validation record."""

    fit: Data
    unseen: Data
    size: float  # part of the largest command that these reach
    limits: Array  # largest command of each actuator, in its unit (actuators,)
    missed: Mapping[str, int]  # samples of each record that were missed, by its name
    highest: float = HIGHEST  # Hz, of the excitation


@dataclass(frozen=True)
class Stage:
    """One model of the plant, fitted: what it holds, the fit, and the parameters that were to be fitted."""

    name: str
    fit: Fit
    parameters: tuple[str, ...] = ()

    @property
    def worst(self) -> float:
        """Largest relative error of a sensor in the record that was not fitted."""
        return max(self.fit.validation.values())


@dataclass(frozen=True)
class Curve:
    """The force of a spring over its displacement, at rest."""

    element: str
    meaning: str
    unit: str  # of the force, as the model declares it
    measured: str  # declared unit of the displacement
    displacement: Array  # (m,)
    force: Array  # of the best model (m,)
    std: Array  # standard deviation of that (m,)
    declared: Array  # force of what the plant file said (m,)
    linear: Array  # force of the simplest model (m,)
    # low and high: least and largest displacement that the fitted record reached
    low: float
    high: float


@dataclass(frozen=True)
class Excited:
    """Commands of one actuator in the fitted record, in its unit, as long as one period."""

    name: str
    unit: str
    # times and values: s, and commands (m,)
    times: Array
    values: Array
    # frequencies and amplitudes: of the sines, Hz (lines,)
    frequencies: Array
    amplitudes: Array
    limit: float  # its largest command

    @property
    def peak(self) -> float:
        """Largest magnitude."""
        return float(np.abs(self.values).max())

    @property
    def rms(self) -> float:
        """Root mean square."""
        return float(np.sqrt((self.values**2).mean()))

    @property
    def lines(self) -> Array:
        """Frequencies at which there is something, Hz."""
        return np.asarray(self.frequencies[self.amplitudes > 1e-3 * self.amplitudes.max()])


@dataclass(frozen=True, repr=False)
class Calibration(Printed):
    """What a calibration found: stages from the simplest model to the plant file's own, and where it was written."""

    twin: Twin
    records: Records
    stages: tuple[Stage, ...]
    folder: Path

    @cached_property
    def best(self) -> Stage:
        """Simplest stage that errs in the unseen record hardly more than the one that errs least."""
        least = min(stage.worst for stage in self.stages)
        return next(stage for stage in self.stages if stage.worst <= (1.0 + ALIKE) * least)

    @property
    def floor(self) -> dict[str, float]:
        """Relative error that noise alone makes in the fitted record, by sensor."""
        return self.best.fit.floor

    @property
    def unseen_floor(self) -> dict[str, float]:
        """Relative error that noise alone makes in the unseen record, by sensor."""
        return noise_alone(self.twin.sensors, [self.records.unseen])

    @cached_property
    def residuals(self) -> dict[str, Array]:
        """Residual of each stage in the unseen record, measured less simulated (m, sensors), by its name."""
        return {s.name: simulate(s.fit.twin, self.records.unseen, s.parameters).residual for s in self.stages}

    @cached_property
    def excited(self) -> tuple[Excited, ...]:
        """Commands of the actuators."""
        record, actuators = self.records.fit, self.twin.declaration.actuators or self.twin.model.declaration.inputs
        count = min(len(record), round(PERIOD * record.rate))
        t = np.arange(count) / record.rate
        frequencies = np.asarray(np.fft.rfftfreq(count, 1.0 / record.rate), dtype=float)
        found = []
        for i, name in enumerate(self.twin.actuators):
            values = record.commands[:count, i]
            spectrum = np.asarray(2.0 * np.abs(np.fft.rfft(values)) / count)
            unit, limit = actuators[name].unit, float(self.records.limits[i])
            found.append(Excited(name, unit, t, values, frequencies, spectrum, limit))
        return tuple(found)

    @cached_property
    def curves(self) -> tuple[Curve, ...]:
        """Springs of the best model whose force is not in proportion to displacement."""
        return tuple(curve for curve in (_curve(self, name) for name in self.best.fit.twin.base.elements) if curve)

    def as_dict(self) -> dict[str, Any]:
        """Calibration as JSON can hold it."""
        return {
            "stages": {stage.name: stage.fit.as_dict() for stage in self.stages},
            "best": self.best.name,
            "model": str(self.folder / "model.yaml"),
            "plant": str(self.folder / "plant.yaml"),
            "report": str(self.folder / PAGE),
        }

    @property
    def headline(self) -> str:
        """Model that an unseen record speaks for, and its values."""
        return f"of {self.twin.declaration.name}, {self.best.name}: {self.best.fit.headline}"

    def __str__(self) -> str:
        sensors = self.stages[0].fit.chi
        head = ["", *(f"chi {name}" for name in sensors), *(f"unseen {name}" for name in sensors)]
        rows = [
            [stage.name, *(f"{x:.4f}" for chi in (stage.fit.chi, stage.fit.validation) for x in chi.values())]
            for stage in self.stages
        ]
        rows.append(["noise alone", *(f"{x:.4f}" for x in self.floor.values()), *("" for _ in sensors)])
        lines = aligned([head, *rows])
        lines.append(f"written: {self.folder / 'model.yaml'}, {self.folder / 'plant.yaml'} ({self.best.name})")
        lines.append(f"report: {self.folder / PAGE}")
        return "\n".join(lines)


def reached(twin: Twin, record: Data) -> dict[str, tuple[float, float]]:
    """How far coordinates with a limit went, and their limits, in SI units, by the limit's expression.

    A coordinate is what the sensors that measure it read; one without a sensor is left out.
    """
    found = {}
    for what, limit in twin.declaration.limits.coordinates.items():
        for i, (name, sensor) in enumerate(twin.declaration.sensors.items()):
            if sensor.measures.text.replace(" ", "") == what.text.replace(" ", ""):
                far = float(np.abs(record.readings[:, i]).max() / abs(twin.gain(name)))
                found[what.text] = far, limit.max * twin.size(limit.unit)
    return found


def _curve(found: Calibration, element: str) -> Curve | None:
    """Curve of a spring of the best model; None where it is straight, or no sensor measures it."""
    fit, declared = found.best.fit, found.best.fit.twin.base.elements[element]
    text = "" if declared.displacement is None else declared.displacement.text.replace(" ", "")
    sensors = found.twin.declaration.sensors.values()
    at = next((i for i, s in enumerate(sensors) if s.measures.text.replace(" ", "") == text), None)
    if at is None:
        return None
    seen = found.records.fit.readings[:, at] / found.twin.gain(found.twin.sensors[at])
    far = _MARGIN * float(np.abs(seen).max())
    d = np.linspace(-far, far, _POINTS)
    force = _force(fit.twin, element, d)
    if force is None or np.abs(force - np.polyval(np.polyfit(d, force, 1), d)).max() <= STRAIGHT * np.ptp(force):
        return None
    slopes = []
    for name, value in zip(fit.names, fit.values, strict=True):
        step = _STEP * (abs(value) or 1.0)
        ahead, behind = (_force(fit.twin.with_parameters({name: value + s}), element, d) for s in (step, -step))
        slopes.append((_known(ahead, d) - _known(behind, d)) / (2.0 * step))
    jacobian = np.array(slopes).T
    std = np.sqrt(np.maximum(((jacobian @ fit.covariance) * jacobian).sum(axis=1), 0.0))
    before, linear = (_known(_force(t, element, d), d) for t in (found.twin, found.stages[0].fit.twin))
    low, high = float(seen.min()), float(seen.max())
    model, moved = fit.twin.model, next(iter(declared.acts))
    (measured, size), meaning = model.shown[moved], declared.meaning or element
    return Curve(
        element, meaning, declared.unit, measured, d / size, force, std, before, linear, low / size, high / size
    )


def _known(force: Array | None, d: Array) -> Array:
    return np.full(len(d), np.nan) if force is None else force


def _force(twin: Twin, element: str, displacements: Array) -> Array | None:
    """Force of an element at rest (m,), with all others at no displacement; None if it cannot be determined.

    With the displacements d = D q of all elements and what they do to the accelerations, A f, at rest and without
    inputs, q is found from d and then f from the accelerations.
    """
    names = twin.model.coordinates
    stretched = {n: e.displacement for n, e in twin.base.elements.items() if e.displacement is not None}
    if element not in stretched or any(d.names - {*names, *twin.model.parameters} for d in stretched.values()):
        return None
    elements = {name: twin.base.elements[name] for name in stretched}
    zero = twin.model.parameter_values() | {f"{c}'": 0.0 for c in names} | dict.fromkeys(names, 0.0)
    d_rows = np.array([[d.evaluate(zero | {c: 1.0}) for c in names] for d in stretched.values()])
    acts = np.array([[e.acts[c].evaluate(zero) if c in e.acts else 0.0 for e in elements.values()] for c in names])
    wanted = np.array([float(name == element) for name in elements])
    alone, left_inverse = np.linalg.pinv(d_rows) @ wanted, wanted @ np.linalg.pinv(acts)
    if not np.allclose(d_rows @ alone, wanted, atol=1e-9) or not np.allclose(left_inverse @ acts, wanted, atol=1e-9):
        return None
    n, p, u, slope = len(names), twin.values(), np.zeros(len(twin.actuators)), np.empty(len(twin.state_names))
    found = np.empty(len(displacements))
    for i, d in enumerate(displacements):
        twin.kernels.twin_derivative(0.0, twin.rest(alone * d), u, p, slope)
        found[i] = left_inverse @ slope[n : 2 * n]
    return found
