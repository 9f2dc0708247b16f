"""The verb discover: from the file of a record to the effect that the model of its rig lacks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from masking.app.workflows import discovery_inputs
from masking.app.workflows.output_folders import own_folder
from masking.app.workflows.settings_keywords import with_fields_of
from masking.inference.discovery import discovery_stages as discovery
from masking.inference.discovery.discovery_result import Discovery
from masking.inference.discovery.discovery_settings import DiscoverySettings
from masking.inference.discovery.search_state import Tell
from masking.lab.records.record_form import RecordForm
from masking.reports import discovery_files, discovery_page


@dataclass(frozen=True, kw_only=True)
class Discover(RecordForm, DiscoverySettings):
    """Settings of a discovery, the rig, how its records are given, and where the result goes.

    Args:
        model: model of the rig, a name or a file; in place of the plant's own if both are given.
        plant: plant file with sensors and actuators; without one, the outputs of the model are its sensors, or else
            its coordinates or states, and its inputs are the actuators.
        out: folder to save `models/<model>+<effect>.yaml`, `plant.yaml`, `discovery.json`, `discovery.html` and its
            figures in, all of them or none; by default nothing is saved.
        overwrite: whether an earlier result in that folder may be replaced.
        tell: called with the step under way, and the fraction done.
    """

    model: str | Path | None = None
    plant: str | Path | None = None
    out: str | Path | None = None
    overwrite: bool = False
    tell: Tell | None = None


@with_fields_of(Discover)
def discover(record: str | Path, settings: Discover) -> Discovery:
    """Find the physical effect that the model of a rig lacks, and write the model with it.

    Args:
        record: folder of a recording, or a parquet, csv, mat, h5, npz or json file, with the channels of the plant;
            `FILE@10:20` is its part from 10 s to 20 s.
        settings: the fields of `Discover`.

    Raises:
        MaskingError: a declaration, a name, a setting or a record is wrong; the message says what to do about it.
    """
    with own_folder(settings.out, discovery_files.NUMBERS, "plant.yaml", overwrite=settings.overwrite):
        twin = discovery_inputs.with_effects(discovery_inputs.rig(settings.model, settings.plant), settings.effects)
        given = discovery_inputs.read(twin, record, settings.validation, settings)
        named = replace(settings, parameters=discovery_inputs.parameters(twin, settings.parameters))
        found = discovery.discover(twin, given.record, given.validation, named, tell=settings.tell)
        if settings.out is not None:
            discovery_page.save(found, settings.out, given.origin)
        return replace(found, text=discovery_page.summary)
