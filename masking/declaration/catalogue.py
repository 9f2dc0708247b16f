"""Finding declarations: the packaged models and plants by name, any file by path.

Needs neither pydantic nor sympy, so that a list of what there is takes no time.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from masking.errors import DeclarationError, Place, Problem, nearest

_PACKAGE = Path(__file__).resolve().parents[1]
_FOLDERS = {"model": "models", "plant": "plants", "experiment": "examples"}


@dataclass(frozen=True, slots=True)
class Reference:
    """Where a name or path of another file was written, so that a bad one is reported there."""

    place: Place | None = None
    path: str = ""
    folder: Path | None = None


NOWHERE = Reference()


def folder(kind: str) -> Path:
    """Give the folder of packaged files of a kind: inside the installed package, else beside it in a checkout."""
    installed = _PACKAGE / _FOLDERS[kind]
    return installed if installed.is_dir() else _PACKAGE.parent / _FOLDERS[kind]


def names(kind: str) -> list[str]:
    """List the names of the packaged files of a kind ("model", "plant" or "experiment")."""
    root = folder(kind)
    return sorted(path.relative_to(root).with_suffix("").as_posix() for path in root.rglob("*.yaml"))


def find(kind: str, name_or_path: str | Path, reference: Reference = NOWHERE) -> Path:
    """Give the file of a name in the registry, or of a path: one that ends in .yaml or contains a slash."""
    text = str(name_or_path)
    known = names(kind)
    if text in known:
        return folder(kind) / f"{text}.yaml"
    if isinstance(name_or_path, str) and not text.endswith((".yaml", ".yml")) and "/" not in text:
        message = f"there is no {kind} '{text}'"
        raise DeclarationError(Problem(reference.place, reference.path, message, nearest(text, known)))
    path = Path(text).expanduser()
    for candidate in [reference.folder / path, path] if reference.folder else [path]:
        if candidate.is_file():
            return candidate
    raise DeclarationError(
        Problem(reference.place, reference.path, f"there is no file {text}", f"a {kind} is a .yaml file")
    )
