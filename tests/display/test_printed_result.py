"""Results print as people read them: no class that a verb returns, or that has a text, is shown as a dump of fields."""

import ast
import inspect
import re
import typing
from dataclasses import dataclass, is_dataclass
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.mathtext import MathTextParser

import masking
from masking.app import cli
from masking.control.closed_loop import ClosedLoop
from masking.control.law import Controller
from masking.control.rig.twin import Twin
from masking.display.printed_result import Printed, aligned
from masking.lab.records.recording import Recording
from masking.model.modelling.equations import Equations

VERBS = [f for n in masking.__all__ if inspect.isfunction(f := getattr(masking, n)) and n not in {"json_schema"}]


def classes(annotation):
    """Classes of the package in a type, such as tuple[Checked, ...] or Fit | KalmanFit."""
    inner = [one for part in typing.get_args(annotation) for one in classes(part)]
    own = typing.get_origin(annotation) or annotation
    return [*inner, own] if inspect.isclass(own) and own.__module__.startswith("masking.") else inner


def is_dump(kind):
    """Whether the representation is the one that `dataclass` makes, which guards against recursion by a wrapper."""
    return is_dataclass(kind) and hasattr(kind.__repr__, "__wrapped__")


@pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.__name__)
def test_no_result_of_a_verb_is_a_dump_of_fields(verb):
    found = classes(typing.get_type_hints(inspect.unwrap(verb))["return"])
    assert [kind.__name__ for kind in found if is_dump(kind)] == []


@pytest.mark.parametrize("kind", [ClosedLoop, Controller, Equations, Twin], ids=lambda kind: kind.__name__)
def test_no_part_of_a_model_is_a_dump_of_fields(kind):
    assert not is_dump(kind)


def test_a_dump_is_recognised():
    assert is_dump(dataclass(type("Plain", (), {"__annotations__": {"x": int}})))


def test_every_dataclass_with_a_text_prints_it():
    """What says in `str` what it is, says so at the prompt, too; parts of declarations and of errors have a place."""
    dumps, count = [], 0
    for path in Path(masking.__path__[0]).rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in (one for one in ast.walk(tree) if isinstance(one, ast.ClassDef)):
            made = [ast.unparse(one) for one in node.decorator_list if "dataclass" in ast.unparse(one)]
            methods = {one.name for one in node.body if isinstance(one, ast.FunctionDef)}
            if made and "__str__" in methods and path.name not in {"errors.py", "expression.py"}:
                count += 1
                dumps += [node.name] * ("repr=False" not in made[0] and "__repr__" not in methods)
    assert count > 25
    assert dumps == []


class Words(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.words, self.tags = [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)

    def handle_data(self, data):
        self.words.append(data)


@dataclass(frozen=True, repr=False)
class Finding(Printed):
    text: str

    def __str__(self):
        return self.text


def test_a_result_is_a_line_at_the_prompt_and_a_card_in_a_notebook():
    found = Finding("<b> & more\n  a  1\n  b  2")
    assert repr(found) == "<Finding <b> & more>"
    shown = Words(found._repr_html_())
    assert {"<b> & more", "  a  1\n  b  2"} <= set(shown.words)
    assert "b" not in shown.tags
    assert "pre" not in Words(Finding("a line")._repr_html_()).tags


def test_nothing_acts_on_a_terminal():
    assert repr(Finding("red \x1b[31m")) == "<Finding red <U+001B>[31m>"


def test_rows_are_aligned():
    assert aligned([("a", "10"), ("long", "2")]) == ["  a     10", "  long  2"]


def test_results_of_verbs_are_read_in_a_line_each(tmp_path):
    found = masking.stability("van_der_pol")
    assert repr(found).startswith("<Stability Van der Pol oscillator: ")
    assert "\n" not in repr(found)
    assert str(found.rest) in str(found)
    assert str(found.modes[0]).splitlines() == [str(mode) for mode in found.modes[0].modes]
    (checked,) = masking.check("van_der_pol")
    assert repr(checked) == "<Checked van_der_pol: a sound model>"
    (tmp_path / "bad.yaml").write_text("name: bad\ncoordinates: {x: {}}\nequations: {x'': -y + z}\n", encoding="utf-8")
    (bad,) = masking.check(tmp_path / "bad.yaml")
    assert len(bad.problems) > 1
    assert repr(bad).endswith(f" (and {len(bad.problems) - 1} more)>")
    assert repr(masking.catalogue()).startswith("<Catalogue models ")
    assert repr(masking.show("van_der_pol")) == str(masking.show("van_der_pol"))


def test_a_run_prints_what_its_verb_prints_and_a_part_of_it_its_own(capsys, tmp_path):
    cli.main(["run", "duffing", "--out", str(tmp_path)])
    *printed, times, _ = capsys.readouterr().out.splitlines()
    *said, own_times = str(run := masking.run("duffing")).splitlines()
    assert printed == said
    assert times.split()[0] == own_times.split()[0] == "time"
    assert "\n" not in repr(run)
    assert str(run.between(0.0, 100.0)).splitlines()[0] != said[0]
    assert str(Recording.load(tmp_path)) == repr(run)  # which no verb has given a text


def test_a_comparison_is_read_in_a_line():
    t = np.linspace(0.0, 10.0, 101)
    first, second = (Recording({"t": t, "virtual.x": np.sin(w * t)}, {"name": "a"}) for w in (1.0, 2.0))
    from masking.reports.comparison_page import Comparison

    assert repr(Comparison(first, second, ("a", "b"))) == "<Comparison No parameter differs.>"


@pytest.mark.parametrize("name", ["huygens", "setup", "bouc_wen", "delayed_oscillators"])
def test_equations_are_lines_of_text_and_latex_that_another_program_reads(name):
    equations = masking.load_model(name).equations
    text, latex = str(equations), equations._repr_latex_()
    assert len(text.splitlines()) == len(equations.pairs)
    head, *rows, foot = latex.splitlines()
    assert (head, foot) == (r"$\displaystyle \begin{aligned}", r"\end{aligned}$")
    assert len(rows) == len(equations.pairs)
    parser = MathTextParser("path")
    for row in rows:
        for side in row.removesuffix(r" \\").split(" & = "):
            parser.parse(f"${re.sub(r'(begin|end){cases}', '', side)}$")
    for one in equations.coordinates:
        assert rf"\ddot{{{one[0]}" in latex or rf"\ddot{{\{one}" in latex or rf"\ddot{{\mathit{{{one[:-1]}" in latex
