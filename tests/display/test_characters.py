"""Characters that no text may have: by the tables of Unicode, what is shown in their place, and what a figure draws."""

import io
import json
import sys
import unicodedata

import numpy as np
from matplotlib.figure import Figure

from masking.display.characters import UNFIT, json_escaped, visible, visible_line
from masking.display.json_text import json_text
from masking.display.symbols import in_figure, tex

EVERY = [chr(code) for code in range(sys.maxunicode + 1)]


def is_unfit(character):
    """Return whether Unicode calls a character a control, half of one, a break of lines, of direction, or none."""
    number = ord(character)
    is_none = number & 0xFFFE == 0xFFFE or 0xFDD0 <= number <= 0xFDEF
    is_control = unicodedata.category(character) in {"Cc", "Cs", "Zl", "Zp"} and character not in "\t\n"
    name = unicodedata.name(character, "")
    turns = unicodedata.bidirectional(character) in {"LRE", "RLE", "PDF", "LRO", "RLO", "LRI", "RLI", "FSI", "PDI"}
    return is_none or is_control or turns or (name.endswith("MARK") and "-TO-" in name) or name in {
        "ARABIC LETTER MARK", "ZERO WIDTH NO-BREAK SPACE"}  # fmt: skip


def test_unfit_characters_are_those_of_the_tables_of_unicode():
    assert [f"{ord(c):x}" for c in EVERY if (UNFIT.fullmatch(c) is not None) != is_unfit(c)] == []


def test_what_is_shown_has_none_of_them_and_keeps_all_others():
    every = "".join(EVERY)
    assert not UNFIT.search(visible(every))
    assert UNFIT.sub("", every) == "".join(part.partition(">")[2] if i else part for i, part in
                                           enumerate(visible(every.replace("<U+", "")).split("<U+")))  # fmt: skip
    assert visible_line("a\x1b[31m\tb\n") == "a<U+001B>[31m<U+0009>b<U+000A>"


def test_json_is_the_same_content_without_them():
    content = {" ".join(c for c in EVERY if UNFIT.fullmatch(c)): ["\u00e9\n", '"\\']}
    for text in (json_text(content), json_escaped(json.dumps(content, ensure_ascii=False))):
        assert not UNFIT.search(text)
        assert json.loads(text) == content


def test_a_figure_draws_any_text_and_typesets_symbols_alone():
    pieces = ["$", "\\", "{", "}", "_", "^", "x", "frac", "\\foo", "\\$", " ", tex("alpha"), tex("x1"), tex("mass_2")]
    generator = np.random.default_rng(0)
    texts = ["".join(pieces[i] for i in generator.integers(len(pieces), size=8)) for _ in range(60)]
    figure = Figure(figsize=(1, 1), dpi=20)
    for text in ("$\\foo{$", "5 $ to 6 $", "$" + "{" * 500 + "$", *texts):
        figure.text(0, 0, in_figure(text))
    figure.savefig(io.BytesIO(), format="png")
    assert in_figure(f"{tex('x1')} costs $5 to $6") == r"$x_{1}$ costs \$5 to \$6"
