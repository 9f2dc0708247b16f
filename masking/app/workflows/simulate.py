"""The verb simulate: a record beside what a model makes of its inputs."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path

from masking.app.workflows import discovery_inputs
from masking.app.workflows.output_folders import own_folder
from masking.app.workflows.settings_keywords import with_fields_of
from masking.errors import ColumnError, DeclarationError, IntegrationError, ModelError, Problem
from masking.inference.estimation import simulation, unit_check
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.simulation import Simulated
from masking.lab.records.record_form import RecordForm
from masking.model.declaration import catalogue
from masking.reports import fit_figures, identification_page


@dataclass(frozen=True)
class Simulate(RecordForm):
    """Record and settings of a simulation.

    Args:
        record: folder of a recording, or a parquet, csv, mat, h5, npz or json file; `FILE@10:20` is its part from
            10 s to 20 s.
        plant: plant file with sensors and actuators for a model; without one, the outputs of the model are its sensors,
            or else its coordinates or states, and its inputs are the actuators.
        initial: s from the beginning in which readings are taken for the initial state; by default all.
        shooting_interval: length in s of intervals, each simulated from an initial state of its own, as an error of a
            discovery may be stated; by default the record is one.
        out: folder to save `simulation.html`, its figures and `simulation.json` in; by default nothing is saved.
        overwrite: whether an earlier result in that folder may be replaced.
    """

    record: str | Path
    _: KW_ONLY
    plant: str | Path | None = None
    initial: float | None = None
    shooting_interval: float | None = None
    out: str | Path | None = None
    overwrite: bool = False


@with_fields_of(Simulate)
def simulate(model: str | Path, settings: Simulate) -> Simulated:
    """Simulate a record with a model, from the initial state that fits best, and compare.

    Args:
        model: a model, or a plant file with its own model and effects; a name or a YAML file.
        settings: the fields of `Simulate`.

    Returns:
        measured and simulated readings, the residual, and the relative errors `chi` beside the noise `floor`.

    Raises:
        MaskingError: a declaration, a name, a setting or the record is wrong; the message says what to do about it.
    """
    record, plant, initial, interval = settings.record, settings.plant, settings.initial, settings.shooting_interval
    with own_folder(settings.out, "simulation.json", overwrite=settings.overwrite):
        twin = discovery_inputs.rig(model, plant)
        try:
            given = Data.read(record, twin, **settings.reading)
        except ColumnError as error:
            if plant is not None or catalogue.kind_of(model) == "plant":
                raise
            remedy = (
                "if the record has the sensors and actuators of a plant, name that with --plant (in Python, plant=)"
            )
            raise ColumnError(f"{error}; {remedy}") from None
        if initial is not None and interval is not None:
            message = "each shooting interval has an initial state of its own"
            raise DeclarationError(Problem(None, "initial", message, "give only one of initial and shooting_interval"))
        for name, seconds in (("initial", initial), ("shooting_interval", interval)):
            if seconds is not None and not 2 <= round(seconds * given.rate) <= len(given):
                least, most = 2.0 / given.rate, len(given) / given.rate
                message = f"{seconds:g} s do not hold 2 readings or more of the record"
                raise DeclarationError(Problem(None, name, message, f"give {least:g} ... {most:g} s"))
        doubt = unit_check.checked(twin, given)
        if doubt is not None:
            given = replace(given, notes=(*given.notes, doubt.note(twin, given)))
        try:
            if interval is None:
                made = simulation.simulate(twin, given, initial=initial)
            else:
                made = simulation.in_intervals(twin, given, interval)
        except IntegrationError as error:
            raise ModelError(
                f"{model}: its motion over {record} is not finite; check signs and units of its parameters, "
                f"or simulate a shorter part, such as {record}@0:1"
            ) from error
        if settings.out is not None:
            figures = [fit_figures.fit(made, ""), fit_figures.overview(made)]
            identification_page.save_simulation(made, figures, made.verdict(), settings.out)
        return made
