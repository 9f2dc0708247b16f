"""The verb identify: parameters of a plant from recordings of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from masking.app.workflows import discovery_inputs
from masking.app.workflows.output_folders import own_folder
from masking.app.workflows.settings_keywords import showing
from masking.errors import DeclarationError, IntegrationError, Problem, RecordError, nearest
from masking.inference.discovery import parameter_prior
from masking.inference.estimation import extended_kalman, unit_check
from masking.inference.estimation import fit as fits
from masking.inference.estimation.extended_kalman import KalmanFit
from masking.inference.estimation.identification_data import Data
from masking.lab.records.record_form import RecordForm
from masking.reports import fit_figures, identification_page, model_files, one_page

Method = Literal["least-squares", "kalman"]
METHODS = get_args(Method)
LESS = 0.5  # of chi: a hold that leaves no more of it is proposed


@dataclass(frozen=True, kw_only=True)
class Identify(RecordForm):
    """Settings of an identification.

    Args:
        plant: a plant file, or a packaged plant: sensors, actuators, allocation, delay, and what is to be fitted;
            without one, the outputs of the model are its sensors, or else its coordinates or states, and its inputs are
            the actuators.
        model: a model; in place of the plant's own and of the effects in its elements if both are given.
        parameters: parameters to fit, of the model, and of effects as `<effect>_<parameter>`; by default all that the
            equations of the model hold.
        validation: held-out recordings, which validate the fit.
        shooting_interval: length in s of the intervals of multiple shooting at first; not for a filter.
        method: 'least-squares', or 'kalman' for one pass of the extended Kalman filter with the settings of 4.2.2.
        square_root: whether the filter carries a square root of its covariance.
        iterated: number of linearisations of the filter at each sample.
        out: folder to save `model.yaml`, `plant.yaml`, `fit.json`, `fit.html` and its figures in: `fit.png`,
            `validation.png` if there is a validation, `estimates.png` of a filter; by default nothing is saved.
        overwrite: whether an earlier result in that folder may be replaced.
        progress: called with the fraction done.
    """

    plant: str | Path | None = None
    model: str | Path | None = None
    parameters: Sequence[str] = ()
    validation: Sequence[str | Path] = ()
    shooting_interval: float | None = None
    method: Method = "least-squares"
    square_root: bool = False
    iterated: int = 1
    out: str | Path | None = None
    overwrite: bool = False
    progress: Callable[[float], None] | None = None


@showing(Identify)
def identify(*records: str | Path, **settings: Any) -> fits.Fit | KalmanFit:  # noqa: ANN401  # fields of `Identify`
    """Fit parameters of a plant to recordings of it.

    Args:
        records: folders of recordings, or parquet, csv, mat, h5, npz or json files, with `input.*` and `sensor.*` of
            the plant; `FILE@10:20` is its part from 10 s to 20 s. One for a filter.
        settings: the fields of `Identify`.

    Raises:
        MaskingError: a declaration, a name, a setting or a recording is wrong; the message says what to do about it.
    """
    given = Identify(**settings)
    _check_method(given, len(records))
    with own_folder(given.out, one_page.FIT, "model.yaml", "plant.yaml", overwrite=given.overwrite):
        twin = discovery_inputs.rig(given.model, given.plant)
        names = given.parameters or parameter_prior.uncertain(twin)
        train, held_out = (
            [Data.read(path, twin, **given.reading) for path in paths] for paths in (records, given.validation)
        )
        doubts = [(one, unit_check.checked(twin, one, names)) for one in (*train, *held_out)]
        more: dict[str, Any] = {"validation": held_out, "progress": given.progress}
        found: fits.Fit | KalmanFit
        if given.method == "kalman":
            form = extended_kalman.FilterSettings(square_root=given.square_root, iterated=given.iterated)
            found = extended_kalman.extended_kalman(twin, train[0], names, form, **more)
        else:
            found = fits.fit(twin, train, names, shooting_interval=given.shooting_interval, **more)
        declared, left = np.array([twin.parameter_value(name) for name in names]), max(found.chi.values())
        notes = list[str]()
        for one, doubt in doubts:
            notes += one.notes
            if doubt is not None and doubt.stands(declared, found.values, left):
                notes.append(doubt.note(twin, one))
        if isinstance(found, fits.Fit) and given.hold is None and any(one.hold == "zero-order" for one in train):
            notes += _between_samples(found, train, given.shooting_interval)
        found = replace(found, notes=(*dict.fromkeys(notes), *found.notes))
        if given.out is not None:
            figures, sentence = fit_figures.figures(found, train, held_out)
            sheet = identification_page.sheet(found, twin, train, held_out, sentence)
            model_files.save_fit(found, given.out, sheet)
            identification_page.save_fit(found, figures, sentence, given.out)
        return found


def _between_samples(found: fits.Fit, records: Sequence[Data], interval: float | None) -> list[str]:
    """Note where inputs that go in straight lines between samples leave far less than those that are held."""
    if not any(chi > max(fits.BEYOND * found.floor[name], fits.EXACT) for name, chi in found.chi.items()):
        return []
    try:
        again = fits.fit(found.twin, [one.first_order() for one in records], found.names, shooting_interval=interval)
    except IntegrationError:
        return []
    if any(again.chi[name] > LESS * chi for name, chi in found.chi.items()):
        return []
    errors = ", ".join(f"{again.chi[name]:.2g} in place of {chi:.2g} in {name}" for name, chi in found.chi.items())
    return [
        f"inputs that go in straight lines between samples leave chi {errors}: if they were measured, and not sent "
        "sample by sample, give 'hold: first-order' (--hold first-order)"
    ]


def _check_method(given: Identify, records: int) -> None:
    """Refuse an unknown method, and settings of the other one."""
    if given.method not in METHODS:
        message = f"there is no method '{given.method}'"
        raise DeclarationError(Problem(None, "method", message, nearest(given.method, METHODS)))
    if not records:
        raise RecordError("give at least one recording to fit")
    if given.method == "kalman" and records > 1:
        raise RecordError(
            f"the filter takes one record, {records} are given; filter one after the other, or fit them together by "
            "least squares"
        )
    if given.method == "kalman" and given.shooting_interval is not None:
        raise DeclarationError(Problem(None, "shooting_interval", "a filter has none", "leave it out"))
    if given.method != "kalman" and (given.square_root or given.iterated != 1):
        message = "square roots and iterations are settings of the filter"
        raise DeclarationError(Problem(None, "method", message, "give the method kalman"))
