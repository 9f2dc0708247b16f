"""Public text uses the field's words: docs/vocabulary.md says which words it does without."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
VOCABULARY = ROOT / "docs" / "vocabulary.md"
SECTION = re.compile(r"^## Words that are not used$(.*?)^## ", re.MULTILINE | re.DOTALL)

# Old names that are quoted, in order to refuse them or to say what became of them.
QUOTED = {
    "masking/errors.py": {"fidelity", "horizon", "wiring"},
    "CHANGELOG.md": {"fidelity", "wiring"},
    "masking/control/exports/target_text.py": {"wiring"},  # a header of Arduino
}


def unwanted() -> list[str]:
    """Return the words of the left column that have no sense in brackets, in which alone they are unwanted."""
    rows = SECTION.search(VOCABULARY.read_text(encoding="utf-8"))[1].splitlines()
    cells = [row.split("|")[1] for row in rows if row.startswith("|")][2:]
    return [word.strip() for cell in cells for word in cell.split(",") if "(" not in word]


def texts(path: Path) -> list[str]:
    """Return the public texts of a file: docstrings and other strings of Python, the whole of anything else."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return [text]
    return [n.value for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Constant) and isinstance(n.value, str)]


FILES = sorted(
    path
    for pattern in (
        "masking/**/*.py",
        "masking/**/*.html",
        "*.md",
        "docs/*.md",
        "examples/*/*",
        "models/*",
        "plants/*",
        "dictionaries/*",
    )
    for path in ROOT.glob(pattern)
    if path.is_file() and path != VOCABULARY
)
PATTERN = re.compile(r"\b(" + "|".join(unwanted()).replace(" ", r"\s+") + r")\b", re.IGNORECASE)


def found(path: Path) -> set[str]:
    """Return the unwanted words of a file."""
    return {" ".join(word.lower().split()) for text in texts(path) for word in PATTERN.findall(text)}


def test_the_table_of_words_is_read():
    assert {"kin", "patchwork", "told", "put off", "fidelity"} <= set(unwanted())
    assert "rest" not in unwanted()


def test_public_text_uses_the_words_of_the_field():
    words = {
        name: found(path) - QUOTED.get(name, set()) for path in FILES if (name := path.relative_to(ROOT).as_posix())
    }
    assert not {name: unwanted for name, unwanted in words.items() if unwanted}


def test_what_is_excused_exists():
    assert all((ROOT / name).is_file() for name in QUOTED)
