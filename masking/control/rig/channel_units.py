"""Units of channels: columns of a record in the units that a plant declares for its actuators and sensors."""

from __future__ import annotations

from masking.control.rig.twin import Twin
from masking.errors import DeclarationError, RecordError
from masking.model.declaration import units

_ANGLES = {"rad", "radian", *units.ANGLES, *units.PLURALS}
_TEMPERATURES = {"degC", "degF", "celsius", "fahrenheit", "degree_Celsius", "degree_Fahrenheit"}  # zero is elsewhere
_SAME = 1e-12  # relative difference of factors of one unit


def factor(twin: Twin, name: str, column: str, unit: str, hint: str = "") -> float:
    """How many declared units of an actuator or a sensor one unit of a column is.

    Args:
        twin: the plant.
        name: of the actuator or sensor.
        column: its column in the file, for messages.
        unit: of the column, "" where none is known: then it is in the declared one.
        hint: unit that the name of a column without one may mean.

    Raises:
        RecordError: the unit is none, has another dimension or another zero, may be read in two ways, or is only
            hinted at and another than the declared one; the message has the map that settles it.
    """
    sensors, actuators = twin.declaration.sensors, twin.declaration.actuators or twin.base.inputs
    declared = (sensors[name] if name in sensors else actuators[name]).unit
    plain = column.partition(" [")[0].partition(" (")[0] if unit else column
    if (unit or hint) in {"", "1", declared}:
        return 1.0
    size = _size(unit or hint)
    if not unit:
        if size is None or size[1] != units.dimension_of(declared) or _is_one(size[0] / units.factor_of(declared)):
            return 1.0
        raise RecordError(
            f"column '{column}' may be in {hint} by its name, and {name} is declared in {declared}; say which it is: "
            f"--map {name}={column}:{hint}, or --map {name}={column}:{declared}"
        )
    if size is None:
        raise RecordError(
            f"column '{column}' is in '{unit}', which is no unit; say the unit of its numbers, such as --map "
            f'"{name}={plain}:{declared}"'
        )
    as_is = f'if its numbers are in {declared}, give --map "{name}={plain}:{declared}"'
    if declared == "1":
        if _is_one(size[0]) and size[1] == units.NONE:
            return 1.0
        raise RecordError(
            f"column '{column}' is in {unit}, and the plant declares no unit of {name}; declare one, such as unit: "
            f'{unit}, or take the numbers as they are with --map "{name}={plain}:1"'
        )
    if size[1] != units.dimension_of(declared):
        hint = units.instead_of(unit, units.dimension_of(declared))
        hint = f" ({hint}, such as in --map {name}={plain}:{units.GRAVITY})" if hint else ""
        raise RecordError(
            f"column '{column}' is in {unit}, and {name} is declared in {declared}, which is of another "
            f"dimension{hint}; {as_is}"
        )
    if {unit, declared} & _TEMPERATURES:
        raise RecordError(
            f"column '{column}' is in {unit}, and {name} is declared in {declared}, which has another zero; declare "
            f"{name} in {unit}, or convert the column; {as_is}"
        )
    if size[1] != units.NONE and _has_angle(unit) != _has_angle(declared):
        raise RecordError(
            f"column '{column}' is in {unit}, and {name} is declared in {declared}: it may count turns or radians; say "
            f'which: --map "{name}={plain}:{_counted(unit, "turn")}" or --map "{name}={plain}:{_counted(unit, "rad")}"'
        )
    return size[0] / units.factor_of(declared)


def _size(unit: str) -> tuple[float, units.Dimension] | None:
    """Factor of a unit to SI and its dimension; None where it is none."""
    try:
        return units.factor_of(unit), units.dimension_of(unit)
    except (DeclarationError, ArithmeticError):
        return None


def _is_one(ratio: float) -> bool:
    return abs(ratio - 1.0) < _SAME


def _has_angle(unit: str) -> bool:
    return not _ANGLES.isdisjoint(units.names_in(unit))


def _counted(unit: str, angle: str) -> str:
    """Unit of a frequency as one of turns or radians."""
    if _has_angle(unit):
        return unit if angle == "turn" else f"rad*{unit}"
    plain = unit.replace("kHz", "1000/s").replace("Hz", "1/s")
    return f"{angle}{plain.removeprefix('1')}" if plain.startswith("1/") else f"{angle}*({plain})"
