"""What a plant file may say of its sensors and actuators, and of what the rig withstands."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import model_validator

from masking.model.declaration.fields import Block, Formula, Name, Number, Positive, TextField
from masking.model.declaration.shorthand import Short

_NUMBER = Short("value", (int, float))
_TEXT = Short("text", (str,))
_KIND = Short("kind", (str,))


class Quantity(Block):
    """A number with its unit."""

    value: Number
    unit: TextField = "1"


class Turn(Block):
    """The size of a turn, after which a reading starts again: a number with its unit, also as text, `360 deg`."""

    value: Positive
    unit: TextField

    @model_validator(mode="before")
    @classmethod
    def _of_text(cls, given: object) -> object:
        if not isinstance(given, dict) or given.keys() != {"text"}:
            return given
        number, _, unit = str(given["text"]).strip().partition(" ")
        try:
            return {"value": float(number), "unit": unit.strip()}
        except ValueError:
            return {"value": number, "unit": unit.strip()}


class Limit(Block):
    """The largest allowed magnitude."""

    max: Positive
    unit: TextField = "1"


class InputLimit(Limit):
    """The largest magnitude of a command, and how fast it may change at most, in its unit per s.

    `expiry` is its value where a watchdog expires, in its unit.
    """

    rate: Positive | None = None
    expiry: Number = 0.0


class Sensor(Block):
    """What a sensor measures, and how many of its own units one unit of that gives.

    `range` is what it can read while it is sound, and `jump` the largest change between two samples, in its unit. A
    reading that starts again after each turn `wraps`.
    """

    measures: Formula
    unit: TextField = "1"
    gain: Annotated[Quantity, _NUMBER] = Quantity(value=1.0)
    meaning: TextField = ""
    range: tuple[Number, Number] | None = None
    jump: Positive | None = None
    wraps: Annotated[Turn, _TEXT] | None = None


class Actuator(Block):
    """A channel that a controller writes to."""

    meaning: TextField = ""
    unit: TextField = "1"


class PowerLimit(Block):
    """The largest mean power of an actuator: `heating` is the power per squared command, `time` the mean's, in s."""

    value: Positive
    unit: TextField = "1"
    heating: Annotated[Quantity, _NUMBER] | None = None
    time: Positive = 10.0


class ControlledStop(Block):
    """What is commanded between the end of a run and zero, for `time` s at most: nothing, the last, or damping."""

    kind: Literal["zero", "hold", "brake"] = "zero"
    time: Positive = 1.0


class Limits(Block):
    """What the rig withstands: actuators, coordinates (or expressions of them), their rates, power of each actuator.

    `missed` is the largest share of the samples of a second that a run may miss or answer late; `stop` says how a run
    comes to rest.
    """

    inputs: dict[Name, InputLimit] = {}
    coordinates: dict[Formula, Limit] = {}
    velocities: dict[Formula, Limit] = {}
    power: PowerLimit | None = None
    missed: Positive | None = None
    stop: Annotated[ControlledStop, _KIND] = ControlledStop()
