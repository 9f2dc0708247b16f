"""The verb discover: from the file of a record to the effect that the model of its rig lacks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from masking.discovery import discover as discovery
from masking.discovery.discovery import Discovery
from masking.discovery.search import Tell
from masking.discovery.settings import DiscoverySettings
from masking.reports import discovery_files, discovery_page
from masking.workflows import inputs
from masking.workflows.outputs import check_folder
from masking.workflows.settings import with_fields_of


@dataclass(frozen=True, kw_only=True)
class Discover(DiscoverySettings):
    """Settings of a discovery, the rig, and where the result goes.

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
    """Find out which physical effect the model of a rig lacks, and write the model with it.

    Args:
        record: folder of a recording, or a parquet, csv, mat, h5, npz or json file, with the channels of the plant;
            `FILE@10:20` is its part from 10 s to 20 s.
        settings: the fields of `Discover`.

    Raises:
        MaskingError: a declaration, a name, a setting or a record is wrong; the message says what to do about it.
    """
    check_folder(settings.out, discovery_files.NUMBERS, "plant.yaml", overwrite=settings.overwrite)
    twin = inputs.with_effects(inputs.rig(settings.model, settings.plant), settings.effects)
    given = inputs.read(twin, record, settings)
    named = replace(settings, parameters=inputs.parameters(twin, settings.parameters))
    found = discovery.discover(twin, given.record, given.validation, named, tell=settings.tell)
    if settings.out is not None:
        discovery_page.save(found, settings.out, given.origin)
    return found
