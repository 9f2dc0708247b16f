"""Files of an exported unit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from masking.control.exports import fmu_unit
from masking.control.exports.c_unit import CUnit
from masking.control.exports.example_programs import programs
from masking.control.exports.unit import Unit

ENDINGS = {"c": ".c", "fmu": f"_fmi{fmu_unit.VERSIONS[0]}.fmu"}  # of a file that is always written


def write(unit: Unit, folder: Path, to: str, real: str) -> tuple[Path, ...]:
    """Write a unit into a folder as `c`, whose numbers are of a type, or as `fmu`, and return its files."""
    folder.mkdir(parents=True, exist_ok=True)
    if to == "fmu":
        return fmu_unit.write(unit, folder)
    text = CUnit(unit, real)
    texts = {f"{unit.name}.h": text.header(), f"{unit.name}.c": text.source()}
    return _written(folder, texts | programs(unit, real))


def _written(folder: Path, texts: Mapping[str, str]) -> tuple[Path, ...]:
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return tuple(folder / name for name in texts)
