"""Answered: a discovery from its files to its files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from masking.discovery.discover import discover
from masking.discovery.discovery import Discovery
from masking.discovery.settings import TOLERANCE, DiscoverySettings
from masking.estimation.data import InputHold
from masking.reports import discovery_page
from masking.reports.discovery_files import Files
from masking.workflows import inputs


def answered(
    record: str | Path,
    *,
    model: str | Path | None = None,
    plant: str | Path | None = None,
    validation: str | Path | None = None,
    parameters: Sequence[str] = (),
    tolerance: float = TOLERANCE,
    shooting_interval: float | None = None,
    hold: InputHold | None = None,
    columns: Mapping[str, str] | None = None,
    dt: float | None = None,
    effects: str | Path | None = None,
    out: str | Path | None = None,
    tell: Callable[[str, float], None] | None = None,
) -> tuple[Discovery, Files | None]:
    """Find out which physical effect a model is missing, and write the model with it.

    Args:
        record: a folder of a recording, or a parquet, csv, mat or h5 file, with the channels of the plant; or a part
            of one, as for `identify`.
        model: what is believed of the rig; in place of the plant's own where both are given.
        plant: its sensors and actuators; without one, outputs or coordinates of the model are read, and its inputs.
        validation: another record for validation; the last part of the record where none is given.
        parameters: of the model that may be off; all that its equations hold where none are given.
        tolerance: relative standard deviation of a parameter that declares none.
        shooting_interval: length of the intervals of multiple shooting in s; by default the whole record, or shorter
            intervals if the model is not asymptotically stable.
        hold: how inputs go from each sample to the next, as for `identify`.
        columns: of the files, by the names that they get, such as `{"t": "time", "u": "V1"}`.
        dt: time between samples in s, for a table without a clock.
        effects: a dictionary of own effects, a file or a packaged name, which are tried, too.
        out: folder to save in: `models/<model>+<effect>.yaml`, `plant.yaml`, `discovery.json`, `discovery.html` and
            its figures; nothing is saved where none is given, and nothing half where it is interrupted.
        tell: called with what is done, and the fraction done.

    Returns:
        what was found, and the files; None where nothing is saved.

    Raises:
        MaskingError: a declaration, a name, a setting or a record is wrong; says what to do about it.
    """
    inputs.check_tolerance(tolerance)
    what = inputs.asked(record, model, plant, validation, hold=hold, columns=columns, dt=dt, effects=effects)
    found = discover(
        what.twin,
        what.record,
        what.validation,
        DiscoverySettings(
            parameters=inputs.parameters(what.twin, parameters),
            tolerance=tolerance,
            shooting_interval=shooting_interval,
        ),
        tell=tell,
    )
    return found, None if out is None else discovery_page.save(found, out, what.origin)
