"""An entry of the dictionary: everything that the package knows about a physical effect, and nothing elsewhere.

Expressions are in the language of declarations, over the effect's own parameters and states and

* in an element: `d`, its displacement, `d_rate`, the rate of that, and the time `t`; they give the force f. That of an
  inertia is in proportion to `d_acc`, the acceleration of the displacement, and to no other part of the motion;
* in a sensor: `s`, the true value, and for noise `xi`, a sample of the standard normal distribution;
* in an actuator: `u`, the command.

Units are written with the units of the place: `F` of force and `D` of displacement of an element, `S` of a sensor, `U`
of an actuator, and `s` of time; `prior` and `nominal` are in coherent SI units for a rig the size of a hand.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, Literal

from masking.model.declaration.expression import Expression

Attaches = Literal["beside", "in_series", "instead"]
Directed = Literal["", "coordinate", "command", "gain", "load"]
Where = Literal["element", "sensor", "actuator", "loop"]
Bounds = tuple[float | None, float | None]

POSITIVE: Final[Bounds] = (1e-12, None)
NOT_NEGATIVE: Final[Bounds] = (0.0, None)

# Effects of one family share a row of the error budget, in this order.
SATURATION: Final = "saturation"
FAMILIES: Final = (
    *("springs", "damping", "friction", "hysteresis", "mass", "resonance", "backlash", "end stop", "overflow"),
    *("periodic force", "actuator gains", "actuator dynamics", SATURATION, "sensor errors", "quantisation"),
    *("noise", "delay"),
)


@dataclass(frozen=True)
class Span:
    """The range of a place, sensor or actuator in a record, from which fits of its effects start."""

    # low, high: least and largest value
    low: float
    high: float
    size: float  # largest magnitude
    rate: float  # root mean square of its rate
    time: float = 1.0  # of the motion of the rig in s: displacement over rate, both in rms
    tones: tuple[float, ...] = ()  # frequencies of the latent forces in Hz, the strongest first
    pitches: tuple[float, ...] = ()  # displacements over which the latent forces repeat, the strongest first
    # values of a stiffness in the place of the element's own force, where it declares one
    stiffnesses: tuple[float, ...] = ()


Start = Mapping[str, float]
Starts = Callable[[Span], list[Start]]


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """A parameter of an effect."""

    unit: str  # template in the units of the place, such as `F/D`
    meaning: str  # in a few words
    prior: tuple[float, float] | None = None  # range in which values are expected; None if nobody knows
    nominal: float | None = None  # a usual value; None if nobody knows
    value: float | None = None  # taken if none is given; None if one must be given
    bounds: Bounds = (None, None)  # least and largest value that make sense
    # values from which fits start: parts of the largest displacement if the unit is D, of the largest reading or
    # command if it is S or U, of the rms rate if it is D/s, of the time of the motion if it is s, and plain values
    # otherwise
    tried: tuple[float, ...] = ()
    # standard deviation among instruments: of a sensor or actuator at its largest reading or command, as a part of
    # that; None where any value is as likely
    spread: float | None = None

    def deviation(self, largest: float) -> float:
        """Standard deviation among instruments whose largest reading or command is given; infinite where none is."""
        if self.spread is None or not largest:
            return math.inf
        return self.spread * Expression(self.unit).evaluate({"S": largest, "U": largest})

    def starts(self, span: Span) -> list[float]:
        """Values from which fits start, within the bounds, in coherent units."""
        sizes = {"D": span.size, "S": span.size, "U": span.size, "D/s": span.rate, "s": span.time}
        size = sizes.get(self.unit.replace(" ", ""), 1.0)
        low, high = self.bounds
        least, most = -math.inf if low is None else low, math.inf if high is None else high
        return [min(max(part * size, least), most) for part in self.tried]


@dataclass(frozen=True, slots=True)
class EffectState:
    """An internal state of an effect: its rate, and a unit in those of the place.

    A record may begin up to `size` from 0, an expression of the parameters; '' if the state forgets its beginning. A
    simulation begins at 0.
    """

    rate: str
    unit: str
    meaning: str
    size: str = ""


@dataclass(frozen=True, slots=True)
class Trial:
    """One way in which discovery fits an effect; each is a candidate of its own."""

    # values of other parameters than the factors, from which fits start, for the range of a place
    starts: Starts = lambda span: [{}]
    free: tuple[str, ...] = ()  # parameters that are estimated beside the factors; the others are held at the start
    factors: tuple[str, ...] = ()  # factors that are estimated; all of the effect's if none are named
    sticks: bool = False  # whether it is fitted with the parameters that follow the step of integration


@dataclass(frozen=True)
class Effect:
    """A physical effect."""

    name: str  # in declarations and reports
    meaning: str  # one sentence
    # of the force of an element, or of the value of a sensor or actuator; '' if it makes commands late. Of an effect in
    # series, of the displacement that it takes up.
    expression: str
    parameters: Mapping[str, EffectParameter]  # by their names
    cause: str = ""  # usual causes on a rig
    remedy: str = ""  # what helps
    source: str = ""  # of the law
    states: Mapping[str, EffectState] = field(default_factory=dict)  # internal states by their names
    where: Where = "element"  # the kind of place in which it sits
    family: str = ""  # one of `FAMILIES`; '' gives it a row of its own in the error budget
    label: str = ""  # its name in a sentence; by default the name with spaces
    # the ways in which discovery fits it; by default one, with every parameter that has values to try
    trials: tuple[Trial, ...] = ()
    is_searched: bool = True  # whether discovery tries it at each place by these trials
    joins: bool = False  # whether it is also tried between coordinates that no element joins
    nested: tuple[str, ...] = ()  # simpler effects that are special cases of it, or nearly so
    absorbed_by: str = ""  # the parameter of a model that would do the same; '' if none would
    is_linear: bool = False  # whether a system with it is linear if it was so without it
    is_carried: bool = False  # whether a coordinate carries it: it has no meaning between two
    # what it follows at a directed place, and it is tried at such places alone; '' for any other effect
    directed: Directed = ""
    # whether it is a flow of a level, and no force of a motion: tried at places without a rate alone
    is_flow: bool = False
    is_sum: bool = False  # whether it is there as soon as any factor differs from 0, not only if the first does
    scaled: tuple[str, ...] = ()  # parameters that scale its force together, if no parameter does so alone
    grows_with: str = ""  # the time constant to which its effect is in proportion, as long as that is short
    quantum: str = ""  # the parameter that is the step of a quantiser; '' if it is none
    # standard deviation of the white noise that it adds to a sensor, as an expression of its parameters
    deviation: str = ""
    calibrated: tuple[str, ...] = ()  # parameters that a calibration fits where a plant file declares the effect
    # beside the force of an element, in series with it, or instead of it; the latter two where the element declares a
    # force of its own
    attaches: Attaches = "beside"
    takes_rate: str = ""  # of an effect in series, the rate of what it takes up
    # the law without states where a parameter is 0, by this parameter
    at_zero: Mapping[str, str] = field(default_factory=dict)
    # parameters that are no physics, but make a state as stiff as a step of integration bears: expressions over `step`,
    # in s, and `mobility`, the acceleration by a unit of force, or the rate of a level by a flow
    by_step: Mapping[str, str] = field(default_factory=dict)
    # least values of parameters that a step of integration bears, as such expressions of the parameters, too
    least: Mapping[str, str] = field(default_factory=dict)
    # an expression of its parameters, of the duration of a record in s, and of the travel of its place in it, that is
    # positive, or else it is not what its name says; '' if any are
    positive: str = ""

    @property
    def spoken(self) -> str:
        """Its name in a sentence."""
        return self.label or self.name.replace("_", " ")

    @property
    def factors(self) -> tuple[str, ...]:
        """Parameters that scale its force or value, each in a term of its own: a record gives them at once.

        They are those of the last trial, or else have neither a value nor any from which a fit could start.
        """
        if self.trials and self.trials[-1].factors:
            return self.trials[-1].factors
        tried = {name for trial in self.trials for name in trial.free}
        found = (n for n, p in self.parameters.items() if p.value is None and not p.tried and n not in tried)
        return tuple(found) if self.is_searched else ()

    @property
    def is_inertia(self) -> bool:
        """Whether its force follows the acceleration of its displacement."""
        return "d_acc" in self.expression

    @property
    def is_known_to_controller(self) -> bool:
        """Whether a controller is designed with it: noise of sensors, and what sits in the loop."""
        return bool(self.deviation) or self.where == "loop"

    @cached_property
    def is_held_by_controller(self) -> bool:
        """Whether a controller is designed with it where it is named: a force of an element, or a foreseen reading.

        A reading is foreseen that follows from what is measured and from the time: its states move steadily.
        """
        if self.where != "sensor" or not self.expression or self.deviation or self.quantum:
            return self.where == "element"
        return all(Expression(state.rate).names <= self.parameters.keys() for state in self.states.values())

    @cached_property
    def follows(self) -> frozenset[str]:
        """Motion that it follows: some of displacement `d`, rate `d_rate` and acceleration `d_acc`."""
        texts = filter(None, [self.expression, self.takes_rate, *(state.rate for state in self.states.values())])
        used = {name for text in texts for name in Expression(text).names}
        return frozenset(used & {"d", "d_rate", "d_acc"})

    def indices(self, names: tuple[str, ...]) -> tuple[int, ...]:
        """Positions of some of its parameters."""
        every = list(self.parameters)
        return tuple(every.index(name) for name in names)

    @property
    def ways(self) -> tuple[Trial, ...]:
        """Ways in which discovery fits it."""
        tried = tuple(name for name, parameter in self.parameters.items() if parameter.tried)
        return self.trials or (Trial(self._combinations, tried, sticks=bool(self.by_step)),)

    def reduced(self, given: Mapping[str, object]) -> Effect:
        """Effect without states where a parameter, given or by default, is 0 that they need."""
        for name, expression in self.at_zero.items():
            if given.get(name, self.parameters[name].value) == 0.0:
                left = {key: parameter for key, parameter in self.parameters.items() if key not in self.by_step}
                return replace(self, expression=expression, parameters=left, states={}, at_zero={}, by_step={})
        return self

    def _combinations(self, span: Span) -> list[Start]:
        tried = {name: parameter.starts(span) for name, parameter in self.parameters.items() if parameter.tried}
        return [dict(zip(tried, values, strict=True)) for values in itertools.product(*tried.values())]

    def structure(self) -> list[object]:
        """Everything that compiled functions of it depend on."""
        rates = {name: state.rate for name, state in self.states.items()}
        return [self.name, self.where, self.expression, self.takes_rate, self.attaches, [*self.parameters], rates]
