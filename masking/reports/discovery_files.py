"""Files of a discovery: the model with its causes, the plant that has this model, and all as JSON.

Everything is written into a folder of its own, read again as `masking check` reads it, and only then moved.
"""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from masking.control.rig.twin import Twin
from masking.display.json_text import json_text, plain
from masking.inference.discovery import compiled_laws, latent_force
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.discovery_result import Discovery, Estimate, Named
from masking.inference.discovery.places import identifier
from masking.model.declaration import catalogue, registry
from masking.model.declaration.model_checks import equation_of
from masking.model.declaration.schema import ModelDeclaration, Parameter
from masking.model.declaration.units import combined, dimension_of, factor_of
from masking.model.effects import LATE, Effect, attach
from masking.model.modelling.model import Model
from masking.reports import discovery_text, html, model_files, one_page
from masking.reports.one_page import Sheet
from masking.reports.style import CaptionedFigure
from masking.reports.text import listed

STD_DIGITS = 3  # of standard deviations
PLANT, NUMBERS, PAGE = "plant.yaml", one_page.DISCOVERY, "discovery.html"
WHOLE = 0.05  # of a sample: a delay so near to whole samples is written as these


@dataclass(frozen=True)
class Origin:
    """Where a discovery comes from: each record by what it is for, with its file and SHA-256."""

    records: Mapping[str, tuple[str, str]]

    def source(self, found: Discovery) -> str:
        """Line on how a file was made."""
        records = "; ".join(f"{what} {path} (SHA-256 {digest[:16]})" for what, (path, digest) in self.records.items())
        sure = f", probability {found.least_sure.probability:.4g}" if found.effects else ""
        version = importlib.metadata.version("masking")
        return f"masking discover {version}, {datetime.now(UTC):%Y-%m-%d}: {records}; verdict {found.verdict}{sure}"


@dataclass(frozen=True)
class Files:
    """Paths of the files; the model and the plant are None where nothing was added."""

    numbers: Path
    page: Path
    model: Path | None
    plant: Path | None

    @property
    def written(self) -> str:
        """Line that names what was written."""
        return f"written: {', '.join(str(path) for path in (self.model, self.plant, self.numbers) if path)}"


def save(
    found: Discovery,
    folder: str | Path,
    origin: Origin,
    page: str,
    figures: Sequence[CaptionedFigure],
    *,
    lies: Path | None = None,
    sheet: Sheet | None = None,
) -> Files:
    """Write a discovery into a folder, made if need be; nothing is left half written.

    Those of an earlier discovery there that are not written again are deleted. `lies` is the folder to which all will
    be moved, where that is another; `sheet` is what one page of it says.

    Raises:
        RecordError: the folder cannot be written.
        DeclarationError: the model with its causes is not a sound one.
    """
    out = Path(folder)
    files = paths(found, out)
    contents: dict[Path, bytes | str] = {files.page: page, **html.images(figures, out)}
    if files.model is not None and files.plant is not None:
        contents[files.model] = model_files.text(model(found, files.model.parent, origin))
        contents[files.plant] = model_files.text(plant(found, files.model.relative_to(out), origin, out))
    written = sorted(str(path.relative_to(out)) for path in (*contents, files.numbers))
    contents[files.numbers] = json_text(as_dict(found, lies or out, origin, sheet) | {"files": written})
    earlier = _of_earlier(out)
    with html.staged(out) as made:
        html.write({made / path.relative_to(out): content for path, content in contents.items()})
        if files.model is not None:
            Model(registry.load_model(made / files.model.relative_to(out))).validate()
            registry.check_plant_file(made / PLANT)
            Twin.load(made / PLANT).validate()
    for path in earlier - {*contents}:
        path.unlink()
    one_page.remove(lies or out)
    return files


def _of_earlier(out: Path) -> set[Path]:
    """Files of the discovery that a folder holds, if any."""
    try:
        names = json.loads((out / NUMBERS).read_text(encoding="utf-8")).get("files", ())
        every = {out / name for name in names}
    except (OSError, ValueError, AttributeError, TypeError):
        return set()  # none, or no file of ours
    return {path for path in every if path.is_file() and path.resolve().is_relative_to(out.resolve())}


def paths(found: Discovery, out: Path) -> Files:
    """Where the files of a discovery lie."""
    if not found.effects and found.law is None and not (found.unit and found.unit.kind != "clock"):
        return Files(out / NUMBERS, out / PAGE, None, None)
    base = found.twin.declaration.model
    stem = base if base in catalogue.names("model") else Path(base).stem
    names = [name for name, _ in found.written.names] if found.law else [cause.name for cause in found.effects]
    causes = "+".join(dict.fromkeys(names or ["units"]))
    return Files(out / NUMBERS, out / PAGE, out / "models" / f"{Path(stem).name}+{causes}.yaml", out / PLANT)


def as_dict(found: Discovery, out: Path, origin: Origin, sheet: Sheet | None) -> dict[str, Any]:
    """Discovery, where in the folder `out` its files lie, and what one page of it says, as JSON can hold it."""
    files, facts = paths(found, out), found.as_dict()
    facts.setdefault("next_experiment", None)
    facts["model"] = None if files.model is None else str(files.model)
    facts["plant"] = None if files.plant is None else str(files.plant)
    facts["parameters"] = {n: {"value": x, "std": std, "declared": at} for n, x, std, at in refitted(found)}
    facts["adjusted"] = list(discovery_text.adjusted_parameters(found))
    facts["records"] = {what: {"file": path, "sha256": digest} for what, (path, digest) in origin.records.items()}
    facts["page"] = str(files.page)
    facts["sheet"] = plain(sheet)
    facts["localisation"] = found.localisation.as_dict()
    return facts


def refitted(found: Discovery) -> list[tuple[str, float, float, float]]:
    """Parameters of the model with their values, deviations and declared values, in declared units."""
    rig, fitted = found.written_rig, found.written.hypothesis
    columns = (fitted.theta, fitted.deviations, rig.start)  # imperfections come last
    rows = zip(rig.names, *(column.tolist() for column in columns), strict=False)
    return [(name, value, std, declared) for name, value, std, declared in rows]


def model(found: Discovery, folder: Path, origin: Origin) -> dict[str, Any]:
    """Content of a model file in a folder that extends the model by the causes in its equations."""
    twin, whole = found.twin, found.written_rig.twin.base
    for instance, label in labels(found).items():
        whole = _attached(found, whole, instance, label)
    made: dict[str, Any] = {
        "name": f"{twin.base.name} with {_causes(found)}",
        "source": "; ".join(filter(None, (twin.base.source, origin.source(found)))),
        "extends": registry.name_from(twin.base, folder),
    }
    parameters: dict[str, Any] = {n: model_files.parameter(x, std, STD_DIGITS) for n, x, std, _ in refitted(found)}
    known = _uncertain(found)

    def new(section: str) -> dict[str, Any]:
        before = getattr(twin.base, section)
        return {n: x for n, x in getattr(whole, section).items() if n not in before or x != before[n]}

    def written(section: str) -> dict[str, Any]:
        return {n: x.model_dump(mode="json", exclude_defaults=True) for n, x in new(section).items()}

    fresh = {n: _written(x, *known.get(n, (0.0, ""))) for n, x in new("parameters").items()}
    parameters |= {n: entry | parameters.get(n, {}) for n, entry in fresh.items()}
    states = written("states")
    sections = {
        "parameters": parameters,
        "states": states,
        "definitions": {n: x.text for n, x in new("definitions").items()},
        "elements": written("elements"),
        "equations": {x.text: y.text for x, y in whole.equations.items() if whole.state_of(x) in states},
        "terms": _terms(found, whole),
        "inputs": {n: {"unit": unit} for n, unit in _in_other_units(found, "inputs").items()},
    }
    return made | {name: content for name, content in sections.items() if content or name == "parameters"}


def plant(found: Discovery, model_file: Path, origin: Origin, folder: Path) -> dict[str, Any]:
    """Content of a plant file in a folder, with a model and with the causes outside of its equations.

    `model_file` is the path of the model from that folder.
    """
    twin = found.twin
    before = twin.declaration.canonical().get("effects", {})
    first: dict[str, Any] = {}
    last: dict[str, Any] = {}

    def add(target: dict[str, Any], effect: str, at: str, values: Mapping[str, float]) -> None:
        rounded = {name: model_files.rounded(value) for name, value in values.items()}
        label = _free(f"{effect}_{at}", {*before, *first, *last})
        target[label] = {"effect": effect, "at": at, "parameters": rounded}

    turned = found.unit.kind if found.unit and found.unit.is_sign else ""
    reversing = f"{turned}_gain", found.unit.names[0] if found.unit else "", {"e": -2.0}  # a gain of -1 in all
    if turned == "actuator":
        add(first, *reversing)
    fitted = found.written.hypothesis
    for instance in (*found.written_rig.imperfect(fitted.theta), *fitted.instances):
        if instance.effect == compiled_laws.DELAY:
            _add_delay(found, instance, first, {*before, *first, *last})
        elif instance.where != "element":
            # Commands pass what was found first; readings pass it last.
            values = dict(zip(instance.entry.parameters, instance.values, strict=True))
            add(first if instance.where == "actuator" else last, instance.effect, instance.at, values)
    if turned == "sensor":
        add(last, *reversing)
    for cause in found.effects[len(found.explanation.names) :]:
        add(last, cause.name, cause.on, {n: value for n, (value, _) in cause.parameters.items()})
    heading = {
        "name": f"{twin.declaration.name} with {_causes(found)}",
        "model": model_file.as_posix(),
        "source": "; ".join(filter(None, (twin.declaration.source, origin.source(found)))),
    }
    effects = _in_found_units(found, {**first, **before, **last})
    made = model_files.plant(twin, folder, heading, found.rig.names, effects)
    for kind in ("sensors", "actuators"):
        for name, unit in _in_other_units(found, kind).items():
            entry = made[kind][name] | {"unit": unit}
            by = factor_of(latent_force.channel_unit(found, name, kind.removesuffix("s"))) / factor_of(unit)
            entry |= {"range": [by * end for end in entry["range"]]} if "range" in entry else {}
            entry |= {"jump": by * entry["jump"]} if "jump" in entry else {}
            made[kind] = made[kind] | {name: entry}
    return made


def labels(found: Discovery) -> dict[EffectInstance, str]:
    """Label of each cause in the equations."""
    made: dict[EffectInstance, str] = {}
    base = found.twin.attached
    for instance in found.written.hypothesis.instances:
        if instance.where != "element":
            continue
        taken = {*made.values(), *(n.removesuffix("_on") for n in base.parameters if n.endswith("_on"))}
        names = [*base.parameters, *base.definitions, *base.states, *base.coordinates, *base.inputs]
        taken |= {instance.effect} if any(n.startswith(f"{instance.effect}_") for n in names) else set()
        label = instance.effect if instance.effect not in taken else f"{instance.effect}_{_element(found, instance)}"
        made[instance] = _free(label, taken)
    return made


def _attached(found: Discovery, whole: ModelDeclaration, instance: EffectInstance, label: str) -> ModelDeclaration:
    """Model with one more cause in its equations, at an element that is made where there is none."""
    at = _element(found, instance)
    if at not in whole.elements:
        element = found.written_rig.places[found.written_rig.index(instance)].element
        whole = whole.model_copy(update={"elements": {**whole.elements, at: element}})
    values = dict(zip(instance.entry.parameters, map(model_files.rounded, instance.values), strict=True))
    return attach(whole, instance.entry, at, label, values)


def _element(found: Discovery, instance: EffectInstance) -> str:
    place = found.written_rig.places[found.written_rig.index(instance)]
    return place.name if place.declared else identifier(place.name)


def _terms(found: Discovery, whole: ModelDeclaration) -> dict[str, str]:
    """Terms that the causes add to each equation."""
    terms: dict[str, str] = {}
    for instance, label in labels(found).items():
        if instance.entry.attaches != "beside":  # they are in the force of their element
            continue
        for coordinate, factor in whole.elements[_element(found, instance)].acts.items():
            left = equation_of(whole, coordinate)
            key = coordinate if left is None else left.text  # a Lagrangian has forces instead
            text = factor.text.strip()
            by = text if text.isidentifier() else f"({text})"
            sign = {"1": f"{label}_f", "-1": f"-{label}_f"}.get(text, f"{by}*{label}_f")
            terms[key] = f"{terms[key]} + ({sign})" if key in terms else sign
    return terms


def _add_delay(found: Discovery, instance: EffectInstance, effects: dict[str, Any], taken: set[str]) -> None:
    """Add a delay in whole samples; its remainder, or that of one of several actuators, is a dead time of actuators."""
    rate, seconds = found.record.rate, instance.values[0]
    whole = int(seconds * rate + WHOLE) if not instance.at or found.twin.actuators == (instance.at,) else 0
    rest = seconds - whole / rate
    if whole:
        effects[_free("delay_found", taken)] = {"effect": compiled_laws.DELAY, "parameters": {"samples": whole}}
    if rest * rate > WHOLE:
        at = [instance.at] if instance.at else list(found.twin.actuators)
        late = {"effect": LATE.name, "at": at, "parameters": {LATE.grows_with: model_files.rounded(rest)}}
        effects[_free("rest_of_delay", {*taken, *effects})] = late


def _uncertain(found: Discovery) -> dict[str, tuple[float, str]]:
    """Standard deviation and unit of the parameters of causes in the equations, by the names they have there."""
    made: dict[str, tuple[float, str]] = {}
    known = labels(found)
    deviations = iter(found.written.hypothesis.deviations[len(found.written_rig.start) :])
    for instance in found.written.hypothesis.instances:
        free = {name: float(next(deviations)) for name in instance.names}
        if instance in known:
            values = dict.fromkeys(instance.entry.parameters, Estimate(0.0, 0.0))
            units = discovery_text.plain_units(found, Named(instance.effect, instance.at, values, 1.0))
            made |= {f"{known[instance]}_{name}": (free.get(name, 0.0), units[name]) for name in values}
    return made


def _written(parameter: Parameter, std: float, unit: str) -> dict[str, Any]:
    """Parameter as a file has it: in a unit as its place says it, where that is the same unit."""
    made = parameter.model_dump(mode="json", exclude_defaults=True)
    if unit and (dimension_of(unit), factor_of(unit)) == (dimension_of(parameter.unit), factor_of(parameter.unit)):
        made |= {"unit": unit} if unit != "1" else {}
    return made | ({"std": model_files.rounded(std, STD_DIGITS)} if std > 0.0 else {})


def _in_other_units(found: Discovery, section: str = "") -> dict[str, str]:
    """Units of channels that are probably in others than declared, those of a section of a file or all."""
    doubt = found.unit
    if doubt is None or doubt.is_sign or doubt.kind == "clock":
        return {}
    known = {name: latent_force.channel_unit(found, name, doubt.kind) for name in doubt.names}
    of_plant = {name for name in doubt.names if doubt.kind != "actuator" or name in found.twin.declaration.actuators}
    sections = {name: f"{doubt.kind}s" if name in of_plant else "inputs" for name in doubt.names}
    return {n: doubt.of_declared(known[n]) for n, where in sections.items() if not section or where == section}


def _in_found_units(found: Discovery, effects: Mapping[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Effects of the plant by their labels, their parameters in the units that channels are probably in."""
    others, made = _in_other_units(found), dict[str, dict[str, Any]]()
    for label, use in effects.items():
        at, entry = use.get("at", ()), found.dictionary.get(use["effect"])
        every = [at] if isinstance(at, str) else [*at]
        of_kind = entry is not None and found.unit is not None and entry.where == found.unit.kind
        here = [name for name in every if name in others] if of_kind else []
        if len(here) < len(every) or not here:
            made[label] = use | ({"at": [name for name in every if name not in here]} if here else {})
        for name in here:
            own = label if len(every) == 1 else _free(f"{label}_{name}", {*effects, *made})
            units = latent_force.channel_unit(found, name, found.unit.kind if found.unit else ""), others[name]
            values = {n: _rescaled(value, entry, n, units) for n, value in use.get("parameters", {}).items()}
            made[own] = use | {"at": name} | ({"parameters": values} if values else {})
    return made


def _rescaled(value: float | str, entry: Effect | None, name: str, units: tuple[str, str]) -> float | str:
    """Value of a parameter of an effect in the second of two units of its channel; the first has it now."""
    if entry is None:
        return value
    known, other = (factor_of(combined(entry.parameters[name].unit, dict.fromkeys("SU", unit))) for unit in units)
    return f"({value})*{known / other:.12g}" if isinstance(value, str) else model_files.rounded(value * known / other)


def _causes(found: Discovery) -> str:
    causes = [text for _, text in written(found)]
    if found.law is None and found.explanation.kind == "parameter":
        causes = [f"another {listed([name for name, _ in found.explanation.names])}"]
    units = [f"{name} in {unit}" for name, unit in _in_other_units(found).items()]
    units += [f"another sign of {found.unit.names[0]}"] if found.unit and found.unit.is_sign else []
    return " and ".join([*causes, *units])


def written(found: Discovery) -> list[tuple[str, str]]:
    """Effect of each cause in the files of the model and its plant, and its name in words."""
    if found.law is None:
        return [(one.name, discovery_text.cause_name(found, one.name, one.on)) for one in found.effects]
    *others, (law, _) = found.written.names
    named = [(name, discovery_text.cause_name(found, name, on)) for name, on in others]
    return [*named, (law, f"a law without a name in {found.law.place}")]


def _free(name: str, taken: set[str]) -> str:
    name = "".join(c if c.isalnum() or c == "_" else "_" for c in name)
    return next(n for n in (name, *(f"{name}_{i}" for i in range(2, 99))) if n not in taken)
