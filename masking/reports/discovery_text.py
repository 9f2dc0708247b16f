"""Text of a discovery: its finding in plain sentences, and the names of causes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from masking.inference.discovery import compiled_laws, latent_force
from masking.inference.discovery.discovery_result import Discovery, Named
from masking.inference.discovery.latent_force import LatentForces
from masking.inference.discovery.unnamed_law import UnnamedLaw
from masking.model.declaration.quantities import number, percent, quantity, with_deviation
from masking.model.declaration.units import combined, describe, dimension_of, pretty
from masking.model.effects import Effect
from masking.reports import next_experiment_text
from masking.reports.place_text import follows_command, opposite, portrayed, white
from masking.reports.text import alternatives, capital, listed, much, plural, share

MOST = 0.5  # part of the model error from which a place or a side of the rig is stated
LEAST = 0.05  # part of a law, from which a term is stated
MOST_ODDS = 1e6  # that are said: beyond, the odds are those of the model of the noise
SHOWN = 0.01  # probability from which an alternative is stated
SURE = 2.0  # deviations of a parameter from which it is stated in a sentence
MOVED = 3.0  # of its deviations: a larger move of a parameter is stated; of those of its prior: a smaller one is held
APART = 0.02  # of its declared value by which it moved then
LOST = 0.9  # part of a reading that is left, from which the model is said not to follow it
LARGER = 1.05  # times the record's own peak, from which that of an experiment is stated
EXCHANGED = "Unseen data alone show it: it was estimated from these, and validated by the others"
HARDLY_A_FORCE = "Along the record, two of its standard deviations are as large as the force: there may be none"
EARLY = (
    "The search ended early, after as much work as it may do: a part of the record, or fewer --parameters, leave more"
)
CHECK = "check units, columns and signs of the record against the model"
NO_INPUTS = "no experiment is proposed, since the model has no inputs"
NO_EXPERIMENT = "no experiment is proposed, since it is not known which measured input is the rate of which"


def sentence(found: Discovery) -> str:
    """Finding, and what would decide it, in a few sentences without a full stop at the end."""
    return finding(found, deciding(found))


def finding(found: Discovery, further: Sequence[str] = ()) -> str:
    """Finding in a few sentences without a full stop at the end, with further ones behind the verdict."""
    notes = [text for text, holds in ((EXCHANGED, found.exchanged), (EARLY, found.problem.work.is_cut)) if holds]
    said = [*found.notes, unit_remark(found), *_verdict(found), *further, withheld_causes(found), *notes]
    return ". ".join(filter(None, [*said, hold_remark(found)]))


def deciding(found: Discovery) -> list[str]:
    """Experiments that would decide what the record leaves open, in sentences; empty where it leaves nothing open."""
    if found.verdict == "unknown":
        return next_experiment_text.further(found)
    return [capital(deciding_experiment(found))] if is_open(found) else []


def _verdict(found: Discovery) -> list[str]:
    """Sentences on the verdict; empty ones say nothing."""
    change, moves = error_change(found), adjustments(found)
    if found.verdict == "none":
        adjusted = "with the parameters adjusted within their prior uncertainty"
        return [f"Nothing is missing: {adjusted}, {noise_remark(found)}", moves]
    if found.verdict == "parameter":
        off = [cause_with_values(found, one) for one in found.effects[: len(found.explanation.names)]]
        what = plural(len(off), "a parameter is", "parameters are")
        return [f"No effect is missing, but {what} off: {listed(off, '; ')}", change, moves]
    lost = unfollowed_readings(found)
    if found.verdict == "unknown":
        known = [cause_with_values(found, one) for one in reported(found)]
        do = plural(len(known), "does", "do")
        near = f"The nearest known effect is {listed(known, '; ')}, which {do} not explain everything" if known else ""
        first, after = "The model misses an effect that is not in the dictionary", resemblance
        if found.is_hidden:
            first = "The record shows no missing effect, but the validation record does, and does not tell which"
            after = error_change
        return [first, lost, near, after(found), unnamed_law(found)]
    if is_open(found):
        before = [cause_with_values(found, one) for one in found.effects if one is not found.least_sure]
        known = [f"{listed(before, '; ')} {plural(len(before), 'is', 'are')} missing"] if before else []
        first = capital(", and ".join([*known, alternatives(possible_causes(found))]))
        return [f"{first} is missing, and this record cannot tell which", lost, change, moves]
    what = listed([cause_with_values(found, one) for one in found.effects], "; ")
    comma = "," if ", " in what else ""
    first = f"{capital(what)}{comma} {plural(len(found.effects), 'is', 'are')} missing"
    return [first, opposite(found), lost, change, moves]


def unit_remark(found: Discovery) -> str:
    """Channels that are probably in another unit than declared, and the remedy; '' if none are."""
    doubt = found.unit
    if doubt is None:
        return ""
    needed = [
        f"{cause_name(found, name, on) if on else name} {number(times, 4)} times as large"
        for (name, on), times in doubt.otherwise
    ]
    taken = "With the declared sign" if doubt.is_sign else f"In {doubt.declared}"
    *first, last = doubt.sentences(found.twin, found.record.sources, ", as the record is taken here")
    more = f"{taken}, the record would need {listed(needed)} as declared" if needed else ""
    return ". ".join(filter(None, [*first, more, last]))


def withheld_causes(found: Discovery) -> str:
    """Causes that are not reported since they are worse on unseen data than the model as declared; '' if none are."""
    if found.withheld is None:
        return ""
    before, after = found.simulation_error.validation[0], found.withheld.validation_error
    causes = [cause_label(found, *one) for one in found.withheld.causes]
    what = f"{listed(causes)} would explain more of this record, but" if causes else "With adjusted parameters,"
    if after is None:
        return f"{what} the motion on unseen data would no longer be finite, so it is not reported"
    name = max(after, key=lambda sensor: after[sensor] / max(before[sensor], 1e-300))
    return (
        f"{what} the error of {name} on unseen data would be {percent(after[name])}, against {percent(before[name])} "
        "as declared, so it is not reported"
    )


def unnamed_law(found: Discovery) -> str:
    """Law without a name, and the error that it leaves; '' where there is none."""
    law = found.law
    if law is None:
        return ""
    name, after = worst_sensor(found), law.error[1]
    does = "explains the record" if law.closed else "explains a part of it"
    alone, noise = found.simulation_error.adjusted[name], found.simulation_error.validation_noise_floor[name]
    short = law.problem.interval and law.problem.interval != found.problem.interval
    seconds = law.problem.interval / law.problem.record.rate
    within = f" in shooting intervals of {quantity(seconds, 's', 2)}, the longest that it follows" if short else ""
    unsure = f". {HARDLY_A_FORCE}" if 1.0 <= law.coverage.band < np.inf else ""
    return (
        f"A law without a name in {law.place} {does}: {law_form(found, law)}. The validation error of {name} is "
        f"{percent(after[name])} with it{within}, and {percent(alone)} with adjusted parameters alone; the noise floor "
        f"is {percent(noise)}{unsure}"
    )


def law_form(found: Discovery, law: UnnamedLaw) -> str:
    """Form of a law without a name: a force that grows with the 1.7th power of the rate."""
    if law.form is None:
        return f"{law.free.words}, in tables"
    shares = law.form.formula.shares(law.free)
    terms = zip(law.form.formula.terms, shares, strict=True)
    said = [a.words(v, law.free.nouns) for (a, v, _), share in terms if share > LEAST]
    about = "" if law.is_formula else "in tables, about "
    values = cause_with_values(found, found.unnamed).partition(", ")[2] if law.is_formula and found.unnamed else ""
    return f"{about}a force that {listed(said)}{f' ({values})' if values else ''}"


def hold_remark(found: Discovery) -> str:
    """Remark that commands seem to be measured; '' if they do not."""
    if found.first_order_hold is None:
        return ""
    name = worst_sensor(found)
    after = found.simulation_error.estimation[1][name]
    left = f"{percent(found.first_order_hold[name])} of {name}, against {percent(after)}"
    return (
        "Inputs are taken to be constant between samples (zero-order hold); with straight lines between samples, as in "
        f"measured inputs, the model alone leaves {left}: if they were measured, use --hold first-order"
    )


def probability_sentence(found: Discovery) -> str:
    """Probabilities of the least sure name, its alternatives and none of these; '' where nothing has a name."""
    if found.verdict == "unknown" and found.none_of_these:
        return f"The probability that no name is right is {percent(found.none_of_these)}"
    if found.verdict not in {"named", "ambiguous"} or not found.explanation.hypothesis.instances:
        return ""
    said = probabilities(found, found.least_sure)
    said["none of these"] = found.none_of_these
    return f"Probabilities: {listed([f'{name} {percent(part)}' for name, part in said.items()])}"


def weights(found: Discovery) -> list[str]:
    """Weight of each cause: its share of the error on unseen data, and its odds against another class."""
    said = []
    for one in found.grades if found.verdict in {"named", "ambiguous"} else ():
        against = ""
        if one.odds is not None:
            rival = listed([cause_name(found, *name) for name in one.rival]) or "no cause"
            against = f" (odds {odds_text(one.odds)} against {rival})"
        words = capital(cause_name(found, one.name, one.on))
        said.append(f"{words} makes {share(one.share)} of the error on unseen data{against}")
    return said


def odds_text(odds: float) -> str:
    """Odds in words: 300 : 1, and no more than a million."""
    if odds > MOST_ODDS:
        return f"beyond {MOST_ODDS:,.0f} : 1"
    return f"{number(odds, 2)} : 1" if odds >= 1.0 else f"1 : {number(1.0 / max(odds, 1.0 / MOST_ODDS), 2)}"


def is_open(found: Discovery) -> bool:
    """Whether the record leaves open what is missing, among what has names of its own."""
    return found.verdict == "ambiguous" and len(possible_causes(found)) > 1


def possible_causes(found: Discovery) -> list[str]:
    """Names that the least sure cause may have; a delay of the only actuator is that of all of them."""
    return [*probabilities(found, found.least_sure)]


def probabilities(found: Discovery, cause: Named) -> dict[str, float]:
    """Cause and its alternatives in words with their probabilities, those that are the same together."""
    said = {cause_name(found, cause.name, cause.on): cause.probability}
    for name, on, part in cause.alternatives:
        label = cause_name(found, name, on)
        if part > SHOWN or label in said:
            said[label] = said.get(label, 0.0) + part
    return said


def reported(found: Discovery) -> list[Named]:
    """Causes to report; if they do not explain everything, those that differ surely from 0."""
    if found.verdict != "unknown":
        return list(found.effects)
    kept = []
    for one in found.effects:
        values = list(one.parameters.values())
        effect = found.dictionary.get(one.name)
        if any(abs(value) > SURE * std for value, std in (values if effect and effect.is_sum else values[:1])):
            kept.append(one)
    return kept


def unfollowed_readings(found: Discovery) -> str:
    """Readings that the model hardly follows at all; '' if there are none."""
    remains = found.simulation_error.adjusted if found.verdict == "unknown" else found.simulation_error.validation[1]
    floor = found.simulation_error.validation_noise_floor
    lost = [f"{name} (error {percent(part)})" for name, part in remains.items() if part >= LOST > 2.0 * floor[name]]
    if not lost:
        return ""
    return f"The model hardly follows {listed(lost)}: {CHECK}"


def adjusted_parameters(found: Discovery) -> dict[str, tuple[float, float, bool]]:
    """Parameters that moved beside the causes: value, declared value, and whether the prior allows it."""
    off = {one.name for one in found.effects if one.name not in found.dictionary}
    rig, prior, fitted = found.rig, found.problem.prior.deviation, found.explanation.hypothesis
    moves, rows = {}, zip(rig.names, fitted.theta, fitted.deviations, rig.start, prior, strict=False)
    for name, value, std, start, wide in rows:
        by = abs(float(value - start))
        if name not in off and by > MOVED * std and by > APART * abs(start):
            moves[name] = float(value), float(start), by <= MOVED * float(wide)
    return moves


def adjustments(found: Discovery) -> str:
    """Parameters that moved far beside the causes, and small errors that were adjusted; '' if there are none."""
    sentences, known = [], found.twin.base.parameters
    for is_believed, how in ((True, "within"), (False, "beyond")):
        those = [
            f"{name} = {quantity(value, known[name].unit, 4)}, {deviation_words(value, start)}"
            for name, (value, start, held) in adjusted_parameters(found).items()
            if held is is_believed
        ]
        if those:
            every = {1: f"{how} its prior uncertainty", 2: f"both {how} their prior uncertainty"}
            sentences.append(f"{'; '.join(those)}, {every.get(len(those), f'all {how} their prior uncertainty')}")
    errors = [cause_with_values(found, one) for one in found.imperfections if one.deviates > MOVED]
    sentences += [f"{'; '.join(errors)}, small errors that a rig has"] if errors else []
    moves = adjusted_parameters(found).values()
    far = any(not held and not 0.5 < value / start < 2.0 for value, start, held in moves if start)
    return f"Adjusted: {'; '.join(sentences)}{f': {CHECK}' if far else ''}" if sentences else ""


def deviation_words(value: float, declared: float) -> str:
    """Distance of a value from the declared one: 5 % more than declared."""
    if not declared or not 0.1 < value / declared < 2.0:
        return f"where {number(declared, 5)} is declared"
    off = value / declared - 1.0
    return f"{percent(abs(off))} {'more' if off > 0.0 else 'less'} than declared"


def deciding_experiment(found: Discovery) -> str:
    """Experiment that would decide between the causes that the record leaves open."""
    coming = found.next_experiment
    if coming is None:
        return NO_EXPERIMENT if found.twin.actuators else NO_INPUTS
    one, other = possible_causes(found)[:2]
    if not coming.separates:
        return f"no excitation that was tried can tell {one} from {other}"
    most = np.abs(found.record.commands).max(axis=0)
    peaks = dict(zip(found.twin.actuators, most, strict=True))
    sizes = [
        f"{n} up to {quantity(x, latent_force.channel_unit(found, n, 'actuator'))}" for n, x in coming.peaks.items()
    ]
    sentence = f"a {coming.excitation} of {listed(sizes)}, {coming.pace}, would tell {one} from {other}"
    times = max(peak / max(peaks[name], 1e-300) for name, peak in coming.peaks.items())
    declared = found.twin.declaration.limits.inputs
    if times < LARGER or all(name in declared for name in found.twin.actuators):
        return sentence
    hint = "a plant file may declare limits (limits.inputs)"
    return f"{sentence}. Its peak is {number(times, 2)} times the record's; {hint}"


def noise_remark(found: Discovery) -> str:
    """Distance of the residuals from the noise floor, where nothing is missing."""
    name = worst_sensor(found)
    after, floor = found.simulation_error.validation[1][name], found.simulation_error.validation_noise_floor[name]
    return (
        f"the residual of {listed(found.twin.sensors)} is indistinguishable from noise (validation error of {name} "
        f"{percent(after)}; noise floor {percent(floor)})"
    )


def cause_name(found: Discovery, name: str, on: str) -> str:
    """An effect or a parameter with its place: 'dry friction in spring1', 'an added mass on x1'."""
    effect = found.dictionary.get(name)
    if effect is None:
        return f"another {name}"
    words = effect.spoken
    if effect.is_inertia:
        return f"an {words} on {on}"
    if effect.where == "loop":
        actuators = found.twin.actuators
        return f"a {words} of {on or (actuators[0] if len(actuators) == 1 else 'all actuators')}"
    return f"{words} {'in' if effect.where == 'element' else 'of'} {on}"


def cause_label(found: Discovery, name: str, on: str) -> str:
    """An effect or a parameter with its place as a label: 'Delay of V1'."""
    return capital(cause_name(found, name, on).removeprefix("an ").removeprefix("a "))


def cause_with_values(found: Discovery, named: Named) -> str:
    """Cause with its parameters: 'dry friction in spring1, fc = 0.00547 ± 0.00001 m/s²'.

    An inertia is worded as people say it: 'an added mass of 0.0312 ± 0.0005 kg on x1'.
    """
    values = []
    sure = [n for n, (value, std) in named.parameters.items() if abs(value) > SURE * std]
    for name in sure or named.parameters:
        value, std = named.parameters[name]
        text = f"{name} = {with_deviation(value, std, units(found, named).get(name, ''))}"
        if named.name not in found.dictionary:
            text += f", {deviation_words(value, float(found.rig.start[found.rig.names.index(name)]))}"
        values.append(text)
    what = cause_name(found, named.name, named.on) if named.name in found.dictionary else ""
    if what and found.dictionary[named.name].is_inertia:
        return what.replace(" on ", f" of {values[0].removeprefix('m = ')} on ", 1)
    return ", ".join(filter(None, [what, *values]))


def error_change(found: Discovery) -> str:
    """Fall of the validation error, for the sensor in which it was largest beside its noise."""
    (before, how), what, name = without_finding(found), "with this", worst_sensor(found)
    after, floor = found.simulation_error.validation[1], found.simulation_error.validation_noise_floor
    if not found.effects:
        before, how, what = found.simulation_error.validation[0], "as declared", "with adjusted parameters"
    alone = found.simulation_error.fitted_alone
    both = f", fitted to both records, since a fit to one alone leaves {percent(alone[name])}" if alone else ""
    return (
        f"The validation error of {name} is {percent(before[name])} {how} and {percent(after[name])} {what}{both}; "
        f"the noise floor is {percent(floor[name])}"
    )


def without_finding(found: Discovery) -> tuple[dict[str, float], str]:
    """Validation error of each sensor without the finding, and the model that leaves it."""
    if found.verdict == "parameter":
        return found.simulation_error.validation[0], "as declared"
    return found.simulation_error.adjusted, "with adjusted parameters"


def worst_sensor(found: Discovery) -> str:
    """Sensor with the largest error without the finding, relative to its noise floor."""
    floor, (before, _) = found.simulation_error.validation_noise_floor, without_finding(found)
    return max(floor, key=lambda name: before[name] / max(floor[name], 1e-300))


def intervals(found: Discovery) -> str:
    """Shooting intervals in which a record was searched; '' where each record is simulated whole."""
    seconds = found.shooting_interval
    if seconds is None:
        return ""
    return f"Simulated in shooting intervals of {quantity(seconds, 's')}, each from an initial state of its own"


def unexplained(found: Discovery) -> str:
    """Remainder that the known causes do not explain; '' if the residual is noise, or this is said already."""
    if found.closed or not found.effects or found.verdict == "unknown":
        return ""
    little = ", or the noise is not white: the residual is near the noise floor" if found.is_at_noise_floor else ""
    these = plural(len(found.effects), "This does", "These do")
    return f"{these} not explain all{little}. {resemblance(found)}"


def resemblance(found: Discovery) -> str:
    """Likeness of the model error, or of the residual beside the causes, to a force at a place."""
    latent = remaining_error(found)
    what = "It" if latent is found.localisation.latent else "The residual"
    what = "What is missing" if found.law is not None else what
    place = latent.best
    force, (unit, *_) = place.decomposition, place.units
    of_command = max(latent.actuators, key=lambda name: latent.actuators[name], default="")
    if of_command and latent.actuators[of_command] > max(MOST, place.explained):
        return f"{what} looks like a force: {follows_command(latent, of_command)}"
    return f"{what} looks like a force of {quantity(force.rms, unit, 2)} (rms) at {place.name}: {portrayed(place)}"


def remaining_error(found: Discovery) -> LatentForces:
    """Model error, or the residual if causes are reported that do not explain it."""
    seen = found.localisation
    is_whole = found.law is not None or seen.residual is None or not reported(found)
    return seen.latent if is_whole or seen.residual is None else seen.residual


def model_error(found: Discovery) -> LatentForces:
    """Model error, or the residual if the known causes do not explain it."""
    return remaining_error(found) if found.verdict == "unknown" else found.localisation.latent


def location(found: Discovery) -> list[str]:
    """Place of the model error, and residuals that are not white; empty if neither says anything."""
    seen, latent = found.localisation, found.localisation.latent
    sentences = []
    if found.verdict in {"named", "ambiguous"} and found.effects[-1].name in found.dictionary:
        on, side = found.effects[-1].on, found.dictionary[found.effects[-1].name].where
        if side == "element" and latent.best.explained > MOST:
            place = latent.best
            sentences.append(f"{capital(much(place.share))} of the model error is at {place.name}: {portrayed(place)}")
        elif side == "actuator" and latent.actuators.get(on, 0.0) > MOST:
            sentences.append(capital(follows_command(latent, on)))
        elif side == "sensor" and latent.sensors.get(on, 0.0) > MOST:
            sentences.append(f"{capital(much(latent.sensors[on]))} of the model error in {on} follows its reading")
    if found.verdict == "unknown":
        return sentences
    last = {name: after or first for name, (first, after) in seen.whiteness.items()}
    coloured = [f"{name} is {white(one)}" for name, one in last.items() if not one.white]
    if coloured:
        sentences.append(f"On the validation record, the residual of {listed(coloured)}")
    return sentences


def remedies(found: Discovery) -> list[Effect]:
    """Effects that are named, the likely alternatives among them, those with one name and one cause once."""
    dictionary = found.dictionary
    seen = dict.fromkeys(n for e in reported(found) for n in (e.name, *(a[0] for a in e.alternatives if a[2] > 0.05)))
    known = {(e.spoken, e.cause): e for e in (dictionary[name] for name in reversed(seen) if name in dictionary)}
    return [*reversed(known.values())]


def parameter_meaning(found: Discovery, named: Named, name: str) -> str:
    """Meaning of a parameter of a cause, or its declared value where the cause is another value of it."""
    effect = found.twin.dictionary.get(named.name)
    if effect is None:
        return f"declared {number(float(found.rig.start[found.rig.names.index(name)]), 5)}"
    return effect.parameters[name].meaning if name in effect.parameters else effect.spoken


def units(found: Discovery, named: Named) -> dict[str, str]:
    """Units of the parameters of a cause, as they are shown."""
    return {name: pretty(unit) for name, unit in plain_units(found, named).items()}


def plain_units(found: Discovery, named: Named) -> dict[str, str]:
    """Units of the parameters of a cause, such as N/m**3."""
    if named.name not in found.dictionary:
        return {n: found.twin.base.parameters[n].unit for n in named.parameters}
    if named.name == compiled_laws.DELAY:
        return {compiled_laws.DEAD_TIME: "s"}
    effect = found.dictionary[named.name]
    if effect.where == "element":
        force, displacement, _ = latent_force.element_units(found.written_rig, named.on)
        known = {"F": force or "1", "D": displacement or "1", "s": "s" if displacement else "1"}
    else:
        known = dict.fromkeys("SU", latent_force.channel_unit(found, named.on, effect.where))
    made = {n: combined(effect.parameters[n].unit, known) for n in named.parameters}
    if effect.is_inertia:  # kg, rather than N s²/m
        made = {n: describe(dimension_of(unit)) for n, unit in made.items()}
    return made
