"""Virtual inputs: series, readings and estimated forces that a sampled controller feeds to its virtual system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.graph import Graph, Node
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.controller_sizes import Sizes
from masking.lazy_imports import virtual_input_kernels
from masking.model.modelling.input_series import Series

if TYPE_CHECKING:
    from masking.control.law import Controller


@dataclass(frozen=True)
class FromSensor:
    """An input that is what a sensor reads: its cell, the sensor's index, and virtual units per unit of reading."""

    cell: int
    sensor: int
    factor: float


@dataclass(frozen=True)
class FromPush:
    """An input that is an estimated force."""

    cell: int  # of the input
    coordinate: int  # index of the rig coordinate along which it acts
    factor: float  # virtual units per SI unit
    above: float  # rad/s; slower forces are errors of the model


@dataclass(frozen=True)
class Feed:
    """Inputs of the virtual system that a sampled controller reads as it runs."""

    scale: int = 0  # index of the seconds per unit of virtual time in the parameter array
    series: tuple[tuple[int, Series], ...] = ()  # the cell of each input that is known point by point, and its points
    sensors: tuple[FromSensor, ...] = ()  # inputs that are read
    pushes: tuple[FromPush, ...] = ()  # inputs that are estimated

    def __bool__(self) -> bool:
        return bool(self.series or self.sensors or self.pushes)

    def tail(self) -> Array:
        """Values behind the parameters, as `numerics.virtual_input_kernels` reads them; empty without inputs."""
        if not self:
            return np.empty(0)
        parts = [np.array([cell, len(one.times), *one.pieces.ravel()]) for cell, one in self.series]
        parts += [np.array([one.cell, one.sensor, one.factor]) for one in self.sensors]
        parts += [np.array([one.cell, one.factor, one.above, 0.0]) for one in self.pushes]
        tail = np.concatenate([*parts, np.zeros(len(self.pushes))])
        return np.append(tail, len(tail) + 1.0)

    def lasting(self, p: Array) -> Array:
        """Lasting part of each push (1, pushes), SI units, in the parameters p with their tail."""
        count, last = len(self.pushes), len(p) - 1
        return p[last - 5 * count : last - count].reshape(1, count, 4)[:, :, 3].copy()

    def structure(self) -> list[object]:
        """All that the compiled step depends on."""
        coordinates = [one.coordinate for one in self.pushes]
        return [self.scale, len(self.series), len(self.sensors), coordinates] if self else []

    def bare(self, signature: str) -> str:
        """Signature of a function under the name that it has before it is fed."""
        is_fed = bool(self.series) and signature.startswith(("law(", "virtual(", "remember("))
        return f"bare_{signature}" if is_fed else signature

    def add_laws(self, module: Module) -> None:
        """Add the control law, what the energy balance calls and rates of internal states, with their series."""
        if self.series:
            for name in ("law", "virtual", "remember"):
                kernel = virtual_input_kernels.law if name == "law" else virtual_input_kernels.virtual
                module.add_factory(name, kernel, f"bare_{name}", len(self.series), self.scale, exported=False)

    def add_control(self, module: Module, sizes: Sizes, work: tuple[int, int]) -> None:
        """Add the step with inputs that are read or estimated."""
        given = ("bare_control", "push", *map(len, (self.series, self.sensors, self.pushes)), sizes)
        module.add_factory("control", virtual_input_kernels.control, *given, work=work)

    @property
    def is_live(self) -> bool:
        """Whether an input is known in the run alone."""
        return bool(self.sensors or self.pushes)

    def forces(self, graph: Graph, controller: Controller, known: dict[object, Node], d: list[Node]) -> list[Node]:
        """Nodes of the force along the coordinate of each push, with accelerations `d` that the model lacks (n,)."""
        mass = controller.model.equations.mass.tolist()
        return [
            graph.total([graph.mul(graph.lower(m, known), a) for m, a in zip(mass[one.coordinate], d, strict=True)])
            for one in self.pushes
        ]


NOTHING = Feed()
