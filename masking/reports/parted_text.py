"""Text of a motion that parted from the wanted one: chaos, or another attractor of the same virtual system."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from masking.model.declaration.quantities import number, percent
from masking.reports.run_study import Study, nested


def is_as_wanted(manifest: Mapping[str, Any]) -> bool:
    """Whether a large masking error says nothing against a run: its motion is that of a chaotic system."""
    return bool(nested(manifest, "parting", "chaos").get("is_alike"))


def sentences(facts: Study, plant: str, virtual: str, error: str, unit: str) -> list[str]:
    """What became of the motion, in sentences with the masking `error` over its time; empty where that is not known.

    `unit` is that of the virtual system's time.
    """
    found = nested(facts.recording.manifest, "parting")
    if "chaos" in found:
        return _chaos(found["chaos"], plant, virtual, error, unit)
    if not found:
        return []
    wanted, reached = (_attractor(facts, found[which]) for which in ("wanted", "reached"))
    if found["is_same"]:
        where = f"{plant} settled on the attractor of {virtual} on which the wanted motion settles: {reached}."
        return [where, f"The two differ in phase, or in how they came there: {error}."]
    return [f"{plant} settled on another attractor of {virtual}, {reached}, than the wanted motion, {wanted}: {error}."]


def _chaos(found: Mapping[str, Any], plant: str, virtual: str, error: str, unit: str) -> list[str]:
    rate, along = (number(found[name], 2) for name in ("exponent", "along"))
    first, time, predicted = percent(found["first"]), number(found["time"], 2), number(found["predicted"], 2)
    spread, own = percent(found["distribution"]), percent(found["wanted"])
    if found["is_alike"]:
        said = f"{plant} moved as {virtual}, whose motions are chaotic and part whatever moves them: {error}."
    else:
        said = f"{plant} did not move as {virtual}, whose motions are chaotic: {error}."
    parted = (
        f"With a largest Lyapunov exponent of {rate}, a difference of {first}, as there was at first, parts two "
        f"motions in {predicted} {unit} by itself; these parted after {time} {unit}."
    )
    measured = (
        f"The parts of the time in which states are below any value differ from those of the wanted system by {spread} "
        f"at most (the wanted motion itself: {own}), and the exponent along the motion is {along}."
    )
    return [said, parted, measured]


def _attractor(facts: Study, found: Mapping[str, Any]) -> str:
    """Attractor in words: where it rests, or its period and the amplitude of each coordinate."""

    def places(values: Mapping[str, float], least: float = 0.0) -> str:
        shown = {name: 0.0 if abs(x) <= least else x for name, x in values.items()}
        return ", ".join(f"{n} = {number(x)} {facts.unit(f'virtual.{n}')}".rstrip() for n, x in shown.items())

    if found["kind"] == "rest":
        return f"rest at {places(found['middle'])}"
    least = 1e-3 * max(found["amplitude"].values())
    return (
        f"a periodic motion (period {number(found['period'])}; amplitude {places(found['amplitude'])}; about "
        f"{places(found['middle'], least)})"
    )
