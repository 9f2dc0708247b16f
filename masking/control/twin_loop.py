"""Loop of a sampled controller and the twin that it drives, compiled together."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from masking.compile.codegen import module_store
from masking.compile.codegen.compiled_functions import Kernels
from masking.compile.codegen.source import Module
from masking.control.coordinate_match import CoordinateMatch
from masking.control.rig.twin import Twin
from masking.control.sampled_controller import SampledController
from masking.lazy_imports import runge_kutta, sampled_loop


@dataclass(frozen=True)
class SampledLoop:
    """A sampled controller and the twin that it drives, compiled together."""

    sampled: SampledController
    twin: Twin

    def __post_init__(self) -> None:
        _ = self.match

    @cached_property
    def match(self) -> CoordinateMatch:
        """Coordinates of the controller's model among the twin's."""
        return CoordinateMatch(self.sampled.controller, self.twin.model, self.twin.declaration.sensors)

    @cached_property
    def kernels(self) -> Kernels:
        """Compiled loop; from the cache on disk where it has been made before."""
        return Kernels(module_store.load(self._key, self._build))

    @property
    def is_compiled(self) -> bool:
        """Whether the loop is in the cache on disk."""
        return module_store.exists(self._key)

    @property
    def _key(self) -> str:
        both = {"sampled": self.sampled.structure(), "twin": self.twin.structure()}
        return module_store.key({**both, **self.match.structure()})

    @property
    def width(self) -> int:
        """Length of a row of the work space."""
        return max(self.sampled.sizes.work[1], len(self.twin.sensors), len(self.twin.state_names))

    def _build(self) -> Module:
        controller = self.sampled.controller
        meta = {"kind": "sampled loop", **self.twin.state_kinds, "unsolved": controller.curves.unsolved}
        module = Module(f"{self.twin.declaration.name}, masked as {controller.virtual.name}", meta)
        self.twin.add_to(module)
        self.sampled.add_to(module)
        if not self.match.is_same:
            self.match.add_to(module)
        size, work = len(self.twin.state_names), (self.sampled.sizes.work[0], self.width)
        module.add_factory("move_rig", runge_kutta.steps_under_way, "twin_derivative", size, exported=False)
        module.add_factory("run", sampled_loop.run, "sense", "control", "move_rig", size, work=work)
        return module
