"""The suite: which records are made, in two sizes, and what makes an outcome worth keeping."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from tests.benchmarks import hidden, mujoco_records
from tests.benchmarks.hidden.rig import Damping

ROOT = Path(__file__).resolve().parents[3]
Size = Literal["quick", "full"]


@dataclass(frozen=True)
class Line:
    """Records of one family; `noise` is that of `hidden.Case`, `seed` fixes what is drawn."""

    family: hidden.AnyFamily
    noise: float
    damping: Damping
    count: int
    seed: int


DAMPINGS: tuple[Damping, ...] = ("own", "light")
# Seeds that nobody tunes by: records to try things on are drawn from others.
QUICK_SEED, FULL_SEED = 7001, 2026

_QUICK: tuple[tuple[hidden.AnyFamily, float, Damping, int], ...] = (
    ("effect", 1e-3, "own", 5),
    ("effect", 1e-3, "light", 4),
    ("effect", 1e-4, "light", 3),
    ("effect", 3e-3, "own", 3),
    ("none", 1e-3, "own", 2),
    ("none", 3e-3, "light", 2),
    ("parameter", 1e-3, "own", 3),
    ("two", 1e-3, "own", 2),
    ("outside", 1e-3, "own", 3),
    ("dirty", 1e-3, "own", 2),
    ("dirty_none", 1e-3, "own", 2),
    ("mujoco", 1e-3, "own", 2),
)

_FULL: tuple[tuple[hidden.Family, float, int], ...] = (
    ("effect", 1e-3, 99),  # each effect three times
    ("effect", 1e-4, 99),
    ("effect", 3e-3, 66),  # without weak ones
    ("none", 1e-4, 50),
    ("none", 1e-3, 50),
    ("none", 3e-3, 50),
    ("parameter", 1e-3, 66),  # each parameter six times
    ("two", 1e-3, 40),
    ("outside", 1e-3, 48),
    ("dirty", 1e-3, 48),
    ("dirty_none", 1e-3, 40),
)

QUICK = tuple(
    Line(family, noise, damping, count, QUICK_SEED + number)
    for number, (family, noise, damping, count) in enumerate(_QUICK)
)

FULL = (
    *(
        Line(family, noise, damping, count, FULL_SEED + 2 * number + i)
        for number, (family, noise, count) in enumerate(_FULL)
        for i, damping in enumerate(DAMPINGS)
    ),
    Line("mujoco", 1e-3, "own", len(mujoco_records.HIDDEN), FULL_SEED + 2 * len(_FULL)),
)

SUITES: Mapping[Size, tuple[Line, ...]] = {"quick": QUICK, "full": FULL}


def cases(line: Line) -> list[hidden.Case]:
    """Return the cases of a line."""
    if line.family == "mujoco":
        return mujoco_records.cases(line.count, noise=line.noise, damping=line.damping, seed=line.seed)
    return hidden.cases(line.family, noise=line.noise, damping=line.damping, count=line.count, seed=line.seed)


def kept(case: hidden.Case) -> dict[str, Any]:
    """Return a case as JSON can hold it."""
    return asdict(case)


def restored(told: Mapping[str, Any]) -> hidden.Case:
    """Return the case that `kept` gave."""
    second = told["second"]
    return hidden.Case(
        **{
            **told,
            "second": second and hidden.Hidden(**second),
            "imperfections": tuple(hidden.Hidden(**one) for one in told["imperfections"]),
        }
    )


def digest(*folders: str) -> str:
    """Return a hash of all Python sources in folders or files, relative to the root of the project."""
    made = hashlib.sha256()
    for folder in folders:
        path = ROOT / folder
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            made.update(file.relative_to(ROOT).as_posix().encode())
            made.update(file.read_bytes())
    return made.hexdigest()[:16]


def key(case: hidden.Case, sources: str) -> str:
    """Return what an outcome is kept under: another seed or other sources make another outcome."""
    return f"{case.name}#{case.seed}#{sources}"


def read(path: Path) -> dict[str, dict[str, Any]]:
    """Return the outcomes in a file by their keys; a last line that was cut off is left out."""
    found: dict[str, dict[str, Any]] = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                outcome = json.loads(line)
            except json.JSONDecodeError:
                continue
            found[outcome["key"]] = outcome
    return found


def pieces(todo: Iterable[hidden.Case], size: int) -> list[list[hidden.Case]]:
    """Return cases in pieces that are generated together; none mixes families, and the longest work comes first."""
    groups: dict[str, list[hidden.Case]] = {}
    for case in todo:
        groups.setdefault(case.family, []).append(case)
    order: Sequence[str] = ("two", "outside", "dirty", "dirty_none", "mujoco", "effect", "parameter", "none")
    return [
        groups[family][i : i + size]
        for family in sorted(groups, key=order.index)
        for i in range(0, len(groups[family]), size)
    ]
