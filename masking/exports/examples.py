"""Programs around an exported unit: on Linux, and on a Cortex-M4F without an operating system."""

from __future__ import annotations

from pathlib import Path

from masking.exports.unit import Unit

TEMPLATES = Path(__file__).parent / "templates"

# How each kind of unit begins with its first inputs, and what it does with each.
BEGIN = {"controller": "{name}_init(&unit, in);"}
STEP = {
    "controller": "status = {name}_step(&unit, in, out);",
    "law": "status = {name}_step(&unit, in[0], in + 1, out);",
    "plant": "{name}_step(&unit, in);\n        {name}_read(&unit, in + {first}, out);",
    "model": "{name}_step(&unit, {inputs});\n        {name}_read(&unit, {given}out);",
}


def programs(unit: Unit, real: str) -> dict[str, str]:
    """Return the texts of example programs by the names of their files."""
    written = unit.written("read" if "read" in unit.operations else "step")
    outputs = sum(len(unit.ports[port]) for port in written)
    inputs = sum(len(channels) for port, channels in unit.ports.items() if port not in written)
    inputs += unit.kind == "law"  # the time
    first = len(next(iter(unit.ports.values())))
    read = unit.operations["read"].arguments if "read" in unit.operations else ()
    texts = {"name": unit.name, "first": str(first), "given": "in, " if "inputs" in read else "", "inputs": "in"}
    marks = {
        "NAME": unit.name,
        "REAL": real,
        "INPUTS": str(max(1, inputs)),
        "OUTPUTS": str(outputs),
        "BEGIN": BEGIN.get(unit.kind, "{name}_init(&unit);").format(**texts),
        "STEP": STEP[unit.kind].format(**texts),
    }
    found = {
        f"{unit.name}_linux.c": "linux.c",
        f"{unit.name}_cortex_m4.c": "cortex_m4.c",
        "cortex_m4.ld": "cortex_m4.ld",
    }
    return {name: _filled((TEMPLATES / file).read_text(encoding="utf-8"), marks) for name, file in found.items()}


def _filled(text: str, marks: dict[str, str]) -> str:
    for mark, value in marks.items():
        text = text.replace(f"@{mark}@", value)
    return text
