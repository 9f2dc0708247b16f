"""Attaches effects to declared models, and gives the parts from which effects elsewhere are compiled.

The element's displacement, its rate, its acceleration and the force become definitions `<label>_d`, `<label>_v`,
`<label>_acc` and `<label>_f`; the parameters and states of the effect carry the label too. The parameter `<label>_on`
multiplies the force: at 0 the model is as before, and switching takes no compilation.
"""

from __future__ import annotations

import math
import numbers
import re
from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass, replace
from typing import Any

from masking.errors import DeclarationError, Problem, nearest
from masking.model.declaration.couplings import driven_outputs, has_own_force, has_rate
from masking.model.declaration.differentiate import rate_of
from masking.model.declaration.dimensions import check_dimensions, displacement_dimension, is_plain, symbol_dimensions
from masking.model.declaration.expression import Expression
from masking.model.declaration.fields import NAME_PATTERN
from masking.model.declaration.model_checks import check_model, equation_of, no_equation, velocities
from masking.model.declaration.schema import Element, ModelDeclaration, Parameter, State
from masking.model.declaration.units import Dimension, describe, dimension_of
from masking.model.effects.dictionary import EFFECTS
from masking.model.effects.entry import Effect, EffectParameter

# A number in the parameter's unit, an expression over the model's parameters, or either with a unit:
# {"value": 5.8, "unit": "mm"}.
Setting = float | str | Expression | Mapping[str, Any]

_SUBJECTS = {"sensor": "s", "actuator": "u"}


def find(name: str | Effect) -> Effect:
    """Effect by its name in the dictionary, or an entry as it is; a `DeclarationError` names the nearest."""
    if isinstance(name, Effect):
        return name
    if name not in EFFECTS:
        raise _refusal("", f"there is no effect '{name}'", nearest(name, EFFECTS))
    return EFFECTS[name]


def expressions(name: str | Effect) -> tuple[Expression, dict[str, Expression]]:
    """Expression of an effect, switch included, and the rates of its states.

    The symbols are those of the dictionary and `on`, the switch: on * f in an element, s + on * (g - s) in a sensor
    whose effect is g, and in an actuator the same with u. Raises a `DeclarationError` where there is no such effect, or
    it has no expression.
    """
    effect = find(name)
    if not effect.expression:
        raise _refusal("", f"the effect '{effect.name}' has no expression: it makes commands late")
    subject = _SUBJECTS.get(effect.where)
    text = f"on*({effect.expression})" if subject is None else f"{subject} + on*({effect.expression} - {subject})"
    rates = {state: Expression(z.rate, path=f"{effect.name}.{state}") for state, z in effect.states.items()}
    return Expression(text, path=effect.name), rates


def unit_of(template: str, units: Mapping[str, str]) -> str:
    """Coherent SI unit of a template such as `F/D`, with units such as `{"F": "m/s**2", "D": "m"}` for its letters."""
    return describe(dimension_of(Expression(template).renamed({name: f"({u})" for name, u in units.items()})))


def parameters(
    name: str | Effect, label: str, given: Mapping[str, Setting], units: Mapping[str, str]
) -> dict[str, Parameter]:
    """Parameters of an effect as a model declares them, named `<label>_<parameter>`, with `<label>_on`.

    Values are given by short names, numbers in coherent SI units; `units` are those of the place, as for `unit_of`. A
    `DeclarationError` lists all parameters that are not known, are missing or have a wrong unit or value.
    """
    effect = find(name)
    known = effect.parameters
    none = f"the effect '{effect.name}' has no parameter"
    unknown = [key for key in given if key not in known]
    problems = [Problem(None, label, f"{none} '{key}'", nearest(key, known)) for key in unknown]
    found = {f"{label}_on": Parameter(value=1.0, meaning=f"switch of {label}: 1 is on, 0 is off", bounds=(0.0, 1.0))}
    missing = []
    for key, entry in known.items():
        unit = unit_of(entry.unit, units)
        setting = given.get(key, entry.value)
        if setting is None:
            such = "" if entry.nominal is None else f", such as {entry.nominal:g}"
            missing.append(f"{key} in {unit} ({entry.meaning}{such})")
            continue
        try:
            found[f"{label}_{key}"] = _parameter(f"{label}.{key}", entry, unit, setting)
        except DeclarationError as error:
            problems += error.problems
    if missing:
        problems.append(Problem(None, label, f"the effect '{effect.name}' needs values", f"give {', '.join(missing)}"))
    if problems:
        raise DeclarationError(problems)
    return found


def attach(
    declaration: ModelDeclaration,
    effect: str | Effect,
    at: str,
    label: str | None = None,
    parameters: Mapping[str, Setting] | None = None,
) -> ModelDeclaration:
    """Model with an effect in one of its elements.

    Args:
        declaration: the model.
        effect: an effect that sits in an element, or its name in the dictionary.
        at: the element.
        label: stands before the names of the effect's parameters and states; by default `<at>_<effect>`.
        parameters: values of the effect's parameters by their short names: numbers in coherent SI units, expressions
            over the model's parameters, or either with a unit, `{"value": 5.8, "unit": "mm"}`.

    Raises:
        DeclarationError: the effect, the element or a parameter is not known, a value is missing, or the model that
            results is wrong; says how to correct it.
    """
    return attach_all(declaration, [Attachment(effect, at, label, parameters or {})])


@dataclass(frozen=True)
class Attachment:
    """One effect to attach: the arguments of `attach`."""

    effect: str | Effect
    at: str
    label: str | None
    parameters: Mapping[str, Setting]


def attach_all(declaration: ModelDeclaration, attachments: Iterable[Attachment]) -> ModelDeclaration:
    """Model with effects in its elements, one after the other; see `attach`."""
    dimensions, result = symbol_dimensions(declaration), declaration
    if dimensions is None:
        raise DeclarationError(check_dimensions(declaration))
    for attachment in attachments:
        result = _with_effect(result, attachment, dimensions)
    problems = check_model(result) or check_dimensions(result) if result is not declaration else []
    if problems:
        raise DeclarationError(problems)
    return result


def with_own(declaration: ModelDeclaration) -> ModelDeclaration:
    """Model with the effects that it declares, in its elements; a DeclarationError lists those that do not fit."""
    bare = declaration.model_copy(update={"effects": {}})
    problems = list[Problem]()
    for name, use in declaration.effects.items():
        given = {key: x.text if isinstance(x, Expression) else x for key, x in use.parameters.items()}
        labels = [(at, f"{name}_{at}" if len(use.at) > 1 else name) for at in use.at]
        try:
            if not use.at:
                remedy = f"write 'at: {next(iter(declaration.elements), 'an element, and declare it under elements')}'"
                raise _refusal("", f"the effect {use.effect} needs a place: which element", remedy)
            if use.enabled:
                bare = attach_all(bare, [Attachment(use.effect, at, label, given) for at, label in labels])
        except DeclarationError as error:
            path = f"effects.{name}"
            problems += [replace(one, place=declaration.key_place(path), path=path) for one in error.problems]
    if problems:
        raise DeclarationError(problems)
    return bare


def _with_effect(
    declaration: ModelDeclaration, attachment: Attachment, dimensions: Mapping[str, Dimension | None]
) -> ModelDeclaration:
    """Model with one more effect; `dimensions` are those of the symbols that its elements may use."""
    whole, at, label = find(attachment.effect), attachment.at, attachment.label
    entry = whole.reduced(attachment.parameters)
    given = {n: x for n, x in attachment.parameters.items() if n in entry.parameters or n not in whole.parameters}
    element = _element(declaration, entry, at)
    label = f"{at}_{entry.name}" if label is None else label
    _check_label(declaration, label)
    units = _units(declaration, element, at, dimensions)
    names = {key: f"{label}_{key}" for key in (*entry.parameters, *entry.states)}
    names |= {"d": f"{label}_d", "d_rate": f"{label}_v", "d_acc": f"{label}_acc"}
    force, taken = Expression(entry.expression, path=label), Expression(entry.takes_rate or "0", path=label)
    rates = {state: Expression(e.rate, path=label) for state, e in entry.states.items()}
    inner = frozenset[str]().union(*(rate.names for rate in rates.values()))
    motion = _motion(declaration, entry, at, label, force.names | taken.names | inner)
    # What is in series reads the motion in the force of its element; its states read it in equations of their own.
    used = inner if entry.attaches == "in_series" else force.names | inner
    definitions = {names[key]: e for key, e in motion.items() if key in used}
    if entry.attaches != "in_series":
        definitions[f"{label}_f"] = Expression(f"{label}_on*({force.renamed(names)})", path=label)
    if entry.attaches == "beside":
        changed = _with_force(declaration, element, f"{label}_f")
    else:
        law = _in_series(declaration, entry, at, label)
        changed = declaration.model_copy(update={"elements": {**declaration.elements, at: law}})
    new_states = {
        names[state]: State(
            meaning=f"{e.meaning}, {label}",
            unit=unit_of(e.unit, units),
            size=Expression(e.size, path=label).renamed(names) if e.size else None,
        )
        for state, e in entry.states.items()
    }
    sides = [(f"{names[state]}'", rate.renamed(names)) for state, rate in rates.items()]
    added: dict[str, dict[Any, Any]] = {"states": new_states, "parameters": parameters(entry, label, given, units)}
    added["definitions"] = definitions
    for section in ("coordinates", "states", "inputs", "parameters", "definitions", "elements"):
        known = getattr(declaration, section)
        if clash := [name for new in added.values() for name in new if name in known]:
            raise _refusal(label, f"the name '{clash[0]}' is already used in {section}", "give another label")
    added["equations"] = {Expression(left, path=label): Expression(right, path=label) for left, right in sides}
    return changed.model_copy(update={key: {**getattr(changed, key), **more} for key, more in added.items()})


def _in_series(declaration: ModelDeclaration, effect: Effect, at: str, label: str) -> Element:
    """Element whose own force an effect takes part of its motion from, or takes the place of."""
    element = declaration.elements[at]
    what = "in series with" if effect.attaches == "in_series" else "in the place of"
    message = f"the effect '{effect.name}' stands {what} an element's own force, and "
    if element.force is None:
        remedy = f"give elements.{at}.force, such as k*d + c*d_rate, and take these terms out of the equations"
        raise _refusal(at, f"{message}'{at}' declares none", remedy)
    if not has_own_force(declaration, element):
        remedy = "write it over d, d_rate and parameters alone"
        raise _refusal(at, f"{message}that of '{at}' has definitions that hold coordinates", remedy)
    if effect.attaches == "instead":
        text = f"(1 - {label}_on)*({element.force.text}) + {label}_f"
    else:
        names = {key: f"{label}_{key}" for key in (*effect.parameters, *effect.states)}
        lost = [Expression(part).renamed(names) for part in (effect.expression, effect.takes_rate)]
        motion = {key: f"({key} - {label}_on*({x}))" for key, x in zip(("d", "d_rate"), lost, strict=True)}
        text = element.force.renamed(motion)
    return element.model_copy(update={"force": Expression(text, path=f"elements.{at}.force")})


def _motion(
    declaration: ModelDeclaration, effect: Effect, at: str, label: str, used: Set[str]
) -> dict[str, Expression]:
    """Motion that an effect follows in an element: displacement, rate and acceleration, as far as used."""
    element, found = declaration.elements[at], dict[str, Expression]()
    what = f"the effect '{effect.name}' follows"
    if element.displacement is not None:
        found["d"] = Expression(element.displacement.text, path=f"{label}.displacement")
    elif "d" in used:
        raise _refusal(at, f"{what} a displacement, and '{at}' has none", f"give elements.{at}.displacement")
    if element.rate is not None:
        found["d_rate"] = Expression(element.rate.text, path=f"{label}.rate")
    elif element.displacement is not None and has_rate(declaration, element):
        found["d_rate"] = Expression(rate_of(element.displacement, declaration.coordinates), path=label)
    elif used & {"d_rate", "d_acc"}:
        remedy = f"give elements.{at}.rate, how fast it is stretched"
        raise _refusal(at, f"{what} a rate, and that of '{at}' is not known from coordinates", remedy)
    if effect.is_inertia:
        if found["d_rate"].names & {*declaration.states, *declaration.inputs}:
            remedy = "an inertia needs an element whose displacement is made of coordinates"
            raise _refusal(at, f"{what} an acceleration, and that of '{at}' is not known", remedy)
        moving = [*declaration.coordinates, *velocities(declaration.coordinates)]
        found["d_acc"] = Expression(rate_of(found["d_rate"], moving), path=label)
    return found


def _element(declaration: ModelDeclaration, effect: Effect, at: str) -> Element:
    if effect.where != "element":
        place = {"sensor": "a sensor", "actuator": "an actuator", "loop": "the loop"}[effect.where]
        message = f"the effect '{effect.name}' sits in {place}, not in an element of a model"
        raise _refusal(at, message, "declare it in a plant")
    if at not in declaration.elements:
        remedy = nearest(at, declaration.elements) if declaration.elements else "declare it under elements"
        raise _refusal(at, f"{declaration.name} has no element '{at}'", remedy)
    return declaration.elements[at]


def _check_label(declaration: ModelDeclaration, label: str) -> None:
    if not re.fullmatch(NAME_PATTERN, label):
        remedy = "a label is made of ASCII letters, digits and _, and starts with a letter"
        raise _refusal(label, f"'{label}' is not a label", remedy)
    if f"{label}_on" in declaration.parameters:
        raise _refusal(label, f"there is already an effect '{label}'", "give this one another label")


def _units(
    declaration: ModelDeclaration, element: Element, at: str, symbols: Mapping[str, Dimension | None]
) -> dict[str, str]:
    """Units that stand for F, D and s in an element."""
    if is_plain(declaration):
        return {"F": "1", "D": "1", "s": "1"}
    moved = displacement_dimension(element, symbols)
    if moved is None or symbols["t"] is None:
        raise _refusal(f"elements.{at}.displacement", "the displacement has no unit")
    return {"F": element.unit, "D": _written(moved), "s": _written(symbols["t"])}


def _written(dimension: Dimension | None) -> str:
    return "1" if dimension is None else describe(dimension)


def _parameter(path: str, entry: EffectParameter, unit: str, setting: Setting) -> Parameter:
    value: object = setting
    if isinstance(setting, Mapping):
        if not {"value"} <= setting.keys() <= {"value", "unit"}:
            raise _refusal(path, "a value is a number, an expression or {value, unit}")
        value, wanted = setting["value"], dimension_of(unit)
        if dimension_of(str(setting.get("unit", unit))) != wanted:
            raise _refusal(path, f"the unit {setting['unit']} is not one of {unit}", f"give a value in {unit}")
        unit = str(setting.get("unit", unit))
    if isinstance(value, str):
        value = Expression(value, path=path)
    if isinstance(value, bool) or not isinstance(value, numbers.Real | Expression):
        raise _refusal(path, f"a value is a number, an expression or {{value, unit}}, not {value!r}")
    if not isinstance(value, Expression):
        value = float(value)
        if not math.isfinite(value):
            raise _refusal(path, f"the value is {value}, not finite")
    return Parameter(value=value, unit=unit, meaning=entry.meaning, bounds=entry.bounds)


def _with_force(declaration: ModelDeclaration, element: Element, force: str) -> ModelDeclaration:
    """Model in which a force acts as its element says."""
    forces, equations, outputs = dict(declaration.forces), dict(declaration.equations), dict(declaration.outputs)
    driven = driven_outputs(declaration)
    for name, factor in element.acts.items():
        left = equation_of(declaration, name)
        if name in driven:
            expression = _sum(outputs[name].expression, factor, force)
            outputs[name] = outputs[name].model_copy(update={"expression": expression})
        elif left is not None:
            equations[left] = _sum(equations[left], factor, force)
        elif declaration.lagrangian is not None:
            forces[name] = _sum(forces.get(name), factor, force)
        else:
            raise DeclarationError(no_equation(declaration, name, f"coordinates.{name}"))
    return declaration.model_copy(update={"forces": forces, "equations": equations, "outputs": outputs})


def _sum(before: Expression | None, factor: Expression, force: str) -> Expression:
    """Expression with a force times a factor added; what was there keeps its place in its file."""
    signs = {"1": f"+ {force}", "-1": f"- {force}"}
    term = signs.get(factor.text.strip(), f"+ ({factor.text})*{force}")
    return Expression(term.removeprefix("+ ")) if before is None else replace(before, text=f"{before.text} {term}")


def _refusal(path: str, message: str, remedy: str = "") -> DeclarationError:
    return DeclarationError(Problem(None, path, message, remedy))
