"""Files of an exported unit: its sources, and programs around it for Linux, for a Cortex-M4F, and as a sketch."""

from __future__ import annotations

import json
from pathlib import Path

from masking.control.exports import fmu_unit
from masking.control.exports.c_unit import CUnit
from masking.control.exports.calls import Names, begin, read, step
from masking.control.exports.target_text import c_string, filled
from masking.control.exports.unit import Unit

ENDINGS = {"c": ".c", "fmu": f"_fmi{fmu_unit.VERSIONS[0]}.fmu"}  # of a file that is always written


def write(unit: Unit, folder: Path, to: str, real: str) -> tuple[Path, ...]:
    """Write a unit into a folder as `c`, whose numbers are of a type, or as `fmu`, and return its files."""
    folder.mkdir(parents=True, exist_ok=True)
    if to == "fmu":
        return fmu_unit.write(unit, folder)
    text = CUnit(unit, real)
    texts = {f"{unit.name}.h": text.header(), f"{unit.name}.c": text.source()}
    texts |= programs(unit, real)
    for name, content in texts.items():
        (folder / name).write_text(content, encoding="utf-8")
    return tuple(folder / name for name in texts)


def programs(unit: Unit, real: str) -> dict[str, str]:
    """Texts of example programs by the names of their files, with numbers that are `double` or `float`."""
    is_law = unit.kind == "law"  # which is given the time before the readings
    names = Names("&unit", "in + 1" if is_law else "in", "out", "in[0]", "status")
    ports = {"sensors": "readings", "actuators": "commands"}
    channels = {kind: [channel.name for channel in unit.ports.get(port, ())] for kind, port in ports.items()}
    marks = {
        "NAME": unit.name,
        "REAL": real,
        "INPUTS": str(max(1, len(unit.inputs) + is_law)),
        "OUTPUTS": str(len(unit.outputs)),
        "RATE": f"{1.0 / unit.period:.12g}" if unit.period else "",
        "PERIOD": repr(unit.period),
        "SENSORS": str(len(channels["sensors"])),
        "ACTUATORS": str(len(channels["actuators"])),
        "CHANNELS": c_string(json.dumps(channels)),
        "BEGIN": begin(unit, names),
        "STEP": "\n        ".join(filter(None, (step(unit, names), read(unit, names)))),
    }
    found = {f"{unit.name}_{file}": file for file in ("linux.c", "cortex_m4.c")} | {"cortex_m4.ld": "cortex_m4.ld"}
    if unit.kind in {"controller", "plant"}:
        found |= {f"{unit.name}_arduino.ino": f"{unit.kind}.ino", "frames.h": "frames.h"}
    return {name: filled(file, marks) for name, file in found.items()}
