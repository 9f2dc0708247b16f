"""Card: an experiment in words, on one line and as a table in a notebook."""

from __future__ import annotations

from masking.display import fragments
from masking.model.declaration.registry import Assembly


def in_words(assembly: Assembly) -> str:
    """Which plant moves as which virtual system, how controlled and for how long."""
    plant, virtual = assembly.plant.name, assembly.virtual_model.name
    return f"{plant} as {virtual}, {_rate(assembly)}, {assembly.experiment.duration:g} units of virtual time"


def html(assembly: Assembly, observer: str) -> str:
    """Experiment as a table; `observer` is the kind of its observer."""
    d = assembly.experiment
    rows = [
        ("plant", assembly.plant.name),
        ("virtual system", assembly.virtual_model.name),
        ("controller", _rate(assembly) + (f", {observer} observer" if d.controller.rate is not None else "")),
        ("initial", ", ".join(f"{name} = {value:g}" for name, value in d.initial.items())),
        ("parameters", ", ".join(f"{name} = {value:g}" for name, value in d.parameters.items())),
        ("duration", f"{d.duration:g} units of virtual time"),
    ]
    return fragments.card(d.name, d.description or "", fragments.table(("", ""), [row for row in rows if row[1]]))


def _rate(assembly: Assembly) -> str:
    rate = assembly.experiment.controller.rate
    return "in continuous time" if rate is None else f"at {rate:g} Hz"
