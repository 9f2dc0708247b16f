"""Graph nodes printed as statements of a language, in the order of their operations, to the last bit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from masking.compile.codegen.graph import Graph, Node

ATOM, UNARY, PRODUCT, SUM = 4, 3, 2, 1


@dataclass(frozen=True)
class Language:
    """How one language writes the operations: `templates` for calls, `declare` and `end` for statements.

    `suffix` follows a number.
    """

    templates: dict[str, str]
    declare: str
    end: str
    suffix: str = ""


def c_language(real: str) -> Language:
    """C99 with numbers of one type, `double` or `float`; `smaller` and `larger` are those of `c_functions`."""
    f = {"double": "", "float": "f"}[real]
    same = ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "floor")
    return Language(
        templates={
            **{name: f"{name}{f}({{0}})" for name in same},
            "pow": f"pow{f}({{0}}, {{1}})",
            "abs": f"fabs{f}({{0}})",
            "sign": f"({real})(({{0}} > 0.0{f}) - ({{0}} < 0.0{f}))",
            "min": "smaller({0}, {1})",
            "max": "larger({0}, {1})",
            "atan2": f"atan2{f}({{0}}, {{1}})",
            "heaviside": f"({{0}} == 0.0{f} ? 0.5{f} : ({{0}} > 0.0{f} ? 1.0{f} : 0.0{f}))",
            "where": "({0} ? {1} : {2})",
            "lt": "({0} < {1})",
            "le": "({0} <= {1})",
        },
        declare=f"const {real} ",
        end=";",
        suffix=f,
    )


C = c_language("double")
INFIX = {"add": (SUM, "+"), "sub": (SUM, "-"), "mul": (PRODUCT, "*"), "div": (PRODUCT, "/")}


def statements(graph: Graph, results: Sequence[tuple[str, Node]], language: Language) -> list[str]:
    """Statements that compute nodes and assign each to a text, such as `out[0]`.

    A node that is used more than once becomes a local variable; all others are written in place.
    """
    return _Statements(graph, language).write(results)


def needed(graph: Graph, nodes: Sequence[Node]) -> list[Node]:
    """Nodes that must be computed for `nodes`, themselves included, in computable order."""
    wanted: set[Node] = set()
    stack = list(nodes)
    while stack:
        node = stack.pop()
        if node not in wanted:
            wanted.add(node)
            stack.extend(arguments(graph, node))
    return sorted(wanted)


def arguments(graph: Graph, node: Node) -> list[Node]:
    """Nodes that a node is computed from."""
    name, *rest = graph.operations[node]
    return [] if name in {"number", "symbol"} else [int(r) for r in rest]


def number(value: float, suffix: str = "") -> str:
    """Floating-point literal that reads back to the same value; a suffix gives it another type."""
    return f"{value!r}{suffix}" if value >= 0.0 else f"({value!r}{suffix})"


class _Statements:
    def __init__(self, graph: Graph, language: Language) -> None:
        self.graph = graph
        self.language = language
        self.text: dict[Node, tuple[str, int]] = {}

    def write(self, results: Sequence[tuple[str, Node]]) -> list[str]:
        order = needed(self.graph, [node for _, node in results])
        uses = dict.fromkeys(order, 0)
        for node in order:
            # heaviside and sign write their argument more than once.
            weight = 2 if self.graph.operations[node][0] in {"heaviside", "sign"} else 1
            for argument in arguments(self.graph, node):
                uses[argument] += weight
        for _, node in results:
            uses[node] += 1
        lines = []
        for node in order:
            text, level = self._print(node)
            if uses[node] > 1 and level < ATOM and self.graph.operations[node][0] not in {"lt", "le"}:
                lines.append(f"{self.language.declare}c{node} = {text}{self.language.end}")
                text, level = f"c{node}", ATOM
            self.text[node] = text, level
        return [*lines, *(f"{target} = {self.text[node][0]}{self.language.end}" for target, node in results)]

    def _print(self, node: Node) -> tuple[str, int]:
        name, *rest = self.graph.operations[node]
        if name == "symbol":
            return str(rest[0]), ATOM
        if name == "number":
            return number(float(rest[0]), self.language.suffix), ATOM
        texts = [self.text[int(r)] for r in rest]
        if name == "neg":
            return f"-{self._at_least(texts[0], UNARY)}", UNARY
        if name in INFIX:
            level, sign = INFIX[str(name)]
            return f"{self._at_least(texts[0], level)} {sign} {self._at_least(texts[1], level + 1)}", level
        template = self.language.templates[str(name)]
        inner = [self._at_least(t, ATOM) for t in texts] if template[-1] != ")" else [t for t, _ in texts]
        if name in {"lt", "le", "where", "heaviside", "sign"}:
            inner = [self._at_least(t, ATOM) for t in texts]
        return template.format(*inner), UNARY

    @staticmethod
    def _at_least(text: tuple[str, int], level: int) -> str:
        return text[0] if text[1] >= level else f"({text[0]})"
