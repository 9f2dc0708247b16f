"""Models for `masking stability` with a truth from elsewhere: a theorem, a closed form, eigenvalues.

The truth is one of

* sets that every motion converges to: "x + y, z | x, y, z" are two of them, each of expressions that vanish there with
  their time derivatives; "rest" are all equilibria;
* BOUNDED: every motion is bounded and the energy does not grow; no smaller set is claimed;
* NONE: a motion from `start` grows, drifts, or goes on for ever beside any set that could be named.

`start` is a state, coordinates first, whose motion does not come to rest where the truth allows that.
"""

from dataclasses import dataclass, field

BOUNDED, NONE = "bounded", "none"


@dataclass(frozen=True)
class Entry:
    """A model, its truth, and why that is so.

    Args:
        equations: accelerations by coordinate, or a Lagrangian, a dissipation function and forces.
        energy: the declared one; of a Lagrangian that of the Lagrangian.
        truth: see above.
        why: the argument or the theorem.
        start: of a motion that goes on.
        duration: after which motions have come near the truth.
        near: of the initial size: how near they are then.
        is_rough: whether the forces jump: integrated by small steps.
    """

    equations: dict[str, str] | str
    energy: str
    truth: str
    why: str
    start: tuple[float, ...] = ()
    duration: float = 120.0
    near: float = 0.02
    size: float = 1.0
    parameters: dict[str, float | str] = field(default_factory=dict)
    definitions: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    inputs: tuple[str, ...] = ()
    dissipation: str = ""
    is_rough: bool = False

    @property
    def coordinates(self) -> list[str]:
        """Return the names of the coordinates."""
        if isinstance(self.equations, dict):
            return [*self.equations]
        return [
            name for name in ("x", "y", "z", "x1", "x2", "x3", "x4", "x5", "th", "ph") if f"{name}'" in self.equations
        ]

    @property
    def declaration(self) -> dict:
        """Return the parts of a declaration."""
        parts = {
            "coordinates": {x: {"initial": 0.5, "unit": self.units.get(x, "1")} for x in self.coordinates},
            "parameters": {n: {"value": x, "unit": self.units.get(n, "1")} for n, x in self.parameters.items()},
            "definitions": self.definitions,
            "inputs": {u: {} for u in self.inputs},
        }
        if isinstance(self.equations, str):
            return parts | {"lagrangian": self.equations, "dissipation": self.dissipation or "0"}
        accelerations = {f"{x}''": text for x, text in self.equations.items()}
        return parts | {"equations": accelerations} | ({"energy": self.energy} if self.energy else {})


def springs(*coordinates):
    """Return the energy of unit masses on unit springs to ground."""
    return "(" + " + ".join(f"{x}'**2 + {x}**2" for x in coordinates) + ")/2"
