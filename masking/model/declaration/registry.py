"""Loading declarations: the packaged ones by name, any file by path, `extends` and `own_effects` resolved."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from masking.errors import DeclarationError, Place, Problem, nearest
from masking.model.declaration import strict_yaml
from masking.model.declaration.catalogue import NOWHERE, Reference, files, find, kind_of_keys, wrong_kind
from masking.model.declaration.composition import Part, compose
from masking.model.declaration.dictionary_checks import check_dictionary
from masking.model.declaration.dimensions import check_dimensions, check_scales
from masking.model.declaration.experiment_checks import check_experiment, check_plant
from masking.model.declaration.fields import Real, Text
from masking.model.declaration.input_definitions import check_inputs, with_inputs
from masking.model.declaration.model_checks import check_model
from masking.model.declaration.plant_units import check_experiment_units, check_plant_units
from masking.model.declaration.repetition import repeated
from masking.model.declaration.schema import (
    BatchDeclaration,
    Declaration,
    DictionaryDeclaration,
    ExperimentDeclaration,
    ModelDeclaration,
    PlantDeclaration,
)
from masking.model.declaration.schema_errors import in_order, plain_mapping, read
from masking.model.declaration.shorthand import SHORT
from masking.model.declaration.strict_yaml import Node, Places

D = TypeVar("D", bound=Declaration)

_MERGED = {*SHORT, "definitions", "equations", "forces", "scales", "elements", "events"}


@dataclass(frozen=True, slots=True)
class Assembly:
    """An experiment with all that it refers to, checked together; the controller assumes `controller_model`."""

    experiment: ExperimentDeclaration
    plant: PlantDeclaration
    plant_model: ModelDeclaration
    virtual_model: ModelDeclaration
    controller_model: ModelDeclaration
    declared_virtual: ModelDeclaration  # the virtual system with its inputs as its file declares them


def load_model(name_or_path: str | Path, reference: Reference = NOWHERE) -> ModelDeclaration:
    """Load a model with all that it extends as one declaration; a `DeclarationError` lists and places problems."""
    chain: list[tuple[Path, Node, dict[str, Any]]] = []
    files: dict[str, str] = {}
    refused: list[Problem] = []
    wanted: str | Path | None = name_or_path
    while wanted is not None:
        path = find("model", wanted, reference)
        if path.resolve() in [link[0].resolve() for link in chain]:
            loop = " -> ".join([*(link[0].stem for link in chain), path.stem])
            raise DeclarationError(Problem(reference.place, reference.path, f"extends itself: {loop}"))
        node, digest, _ = _read_file("model", path, str(wanted), reference, refused)
        data = plain_mapping(node)
        if chain or "extends" in data:
            _read_alone(ModelDeclaration, node, data, refused)
        chain.append((path, node, data))
        files[str(path)] = digest
        wanted = str(data["extends"]) if data.get("extends") is not None else None
        if wanted is not None:
            reference = Reference(data["extends"].node.place, "extends", path.parent, reference.counts)
    places = Places()
    _, node, merged = chain.pop()
    places.add(node)
    while chain:
        _, node, data = chain.pop()
        merged = _extended(merged, data)
        places.add(node)
        for section, key in SHORT.items():
            for name, entry in data.get(section, {}).items():
                if not isinstance(entry, dict):
                    places.values[f"{section}.{name}.{key}"] = places.values[f"{section}.{name}"]
    return read(ModelDeclaration, merged, places, files, check_model, refused=refused)


def load_plant(name_or_path: str | Path, reference: Reference = NOWHERE) -> PlantDeclaration:
    """Load a plant with the dictionaries that it names; its model is a file of its own."""
    plant = _load(PlantDeclaration, name_or_path, reference)
    for i, name in enumerate(plant.own_effects):
        plant = with_dictionary(plant, name, replace(refer(plant, f"own_effects.{i}"), path="own_effects"))
    return plant


def load_dictionary(name_or_path: str | Path, reference: Reference = NOWHERE) -> DictionaryDeclaration:
    """Load a dictionary of own effects."""
    return _load(DictionaryDeclaration, name_or_path, reference, check_dictionary)


def with_dictionary(
    plant: PlantDeclaration, name_or_path: str | Path, reference: Reference = NOWHERE
) -> PlantDeclaration:
    """Plant that names one more dictionary of own effects; one that it has read already is not read anew."""
    file = find("dictionary", name_or_path, reference).resolve()
    if any(Path(known).resolve() == file for own in plant.dictionaries for known in own.files):
        return plant
    return plant.with_dictionaries(load_dictionary(name_or_path, reference))


def check_plant_file(name_or_path: str | Path) -> PlantDeclaration:
    """Load a plant, checked against its model with units; a `DeclarationError` lists every problem with its place."""
    plant = load_plant(name_or_path)
    model = load_model(plant.model, refer(plant, "model"))
    problems = check_plant(plant, model) + check_dimensions(model) + check_scales(model)
    problems += check_plant_units(plant, model)
    if problems:
        raise DeclarationError(in_order(problems))
    return plant


def load_experiment(name_or_path: str | Path, reference: Reference = NOWHERE) -> ExperimentDeclaration:
    """Load an experiment; its plant and its virtual system are files of their own."""
    return _load(ExperimentDeclaration, name_or_path, reference, _check_plants)


def load_batch(name_or_path: str | Path) -> BatchDeclaration:
    """Load a batch of runs; its experiment is a file of its own."""
    return _load(BatchDeclaration, name_or_path, NOWHERE)


def _check_plants(experiment: ExperimentDeclaration, is_whole: bool, lost: Collection[str]) -> list[Problem]:
    """List what is wrong with the plants that an experiment names: it has one, or several together."""
    path, remedy = "plants", "name one plant with plant, or several with plants, such as 'plants: {a: cart, b: cart}'"
    place = experiment.key_place(path)
    if experiment.plant is None and not experiment.plants and not {"plant", "plants"} & {*lost} and is_whole:
        return [Problem(experiment.place(""), "plant", "the key 'plant' is missing", remedy)]
    if experiment.plant is not None and experiment.plants:
        return [Problem(place, path, "plant and plants are both given", remedy)]
    if len(experiment.plants) == 1:
        return [Problem(place, path, "plants are at least two", remedy)]
    return []


def name_from(declaration: Declaration, start: Path | None = None) -> str:
    """How a file in a folder names a declaration: by its packaged name, or by its path, whole without a folder."""
    file = Path(next(iter(declaration.files), declaration.name)).resolve()
    packaged = files(declaration.kind_name).get(file.stem)
    if packaged is not None and packaged.resolve() == file:
        return file.stem
    return str(file) if start is None else os.path.relpath(file, start.resolve())


def content_from(assembly: Assembly, start: Path) -> dict[str, Any]:
    """Content of an experiment's file for a folder, from which it names other files."""
    declared = assembly.experiment
    made = canonical(declared)
    made["virtual"] = name_from(assembly.virtual_model, start)
    if declared.plants:
        made["plants"] = {part.name: name_from(part.plant, start) for part in parts(declared)}
    else:
        made["plant"] = name_from(assembly.plant, start)
    if declared.controller.model is not None:
        made["controller"]["model"] = name_from(assembly.controller_model, start)
    return made


def canonical(experiment: ExperimentDeclaration) -> dict[str, Any]:
    """Experiment as JSON can hold it, which names the files of its inputs by their whole paths."""
    made = experiment.canonical()
    for name, source in experiment.inputs.items():
        if source.file is not None:
            folder = refer(experiment, f"inputs.{name}").folder
            made["inputs"][name]["file"] = str(((folder or Path()) / source.file).resolve())
    return made


def restored(declared: Mapping[str, Any]) -> Assembly:
    """Assembly from what the manifest of its run declares; of its files, only those of inputs are needed.

    A DeclarationError where the manifest is of another version of this program.
    """
    for name in ("experiment", "plant", "plant_model", "virtual", "controller_model"):
        if not isinstance(declared.get(name), dict):
            raise DeclarationError(Problem(None, name, "is not declared", "another version of this program wrote it"))

    def own(kind: type[D], content: Mapping[str, Any]) -> D:
        return read(kind, dict(content), Places(), {}, lambda *_: [])

    experiment, plant = own(ExperimentDeclaration, declared["experiment"]), own(PlantDeclaration, declared["plant"])
    plant = plant.with_dictionaries(*(own(DictionaryDeclaration, one) for one in declared.get("dictionaries", ())))
    names = ("plant_model", "virtual", "controller_model")
    rig, virtual, assumed = (own(ModelDeclaration, declared[name]) for name in names)
    return Assembly(experiment, plant, rig, virtual, assumed, virtual)


def changed_experiment(experiment: ExperimentDeclaration, sections: Mapping[str, object]) -> ExperimentDeclaration:
    """Experiment with some sections of its file replaced, checked as if the file said so."""
    data, places = {**experiment.canonical(), **sections}, experiment._places.without(sections)
    made = read(ExperimentDeclaration, data, places, experiment.files, _check_plants)
    made._counts = experiment._counts
    return made


def assemble(
    experiment: ExperimentDeclaration,
    plant: str | None = None,
    known: Assembly | None = None,
    sections: Collection[str] = (),
) -> Assembly:
    """Load all that an experiment refers to, `plant` in place of its own; a `DeclarationError` lists misfits.

    Of what is `known`, only the files that the `sections` name are read anew.
    """
    if known is None or {"plant", "plants"} & {*sections}:
        rig, plant_model = _rig(experiment, plant)
    else:
        rig, plant_model = known.plant, known.plant_model
    if known is None or "virtual" in sections:
        declared = load_model(experiment.virtual, refer(experiment, "virtual"))
    else:
        declared = known.declared_virtual
    controller_model, assumed = plant_model, experiment.controller.model
    if assumed and known is not None and assumed == known.experiment.controller.model:
        controller_model = known.controller_model
    elif assumed:
        controller_model = load_model(assumed, refer(experiment, "controller.model"))
    problems = check_experiment(experiment, rig, plant_model, declared, controller_model)
    problems += check_inputs(experiment, rig, plant_model, declared)
    if problems:
        raise DeclarationError(in_order(problems))
    virtual = with_inputs(declared, experiment.inputs)
    return Assembly(experiment, rig, plant_model, virtual, controller_model, declared)


def changed_assembly(known: Assembly, sections: Mapping[str, object]) -> Assembly:
    """Assembly with some sections of the experiment's file replaced, checked as if the file said so."""
    return assemble(changed_experiment(known.experiment, sections), None, known, sections)


def parts(experiment: ExperimentDeclaration) -> list[Part]:
    """Load the plants that an experiment runs together, each with its model."""
    plants = ((name, load_plant(file, refer(experiment, f"plants.{name}"))) for name, file in experiment.plants.items())
    return [Part(name, plant, load_model(plant.model, refer(plant, "model"))) for name, plant in plants]


def _rig(experiment: ExperimentDeclaration, plant: str | None) -> tuple[PlantDeclaration, ModelDeclaration]:
    """Load what an experiment drives, and its model; `plant` replaces it."""
    if plant is None and experiment.plants:
        found = parts(experiment)
        problems = [problem for part in found for problem in check_plant(part.plant, part.model)]
        if problems:
            raise DeclarationError(in_order(problems))
        return compose(found)
    reference = Reference(counts=experiment._counts) if plant else refer(experiment, "plant")
    rig = load_plant(plant or experiment.plant or "", reference)
    return rig, load_model(rig.model, refer(rig, "model"))


def check_units(assembly: Assembly) -> list[Problem]:
    """List the units of an experiment and its plant that do not go with those of the models; needs pint."""
    problems = check_plant_units(assembly.plant, assembly.plant_model)
    declared = assembly.experiment, assembly.plant, assembly.plant_model, assembly.declared_virtual
    return problems + check_experiment_units(*declared)


def refer(declaration: Declaration, path: str) -> Reference:
    """Give the reference that stands at a path of a declaration; files are looked up from its folder."""
    place = declaration.place(path)
    return Reference(place, path, Path(place.file).parent if place else None, declaration._counts)


def _load(
    kind: type[D],
    name_or_path: str | Path,
    reference: Reference,
    check: Callable[[D, bool, Collection[str]], list[Problem]] = lambda *_: [],
) -> D:
    path = find(kind.kind_name, name_or_path, reference)
    refused: list[Problem] = []
    node, digest, counts = _read_file(kind.kind_name, path, str(name_or_path), reference, refused)
    places = Places()
    places.add(node)
    made = read(kind, plain_mapping(node), places, {str(path): digest}, check, refused=refused)
    made._counts = {**reference.counts, **counts}
    return made


def _read_file(
    kind: str, path: Path, shown: str, reference: Reference, refused: list[Problem]
) -> tuple[Node, str, dict[str, int]]:
    """Read a file that must be of a kind, with its SHA-256 and counts; `refused` takes the scalars that are none."""
    data = strict_yaml.read_bytes(path)
    node = strict_yaml.decode(data, str(path), refused)
    found = kind_of_keys(node.value if isinstance(node.value, dict) else ())
    if found not in {None, kind}:
        raise DeclarationError(wrong_kind(kind, str(found), shown, reference, node))
    node, counts = (node, dict[str, int]()) if kind == "batch" else repeated(node, reference.counts)
    return node, hashlib.sha256(data).hexdigest(), counts


def _read_alone(kind: type[D], node: Node, data: Mapping[str, Any], refused: list[Problem]) -> None:
    """Check one file of a chain against the schema; the whole check comes when the chain is merged."""
    places = Places()
    places.add(node)
    try:
        read(kind, data, places, {}, lambda *_: [])
    except DeclarationError as error:
        known = {problem.place for problem in refused}
        if fresh := [problem for problem in error.problems if problem.place not in known]:
            raise DeclarationError(in_order([*refused, *fresh])) from None


def _extended(base: dict[str, Any], child: dict[str, Any]) -> dict[str, Any]:
    """Put a child over the model it extends: entries replaced field by field, terms added to the right-hand sides."""
    result = dict(base)
    for key, value in child.items():
        if key == "terms":
            _add_terms(result, value)
        elif key in _MERGED and isinstance(base.get(key), dict):
            result[key] = dict(base[key])
            for name, entry in value.items():
                old, new = result[key].get(name, {}), entry
                if key in SHORT:
                    old, new = _full(key, old), _full(key, new)
                result[key][name] = old | new if isinstance(old, dict) and isinstance(new, dict) else new
        else:
            result[key] = value
    return result


def _full(section: str, entry: Any) -> dict[str, Any]:  # noqa: ANN401  (plain data of YAML)
    return entry if isinstance(entry, dict) else {SHORT[section]: entry}


def _add_terms(result: dict[str, Any], terms: dict[Text, Text | Real]) -> None:
    """Add terms to right-hand sides of equations, to forces of a Lagrangian model, or to outputs."""
    is_lagrangian = "lagrangian" in result
    equations = dict(result.get("equations", {}))  # of a Lagrangian model, those of its internal states
    forces = dict(result.get("forces", {}))
    outputs = dict(result.get("outputs", {}))
    allowed = [*(result.get("coordinates", {}) if is_lagrangian else ()), *equations]
    for name, term in terms.items():
        if name in outputs and name not in allowed:
            entry = _full("outputs", outputs[name])
            outputs[name] = entry | {"expression": _sum(entry["expression"], term, f"outputs.{name}.expression")}
            result["outputs"] = outputs
            continue
        if name not in allowed:
            what = f"'{name}' is not a coordinate" if is_lagrangian else f"no equation has the left-hand side {name}"
            raise DeclarationError(Problem(name.node.place, name.node.path, what, nearest(name, allowed)))
        section, sides = ("equations", equations) if name in equations else ("forces", forces)
        sides[name] = _sum(sides[name], term, f"{section}.{name}") if name in sides else term
    result |= {"equations": equations} if equations else {}
    result |= {"forces": forces} if forces else {}


def _sum(left: Text | Real, right: Text | Real, path: str) -> Text:
    """Write the sum of two expressions; each character keeps its place in its own file."""
    text = f"({left.node.text}) + ({right.node.text})"
    pieces: list[tuple[int, Place]] = []
    for start, node in ((1, left.node), (len(left.node.text) + 6, right.node)):
        pieces += [(start + index, place) for index, place in node.pieces or ((0, node.place),)]
    result = Text(text)
    result.node = Node(text, left.node.place, path, text, pieces=tuple(pieces))
    return result
