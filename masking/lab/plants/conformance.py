"""Check that a plant keeps the rules of `masking.lab.plants.interface`; for whoever writes an adapter."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.display.printed_result import Printed
from masking.errors import PlantError, PlantMismatchError
from masking.lab.plants.interface import APPLIED, Plant, Sample, Settings, Telling

MakePlant = Callable[[], Plant]
TICKS: Final = 20
RATE: Final = 1000.0  # Hz
AMPLITUDE: Final = 1e-3  # in the actuators' units
WATCHDOG: Final = 1.0  # s: time for the check itself
STANDARD: Final = Settings(RATE, WATCHDOG)


@dataclass(frozen=True, repr=False, slots=True)
class Verdict(Printed):
    """Whether a plant keeps a rule."""

    rule: str  # what it says
    broken: tuple[str, ...]  # how it is broken, a sentence each; none where it is kept

    def __str__(self) -> str:
        head = f"{'fails' if self.broken else 'passes'}  {self.rule}"
        return "\n".join([head, *(f"        {text}" for text in self.broken)])


def check(make_plant: MakePlant, settings: Settings = STANDARD, *, amplitude: float = AMPLITUDE) -> list[str]:
    """Try every rule on plants of one make; the outputs move.

    Args:
        make_plant: makes an unconfigured plant; each rule asks for its own.
        settings: what the plants are configured with; the watchdog must leave time for the check itself.
        amplitude: magnitude of the commands that are tried.

    Returns:
        the rules that are broken, a sentence each; none where the plant conforms.
    """
    found = [text for verdict in verdicts(make_plant, settings, amplitude=amplitude) for text in verdict.broken]
    return list(dict.fromkeys(found))


def reach(make_plant: MakePlant, settings: Settings, amplitude: float, largest: float = np.inf) -> None:
    """See that there is a plant to check, before every rule fails since there is none, and what its actuators bear.

    Commands are tried up to an amplitude, which must be positive and no more than the `largest` that every actuator
    bears: else a PlantMismatchError; a PlantError where the plant cannot be configured.
    """
    if not 0.0 < amplitude < float("inf"):
        raise PlantMismatchError(f"the amplitude is {amplitude:g}; give a positive number in the actuators' units")
    if amplitude > largest:
        raise PlantMismatchError(f"the amplitude is {amplitude:g}, where the plant file allows {largest:g}; give less")
    plant = make_plant()
    try:
        plant.configure(settings)
    except PlantError:
        raise
    except Exception:  # noqa: S110  # the rules say which they break
        pass
    finally:
        with contextlib.suppress(Exception):
            plant.deactivate()


def verdicts(make_plant: MakePlant, settings: Settings = STANDARD, *, amplitude: float = AMPLITUDE) -> list[Verdict]:
    """Try every rule as `check` does, and return how each came out."""
    found: list[Verdict] = []
    for rule in RULES:
        plant = make_plant()
        broken: list[str] = []
        try:
            broken += rule(plant, settings, amplitude)
        except Exception as error:  # an adapter may raise anything
            broken.append(f"{_sentence(rule)}, but it raised {type(error).__name__}: {error}")
        finally:
            with contextlib.suppress(Exception):  # reported by its own rule
                plant.deactivate()
        found.append(Verdict(_sentence(rule), tuple(dict.fromkeys(broken))))
    return found


def _order(plant: Plant, settings: Settings, amplitude: float) -> Iterator[str]:
    """The life cycle is configure, activate, read and write, deactivate."""
    for verb, call in (("activate", plant.activate), ("read", plant.read), ("write", lambda: plant.write(0, _ZERO))):
        yield from _must_refuse(f"{verb} before configure", call)
    plant.configure(settings)
    command = np.full(len(plant.actuators), amplitude)
    for verb, call in (("read", plant.read), ("write", lambda: plant.write(0, command))):
        yield from _must_refuse(f"{verb} before activate", call)
    plant.activate()
    yield from _must_refuse("activate while active", plant.activate)
    yield from _must_refuse("configure while active", lambda: plant.configure(settings))
    plant.deactivate()
    for verb, call in (("activate", plant.activate), ("read", plant.read), ("write", lambda: plant.write(0, command))):
        yield from _must_refuse(f"{verb} after deactivate", call)


def _names(plant: Plant, settings: Settings, _amplitude: float) -> Iterator[str]:
    """A configured plant names its channels."""
    plant.configure(settings)
    for kind, names in (("sensors", plant.sensors), ("actuators", plant.actuators)):
        if not isinstance(names, tuple) or not names or not all(isinstance(name, str) and name for name in names):
            yield f"{kind} are {names!r}; they must be a tuple of names that are not empty"
        elif len(set(names)) != len(names):
            yield f"{kind} are {', '.join(names)}; no name may stand twice"
    if not isinstance(plant.owns_clock, bool):
        yield f"owns_clock is {plant.owns_clock!r}; it must be True or False"


def _samples(plant: Plant, settings: Settings, amplitude: float) -> Iterator[str]:
    """A sample is one finite float64 for each sensor, and its index increases."""
    last = -1
    for sample in _started(plant, settings, amplitude):
        values = sample.values
        if not isinstance(values, np.ndarray) or values.dtype != np.float64 or values.shape != (len(plant.sensors),):
            shape, kind = np.shape(values), getattr(values, "dtype", type(values).__name__)
            yield f"the values of a sample are {kind} of shape {shape}; they must be float64 of ({len(plant.sensors)},)"
        elif not np.isfinite(values).all():
            yield f"the values of sample {sample.index} are {values.tolist()}; they must be finite in a plant at rest"
        if not isinstance(sample.index, int):
            yield f"the index of a sample is a {type(sample.index).__name__}; it must be an int"
        if sample.index <= last:
            yield f"sample {sample.index} came after sample {last}; the index must increase"
        last = sample.index


def _own_samples(plant: Plant, settings: Settings, amplitude: float) -> Iterator[str]:
    """A sample that was read does not change later."""
    taken = [(sample, np.array(sample.values)) for sample in _started(plant, settings, amplitude)]
    if any(not np.array_equal(sample.values, values, equal_nan=True) for sample, values in taken):
        yield "the values of a sample changed after it was read; give each sample an array of its own"


def _own_commands(plant: Plant, settings: Settings, amplitude: float) -> Iterator[str]:
    """A command that was written is not changed, and may change later."""
    plant.configure(settings)
    plant.activate()
    command = np.full(len(plant.actuators), amplitude)
    plant.write(plant.read().index, command)
    if not np.array_equal(command, np.full(len(plant.actuators), amplitude)):
        yield "write changed the command that it was given; copy it"


def _shapes(plant: Plant, settings: Settings, amplitude: float) -> Iterator[str]:
    """A command is one number for each actuator."""
    plant.configure(settings)
    plant.activate()
    index, size = plant.read().index, len(plant.actuators)
    for shape in ((size + 1,), (size - 1,), (1, size), ()):
        yield from _must_refuse(f"a command of shape {shape}", partial(plant.write, index, np.full(shape, amplitude)))


def _finite(plant: Plant, settings: Settings, _amplitude: float) -> Iterator[str]:
    """A command is finite."""
    plant.configure(settings)
    plant.activate()
    index = plant.read().index
    for value in (np.nan, np.inf, -np.inf):
        command = np.zeros(len(plant.actuators))
        command[-1] = value
        yield from _must_refuse(f"a command of {value}", partial(plant.write, index, command))


def _way_out(plant: Plant, settings: Settings, amplitude: float) -> Iterator[str]:
    """Deactivate is legal in every state, any number of times, also after an error."""
    state = "before configure"
    try:
        plant.deactivate()
        plant.configure(settings)
        state = "before activate"
        plant.deactivate()
        plant.configure(settings)
        plant.activate()
        state = "while active, after a command that was refused"
        with contextlib.suppress(PlantError):
            plant.write(plant.read().index, np.full(len(plant.actuators), np.nan))
        plant.deactivate()
        state = "a second time"
        plant.deactivate()
    except PlantError as error:
        yield f"deactivate {state} raised {type(error).__name__}: {error}; it must be legal in every state"


def _again(plant: Plant, settings: Settings, amplitude: float) -> Iterator[str]:
    """A plant can be configured again after deactivate."""
    channels = []
    for _ in range(2):
        list(_started(plant, settings, amplitude))
        channels.append((plant.sensors, plant.actuators))
        plant.deactivate()
    if channels[0] != channels[1]:
        yield f"configured again, the plant has channels {channels[1]} instead of {channels[0]}"


def _zero(plant: Plant, settings: Settings, amplitude: float) -> Iterator[str]:
    """The outputs are zero once activated, and once deactivated."""
    plant.configure(settings)
    plant.activate()
    yield from _not_zero(plant, "activate")
    for _ in range(3):
        plant.write(plant.read().index, np.full(len(plant.actuators), amplitude))
    plant.deactivate()
    yield from _not_zero(plant, "deactivate")


Rule = Callable[[Plant, Settings, float], Iterator[str]]
RULES: Final[tuple[Rule, ...]] = (
    _order, _names, _samples, _own_samples, _own_commands, _shapes, _finite, _way_out, _again, _zero,
)  # fmt: skip
_ZERO: Final[Array] = np.zeros(1)


def _started(plant: Plant, settings: Settings, amplitude: float) -> Iterator[Sample]:
    """Samples of a run in which the sign of the command alternates."""
    plant.configure(settings)
    plant.activate()
    for tick in range(TICKS):
        sample = plant.read()
        yield sample
        plant.write(sample.index, np.full(len(plant.actuators), amplitude * (-1.0) ** tick))


def _must_refuse(what: str, call: Callable[[], object]) -> Iterator[str]:
    """Where a call is not refused with a PlantError."""
    try:
        call()
    except PlantError:
        return
    except Exception as error:  # an adapter may raise anything
        yield f"{what} raised {type(error).__name__}: {error}; it must be refused with a PlantError"
    else:
        yield f"{what} was accepted; it must be refused with a PlantError"


def _not_zero(plant: Plant, verb: str) -> Iterator[str]:
    """Which outputs are not zero, as far as the plant reports them."""
    telemetry = plant.telemetry() if isinstance(plant, Telling) else {}
    for name in plant.actuators:
        value = telemetry.get(f"{APPLIED}{name}", 0.0)
        if value != 0.0:
            yield f"the output {name} is {value} after {verb}; it must be 0"


def _sentence(rule: Rule) -> str:
    return (rule.__doc__ or rule.__name__).rstrip(".")
