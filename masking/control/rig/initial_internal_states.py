"""Initial internal states of a twin: how far from the declared ones a record may begin."""

from __future__ import annotations

from masking.control.rig.twin import Twin
from masking.model.declaration.expression import Expression


def reaches(twin: Twin) -> dict[int, float]:
    """Sizes of the internal states that have one, in SI units, by their indices in y.

    Of the others, those of the model begin anywhere; those of effects forget how they begin, and begin at 0.
    """
    units, values, found = twin.model.units.conversions, twin.model.parameter_values(), dict[int, float]()
    for name, state in twin.model.declaration.states.items():
        if state.size is not None:
            unit = 1.0 if state.size.symbols else units[state.unit].factor
            found[twin.state_names.index(name)] = unit * state.size.evaluate(values)
    for effect, name in twin.chain_states:
        known = {key: twin.parameter_value(f"{effect.label}_{key}") for key in effect.entry.parameters}
        size = Expression(effect.entry.states[name].size or "0")
        found[twin.state_names.index(f"{effect.label}_{name}")] = size.evaluate(known)
    return {index: reach for index, reach in found.items() if reach > 0.0}
