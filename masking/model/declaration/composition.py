"""Several plants as one: the declarations of rigs that run side by side, with the name of its plant before each name.

The coordinate `x` of the plant `a` is `a_x` in the whole: in a transform, in `initial`, in columns and in exports.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from masking.errors import DeclarationError, Problem
from masking.model.declaration.expression import Expression
from masking.model.declaration.schema import Declaration, ModelDeclaration, PlantDeclaration
from masking.model.declaration.schema_errors import read
from masking.model.declaration.strict_yaml import Places

_NAMED = ("coordinates", "states", "inputs", "parameters", "definitions", "outputs", "elements")
# What is one expression for the whole model, and the sum of those of its parts.
_SUMMED = ("lagrangian", "dissipation", "energy")


@dataclass(frozen=True)
class Part:
    """One of several plants, with its model; `name` stands before its names."""

    name: str
    plant: PlantDeclaration
    model: ModelDeclaration

    def called(self, name: str) -> str:
        """Return what one of its names is in the whole."""
        return f"{self.name}_{name}"

    @property
    def names(self) -> dict[str, str]:
        """Return what each name in its expressions is in the whole, derivatives included."""
        own = {name for section in _NAMED for name in getattr(self.model, section)}
        own |= {*self.plant.actuators, *self.plant.sensors}
        return {name + primes: self.called(name) + primes for name in own for primes in ("", "'", "''")}

    def written(self, value: Any) -> Any:  # noqa: ANN401  (a number or an expression, as plain data)
        """Value with the names of the whole."""
        return Expression(value).renamed(self.names) if isinstance(value, str) else value


def compose(parts: Iterable[Part]) -> tuple[PlantDeclaration, ModelDeclaration]:
    """Several plants as one, and their models as one.

    Raises:
        DeclarationError: two names are the same, or what the plants share differs, such as the delay of the loop.
    """
    parts = list(parts)
    model, plant = _model(parts), _plant(parts)
    # Each model was checked by itself. In the whole, a parameter that only its own scales use is one that nothing uses.
    made = read(ModelDeclaration, model, Places(), _files(part.model for part in parts), lambda *_: [])
    whole = read(PlantDeclaration, plant, Places(), _files(part.plant for part in parts), lambda *_: [])
    own = {tuple(one.files): one for part in parts for one in part.plant.dictionaries}
    return whole.with_dictionaries(*own.values()), made


def _model(parts: list[Part]) -> dict[str, Any]:
    all_data = {part.name: part.model.canonical() for part in parts}
    made: dict[str, Any] = {"name": _title(parts, lambda part: part.model.name)}
    sections: dict[str, Callable[[Part, Any], Any]] = {
        "coordinates": lambda part, entry: entry,
        "states": lambda part, entry: {**entry, **({"size": part.written(entry["size"])} if "size" in entry else {})},
        "inputs": lambda part, entry: entry,
        "parameters": _with("value"),
        "outputs": _with("expression"),
        "definitions": Part.written,
        "elements": _element,
        "forces": Part.written,
    }
    for section, change in sections.items():
        made[section] = _joined(parts, section, {n: data.get(section, {}) for n, data in all_data.items()}, change)
    sides = [(part, both) for part in parts for both in all_data[part.name].get("equations", {}).items()]
    made["equations"] = {part.written(left): part.written(right) for part, (left, right) in sides}
    for part in parts:  # a Lagrangian is not joined to equations of motion
        if (part.model.lagrangian is None) != (parts[0].model.lagrangian is None):
            message = f"{part.model.name} and {parts[0].model.name}: one has a Lagrangian, one equations of motion"
            raise DeclarationError(Problem(None, f"plants.{part.name}", message, "write both in the same way"))
    for key in _SUMMED:
        given = [(part, data[key]) for part in parts if key in (data := all_data[part.name])]
        if given and (key == "dissipation" or len(given) == len(parts)):
            made[key] = " + ".join(f"({part.written(text)})" for part, text in given)
    made["scales"] = _shared(parts, "scales", [data.get("scales", {}) for data in all_data.values()])
    made["scales"] = {key: _with("value")(parts[0], scale) for key, scale in made["scales"].items()}
    if any(part.model.oscillators for part in parts):
        own = [(part, part.model.oscillators or part.model.coordinates) for part in parts]
        made["oscillators"] = [part.called(name) for part, names in own for name in names]
    return {key: value for key, value in made.items() if value}


def _plant(parts: list[Part]) -> dict[str, Any]:
    all_data = {part.name: part.plant.canonical() for part in parts}
    made: dict[str, Any] = {"name": _title(parts, lambda part: part.plant.name), "model": " + ".join(all_data)}
    sections: dict[str, Callable[[Part, Any], Any]] = {
        "parameters": lambda part, value: value,
        "sensors": _with("measures"),
        "actuators": lambda part, entry: entry,
        "allocation": Part.written,
    }
    for section, change in sections.items():
        made[section] = _joined(parts, section, {n: data.get(section, {}) for n, data in all_data.items()}, change)
    with_own = [part for part in parts if part.plant.actuators]
    for part in parts if with_own else ():  # one that commands the inputs of its model is not joined to these
        if not part.plant.actuators and part.model.inputs:
            message = f"{part.plant.name} declares no actuators, {with_own[0].plant.name} does"
            remedy = "write actuators and allocation into both"
            raise DeclarationError(Problem(part.plant.place("name"), f"plants.{part.name}", message, remedy))
    limits = {name: data.get("limits", {}) for name, data in all_data.items()}
    inputs = _joined(parts, "limits.inputs", {n: x.get("inputs", {}) for n, x in limits.items()}, lambda _, x: x)
    made["limits"] = {"inputs": inputs}
    for key in ("coordinates", "velocities"):
        made["limits"][key] = {
            part.written(text): limit for part in parts for text, limit in limits[part.name].get(key, {}).items()
        }
    shared = _shared(parts, "limits.power", [x.get("power") for x in limits.values()])
    made["limits"] |= {"power": shared} if shared else {}
    stop = _shared(parts, "limits.stop", [x.get("stop") for x in limits.values()])
    made["limits"] |= {"stop": stop} if stop else {}
    missed = [x["missed"] for x in limits.values() if "missed" in x]  # one loop, which is held to the least
    made["limits"] |= {"missed": min(missed)} if missed else {}
    made["own_effects"] = list(dict.fromkeys(one for part in parts for one in part.plant.own_effects))
    made["effects"] = _effects(parts, {name: data.get("effects", {}) for name, data in all_data.items()})
    made |= {"arm": "operator"} if any(part.plant.arm for part in parts) else {}
    return {key: value for key, value in made.items() if value}


def _effects(parts: list[Part], given: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Effects of all; those of the loop, which have no place, are shared, since a loop has one delay."""
    loop = [{name: entry for name, entry in given[part.name].items() if not entry.get("at")} for part in parts]
    made = dict(_shared(parts, "effects of the loop", loop))
    for part in parts:
        for name, entry in given[part.name].items():
            if not entry.get("at"):
                continue
            at = entry["at"] if isinstance(entry["at"], list | tuple) else [entry["at"]]
            own = {key: part.written(value) for key, value in entry.get("parameters", {}).items()}
            made[part.called(name)] = {**entry, "at": [part.called(place) for place in at], "parameters": own}
    return made


def _with(key: str) -> Callable[[Part, Any], Any]:
    """Change of an entry that holds one expression."""

    def change(part: Part, entry: Any) -> Any:  # noqa: ANN401
        return {**entry, key: part.written(entry[key])}

    return change


def _element(part: Part, entry: Mapping[str, Any]) -> dict[str, Any]:
    """Element; its own force is over its displacement `d` and rate, which keep their names."""
    made = dict(entry)
    for key in {"displacement", "rate"} & made.keys():
        made[key] = part.written(made[key])
    if "force" in made:
        own = {name: whole for name, whole in part.names.items() if name not in {"d", "d_rate"}}
        made["force"] = Expression(made["force"]).renamed(own)
    made["acts"] = {part.called(name): part.written(text) for name, text in made.get("acts", {}).items()}
    return made


def _joined(
    parts: list[Part], section: str, given: Mapping[str, Mapping[str, Any]], change: Callable[[Part, Any], Any]
) -> dict[str, Any]:
    """Section with the entries of all parts, no two of which have one name."""
    made: dict[str, Any] = {}
    for part in parts:
        for name, entry in given[part.name].items():
            whole = part.called(name)
            if whole in made:
                message = f"{section}: '{whole}' of {part.name} is also that of another plant"
                raise DeclarationError(Problem(None, f"plants.{part.name}", message, "give the plants other names"))
            made[whole] = change(part, entry)
    return made


def _shared(parts: list[Part], what: str, given: list[Any]) -> Any:  # noqa: ANN401
    """Return what must be the same in all parts."""
    for part, one in zip(parts[1:], given[1:], strict=True):
        if one != given[0]:
            message = f"{what}: not those of {parts[0].name}; plants in one loop share them"
            remedy = f"write the same into {part.plant.name} and {parts[0].plant.name}"
            raise DeclarationError(Problem(None, f"plants.{part.name}", message, remedy))
    return given[0]


def _files(declarations: Iterable[Declaration]) -> dict[str, str]:
    return {file: digest for one in declarations for file, digest in one.files.items()}


def _title(parts: list[Part], name: Callable[[Part], str]) -> str:
    return " and ".join(f"{name(part)} {part.name}" for part in parts)
