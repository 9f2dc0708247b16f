"""Statements of C around a unit: how a program begins and steps it with arrays of all inputs and outputs."""

from __future__ import annotations

from dataclasses import dataclass

from masking.control.exports.unit import Unit


@dataclass(frozen=True)
class Names:
    """What a program calls the state, the inputs, the outputs, the time, and where it puts the status."""

    state: str
    inputs: str
    outputs: str
    time: str
    status: str


def begin(unit: Unit, names: Names) -> str:
    """Statements that begin a unit, with its first inputs where it wants them."""
    given = f", {names.inputs}" if unit.kind == "controller" else ""
    return f"{unit.name}_init({names.state}{given});"


def step(unit: Unit, names: Names) -> str:
    """Statement of one step, without what is read after it."""
    if unit.kind == "controller":
        return f"{names.status} = {unit.name}_step({names.state}, {names.inputs}, {names.outputs});"
    if unit.kind == "law":
        return f"{names.status} = {unit.name}_step({names.state}, {names.time}, {names.inputs}, {names.outputs});"
    return f"{unit.name}_step({names.state}, {names.inputs});"


def read(unit: Unit, names: Names) -> str:
    """Statement that reads the outputs after a step; nothing where a step writes them."""
    if "read" not in unit.operations:
        return ""
    given = ""
    if unit.kind == "plant":  # commands, then noise
        given = f", {names.inputs} + {len(unit.ports['commands'])}"
    elif "inputs" in unit.operations["read"].arguments:
        given = f", {names.inputs}"
    return f"{unit.name}_read({names.state}{given}, {names.outputs});"
