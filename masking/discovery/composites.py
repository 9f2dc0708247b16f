"""Patches: several laws that are put together to one that the dictionary lacks."""

from __future__ import annotations

from collections.abc import Sequence

from masking.declaration.expression import Expression
from masking.discovery.augmented_model import OpenRig
from masking.effects import Effect

ENOUGH = 3  # linear causes that together are any linear system


def is_patched(causes: Sequence[tuple[str, str]], rig: OpenRig) -> bool:
    """Return whether several laws are put together to one that the dictionary lacks.

    Such are laws of one kind at one place, or at an element and at a coordinate that is its alone, and linear laws of
    which so many can make any linear system.

    Args:
        causes: the effect and the place of each.
        rig: the rig.
    """
    known = rig.twin.dictionary
    those = [(known[name], at) for name, at in causes if name in known]
    if sum(effect.is_linear for effect, _ in those) >= ENOUGH:
        return True
    kinds = [(_seat(rig, at), _kind(effect)) for effect, at in those]
    kinds = [kind for kind in kinds if kind[1]]
    return len(set(kinds)) < len(kinds)


def _seat(rig: OpenRig, name: str) -> str:
    """Return the element that a coordinate is of alone; what is no such coordinate itself."""
    if not any(place.name == name and place.coordinate and not place.declared for place in rig.places):
        return name
    elements = [(p.name, p.element.displacement) for p in rig.places if p.declared]
    those = [element for element, displacement in elements if displacement and name in displacement.symbols]
    return those[0] if len(those) == 1 else name


def _kind(effect: Effect) -> str:
    """Return what the force of an element follows; '' where it follows neither displacement nor rate."""
    if effect.where != "element" or effect.absorbed_by:
        return ""
    if effect.states:
        return "memory"
    names = Expression(effect.expression).symbols & {"d", "d_rate"}
    return " and ".join(sorted(names))
