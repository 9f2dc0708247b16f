"""Loop of a sampled controller and the twin that it drives, compiled together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from masking.compile.codegen.compiled_functions import Compiled
from masking.compile.codegen.generated_module import Module
from masking.control.coordinate_match import CoordinateMatch
from masking.control.rig.twin import Twin
from masking.control.sampled_controller import SampledController
from masking.lazy_imports import sampled_loop


@dataclass(frozen=True)
class SampledLoop(Compiled):
    """A sampled controller and the twin that it drives, compiled together."""

    sampled: SampledController
    twin: Twin

    def __post_init__(self) -> None:
        _ = self.match

    @cached_property
    def match(self) -> CoordinateMatch:
        """Coordinates of the controller's model among the twin's."""
        return CoordinateMatch(self.sampled.controller, self.twin.model, self.twin.declaration.sensors)

    @property
    def _made_from(self) -> Mapping[str, object]:
        both = {"sampled": self.sampled.structure(), "twin": self.twin.structure()}
        return both | self.match.structure()

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
        module.add_factory("run", sampled_loop.run, "sense", "control", "move", size, work=work)
        return module
