"""The verb measure: one procedure of the identification, on recordings made for it."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from masking.app.workflows.output_folders import own_folder
from masking.app.workflows.settings_keywords import Parameter, parameters, show
from masking.control.rig.twin import Twin
from masking.errors import DeclarationError, Problem, RecordError, nearest
from masking.inference.procedures import measured_response, measurement
from masking.inference.procedures.channel_names import Source
from masking.inference.procedures.measurement import Measurement
from masking.lab.records.recording import Recording
from masking.reports import identification_page

PROCEDURES: Final[dict[str, Callable[..., Measurement[Any]]]] = {
    "springs": measurement.springs,
    "actuators": measurement.actuators,
    "friction": measurement.friction,
    "response": measured_response.response,
}


def _shown(verb: Callable[..., Measurement[Any]]) -> Callable[..., Measurement[Any]]:
    """The verb, whose signature and docstring have the settings of all procedures, each with those that take it."""
    settings: dict[str, Parameter] = {}
    takers: dict[str, list[str]] = {}
    for procedure, function in PROCEDURES.items():
        for name, setting in parameters(function).items():
            if setting.kind is inspect.Parameter.KEYWORD_ONLY:
                settings.setdefault(name, setting)
                takers.setdefault(name, []).append(procedure)
    lines = "".join(f"        {name}: {', '.join(takers[name])}: {s.text}\n" for name, s in settings.items())
    show(verb, settings, lines)
    return verb


@_shown
def measure(
    procedure: str,
    *records: str | Path,
    plant: str | Path | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    **settings: Any,  # noqa: ANN401  # of the procedure
) -> Measurement[Any]:
    """Do one procedure of the identification on recordings made for it.

    Args:
        procedure: 'springs' or 'actuators', of one record; 'friction' or 'response', of one or more.
        records: folders of recordings, or parquet files, with `input.*` and `sensor.*`.
        plant: a plant file, or a packaged plant, whose sensors turn readings into what they measure, such as a
            displacement in m; by default results are in the units of the readings.
        out: folder to save `<procedure>.html`, `<procedure>.json` and PNG files in; by default nothing is saved.
        overwrite: whether an earlier result in that folder may be replaced.
        settings: of the procedure.

    Raises:
        DeclarationError: there is no such procedure, or a setting is one of another.
        RecordError: a column or a recording is wrong, or there are too many.
        ModelError: a setting makes no sense.
    """
    if procedure not in PROCEDURES:
        message = f"there is no procedure '{procedure}'"
        raise DeclarationError(Problem(None, "", message, nearest(procedure, [*PROCEDURES])))
    declared = inspect.signature(PROCEDURES[procedure]).parameters.values()
    known = [p.name for p in declared if p.kind is p.KEYWORD_ONLY]
    settings = {name: value for name, value in settings.items() if value is not None}
    for name in settings.keys() - set(known):
        raise DeclarationError(Problem(None, name, f"{procedure} has no such setting", nearest(name, known)))
    takes_one = not any(p.kind is p.VAR_POSITIONAL for p in declared)
    if not records or (takes_one and len(records) > 1):
        raise RecordError(f"{procedure} takes {'one record' if takes_one else 'records'}; {len(records)} are given")
    with own_folder(out, f"{procedure}.json", overwrite=overwrite):
        twin = None if plant is None else Twin.load(plant)
        sources = [Source(str(record), Recording.load(Path(record)), twin) for record in records]
        found = PROCEDURES[procedure](*sources, **settings)
        if out is not None:
            identification_page.save(found, out)
        return found
