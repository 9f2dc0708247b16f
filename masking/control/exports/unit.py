"""Unit: what is exported, in no language yet: its ports, memory, constants, and the kernels that are called."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from masking.compile.codegen.generated_module import Module
from masking.compile.numerics.arrays import Array
from masking.control.exports import unit_kernels
from masking.model.declaration.schema import ModelDeclaration
from masking.model.declaration.units import coherent, combined


@dataclass(frozen=True)
class Channel:
    """One number that goes in or comes out: its name, its unit, and what it is."""

    name: str
    unit: str = ""
    meaning: str = ""


@dataclass(frozen=True)
class Operation:
    """A function of a unit."""

    # of its kernel, in order: ports, memory and constants by their names; `time` is a number
    arguments: tuple[str, ...]
    text: str  # what it does, in one sentence
    returns_status: bool = False  # whether it returns 0, or why the unit has stopped


@dataclass(frozen=True)
class Unit:
    """A controller, a rig or a model that can be called by itself."""

    name: str  # of its functions and files, as `target_text.c_name` makes it
    title: str  # what it is
    kind: str  # `controller`, `law`, `plant` or `model`
    module: Module  # holds each operation's kernel as `unit_` and its name
    ports: Mapping[str, tuple[Channel, ...]]  # channels by the name of the argument that they are
    memory: Mapping[str, tuple[int, ...]]  # shape of each array that evolves
    constants: Mapping[str, Array]  # arrays that stay
    operations: Mapping[str, Operation]  # by name; `init` begins, `step` is called once a period
    period: float | None  # seconds, or units of a model's time, between steps; None where the caller gives the time
    notes: tuple[str, ...] = ()  # further sentences on its use
    # what the first numbers of the first array of its memory are; empty where no one wants them
    states: tuple[Channel, ...] = ()
    parameters: tuple[tuple[Channel, int], ...] = ()  # that can be set, with their indices in the array `p`

    @property
    def inputs(self) -> tuple[Channel, ...]:
        """Channels that a caller gives, of all ports."""
        return tuple(c for port, channels in self.ports.items() if port != self._output for c in channels)

    @property
    def outputs(self) -> tuple[Channel, ...]:
        """Channels that a unit writes."""
        return self.ports[self._output]

    @property
    def _output(self) -> str:
        return "commands" if self.kind in {"controller", "law"} else "readings"

    def written(self, operation: str) -> tuple[str, ...]:
        """Ports that an operation writes."""
        return (self._output,) if self._output in self.operations[operation].arguments else ()


class Operations(dict[str, Operation]):
    """Operations of a unit by name, whose kernels are added to its module with them; `start` is its first sample."""

    def __init__(self, module: Module, start: int, period: float | None) -> None:
        self.module = module
        module.add_factory("clear", unit_kernels.clear, start, exported=False)
        if period is not None:
            module.add_factory("instant", unit_kernels.instant, period, exported=False)

    def add(self, name: str, text: str, arguments: str, *kernel: Any, returns_status: bool = False) -> None:  # noqa: ANN401
        """Add an operation; `text` says what it does, in one sentence.

        `arguments` are those of its kernel, as `Operation` has them, in one line; `kernel` is its factory, and what
        that is given.
        """
        self.module.add_factory(f"unit_{name}", *kernel, exported=False)
        self[name] = Operation(tuple(arguments.split()), text, returns_status)


def state_channels(names: Sequence[str], declaration: ModelDeclaration, meaning: str = "") -> tuple[Channel, ...]:
    """Coordinates, velocities and internal states, in SI units; what a model does not declare has no unit."""
    units = {name: coherent(one.unit) for name, one in declaration.coordinates.items()}
    units |= {name: coherent(one.unit) for name, one in declaration.states.items()}
    units |= {f"{name}'": combined("D/s", {"D": units[name]}) for name in declaration.coordinates}
    return tuple(Channel(name, units.get(name, ""), meaning) for name in names)
