"""Text of a run: its study in sentences and short lines of plain text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from masking.analysis.synchronisation.synchronisation_verdict import NEAR
from masking.lab.records.recording import Recording
from masking.model.declaration.quantities import number, percent
from masking.reports.run_study import BudgetRow, InputUse, Parameter, PhasePair, Study, nested, parameters
from masking.reports.text import capital, short

_SUMMARY_LINES, _WIDTH = 14, 100
_TRUE, _ROUGH = 0.01, 0.3  # chi up to which the rig moved as, or roughly as, the virtual system
_OTHER = 1.0  # chi of a rig at rest
_TARDY = 0.01  # of the samples of a run
_OWNED = frozenset({"the", "a", "an", "my", "our", "your", "his", "her", "its", "their", "this", "that"})
_AWAY = 0.02  # of the largest initial coordinate: what homing may leave
_MUCH = 1.1  # times its limit: from here on an input is stated in multiples, below in percent
_WITH_MODEL = frozenset({"kalman", "disturbance"})  # observers that predict what is late
_ORDER, _ENOUGH = 8, 100  # of differences of readings; readings in which noise is looked for
_MEDIAN = 0.6745  # of the magnitude of normal noise, in parts of its deviation
_LOUD = 2.0  # times the noise that is known
_NO_PHASE = "no fixed phase"
_HELPS = 0.98  # of chi: what a cause must bring it down to, for what helps on the rig to be shown
_STEADY = 0.7  # length of the mean unit vector below which a phase is not locked


def warnings(study: Study) -> list[str]:
    """Sentences on what limits the validity of the result; empty if all is well."""
    manifest = study.recording.manifest
    measured = (exceeded(study.inputs), cut(study.inputs), hasty(study), louder(study.recording), tardy(manifest))
    found = [text for text in measured if text]
    rate = float(manifest.get("rate") or 0.0)
    compensates = (manifest.get("observer") or {}).get("kind") in _WITH_MODEL
    is_late = manifest.get("mode") == "sampled" and rate > 0.0 and not compensates
    if is_late and any(part > _TRUE for part in study.chi.values()):
        late = 0.5 / rate
        late_words = f"{number(late)} s" if late >= 1.0 else f"{number(1e3 * late)} ms"
        found.append(
            f"Sampled at {rate_words(rate)}, inputs act half a sample ({late_words}) late on average, and nothing here "
            "compensates for it; 'observer: disturbance' does, and a higher controller.rate reduces it."
        )
    found += [missed(study)] if missed(study) else []
    free = manifest.get("passive") or {}
    if free.get("verdict") == "unstable":
        found.append(
            f"Not for long: {free['words']}. Nothing holds what is passive; choose a slower or smaller virtual motion, "
            "or drive it instead."
        )
    other = strayed(study)
    if other and not found and not manifest.get("parting"):
        other += (
            " Nothing that was measured explains it: compare zeros, noise, gains and delay of the rig with those of "
            "its plant file ('masking rig check ADDRESS --plant PLANT', 'masking rig calibrate'), or let 'masking "
            "discover' look for the cause in this recording, such as the drift of a sensor."
        )
    return [other, *found] if other else found


def strayed(study: Study) -> str:
    """Coordinates that moved otherwise than wanted; nothing where none did, something else is held, or it is chaos."""
    far = [f"{name} {number(chi, 2)}" for name, chi in study.chi.items() if not chi <= _OTHER]
    manifest = study.recording.manifest
    is_chaos = nested(manifest, "parting", "chaos").get("is_alike")  # a large error says nothing against such a run
    if not far or regulation(manifest) or (is_chaos and not cut(study.inputs)):
        return ""
    return f"The masking error is above 1 ({', '.join(far)}): a rig at rest would be nearer to the wanted motion."


def tardy(manifest: Mapping[str, Any]) -> str:
    """Share of the samples of a run on a plant that came late or not at all; nothing where it is small."""
    rig = manifest.get("rig") or {}
    counts, ticks = rig.get("counters") or {}, sum(nested(rig, "timing", "controller").get("counts") or ())
    late, missed = counts.get("late", 0), counts.get("missed", 0)
    part = max(late, missed) / max(1, ticks + missed)
    words = f"{percent(part)} of the samples were late or missed, so that commands acted later than declared"
    return f"{words}; lower controller.rate, or take load off the machine and the line." if part > _TARDY else ""


def passive(facts: Study) -> str:
    """Reach, energy and own stability of the passive coordinates."""
    free = facts.recording.manifest["passive"]
    far = [f"{n} up to {with_unit(x, facts.unit(f'rig.{n}'))}" for n, x in free["peak"].items()]
    if free.get("energy"):
        far.append(f"energy up to {with_unit(free['energy']['peak'], free['energy']['unit'])}")
    return f"{', '.join(far)}; zero dynamics {free['verdict']} ({free['how']})"


def missed(facts: Study) -> str:
    """Distance of the rig from its initial state after homing; nothing where it is there."""
    start = facts.recording.manifest.get("start") or {}
    wanted, reached = start.get("wanted") or {}, start.get("reached") or {}
    units = {name: facts.unit(f"virtual.{name}") for name in wanted}
    size, short = max(map(abs, wanted.values()), default=0.0), []
    for name, value in wanted.items():
        alike = max(abs(other) for n, other in wanted.items() if units[n] == units[name])
        if abs(reached.get(name, value) - value) > _AWAY * (alike or size):
            short.append(name)
    if not short:
        return ""
    away = ", ".join(f"{n} = {number(reached[n])} instead of {with_unit(wanted[n], units[n])}" for n in short)
    return (
        f"Homing did not reach the initial state: {away}; give it more time (controller.homing), or begin with "
        "less (initial)."
    )


def exceeded(uses: Iterable[InputUse]) -> str:
    """Inputs beyond their limits; nothing where none are."""
    sentences = []
    for use in uses:
        if use.is_exceeded and use.used is not None:
            peak, limit = (with_unit(value, use.unit) for value in (use.peak, use.limit or 0.0))
            over = f"{number(use.used)} times" if use.used >= _MUCH else f"{percent(use.used - 1)} above"
            sentences.append(f"{use.name} needs {peak}, {over} its limit of {limit}")
    return f"Not possible on this rig: {'; '.join(sentences)}." if sentences else ""


def cut(uses: Iterable[InputUse]) -> str:
    """Inputs that a limit held back, and for how long; nothing where all that was demanded was applied."""
    sentences = []
    for use in uses:
        if not use.is_cut:
            continue
        parts = [f"at its limit for {percent(use.saturated)} of the run"] if use.saturated else []
        if use.throttled:
            power = "" if use.most_power is None else f" of {use.most_power:g} W"
            parts.append(f"held back by its mean power{power} for {percent(use.throttled)} of the run")
        limit = with_unit(use.limit or 0.0, use.unit)
        demand = f"{percent(use.demand / use.limit)} of {limit}" if use.limit else f"{number(use.demand)} {use.unit}"
        sentences.append(f"{use.name} was {' and '.join(parts)}: demanded up to {demand.rstrip()}")
    return f"{'; '.join(sentences)}; the rig could not follow there." if sentences else ""


def hasty(study: Study) -> str:
    """Inputs that change faster than the rig allows, as they may in a simulated run; nothing where none do."""
    limits, found = nested(study.recording.manifest, "limits"), list[str]()
    for use in study.inputs:
        rate, times = nested(limits, use.name).get("rate"), study.whole.t
        fastest = float(np.max(np.abs(np.diff(use.series)) / np.diff(times), initial=0.0)) if rate else 0.0
        if rate and fastest > _MUCH * rate:
            found.append(f"{use.name} changes by {number(fastest)} {use.unit}/s, where {number(rate)} are allowed")
    return f"{'; '.join(found)}: on the rig, commands are slowed." if found else ""


def louder(recording: Recording) -> str:
    """Sensors that scatter by more than the noise for which the observer is designed; "" where none do.

    Of a smooth motion, differences of a high order leave nothing; what white noise leaves is known.
    """
    noise, found = (recording.manifest.get("observer") or {}).get("noise") or {}, dict[str, str]()
    for name, deviation in noise.items():
        readings = recording[f"sensor.{name}"] if f"sensor.{name}" in recording.columns else np.empty(0)
        if len(readings) > _ENOUGH and deviation > 0.0:
            left = float(np.median(np.abs(np.diff(readings, _ORDER))))
            times = left / (_MEDIAN * deviation * math.sqrt(math.comb(2 * _ORDER, _ORDER)))
            if times > _LOUD:
                found[name] = number(times)
    words = f"{', '.join(found)} scatter{'s' * (len(found) == 1)} by {'/'.join(found.values())} times the known noise"
    remedy = "declare it, so that the observer is designed for it: an effect of the plant, or controller.observer.noise"
    return f"{words}; {remedy}." if found else ""


def observer(facts: Study) -> str:
    """Observer of the rig's state; "" where the controller knew the true one."""
    entry = facts.recording.manifest.get("observer") or {}
    kind = str(entry.get("kind") or "")
    if not kind or kind == "exact":
        return ""
    delay = int(entry.get("delay") or 0)
    late = f"{delay} sample{'s' * (delay != 1)} of delay" if delay else "no delay"
    if kind not in _WITH_MODEL:
        return f"{kind} of the positions, {late}{' not predicted' * bool(delay)}"
    words = f"{'Kalman filter' if kind == 'kalman' else f'{kind} observer'}"
    if entry.get("order"):
        words += f", order {entry['order']}"
    speeds = (entry.get("bandwidth") or {}).values()
    if speeds:
        words += f", bandwidth {'/'.join(number(speed) for speed in speeds)} rad/s"
    return f"{words}, {late}{' predicted' * bool(delay)}"


def external(facts: Study) -> str:
    """Response to a push: a disturbance observer takes it for an error of its model, unless it is felt."""
    manifest = facts.recording.manifest
    if nested(manifest, "declarations", "experiment", "controller").get("external") == "felt":
        sources = manifest.get("inputs") or {}
        felt = [name for name, source in sources.items() if {"sensor", "push"} & source.keys()]
        return f"pushes felt through {', '.join(felt)}"
    rejects = (manifest.get("observer") or {}).get("kind") == "disturbance"
    return "pushes rejected, as errors of the model" if rejects else ""


def _rig(name: str) -> str:
    """Plant's name with an article, where it does not bring its own."""
    first = name.lower().partition(" ")[0]
    name = name if first in _OWNED or first.endswith(("'s", "\u2019s")) else f"the {name}"
    return capital(name)


def headline(facts: Study) -> list[str]:
    """Outcome in sentences; what is beyond a limit would happen."""
    manifest = facts.recording.manifest
    plant = _rig(str(manifest.get("plant_name") or "").strip() or "rig")
    possible = not exceeded(facts.inputs)
    virtual = str(manifest.get("virtual_name") or "its virtual system")
    over = f"over {' '.join(length(facts))}"
    worst = facts.worst
    still = bool(facts.coordinates) and not any(np.any(facts.motion(name)) for name in facts.coordinates)
    if still and not any(facts.chi.values()):
        return [f"{plant} stood still {over}."]
    if worst is None:
        sentences = [f"{plant} was recorded {over}."]
    else:
        chi = facts.chi[worst]
        size = f"= {number(chi, 2)}" if len(facts.chi) == 1 or chi == 0 else f"<= {number(chi, 2)} in each coordinate"
        held = regulation(manifest)
        how = "as" if chi <= _TRUE else "roughly as"
        verb = f"moved {how}" if possible else f"would move {how}"
        if not chi <= _ROUGH:
            verb = "did not move as" if possible else "would not move as"
        sentences = [f"{plant} {verb} {virtual}: masking error chi {size} {over}."]
        if possible and not chi <= _ROUGH:
            error, unit = f"masking error chi {size} {over}", length(facts)[1]
            sentences = _parted(facts, plant, virtual, error, unit) or sentences
        if held:
            sentences = [f"{plant} {'moved' if possible else 'would move'} as {virtual} {held}, {over}."]
    if still:
        sentences.append("Nothing moved.")
    sentences += [_phase_sentence(pair) for pair in facts.pairs[:1]]
    if ended(manifest):
        sentences.append(ended(manifest))
    if len(facts.oscillators) > 2 and facts.sum_peak is not None:
        start, end = facts.sum_ends
        to = with_unit(end, sum_unit(facts))
        sentences.append(f"The peak of {sum_name(facts)} went from {number(start)} to {to}.")
    if facts.budget:
        sentences.append(str(manifest["budget"]["sentence"]))
    return sentences


def ended(manifest: Mapping[str, Any]) -> str:
    """Early end of a run, or that its condition was not met; nothing where no condition was set."""
    stop = manifest.get("stop") or {}
    if not stop:
        return ""
    what = f"{' and '.join(stop['of'])} were {'in ' * (stop['phase'] == 'anti')}{stop['phase']}-phase"
    eps = f"to {percent(stop['eps'])} of the amplitude"
    if stop["met"]:
        whole = number(stop["duration"], 4)
        return f"The run ended after {number(stop['at'], 4)} of {whole} units of time, when {what} {eps}."
    return f"The run was not ended early: {what} {eps} for {number(stop['periods_needed'])} periods at no time."


def regulation(manifest: Mapping[str, Any]) -> str:
    """Quantities that the controller held besides the wanted dynamics; nothing where it held none."""
    wanted = nested(manifest, "declarations", "experiment", "controller", "regulate")
    parts = [f"an energy of {number(wanted['energy'])}"] if wanted.get("energy") is not None else []
    parts += [f"{wanted['phase']}-phase motion"] if wanted.get("phase") else []
    return f"regulated to {' and '.join(parts)}" if parts else ""


def _phase_sentence(pair: PhasePair) -> str:
    who = f"{pair.first} and {pair.second}"
    start, end = _state(pair.start, pair.steady_start), _state(pair.end, pair.steady_end)
    if pair.verdict is not None and (pair.verdict.kind in {"beating", "death"} or len(set(pair.verdict.ratio)) > 1):
        return str(pair.verdict)
    if start == end and "pi" in end:
        return f"{who} stayed {end}."
    if start == end == _NO_PHASE:
        return f"{who} kept {_NO_PHASE}."
    if start == end:
        return f"{who} stayed {'in ' * (end == 'anti-phase')}{end} (from {pi(pair.start)} to {pi(pair.end)})."
    where = {"in-phase", "anti-phase"}
    ends = [s if s not in where else f"{s} ({pi(p)})" for s, p in ((start, pair.start), (end, pair.end))]
    return f"{who} went from {ends[0]} to {ends[1]}."


def _state(phase: float, steady: float) -> str:
    if steady < _STEADY:
        return _NO_PHASE
    if phase <= NEAR:
        return "in-phase"
    return "anti-phase" if phase >= math.pi - NEAR else f"{pi(phase)} apart"


def summary(facts: Study) -> str:
    """Study in at most fourteen lines of plain text."""
    manifest = facts.recording.manifest
    rows = [("changed", ", ".join(change(p) for p in parameters(facts.recording) if p.is_changed))]
    if facts.chi:
        against = ", against the system without regulation" if regulation(manifest) else ""
        rows.append(("error", "  ".join(f"{name} {number(chi, 2)}" for name, chi in facts.chi.items()) + against))
    if facts.anti_phase is not None and facts.anti_phase.alpha > 0:
        fit, last = facts.anti_phase, facts.verdict
        words = f"alpha = {fit.alpha:.4f}, eps = {with_unit(fit.eps, sum_unit(facts))} over the last fifth"
        if last is not None and math.isfinite(last.time):  # by definition 8.1
            words += f"; within {percent(last.within)} of the amplitude from {number(last.time, 4)} on"
        rows.append(("anti-phase", words))
    if facts.sum_peak is not None:
        start, end = facts.sum_ends
        rows.append(("peak sum", f"{sum_name(facts)} from {number(start)} to {with_unit(end, sum_unit(facts))}"))
    elif len(facts.oscillators) > 1:
        rows.append(
            ("phase", f"not given: {facts.no_phase}") if facts.no_phase else ("sum", f"not given: {facts.no_sum}")
        )
    rows.append(("inputs", "  ".join(use_words(use) for use in facts.inputs)))
    rows.append(("passive", passive(facts) if facts.passive else ""))
    rows += [("observer", observer(facts)), ("external", external(facts))]
    if manifest.get("rig"):
        rows += [("rig", ticks(manifest)), *loop_times(manifest)]
    energy = manifest.get("energy") or {}
    if "virtual" in energy:
        rows.append(("energy", f"drift of the virtual system {number(energy['virtual'])}"))
    rows.append(("record", record_words(facts)))
    if manifest.get("timing"):
        rows.append(("time", "  ".join(timing(manifest))))
    first, *more = headline(facts)
    said = [first, *warnings(facts), *more]
    lines = said + [f"  {name:<11}{short(text, _WIDTH)}" for name, text in rows if text]
    return "\n".join(lines[:_SUMMARY_LINES])


def timing(manifest: Mapping[str, Any]) -> list[str]:
    """Time that each stage took, compilation first."""
    stages = dict(manifest.get("timing") or {})
    ordered = sorted(stages, key=lambda stage: stage != "compilation")
    return [f"{stage} {number(stages[stage])} s" for stage in ordered]


def change(parameter: Parameter) -> str:
    """Parameter with the value that ran."""
    return f"{parameter.name} = {number(parameter.value, 7)} {parameter.unit}".rstrip()


def declared(parameter: Parameter) -> str:
    """Declared value in brackets, where it is not the value that ran."""
    if parameter.is_changed:
        return f" (declared {number(parameter.declared, 7)})"
    is_computed = isinstance(parameter.declared, str) and isinstance(parameter.value, float)
    return f" (= {parameter.declared})" if is_computed else ""


def record_words(facts: Study) -> str:
    """Length of the record, and its sampling."""
    manifest, unit = facts.recording.manifest, facts.unit("t")
    first, last = facts.whole.span
    words = f"{len(facts.whole)} samples, {number(last - first)} {unit}".rstrip() + " of the rig"
    if manifest.get("rate"):
        words += f", {manifest.get('mode') or 'sampled'} at {rate_words(manifest['rate'])}"
    elif manifest.get("mode"):
        words += f", {manifest['mode']}"
    if manifest.get("rig") or manifest.get("seed") is None:  # a rig makes its own noise
        return words
    return f"{words}, seed {manifest['seed']}"


def ticks(manifest: Mapping[str, Any]) -> str:
    """Timing of a run on a plant, and the source of its motion."""
    rig = manifest["rig"]
    counts = rig.get("counters") or {}
    parts = [f"{rig.get('end')}"]
    parts += [f"{counts[name]} samples {name}" for name in ("late", "missed", "clamped") if counts.get(name)]
    if len(parts) == 1:
        parts.append("every sample in time")
    return f"{', '.join(parts)}; its motion is {manifest.get('states') or 'measured'}"


def loop_times(manifest: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Durations of the ticks of a run on a plant, and how late they began: one line, or none."""
    times = manifest["rig"].get("timing") or {}

    def words(one: Mapping[str, Any]) -> str:
        return f"{number(1e6 * one['median'], 2)}/{number(1e6 * one['p99'], 2)}/{number(1e6 * one['max'], 2)} us"

    what = {"work": "controller, safety and row", "lateness": "late"}
    parts = [f"{name} {words(times[key])} at tick {times[key]['at']}" for key, name in what.items() if key in times]
    return [("loop", f"median/p99/worst: {', '.join(parts)}")] if parts else []


def use_words(use: InputUse) -> str:
    """Part of its limit that an input used."""
    if use.used is None:
        return f"{use.name} peak {with_unit(use.peak, use.unit)}"
    return f"{use.name} {percent(use.used)} of {use.limit:g} {use.unit}".rstrip()


def power(use: InputUse) -> str:
    """Largest mean power of an input and its limit; nothing where none was recorded."""
    most = "" if use.most_power is None else f" of {use.most_power:g}"
    return "" if use.power is None else f"{number(use.power)}{most} W"


def locking(pair: PhasePair) -> str:
    """Remark on a phase that is not fixed at the end; nothing on one that is."""
    return "" if pair.steady_end >= _STEADY else "not fixed"


def worth(row: BudgetRow, whole: BudgetRow) -> list[str]:
    """Change of the masking error without a cause, in percent with its sign, and what helps against the cause."""
    change = "" if row is whole or not whole.rms > 0.0 else "diverges"
    if change and math.isfinite(row.rms):
        change = f"{100.0 * (row.rms / whole.rms - 1.0):+.0f} %".replace("-", "\N{MINUS SIGN}")
        change = "0 %" if change[1:] == "0 %" else change
    helps = row.remedy if row.rms <= _HELPS * whole.rms else ""
    helps = helps if row.remedied is None else f"{row.remedy}: rms {number(row.remedied, 2)}"
    return [change, "; ".join(filter(None, (row.note, helps)))]


def sum_name(facts: Study) -> str:
    """Magnitude of the sum of the oscillators."""
    names = facts.oscillators
    return f"|{' + '.join(names if len(names) <= 3 else (names[0], '...', names[-1]))}|"


def sum_unit(facts: Study) -> str:
    """Unit of the sum of the oscillators."""
    return facts.unit(f"{facts.prefix}.{facts.oscillators[0]}")


def length(facts: Study) -> tuple[str, str]:
    """Length of the record and its unit."""
    unit = "" if facts.is_scaled else facts.unit("t")
    return number(facts.length, 4), unit or "units of time"


def rate_words(rate: Any) -> str:  # noqa: ANN401  # a number of the manifest
    """Rate with its unit."""
    return f"{number(float(rate) / 1e3)} kHz" if float(rate) >= 1e3 else f"{number(rate)} Hz"


def with_unit(value: float, unit: str) -> str:
    """Value with its unit, which may be none."""
    return f"{number(value)} {unit}".rstrip()


def pi(phase: float) -> str:
    """Phase in multiples of pi."""
    return f"{phase / math.pi:.3f} pi"


def _parted(facts: Study, plant: str, virtual: str, error: str, unit: str) -> list[str]:
    """What became of the motion, in sentences with the masking `error` over its time; empty where that is not known.

    `unit` is that of the virtual system's time.
    """
    found = nested(facts.recording.manifest, "parting")
    if "chaos" in found:
        return _chaos(found["chaos"], plant, virtual, error, unit)
    if not found:
        return []
    wanted, reached = (_attractor(facts, found[which]) for which in ("wanted", "reached"))
    if found["is_same"]:
        where = f"{plant} settled on the attractor of {virtual} on which the wanted motion settles: {reached}."
        return [where, f"The two differ in phase, or in how they came there: {error}."]
    return [f"{plant} settled on another attractor of {virtual}, {reached}, than the wanted motion, {wanted}: {error}."]


def _chaos(found: Mapping[str, Any], plant: str, virtual: str, error: str, unit: str) -> list[str]:
    rate, along = (number(found[name], 2) for name in ("exponent", "along"))
    first, time, predicted = percent(found["first"]), number(found["time"], 2), number(found["predicted"], 2)
    spread, own = percent(found["distribution"]), percent(found["wanted"])
    if found["is_alike"]:
        said = f"{plant} moved as {virtual}, whose motions are chaotic and part whatever moves them: {error}."
    else:
        said = f"{plant} did not move as {virtual}, whose motions are chaotic: {error}."
    parted = (
        f"With a largest Lyapunov exponent of {rate}, a difference of {first}, as there was at first, parts two "
        f"motions in {predicted} {unit} by itself; these parted after {time} {unit}."
    )
    measured = (
        f"The parts of the time in which states are below any value differ from those of the wanted system by {spread} "
        f"at most (the wanted motion itself: {own}), and the exponent along the motion is {along}."
    )
    return [said, parted, measured]


def _attractor(facts: Study, found: Mapping[str, Any]) -> str:
    """Attractor in words: where it rests, or its period and the amplitude of each coordinate."""

    def places(values: Mapping[str, float], least: float = 0.0) -> str:
        shown = {name: 0.0 if abs(x) <= least else x for name, x in values.items()}
        return ", ".join(f"{n} = {number(x)} {facts.unit(f'virtual.{n}')}".rstrip() for n, x in shown.items())

    if found["kind"] == "rest":
        return f"rest at {places(found['middle'])}"
    least = 1e-3 * max(found["amplitude"].values())
    return (
        f"a periodic motion (period {number(found['period'])}; amplitude {places(found['amplitude'])}; about "
        f"{places(found['middle'], least)})"
    )
