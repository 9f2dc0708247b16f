"""A unit as an FMU for co-simulation, of FMI 2.0 or 3.0: sources, and a binary for 64-bit Linux where gcc is.

Source: Functional Mock-up Interface 2.0.4 and 3.0, https://fmi-standard.org.
"""

from __future__ import annotations

import platform
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from masking import process_environment
from masking.compile.codegen.content_hashes import digest
from masking.control.exports import calls
from masking.control.exports.c_unit import CUnit
from masking.control.exports.target_text import filled, xml_text
from masking.control.exports.unit import Channel, Unit
from masking.errors import DeclarationError, ModelError
from masking.model.declaration.units import base_powers, factor_of

VERSIONS = (2, 3)
FOLDERS = {2: "binaries/linux64", 3: "binaries/x86_64-linux"}
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden")
CREATED = (1980, 1, 1, 0, 0, 0)  # of every file, so that the same unit gives the same bytes

MARKS = {
    2: {"FMI": "fmi2", "COMPONENT": "fmi2Component", "STATE": "FMUstate", "DESERIALIZE": "DeSerialize", "REAL": "Real"},
    3: {
        **{"FMI": "fmi3", "COMPONENT": "fmi3Instance", "STATE": "FMUState", "DESERIALIZE": "Deserialize"},
        "REAL": "Float64",
    },
}  # of what the two standards have in common


@dataclass(frozen=True)
class Variable:
    """A variable of an FMU: `causality` is independent, input, output, local or parameter."""

    reference: int
    name: str
    unit: str
    meaning: str
    causality: str
    start: float | None = None  # that can be set


def variables(unit: Unit) -> tuple[Variable, ...]:
    """Variables of a unit: the time, inputs, outputs, its state, and its parameters."""
    begun = unit.constants.get("state0", np.full(len(unit.states), np.nan))
    order: list[tuple[str, str, Channel, float | None]] = [("input", c.name, c, 0.0) for c in unit.inputs]
    order += [("output", c.name, c, None) for c in unit.outputs]
    order += [
        ("local", f"state.{c.name}", c, float(x) if np.isfinite(x) else None)
        for c, x in zip(unit.states, begun, strict=True)
    ]
    order += [("parameter", f"parameter.{c.name}", c, float(unit.constants["values"][i])) for c, i in unit.parameters]
    found = [Variable(i, name, c.unit, c.meaning, kind, start) for i, (kind, name, c, start) in enumerate(order, 1)]
    return (Variable(0, "time", "", "", "independent"), *found)


def write(unit: Unit, folder: Path) -> tuple[Path, ...]:
    """Write a unit as an FMU of each version of FMI into a folder, and return the files."""
    return tuple(_write(unit, folder / f"{unit.name}_fmi{version}.fmu", version) for version in VERSIONS)


def has_binary() -> bool:
    """Whether FMUs get a binary here."""
    return platform.system() == "Linux" and platform.machine() == "x86_64" and shutil.which("gcc") is not None


def _write(unit: Unit, path: Path, version: int) -> Path:
    text = CUnit(unit, "double")
    sources = {f"{unit.name}.h": text.header(), f"{unit.name}.c": text.source()}
    token = digest(xml_text(unit.title), *sources.values())
    token = "{" + "-".join((token[:8], token[8:12], token[12:16], token[16:20], token[20:])) + "}"
    sources["fmu_unit.h"] = _glue(unit, token)
    shared = filled("fmi_shared.c", MARKS[version])
    sources[f"fmi{version}.c"] = filled(f"fmi{version}.c", {"SHARED": shared})
    files: dict[str, bytes] = {"modelDescription.xml": _xml(_description(unit, token, version, sources))}
    if version == 3:
        files["sources/buildDescription.xml"] = _xml(_build(unit, sources))
    files |= {f"sources/{name}": text.encode() for name, text in sources.items()}
    if has_binary():
        files[f"{FOLDERS[version]}/{unit.name}.so"] = _binary(unit, sources)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name, CREATED), content, zipfile.ZIP_DEFLATED)
    return path


def _binary(unit: Unit, sources: Mapping[str, str]) -> bytes:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8")
        library = folder / f"{unit.name}.so"
        given = [str(folder / file) for file in sources if file.endswith(".c")]
        command = ["gcc", *FLAGS, *given, "-o", str(library), "-lm"]
        made = process_environment.minimal()  # without variables that name more headers
        done = subprocess.run(command, env=made, capture_output=True, text=True, check=False)  # noqa: S603
        if done.returncode:
            raise ModelError(f"gcc could not compile {unit.name}: {done.stderr.strip().splitlines()[-1]}")
        return library.read_bytes()


def _glue(unit: Unit, token: str) -> str:
    names = calls.Names("&i->unit", "i->inputs", "i->outputs", "i->time", "status")
    begun = [calls.begin(unit, names), "choose(i);", calls.read(unit, names)]
    if unit.kind == "controller":
        begun.append("memcpy(i->outputs, i->unit.applied, sizeof(i->unit.applied));")
    elif unit.kind == "law":
        begun += [f"const int {calls.step(unit, names)}", "(void)status;"]
    marks = {
        "NAME": unit.name,
        "TOKEN": token,
        "INPUTS": str(len(unit.inputs)),
        "OUTPUTS": str(len(unit.outputs)),
        "STATES": str(len(unit.states)),
        "PARAMETERS": str(len(unit.parameters)),
        "CHOSEN_SIZE": str(max(1, len(unit.states) + len(unit.parameters))),
        "HAS_START": str(int("state0" in unit.constants)),
        "PLACES": ", ".join(str(i) for _, i in unit.parameters) or "0",
        "INPUTS_SIZE": str(max(1, len(unit.inputs))),
        "PERIOD": repr(unit.period or 0.0),
        "BEGIN": "\n    ".join(filter(None, begun)),
        "ADVANCE": "\n        ".join(filter(None, (calls.step(unit, names), calls.read(unit, names)))),
        "MEMORY": next(iter(unit.memory)),
    }
    return filled("fmu_unit.h", marks)


def _description(unit: Unit, token: str, version: int, sources: Mapping[str, str]) -> Element:
    attributes = {"fmiVersion": f"{version}.0", "modelName": unit.name, "description": unit.title}
    attributes["guid" if version == 2 else "instantiationToken"] = token
    root = Element("fmiModelDescription", {**attributes, "generationTool": "masking"})
    able = {"canGetAndSetFMUstate": "true", "canSerializeFMUstate": "true"}
    if version == 3:
        able = {name.replace("state", "State"): value for name, value in able.items()}
        able |= {"fixedInternalStepSize": repr(unit.period)} if unit.period else {}
    is_free = "true" if unit.period is None else "false"
    simulation = {"modelIdentifier": unit.name, "canHandleVariableCommunicationStepSize": is_free, **able}
    element = SubElement(root, "CoSimulation", simulation)
    if version == 2:
        listed = SubElement(element, "SourceFiles")
        for name in _compiled(sources):
            SubElement(listed, "File", {"name": name})
    found = variables(unit)
    units = {name: one for name in sorted({v.unit for v in found}) if (one := _base_unit(name)) is not None}
    if units:
        defined = SubElement(root, "UnitDefinitions")
        for name, one in units.items():
            SubElement(SubElement(defined, "Unit", {"name": name}), "BaseUnit", one)
    times = {"startTime": "0.0"} | ({"stepSize": repr(unit.period)} if unit.period else {})
    SubElement(root, "DefaultExperiment", times)
    listed = SubElement(root, "ModelVariables")
    for variable in found:
        _variable(listed, variable, version, has_unit=variable.unit in units)
    structure = SubElement(root, "ModelStructure")
    places = [(i, v.reference) for i, v in enumerate(found, 1) if v.causality == "output"]
    for name in ("Output", "InitialUnknown"):
        listed = SubElement(structure, f"{name}s") if version == 2 else structure
        for place, reference in places:
            if version == 2:
                SubElement(listed, "Unknown", {"index": str(place)})
            else:
                SubElement(listed, name, {"valueReference": str(reference)})
    return root


def _base_unit(name: str) -> dict[str, str] | None:
    """Factor and powers of SI base units as FMI writes them; None for what is no unit, or has broken powers."""
    try:
        powers, factor = base_powers(name), factor_of(name)
    except DeclarationError:
        return None
    if not name or any(power.denominator != 1 for power in powers.values()):
        return None
    return {base: str(power) for base, power in powers.items()} | ({} if factor == 1.0 else {"factor": repr(factor)})


def _variable(parent: Element, variable: Variable, version: int, *, has_unit: bool) -> None:
    attributes = {"name": variable.name, "valueReference": str(variable.reference), "causality": variable.causality}
    attributes["variability"] = {"independent": "continuous", "parameter": "tunable"}.get(
        variable.causality, "discrete"
    )
    if variable.causality in {"output", "local", "parameter"}:
        attributes["initial"] = "calculated" if variable.start is None else "exact"
    attributes |= {"description": variable.meaning} if variable.meaning else {}
    value = {} if variable.start is None else {"start": repr(variable.start)}
    value |= {"unit": variable.unit} if has_unit else {}
    if version == 2:
        SubElement(SubElement(parent, "ScalarVariable", attributes), "Real", value)
    else:
        SubElement(parent, "Float64", attributes | value)


def _build(unit: Unit, sources: Mapping[str, str]) -> Element:
    root = Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    build = SubElement(root, "BuildConfiguration", {"modelIdentifier": unit.name})
    files = SubElement(build, "SourceFileSet", {"language": "C99"})
    for name in _compiled(sources):
        SubElement(files, "SourceFile", {"name": name})
    SubElement(build, "Library", {"name": "m"})
    return root


def _compiled(sources: Mapping[str, str]) -> Iterator[str]:
    return (name for name in sources if name.endswith(".c"))


def _xml(root: Element) -> bytes:
    for element in root.iter():
        element.attrib = {name: xml_text(value) for name, value in element.attrib.items()}
    indent(root)
    return bytes(tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"
