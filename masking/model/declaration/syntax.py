"""From the text of an expression to its postfix program, through two walls.

The scanner admits only the tokens of the language and sees the text before Python's parser does; the walker over
Python's syntax tree admits only the forms of the language. Neither executes anything.
"""

from __future__ import annotations

import ast
import keyword
import math
import re
import unicodedata
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from masking.errors import DeclarationError, nearest
from masking.model.declaration.operations import COMPARISONS, CONSTANTS, FUNCTIONS, OPERATIONS, Step

LARGEST = 10_000  # operations and operands; measured: compiling as many takes a second, the packaged models have 200
LONGEST_NUMBER = 32
LONGEST_NAME = 100
DEEPEST_NESTING = 100

Refuse = Callable[[int, int, str, str], DeclarationError]
"""Makes the error for the part of the text from one index to another, with a message and its remedy."""

_SPLIT = "split it into definitions"
_DEEP = f"nested deeper than {DEEPEST_NESTING}"
_PRIMES = "write x1' or x1''"
_SECOND = "write x1'' with two single quotes for a second derivative"
_COMPARE_REMEDY = f"the comparisons are {' '.join(sorted(COMPARISONS))}"
# It stands for ' in Python identifiers, once every other non-ASCII character is refused.
_PRIME = "\N{MODIFIER LETTER PRIME}"
_OPERATORS: dict[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**",
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=",
}  # fmt: skip
_TOKEN = re.compile(
    r"(?P<number>(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?)"
    r"|(?P<name>[A-Za-z][A-Za-z0-9_]*)"
    r"|(?P<open>\()|(?P<close>\))"
    r"|(?P<operator>\*\*|<=|>=|(?!//|<<|>>)[-+*/<>,])"
)
_CALL = re.compile(r"(?P<primes>'*) *(?P<open>\()?")  # what may follow a name
_FOREIGN: tuple[tuple[str, str, str], ...] = (  # Python that people try, what it is, and what to write instead
    ("^", "'^' is not an operator", "write ** for a power"),
    ("//", "'//' is not an operator", "write a/b"),
    ("%", "'%' is not an operator", "of a unit, write percent"),
    ("==", "'==' is not allowed", _COMPARE_REMEDY),
    ("!=", "'!=' is not allowed", _COMPARE_REMEDY),
    ("<<", "'<<' is not an operator", ""),
    (">>", "'>>' is not an operator", ""),
    (":=", "an assignment is not allowed in an expression", ""),
    ("=", "'=' is not allowed in an expression", _COMPARE_REMEDY),
    ("'", "a prime stands right after the name of a coordinate, and text in quotes is not allowed", _PRIMES),
    ('"', "text in quotes is not allowed in an expression", _SECOND),
    (".", "a dot is allowed only in a number", "write sin(x) without a prefix, and a*b for a product"),
    ("[", "square brackets are not allowed", "use parentheses"),
    ("]", "square brackets are not allowed", "use parentheses"),
    ("{", "braces are not allowed", "use parentheses"),
    ("}", "braces are not allowed", "use parentheses"),
    ("_", "a name may not start with an underscore", "start it with a letter"),
    ("#", "a comment is not allowed inside an expression", ""),
    ("\n", "a line break is not allowed in an expression", "fold it with '>-' in YAML"),
    ("\r", "a line break is not allowed in an expression", "fold it with '>-' in YAML"),
    ("\t", "a tab is not allowed in an expression", "use spaces"),
)


def parse(text: str, refuse: Refuse) -> tuple[Step, ...]:
    """Read the text into its postfix program; raises what `refuse` makes of the first thing outside the language."""
    if not text.strip():
        raise refuse(0, 1, "the expression is empty", "")
    if (size := _scan(text, refuse)) > LARGEST:
        message = f"the expression has {size} operations and operands, more than {LARGEST}"
        raise refuse(0, 1, message, "shorten it, or the ranges of the sums in it")
    source = f"({text})".replace("'", _PRIME)
    indices = [index for index, character in enumerate(source) for _ in character.encode()]
    try:
        tree = ast.parse(source, mode="eval").body
        return tuple(_Walker(text, [*indices, len(source)], refuse).visit(tree, 0))
    except SyntaxError as error:
        index = min(max((error.offset or 1) - 2, 0), len(text) - 1)
        raise refuse(index, index + 1, "an operand or an operator is missing", "") from None
    except (RecursionError, MemoryError):
        raise refuse(0, 1, f"too long or {_DEEP}", _SPLIT) from None


def _scan(text: str, refuse: Refuse) -> int:
    """Refuse every text that is not made of this language's tokens; give how many operations and operands it has."""
    brackets: list[int] = []
    index, before, last = 0, "", ""  # `last` is the token just read, `before` the same if a value ended there
    size = 0
    while index < len(text):
        if text[index] == " ":
            index += 1
            continue
        match = _TOKEN.match(text, index)
        if match is None:
            raise _foreign(text, index, refuse)
        start, end, kind = index, match.end(), match.lastgroup
        if before and (kind in {"number", "name"} or (kind == "open" and before not in FUNCTIONS)):
            raise _juxtaposed(text, start, end, before, refuse)
        if kind == "number":
            _check_number(match[0], start, refuse)
        elif kind == "name":
            end = _check_name(text, start, end, refuse)
        elif kind == "open":
            brackets.append(start)
            if len(brackets) > DEEPEST_NESTING:
                raise refuse(start, end, _DEEP, _SPLIT)
        elif kind == "close":
            if not brackets:
                raise refuse(start, end, "')' closes nothing", "")
            if last == ",":
                raise refuse(start, end, "an argument is missing after the comma", "")
            brackets.pop()
        last = text[start:end]
        size += kind in {"number", "name"} or (kind == "operator" and last != ",")
        index, before = end, "" if kind in {"operator", "open"} else last
    if brackets:
        raise refuse(brackets[-1], brackets[-1] + 1, "'(' is never closed", "")
    return size


def _foreign(text: str, index: int, refuse: Refuse) -> DeclarationError:
    """Say what a character is that starts no token."""
    for token, message, remedy in _FOREIGN:
        if text.startswith(token, index):
            return refuse(index, index + len(token), message, remedy)
    character = text[index]
    if character.isascii():
        return refuse(index, index + 1, f"the character {character!r} is not allowed in an expression", "")
    name = unicodedata.name(character, "a character without a name")
    plain = unicodedata.normalize("NFKC", character)
    remedy = f"write '{plain}'" if plain.isascii() and plain.isprintable() else "write it in ASCII"
    return refuse(index, index + 1, f"the character U+{ord(character):04X} ({name}) is not ASCII", remedy)


def _juxtaposed(text: str, start: int, end: int, before: str, refuse: Refuse) -> DeclarationError:
    """Say that two values stand side by side, which is no product here."""
    after = text[start:end]
    if keyword.iskeyword(after):
        return refuse(start, end, f"'{after}' is a Python keyword", "the only choice is where(condition, a, b)")
    left, right = "(...)" if before == ")" else before, "(...)" if after == "(" else after
    message = f"{left} is followed by {right} without an operator"
    return refuse(start, end, message, f"write {left}*{right} for a product")


def _check_name(text: str, start: int, end: int, refuse: Refuse) -> int:
    """Refuse names that are not free to use; give the end of the name with its primes."""
    name, call = text[start:end], _CALL.match(text, end)
    last = call.end("primes") if call else end
    if end - start > LONGEST_NAME:
        raise refuse(start, end, f"a name of {end - start} characters, more than {LONGEST_NAME}", "")
    if keyword.iskeyword(name):
        raise refuse(start, end, f"'{name}' is a Python keyword", "")
    if last - end > 2:
        raise refuse(start, last, f"'{name}' has {last - end} primes, at most two are allowed", _PRIMES)
    if last > end and (name in FUNCTIONS or name in CONSTANTS or name == "t"):
        raise refuse(start, last, f"'{name}' has no derivative", "primes are for coordinates")
    called = bool(call and call["open"])
    if called and name not in FUNCTIONS:
        hint = nearest(name, sorted(FUNCTIONS))
        remedy = hint if hint.startswith("did") else f"write {text[start:last]}*(...) for a product"
        raise refuse(start, last, f"'{name}' is not a function", remedy)
    if name in FUNCTIONS and not called:
        raise refuse(start, end, f"'{name}' is a function", f"write {name}(...)")
    return last


def _check_number(token: str, start: int, refuse: Refuse) -> None:
    end = start + len(token)
    if len(token) > LONGEST_NUMBER:
        raise refuse(start, end, f"a number of {len(token)} characters, more than {LONGEST_NUMBER}", "")
    if re.match(r"0\d", token):
        raise refuse(start, end, f"the number {token} starts with 0", "leave the leading zeros away")
    if math.isinf(float(token)):
        raise refuse(start, end, f"the number {token} is not finite", "")
    if float(token) == 0.0 and re.search(r"[1-9]", re.split("[eE]", token)[0]):
        raise refuse(start, end, f"the number {token} is too small for a float", "")


@dataclass(frozen=True, slots=True)
class _Walker:
    """Walks Python's tree of the bracketed source and yields steps, arguments before operations.

    `indices` has the index of the character of the source that each of its bytes belongs to.
    """

    text: str
    indices: list[int]
    refuse: Refuse

    def visit(self, node: ast.expr, depth: int) -> Iterator[Step]:
        start, end = self._span(node)
        if depth > DEEPEST_NESTING:
            raise self.refuse(start, end, _DEEP, _SPLIT)
        match node:
            case ast.Constant(value=int() | float()):
                yield Step("number", 0, self.text[start:end], start, end)
            case ast.Name():
                name = self.text[start:end]
                yield Step("number" if name in CONSTANTS else "symbol", 0, name, start, end)
            case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
                yield from self.visit(operand, depth + 1)
                if isinstance(node.op, ast.USub):
                    yield Step("negative", 1, "", start, end)
            case ast.BinOp():
                yield from self._chain(node, depth)
            case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in FUNCTIONS:
                yield from self._call(name, args, start, end, depth)
            case ast.Compare():
                remedy = "write where(x > 0, a, b)"
                raise self.refuse(start, end, "a comparison is allowed only as the condition of where", remedy)
            case ast.Tuple():
                decimal = re.search(r"(\d+),(\d+)", self.text[start:end])
                remedy = f"a number has a decimal point: write {decimal[1]}.{decimal[2]}" if decimal else ""
                raise self.refuse(start, end, "a comma stands only between the arguments of a function", remedy)
            case _:
                raise self.refuse(start, end, "this is not allowed in an expression", "")

    def _chain(self, node: ast.BinOp, depth: int) -> Iterator[Step]:
        """Yield a chain of operators such as a sum of many terms, which is long but not deep."""
        links: list[ast.BinOp] = []
        left: ast.expr = node
        while isinstance(left, ast.BinOp):
            links.append(left)
            left = left.left
        yield from self.visit(left, depth + 1)
        for link in reversed(links):
            start, end = self._span(link)
            if type(link.op) not in _OPERATORS:
                raise self.refuse(start, end, "this operator is not allowed", "")
            yield from self.visit(link.right, depth + 1)
            yield Step(_OPERATORS[type(link.op)], 2, "", start, end)

    def _call(self, name: str, args: list[ast.expr], start: int, end: int, depth: int) -> Iterator[Step]:
        operation = OPERATIONS[name]
        if not operation.least <= len(args) <= operation.most:
            more = " or more" if operation.most > operation.least else ""
            plural = "" if operation.most == 1 else "s"
            raise self.refuse(start, end, f"{name} takes {operation.least}{more} argument{plural}, not {len(args)}", "")
        for index, argument in enumerate(args):
            is_condition = name == "where" and index == 0
            yield from self._condition(argument, depth + 1) if is_condition else self.visit(argument, depth + 1)
        yield Step(name, len(args), "", start, end)

    def _condition(self, node: ast.expr, depth: int) -> Iterator[Step]:
        start, end = self._span(node)
        match node:
            case ast.Compare(left=left, ops=[comparison], comparators=[right]) if type(comparison) in _OPERATORS:
                yield from self.visit(left, depth + 1)
                yield from self.visit(right, depth + 1)
                yield Step(_OPERATORS[type(comparison)], 2, "", start, end)
            case ast.Compare():
                raise self.refuse(start, end, "a chain of comparisons is not allowed", "put one where inside another")
            case _:
                remedy = "write where(x > 0, a, b)"
                raise self.refuse(start, end, "the condition of where is not a comparison", remedy)

    def _span(self, node: ast.expr) -> tuple[int, int]:
        """Give the node's first and last index in the text; Python counts bytes of the bracketed source."""
        start, end = (self.indices[offset] - 1 for offset in (node.col_offset, node.end_col_offset or 0))
        return max(start, 0), min(end, len(self.text))  # a tuple would include the brackets around the source
