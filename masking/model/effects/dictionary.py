"""The dictionary of effects: those that come with the package, and those that a user's file declares beside them.

Both are entries of the same form. A user's are values: a plant carries those of the dictionaries that it names, and
nothing is registered anywhere.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Final

from masking.errors import DeclarationError, Problem, nearest
from masking.model.declaration import registry
from masking.model.declaration.model_checks import problem_at
from masking.model.declaration.schema import DictionaryDeclaration, OwnEffect
from masking.model.effects.directed_effects import DIRECTED
from masking.model.effects.element_effects import ELEMENTS
from masking.model.effects.entry import FAMILIES, Effect, EffectParameter, EffectState
from masking.model.effects.instrument_effects import INSTRUMENTS
from masking.model.effects.series_effects import SERIES

EFFECTS: Final[dict[str, Effect]] = {effect.name: effect for effect in (*ELEMENTS, *SERIES, *DIRECTED, *INSTRUMENTS)}

# Effects that the package itself puts into a rig or reads out of a record.
FORCE, OFFSET = EFFECTS["constant_force"], EFFECTS["actuator_offset"]
GAINS_AND_ZEROS = ("sensor_gain", "sensor_offset", "actuator_gain", "actuator_offset")  # of every rig, a little off
CROSS_DAMPING = EFFECTS["cross_damping"]
LATE, DELAY, ROUNDING = EFFECTS["actuator_delay"], EFFECTS["delay"], EFFECTS["quantisation"]


def load(name_or_path: str | Path) -> dict[str, Effect]:
    """Effects of a dictionary, a packaged name or a file, by their names; a `DeclarationError` lists all problems."""
    return own(registry.load_dictionary(name_or_path))


def own(declaration: DictionaryDeclaration) -> dict[str, Effect]:
    """Effects that a dictionary declares, by their names.

    A `DeclarationError` lists all that have the name of an effect that comes with the package, or name a family or an
    effect that there is not.
    """
    problems = [problem for name in declaration.dictionary for problem in _problems(declaration, name)]
    if problems:
        raise DeclarationError(problems)
    return {name: _effect(name, effect) for name, effect in declaration.dictionary.items()}


def dictionary(declarations: Iterable[DictionaryDeclaration]) -> Mapping[str, Effect]:
    """Dictionary with the effects that others declare, by their names; refuses two effects of one name."""
    found = EFFECTS
    for declaration in declarations:
        more = own(declaration)
        if both := [name for name in more if name in found]:
            message = "the effect '{}' is in another dictionary, too"
            raise DeclarationError([_taken(declaration, name, message.format(name)) for name in both])
        found = {**found, **more}
    return found


def _problems(declaration: DictionaryDeclaration, name: str) -> Iterator[Problem]:
    """Give what is wrong with an effect beside those that come with the package."""
    effect, path = declaration.dictionary[name], f"dictionary.{name}"
    if name in EFFECTS:
        yield _taken(declaration, name, f"the effect '{name}' comes with the package, see 'masking show {name}'")
    if effect.family not in {"", *FAMILIES}:
        message = f"there is no family '{effect.family}'"
        yield problem_at(declaration, f"{path}.family", message, nearest(effect.family, FAMILIES))
    places: dict[str, str] = {known: entry.where for known, entry in EFFECTS.items()}
    places |= {known: entry.where for known, entry in declaration.dictionary.items()}
    for simpler in effect.nested:
        if simpler not in places:
            message = f"there is no effect '{simpler}'"
            yield problem_at(declaration, f"{path}.nested", message, nearest(simpler, places))
        elif places[simpler] != effect.where or simpler == name:
            yield problem_at(declaration, f"{path}.nested", f"'{simpler}' cannot be nested in '{name}'", "remove it")


def _taken(declaration: DictionaryDeclaration, name: str, message: str) -> Problem:
    return problem_at(declaration, f"dictionary.{name}", message, "choose another name", at_key=True)


def _effect(name: str, declared: OwnEffect) -> Effect:
    parameters = {
        key: EffectParameter(p.unit, p.meaning, value=p.value, bounds=p.bounds, tried=p.tried)
        for key, p in declared.parameters.items()
    }
    states = {
        key: EffectState(z.rate.text, z.unit, z.meaning, z.size.text if z.size else "")
        for key, z in declared.states.items()
    }
    return Effect(
        name, declared.meaning, declared.expression.text, parameters, declared.cause, declared.remedy,
        declared.source, states, declared.where, declared.family, declared.label,
        nested=declared.nested, absorbed_by=declared.absorbed_by,
        is_linear=declared.linear or bool(declared.absorbed_by),
    )  # fmt: skip
