"""Experiment: a declaration brought to life, run, and recorded."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from masking.analysis.masking_error import masking_error
from masking.control.blocks import Transform, check_actuation
from masking.control.closed_loop import ClosedLoop
from masking.control.instruments import Instruments
from masking.control.law import Controller
from masking.control.observer import Differences, Kalman, Observer
from masking.control.sampled import SampledController, SampledLoop
from masking.control.step import LawStep, SampledStep
from masking.declaration import cross_checks, registry, schema
from masking.declaration.catalogue import Reference
from masking.display import fragments
from masking.errors import DeclarationError, ModelError, Problem
from masking.modelling import series
from masking.modelling.model import Model
from masking.numerics.arrays import Array
from masking.records.recording import Recording
from masking.rig.twin import PlacedEffect, Twin
from masking.runs import manifest, record_rate
from masking.runs.columns import Columns
from masking.runs.offline import Mapped, Run, TwinRun, cut, loop_state, rig_state, run_continuous, run_sampled, run_twin
from masking.runs.passive import Passive
from masking.runs.stopping import SYNCHRONISED, StopCondition
from masking.runs.virtual_inputs import VirtualInputs, live_inputs


@dataclass(frozen=True)
class Experiment:
    """Which plant moves as which virtual system, from where, for how long, under which controller."""

    assembly: registry.Assembly

    def __repr__(self) -> str:
        return f"<Experiment {self.declaration.name}: {self._in_words}>"

    def _repr_html_(self) -> str:
        d = self.declaration
        observer = f", {self.observer_settings.kind} observer" if d.controller.rate is not None else ""
        rows = [
            ("plant", self.assembly.plant.name),
            ("virtual system", self.assembly.virtual_model.name),
            ("controller", f"{self._rate_in_words}{observer}"),
            ("initial", ", ".join(f"{name} = {value:g}" for name, value in d.initial.items())),
            ("parameters", ", ".join(f"{name} = {value:g}" for name, value in d.parameters.items())),
            ("duration", f"{d.duration:g} units of virtual time"),
        ]
        return fragments.card(d.name, d.description or "", fragments.table(("", ""), [row for row in rows if row[1]]))

    @property
    def _rate_in_words(self) -> str:
        rate = self.declaration.controller.rate
        return "in continuous time" if rate is None else f"at {rate:g} Hz"

    @property
    def _in_words(self) -> str:
        plant, virtual = self.assembly.plant.name, self.assembly.virtual_model.name
        return f"{plant} as {virtual}, {self._rate_in_words}, {self.declaration.duration:g} units of virtual time"

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
        if changes:
            wrong = [name for name, value in changes.items() if not isinstance(value, int | float)]
            if wrong:
                raise DeclarationError(Problem(None, wrong[0], f"must be a number, not {changes[wrong[0]]!r}"))
            declaration = declaration.model_copy(update={"parameters": {**declaration.parameters, **changes}})
        return cls(registry.assemble(declaration, plant))

    def changed(self, **sections: object) -> Experiment:
        """Return the experiment with sections of its file replaced, each as YAML would give it.

            experiment.changed(controller={"rate": "1 kHz", "observer": "differences"}, duration=100)

        Raises:
            DeclarationError: as for a file.
        """
        declaration = registry.changed_experiment(self.declaration, sections)
        is_given = declaration.plants or {"plant", "plants"} & sections.keys()
        here = None if is_given else next(iter(self.assembly.plant.files), None)
        return Experiment(registry.assemble(declaration, here))

    @property
    def declaration(self) -> schema.ExperimentDeclaration:
        """Return the content of the experiment file."""
        return self.assembly.experiment

    @cached_property
    def twin(self) -> Twin:
        """Return the plant: its model with the effects it has, its actuators and sensors."""
        return Twin(self.assembly.plant, self.assembly.plant_model, self.declaration.effects)

    @property
    def plant(self) -> Model:
        """Return the model of the plant with the effects of its elements, in SI units."""
        return self.twin.model

    @cached_property
    def virtual(self) -> Model:
        """Return the virtual system, in its scales where it declares any."""
        model = Model(self.assembly.virtual_model, self.declaration.parameters)
        return model.dimensionless() if model.declaration.scales else model

    @cached_property
    def law(self) -> Controller:
        """Return the control law."""
        settings = self.declaration.controller
        overrides = {} if settings.model else self.assembly.plant.parameters
        assumed = Model(self.assembly.believed_model, {**overrides, **settings.parameters})
        transform = Transform(assumed, self.virtual, self.declaration.transform)
        own = self.declaration.transform.parameters
        balance = None if settings.energy_balance is None else (settings.energy_balance, self._frequency)
        return Controller(assumed, self.virtual, transform, self.time_scale, own, settings.regulate, balance)

    @property
    def _frequency(self) -> float:
        """Return the frequency of the virtual motion, in radians per unit of its time: 1 where its scales say so."""
        if self.virtual.is_dimensionless or self.virtual.units.is_plain:
            return 1.0
        return record_rate.fastest(self.virtual, self.virtual.initial_state({})) or 1.0

    @cached_property
    def inputs(self) -> VirtualInputs:
        """Return the inputs of the virtual system that are no expressions."""
        return VirtualInputs(self.declaration, self.virtual, self.law)

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
        """Return controller and plant, compiled together, for a controller that knows the true state."""
        return ClosedLoop(self.law, self.plant)

    @property
    def has_observer(self) -> bool:
        """Tell whether the controller runs at a rate and reads sensors."""
        settings = self.declaration.controller
        return settings.rate is not None and self.observer_settings.kind != "exact"

    @property
    def observer_settings(self) -> schema.ObserverSettings:
        """Return how the rig's state is known; a sampled controller estimates disturbances where nothing is said."""
        return self.declaration.controller.observer or schema.ObserverSettings()

    @cached_property
    def observer(self) -> Observer:
        """Return the observer of a sampled controller."""
        settings = self.observer_settings
        if settings.kind == "differences":
            return Differences()
        return Kalman(0 if settings.kind == "kalman" else settings.order, settings.bandwidth)

    @cached_property
    def instruments(self) -> Instruments:
        """Return what the controller knows of sensors, actuators and limits."""
        assumed, factors = self.twin.changed(self.assumed_effects), self.twin.kernels.meta["factors"]
        plant, model, driven = self.assembly.plant, self.law.model, self.law.driven
        return Instruments(plant, model, factors, assumed.noise(), assumed.delay, driven)

    @cached_property
    def assumed_effects(self) -> dict[str, schema.EffectChange]:
        """Return the changes of the plant's effects as the controller takes them.

        Raises:
            DeclarationError: `controller.effects` names an effect that no controller is designed with.
        """
        assumed, uses = self.declaration.controller.effects, self.assembly.plant.effects
        allowed = [name for name, use in uses.items() if self.twin.dictionary[use.effect].is_known_to_controller]
        mend = f"allowed: {', '.join(allowed) or 'none'}; forces and gains belong into controller.model and .parameters"
        problems = []
        for name in assumed.keys() - set(allowed):
            path, message = f"controller.effects.{name}", f"a controller is not designed with {uses[name].effect}"
            problems.append(Problem(self.declaration.key_place(path), path, message, mend))
        if problems:
            raise DeclarationError(problems)
        return {**self.declaration.effects, **assumed}

    @cached_property
    def sampled(self) -> SampledController:
        """Return the sampled controller, with the initial state to which it brings the rig.

        Raises:
            ModelError: the initial state moves.
        """
        settings = self.declaration.controller
        made = SampledController(
            self.law,
            self.instruments,
            self.observer,
            settings.rate or 0.0,
            self.observer_settings.noise,
            settings.homing or 0.0,
            np.zeros(len(self.law.model.coordinates)),
            settings.rest or 0.0,
            self.inputs.feed(self.instruments),
            tuple(self.virtual_start[2 * len(self.virtual.coordinates) :].tolist()),
        )
        state = self.rig_start(made)
        n = len(made.end)
        if self.passive:
            self.passive.check_still()
        if np.any(np.abs(state[n:]) > 1e-12 * np.abs(state[:n]).max()):
            raise ModelError(
                "a controller that reads sensors begins with a rig at rest, but the initial state moves: give no "
                "initial velocities, or take controller.observer exact, which places a simulated rig in that state"
            )
        return replace(made, end=state[:n])

    @cached_property
    def sampled_loop(self) -> SampledLoop:
        """Return sampled controller and twin, compiled together."""
        return SampledLoop(self.sampled, self.twin)

    def controller(self) -> SampledStep | LawStep:
        """Return the controller for a loop of one's own; each call of this gives one of its own.

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
        """Return what ends a run before its duration; None where nothing does."""
        declaration, rate = self.declaration, self.declaration.controller.rate
        if declaration.stop is None:
            return None
        initial = self.virtual_start
        step = 1.0 / self.rows_per_unit if rate is None else self.every / (rate * self.time_scale)
        return StopCondition.of(declaration.stop, self.virtual, initial, step=step, duration=declaration.duration)

    @cached_property
    def rows_per_unit(self) -> float:
        """Return the rows per unit of virtual time of a record."""
        declared = self.declaration.record.rate if self.declaration.record else self.declaration.controller.rate
        if declared is not None:
            return declared * self.time_scale
        return record_rate.rows_per_unit(self.virtual, self.virtual_start)

    @property
    def samples(self) -> int:
        """Return the instants of a record that has no rate of its own."""
        return max(2, round(self.rows_per_unit * self.declaration.duration) + 1)

    @property
    def virtual_start(self) -> Array:
        """Return the initial state of the virtual system, in its units."""
        given, free = self.declaration.initial, self.law.transform.passive
        names = {self.plant.coordinates[i] for i in free} - set(self.virtual.coordinates)
        return self.virtual.initial_state({n: x for n, x in given.items() if n.rstrip("'") not in names})

    @cached_property
    def passive(self) -> Passive | None:
        """Return the rig coordinates that no virtual one stands for; None where there are none."""
        eta = self.virtual_start[: len(self.virtual.coordinates)]
        return Passive(self.law, self.plant, eta, self.declaration.initial) if self.law.transform.passive else None

    def rig_start(self, loop: Mapped) -> Array:
        """Return coordinates and velocities of the rig (2 n,) at the start, by a loop's transform."""
        return rig_state(loop, self.virtual_start, passive=self.passive.initial() if self.passive else None)

    @property
    def stem(self) -> str:
        """Return the name of the experiment's file, without its ending."""
        return Path(next(iter(self.declaration.files), self.declaration.name)).stem

    @property
    def is_compiled(self) -> bool:
        """Tell whether the closed loop has been compiled before and is kept on disk."""
        return (self.sampled_loop if self.has_observer else self.loop).is_compiled

    def validate(self) -> None:
        """Refuse what can be refused without running.

        Raises:
            MaskingError: a model is wrong, the rig's inputs cannot accelerate every virtual coordinate, or no rig
                position gives the initial state.
        """
        for model in (self.plant, self.law.model, self.virtual):
            model.validate()
        self.twin.validate()
        _ = self.assumed_effects
        problems = [*registry.check_units(self.assembly), *self._check_size()]
        if problems:
            raise DeclarationError(problems)
        check_actuation(self.law.model, self.law.transform)
        _ = self.passive.initial() if self.passive else self.virtual_start
        if self.has_observer:
            _ = self.sampled.gain
        _ = self.stop_condition, self.inputs.series

    def _check_size(self) -> list[Problem]:
        rows = cross_checks.recorded_rows(self.declaration, self.time_scale, self.rows_per_unit)
        columns = cross_checks.count_columns(self.assembly.plant_model, self.assembly.virtual_model)
        if self.has_observer:
            columns += len(self.twin.state_names) + 3 * len(self.twin.actuators) + len(self.twin.sensors)
        return cross_checks.check_size(self.declaration, rows, columns)

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
        problems = [*self._check_size(), *([] if self.is_compiled else registry.check_units(self.assembly))]
        if problems:
            raise DeclarationError(problems)
        self._prepare_kernels()
        stages.append(time.perf_counter())
        simulate = self._sampled_run() if self.has_observer else self._exact_run()
        stages.append(time.perf_counter())
        run, condition = simulate(progress=progress), self.stop_condition
        row = condition.row(self._seen(run)) if condition else None
        run = run if row is None else cut(run, row + 1)
        stages.append(time.perf_counter())
        columns = self.sampled_columns(run) if isinstance(run, TwinRun) else self._exact_columns(run)
        stages.append(time.perf_counter())
        timing = zip(("compilation", "preparation", "run", "ideal"), np.diff(stages).tolist(), strict=True)
        return self._record(columns, dict(timing), is_stopped=row is not None)

    def _prepare_kernels(self) -> None:
        """Compile or load what a run calls."""
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

    def _exact_run(self) -> Callable[..., Run]:
        """Return the run of a controller that knows the true state, ready to be started."""
        declaration, rate = self.declaration, self.declaration.controller.rate
        state = loop_state(self.loop, self.virtual_start, self.rig_start(self.loop))
        duration, schedule = declaration.duration * self.time_scale, self.inputs.of_rig(self.time_scale)
        if rate is not None:
            return partial(
                run_sampled, self.loop, state, rate=rate, duration=duration, every=self.every, schedule=schedule
            )
        times = np.linspace(0.0, duration, self.samples)
        if declaration.record:
            times = np.arange(int(duration * declaration.record.rate * (1.0 + 1e-12)) + 1) / declaration.record.rate
        return partial(run_continuous, self.loop, state, times, tolerance=declaration.tolerance, schedule=schedule)

    def _sampled_run(self) -> Callable[..., TwinRun]:
        """Return the run of a controller with an observer, ready to be started."""
        declaration, sampled = self.declaration, self.sampled
        _ = sampled.gain
        duration = declaration.duration * self.time_scale
        return partial(
            run_twin, self.sampled_loop, sampled.end, duration=duration, seed=declaration.seed, every=self.every
        )

    def _seen(self, run: Run | TwinRun) -> Array:
        """Return the virtual motion that may end a run: what the controller takes for it, as on a rig."""
        return self._virtual(run.times, run.estimates) if isinstance(run, TwinRun) else run.virtual

    def _virtual(self, times: Array, states: Array) -> Array:
        """Return the virtual coordinates and velocities (m, 2 k) of the rig's states (m, .)."""
        virtual = np.empty((len(times), 2 * len(self.virtual.coordinates)))
        self.sampled.kernels.transforms(times, np.ascontiguousarray(states), self.sampled.values(), virtual)
        return virtual

    def sampled_columns(self, run: TwinRun) -> Columns:
        """Return the columns of a sampled run; where a rig's true states are not known, `states` are estimates."""
        times, states, live = run.times, run.states, live_inputs(self.sampled, run, self.inputs)
        virtual = np.hstack([self._virtual(times, states), run.estimates[:, self.sampled.sizes.memory]])
        columns = self._columns().add_motion(times, states, virtual, self._ideal(times, live))
        columns.add_inputs(self.inputs.columns(times / self.time_scale, live))
        columns.add_sensors(run.readings)
        columns.add_actuators("input", run.applied).add_actuators("demanded", run.demanded)
        if self.assembly.plant.limits.power is not None:
            columns.add_power(run.power)
        return columns

    def _exact_columns(self, run: Run) -> Columns:
        commands = run.inputs @ self.instruments.allocation_inverse.T
        columns = self._columns().add_motion(run.times, run.rig, run.virtual, self._ideal(run.times))
        columns.add_inputs(self.inputs.columns(run.times / self.time_scale, {}))
        return columns.add_actuators("input", commands)

    def _columns(self) -> Columns:
        return Columns(self.assembly, self.plant, self.virtual)

    @property
    def every(self) -> int:
        """Return of how many samples one is recorded."""
        rate, record = self.declaration.controller.rate, self.declaration.record
        return max(1, round(rate / record.rate)) if rate is not None and record else 1

    def _ideal(self, times: Array, live: Mapping[str, Array] | None = None) -> Array:
        """Return the virtual system integrated by itself from time 0, at times of the rig (m,), as states (m, 2 k)."""
        found = series.integrate(
            self.virtual.kernels,
            np.concatenate([[0.0], times]) / self.time_scale,
            self.virtual_start,
            np.zeros(len(self.virtual.inputs)),
            self.virtual.values(),
            schedule=self.inputs.along(times / self.time_scale, live or {}),
            tolerance=min(self.declaration.tolerance, 1e-12),
        )
        return found.states[1:]

    def record_rig(self, run: TwinRun, *, lockstep: bool, outcome: Mapping[str, object]) -> Recording:
        """Return the recording of a run on a plant that runs by itself.

        Args:
            run: what happened since the release; `states` are estimates.
            lockstep: whether controller and plant waited for each other.
            outcome: how the run ended and what was counted, for the manifest.
        """
        made = self._record(self.sampled_columns(run), {}, is_stopped=outcome["end"] == SYNCHRONISED)
        made.manifest.update(mode="lockstep" if lockstep else "real time", states="estimated", rig=dict(outcome))
        return made

    def _record(self, made: Columns, timing: Mapping[str, float], *, is_stopped: bool) -> Recording:
        columns = made.columns
        at = float(columns["t"][-1]) / self.time_scale if is_stopped else None
        stop = {"stop": self.stop_condition.entry(at)} if self.stop_condition else {}
        chi = {c: masking_error(columns[f"virtual.{c}"], columns[f"ideal.{c}"]) for c in self.virtual.coordinates}
        entries = {
            "columns": dict(made.units),
            "time_scale": self.time_scale,
            "limits": manifest.limits(self.assembly.plant, self.instruments),
            "effects": {effect.label: effect.enabled and self._acts(effect) for effect in self.twin.effects},
            "observer": manifest.observer(self.sampled, self.observer_settings.kind) if self.has_observer else None,
            "masking_error": chi,
            "timing": dict(timing),
        }
        if self.passive:
            names = [f"rig.{c}{d}" for d in ("", "'") for c in self.plant.coordinates]
            entries["passive"] = self.passive.entry(np.column_stack([columns[name] for name in names]))
        if self.declaration.inputs:
            entries["inputs"] = self.inputs.entry()
        if self.declaration.controller.homing is not None:
            entries["start"] = manifest.start(self.virtual.coordinates, self.virtual_start, columns)
        entries |= stop
        return Recording(columns, manifest.content(self.assembly, self.virtual, entries))

    def _acts(self, effect: PlacedEffect) -> bool:
        """Tell whether an effect acts in a run: one outside the rig does not, where the true state is known."""
        return self.has_observer or effect.entry.where == "element"
