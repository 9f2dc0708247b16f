"""Error budget: the share of each cause in the masking error of a simulated rig, from runs without that cause."""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from masking.analysis.masking_error import masking_error
from masking.compile.numerics.arrays import Array
from masking.control.observer import Differences, Observer
from masking.control.rig.twin import Twin
from masking.control.twin_loop import SampledLoop
from masking.display.printed_result import Printed
from masking.errors import MaskingError, ModelError
from masking.lab.records.recording import Recording
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.parted_motion import noted
from masking.lab.runs.remedies import PARAMETERS, SAMPLING, Remedy, differing_parameters, remedies, with_rig_parameters
from masking.lab.runs.simulated_run import Progress, TwinRun, run_twin
from masking.model.declaration import schema
from masking.model.effects import DELAY, FAMILIES, SATURATION

NOTHING, ALL = "nothing", "all of these"
FASTER: Final = 10  # times the rate: so much faster is sampling that costs next to nothing
LONGEST: Final = 10.0  # s that the runs of a budget may take where nobody has asked for one
PREDICTED: Final = 10_000  # samples that a prediction simulates at most
BORNE: Final = 0.1  # masking error up to which a delay is borne
MOST_DOUBLED: Final = 7  # times that a delay is doubled: more than 100 samples are no delay of a loop
_PREPARING: Final = 0.15  # s before each of them
_WORTH: Final = 0.9  # of chi: what a cause must bring it down to, to be worth a sentence
_PROBES: Final = 200  # states of the run at which the controller's model is compared with the rig
_CAUSES: Final = 0.6  # part of the work of a budget that is done when all causes have been looked at
_FELT: Final = 0.5  # masking error between two wanted motions from which on what parts them is their excitation
_KNOWN: Final = 0.5  # of the error of the model: what knowing a cause must bring it down to
_KNOWN_NOTE: Final = "the controller's model knows it: without it, the model is wrong"
_OFFSETS_NOTE: Final = "makes up for another cause: to correct it alone makes matters worse"


@dataclass(frozen=True)
class Row:
    """The masking error of one run: without a cause, whose effects are named as the plant file names them."""

    cause: str  # what was absent
    effects: tuple[str, ...]  # the effects that were switched off; "limits" for those of the plant file
    chi: Mapping[str, float]  # masking error of each virtual coordinate; infinite where the run could not go on
    remedy: str = ""  # what helps against the cause: a change of a file that was tried, or else what helps on the rig
    note: str = ""  # what must be known to read the row, such as why the run stopped
    remedied: float | None = None  # rms of chi with the remedy; None where it was not tried

    @property
    def worst(self) -> float:
        """Largest chi."""
        return max(self.chi.values())

    @property
    def rms(self) -> float:
        """Root of the mean squared chi of the coordinates, by which runs are compared."""
        return math.sqrt(sum(chi**2 for chi in self.chi.values()) / len(self.chi))


@dataclass(frozen=True)
class Budget:
    """What limits the masking error of a run: the run as it is, without each cause in turn, and without all of them."""

    whole: Row
    rows: tuple[Row, ...]
    without_all: Row  # leaves on what the controller's model knows
    rate: float  # of the controller, Hz

    @property
    def sentence(self) -> str:
        """Cause to remove first, in words."""
        now, left = f"{self.whole.rms:.2g}", f"{self.without_all.rms:.2g}"
        best = min(self.rows, key=lambda row: row.rms)
        declared = min(self.rows, key=lambda row: (math.inf if row.remedied is None else row.remedied, row.rms))
        if declared.remedied is not None:
            return f"Remedy first: {declared.cause} (chi {now} -> {declared.remedied:.2g} with {declared.remedy})."
        if math.isinf(self.whole.rms):
            cured = f" Without {best.cause} it goes on (chi {best.rms:.2g})." if math.isfinite(best.rms) else ""
            return f"The run stops: {self.whole.note}.{cured}"
        if best.rms <= _WORTH * self.whole.rms:
            how = f"sampled at {FASTER * self.rate / 1e3:g} kHz" if best.cause == SAMPLING else "without"
            return f"Remedy first: {best.cause} (chi {now} -> {best.rms:.2g} {how})."
        if self.without_all.rms <= _WORTH * self.whole.rms:
            change = f"chi {now} -> {left} without any of them"
            return f"No single cause limits the masking error; all together do ({change})."
        return f"Nothing that can be switched off limits the masking error (chi {now}, and {left} without any of it)."

    def as_dict(self) -> dict[str, Any]:
        """Budget as JSON can hold it; `change` is that of the rms of chi."""
        whole = self.whole

        def entry(row: Row) -> dict[str, Any]:
            change = 0.0 if row.rms == whole.rms else row.rms - whole.rms  # both may be infinite
            own = {"effects": [*row.effects], "worst": row.worst, "rms": row.rms, "change": change}
            return asdict(row) | own

        return {
            "sentence": self.sentence,
            "chi": dict(whole.chi),
            "worst": whole.worst,
            "rms": whole.rms,
            "rows": [entry(row) for row in self.rows],
            "without_all": entry(self.without_all),
        }


def run(experiment: Experiment, wanted: bool | None = None, progress: Progress | None = None) -> Recording:
    """Run an experiment and put its budget into the manifest of the recording, under `budget`.

    Where it is not said whether a budget is wanted, one is made that takes less than ten seconds, but none of chaos,
    whose masking error grows whatever its causes are. `progress` is called with the part done, first of the run and
    then of the budget. A MaskingError where the run could not go on, or a budget is wanted without an observer.
    """
    if wanted and not experiment.has_observer:
        raise ModelError(
            f"{experiment.declaration.name}: there is no budget of a controller that knows the true state; give "
            "controller.rate and an observer, such as 'controller: {rate: 1 kHz, observer: disturbance}'"
        )
    recording = noted(experiment, experiment.run(progress))
    if wanted is None:
        is_free = experiment.declaration.controller.regulate is None  # else chi is of another motion
        is_free = is_free and "chaos" not in recording.manifest.get("parting", {})
        wanted = experiment.has_observer and is_free and expected_time(experiment, recording) < LONGEST
    if not wanted:
        return recording
    if (recording.manifest.get("stop") or {}).get("met"):  # the same length for all runs
        experiment = in_full(experiment, recording.manifest["stop"]["at"])
    return replace(recording, manifest={**recording.manifest, "budget": budget(experiment, progress).as_dict()})


def in_full(experiment: Experiment, duration: float | None = None) -> Experiment:
    """Experiment that nothing ends before its duration, or before another one in virtual time."""
    changes = {"stop": None, "duration": duration or experiment.declaration.duration}
    changed = experiment.declaration.model_copy(update=changes)
    return replace(experiment, assembly=replace(experiment.assembly, experiment=changed))


def expected_time(experiment: Experiment, recording: Recording) -> float:
    """How long a budget will take, in s, from the time of the run."""
    timing = recording.manifest["timing"]
    slow, fast = 1 + len(causes(experiment.twin)), 2  # sampling, and all of these
    return float((timing["run"] + timing["ideal"]) * (slow + FASTER * fast) + _PREPARING * (slow + fast))


def causes(twin: Twin) -> dict[str, tuple[str, ...]]:
    """Causes that a twin has switched on, with their effects as the plant file names them; limits are saturation."""
    found: dict[str, list[str]] = {family: [] for family in FAMILIES}
    for effect in twin.effects:
        if effect.enabled:
            found.setdefault(effect.entry.family or effect.kind, []).append(effect.path.partition(".")[2])
    if twin.declaration.limits.inputs or twin.declaration.limits.power:
        found[SATURATION].append("limits")
    return {cause: tuple(dict.fromkeys(names)) for cause, names in found.items() if names}


def budget(experiment: Experiment, progress: Progress | None = None) -> Budget:
    """Run an experiment with an observer as it is, and again without each cause of masking error.

    Only the cause changes: the observer keeps the bandwidths and the noise for which it was designed, and a controller
    that predicts the delay predicts the one there is. A run that cannot go on counts with an infinite chi.
    """
    bench, found, others = _Bench(experiment), causes(experiment.twin), differing_parameters(experiment)
    total = 1 + len(found) + bool(others) + 2 * FASTER
    done = itertools.accumulate([1] * (1 + len(found) + bool(others)) + [FASTER], initial=0)

    def report(part: float) -> None:
        if progress is not None:
            progress(part)

    def row(
        cause: str, without: Iterable[str], effects: tuple[str, ...], note: str = "", bench: _Bench = bench
    ) -> tuple[Row, TwinRun | None]:
        without, before = frozenset(without), next(done)
        weight = FASTER if SAMPLING in without else 1
        return bench.row(cause, without, effects, note, lambda part: report(_CAUSES * (before + weight * part) / total))

    whole, run_as_it_is = row(NOTHING, (), ())
    known = bench.known(found, run_as_it_is) if run_as_it_is else frozenset()
    rows, felt = list[Row](), set[str]()
    is_pushed = any(source.is_live for source in experiment.declaration.inputs.values())
    motion = bench.wanted(run_as_it_is) if is_pushed and run_as_it_is else None
    for cause, effects in found.items():
        made, run = row(cause, [cause], effects, _KNOWN_NOTE if cause in known else "")
        if run is not None and motion is not None and bench.is_felt(motion, run):
            felt.add(cause)
            continue
        is_worse = not made.note and made.rms * _WORTH > whole.rms
        rows.append(replace(made, note=_OFFSETS_NOTE) if is_worse else made)
    exact = _Bench(with_rig_parameters(experiment).made()) if others else bench
    if others:
        rows.append(row(PARAMETERS, (), others, bench=exact)[0])
    faster = f"sampled at {FASTER * bench.rate / 1e3:g} kHz instead, with the same delay in seconds"
    rows.append(row(SAMPLING, [SAMPLING], (), faster)[0])
    note = f"but for {', '.join(c for c in found if c in known)}, which the controller's model knows" if known else ""
    off = [cause for cause in found if cause not in known | felt]
    effects = tuple(name for cause in off for name in found[cause])
    ideal = row(ALL, [*off, SAMPLING], effects, note, bench if known else exact)[0]
    worth = [i for i, one in enumerate(rows) if one.rms <= _WORTH * whole.rms or one.cause == SAMPLING]
    tried = dict[str, Row]()
    for done_before, i in enumerate(worth):
        rows[i] = bench.remedied(rows[i], whole, rows[i].cause in known, tried)
        report(_CAUSES + (1.0 - _CAUSES) * (done_before + 1) / len(worth))
    report(1.0)
    return Budget(whole, tuple(rows), ideal, bench.rate)


@dataclass(frozen=True, repr=False)
class Prediction(Printed):
    """Masking error that a simulated run shows before anything moves, and the delay that its controller bears."""

    chi: Mapping[str, float]  # masking error of each virtual coordinate; infinite where the run could not go on
    seconds: float  # that were simulated, of the rig
    sentence: str  # what to remove first
    delay: int  # samples by which the rig is late
    most: int | None  # samples with which chi stays below `BORNE`; None without a declared delay, or where none does

    def __str__(self) -> str:
        worst = max(self.chi, key=lambda name: self.chi[name])
        words = f"predicted masking error chi = {self.chi[worst]:.2g} ({worst}) over {self.seconds:.3g} s"
        borne = f"; it stays below {BORNE:g} up to a delay of {self.most} samples, and the plant has {self.delay}"
        return f"{words}{borne if self.most is not None else ''}. {self.sentence}"


def predict(experiment: Experiment) -> Prediction:
    """Simulate an experiment whose controller reads sensors, with the effects of its rig.

    At most `PREDICTED` samples are. The delay that the controller bears is searched with the observer that it has by
    default at each delay.
    """
    scale, rate = experiment.time_scale, experiment.sampled.rate
    duration = min(experiment.declaration.duration, PREDICTED / (rate * scale))
    shortened = in_full(experiment, duration)
    whole, bench = budget(shortened), _Bench(shortened)
    delay, most = experiment.twin.delay, None

    def is_borne(samples: int) -> bool:
        made = replace(bench, delay=samples)
        return made.row("", frozenset(), (), "", lambda _: None)[0].worst <= BORNE

    if delay and is_borne(1):
        beyond = next((d for d in (2**i for i in range(1, MOST_DOUBLED)) if not is_borne(d)), 2**MOST_DOUBLED)
        most = bisect.bisect_left(range(beyond), True, lo=beyond // 2 + 1, key=lambda d: not is_borne(d)) - 1
    return Prediction(whole.whole.chi, duration * scale, whole.sentence, delay, most)


@dataclass(frozen=True)
class _Bench:
    """An experiment that is run without some of the causes of its masking error."""

    experiment: Experiment
    delay: int | None = None  # samples by which the rig is late and the controller knows it; None: as declared

    @property
    def rate(self) -> float:
        return self.experiment.sampled.rate

    @cached_property
    def observer(self) -> Observer:
        """The observer of the run as it is, with the bandwidths that were chosen for it."""
        observer, sampled = self.experiment.observer, self.experiment.sampled
        if isinstance(observer, Differences) or self.delay is not None:
            return observer
        speeds = observer.bandwidths(sampled.plan)
        return replace(observer, bandwidth=tuple(float(speed) for speed in speeds))

    def row(
        self, cause: str, without: frozenset[str], effects: tuple[str, ...], note: str, progress: Progress
    ) -> tuple[Row, TwinRun | None]:
        """Run the experiment without some causes; return its row, and the run if it could go on."""
        names = self.experiment.virtual.coordinates
        try:
            run = self.run(without, progress)
        except MaskingError as error:
            return Row(cause, effects, dict.fromkeys(names, math.inf), note=str(error)), None
        with np.errstate(all="ignore"):  # a run that is about to grow without bound
            columns = self.experiment.columns(run)[0].columns
            found = {name: masking_error(columns[f"virtual.{name}"], columns[f"ideal.{name}"]) for name in names}
        chi = {name: value if math.isfinite(value) else math.inf for name, value in found.items()}
        return Row(cause, effects, chi, note=note), run

    def wanted(self, run: TwinRun) -> list[Array]:
        """Wanted motion beside a run, a series for each virtual coordinate."""
        columns = self.experiment.columns(run)[0].columns
        return [columns[f"ideal.{name}"] for name in self.experiment.virtual.coordinates]

    def is_felt(self, motion: Sequence[Array], without: TwinRun) -> bool:
        """Whether a cause moves the virtual system itself: a push that is felt is no error, but its excitation.

        `motion` is the one that is wanted with the cause, `without` the run without it.
        """
        pairs = zip(self.wanted(without), motion, strict=True)
        return max(masking_error(other, own) for other, own in pairs) > _FELT

    def remedied(self, row: Row, whole: Row, known: bool, tried: dict[str, Row]) -> Row:
        """Row with the first change that brings the error down, as a run shows, or else with what helps on the rig.

        `tried` holds the runs with changes, by their words.
        """
        for remedy in remedies(self.experiment, row.cause, row.effects, known):
            if remedy.words not in tried:
                tried[remedy.words] = self._changed(remedy)
            if tried[remedy.words].rms <= _WORTH * whole.rms and math.isfinite(tried[remedy.words].rms):
                return replace(row, remedy=remedy.words, remedied=tried[remedy.words].rms)
        twin = self.experiment.twin
        placed = [e for e in twin.effects if e.path.partition(".")[2] in row.effects and e.enabled and e.entry.remedy]
        helps = dict.fromkeys((e.entry.remedy, e.at) for e in placed)
        return replace(row, remedy="; ".join(f"{at}: {text}" if at else text for text, at in helps))

    def _changed(self, remedy: Remedy) -> Row:
        """Row of the run with a change; its chi is infinite where the change is refused, or the run cannot go on."""
        try:
            changed = _Bench(remedy.made())
        except MaskingError as error:
            return Row("", (), dict.fromkeys(self.experiment.virtual.coordinates, math.inf), note=str(error))
        return changed.row("", frozenset(), (), "", lambda _: None)[0]

    def run(self, without: frozenset[str], progress: Progress) -> TwinRun:
        """Run the experiment without some causes, recorded at the instants at which it is recorded as it is."""
        experiment, loop = self.experiment, self.loop(without)
        sampled = loop.sampled
        duration, seed = experiment.declaration.duration * experiment.time_scale, experiment.declaration.seed
        every = experiment.every * round(sampled.rate / self.rate)
        return run_twin(loop, experiment.twin_start, duration=duration, seed=seed, every=every, progress=progress)

    def loop(self, without: frozenset[str]) -> SampledLoop:
        """Controller and twin without some causes; the compiled functions are those of the run as it is."""
        sampled, faster = self.experiment.sampled, FASTER if SAMPLING in without else 1
        twin = self.twin(without, faster) if self.delay is None else _delayed(self.experiment.twin, self.delay)
        plant = sampled.instruments.plant
        if SATURATION in without:
            limits = {name: limit.model_copy(update={"max": math.inf}) for name, limit in plant.limits.inputs.items()}
            lifted = plant.limits.model_copy(update={"inputs": limits, "power": None})
            plant = plant.model_copy(update={"limits": lifted})
        instruments = replace(sampled.instruments, plant=plant, delay=twin.delay)
        made = replace(sampled, instruments=instruments, observer=self.observer, rate=faster * sampled.rate)
        return SampledLoop(made, twin)

    def twin(self, without: frozenset[str], faster: int) -> Twin:
        """Twin without some causes, with the same delay in seconds at a multiple of the rate."""
        twin = self.experiment.twin
        off = {name for cause, effects in causes(twin).items() if cause in without for name in effects}
        twin = _switched(twin, lambda name, enabled: enabled and name not in off)
        return twin if faster == 1 or not twin.delay else _delayed(twin, faster * twin.delay)

    def known(self, found: Mapping[str, tuple[str, ...]], run: TwinRun) -> frozenset[str]:
        """Causes that the controller holds: errors of sensors that it expects, and forces.

        Its model holds those forces with which, and only with which, the rig is nearer to it.
        """
        settings, twin = self.experiment.declaration.controller, self.experiment.twin
        if settings.model is None and not settings.parameters and not settings.effects:
            return frozenset()
        model, match, n = self.experiment.law.model, self.experiment.match, len(twin.model.coordinates)
        k, kernels = len(model.coordinates), self.experiment.sampled_loop.kernels
        seen = match.seen(kernels, run.states)
        rows = np.unique(np.linspace(0, len(run.times) - 1, _PROBES).astype(int))
        p, u, out = model.values(), np.zeros(len(model.inputs)), np.empty(run.estimates.shape[1])
        assumed = []
        for row in rows:
            state = np.concatenate([seen[row, : 2 * k], run.estimates[row, 2 * k :]])
            model.kernels.derivative(0.0, state, u, p, out)
            assumed.append(out[k : 2 * k].copy())

        def error(effects: tuple[str, ...]) -> float:
            rig = _switched(twin, lambda name, enabled: enabled and name in effects)
            states = run.states[rows]
            return float(
                np.linalg.norm(match.seen(kernels, states, _accelerations(rig, states, n))[:, 2 * k :] - assumed)
            )

        bare, expected = error(()), {error.effect for error in self.experiment.sampled.instruments.errors}
        kinds = {name: twin.dictionary[use.effect].where for name, use in twin.declaration.effects.items()}
        return frozenset(
            cause
            for cause, effects in found.items()
            if expected & {*effects}
            or (any(kinds.get(name) == "element" for name in effects) and error(effects) < _KNOWN * bare)
        )


def _delayed(twin: Twin, samples: int) -> Twin:
    """Twin whose loop is late by some samples; it declares a delay."""
    first, *more = causes(twin)[DELAY.family]
    changes = {**twin.changes, **{name: schema.EffectChange(enabled=False) for name in more}}
    changes[first] = schema.EffectChange(parameters={DELAY.grows_with: float(samples)}, enabled=True)
    return twin.changed(changes)


def _accelerations(twin: Twin, states: Array, n: int) -> Array:
    """Accelerations (m, n) of a twin that is not driven, in given states (m, states)."""
    p, u, out = twin.values(), np.zeros(len(twin.actuators)), np.empty(states.shape[1])
    found = np.empty((len(states), n))
    for state, row in zip(states, found, strict=True):
        twin.kernels.twin_derivative(0.0, np.ascontiguousarray(state), u, p, out)
        row[:] = out[n : 2 * n]
    return found


def _switched(twin: Twin, on: Callable[[str, bool], bool]) -> Twin:
    """Twin with its effects switched as `on(name, is it on)` says."""
    changes = {}
    for name, use in twin.declaration.effects.items():
        change = twin.changes.get(name, schema.EffectChange())
        enabled = use.enabled if change.enabled is None else change.enabled
        changes[name] = change.model_copy(update={"enabled": on(name, enabled)})
    return twin.changed(changes)
