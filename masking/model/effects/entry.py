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
    *("springs", "damping", "friction", "hysteresis", "mass", "backlash", "end stop", "overflow", "periodic force"),
    *("actuator gains", "actuator dynamics", SATURATION, "sensor errors", "quantisation", "noise", "delay"),
)


@dataclass(frozen=True)
class Span:
    """The range of a place, sensor or actuator in a record, from which fits of its effects start.

    Args:
        low, high: least and largest value.
        size: largest magnitude.
        rate: root mean square of its rate.
        time: of the motion of the rig in s: displacement over rate, both in rms.
        tones: frequencies of the latent forces in Hz, the strongest first.
        pitches: displacements over which the latent forces repeat, the strongest first.
        stiffnesses: values of a stiffness in the place of the element's own force, where it declares one.
    """

    low: float
    high: float
    size: float
    rate: float
    time: float = 1.0
    tones: tuple[float, ...] = ()
    pitches: tuple[float, ...] = ()
    stiffnesses: tuple[float, ...] = ()


Start = Mapping[str, float]
Starts = Callable[[Span], list[Start]]


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """A parameter of an effect.

    Args:
        unit: template in the units of the place, such as `F/D`.
        meaning: in a few words.
        prior: range in which values are expected; None if nobody knows.
        nominal: a usual value; None if nobody knows.
        value: taken if none is given; None if one must be given.
        bounds: least and largest value that make sense.
        tried: values from which fits start: parts of the largest displacement if the unit is D, of the largest reading
            or command if it is S or U, of the rms rate if it is D/s, of the time of the motion if it is s, and plain
            values otherwise.
    """

    unit: str
    meaning: str
    prior: tuple[float, float] | None = None
    nominal: float | None = None
    value: float | None = None
    bounds: Bounds = (None, None)
    tried: tuple[float, ...] = ()

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
    """One way in which discovery fits an effect; each is a candidate of its own.

    Args:
        starts: values of other parameters than the factors, from which fits start, for the range of a place.
        free: parameters that are estimated beside the factors; the others are held at the start.
        factors: factors that are estimated; all of the effect's if none are named.
        sticks: whether it is fitted with the parameters that follow the step of integration.
    """

    starts: Starts = lambda span: [{}]
    free: tuple[str, ...] = ()
    factors: tuple[str, ...] = ()
    sticks: bool = False


@dataclass(frozen=True, slots=True)
class Effect:
    """A physical effect.

    Args:
        name: in declarations and reports.
        meaning: one sentence.
        expression: of the force of an element, or of the value of a sensor or actuator; '' if it makes commands late.
            Of an effect in series, of the displacement that it takes up.
        parameters: by their names.
        cause: usual causes on a rig.
        remedy: what helps.
        source: of the law.
        states: internal states by their names.
        where: the kind of place in which it sits.
        family: one of `FAMILIES`; '' gives it a row of its own in the error budget.
        label: its name in a sentence; by default the name with spaces.
        trials: the ways in which discovery fits it; by default one, with every parameter that has values to try.
        is_searched: whether discovery tries it at each place by these trials.
        joins: whether it is also tried between coordinates that no element joins.
        nested: simpler effects that are special cases of it, or nearly so.
        absorbed_by: the parameter of a model that would do the same; '' if none would.
        is_linear: whether a system with it is linear if it was so without it.
        directed: what it follows at a directed place, and it is tried at such places alone; '' for any other effect.
        is_flow: whether it is a flow of a level, and no force of a motion: tried at places without a rate alone.
        is_sum: whether it is there as soon as any factor differs from 0, not only if the first does.
        scaled: parameters that scale its force together, if no parameter does so alone.
        grows_with: the time constant to which its effect is in proportion, as long as that is short.
        quantum: the parameter that is the step of a quantiser; '' if it is none.
        deviation: standard deviation of the white noise that it adds to a sensor, as an expression of its parameters.
        calibrated: parameters that a calibration fits where a plant file declares the effect.
        attaches: beside the force of an element, in series with it, or instead of it; the latter two where the element
            declares a force of its own.
        takes_rate: of an effect in series, the rate of what it takes up.
        at_zero: the law without states where a parameter is 0, by this parameter.
        by_step: parameters that are no physics, but make a state as stiff as a step of integration bears: expressions
            over `step`, in s, and `mobility`, the acceleration by a unit of force, or the rate of a level by a flow.
        least: least values of parameters that a step of integration bears, as such expressions of the parameters, too.
        positive: an expression of its parameters that is positive, or else it is not what its name says; '' if any are.
    """

    name: str
    meaning: str
    expression: str
    parameters: Mapping[str, EffectParameter]
    cause: str = ""
    remedy: str = ""
    source: str = ""
    states: Mapping[str, EffectState] = field(default_factory=dict)
    where: Where = "element"
    family: str = ""
    label: str = ""
    trials: tuple[Trial, ...] = ()
    is_searched: bool = True
    joins: bool = False
    nested: tuple[str, ...] = ()
    absorbed_by: str = ""
    is_linear: bool = False
    directed: Directed = ""
    is_flow: bool = False
    is_sum: bool = False
    scaled: tuple[str, ...] = ()
    grows_with: str = ""
    quantum: str = ""
    deviation: str = ""
    calibrated: tuple[str, ...] = ()
    attaches: Attaches = "beside"
    takes_rate: str = ""
    at_zero: Mapping[str, str] = field(default_factory=dict)
    by_step: Mapping[str, str] = field(default_factory=dict)
    least: Mapping[str, str] = field(default_factory=dict)
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

    @property
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
        """All combinations of the values that are tried."""
        tried = {name: parameter.starts(span) for name, parameter in self.parameters.items() if parameter.tried}
        return [dict(zip(tried, values, strict=True)) for values in itertools.product(*tried.values())]

    def structure(self) -> list[object]:
        """Everything that compiled functions of it depend on."""
        rates = {name: state.rate for name, state in self.states.items()}
        return [self.name, self.where, self.expression, self.takes_rate, self.attaches, [*self.parameters], rates]
