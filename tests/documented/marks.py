"""Markers in Markdown: found, computed, compared, written."""

from __future__ import annotations

import ast
import os
import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.documented.values import VALUES, Value

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
MARK = re.compile(r"<!-- computed: (?P<call>[^>]+?) -->(?P<text>.*?)<!-- end -->", re.DOTALL)
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
COMMENT = re.compile(r"^(?P<code>[^#\n]+?)(?P<gap> +# )(?P<words>.*)$", re.MULTILINE)


@dataclass(frozen=True)
class Mark:
    """One marker: its page, what it asks for, and the text that stands there."""

    page: Path
    call: str
    text: str

    @property
    def value(self) -> Value:
        """Return the registered value."""
        return VALUES[self.call.split()[0]]

    @property
    def is_slow(self) -> bool:
        """Return whether it is left to `make docs-check`."""
        return self.value.is_slow

    def computed(self) -> str:
        """Return the text as the code gives it now."""
        name, *words = self.call.split()
        with tempfile.TemporaryDirectory() as folder:
            before = Path.cwd()
            os.chdir(folder)
            try:
                if name == "python":
                    return _executed(self.text)
                found = self.value.function(*words)
            finally:
                os.chdir(before)
        return f"\n\n{found}\n\n" if self.text.startswith("\n") else found


def marks() -> Iterator[Mark]:
    """Yield every marker of every page."""
    for page in PAGES:
        for match in MARK.finditer(page.read_text(encoding="utf-8")):
            yield Mark(page, match["call"], match["text"])


def is_same(written: str, computed: str) -> bool:
    """Return whether two texts are the same but for white space and one unit in the last digit of their numbers."""
    first, second = (" ".join(text.split()) for text in (written, computed))
    if NUMBER.sub("#", first) != NUMBER.sub("#", second):
        return False
    pairs = zip(NUMBER.findall(first), NUMBER.findall(second), strict=True)
    return all(abs(float(a) - float(b)) <= 1.001 * max(_unit(a), _unit(b)) for a, b in pairs)


def write(mark: Mark, text: str) -> None:
    """Put a text into the page, in place of the one that stands there."""
    page = mark.page.read_text(encoding="utf-8")
    head = f"<!-- computed: {mark.call} -->"
    page = page.replace(f"{head}{mark.text}<!-- end -->", f"{head}{text}<!-- end -->")
    mark.page.write_text(page, encoding="utf-8")


def _unit(number: str) -> float:
    """Return one unit in the last digit of a number as it is written; that of a count is 0."""
    mantissa, _, exponent = number.partition("e")
    if "." not in mantissa and not exponent:
        return 0.0
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def _executed(text: str) -> str:
    """Return a block of Python with the first number of each comment behind an expression as it is now."""
    code = re.sub(r"^```\w*$", "", text, flags=re.MULTILINE)
    names: dict[str, object] = {}
    results: dict[int, object] = {}
    for node in ast.parse(code).body:
        if isinstance(node, ast.Expr):
            results[node.end_lineno or node.lineno] = eval(compile(ast.Expression(node.value), "docs", "eval"), names)  # noqa: S307  # our own page
        else:
            exec(compile(ast.Module([node], []), "docs", "exec"), names)  # noqa: S102  # our own page
    lines = text.split("\n")
    for number, result in results.items():
        comment = COMMENT.match(lines[number - 1])
        if comment and isinstance(result, float) and (old := NUMBER.search(comment["words"])):
            words = comment["words"]
            digits = len(re.sub(r"e.*|[-.]", "", old[0]).lstrip("0"))
            lines[number - 1] = (
                f"{comment['code']}{comment['gap']}{words[: old.start()]}{result:#.{digits}g}{words[old.end() :]}"
            )
    return "\n".join(lines)
