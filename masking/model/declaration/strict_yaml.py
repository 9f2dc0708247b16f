"""A strict reader of YAML that keeps the place of every key and value.

It reads PyYAML's events, never its constructors, and refuses what silently means something else: duplicate keys,
anchors, aliases, merge keys, tags, several documents, and plain scalars such as `on`, `010`, `1:30` or a date.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn

import yaml

from masking.display.characters import UNFIT, code_point
from masking.errors import DeclarationError, Place, Problem

LARGEST_FILE = 2**20
DEEPEST_NESTING = 50

_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the same events, in C where PyYAML was built so

_NUMBER = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?", re.ASCII)
_LEADING_ZERO = re.compile(r"[-+]?0\d")
# y, n and N are truth values in YAML 1.1 too, though not in PyYAML; they are names here, and N is the newton.
_AMBIGUOUS: tuple[tuple[str, str, str], ...] = (  # what YAML 1.1 makes of it, and what to write instead
    (r"(?i:on|off|yes|no)", "is true or false in YAML 1.1", "quote it or write true/false"),
    (r"(?i:[-+]?\.?(?:inf(?:inity)?|nan))", "is not a finite number", "write a finite number"),
    (r"[-+]?0[0-9_]+(?:\.\d*)?(?:[eE].*)?|0o[0-7]+", "is an octal number in YAML", "leave the leading zero away"),
    (r"[-+]?0(?:x[0-9a-fA-F_]+|b[01_]+)", "is a hexadecimal or binary number in YAML 1.1", "write it in decimals"),
    (r"[-+]?\d[\d_]*(?::[0-5]?\d)+(?:\.\d*)?", "is a number to base 60 in YAML 1.1", "write it in decimals"),
    (r"\d{4}-\d\d?-\d\d?(?:[Tt ].*)?", "is a date in YAML 1.1", "quote it"),
    (r"[-+]?\d[\d_]*_[\d_]*(?:\.[\d_]*)?(?:[eE].*)?", "is a number in YAML 1.1", "leave the underscores away"),
)
_NO_SPACE = re.compile(r"[\w)]['\"]*:[^\s:/]")
_CONTENT = re.compile(r"\s*[^\s#]")
_KEY = re.compile(r":(?: |$)")
_LONGEST_SHOWN, _LINES_ABOVE = 40, 50
_IN_A_KEY = re.compile(f"[\\t\\n]|{UNFIT.pattern}")


@dataclass(frozen=True)
class Node:
    """A value with its place: a mapping, a list, a text, a finite number, a truth value or null.

    `text` is a scalar as written, `keys` the places of a mapping's keys, `pieces` (index into the text, place) pairs
    where the characters of the text do not follow one another in the file.
    """

    value: dict[str, Node] | list[Node] | str | float | bool | None
    place: Place
    path: str = ""
    text: str = ""
    keys: dict[str, Place] = field(default_factory=dict)
    pieces: tuple[tuple[int, Place], ...] = ()


@dataclass
class Places:
    """The places of all keys and values of some files, by dotted path."""

    values: dict[str, Place] = field(default_factory=dict)
    keys: dict[str, Place] = field(default_factory=dict)

    def without(self, sections: Collection[str]) -> Places:
        """Places outside of some sections."""

        def kept(places: dict[str, Place]) -> dict[str, Place]:
            return {path: place for path, place in places.items() if path.partition(".")[0] not in sections}

        return Places(kept(self.values), kept(self.keys))

    def add(self, node: Node) -> None:
        """Add a node and everything inside it; what is there already stays behind what comes later."""
        self.values[node.path] = node.place
        if isinstance(node.value, dict):
            self.keys |= {child.path: node.keys[key] for key, child in node.value.items()}
        if isinstance(node.value, dict | list):
            for child in node.value.values() if isinstance(node.value, dict) else node.value:
                self.add(child)

    def around(self, path: str) -> Place | None:
        """Give the place of a value, or of the nearest value around it."""
        while path and path not in self.values:
            path = path.rpartition(".")[0]
        return self.values.get(path)


def load(path: str | Path) -> Node:
    """Read a YAML file; raises `DeclarationError` with every problem found."""
    return decode(read_bytes(path), str(path))


def read_bytes(path: str | Path) -> bytes:
    """Read a file; raises a `DeclarationError` if it is not there, cannot be read, or is too large."""
    path, start = Path(path), Place(str(path), 1, 1)
    if not path.is_file():
        raise DeclarationError(Problem(start, "", "there is no such file"))
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise DeclarationError(Problem(start, "", f"cannot be read: {error.strerror}")) from None
    if len(data) > LARGEST_FILE:
        raise DeclarationError(Problem(start, "", f"the file is larger than {LARGEST_FILE} bytes"))
    return data


def decode(data: bytes, file: str, refused: list[Problem] | None = None) -> Node:
    """Read YAML from the bytes of a file, as `loads` does; raises a `DeclarationError`, too, if it is not UTF-8."""
    try:
        return loads(data.decode("utf-8"), file, refused)
    except UnicodeDecodeError as error:
        before = data[: error.start].decode("utf-8")
        place = _place(file, before, len(before))
        raise DeclarationError(Problem(place, "", "the file is not UTF-8", "save it as UTF-8")) from None


def loads(text: str, file: str = "<text>", refused: list[Problem] | None = None) -> Node:
    """Read YAML from a text; a `DeclarationError` lists every problem with its place in a file of that name.

    `refused` takes the problems of single scalars and keys, so that the rest of the file can be checked too; without
    such a list they are raised as any other.
    """
    text = text.removeprefix("\ufeff").replace("\r\n", "\n")  # some editors write a byte order mark
    if len(text) > LARGEST_FILE:
        raise DeclarationError(Problem(Place(file, 1, 1), "", f"the text is larger than {LARGEST_FILE} characters"))
    if (at := text.find("\t")) >= 0:
        raise DeclarationError(Problem(_place(file, text, at), "", "a tab is not allowed", "use spaces"))
    if unfit := UNFIT.search(text):
        message = f"the character {code_point(unfit[0])} is not allowed"
        raise DeclarationError(Problem(_place(file, text, unfit.start()), "", message, "delete it"))
    builder = _Builder(text, file)
    node = builder.build()
    if refused is None and builder.problems:
        raise DeclarationError(builder.problems)
    if refused is not None:
        refused += builder.problems
    return node


def _position(mark: Any) -> tuple[int, int]:  # noqa: ANN401  (PyYAML has two classes of marks, one in C)
    """Give the line and column of a mark, both from 0."""
    return mark.line, mark.column


def _place(file: str, text: str, index: int) -> Place:
    """Give the place of a character of a text."""
    before = text[:index].split("\n")
    return Place(file, len(before), len(before[-1]) + 1)


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip(" "))


class _Builder:
    """Turns the events of one document into nodes; `path` is that of the value which is read."""

    def __init__(self, text: str, file: str) -> None:
        self.text, self.file, self.lines = text, file, text.split("\n")
        self.path = ""
        self.problems: list[Problem] = []

    def build(self) -> Node:
        root: Node | None = None
        events = self.events()
        try:
            for event in events:
                root = self.node(event, events, "")
        except yaml.YAMLError as error:
            raise DeclarationError([*self.problems, self.not_yaml(error)]) from None
        except RecursionError:
            self.report(Place(self.file, 1, 1), f"nested deeper than {DEEPEST_NESTING}")
            raise DeclarationError(self.problems) from None
        if root is None or (root.value is None and not root.text):
            raise DeclarationError(Problem(Place(self.file, 1, 1), "", "the file is empty"))
        return root

    def events(self) -> Iterator[yaml.Event]:
        """Events of values; refuses what no document may hold."""
        documents = 0
        for event in yaml.parse(self.text, Loader=_Loader):
            if isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if documents > 1:
                    self.stop(event, "a second document is not allowed", "keep one document in a file")
                if event.version or event.tags:
                    self.stop(event, "a directive is not allowed")
            if isinstance(event, yaml.AliasEvent):
                self.stop(event, "an alias is not allowed", "write the value out")
            if isinstance(event, yaml.NodeEvent) and event.anchor is not None:
                self.stop(event, "an anchor is not allowed", "write the value out where it is used")
            if isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent) and event.tag is not None:
                self.stop(event, f"the tag {event.tag} is not allowed", "leave it away")
            if isinstance(event, yaml.NodeEvent | yaml.CollectionEndEvent):
                yield event

    def node(self, event: yaml.Event, events: Iterator[yaml.Event], path: str, depth: int = 0) -> Node:
        """Value that begins with an event, at a depth of nesting."""
        if isinstance(event, yaml.ScalarEvent):
            return self.scalar(event)
        if depth >= DEEPEST_NESTING:
            self.stop(event, f"nested deeper than {DEEPEST_NESTING}")
        place, items, value, keys = self.place(event), list[Node](), dict[str, Node](), dict[str, Place]()
        if isinstance(event, yaml.MappingStartEvent):
            self.path = path
            while not isinstance(event := next(events), yaml.CollectionEndEvent):
                key, is_kept = self.take_key(event, path, keys)
                child = self.node(next(events), events, self.path, depth + 1)
                if is_kept:
                    value[key] = child
                self.path = path
            return Node(value, place, path, keys=keys)
        while True:
            self.path = f"{path}.{len(items)}" if path else str(len(items))
            if isinstance(event := next(events), yaml.CollectionEndEvent):
                return Node(items, place, path)
            items.append(self.node(event, events, self.path, depth + 1))

    def not_yaml(self, error: yaml.YAMLError) -> Problem:
        """Describe what PyYAML stopped at, with the remedy of the mistakes that people make."""
        mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
        line, column = _position(mark) if mark else (0, 0)
        message = getattr(error, "problem", None) or str(error)
        text = self.lines[line] if line < len(self.lines) else ""
        remedy, start = "", getattr(error, "context_mark", None)
        if "expected ':'" in message and start:
            return self.without_colon(*_position(start))
        if re.search("mapping values|unexpected ':'|expected key", message):
            if _NO_SPACE.search(text):
                remedy = "write a space after ':'"
            elif "mapping values" in message:
                above = [i for i in range(max(0, line - _LINES_ABOVE), line) if _CONTENT.match(self.lines[i])]
                key = next((i for i in reversed(above) if _KEY.search(self.lines[i])), -1)
                follow = [i for i in above if i > key]
                if follow and (key < 0 or self.lines[key].rstrip().endswith(":")):
                    return self.without_colon(follow[0], _indent(self.lines[follow[0]]))
                is_deeper = key >= 0 and len(text[:column].split()) == 1 and _indent(text) > _indent(self.lines[key])
                if is_deeper:
                    return self.indented(line, key)
                remedy = "quote a text that holds ': '"
        if "did not find expected key" in message or "expected <block end>" in message:
            closed = text[:column].rstrip()
            if closed.endswith(("}", "]")):
                ends = f"'{closed[-1]}' ends the value, and '{text[column:].strip()}' follows it"
                return Problem(Place(self.file, line + 1, column + 1), self.path, f"not YAML: {ends}",
                               f"write it before the '{closed[-1]}', or in a line of its own")  # fmt: skip
            if _indent(text) == column and column not in self.open_columns(line):
                return self.indented(line, None)
        return Problem(Place(self.file, line + 1, column + 1), self.path, f"not YAML: {message}", remedy)

    def open_columns(self, line: int) -> list[int]:
        """Columns, from 0, in which blocks that are open above a line begin, the innermost first."""
        found = list[int]()
        for above in reversed(self.lines[:line]):
            if _CONTENT.match(above) and (not found or _indent(above) < found[-1]):
                found.append(_indent(above))
        return found

    def indented(self, line: int, above: int | None) -> Problem:
        """Describe a line in a column in which nothing may begin; the one above holds a whole value, if it is given."""
        column, text = _indent(self.lines[line]), self.lines[line].strip()
        name, columns = text.partition(":")[0], [str(x + 1) for x in self.open_columns(line)]
        message = f"'{name}' begins in column {column + 1}, the lines above in column {' and '.join(columns)}"
        remedy = "begin it in one of these, below the key that it stands beside"
        if above is not None:
            message = f"'{name}' is indented below '{self.lines[above].strip()}', which is complete"
            remedy = f"begin it in column {_indent(self.lines[above]) + 1}, as the line above"
        return Problem(Place(self.file, line + 1, column + 1), self.path, f"not YAML: {message}", remedy)

    def without_colon(self, line: int, column: int) -> Problem:
        """Describe a line that should be 'key: value' and has no colon with a space after it."""
        text = self.lines[line][column:].strip()
        name = re.match(r"[^\s:]*", text)
        key = name[0] if name else ""
        shown = text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
        what, remedy = f"no ':' after '{shown}'", f"write {key}: ..."
        if _NO_SPACE.search(text):
            what, remedy = f"no space after ':' in '{shown}'", "write a space after ':'"
        return Problem(Place(self.file, line + 1, column + 1), self.path, f"not YAML: {what}", remedy)

    def take_key(self, event: yaml.Event, path: str, keys: dict[str, Place]) -> tuple[str, bool]:
        """Add a key of the mapping at a path to those before it; gives it, and whether its value is kept."""
        if not isinstance(event, yaml.ScalarEvent):
            self.stop(event, "a key is not a text", "write a plain name as key")
        key, place = event.value, self.place(event)
        node = self.scalar(event, is_key=True)
        if key == "<<" and not event.style:
            self.stop(event, "a merge key is not allowed", "write the values out")
        self.path = f"{path}.{key}" if path else key
        is_kept = isinstance(node.value, str) or self.refuse_key(path, key, place)
        if key in keys:
            message = f"the key '{key}' stands here twice"
            self.report(place, message, f"the first is in line {keys[key].line}")
        keys.setdefault(key, place)
        return key, is_kept

    def refuse_key(self, path: str, key: str, place: Place) -> bool:
        """Report a key that is a number or null; what follows half of a number with a decimal comma is not kept."""
        before = re.search(r"[-+]?\d+(?=,$)", self.lines[place.line - 1][: place.column - 1])
        if before and key.isdigit():
            place = replace(place, column=before.start() + 1)
            self.problems.append(
                Problem(place, self.path.rpartition(".")[0], f"'{before[0]},{key}' is no number",
                        f"a number has a decimal point: write {before[0]}.{key}")
            )  # fmt: skip
            return False
        remedy = "quote it or give it a name"
        if path == "equations":
            remedy = f"write what it is on the left, such as x'': ..., or the number in quotes: '{key}': ..."
        self.report(place, f"the key {key or 'null'} is not a text", remedy)
        return True

    def scalar(self, event: yaml.ScalarEvent, *, is_key: bool = False) -> Node:
        """Read a scalar; a plain one may be null, true, false or a number, any other is a text."""
        text: str = event.value
        value: str | float | bool | None = text
        if unfit := (_IN_A_KEY if is_key else UNFIT).search(text):
            where = "a key" if is_key else "a text"
            self.report(
                self.place(event), f"the character {code_point(unfit[0])} is not allowed in {where}", "delete it"
            )
        if not event.style:
            if text in {"", "~", "null", "Null", "NULL"}:
                value = None
            elif text in {"true", "True", "TRUE", "false", "False", "FALSE"}:
                value = text.lower() == "true"
            elif _NUMBER.fullmatch(text) and not _LEADING_ZERO.match(text):
                value = self.number(text, event)
            else:
                for pattern, meaning, remedy in _AMBIGUOUS:
                    if re.fullmatch(pattern, text):
                        self.report(self.place(event), f"'{text}' {meaning}", remedy)
                        break
        return Node(value, self.place(event), self.path, text, pieces=self.pieces(event))

    def number(self, text: str, event: yaml.ScalarEvent) -> float:
        value = float(text)
        if math.isinf(value):
            self.report(self.place(event), f"{text} is not a finite number", "write a finite number")
        elif value == 0.0 and re.search("[1-9]", re.split("[eE]", text)[0]):
            self.report(self.place(event), f"{text} is too small for a float", "write 0")
        return value

    def pieces(self, event: yaml.ScalarEvent) -> tuple[tuple[int, Place], ...]:
        """Find each word of a text that is folded over lines or holds doubled quotes."""
        line, column, last = *_position(event.start_mark), _position(event.end_mark)[0]
        folded = last > line
        if not folded and not (event.style == "'" and "'" in event.value):
            return ()
        pieces: list[tuple[int, Place]] = []
        for word in re.finditer(r"'|[^\s']+", event.value):
            raw = "''" if event.style == "'" and word[0] == "'" else word[0]
            column += event.style == "'" and not pieces
            while (found := self.lines[line].find(raw, column)) < 0 and line < last:
                line, column = line + 1, 0
                if line >= len(self.lines):
                    return tuple(pieces)
            if found < 0:
                return tuple(pieces)
            pieces.append((word.start(), Place(self.file, line + 1, found + 1)))
            column = found + len(raw)
        return tuple(pieces)

    def place(self, event: yaml.Event) -> Place:
        """Give where the content of an event begins, inside the quotes of a quoted text."""
        quoted = isinstance(event, yaml.ScalarEvent) and event.style in {"'", '"'}
        line, column = _position(event.start_mark)
        return Place(self.file, line + 1, column + 1 + quoted)

    def report(self, place: Place, message: str, remedy: str = "") -> None:
        self.problems.append(Problem(place, self.path, message, remedy))

    def stop(self, event: yaml.Event, message: str, remedy: str = "") -> NoReturn:
        """Report what the rest of the file cannot be read after."""
        raise DeclarationError([*self.problems, Problem(self.place(event), self.path, message, remedy)])
