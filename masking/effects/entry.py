"""What an entry of the dictionary of physical effects holds.

Expressions are in the language of declarations, over the effect's own parameters and states and

* in an element: `d`, its displacement, `d_rate`, the rate of that, and the time `t`; they give the force f. That of an
  inertia is in proportion to `d_acc`, the acceleration of the displacement, and to nothing else of the motion;
* in a sensor: `s`, the value that it should give, and for noise `xi`, a sample of the standard normal distribution;
* in an actuator: `u`, the commanded value.

Units are written with the units of the place: `F` of force and `D` of displacement of an element, `S` of a sensor, `U`
of an actuator, and `s` of time; `prior` and `nominal` are in coherent SI units for a rig the size of a hand.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from masking.declaration.expression import Expression

Where = Literal["element", "sensor", "actuator", "loop"]
Bounds = tuple[float | None, float | None]


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """A parameter of an effect.

    `value` is taken where none is given, and None where one must be; `prior` is the range in which values are expected,
    `nominal` a usual one, None where nobody knows; `bounds` are the least and the largest that make sense. `tried` are
    values that a discovery begins from, of an own effect; see `masking.declaration.schema.OwnParameter`.
    """

    unit: str
    meaning: str
    prior: tuple[float, float] | None
    nominal: float | None
    value: float | None = None
    bounds: Bounds = (None, None)
    tried: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class EffectState:
    """An internal state of an effect, with the expression of its rate.

    A simulation begins with 0. Where a record may begin with anything else, `size` is how far from 0 that may be, as an
    expression of the parameters; '' where the state forgets where it began.
    """

    rate: str
    unit: str
    meaning: str
    size: str = ""


@dataclass(frozen=True, slots=True)
class Effect:
    """A physical effect: the expression of what it does, where it may sit, what causes it and what helps.

    `factors` are the parameters of an own effect that are factors of what it does.
    """

    name: str
    meaning: str
    where: Where
    expression: str
    parameters: Mapping[str, EffectParameter]
    cause: str
    remedy: str
    source: str
    states: Mapping[str, EffectState] = field(default_factory=dict)
    factors: tuple[str, ...] = ()

    @property
    def is_inertia(self) -> bool:
        """Tell whether its force follows the acceleration of its displacement."""
        return "d_acc" in self.expression

    @property
    def follows(self) -> frozenset[str]:
        """Return what it follows of an element: some of displacement `d`, rate `d_rate` and acceleration `d_acc`."""
        texts = filter(None, [self.expression, *(state.rate for state in self.states.values())])
        used = {name for text in texts for name in Expression(text).names}
        return frozenset(used & {"d", "d_rate", "d_acc"})

    def structure(self) -> list[object]:
        """Return all that compiled functions of it depend on."""
        rates = {name: state.rate for name, state in self.states.items()}
        return [self.name, self.where, self.expression, [*self.parameters], rates]


POSITIVE: Bounds = (1e-12, None)
NOT_NEGATIVE: Bounds = (0.0, None)
