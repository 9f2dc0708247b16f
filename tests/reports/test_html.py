"""Markup: names in prose are typeset where they are symbols, and left as they are where they are words or units."""

import pytest

from masking.reports.html import is_symbol, prose

NAMES = {"x", "s1", "V1", "xi_3", "theta", "force", "m", "a", "load", "w12"}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("the error in x", "the error in <var>x</var>"),
        ("of s1 and w12", "of <var>s</var><sub>1</sub> and <var>w</var><sub>12</sub>"),
        ("xi_3 and theta", "<var>&xi;</var><sub>3</sub> and <var>&theta;</var>"),
        ("gravity force of force under load", "gravity force of force under load"),
        ("an edge of 0.02 ± 0.01 m, and m = 2 kg", "an edge of 0.02 ± 0.01 m, and <var>m</var> = 2 kg"),
        ("-4 N/(m s) at 3 N/m", "-4 N/(m s) at 3 N/m"),
        ("a force with a = 3 N", "a force with <var>a</var> = 3 N"),
    ],
)
def test_only_symbols_are_italic(text, told):
    assert prose(text, NAMES) == told


@pytest.mark.parametrize(
    ("name", "is_one"),
    [("x", True), ("V1", True), ("xi_3", True), ("omega", True), ("fc", True), ("x_max", True), ("force", False),
     ("load", False), ("stroke2", False)],
)  # fmt: skip
def test_what_a_symbol_is(name, is_one):
    assert is_symbol(name) is is_one
