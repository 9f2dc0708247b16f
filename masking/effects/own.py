"""Effects of one's own: those that a file declares, beside the dictionary that comes with the package.

They are values: a plant carries those of the dictionaries that it names, and nothing is registered anywhere.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from masking.declaration import registry
from masking.declaration.checks import problem_at
from masking.declaration.dictionary import factors
from masking.declaration.schema import DictionaryDeclaration, OwnEffect
from masking.effects.entries import EFFECTS
from masking.effects.entry import Effect, EffectParameter, EffectState
from masking.errors import DeclarationError, Problem


def load(name_or_path: str | Path) -> dict[str, Effect]:
    """Return the effects of a dictionary, a packaged name or a file, by their names.

    Raises:
        DeclarationError: the file is wrong; lists all problems.
    """
    return own(registry.load_dictionary(name_or_path))


def own(declaration: DictionaryDeclaration) -> dict[str, Effect]:
    """Return the effects that a dictionary declares, by their names.

    Raises:
        DeclarationError: one has the name of an effect that comes with the package.
    """
    problems = [
        _taken(declaration, name, f"the effect '{name}' comes with the package, see 'masking show {name}'")
        for name in declaration.dictionary
        if name in EFFECTS
    ]
    if problems:
        raise DeclarationError(problems)
    return {name: _effect(name, effect) for name, effect in declaration.dictionary.items()}


def dictionary(declarations: Iterable[DictionaryDeclaration]) -> Mapping[str, Effect]:
    """Return the dictionary with the effects that others declare, by their names.

    Raises:
        DeclarationError: two effects have one name.
    """
    found = EFFECTS
    for declaration in declarations:
        more = own(declaration)
        problems = [
            _taken(declaration, name, f"the effect '{name}' is in another dictionary, too")
            for name in more
            if name in found
        ]
        if problems:
            raise DeclarationError(problems)
        found = {**found, **more}
    return found


def _taken(declaration: DictionaryDeclaration, name: str, message: str) -> Problem:
    return problem_at(declaration, f"dictionary.{name}", message, "choose another name", at_key=True)


def _effect(name: str, declared: OwnEffect) -> Effect:
    parameters = {
        key: EffectParameter(p.unit, p.meaning, None, None, p.value, p.bounds, p.tried)
        for key, p in declared.parameters.items()
    }
    states = {
        key: EffectState(z.rate.text, z.unit, z.meaning, z.size.text if z.size else "")
        for key, z in declared.states.items()
    }
    return Effect(
        name,
        declared.meaning,
        declared.where,
        declared.expression.text,
        parameters,
        declared.cause,
        declared.remedy,
        declared.source,
        states,
        factors(declared),
    )
