"""The verb measure: one procedure of the identification, on recordings made for it."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from masking.app.workflows.output_folders import check_folder
from masking.control.rig.twin import Twin
from masking.errors import DeclarationError, Problem, RecordError, nearest
from masking.inference.procedures import measured_response, measurement
from masking.inference.procedures.channels import Source
from masking.inference.procedures.measurement import Measurement
from masking.lab.records.recording import Recording
from masking.reports import identification_page

PROCEDURES: Final[dict[str, Callable[..., Measurement[Any]]]] = {
    "springs": measurement.springs,
    "actuators": measurement.actuators,
    "friction": measurement.friction,
    "response": measured_response.response,
}
# Parameters of `measure` that are no settings.
_ALWAYS = frozenset({"procedure", "records", "plant", "out", "overwrite"})


def measure(
    procedure: str,
    *records: str | Path,
    plant: str | Path | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    input: str | None = None,
    sensor: str | None = None,
    order: int | None = None,
    settle: float | None = None,
    scale: float | None = None,
    force_scale: float | None = None,
    first: str | None = None,
    second: str | None = None,
    frequency: float | None = None,
    span: float | None = None,
    bins: int | None = None,
    inputs: Sequence[str] | None = None,
    sensors: Sequence[str] | None = None,
    period: float | None = None,
    discard: int | None = None,
) -> Measurement[Any]:
    """Do one procedure of the identification on recordings made for it.

    Args:
        procedure: 'springs' or 'actuators', of one record; 'friction' or 'response', of one or more.
        records: folders of recordings, or parquet files, with `input.*` and `sensor.*`.
        plant: a plant file, or a packaged plant, whose sensors turn readings into what they measure, such as a
            displacement in m; by default results are in the units of the readings.
        out: folder to save `<procedure>.html`, `<procedure>.json` and PNG files in; by default nothing is saved.
        overwrite: whether an earlier result in that folder may be replaced.
        input: springs, friction: the input that pushes; by default the only one that moves.
        sensor: springs, actuators, friction: the sensor of the displacement; by default the only one.
        order: springs: order of the polynomial, 5 by default.
        settle: springs: time left out at the start in s, 2 by default.
        scale: springs: unit of displacement of the coefficients; by default the length of the plant's model, or 1.
        force_scale: springs: unit of force of the coefficients; by default that of the plant's model, or 1.
        first: actuators: the input with the sine of constant amplitude.
        second: actuators: the input with the swept gain.
        frequency: actuators: frequency of the sines in Hz; by default that of the first input.
        span: actuators: range of gains around the balance that is used, 0.3 by default.
        bins: friction: number of bins over the travel, 100 by default.
        inputs: response: the inputs; by default all that move.
        sensors: response: the sensors; by default all.
        period: response: period of the excitation in s; by default as the record states, or as it repeats.
        discard: response: number of periods left out at the start, 1 by default.

    Raises:
        DeclarationError: there is no such procedure, or a setting is one of another.
        RecordError: a column or a recording is wrong, or there are too many.
        ModelError: a setting makes no sense.
    """
    settings = {name: value for name, value in locals().items() if name not in _ALWAYS and value is not None}
    if procedure not in PROCEDURES:
        message = f"there is no procedure '{procedure}'"
        raise DeclarationError(Problem(None, "", message, nearest(procedure, [*PROCEDURES])))
    parameters = inspect.signature(PROCEDURES[procedure]).parameters.values()
    known = [p.name for p in parameters if p.kind is p.KEYWORD_ONLY]
    for name in settings.keys() - set(known):
        raise DeclarationError(Problem(None, name, f"{procedure} has no such setting", nearest(name, known)))
    takes_one = not any(p.kind is p.VAR_POSITIONAL for p in parameters)
    if not records or (takes_one and len(records) > 1):
        raise RecordError(f"{procedure} takes {'one record' if takes_one else 'records'}; {len(records)} are given")
    check_folder(out, f"{procedure}.json", overwrite=overwrite)
    twin = None if plant is None else Twin.load(plant)
    sources = [Source(str(record), Recording.load(Path(record)), twin) for record in records]
    found = PROCEDURES[procedure](*sources, **settings)
    if out is not None:
        identification_page.save(found, out)
    return found
