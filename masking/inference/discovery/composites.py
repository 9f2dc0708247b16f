"""Composites: explanations by several effects that imitate one that is not in the dictionary."""

from __future__ import annotations

from collections.abc import Sequence

from masking.inference.discovery import verdict
from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.decision_rules import RULES, DecisionRules
from masking.inference.discovery.verdict import Key, Law
from masking.model.declaration.expression import Expression
from masking.model.effects import Effect


def are_composite(causes: Sequence[Key], rig: AugmentedModel, rules: DecisionRules = RULES) -> bool:
    """Whether several effects imitate one that the dictionary lacks, see `verdict.is_composite`.

    A coordinate that only one element moves counts as that element.
    """
    known = rig.twin.dictionary
    every = [(known[name], at) for name, at in causes if name in known]
    laws = [Law(one.is_linear, _seat(rig, at), _kind(one.reduced({})), one.family) for one, at in every]
    return verdict.is_composite(laws, rules)


def share_a_place(causes: Sequence[Key], rig: AugmentedModel) -> bool:
    """Whether two forces of an explanation act at one place, which may stand for a single law."""
    known = rig.twin.dictionary
    seats = [_seat(rig, at) for name, at in causes if name in known and known[name].where == "element"]
    return len({*seats}) < len(seats)


def _seat(rig: AugmentedModel, name: str) -> str:
    """The only element a coordinate belongs to; other names unchanged."""
    if not any(place.name == name and place.coordinate and not place.declared for place in rig.places):
        return name
    elements = [(p.name, p.element.displacement) for p in rig.places if p.declared]
    those = [element for element, displacement in elements if displacement and name in displacement.symbols]
    return those[0] if len(those) == 1 else name


def _kind(effect: Effect) -> str:
    """Variables that the force of an element follows; '' for neither displacement nor rate."""
    if effect.where != "element" or effect.absorbed_by:
        return ""
    return "memory" if effect.states else " and ".join(sorted(Expression(effect.expression).symbols & {"d", "d_rate"}))
