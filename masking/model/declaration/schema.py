"""What a model, a plant, an experiment and a dictionary file may hold.

Every block is frozen and refuses unknown keys. A value that may be written shortly (`w3: 0.53` for `w3: {value: 0.53}`)
is brought to its full form on reading, so code meets only one form.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field, PrivateAttr

from masking.errors import Place
from masking.model.declaration.event_declaration import Event
from masking.model.declaration.expression import Expression
from masking.model.declaration.fields import (
    Block,
    ControllerRate,
    Formula,
    Name,
    Natural,
    NotNegative,
    Number,
    Positive,
    Rate,
    TextField,
    Truth,
    Value,
    refuse,
)
from masking.model.declaration.input_source import InputSource
from masking.model.declaration.instrument_declaration import Actuator, Limits, Sensor
from masking.model.declaration.shape_declaration import Shape
from masking.model.declaration.shorthand import Short
from masking.model.declaration.strict_yaml import Places

_MEANING = Short("meaning", (str,))
_VALUE = Short("value", (int, float, str))
_EXPRESSION = Short("expression", (int, float, str))
_KIND = Short("kind", (str,))
_MEASURES = Short("measures", (int, float, str))


class _Several(Short):
    """Reads one text as a list of one."""

    def widen(self, value: object) -> object:
        return [value] if isinstance(value, str) else value


class _Switch(Short):
    """Reads `false` or `true` as a switch, and a mapping as parameters."""

    def widen(self, value: object) -> object:
        if isinstance(value, bool):
            return {"enabled": value}
        if isinstance(value, Mapping) and not value.keys() <= {"enabled", "parameters"}:
            return {"parameters": value}
        return value


_SEVERAL = _Several("", (str,))
_SWITCH = _Switch("", (bool,))


class Coordinate(Block):
    """A coordinate, its meaning and unit, and where it starts; `initial` None is 0, and an experiment says where."""

    meaning: TextField = ""
    unit: TextField = "1"
    initial: Number | None = None
    initial_velocity: Number = 0.0


class State(Block):
    """An internal state: a quantity z with an equation `z': ...` of first order, and where it starts.

    A record may begin about `size`, an expression of parameters or a number in `unit`, away from `initial`; by default
    anywhere.
    """

    meaning: TextField = ""
    unit: TextField = "1"
    initial: Number = 0.0
    size: Formula | None = None


class Element(Block):
    """A place where a force may sit, such as a spring.

    `displacement` is how far it is stretched and `rate` how fast, by default the time derivative of a displacement of
    coordinates. A force f in it, in `unit`, adds acts[c] * f to the right-hand side of the equation of each coordinate
    or internal state c, and to each output c. A positive force resists a positive displacement where `acts` says so.
    `force` is its own, over its displacement `d`, its rate `d_rate` and parameters: it acts in the same way, the
    equations do not hold it again, and effects may stand in series with it or in its place.
    """

    displacement: Formula | None = None
    rate: Formula | None = None
    force: Formula | None = None
    unit: TextField = "1"
    acts: dict[Name, Formula] = {}
    meaning: TextField = ""


class Input(Block):
    """A quantity that acts on the model from outside."""

    meaning: TextField = ""
    unit: TextField = "1"


class Parameter(Block):
    """A number with a name, or an expression over other parameters; `bounds` are the least and the largest value.

    `std` is the standard deviation of the value, in its unit; 0 where it is known, so that it is not fitted.
    """

    value: Value
    unit: TextField = "1"
    meaning: TextField = ""
    bounds: tuple[Number | None, Number | None] = (None, None)
    std: NotNegative | None = None


class Output(Block):
    """A quantity that can be computed from the state, its rate and the inputs."""

    expression: Formula
    unit: TextField = "1"
    meaning: TextField = ""


class Scale(Block):
    """What one unit of a dimensionless quantity is, such as time or length; may be an expression over parameters."""

    value: Value
    unit: TextField


class EffectUse(Block):
    """A physical effect that a plant has: which, where (an element, sensor or actuator, or several) and how strong.

    Each of its parameters is a number, in the unit of the dictionary of effects, or an expression over the
    parameters of the plant's model. A model declares those in its elements in the same way.
    """

    effect: TextField
    at: Annotated[tuple[TextField, ...], _SEVERAL] = ()
    parameters: dict[Name, Value] = {}
    enabled: Truth = True


class OwnParameter(Block):
    """A parameter of an own effect.

    Its unit is made of those of the place: F and D of an element, S of a sensor, U of an actuator, and s. It is `value`
    where none is given. `tried` are values that a discovery begins from: parts of the largest displacement where the
    unit is D, of the largest reading or command where it is S or U, of the rms rate where it is D/s.
    """

    unit: TextField = "1"
    meaning: TextField = ""
    value: Number | None = None
    bounds: tuple[Number | None, Number | None] = (None, None)
    tried: tuple[Number, ...] = ()


class OwnState(Block):
    """An internal state of an own effect, which begins at 0; a record may begin up to `size` away from that."""

    rate: Formula
    unit: TextField = "1"
    meaning: TextField = ""
    size: Formula | None = None


class OwnEffect(Block):
    """A user's own effect: the force of an element, or the value that a sensor or actuator makes of its own.

    `nested` names simpler effects that are special cases of it; `absorbed_by`, a parameter of the model that would do
    the same; `linear` says that it keeps a linear rig linear. `label` is its name in a sentence, and `family` the row
    of the error budget in which it counts.
    """

    meaning: TextField
    label: TextField = ""
    family: TextField = ""
    where: Literal["element", "sensor", "actuator"]
    expression: Formula
    parameters: dict[Name, OwnParameter] = {}
    states: dict[Name, OwnState] = {}
    nested: Annotated[tuple[TextField, ...], _SEVERAL] = ()
    absorbed_by: TextField = ""
    linear: Truth = False
    cause: TextField = ""
    remedy: TextField = ""
    source: TextField = ""


class EffectChange(Block):
    """What an experiment changes of an effect that its plant has: `false` switches it off."""

    enabled: Truth | None = None
    parameters: dict[Name, Value] = {}


class Transform(Block):
    """The map from rig coordinates to virtual ones: a matrix, an expression for each, or neither for the identity."""

    matrix: tuple[tuple[Formula, ...], ...] | None = None
    expressions: dict[Name, Formula] | None = None
    parameters: dict[Name, Number] = {}

    @property
    def kind(self) -> Literal["identity", "matrix", "expressions"]:
        """Say in which way the transform is given."""
        return "matrix" if self.matrix is not None else "expressions" if self.expressions is not None else "identity"


class ObserverSettings(Block):
    """How the controller estimates the rig's state from its sensors.

    `exact` takes the true state, as only a simulation can give it; `differences` differences the positions; `kalman`
    follows the model; `disturbance` also estimates what the model lacks. `bandwidth` is in rad/s; `noise` is the
    standard deviation of a reading, in the sensors' units; `order` says how a disturbance is expected to continue: 1 as
    a constant, 2 as a straight line. `at` says where it acts on a rig whose inputs act through dynamics of their own:
    at the `inputs` alone, or at the `masses`, too; by default at these where the sensors tell both apart.
    """

    kind: Literal["exact", "differences", "kalman", "disturbance"] = "disturbance"
    bandwidth: Positive | None = None
    noise: Positive | None = None
    order: Natural = 2
    at: Literal["inputs", "masses"] | None = None


class Regulation(Block):
    """What is held besides the wanted dynamics: a virtual energy, and oscillators in or in anti-phase.

    `energy` is in the virtual system's units, `rate` says how fast it is approached and `coupling` how strongly the
    oscillators are drawn to each other, both per unit of virtual time.
    """

    energy: Positive | None = None
    rate: Positive = 0.05
    phase: Literal["in", "anti"] | None = None
    coupling: Positive = 0.05


class ControllerSettings(Block):
    """How often the controller runs (`rate` in Hz, None for continuous) and its model of the rig.

    `homing` is the time in s in which it brings the rig from rest to the initial state; without it, a simulated rig
    is placed there. In `rest` s before that, it measures the offsets of the sensors. `energy_balance` is the rate at
    which it takes out energy that the rig gains beyond what the virtual system gives it, per unit of virtual time.
    `actuator_bandwidth`, in rad/s, is that with which a rig whose inputs act through dynamics of their own is brought
    to the wanted accelerations; by default it is that of the observer, and twenty times the fastest frequency of the
    virtual motion without one.
    `external` says what becomes of forces that are not in the model: rejected, or felt by the virtual system through an
    input from a force sensor or from the disturbance observer. `effects` is how strong the controller takes noise and
    delay of the plant to be, where that differs from what the experiment gives its plant.
    """

    rate: ControllerRate = None
    model: TextField | None = None
    parameters: dict[Name, Number] = {}
    effects: dict[Name, Annotated[EffectChange, _SWITCH]] = {}
    observer: Annotated[ObserverSettings, _KIND] | None = None
    homing: Positive | None = None
    rest: Positive | None = None
    regulate: Regulation | None = None
    energy_balance: Positive | None = None
    actuator_bandwidth: Positive | None = None
    external: Literal["rejected", "felt"] = "rejected"


class RecordSettings(Block):
    """How often a recording takes a row, in Hz."""

    rate: Rate


class Stop(Block):
    """What ends a run before its duration: that two virtual coordinates have synchronised.

    `of` are the two, by default the first oscillators; `phase` and `eps`, a part of the amplitude, say when they count
    as synchronised (definition 5.3). `false_alarm` is the probability that a run without synchronisation is ended;
    `period`, in virtual time, is that of the ideal motion by default; `memory` the periods after which phases that have
    nothing to do with each other are other ones.
    """

    when: Literal["synchronised"]
    of: tuple[Name, ...] = ()
    phase: Literal["in", "anti"] = "anti"
    eps: Positive = 0.05
    false_alarm: Positive = 1e-3
    period: Positive | None = None
    memory: Positive = 0.5


class _Identity(Short):
    """Reads the word "identity" as a transform that is neither a matrix nor expressions."""

    def widen(self, value: object) -> object:
        if isinstance(value, str) and value != "identity":
            remedy = "write identity, {matrix: [[...]]} or {expressions: {coordinate: expression}}"
            raise refuse(f"'{value}' is not a transform", remedy)
        return {} if isinstance(value, str) else value


_IDENTITY = _Identity("", (str,))
_WHEN = Short("when", (str,))


class Declaration(Block):
    """A file that was read: its values, and the place of each."""

    kind_name: ClassVar[str]
    _places: Places = PrivateAttr(default_factory=Places)
    _files: dict[str, str] = PrivateAttr(default_factory=dict)
    _counts: dict[str, int] = PrivateAttr(default_factory=dict)

    name: TextField
    source: TextField | None = None
    description: TextField | None = None

    @property
    def files(self) -> dict[str, str]:
        """The files that were read, each with its SHA-256."""
        return dict(self._files)

    def place(self, path: str) -> Place | None:
        """Give the place of a value such as "parameters.w3.value", or of the nearest value around it."""
        return self._places.around(path)

    def key_place(self, path: str) -> Place | None:
        """Give the place of the key of a value, or of the nearest one around it."""
        return self._places.keys.get(path) or self.place(path)

    def canonical(self) -> dict[str, Any]:
        """Give the declaration as JSON can hold it, defaults left out; the dict can be validated again."""
        return self.model_dump(mode="json", exclude_defaults=True)


class ModelDeclaration(Declaration):
    """The equations of a machine: explicit, implicit in the accelerations, or from a Lagrangian."""

    kind_name = "model"

    extends: TextField | None = None
    coordinates: dict[Name, Annotated[Coordinate, _MEANING]] = {}
    states: dict[Name, Annotated[State, _MEANING]] = {}
    inputs: dict[Name, Annotated[Input, _MEANING]] = {}
    parameters: dict[Name, Annotated[Parameter, _VALUE]] = {}
    definitions: dict[Name, Formula] = {}
    equations: dict[Formula, Formula] = {}
    lagrangian: Formula | None = None
    dissipation: Formula | None = None
    forces: dict[Name, Formula] = {}
    terms: dict[Formula, Formula] = {}
    outputs: dict[Name, Annotated[Output, _EXPRESSION]] = {}
    energy: Formula | None = None
    scales: dict[TextField, Scale] = {}
    oscillators: tuple[Name, ...] | None = None
    elements: dict[Name, Element] = {}
    effects: dict[Name, EffectUse] = {}
    events: dict[Name, Event] = {}
    drawing: tuple[Shape, ...] = ()

    def state_of(self, left: Expression) -> str | None:
        """Give the internal state whose equation has this left-hand side, None for an equation of motion.

        It holds the rate of this state, no other and no acceleration.
        """
        rates = [symbol for symbol in left.symbols if symbol.endswith("'") and symbol[:-1] in self.states]
        return rates[0][:-1] if len(rates) == 1 and not any(symbol.endswith("''") for symbol in left.symbols) else None

    @property
    def motion(self) -> dict[Expression, Expression]:
        """The equations of motion: all but those of the internal states."""
        return {left: right for left, right in self.equations.items() if self.state_of(left) is None}

    @property
    def rates(self) -> dict[str, tuple[Expression, Expression]]:
        """Both sides of the equation of each internal state, in declared order."""
        found = {self.state_of(left): (left, right) for left, right in self.equations.items()}
        return {name: found[name] for name in self.states if name in found}


class DictionaryDeclaration(Declaration):
    """Effects of one's own, beside those of `masking.model.effects.EFFECTS`."""

    kind_name = "dictionary"

    dictionary: dict[Name, OwnEffect]


class PlantDeclaration(Declaration):
    """A rig: the model that describes it, its sensors and its limits; `own_effects` names dictionaries."""

    kind_name = "plant"
    _dictionaries: tuple[DictionaryDeclaration, ...] = PrivateAttr(default=())

    kind: Literal["simulated"] = "simulated"
    model: TextField
    parameters: dict[Name, Number] = {}
    sensors: dict[Name, Annotated[Sensor, _MEASURES]] = {}
    actuators: dict[Name, Annotated[Actuator, _MEANING]] = {}
    allocation: dict[Name, Formula] = {}
    limits: Limits = Limits()
    arm: Literal["operator"] | None = None
    own_effects: Annotated[tuple[TextField, ...], _SEVERAL] = ()
    effects: dict[Name, EffectUse] = {}

    @property
    def dictionaries(self) -> tuple[DictionaryDeclaration, ...]:
        """The dictionaries that `own_effects` names, as they were read with the plant."""
        return self._dictionaries

    def with_dictionaries(self, *own: DictionaryDeclaration) -> PlantDeclaration:
        """Give the plant with more dictionaries than it names."""
        changed = self.model_copy()
        changed._dictionaries = (*self._dictionaries, *own)
        changed._files = {**self._files, **{file: digest for one in own for file, digest in one.files.items()}}
        return changed


class ExperimentDeclaration(Declaration):
    """A run: which plant, or which `plants` together, is to move as which virtual system, from where, for how long."""

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["plant"]}, {"required": ["plants"]}]})
    kind_name = "experiment"

    plant: TextField | None = None
    plants: dict[Name, TextField] = {}
    virtual: TextField
    transform: Annotated[Transform, _IDENTITY] = Transform()
    controller: ControllerSettings = ControllerSettings()
    initial: dict[TextField, Number] = {}
    parameters: dict[Name, Number] = {}
    inputs: dict[Name, Annotated[InputSource, _EXPRESSION]] = {}
    effects: dict[Name, Annotated[EffectChange, _SWITCH]] = {}
    duration: Positive
    time_scale: Positive | None = None
    record: RecordSettings | None = None
    stop: Annotated[Stop, _WHEN] | None = None
    tolerance: Positive = 1e-10
    seed: Natural = Field(default=0)


class BatchBudget(Block):
    """What the runs of a batch may use together: `time` in s, `trips`, and `energy` of all actuators in J."""

    time: Positive | None = None
    trips: Natural | None = None
    energy: Positive | None = None


class BatchDeclaration(Declaration):
    """Runs of an experiment, one after the other: every combination of what `vary` lists, each `repeats` times.

    `vary` names values of the experiment, such as `parameters.k`, `initial.x` or `seed`. Without a `plant`, an address,
    they run on the twin. Between two runs the rig cools for `cool` s; its sensors must be at rest, and within `drift`
    of a limit of where they were before the first run. A run that did not end as planned is tried `retries` more times;
    a plant that does not answer is waited for, `patience` s at most.
    """

    kind_name = "batch"

    experiment: TextField
    plant: TextField | None = None
    lockstep: Truth = False
    vary: dict[TextField, tuple[Number, ...]] = {}
    repeats: Natural = 1
    retries: Natural = 1
    cool: Number = 0.0
    drift: Positive = 0.05
    patience: Positive = 60.0
    budget: BatchBudget = BatchBudget()


_EACH = (ModelDeclaration, PlantDeclaration, ExperimentDeclaration, DictionaryDeclaration, BatchDeclaration)
KINDS: dict[str, type[Declaration]] = {kind.kind_name: kind for kind in _EACH}
