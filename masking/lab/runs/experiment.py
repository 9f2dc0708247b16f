"""Experiment: a declaration brought to life, run, and recorded."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.control import coordinate_match
from masking.control.closed_loop import ClosedLoop
from masking.control.coordinate_match import CoordinateMatch
from masking.control.known_instruments import Instruments, branches
from masking.control.law import APPROACH, Controller
from masking.control.observer import Differences, Kalman, Observer
from masking.control.rig import assumed_rig
from masking.control.rig.sensor_errors import SensorError
from masking.control.rig.twin import Twin
from masking.control.sampled_controller import SampledController
from masking.control.stepwise_controller import LawStep, SampledStep
from masking.control.transform import Transform
from masking.control.twin_loop import SampledLoop
from masking.control.zero_dynamics import Held
from masking.errors import DeclarationError, ModelError, Problem
from masking.lab.records.recording import Recording
from masking.lab.runs import experiment_card, manifest, record_rate, simulated_run
from masking.lab.runs.experiment_inputs import InputFiles, VirtualInputs, live_inputs
from masking.lab.runs.ideal_motion import Ideal, Reached
from masking.lab.runs.passive_coordinates import Passive
from masking.lab.runs.recording_columns import Columns, Summary
from masking.lab.runs.simulated_run import Mapped, Run, TwinRun
from masking.lab.runs.stopping import StopCondition
from masking.model.declaration import experiment_checks, registry, schema
from masking.model.declaration.catalogue import Reference
from masking.model.modelling.model import Model


@dataclass(frozen=True)
class Experiment:
    """Which plant moves as which virtual system, from where, for how long, under which controller."""

    assembly: registry.Assembly
    files: InputFiles = field(default_factory=InputFiles, compare=False)

    def __reduce__(self) -> tuple[type[Experiment], tuple[registry.Assembly, InputFiles]]:
        """Pickled form: what was declared and read, without compiled code."""
        return Experiment, (self.assembly, self.files.read(self.declaration))

    def __repr__(self) -> str:
        return f"<Experiment {self.declaration.name}: {experiment_card.in_words(self.assembly)}>"

    def _repr_html_(self) -> str:
        return experiment_card.html(self.assembly, self.observer_settings.kind)

    @classmethod
    def load(
        cls,
        name_or_path: str | Path,
        *,
        plant: str | None = None,
        changes: Mapping[str, float] | None = None,
        counts: Mapping[str, int] | None = None,
    ) -> Experiment:
        """Load an experiment and all it refers to.

        Args:
            name_or_path: an experiment file, or the name of a packaged one.
            plant: replaces the experiment's plant.
            changes: parameters of the virtual system that replace the declared ones, in the declared units.
            counts: that replace those which its files declare under `repeat`, such as `{"N": 100}`.

        Raises:
            DeclarationError: a declaration is wrong; lists every problem with its place.
        """
        declaration = registry.load_experiment(name_or_path, Reference(counts=counts or {}))
        for name, value in (changes or {}).items():
            if not isinstance(value, int | float):
                raise DeclarationError(Problem(None, name, f"must be a number, not {value!r}"))
        whole = {"parameters": {**declaration.parameters, **(changes or {})}}
        return cls(registry.assemble(declaration.model_copy(update=whole), plant))

    def changed(self, **sections: object) -> Experiment:
        """Experiment with sections of its file replaced, each as YAML would give it.

            experiment.changed(controller={"rate": "1 kHz", "observer": "differences"}, duration=100)

        Raises:
            DeclarationError: as for a file.
        """
        return replace(self, assembly=registry.changed_assembly(self.assembly, sections))

    @property
    def declaration(self) -> schema.ExperimentDeclaration:
        """Content of the experiment file."""
        return self.assembly.experiment

    @cached_property
    def twin(self) -> Twin:
        """Plant: its model with the effects it has, its actuators and sensors."""
        return Twin(self.assembly.plant, self.assembly.plant_model, self.declaration.effects)

    @property
    def plant(self) -> Model:
        """Model of the plant with the effects of its elements, in SI units."""
        return self.twin.model

    @cached_property
    def virtual(self) -> Model:
        """Virtual system, in its scales where it declares any."""
        model = Model(self.assembly.virtual_model, self.declaration.parameters)
        return model.dimensionless() if model.declaration.scales else model

    @cached_property
    def law(self) -> Controller:
        """Control law."""
        settings = self.declaration.controller
        overrides = {} if settings.model else self.assembly.plant.parameters
        base = assumed_rig.model(self.assembly.controller_model, self.assumed, self.declaration)
        assumed = Model(base, {**overrides, **settings.parameters})
        transform = Transform(assumed, self.virtual, self.declaration.transform)
        own = self.declaration.transform.parameters
        balance = None if settings.energy_balance is None else (settings.energy_balance, self._frequency)
        law = Controller(assumed, self.virtual, transform, self.time_scale, own, settings.regulate, balance)
        fast = settings.actuator_bandwidth or (0.0 if law.is_direct else APPROACH * self._frequency / self.time_scale)
        return replace(law, actuator_bandwidth=fast, branches=branches(self.twin, assumed)).checked()

    @property
    def acting_law(self) -> Controller:
        """Control law with the actuator bandwidth of a run."""
        return self.law if self.law.is_direct or not self.has_observer else self.sampled.controller

    @property
    def _frequency(self) -> float:
        """Frequency of the virtual motion, in radians per unit of its time: 1 where its scales say so."""
        if self.virtual.is_dimensionless or self.virtual.units.is_plain:
            return 1.0
        own, given = {*self.virtual.coordinates, *self.virtual.states}, self.declaration.initial.items()
        start = self.virtual.initial_state({name: x for name, x in given if name.rstrip("'") in own})
        return record_rate.fastest(self.virtual, start) or 1.0

    @cached_property
    def inputs(self) -> VirtualInputs:
        """Inputs of the virtual system that are no expressions."""
        return VirtualInputs(self.declaration, self.virtual, self.law, self.files)

    @property
    def time_scale(self) -> float:
        """Seconds of the rig per unit of virtual time."""
        if self.declaration.time_scale is not None:
            return self.declaration.time_scale
        if self.plant.units.is_plain or not self.virtual.declaration.scales:
            return 1.0
        return self.virtual.units.size("s", self.virtual.overrides)

    @cached_property
    def loop(self) -> ClosedLoop:
        """Controller and plant, compiled together, for a controller that knows the true state."""
        return ClosedLoop(self.law, self.plant, self.assembly.plant.sensors)

    @cached_property
    def match(self) -> CoordinateMatch:
        """Coordinates of the controller's model among the plant's; a ModelError where one is not there."""
        return CoordinateMatch(self.law, self.plant, self.assembly.plant.sensors)

    @property
    def has_observer(self) -> bool:
        """Whether the controller runs at a rate and reads sensors."""
        return self.declaration.controller.rate is not None and self.observer_settings.kind != "exact"

    @property
    def observer_settings(self) -> schema.ObserverSettings:
        """How the rig's state is known; a sampled controller estimates disturbances where nothing is said."""
        return self.declaration.controller.observer or schema.ObserverSettings()

    @cached_property
    def observer(self) -> Observer:
        """Observer of a sampled controller."""
        known = self.observer_settings
        order = 0 if known.kind == "kalman" else known.order
        return Differences() if known.kind == "differences" else Kalman(order, known.bandwidth, known.at)

    @cached_property
    def instruments(self) -> Instruments:
        """Sensors, actuators and limits as the controller knows them."""
        assumed, factors = self.assumed, self.twin.kernels.meta["factors"]
        plant, model, driven = self.assembly.plant, self.law.model.affine, self.law.driven
        if not self.match.is_same:
            plant = coordinate_match.in_coordinates_of(model.declaration, plant, self.plant.coordinates)
        errors = SensorError.of(assumed, assumed_rig.held(assumed, self.declaration, "sensor"))
        return Instruments(plant, model, factors, assumed.noise(), assumed.delay, driven, self.law.per_unit, errors)

    @cached_property
    def assumed(self) -> Twin:
        """Plant with the effects that the controller takes it to have; a DeclarationError where it can know one not."""
        return assumed_rig.assumed(self.twin, self.declaration)

    @cached_property
    def sampled(self) -> SampledController:
        """Sampled controller, with the initial state to which it brings the rig; a ModelError where that moves."""
        settings, law, n = self.declaration.controller, self.law, len(self.law.model.coordinates)
        still = np.concatenate([np.zeros(2 * n), law.model.first_internal])
        held = still if law.is_direct else self._beside(law.model, law.transform, law.lengths).begun
        made = SampledController(
            self.law,
            self.instruments,
            self.observer,
            settings.rate or 0.0,
            self.observer_settings.noise,
            settings.homing or 0.0,
            held[:n],
            settings.rest or 0.0,
            self.inputs.feed(self.instruments),
            tuple(self.virtual_start[2 * len(self.virtual.coordinates) :].tolist()),
            tuple(held[2 * n :].tolist()),
        )
        state = self.rig_start(made)
        if self.assumed_passive:
            self.assumed_passive.check_still()
        if np.any(np.abs(state[n:]) > 1e-12 * np.abs(state[:n]).max()):
            raise ModelError(
                "a controller that reads sensors begins with a rig at rest, but the initial state moves: give no "
                "initial velocities, or take controller.observer exact, which places a simulated rig in that state"
            )
        placed = replace(made, end=state[:n]) if law.is_direct else made
        return placed if settings.actuator_bandwidth else placed.as_fast_as_observed()

    @cached_property
    def sampled_loop(self) -> SampledLoop:
        """Sampled controller and twin, compiled together."""
        return SampledLoop(self.sampled, self.twin)

    def controller(self) -> SampledStep | LawStep:
        """Controller for a loop of one's own; each call of this gives one of its own.

        An experiment whose controller reads sensors gives a `SampledStep`, called with readings; one whose controller
        knows the true state gives a `LawStep`, called with time and state. Everything is compiled here.

        Raises:
            MaskingError: as for `validate`.
        """
        self.validate()
        if self.has_observer:
            return SampledStep(self.sampled)
        schedule = self.inputs.of_rig(self.time_scale)
        return LawStep(self.loop, self.instruments.allocation_inverse, self.instruments.actuators, schedule)

    @cached_property
    def stop_condition(self) -> StopCondition | None:
        """Condition that ends a run before its duration; None for none."""
        declaration, rate = self.declaration, self.declaration.controller.rate
        if declaration.stop is None:
            return None
        step = self.every / (rate * self.time_scale) if rate else 1.0 / self.rows_per_unit
        start, duration = self.virtual_start, declaration.duration
        return StopCondition.of(declaration.stop, self.virtual, start, step=step, duration=duration)

    @cached_property
    def rows_per_unit(self) -> float:
        """Rows per unit of virtual time of a record."""
        declared = self.declaration.record.rate if self.declaration.record else self.declaration.controller.rate
        own = None if declared is None else declared * self.time_scale
        return record_rate.rows_per_unit(self.virtual, self.virtual_start) if own is None else own

    @property
    def samples(self) -> int:
        """Instants of a record that has no rate of its own."""
        return max(2, round(self.rows_per_unit * self.declaration.duration) + 1)

    @property
    def virtual_start(self) -> Array:
        """Initial state of the virtual system, in its units."""
        given, names = self.declaration.initial, {*self.plant.coordinates, *self.law.model.coordinates}
        names -= {*self.virtual.coordinates, *self.virtual.states}
        return self.virtual.initial_state({n: x for n, x in given.items() if n.rstrip("'") not in names})

    @cached_property
    def passive(self) -> Passive | None:
        """Rig coordinates that no virtual one stands for; None where there are none."""
        return self._beside(self.plant, self.match.mapping, self.match.lengths).if_any()

    @cached_property
    def assumed_passive(self) -> Passive | None:
        """Those of them that the controller's model has, as it has them."""
        law = self.law
        return self.passive if self.match.is_same else self._beside(law.model, law.transform, law.lengths).if_any()

    def _beside(self, rig: Model, transform: Transform, lengths: Array) -> Passive:
        eta, own = self.virtual_start[: len(self.virtual.coordinates)], self.law.transform_parameters
        return Passive(Held.direct(rig, transform, own, lengths, eta), self.declaration.initial).under(self.law)

    def rig_start(self, loop: Mapped) -> Array:
        """Coordinates and velocities (2 n,) at the start of the rig that a loop's transform maps."""
        passive = self.passive if loop.match.mapping == self.match.mapping else self.assumed_passive
        return simulated_run.rig_state(loop, self.virtual_start, passive=passive.initial() if passive else None)

    @cached_property
    def twin_start(self) -> Array:
        """Coordinates of the twin (n,) where the controller that reads its sensors brings it; its own at rest."""
        end, n = self.sampled.end, len(self.plant.coordinates)
        if self.match.is_same:
            return end
        own = Passive(Held.direct(self.plant, self.match.view, {}, np.ones(n), end), self.declaration.initial)
        return own.held.state(own.states)[:n]

    @property
    def stem(self) -> str:
        """Name of the experiment's file, without its ending."""
        return Path(next(iter(self.declaration.files), self.declaration.name)).stem

    @property
    def is_compiled(self) -> bool:
        """Whether the closed loop has been compiled before and is kept on disk."""
        return (self.sampled_loop if self.has_observer else self.loop).is_compiled

    def validate(self) -> None:
        """Refuse what can be refused without running.

        Raises:
            MaskingError: a model is wrong or of another rig, or the rig cannot be driven, or begin, as it is wanted.
        """
        for model in (self.plant, self.law.model, self.virtual):
            model.validate()
        self.twin.validate()
        _ = self.assumed
        largest = experiment_checks.LARGEST_RECORDING if self.ideal.needs_memory else experiment_checks.LARGEST_ON_DISK
        if problems := [*registry.check_units(self.assembly), *self._check_size(largest)]:
            raise DeclarationError(problems)
        self.match.check_units()
        _ = self.instruments, self.loop if not self.has_observer else None
        _ = self.passive.initial() if self.passive else self.virtual_start
        if self.has_observer:
            _ = self.sampled.gain
        _ = self.stop_condition, self.inputs.series

    def _check_size(self, largest: float) -> list[Problem]:
        return experiment_checks.check_size(self.declaration, *self.table_size, largest)

    @property
    def table_size(self) -> tuple[float, int]:
        """Rows and the columns of the recording."""
        rows = experiment_checks.recorded_rows(self.declaration, self.time_scale, self.rows_per_unit)
        columns = experiment_checks.count_columns(self.assembly.plant_model, self.assembly.virtual_model)
        if self.has_observer:
            columns += len(self.twin.state_names) + 3 * len(self.twin.actuators) + len(self.twin.sensors)
        return rows, columns

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
        stages = [time.perf_counter()]
        self.prepare(experiment_checks.LARGEST_RECORDING)
        stages.append(time.perf_counter())
        simulate = self.simulation()
        stages.append(time.perf_counter())
        run, condition = simulated_run.joined(simulate(progress=progress)), self.stop_condition
        row = condition.watch()(self.seen(run)) if condition else None
        run = run if row is None else simulated_run.cut(run, row + 1)
        stages.append(time.perf_counter())
        columns, _ = self.columns(run)
        stages.append(time.perf_counter())
        timing = zip(("compilation", "preparation", "run", "ideal"), np.diff(stages).tolist(), strict=True)
        return self.recording(columns, dict(timing), is_stopped=row is not None)

    def prepare(self, largest: float) -> None:
        """Compile or load what a run calls; refuse a recording beyond some bytes, or units that do not fit."""
        if problems := [*self._check_size(largest), *([] if self.is_compiled else registry.check_units(self.assembly))]:
            raise DeclarationError(problems)
        virtual = self.virtual.kernels
        wanted = [(virtual, [f"solve_{virtual.meta['method']}"])]
        if self.has_observer:
            wanted.append((self.sampled_loop.kernels, ["run"]))
            wanted.append((self.sampled.kernels, ["transform", "transforms", "still"]))
            wanted.append((self.twin.kernels, ["sense", "twin_derivative"]))
        else:
            solve = "solve_runge_kutta" if self.declaration.controller.rate is None else "run_sampled"
            wanted.append((self.loop.kernels, ["transform", "along", solve]))
        for kernels, names in wanted:
            for name in names:
                getattr(kernels, name).prepare()

    def simulation(self, most: int | None = None) -> Callable[..., Iterator[Run | TwinRun]]:
        """Run, ready to be started: called with `progress`, it gives chunks of at most `most` rows."""
        declaration, rate = self.declaration, self.declaration.controller.rate
        duration, every = declaration.duration * self.time_scale, self.every
        if self.has_observer:
            _, loop, start = self.sampled.gain, self.sampled_loop, self.twin_start
            chunks = partial(simulated_run.twin_chunks, loop, start, duration=duration, seed=declaration.seed)
            return partial(chunks, every=every, most=most)
        state = simulated_run.loop_state(self.loop, self.virtual_start, self.rig_start(self.loop))
        schedule = self.inputs.of_rig(self.time_scale)
        if rate is not None:
            sampled = partial(simulated_run.sampled_chunks, self.loop, state, rate=rate, duration=duration, every=every)
            return partial(sampled, schedule=schedule, most=most)
        declared = declaration.record.rate if declaration.record else None
        rows, instants = record_rate.instants(duration, self.samples, declared)
        continuous = partial(simulated_run.continuous_chunks, self.loop, state, rows, instants)
        return partial(continuous, tolerance=declaration.tolerance, schedule=schedule)

    def seen(self, run: Run | TwinRun) -> Array:
        """Virtual motion that may end a run: what the controller takes for it, as on a rig."""
        return self._virtual(run.times, run.estimates) if isinstance(run, TwinRun) else run.virtual

    def _virtual(self, times: Array, states: Array) -> Array:
        """Virtual coordinates and velocities (m, 2 k) of states of the controller's model (m, .)."""
        virtual = np.empty((len(times), 2 * len(self.virtual.coordinates)))
        self.sampled.kernels.transforms(times, np.ascontiguousarray(states), self.sampled.values(), virtual)
        return virtual

    def columns(self, run: Run | TwinRun, reached: Reached | None = None) -> tuple[Columns, Reached]:
        """Columns of a run, or of a chunk of it, and what the virtual system by itself has reached then.

        Where a rig's true states are not known, the `states` of the run are estimates; `reached` is what the virtual
        system has reached before, None for a run from its beginning.
        """
        live = live_inputs(self.sampled, run, self.inputs) if isinstance(run, TwinRun) else {}
        states, reached = self.ideal.along(run.times, live, reached or (0.0, self.virtual_start))
        is_estimated = isinstance(run, TwinRun) and run.states is run.estimates
        columns = Columns(self.assembly, self.law.model if is_estimated else self.plant, self.virtual)
        inputs = self.inputs.columns(run.times / self.time_scale, live)
        if isinstance(run, Run):
            columns.add_motion(run.times, run.rig, run.virtual, states).add_inputs(inputs)
            return columns.add_channels("input", run.inputs @ self.instruments.allocation_inverse.T), reached
        seen = run.states if is_estimated else self.match.seen(self.sampled_loop.kernels, run.states)
        virtual = self._virtual(run.times, seen), run.estimates[:, self.sampled.sizes.memory]
        columns.add_motion(run.times, run.states, np.hstack(virtual), states).add_inputs(inputs)
        columns.add_channels("sensor", run.readings)
        columns.add_channels("input", run.applied).add_channels("demanded", run.demanded)
        if self.assembly.plant.limits.power is not None:
            columns.add_channels("power", run.power)
        return columns, reached

    @property
    def every(self) -> int:
        """Samples per recorded row."""
        rate, record = self.declaration.controller.rate, self.declaration.record
        return max(1, round(rate / record.rate)) if rate is not None and record else 1

    @cached_property
    def ideal(self) -> Ideal:
        """Motion that the rig should have."""
        return Ideal(self.virtual, self.inputs, self.time_scale, min(self.declaration.tolerance, 1e-12))

    def recording(self, made: Columns, timing: Mapping[str, float], *, is_stopped: bool) -> Recording:
        """Recording of a run; the arguments are those of `manifest`."""
        summary = self.summary()
        summary.add(made.columns)
        return Recording(made.columns, self.manifest(made, summary, timing, is_stopped=is_stopped))

    def summary(self) -> Summary:
        """Collector of the numbers of a run for its manifest."""
        return Summary(self.virtual.coordinates, (self.passive, self.assumed_passive))

    def manifest(
        self, made: Columns, summary: Summary, timing: Mapping[str, float], *, is_stopped: bool
    ) -> dict[str, Any]:
        """Manifest of a run: of its columns, or a chunk of them, and the summary of all its rows.

        `timing` has the seconds that each stage took; `is_stopped` says whether its stop condition ended it.
        """
        at = summary.last / self.time_scale if is_stopped else None
        acts = {e.label: e.enabled and (self.has_observer or e.entry.where == "element") for e in self.twin.effects}
        entries = {
            "columns": dict(made.units),
            "time_scale": self.time_scale,
            "limits": manifest.limits(self.assembly.plant, self.instruments),
            "effects": acts,
            "observer": manifest.observer(self.sampled, self.observer_settings.kind) if self.has_observer else None,
            "masking_error": summary.masking_error,
            "timing": dict(timing),
        }
        if summary.passive:
            entries["passive"] = summary.passive
        if self.declaration.inputs:
            entries["inputs"] = self.inputs.entry()
        if self.declaration.controller.homing is not None:
            entries["start"] = manifest.start(self.virtual, self.virtual_start, summary.first)
        entries |= {"stop": self.stop_condition.entry(at)} if self.stop_condition else {}
        return manifest.content(self.assembly, self.virtual, entries)
