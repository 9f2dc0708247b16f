"""Passive coordinates of an experiment: where they begin, how they move by themselves, and the energy they took."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.control.law import Controller
from masking.control.zero_dynamics import Held, ZeroDynamics
from masking.errors import ModelError
from masking.model.declaration import dimensions, units
from masking.model.modelling.model import Model

_ROWS: Final = 5000  # of a run, at which its energy is looked at


@dataclass(frozen=True)
class Passive:
    """States of a rig that its virtual coordinates do not determine, and the coordinates among them."""

    held: Held  # the rig with the virtual coordinates held where the run begins
    given: Mapping[str, float]  # the experiment's initial values, in declared units

    def under(self, law: Controller) -> Passive:
        """Those beside the states that a law determines: more, where inputs act through dynamics of their own."""
        if law.is_direct:
            return self
        is_same = self.plant.state_names == law.model.state_names  # else it is not known what the plant has beside
        return replace(self, held=replace(self.held, degrees=law.degrees, places=law.remainder if is_same else ()))

    def scaled(self, amplitude: float, stroke: float) -> Passive:
        """Those of a run with all initial values, and the lengths that the transform sees, times a factor each."""
        held = replace(self.held, eta=amplitude * self.held.eta, lengths=stroke * self.held.lengths)
        return replace(self, held=held, given={name: amplitude * value for name, value in self.given.items()})

    def if_any(self) -> Passive | None:
        """Itself; None where the virtual coordinates determine the whole state."""
        return self if self.held.places else None

    @property
    def begun(self) -> Array:
        """State [q, v, s] of the rig at the start, with the virtual coordinates held."""
        return self.held.state(self.states)

    @property
    def plant(self) -> Model:
        """Model of the rig, SI units."""
        return self.held.plant

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates and internal states."""
        return tuple(n for n in (self.plant.state_names[i] for i in self.held.places) if not n.endswith("'"))

    @cached_property
    def zero_dynamics(self) -> ZeroDynamics:
        """Their motion with the virtual coordinates held where the run begins; a ModelError without a rest."""
        return self.held.zero_dynamics()

    @property
    def words(self) -> str:
        """How they move with the virtual coordinates held, or why that is not known."""
        try:
            return str(self.zero_dynamics)
        except ModelError as error:
            return str(error)

    @property
    def states(self) -> Array:
        """States that are passive at the start (r,), SI units: as given, else at rest."""
        shown, virtual = self.plant.shown, self.held.transform.virtual.coordinates
        names = [self.plant.state_names[i] for i in self.held.places]
        own = [name for name in names if name in self.given and name.rstrip("'") not in virtual]
        given = {name: self.given[name] * shown[name].size for name in own}
        if {name for name in names if not name.endswith("'")} <= given.keys():
            return np.array([given.get(name, 0.0) for name in names])
        resting = dict(zip(self.zero_dynamics.names, self.zero_dynamics.rest, strict=True))
        return np.array([(resting | given).get(name, 0.0) for name in names])

    def initial(self) -> Array:
        """Coordinates that no virtual one stands for, then their velocities, at the start (2 m,), SI units."""
        n, free = len(self.held.lengths), self.held.transform.passive
        both = (*free, *(n + i for i in free))
        return self.states if both == self.held.places else self.begun[list(both)]

    def check_still(self) -> None:
        """Refuse initial velocities, which a controller that reads sensors cannot give."""
        moving = [n for n in self.names if self.given.get(f"{n}'") and n not in self.held.transform.virtual.coordinates]
        if moving:
            raise ModelError(
                f"initial.{moving[0]}': a rig that is read by sensors starts at rest; leave it out, or take 'observer: "
                "exact' or 'rate: continuous', where a simulation can begin in any state"
            )

    def entry(self, columns: Mapping[str, Array]) -> dict[str, Any]:
        """Their names and motion, for the manifest, from columns of a recording (rows,), by name."""
        try:
            found = self.zero_dynamics.as_dict()
        except ModelError as error:
            found = {"coordinates": list(self.names), "verdict": "unknown", "how": "no rest", "words": str(error)}
        found["peak"] = {name: float(np.abs(columns[f"rig.{name}"]).max()) for name in self.names}
        moved = self.plant.state_names[: 2 * len(self.plant.coordinates)]
        states = np.column_stack([columns[f"rig.{name}"] * self.plant.shown[name].size for name in moved])
        energy = self._energy(states) if found["verdict"] != "unknown" else None
        if energy is not None:
            numbers = {"start": float(energy[0]), "end": float(energy[-1]), "peak": float(energy.max())}
            found["energy"] = {**numbers, "unit": self._energy_unit()}
        return found

    @staticmethod
    def merged(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
        """Entry of a run from those of two chunks, one behind the other."""
        found = {**before, "peak": {name: max(peak, after["peak"][name]) for name, peak in before["peak"].items()}}
        if "energy" in before:
            peak = max(before["energy"]["peak"], after["energy"]["peak"])
            found["energy"] = {**before["energy"], "end": after["energy"]["end"], "peak": peak}
        return found

    def _energy_unit(self) -> str:
        """Unit of the energy in SI units."""
        model = self.plant.declaration
        expression, symbols = model.energy or model.lagrangian, dimensions.symbol_dimensions(model)
        found = dimensions.dimension_in(expression, symbols) if expression and symbols else None
        if found is None:
            return ""
        return "J" if found == units.dimension_of("J") else units.describe(found)

    def _energy(self, states: Array) -> Array | None:
        """Energy of the rig beyond that with its passive coordinates at rest (rows,); None without one."""
        kernels, n = self.plant.kernels, len(self.plant.coordinates)
        if not kernels.meta["has_energy"]:
            return None
        rows = np.unique(np.linspace(0, len(states) - 1, _ROWS).astype(int))
        p, found, free = self.plant.values(), np.empty(len(rows)), self.held.passive
        for i, row in enumerate(rows):
            q, rest = states[row, :n].copy(), states[row, :n].copy()
            v, still = states[row, n:].copy(), states[row, n:].copy()
            rest[free], still[free] = self.zero_dynamics.rest[: len(free)], 0.0
            found[i] = kernels.energy(0.0, q, v, p) - kernels.energy(0.0, rest, still, p)
        return found
