"""Graph nodes printed as statements of Python (for numba) or C."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from masking.codegen.graph import Graph, Node

ATOM, UNARY, PRODUCT, SUM = 4, 3, 2, 1


@dataclass(frozen=True)
class Language:
    """How one language writes the operations: `templates` for calls, `declare` and `end` for statements."""

    templates: dict[str, str]
    declare: str
    end: str


PYTHON = Language(
    templates={
        **{f: f"math.{f}({{0}})" for f in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh")},
        **{f: f"math.{f}({{0}})" for f in ("tanh", "exp", "log")},
        "pow": "{0} ** {1}",
        "abs": "abs({0})",
        "sign": "np.sign({0})",
        "floor": "np.floor({0})",
        "min": "min({0}, {1})",
        "max": "max({0}, {1})",
        "atan2": "math.atan2({0}, {1})",
        "heaviside": "(0.5 if {0} == 0.0 else (1.0 if {0} > 0.0 else 0.0))",
        "where": "({1} if {0} else {2})",
        "lt": "({0} < {1})",
        "le": "({0} <= {1})",
    },
    declare="",
    end="",
)
C = Language(
    templates={
        **{f: f"{f}({{0}})" for f in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh")},
        **{f: f"{f}({{0}})" for f in ("exp", "log", "floor")},
        "pow": "pow({0}, {1})",
        "abs": "fabs({0})",
        "sign": "(double)(({0} > 0.0) - ({0} < 0.0))",
        "min": "fmin({0}, {1})",
        "max": "fmax({0}, {1})",
        "atan2": "atan2({0}, {1})",
        "heaviside": "({0} == 0.0 ? 0.5 : ({0} > 0.0 ? 1.0 : 0.0))",
        "where": "({0} ? {1} : {2})",
        "lt": "({0} < {1})",
        "le": "({0} <= {1})",
    },
    declare="const double ",
    end=";",
)
INFIX = {"add": (SUM, "+"), "sub": (SUM, "-"), "mul": (PRODUCT, "*"), "div": (PRODUCT, "/")}


def statements(graph: Graph, results: Sequence[tuple[str, Node]], language: Language = PYTHON) -> list[str]:
    """Return the statements that compute nodes and assign them.

    A node that is used more than once becomes a local variable; all others are written in place.

    Args:
        graph: the graph that holds the nodes.
        results: pairs of an assignable text, such as `out[0]`, and the node whose value it gets.
        language: the language to print.
    """
    return _Statements(graph, language).write(results)


def needed(graph: Graph, nodes: Sequence[Node]) -> list[Node]:
    """Return the nodes that must be computed for `nodes`, themselves included, in computable order."""
    wanted: set[Node] = set()
    stack = list(nodes)
    while stack:
        node = stack.pop()
        if node not in wanted:
            wanted.add(node)
            stack.extend(arguments(graph, node))
    return sorted(wanted)


def arguments(graph: Graph, node: Node) -> list[Node]:
    """Return the nodes that a node is computed from."""
    name, *rest = graph.operations[node]
    return [] if name in {"number", "symbol"} else [int(r) for r in rest]


def number(value: float) -> str:
    """Return a floating-point literal that reads back to the same value."""
    return repr(value) if value >= 0.0 else f"({value!r})"


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
            if uses[node] > 1 and level < ATOM and not self._is_condition(node):
                lines.append(f"{self.language.declare}c{node} = {text}{self.language.end}")
                text, level = f"c{node}", ATOM
            self.text[node] = text, level
        return [*lines, *(f"{target} = {self.text[node][0]}{self.language.end}" for target, node in results)]

    def _is_condition(self, node: Node) -> bool:
        return self.graph.operations[node][0] in {"lt", "le"}

    def _print(self, node: Node) -> tuple[str, int]:
        name, *rest = self.graph.operations[node]
        if name == "symbol":
            return str(rest[0]), ATOM
        if name == "number":
            return number(float(rest[0])), ATOM
        texts = [self.text[int(r)] for r in rest]
        if name == "neg":
            return f"-{self._at_least(texts[0], UNARY)}", UNARY
        if name in INFIX:
            level, sign = INFIX[str(name)]
            right = level if name == "add" else level + 1
            return f"{self._at_least(texts[0], level)} {sign} {self._at_least(texts[1], right)}", level
        template = self.language.templates[str(name)]
        inner = [self._at_least(t, ATOM) for t in texts] if template[-1] != ")" else [t for t, _ in texts]
        if name in {"lt", "le", "where", "heaviside", "sign"}:
            inner = [self._at_least(t, ATOM) for t in texts]
        return template.format(*inner), UNARY

    @staticmethod
    def _at_least(text: tuple[str, int], level: int) -> str:
        return text[0] if text[1] >= level else f"({text[0]})"
