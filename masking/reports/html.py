"""Markup: the parts that every page of a report is made of, in one style, as HTML that needs no other file."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from string import Template
from typing import Final

GREEK: Final = frozenset(
    {"alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "kappa", "lambda", "mu", "nu"}
    | {"xi", "rho", "sigma", "tau", "phi", "chi", "psi", "omega"}
)
_TEMPLATE = Path(__file__).with_name("templates") / "base.html"
# Columns of words, which may run over several lines.
_WORDY = frozenset({"meaning", "measure", "value", "what helps", "where"})
_SYMBOL = re.compile(r"([A-Za-z]{1,3}|" + "|".join(sorted(GREEK)) + r")(\d*|_\w+)")
# Short words and units that may be names, too: symbols where a value follows, or where they do not stand as units.
_SHORT = frozenset({"A", "a", "an", "as", "at", "by", "in", "is", "it", "no", "of", "on", "or", "to", "all", "and",
                    "its", "not", "the"})  # fmt: skip
_UNITS = frozenset({"A", "C", "F", "H", "Hz", "J", "K", "N", "Pa", "T", "V", "W", "g", "h", "kg", "m", "min", "mm",
                    "ms", "rad", "s"})  # fmt: skip
_WORDS = {"chi": "<var>&chi;</var>", "pi": "&pi;", "alpha": "<var>&alpha;</var>", "eps": "<var>&epsilon;</var>"}


def document(name: str, lead: str, tiles: Sequence[str], sections: Sequence[str]) -> str:
    """Return a page.

    Args:
        name: its title, plain text.
        lead: what stands below the title, HTML.
        tiles: the numbers below that, as `tile` makes them.
        sections: what follows, as `section` makes them.
    """
    return Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        title=html.escape(name),
        heading=html.escape(name[0].upper() + name[1:]),
        lead=lead,
        tiles="\n".join(tiles),
        sections="\n".join(sections),
    )


def section(title: str, body: str) -> str:
    """Return a part of a page under a heading: a title in plain text, a body in HTML."""
    return f"<section>\n<h2>{html.escape(title)}</h2>\n{body}\n</section>"


def paragraph(text: str, kind: str, names: Collection[str] = ()) -> str:
    """Return a paragraph of plain text: of kind `lead`, `changed`, `missing`, `card` or `card wrong`."""
    return f'<p class="{kind}">{prose(text, names)}</p>'


def tile(label: str, value: str, unit: str = "", *, is_wrong: bool = False, names: Collection[str] = ()) -> str:
    """Return a number with a label above and a unit behind, all plain text."""
    small = f" <small>{prose(unit, names)}</small>" if unit else ""
    kind = ' class="wrong"' if is_wrong else ""
    return f"<div{kind}><dt>{prose(label, names)}</dt><dd>{prose(value, names)}{small}</dd></div>"


def picture(title: str, caption: str, image: bytes | None, names: Collection[str] = ()) -> str:
    """Return a figure: the content of a PNG file and a caption in plain text; without an image, the caption alone."""
    if image is None:
        return paragraph(caption, "missing", names)
    data = base64.b64encode(image).decode("ascii")
    alt = html.escape(f"{title}. {caption}", quote=True)
    words = prose(caption, names)
    return (
        f'<figure>\n<img alt="{alt}" src="data:image/png;base64,{data}">\n<figcaption>{words}</figcaption>\n</figure>'
    )


def table(
    head: Sequence[str], rows: Iterable[Sequence[str]], numbers: Collection[int] = (), names: Collection[str] = ()
) -> str:
    """Return a table of plain text; `numbers` are the columns that are set to the right."""
    kinds = [' class="n"' if i in numbers else ' class="t"' if text in _WORDY else "" for i, text in enumerate(head)]
    top = "".join(f"<th{kind}>{prose(text, names)}</th>" for kind, text in zip(kinds, head, strict=True))
    body = "".join(
        "<tr>" + "".join(f"<td{k}>{prose(str(cell), names)}</td>" for k, cell in zip(kinds, row, strict=True)) + "</tr>"
        for row in rows
    )
    return f'<div class="scroll" tabindex="0"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def provenance(rows: Iterable[tuple[str, object]]) -> str:
    """Return a table of names and values, both plain text and set as they are; rows without a value are left out."""
    body = "".join(
        f'<tr><th scope="row">{html.escape(name)}</th><td class="w">{html.escape(str(value))}</td></tr>'
        for name, value in rows
        if value
    )
    return f'<div class="scroll"><table><tbody>{body}</tbody></table></div>'


def details(summary: str, text: str) -> str:
    """Return plain text that is shown when its summary is opened."""
    return f"<details><summary>{html.escape(summary)}</summary><pre>{html.escape(text)}</pre></details>"


def prose(text: str, names: Collection[str] = ()) -> str:
    """Escape a text and typeset names in it that are symbols as such, and powers of ten and Greek letters."""

    def typeset(match: re.Match[str]) -> str:
        word = match.group()
        if word in names and is_symbol(word) and not _is_word(escaped, match):
            letters, index = re.fullmatch(r"(.*?)_?(\d*)", word).groups()  # type: ignore[union-attr]  # matches any word
            letters, index = (letters, index) if letters else (word, "")
            letters = f"&{letters};" if letters in GREEK else letters
            return f"<var>{letters}</var>" + (f"<sub>{index}</sub>" if index else "")
        return _WORDS.get(word, word)

    escaped = html.escape(text)
    escaped = re.sub(r"(?<![&\w])[A-Za-z_]\w*", typeset, escaped)
    escaped = re.sub(r"(?<=\d)e(-?)(\d+)\b", _power_of_ten, escaped)
    return escaped.replace("&lt;=", "&le;").replace(" - ", " &minus; ").replace("-&gt;", "&rarr;")


def is_symbol(name: str) -> bool:
    """Return whether a name is a symbol: a few letters or a Greek one, with or without an index; no English word."""
    return _SYMBOL.fullmatch(name) is not None


def _is_word(text: str, match: re.Match[str]) -> bool:
    """Return whether what has the name of a symbol is a word or a unit where it stands."""
    word, before, behind = match.group(), text[: match.start()], text[match.end() :]
    if word in _SHORT:
        return not behind.startswith(" =")
    return word in _UNITS and re.search(r"(\d |[^\W\d_]/\(?|/\([^\W\d_]+ |[⁻⁰¹²³⁴⁵⁶⁷⁸⁹µ] )$", before) is not None


def _power_of_ten(match: re.Match[str]) -> str:
    return f" &middot; 10<sup>{'&minus;' if match[1] else ''}{match[2]}</sup>"
