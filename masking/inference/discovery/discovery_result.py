"""Result of a discovery: verdict, causes with their probabilities, and simulation errors before and after."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

from masking.compile.numerics.arrays import Array
from masking.display import fragments, symbols
from masking.display.json_text import Result, plain
from masking.inference.discovery.answer_by_validation import Withheld
from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.decision_rules import DecisionRules
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.explanation import Explanation
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.latent_force import Explained, Localisation, ResidualWhiteness, localise
from masking.inference.discovery.next_experiment import NextExperiment
from masking.inference.discovery.unnamed_law import UnnamedLaw
from masking.inference.discovery.verdict import Key, at_noise_floor, is_closed
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.unit_check import FAR, UnitDoubt
from masking.inference.estimation.whiteness import Whiteness, whiteness
from masking.model.effects import GAINS_AND_ZEROS, Effect

GAINS = {name for name in GAINS_AND_ZEROS if name.endswith("gain")}


class Estimate(NamedTuple):
    """A parameter with its standard deviation."""

    value: float
    std: float


class Alternative(NamedTuple):
    """A cause that may be instead of another, with its probability."""

    name: str
    on: str
    probability: float


class Grade(NamedTuple):
    """What speaks for a cause."""

    name: str
    on: str
    share: float  # of the error without it on unseen data, of the worst sensor, which it takes away
    without: float  # that error, with the other causes fitted anew
    odds: float | None  # against the likeliest hypothesis of the record without a cause of its class there, if any
    rival: tuple[Key, ...]  # causes of that


class Errors(NamedTuple):
    """Relative error of each sensor, by name, before and after."""

    before: dict[str, float]
    after: dict[str, float]


@dataclass(frozen=True)
class Named(Result):
    """A cause with its parameters as value and standard deviation, its probability, and what it may be instead."""

    name: str
    on: str
    parameters: dict[str, Estimate]
    probability: float
    alternatives: tuple[Alternative, ...] = ()

    @property
    def deviates(self) -> float:
        """Standard deviations by which the surest of its parameters differs from 0."""
        return max((abs(value) / std for value, std in self.parameters.values() if std > 0.0), default=0.0)


@dataclass(frozen=True)
class SimulationError(Result):
    """Relative error of each sensor, by name: before and after, in both records; and the noise floor.

    `adjusted` is that of the model with its parameters adjusted alone, in the validation record; `fitted_alone` that of
    the causes fitted to the estimation record alone, where they are fitted to both.
    """

    estimation: Errors
    validation: Errors
    noise_floor: dict[str, float]
    validation_noise_floor: dict[str, float]
    adjusted: dict[str, float]
    fitted_alone: dict[str, float] | None = None
    json_names = ("estimation", "validation", "fitted_alone", "noise_floor", "validation_noise_floor")

    @property
    def over_noise(self) -> float:
        """Largest error of a sensor in the validation record, over its noise floor there."""
        return max(error / max(self.validation_noise_floor[n], 1e-300) for n, error in self.validation.after.items())

    def is_noise(self, readings: int, rules: DecisionRules) -> bool:
        """Whether each sensor is at the noise floor in the validation record, with its number of readings."""
        return at_noise_floor(self.validation[1].values(), self.validation_noise_floor.values(), readings, rules)


@dataclass(frozen=True, repr=False, kw_only=True)
class Discovery(Explained):
    """A discovery."""

    effects: tuple[Named, ...]  # causes, in the order in which they were found
    simulation_error: SimulationError  # before and after
    unexplained_fraction: float  # part of the excess cost that is left in the estimation record
    rivals: tuple[Explanation, ...]  # the explanations that the one was chosen from, itself first
    weights: tuple[float, ...]  # probability of each of them
    validation: EstimationProblem  # the estimation problem of the validation record
    # before and after: the model as declared and with the causes, on the validation record
    before: Hypothesis
    after: Hypothesis
    adjusted: Hypothesis  # the model without causes, its parameters adjusted by the priors, on the validation record
    next_experiment: NextExperiment | None = None  # that separates the likeliest two, if the record does not
    # relative error of each sensor with adjusted parameters alone and inputs in straight lines between samples; None
    # unless that is far less than what was found leaves
    first_order_hold: dict[str, float] | None = None
    exchanged: bool = False  # whether the record to validate by was searched, since it alone shows the effect
    law: UnnamedLaw | None = None  # the law without a name, where no name explains the record
    none_of_these: float = 0.0  # probability that none of the names is right
    withheld: Withheld | None = None  # what was found before, but is worse on unseen data than as declared
    grades: tuple[Grade, ...] = ()  # of each effect of the explanation
    unit: UnitDoubt | None = None  # that of a channel which is probably another; the record is converted then
    text: Callable[[Discovery], str] = repr  # makes what `print` shows, which the verb discover gives it

    def __str__(self) -> str:
        return self.text(self)

    def __repr__(self) -> str:
        causes = ", ".join(f"{one.name} in {one.on}" if one.on else one.name for one in self.effects)
        before, after = self.simulation_error.validation
        if self.law is not None:
            causes, after = f"a law without a name in {self.law.place}", self.law.error[1]
        errors = ", ".join(f"{name} {before[name]:.2g} to {after[name]:.2g}" for name in after)
        return f"<Discovery: {self.verdict}{f', {causes}' if causes else ''}; error on unseen data: {errors}>"

    def _repr_html_(self) -> str:
        causes = [
            (one.name.replace("_", " "), one.on, symbols.markup(name), *(f"{x:.4g}" for x in (*pair, one.probability)))
            for one in (*self.effects, *([self.unnamed] if self.unnamed else []))
            for name, pair in one.parameters.items()
        ]
        three = (*self.simulation_error.validation, self.simulation_error.validation_noise_floor)
        errors = [(name, *(f"{each[name]:.2g}" for each in three)) for name in three[1]]
        head = ("cause", "in", "parameter", "value", "standard deviation", "probability")
        parts = [
            fragments.table(head, causes, numbers=(3, 4, 5)),
            fragments.table(("error on unseen data", "before", "after", "noise floor"), errors, numbers=(1, 2, 3)),
        ]
        return fragments.card(f"Discovery in {self.twin.declaration.name}", f"verdict: {self.verdict}", *parts)

    @property
    def least_sure(self) -> Named:
        """Cause of least probability, the last of several; there are causes."""
        return min(reversed(self.effects), key=lambda cause: cause.probability)

    @property
    def validation_record(self) -> Data:
        """Validation record."""
        return self.validation.record

    @property
    def imperfections(self) -> list[Named]:
        """Small errors of sensors and actuators that were adjusted with the parameters of the model."""
        rig = self.written_rig
        first, known = len(rig.names), rig.imperfect(self.written.hypothesis.theta)
        pairs = zip(known, map(float, self.written.hypothesis.deviations[first:]), strict=False)
        return [Named(one.effect, one.at, {one.names[0]: Estimate(one.estimated[0], std)}, 1.0) for one, std in pairs]

    @property
    def written(self) -> Explanation:
        """Explanation that is written into the model: the law without a name where there is one."""
        return self.explanation if self.law is None else self.law.explanation

    @property
    def unseen(self) -> Hypothesis:
        """Model as written, on the validation record: with the law without a name where there is one."""
        return self.after if self.law is None else self.law.validated

    @cached_property
    def as_written(self) -> Discovery:
        """Discovery with what is written as its explanation: the law without a name where there is one."""
        if (law := self.law) is None:
            return self
        explanation = replace(law.explanation, hypothesis=law.simulated)
        return replace(self, problem=law.known, explanation=explanation, validation=law.problem, after=law.validated)

    @property
    def written_rig(self) -> AugmentedModel:
        """Rig that this is for: with a further place where the law without a name sits in one."""
        return self.rig if self.law is None else self.law.rig

    @property
    def dictionary(self) -> Mapping[str, Effect]:
        """Effects that are known here, the law without a name among them."""
        known = self.twin.dictionary
        return known if self.law is None else {**known, self.law.instance.effect: self.law.instance.entry}

    @property
    def unnamed(self) -> Named | None:
        """Law without a name as a cause, with its parameters and their standard deviations."""
        if self.law is None:
            return None
        one = self.law.instance
        every = self.written.hypothesis.deviations
        stds = every[len(every) - len(one.free) :]
        values = map(Estimate, one.estimated, map(float, stds))
        return Named(one.effect, one.at, dict(zip(one.names, values, strict=True)), 1.0)

    @cached_property
    def whiteness(self) -> dict[str, Whiteness]:
        """Whiteness of the validation residual of each sensor."""
        return whiteness_of(self.validation, self.after.residuals)

    @cached_property
    def localisation(self) -> Localisation:
        """Where the model error is: its coordinates, places, displacements, rates, times and sides."""
        before = whiteness_of(self.validation, self.adjusted.residuals)
        after = whiteness_of(self.validation, self.unseen.residuals)
        causes = self.effects or self.law
        pairs = {n: ResidualWhiteness(before[n], after[n] if causes else None) for n in self.twin.sensors}
        return localise(self.as_written, pairs, [place.name for place in self.rig.places])

    @property
    def is_at_noise_floor(self) -> bool:
        """Whether the validation residual of each sensor is at the noise floor."""
        return self.simulation_error.is_noise(len(self.validation_record), self.problem.rules)

    @property
    def far_off(self) -> tuple[tuple[Key, float], ...]:
        """Gains (effect, place) and parameters (name, '') that are several times what is declared, and how many."""
        prior, fitted, most = self.problem.prior, self.explanation.hypothesis, self.problem.rules.chance_deviations
        pairs = [((one.effect, one.at), 1.0 + one.values[0]) for one in fitted.instances if one.effect in GAINS]
        for name, value, mean, deviation in zip(
            self.rig.names, fitted.theta, prior.mean, prior.deviation, strict=False
        ):
            if mean and abs(value - mean) > most * deviation:
                pairs.append(((name, ""), float(value / mean)))
        return tuple((key, times) for key, times in pairs if not 1.0 / FAR < times < FAR)

    @property
    def shooting_interval(self) -> float | None:
        """Shooting interval of the search in s; None where the whole record is one."""
        return self.problem.interval / self.record.rate if self.problem.interval else None

    @property
    def is_hidden(self) -> bool:
        """Whether something is missing that shows in the validation record alone."""
        after, floor = self.simulation_error.estimation[1].values(), self.simulation_error.noise_floor.values()
        is_seen = not at_noise_floor(after, floor, len(self.record), self.problem.rules)
        is_missing = self.verdict == "unknown" and self.explanation.kind == "none"
        return is_missing and not is_seen and not self.is_at_noise_floor

    @cached_property
    def closed(self) -> bool:
        """Whether the explanation is complete: the validation residual at the noise floor, and white in both.

        Where the motion begins so often anew that its initial states take much of the noise, its size alone counts.
        """
        fitted = self.explanation.hypothesis
        seen = [*self.whiteness.values(), *whiteness_of(self.problem, fitted.residuals).values()]
        states = max(fitted.start.size, self.after.start.size)
        estimated, white = states / self.validation_record.readings.size, (one.white for one in seen)
        return is_closed(at_noise=self.is_at_noise_floor, white=white, estimated=estimated, rules=self.problem.rules)

    @property
    def notes(self) -> tuple[str, ...]:
        """How its records were read, and what in them is doubtful."""
        return tuple(dict.fromkeys((*self.problem.record.notes, *self.validation.record.notes)))

    def as_dict(self) -> dict[str, Any]:
        """Discovery as JSON can hold it."""
        small = [{"name": one.name, "on": one.on, "parameters": one.parameters} for one in self.imperfections]
        names = (
            *("verdict", "closed", "effects", "simulation_error", "unexplained_fraction", "next_experiment"),
            *("grades", "first_order_hold", "exchanged", "law", "none_of_these", "unit", "withheld"),
            "shooting_interval",
        )
        every = {name: getattr(self, name) for name in names} | {"notes": self.notes, "trace": self.problem.trace}
        return dict(plain({**every, "imperfections": small, "search_ended_early": self.problem.work.is_cut}))


def whiteness_of(problem: EstimationProblem, residuals: Array) -> dict[str, Whiteness]:
    """How white residuals (m, sensors) of a record are, by sensor."""
    every = zip(problem.rig.twin.sensors, residuals.T, problem.record.readings.T, problem.sigma, strict=True)
    return {name: whiteness(left, read, float(sigma), problem.record.rate) for name, left, read, sigma in every}
