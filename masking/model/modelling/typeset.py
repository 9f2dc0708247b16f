"""Equations typeset in MathML, which browsers and notebooks show by themselves."""

from __future__ import annotations

import html
from collections.abc import Iterable
from typing import Any, Final

import sympy as sp
from markupsafe import Markup
from sympy.printing.mathml import MathMLPresentationPrinter

from masking.display.symbols import GREEK, split

_ACCENTS: Final = {1: r"\dot{%s}", 2: r"\ddot{%s}"}
_DOTS: Final = {1: "\N{DOT ABOVE}", 2: "\N{DIAERESIS}"}
LONGEST: Final = 400  # operations of an expression that is typeset
_CELL: Final = Markup('<mtd style="text-align:{};padding:.25em .2em">{}</mtd>')
_TABLE: Final = Markup(
    '<div style="overflow-x:auto;margin:.5em 0"><math><mtable displaystyle="true">{}</mtable></math></div>'
)


def equations(pairs: Iterable[tuple[sp.Expr, sp.Expr]]) -> Markup:
    """Equations, given by both sides, aligned at their equals signs; derivatives of coordinates carry dots."""
    equals = _CELL.format("center", Markup("<mo>=</mo>"))
    cells = [(_CELL.format("right", side(left)), equals, _CELL.format("left", side(right))) for left, right in pairs]
    rows = [Markup("<mtr>{}{}{}</mtr>").format(*row) for row in cells]
    return _TABLE.format(Markup().join(rows)) if rows else Markup()


def side(expression: sp.Expr) -> Markup:
    """Return one side of an equation; an ellipsis stands for what is very long."""
    if sp.count_ops(expression) > LONGEST:
        return Markup("<mo>\N{HORIZONTAL ELLIPSIS}</mo>")
    return Markup(_Printer()._print(expression).toxml())  # noqa: S704  # made of a checked expression


def latex(pairs: Iterable[tuple[sp.Expr, sp.Expr]]) -> str:
    """Equations, as `equations` has them, in LaTeX, which notebooks show and papers take."""
    rows = [" & = ".join(map(_side_in_latex, pair)) for pair in pairs]
    return "\n".join([r"$\displaystyle \begin{aligned}", " \\\\\n".join(rows), r"\end{aligned}$"])


def _side_in_latex(expression: sp.Expr) -> str:
    names = {symbol: _in_latex(symbol.name) for symbol in expression.free_symbols}
    return r"\ldots" if sp.count_ops(expression) > LONGEST else str(sp.latex(expression, symbol_names=names))


def _in_latex(name: str) -> str:
    """Name of a symbol in LaTeX, its primes as dots."""
    plain = name.rstrip("'")
    letters, index = split(plain)
    word = letters.replace("_", r"\_")
    base = rf"\{letters}" if letters in GREEK else letters if len(letters) == 1 else rf"\mathit{{{word}}}"
    return _ACCENTS.get(len(name) - len(plain), "%s") % base + (f"_{{{index}}}" if index else "")


class _Printer(MathMLPresentationPrinter):  # type: ignore[misc]  # sympy has no types
    """Prints names as the rest of the package typesets them, and primes as dots."""

    def _print_Symbol(self, symbol: sp.Symbol) -> Any:  # noqa: ANN401, N802  # a node of minidom; sympy's own name
        name = symbol.name.rstrip("'")
        letters, index = split(name)
        base = self._leaf("mi", html.unescape(f"&{letters};") if letters in GREEK else letters)
        if len(letters) > 1 and letters not in GREEK:
            base.setAttribute("style", "font-style:italic")
        if dots := _DOTS.get(len(symbol.name) - len(name)):
            base = self._node("mover", base, self._leaf("mo", dots))
        return self._node("msub", base, self._leaf("mn", index)) if index else base

    def _leaf(self, tag: str, text: str) -> Any:  # noqa: ANN401
        made = self.dom.createElement(tag)
        made.appendChild(self.dom.createTextNode(text))
        return made

    def _node(self, tag: str, *parts: Any) -> Any:  # noqa: ANN401
        made = self.dom.createElement(tag)
        for part in parts:
            made.appendChild(part)
        return made
