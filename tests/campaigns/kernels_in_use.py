"""Every kernel's wrapper with arguments that it is given in use, recorded from short runs, fits and filters."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import masking
from masking.compile.codegen import column_step
from masking.compile.codegen.machine_code import DIMENSIONS, NativeFunction
from masking.compile.codegen.module_store import Generated
from masking.control.rig.twin import Twin
from masking.inference.discovery import compiled_laws, smoothing
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.motion_features import Kept, MotionFeatures, Thinning
from masking.inference.discovery.parameter_prior import prior_of
from masking.inference.estimation.extended_kalman import FilterSettings, extended_kalman
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.sensitivity import Sensitivity
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.runs import rig_run
from masking.lab.runs.experiment import Experiment

Call = tuple[NativeFunction, tuple[Any, ...]]
PLANT = """
name: linear rig
model: setup
sensors:
  s1: {measures: x1 - x3, gain: {value: 200, unit: V/m}, unit: V}
  s2: {measures: x2 - x3, gain: {value: 200, unit: V/m}, unit: V}
  s3: {measures: x3, gain: {value: 200, unit: V/m}, unit: V}
actuators: {V1: {unit: V}, V2: {unit: V}, V3: {unit: V}}
allocation: {u1: V1, u2: V2, u3: V3}
limits: {inputs: {V1: {max: 0.42, unit: V}, V2: {max: 0.42, unit: V}, V3: {max: 0.42, unit: V}}}
"""
RATE, SAMPLES = 100.0, 60


class _Recorder:
    """First calls of each function, with copies of their arrays, and the modules that were loaded meanwhile."""

    def __init__(self) -> None:
        self.calls, self.modules = dict[tuple[str, str], Call](), dict[str, Generated]()

    def note(self, function: NativeFunction, given: Iterable[Any], *, bound: bool = False, runs: bool = False) -> None:
        key = (function.stem.name, function.name)
        if key in self.calls:
            return
        kinds = [*function.arguments.values()]
        values = [part for value in given for part in (value if isinstance(value, tuple) else (value,))]
        kept = list[Any]()
        for kind, value in zip(kinds, values, strict=False):
            if kind not in DIMENSIONS:
                one = value[0] if bound else value
                kept.append(int(one) if kind == "int" else float(one))
            else:
                rows = runs and value.ndim == DIMENSIONS[kind] + 1
                kept.append(np.array(value[0] if rows else value))
        self.calls[key] = (function, tuple(kept))


def recorded(*, quick: bool = False) -> list[Call]:
    """Calls of kernels that short uses of them make; `quick` leaves out what takes more than a few seconds."""
    recorder = _Recorder()
    originals = {name: getattr(NativeFunction, name) for name in ("__call__", "each", "bind")}
    function_of = Generated.function

    def called(function: NativeFunction, *given: Any) -> Any:
        recorder.note(function, given)
        return originals["__call__"](function, *given)

    def each(function: NativeFunction, runs: int, *given: Any, threads: int = 1) -> Any:
        recorder.note(function, given, runs=True)
        return originals["each"](function, runs, *given, threads=threads)

    def bind(function: NativeFunction, *given: Any) -> Any:
        recorder.note(function, given, bound=True)
        return originals["bind"](function, *given)

    def loaded(generated: Generated, name: str) -> NativeFunction:
        recorder.modules[str(generated.path)] = generated
        return function_of(generated, name)

    patched: Mapping[str, Callable[..., Any]] = {"__call__": called, "each": each, "bind": bind}
    for name, one in patched.items():
        setattr(NativeFunction, name, one)
    Generated.function = loaded  # type: ignore[method-assign]
    try:
        with tempfile.TemporaryDirectory() as folder:
            for use in (*QUICK, *(() if quick else LONG)):
                use(Path(folder))
    finally:
        for name, one in originals.items():
            setattr(NativeFunction, name, one)
        Generated.function = function_of  # type: ignore[method-assign]
    modules = recorder.modules.values()
    unused = [_unused(one.function(name)) for one in modules for name in one.meta["functions"]]
    known = {(one.stem.name, one.name) for one, _ in recorder.calls.values()}
    calls = [*recorder.calls.values(), *(call for call in unused if (call[0].stem.name, call[0].name) not in known)]
    for one, _ in calls:
        one.prepare()  # before processes are forked off
    return calls


def _unused(function: NativeFunction) -> Call:
    """Arguments of the least sizes, or of a few elements, for a kernel that was not used."""
    given, kinds = list[Any](), function.arguments
    for name in [*kinds][: len(kinds) - (function.work is not None)]:
        if (kind := kinds[name]) in DIMENSIONS:
            least = [*function.needed.sizes.get(name, ())]
            shape = [*least, *[0] * (DIMENSIONS[kind] - len(least))]
            given.append(np.full([n or 2 for n in shape], 0.1 if not kind.startswith("Int") else 0, dtype=_dtype(kind)))
        else:
            given.append(1 if kind == "int" else 0.1)
    return function, tuple(given)


def _dtype(kind: str) -> type:
    return np.int64 if kind.startswith("Int") else np.float64


def _model(name: str, _: Path, **chosen: Any) -> None:
    masking.load_model(name).simulate([0.0, 0.3, 0.7], **chosen)


def _ensemble(_: Path) -> None:
    masking.load_model("duffing").simulate([0.0, 0.3, 0.7], ensemble={"w3": np.linspace(0.4, 0.6, 5)})


def _experiment(name: str, _: Path) -> None:
    Experiment.load(name).changed(duration=1).run()


def _on_a_plant(_: Path) -> None:
    experiment = Experiment.load("cart_van_der_pol").changed(duration=2)
    rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True))


def _record(twin: Twin) -> Data:
    random = np.random.default_rng(1)
    commands = np.ascontiguousarray(0.01 * random.standard_normal((SAMPLES, len(twin.actuators))))
    made = Data("made", RATE, commands, np.zeros((SAMPLES, len(twin.sensors))), twin.delay)
    begin = twin.rest(np.zeros(len(twin.sensors)))
    readings = Sensitivity(twin, ()).simulate(np.empty(0), begin, made.acting, rate=RATE, substeps=2)
    return replace(made, readings=np.ascontiguousarray(readings))


def _filters(_: Path) -> None:
    twin = Twin.load("linear_rig")
    record = _record(twin)
    for has_root in (False, True):
        extended_kalman(twin, record, ("w1", "z1"), FilterSettings(square_root=has_root), start=None, progress=None)


def _augmented(folder: Path) -> None:
    (folder / "plant.yaml").write_text(PLANT)
    twin = Twin.load(folder / "plant.yaml")
    rig, record = AugmentedModel(twin, twin.equation_parameters()), _record(twin)
    problem = EstimationProblem(rig, record, prior_of(twin, rig, 0.01), np.full(3, 1e-3), 2)
    places = (("hardening_spring", "spring1", (5e6,)), ("dry_friction", "beam", (0.4, 1e-9)))
    instances = tuple(EffectInstance(name, at, values, (0,)) for name, at, values in places)
    problem.equations(rig.start, np.zeros((1, 6)), instances, np.array([5e6, 0.4]))
    motion = smoothing.smooth(problem, rig.start, np.zeros((1, 6)))
    made = MotionFeatures(rig, record, motion, record.readings, Thinning(2, 2), Kept())
    made.with_slopes(EffectInstance("hardening_spring", "spring1", (5e6,), (0,)))
    compiled_laws.library(rig.laws)
    for one in column_step.link(6, 3).values():
        one(np.zeros((24, 8)), np.zeros((24, 16)), np.zeros((6, 16)), 0.1)


QUICK: tuple[Callable[[Path], None], ...] = (partial(_model, "duffing"), _ensemble, _on_a_plant)
LONG: tuple[Callable[[Path], None], ...] = (
    *(partial(_model, name) for name in ("huygens", "delayed_oscillators", "pendula")),
    *(partial(_experiment, name) for name in ("duffing", "huygens_rig", "bouncing_ball", "delayed_oscillators_rig")),
    *(
        partial(_experiment, name)
        for name in ("cart_van_der_pol", "duffing_sampled", "cart_sensors", "escapements_rig")
    ),
    _filters,
    _augmented,
)
