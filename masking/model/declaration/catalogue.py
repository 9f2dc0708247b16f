"""Finding declarations: the packaged models and plants by name, any file by path, and of which kind a file is.

Needs neither pydantic nor sympy, so that a list of what there is takes no time.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from masking.display.printed_result import Printed
from masking.errors import DeclarationError, Place, Problem, nearest
from masking.model.declaration import strict_yaml
from masking.model.declaration.strict_yaml import Node

_PACKAGE = Path(__file__).resolve().parents[2]
_FOLDERS: dict[str, tuple[str, ...]] = {
    "model": ("models",),
    "plant": ("plants",),
    "experiment": tuple(f"examples/{shown}" for shown in ("oscillators", "clocks", "discs", "carts", "actuators")),
    "dictionary": ("dictionaries",),
    "batch": ("examples/batches",),
}
Kind = Literal["model", "plant", "experiment", "dictionary", "batch"]
KINDS = get_args(Kind)
_ENDINGS = (".yaml", ".yml")
_ARTICLE = {
    "model": "a model",
    "plant": "a plant",
    "experiment": "an experiment",
    "dictionary": "a dictionary of effects",
    "batch": "a batch of runs",
    None: "a declaration",
}
_PLURAL = {kind: f"{kind}s" for kind in KINDS} | {"dictionary": "dictionaries", "batch": "batches"}
OWN_KEYS: dict[str, frozenset[str]] = {  # what no other kind has
    kind: frozenset(keys.split())
    for kind, keys in {
        "experiment": "plants virtual transform controller initial duration time_scale record stop tolerance seed",
        "plant": "kind model sensors actuators limits allocation arm own_effects",
        "model": "extends coordinates states definitions equations lagrangian dissipation forces terms outputs "
        "energy scales oscillators elements events drawing",
        "dictionary": "dictionary",
        "batch": "experiment lockstep vary repeats retries cool drift patience budget",
    }.items()
}
_NAMED_BY = {("plant", "experiment"): "plant", ("model", "experiment"): "virtual", ("model", "plant"): "model"}


@dataclass(frozen=True, slots=True)
class Reference:
    """Where a name or path of another file was written, so that a bad one is reported there.

    `counts` are those of the file that holds it; they replace counts of the same names in the other.
    """

    place: Place | None = None
    path: str = ""
    folder: Path | None = None
    counts: Mapping[str, int] = field(default_factory=dict)


NOWHERE = Reference()


@dataclass(frozen=True, slots=True)
class Entry:
    """A packaged declaration: its kind, the name to call it by, and its title."""

    kind: str
    name: str
    title: str


class Catalogue(Printed, tuple[Entry, ...]):
    """Entries, ordered by kind."""

    __slots__ = ()

    @property
    def headline(self) -> str:
        """Number of entries of each kind."""
        return ", ".join(f"{_PLURAL[kind]} {sum(one.kind == kind for one in self)}" for kind in KINDS)

    def __str__(self) -> str:
        width, lines = max((len(one.name) for one in self), default=0), list[str]()
        for kind in KINDS:
            lines.append(_PLURAL[kind])
            lines += [f"  {one.name:{width}}  {one.title}" for one in self if one.kind == kind]
        return "\n".join(lines)


def catalogue() -> Catalogue:
    """Packaged declarations of each kind."""
    return Catalogue(Entry(kind, name, _title(path) or name) for kind in KINDS for name, path in files(kind).items())


def _title(path: Path) -> str:
    """Title in a packaged file: the value of its key `name`, which stands in one line; the rest is not read."""
    line = re.search("^name: .*", path.read_text(encoding="utf-8"), re.MULTILINE)
    content = strict_yaml.loads(line[0]).value if line else None
    return str(content["name"].value) if isinstance(content, dict) else ""


def files(kind: str) -> dict[str, Path]:
    """Packaged files of a kind, one of `KINDS`, by name: inside the installed package, else beside it in a checkout."""
    shipped = _PACKAGE / "shipped"
    root = shipped if shipped.is_dir() else _PACKAGE.parent
    found = [path for folder in _FOLDERS[kind] for path in (root / folder).glob("*.yaml")]
    return {path.stem: path for path in sorted(found, key=lambda path: path.stem)}


def names(kind: str) -> list[str]:
    """Names of the packaged files of a kind, one of `KINDS`."""
    return [*files(kind)]


def find(kind: str | None, name_or_path: str | Path, reference: Reference = NOWHERE) -> Path:
    """Give the file of a name in the registry, or of a path: one that ends in .yaml or contains a slash.

    Without a `kind`, one of `KINDS`, it is the first in their order that has the name. `reference` is where that was
    written. Raises a `DeclarationError` where there is none, it is of another kind, or no .yaml file.
    """
    text = str(name_or_path)
    for some in [kind] if kind else _FOLDERS:
        if text in (packaged := files(some)):
            return packaged[text]
    is_name = isinstance(name_or_path, str) and not text.endswith(_ENDINGS) and "/" not in text
    try:
        path = Path(text).expanduser()
    except RuntimeError:  # ~ of somebody who is not here
        path = Path(text)
    candidates = [reference.folder / path, path] if reference.folder else [path]
    if not is_name and (there := [candidate for candidate in candidates if _is(candidate, Path.is_file)]):
        if there[0].resolve().suffix not in _ENDINGS:  # whose lines no message shows
            message = f"{text} is no declaration: its name does not end in .yaml"
            raise DeclarationError(Problem(reference.place, reference.path, message, "name a .yaml file"))
        return there[0]
    if is_name and kind:
        for other in _FOLDERS:
            if other != kind and text in names(other):
                raise DeclarationError(wrong_kind(kind, other, text, reference))
    raise DeclarationError(_not_found(kind, text, is_name, candidates, reference))


def kind_of(name_or_path: str | Path) -> str:
    """Tell of which kind a name or file is, by its name or by its keys."""
    path = find(None, name_or_path)
    for kind in _FOLDERS:
        if str(name_or_path) in names(kind):
            return kind
    node = strict_yaml.decode(strict_yaml.read_bytes(path), str(path), refused=[])
    return kind_of_keys(node.value if isinstance(node.value, dict) else ()) or "model"


def kind_of_keys(keys: Collection[str]) -> str | None:
    """Tell of which kind a file with these keys is: the one with most keys of its own; None without any of those."""
    counts = {kind: len(own.intersection(keys)) for kind, own in OWN_KEYS.items()}
    kind = max(counts, key=counts.__getitem__)
    return kind if counts[kind] else None


def check_changes(kind: str, changes: Mapping[str, float] | None) -> None:
    """Refuse other values of parameters, of `--set`, for a kind that takes none, with a `DeclarationError`."""
    if changes and kind not in {"model", "experiment"}:
        message = f"values of {_ARTICLE[kind]} stand in its file"
        raise DeclarationError(Problem(None, "--set", message, "change them there"))


def wrong_kind(kind: str, found: str, shown: str, reference: Reference, node: Node | None = None) -> Problem:
    """Say that a file, whose content may be given as `node`, is of another kind, `found`, than is needed."""
    needed = f"{_ARTICLE[kind]} is needed here"
    entry = node.value.get(_NAMED_BY.get((kind, found), "")) if node and isinstance(node.value, dict) else None
    remedy = needed
    if kind == "experiment" and found in {"plant", "model"}:
        plant, virtual = (shown, "duffing") if found == "plant" else ("ideal", shown)
        remedy = f"{needed}, which names a plant and a model: 'plant: {plant}', 'virtual: {virtual}'"
    elif (kind, found) == ("plant", "model"):
        remedy = f"{needed}, which names a model: 'model: {shown}'"
    elif entry is not None and isinstance(entry.value, str):
        remedy = f"{needed}, such as the {found}'s own: {entry.value}"
    return Problem(reference.place, reference.path, f"{shown} is {_ARTICLE[found]}", remedy)


def _not_found(kind: str | None, text: str, is_name: bool, candidates: list[Path], reference: Reference) -> Problem:
    """Say that there is no such file or name, and what was probably meant."""
    message = f"there is no file {text}"
    remedy = f"{_ARTICLE[kind]} is a .yaml file"
    if is_name:
        message = f"there is no {kind or 'model, plant, experiment or dictionary'} '{text}'"
        remedy = nearest(text, [name for some in ([kind] if kind else _FOLDERS) for name in names(some)])
    endings = [end for end in _ENDINGS if any(_is(Path(f"{c}{end}"), Path.is_file) for c in candidates)]
    if endings:
        remedy = f"did you mean the file {text}{endings[0]}?"
    elif any(_is(candidate, Path.is_dir) for candidate in candidates):
        message, remedy = f"{text} is a folder", f"name a file in it; {remedy}" if not is_name else remedy
    elif is_name and any(_is(candidate, Path.is_file) for candidate in candidates):
        remedy = f"write ./{text} for the file {text}"
    return Problem(reference.place, reference.path, message, remedy)


def _is(path: Path, test: Callable[[Path], bool]) -> bool:
    """Apply a test to a path; one that the system cannot look up, such as a name too long, is not there."""
    try:
        return test(path)
    except (OSError, ValueError):
        return False
