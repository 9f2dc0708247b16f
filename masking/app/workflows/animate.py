"""The verb animate: a recording as a page, a picture or a film of the rig beside its virtual system."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from masking.app.workflows.output_folders import beside, own_folder
from masking.app.workflows.settings_keywords import with_fields_of
from masking.errors import RecordError
from masking.lab.records.recording import Recording
from masking.lab.records.time_slice import Part
from masking.lazy_imports import animation_frames
from masking.reports import animation

FORMATS: Final = (".html", ".png", ".svg", ".gif", ".mp4")
_MOST: Final = 2**20  # samples of a whole recording that is shown


@dataclass(frozen=True, kw_only=True)
class AnimateSettings:
    """What of a recording is shown, and where it goes.

    Args:
        out: file, whose ending says what it is: `.html`, a page that needs no other file; `.png` or `.svg`, a picture
            of one instant; `.gif`, or `.mp4` if ffmpeg is installed, a film of 12 s at most. By default
            `animation.html` beside the recording.
        overwrite: whether a file that is there may be replaced; the page beside the recording always is.
        at: instant of a picture, s; by default the middle of the recording.
        progress: called with the fraction done.
    """

    out: str | Path | None = None
    overwrite: bool = False
    at: float | None = None
    progress: Callable[[float], None] | None = None


@with_fields_of(AnimateSettings)
def animate(record: str | Path | Recording, settings: AnimateSettings) -> Path | animation.Animation:
    """Write an animation of a recording: the rig, the virtual system beside it, and the motion over time.

    Models say under `drawing` what they look like; of a model that does not, each coordinate moves a body on a line.

    Args:
        record: the folder of a recording, or its parquet file; `FOLDER@10:20` is its part from 10 s to 20 s. In Python,
            a `Recording`, too.
        settings: the fields of `AnimateSettings`.

    Returns:
        the file; of a `Recording` without `out` an `Animation`, which a notebook shows, and nothing is written.

    Raises:
        RecordError: there is no recording, it holds no motion, or the file cannot be written.
    """
    if isinstance(record, Recording):
        if settings.out is None:
            return animation.Animation(_thinned(record))
        return _write(lambda: _thinned(record), Path(settings.out), settings)
    part = Part.of(record)
    page = beside(part.file) / animation.PAGE
    file = page if settings.out is None else Path(settings.out)
    is_own = file.resolve() == page.resolve()
    own = replace(settings, overwrite=settings.overwrite or is_own)
    return _write(lambda: _cut(Recording.load(part.file), part), file, own)


def _write(source: Callable[[], Recording], file: Path, settings: AnimateSettings) -> Path:
    if file.suffix not in FORMATS:
        raise RecordError(f"{file}: an animation ends in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}")
    with own_folder(file.parent, file.name, overwrite=settings.overwrite):
        shown, at = animation.Animation(source()), settings.at
        first, last = shown.recording.t[[0, -1]]
        if at is not None and not first <= at <= last:
            raise RecordError(f"at {at:g} s there is nothing: the recording goes from {first:g} s to {last:g} s")
        file.parent.mkdir(parents=True, exist_ok=True)
        if file.suffix == ".html":
            animation.save(shown, file)
        elif file.suffix in animation_frames.FILMS:
            animation_frames.film(shown, file, settings.progress or (lambda fraction: None))
        else:
            animation_frames.picture(shown, 0.5 * (first + last) if at is None else at, file)
        return file


def _cut(recording: Recording, part: Part) -> Recording:
    if part.start is None and part.end is None:
        return _thinned(recording)
    found = recording.between(part.start, part.end)
    if len(found) < 2:
        raise RecordError(f"{part.name} holds one sample, which does not move; name a longer part")
    return found


def _thinned(recording: Recording) -> Recording:
    return recording.thinned(_MOST, recording.names())
