"""Repetition: entries of a declaration that are written once for an index, and made for each of its values.

    repeat: [N = 50, i = 1..N]
    coordinates: {"x[i]": displacement of oscillator [i]}
    definitions: {x0: 0, "x[N+1]": 0}
    equations:
      x[i]'': c*(x[i-1] - 2*x[i] + x[i+1]) - x[i]**3
    energy: sum(i, x[i]'**2/2 + x[i]**4/4) + sum(i=1..N+1, c*(x[i] - x[i-1])**2/2)

It works on the nodes of a file, before anything is made of them, and so for every kind of declaration.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

from masking.errors import DeclarationError, Place, Problem, nearest
from masking.model.declaration.expression import Expression
from masking.model.declaration.operations import CONSTANTS, FUNCTIONS
from masking.model.declaration.strict_yaml import LARGEST_FILE, Node
from masking.model.declaration.syntax import DEEPEST_NESTING

LARGEST_MADE = 100_000  # entries, terms of sums and indices; measured: making as many takes five seconds
LONGEST_MADE = LARGEST_FILE  # characters
LONGEST_SUMS = 10_000  # characters of a text with sums in it, as written

_ITEM = re.compile(r"\s*([A-Za-z][A-Za-z0-9_]*)\s*=\s*(.*?)\s*(?:\.\.\s*(.*?)\s*)?")
_BRACKET = re.compile(r"(?P<name>[A-Za-z0-9_])?\[(?P<inside>[^][]*)\]")
_OWN_RANGE = re.compile(r"\[\s*([A-Za-z][A-Za-z0-9_]*)\s*=[^][]*\]")
_NAME = re.compile(r"(?<![\w.])[A-Za-z]\w*")
_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_SUM = re.compile(r"\bsum\(")
_REMEDY = "write 'repeat: i = 1..50', or 'repeat: [N = 50, i = 1..N]'"


def repeated(node: Node, given: Mapping[str, int]) -> tuple[Node, dict[str, int]]:
    """File with all its repeated entries made, and its counts, in place of which others may be given by name.

    Raises a `DeclarationError` where an index or a range is wrong, or an entry is made twice.
    """
    if not isinstance(node.value, dict) or "repeat" not in node.value:
        return node, {}
    repetition = _Repetition()
    repetition.declare(node.value["repeat"], given)
    rest = {key: child for key, child in node.value.items() if key != "repeat"}
    return repetition.made(replace(node, value=rest), repetition.counts, node.path), repetition.counts


@dataclass
class _Repetition:
    """The counts and ranges of a file, and how many things and characters have been made."""

    counts: dict[str, int] = field(default_factory=dict)
    ranges: dict[str, range] = field(default_factory=dict)
    things: int = 0
    characters: int = 0
    integers: dict[tuple[str, Place], Expression] = field(default_factory=dict)

    def declare(self, node: Node, given: Mapping[str, int]) -> None:
        """Read the items of `repeat`."""
        for item in node.value if isinstance(node.value, list) else [node]:
            match = _ITEM.fullmatch(item.text)
            if match is None:
                raise _problem(item, f"'{item.text}' is neither a count nor a range", _REMEDY)
            name, first, last = match.groups()
            if name in {*self.counts, *self.ranges}:
                raise _problem(item, f"'{name}' stands here twice", "give it another name")
            if last is not None:
                self.ranges[name] = self.range_of(first, last, self.counts, item)
            else:
                self.counts[name] = given[name] if name in given else self.number(first, self.counts, item)

    def range_of(self, first: str, last: str, known: Mapping[str, int], node: Node) -> range:
        low, high = (self.number(text, known, node) for text in (first, last))
        if high < low - 1:
            raise _problem(node, f"the range {low}..{high} ends before it begins", "write the smaller number first")
        if high - low >= LARGEST_MADE:
            raise _too_many(node)
        return range(low, high + 1)

    def number(self, text: str, known: Mapping[str, int], node: Node) -> int:
        """Integer that an expression of indices and counts is."""
        if (text, node.place) not in self.integers:
            self.integers[text, node.place] = Expression(text, node.place, node.path)
        expression = self.integers[text, node.place]
        if expression.unknown(known):
            raise DeclarationError(expression.check_symbols([*known]))
        value = expression.evaluate(known)
        if value != int(value):
            raise _problem(node, f"{text} is {value:g}, not an integer", _REMEDY)
        return int(value)

    def made(self, node: Node, known: Mapping[str, int], path: str) -> Node:
        """Node with everything inside it that is repeated, for known values of indices."""
        self.count(node)
        if isinstance(node.value, dict):
            return self.mapping(node, known, path)
        if isinstance(node.value, list):
            every = [(child, more) for child in node.value for more in self.values(self.free(child, known))]
            items = [self.made(child, {**known, **more}, f"{path}.{i}") for i, (child, more) in enumerate(every)]
            return replace(node, path=path, value=items)
        if not isinstance(node.value, str):
            return replace(node, path=path)
        return self.scalar(node, known, path)

    def mapping(self, node: Node, known: Mapping[str, int], path: str) -> Node:
        assert isinstance(node.value, dict)  # noqa: S101
        value, keys = dict[str, Node](), dict[str, Place]()
        for key, child in node.value.items():
            at = Node(key, node.keys[key], child.path, key)
            text, ranges = self.own_ranges(at, known)
            for more in self.values({**self.free(replace(at, text=text, value=text), known), **ranges}):
                name = self.text(text, {**known, **more}, at)
                if name in keys:
                    remedy = f"the first is in line {keys[name].line}; shorten a range, as in x[i=2..N]"
                    raise _problem(at, f"the key '{name}' is made twice", remedy)
                inner = f"{path}.{name}" if path else name
                value[name], keys[name] = self.made(child, {**known, **more}, inner), node.keys[key]
        return replace(node, path=path, value=value, keys=keys)

    def own_ranges(self, node: Node, known: Mapping[str, int]) -> tuple[str, dict[str, range]]:
        """Key without the ranges in it, such as x[i=2..N], and these ranges."""
        found = dict[str, range]()

        def take(match: re.Match[str]) -> str:
            item = _ITEM.fullmatch(match["inside"])
            if item is None or item[3] is None:
                return match[0]
            found[item[1]] = self.range_of(item[2], item[3], known, node)
            return f"{match['name'] or ''}[{item[1]}]"

        return _BRACKET.sub(take, node.text), found

    @staticmethod
    def values(ranges: Mapping[str, range]) -> Iterator[dict[str, int]]:
        """Every combination of values of some indices, of which the last varies fastest."""
        for combination in itertools.product(*ranges.values()):
            yield dict(zip(ranges, combination, strict=True))

    def free(self, node: Node, known: Mapping[str, int]) -> dict[str, range]:
        """Ranges of the indices in a node that have no value yet and get none inside it."""
        if isinstance(node.value, list):
            return {k: v for child in node.value for k, v in self.free(child, known).items()}
        if isinstance(node.value, dict):
            found = dict[str, range]()
            for key, child in node.value.items():
                text = _OWN_RANGE.sub(r"[\1]", key)
                bound = {**known, **dict.fromkeys((*self.indices(text, known, child), *_OWN_RANGE.findall(key)), 0)}
                found |= self.free(child, bound)
            return found
        return self.indices(node.text, known, node) if isinstance(node.value, str) else {}

    def indices(self, text: str, known: Mapping[str, int], node: Node) -> dict[str, range]:
        """Ranges of the indices in a text, outside of sums over them, that have no value yet."""
        found = dict[str, range]()
        outside, end = list[str](), 0
        for start, stop, index, body in sums(text, node):
            outside.append(text[end:start])
            end = stop
            name = index.partition("=")[0].strip()
            found |= self.indices(body, {**known, name: 0}, node)
        for match in _BRACKET.finditer("".join([*outside, text[end:]])):
            words = _WORD.findall(match["inside"])
            found |= {word: self.ranges[word] for word in words if word in self.ranges and word not in known}
        return found

    def scalar(self, node: Node, known: Mapping[str, int], path: str) -> Node:
        """Text for known values of indices; one that is arithmetic of numbers then is a number."""
        assert isinstance(node.value, str)  # noqa: S101
        text = self.text(node.value, known, node)
        if text == node.value:
            return replace(node, path=path)
        value: str | float = text
        if not {*_NAME.findall(text)} - {*FUNCTIONS, *CONSTANTS}:
            with suppress(DeclarationError):  # a text of numbers
                value = Expression(text).evaluate({})
        return replace(node, path=path, value=value, text=text, pieces=())

    def count(self, node: Node, characters: int = 0) -> None:
        """Count one more thing that is made, and its characters; refuse a file that makes too much."""
        self.things += 1
        self.characters += characters
        if self.things > LARGEST_MADE or self.characters > LONGEST_MADE:
            raise _too_many(node)

    def text(self, text: str, known: Mapping[str, int], node: Node) -> str:
        """Text with sums written out, and numbers in place of indices."""
        self.count(node, len(text))
        made, end = "", 0
        for start, stop, index, body in sums(text, node):
            made += self.indexed(text[end:start], known, node) + self.sum(index, body, known, node)
            end = stop
        return made + self.indexed(text[end:], known, node)

    def indexed(self, text: str, known: Mapping[str, int], node: Node) -> str:
        return _BRACKET.sub(lambda match: self.index(match, known, node), text)

    def sum(self, index: str, body: str, known: Mapping[str, int], node: Node) -> str:
        item = _ITEM.fullmatch(index)
        if item is not None and item[3] is not None:
            name, values = item[1], self.range_of(item[2], item[3], known, node)
        elif (name := index.strip()) in self.ranges:
            values = self.ranges[name]
        else:
            raise _problem(node, f"sum: '{name}' is no index", nearest(name, self.ranges))
        terms = [f"({self.text(body.strip(), {**known, name: value}, node)})" for value in values]
        return f"({' + '.join(terms) or '0'})"

    def index(self, match: re.Match[str], known: Mapping[str, int], node: Node) -> str:
        """Return what stands for the brackets of an index; others, such as those of a citation, stay."""
        self.count(node)
        before, inside = match["name"] or "", match["inside"]
        words = set(_WORD.findall(inside))
        if not words or not (before or words <= {*known, *self.ranges}):
            return match[0]
        if missing := sorted(words & self.ranges.keys() - known.keys()):
            name = missing[0]
            remedy = f"write the index into the key of the entry, such as x[{name}], or sum({name}, ...)"
            raise _problem(node, f"[{inside}]: the index {name} has no value here", remedy)
        if unknown := sorted(words - known.keys()):
            allowed = [*self.counts, *self.ranges]
            message = f"[{inside}]: '{unknown[0]}' is neither an index nor a count"
            raise _problem(node, message, nearest(unknown[0], allowed))
        number = self.number(inside, known, node)
        if before and number < 0:
            values = ", ".join(f"{word} = {known[word]}" for word in sorted(words))
            raise _problem(node, f"[{inside}] is {number} for {values}", "names end in 0 or more; shorten the range")
        return f"{before}{number}" if number >= 0 else f"({number})"


def sums(text: str, node: Node) -> Iterator[tuple[int, int, str, str]]:
    """Yield the outermost sums of a text: where each starts and stops, its index and what is summed."""
    if len(text) > LONGEST_SUMS and _SUM.search(text):
        message = f"a text with sums in it has {len(text)} characters, more than {LONGEST_SUMS}"
        raise _problem(node, message, "split it into definitions")
    end = 0
    while found := _SUM.search(text, end):
        depth, comma, end = 1, -1, found.end()
        while depth and end < len(text):
            depth += (text[end] == "(") - (text[end] == ")")
            if depth > DEEPEST_NESTING:
                return  # the expression will be refused
            if text[end] == "," and depth == 1 and comma < 0:
                comma = end
            end += 1
        if not depth and comma > 0:
            yield found.start(), end, text[found.end() : comma], text[comma + 1 : end - 1]


def _too_many(node: Node) -> DeclarationError:
    message = f"the repetition makes more than {LARGEST_MADE} entries, terms and indices, or {LONGEST_MADE} characters"
    return _problem(node, message, "shorten the ranges")


def _problem(node: Node, message: str, remedy: str) -> DeclarationError:
    return DeclarationError(Problem(node.place, node.path, message, remedy))
