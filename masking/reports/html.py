"""HTML of reports: templates in which every value is escaped, names typeset as symbols, and the files of a report."""

from __future__ import annotations

import base64
import contextlib
import functools
import importlib.metadata
import math
import platform
import re
import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import markupsafe
from markupsafe import Markup

from masking.display import palette
from masking.display.json_text import json_text
from masking.display.symbols import is_symbol
from masking.display.symbols import markup as symbol
from masking.errors import RecordError
from masking.lazy_imports import jinja2, style
from masking.model.declaration.quantities import number, percent, with_deviation
from masking.model.declaration.units import pretty
from masking.reports.text import capital, capped, listed, probability_text, signed

_TEMPLATES = Path(__file__).with_name("templates")
# Short words and units that may be names, too: symbols where a value follows, or where they do not stand as units.
_SHORT = frozenset({"A", "a", "an", "as", "at", "by", "in", "is", "it", "no", "of", "on", "or", "to", "all", "and",
                    "its", "not", "the"})  # fmt: skip
_UNITS = frozenset({"A", "C", "F", "H", "Hz", "J", "K", "N", "Pa", "T", "V", "W", "g", "h", "kg", "m", "min", "mm",
                    "ms", "rad", "s"})  # fmt: skip
_WORDS = {"chi": "<var>&chi;</var>", "pi": "&pi;", "alpha": "<var>&alpha;</var>", "eps": "<var>&epsilon;</var>",
          "tau_s": "<var>&tau;</var><sub>s</sub>"}  # fmt: skip


class Tile(NamedTuple):
    """A number at the top of a page, with a label above and a unit behind it."""

    label: str
    value: str
    unit: str = ""
    is_wrong: bool = False


def render(template: str, **facts: object) -> str:
    """Page of a template, by its name without `.html`; `names` are typeset if they are symbols."""
    return environment().get_template(f"{template}.html").render(**facts)


def save(
    page: Path,
    template: str,
    figures: Sequence[style.CaptionedFigure],
    numbers: Mapping[str, Any] | None = None,
    **facts: object,
) -> None:
    """Write a page with its figures, those that are drawn, as PNG files beside it, and its numbers, if any, as JSON.

    Facts are as for `render`. Raises a `RecordError` where a file cannot be written.
    """
    contents: dict[Path, bytes | str] = {**images(figures, page.parent)}
    if numbers is not None:
        contents[page.with_suffix(".json")] = json_text(numbers)
    write({**contents, page: render(template, figures=figures, **facts)})


def images(figures: Iterable[style.CaptionedFigure], folder: Path) -> dict[Path, bytes]:
    """Content of the PNG file of each figure that is drawn, by its path in a folder."""
    return {folder / f"{one.name}.png": one.png for one in figures if one.png is not None}


def write(contents: Mapping[Path, bytes | str]) -> None:
    """Write files, texts as UTF-8, and their folders if need be; a `RecordError` says that one cannot be written."""
    for path, content in contents.items():
        with writing(path.parent):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content.encode() if isinstance(content, str) else content)


@contextlib.contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Context in which an error of the system is a `RecordError` that says that a folder cannot be written."""
    try:
        yield
    except OSError as error:
        raise RecordError(f"{folder} cannot be written: {error.strerror or error}; name another folder") from error


@contextlib.contextmanager
def staged(folder: Path | None) -> Iterator[Path]:
    """Folder to write into, whose files are moved to another one at the end, unless an error is raised.

    It lies beside the other, so that paths from both to other files are the same. Without another, it lies anywhere,
    and its files are deleted. Raises a `RecordError` where one of them cannot be written.
    """
    with writing(folder or Path(tempfile.gettempdir())):
        there = None if folder is None else folder.resolve()
        if there is not None:
            there.parent.mkdir(parents=True, exist_ok=True)
        name, beside = ("masking", None) if there is None else (f".{there.name}", there.parent)
        with tempfile.TemporaryDirectory(prefix=f"{name}-", dir=beside, ignore_cleanup_errors=True) as made:
            yield Path(made)
            if there is None:
                return
            for path in sorted(p for p in Path(made).rglob("*") if p.is_file()):
                target = there / path.relative_to(made)
                target.parent.mkdir(parents=True, exist_ok=True)
                path.replace(target)


def versions(*libraries: str) -> str:
    """Versions of Python and of libraries in a line."""
    each = [f"{library} {importlib.metadata.version(library)}" for library in libraries]
    return ", ".join([f"python {platform.python_version()}", *each])


def prose(text: object, names: Collection[str] = ()) -> Markup:
    """Escape a text and typeset its `names` of symbols, powers of ten and Greek letters; markup stays as it is."""

    def typeset(match: re.Match[str]) -> str:
        word = match.group()
        if word in names and is_symbol(word) and not _is_word(escaped, match):
            return symbol(word)
        return _WORDS.get(word, word)

    if isinstance(text, Markup):
        return text
    escaped = str(markupsafe.escape(str(text)))
    escaped = re.sub(r"(?<![&\w])[A-Za-z_]\w*", typeset, escaped)
    escaped = re.sub(r"(?<=\d)e(-?)(\d+)\b", _power_of_ten, escaped)
    escaped = re.sub(r"(?<=\d) (?=%)", "\N{NO-BREAK SPACE}", escaped)
    return Markup(escaped.replace("&lt;=", "&le;").replace(" - ", " &minus; ").replace("-&gt;", "&rarr;"))  # noqa: S704  # escaped above


def _is_word(text: str, match: re.Match[str]) -> bool:
    """Whether what has the name of a symbol is a word or a unit where it stands."""
    word, before, behind = match.group(), text[: match.start()], text[match.end() :]
    if word in _SHORT:
        return not behind.startswith(" =")
    return word in _UNITS and re.search(r"(\d |[^\W\d_]/\(?|/\([^\W\d_]+ |[⁻⁰¹²³⁴⁵⁶⁷⁸⁹µ] )$", before) is not None


def _power_of_ten(match: re.Match[str]) -> str:
    return f" &middot; 10<sup>{'&minus;' if match[1] else ''}{match[2]}</sup>"


@functools.cache
def environment() -> jinja2.Environment:
    """Environment of all templates: values are escaped, and one that is missing is an error."""
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {
        "prose": jinja2.pass_context(lambda context, text: prose(text, context.get("names", ()))),
        "base64": lambda content: base64.b64encode(content).decode("ascii"),
        "capital": capital,
        "capped": capped,
        "deviation": with_deviation,
        "digits": lambda part: f"{part:.4f}" if part >= 0.01 else f"{part:.5f}",
        "listed": listed,
        "number": number,
        "percent": percent,
        "probability": probability_text,
        "signed": signed,
        "symbol": symbol,
        "unit": pretty,
    }
    made.globals |= {"palette": palette, "infinity": math.inf, "versions": versions}
    return made
