"""The comparison with the source document: what it holds, what it says of differences, and how it is cached."""

import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from masking.analysis.stability.modes import modes, state_matrix
from masking.errors import DeclarationError
from masking.model.modelling.model import load_model
from reproduction import __main__, cache, chapter7, chapter8, document, errata
from reproduction.comparison import Entry, Value, declared, experimental, repeated
from reproduction.contents import CHAPTERS, ENTRIES, chosen
from reproduction.mismatch import mismatch


def value(entry, what):
    (found,) = [v for v in entry.values if v.what == what]
    return found


# Verdicts.


@pytest.mark.parametrize(
    ("made", "verdict"),
    [
        (Value("x", 1.01, document=1.0), "agrees"),
        (Value("x", 1.01, document=1.0, within=0.005), "unexplained"),
        (Value("x", 1.08, document=1.0, within=0.1), "in kind"),
        (Value("x", 1.0, document=1.0, within=0.1), "in kind"),  # the row's tolerance decides, not chance
        (Value("x", 1.0, document=1.0, given=True), "given"),
        (Value("x", 2.0, document=1.0, given=True), "unexplained"),  # a fit that fails shows something
        (Value("x", 0.76, document=1.0, within=0.25, given=True, why="of two"), "explained"),  # a fit that is far off
        (Value("x", 1.03, document=1.0), "unexplained"),
        (Value("x", 1.03, document=1.0, why="it was measured so"), "explained"),
        (Value("x", 1.1e-4, independent=1e-4), "agrees"),  # printed to one digit
        (Value("x", 1.0, document=1.0, independent=2.0), "unexplained"),
        (Value("x", 1.0), "ours only"),
        (Value("x", 1.0, document="not legible in the text"), "ours only"),
        (Value("x", math.nan, document=1.0), "unexplained"),
    ],
)
def test_a_number_agrees_is_explained_or_is_marked(made, verdict):
    assert made.verdict == verdict


def test_a_parameter_that_is_typed_from_the_table_is_given_and_a_derived_one_is_compared():
    setup = load_model("setup").dimensionless()
    typed, derived, wrong = declared(setup, {"z1": 0.3362, "w1": 0.9443, "mu1": 0.05}, "a table")
    assert (typed.verdict, derived.verdict, wrong.verdict) == ("given", "agrees", "unexplained")


def test_a_number_that_stands_in_two_tables_counts_in_the_first():
    first = Entry("Table 1", "", "table", (Value("a", 2.0, document=2.0, where="p. 1"), Value("b", 2.0)))
    second = Entry(
        "Table 2",
        "",
        "table",
        (Value("c", 2.0, document=2.0, where="p. 1", within=0.5), Value("d", 2.0), first.values[0]),
    )
    repeats = repeated([first, second])
    assert repeats == {("Table 2", "c"): "Table 1", ("Table 2", "a"): "Table 1"}
    found = document.counts([first, second], repeats)
    assert (found["agrees"], found["in kind"], found["ours only"], found["repeated"]) == (1, 0, 2, 2)
    assert "| c | 2 (p. 1) |  | 2 | 1 | see Table 1 |" in document.section(second, repeats)


def test_an_experiment_on_the_twin_says_so():
    (value,) = experimental(Value("x", 1.08, document=1.0, within=0.1))
    assert "| in kind (10 %), twin |" in document.section(Entry("Fig. 0", "", "figure", (value,)))


def test_ratio_is_to_the_document_and_else_to_the_independent_number():
    assert Value("x", 3.0, document=2.0, independent=1.0).ratio == 1.5
    assert Value("x", 3.0, independent=1.5).ratio == 2.0
    assert math.isnan(Value("x", 3.0).ratio)


# Entries against what was computed or derived outside.


@pytest.fixture(scope="module")
def discs():
    return chapter8.fig_8_2()


def test_independent_numbers_agree(discs):
    compared = [v for v in discs.values if math.isfinite(v.independent)]
    assert len(compared) == 4
    assert {v.verdict for v in compared} == {"agrees"}
    assert discs.picture.startswith(b"\x89PNG")


@pytest.mark.parametrize("make", [errata.gains, errata.cubic, errata.damping_entry, errata.crest])
def test_an_erratum_is_explained_by_a_number_that_differs(make):
    verdicts = {v.verdict for v in make().values}
    assert "explained" in verdicts
    assert "unexplained" not in verdicts


def test_printed_gains_are_too_large_by_the_fourth_power_of_the_frequency():
    found = value(errata.gains(), "lam1 = nu c1/(l wbar^2)")
    assert 1.0 / found.ratio == pytest.approx(13.2929**4, rel=1e-4)


def test_printed_cubic_stiffness_is_ten_times_the_scale_without_the_stiffness():
    found = value(errata.cubic(), "10 (l/wbar)^2, in SI units")
    assert found.ours == pytest.approx(10 * (5e-3 / 18.3157) ** 2, rel=1e-12)
    assert found.verdict == "agrees"


def test_crossed_reaction_moves_the_centre_of_mass():
    kept_still, moved = errata.reaction().values
    assert kept_still.ours == 0.0
    assert moved.ours == pytest.approx(2.0 / (1.0 + 0.0411 + 0.0578))


def test_energy_balance_holds_with_the_square_of_the_frequency_only():
    right, wrong = (v.ours for v in errata.stiffness_power().values)
    assert right < 1e-5
    assert wrong > 1e-2


def test_parameters_of_the_duffing_oscillators_are_derived():
    table = chapter7.table_7_2()
    assert value(table, "w3, that of the beam, in the new time").verdict == "agrees"
    assert value(table, "th (both), beta l^2/wbar^2").ours == pytest.approx(4.4728e6 * 25e-6 / 18.3157**2, rel=1e-12)


def test_a_mismatch_has_the_mode_that_was_asked_for():
    wanted = mismatch(load_model("discs_driven").dimensionless().with_parameters(**chapter8.PLAIN), 1.35, 0.95 * np.pi)
    found = modes(state_matrix(wanted.model), wanted.model.coordinates)
    neutral = min(found.modes, key=lambda mode: abs(mode.eigenvalue.real))
    ratio = neutral.shape["th1"] / neutral.shape["th2"]
    assert abs(neutral.eigenvalue.real) < 1e-7
    assert abs(ratio) == pytest.approx(1.35, rel=1e-5)
    assert abs(np.angle(ratio)) == pytest.approx(0.95 * np.pi, rel=1e-5)
    others = [mode.eigenvalue.real for mode in found.modes if mode is not neutral]
    assert max(others) < -0.01
    assert wanted.decay == pytest.approx(-max(others))


# The page.


def test_every_entry_is_named_as_its_number():
    assert all(make.__module__.startswith("reproduction.") for make in ENTRIES.values())
    assert sum(len(chapter) for chapter in CHAPTERS.values()) == len(ENTRIES)
    for number in ("Table 7.2", "Erratum: (4.13)", "Table 8.4", "ENOC Table 2"):
        assert ENTRIES[number]().number == number


@pytest.mark.parametrize(
    ("word", "numbers"), [("Fig. 7.2", ("Fig. 7.2",)), ("9.2", ("Table 9.2", "Fig. 9.2", "Section 9.2"))]
)
def test_entries_are_chosen_by_a_part_of_their_number(word, numbers):
    assert chosen(word) == numbers


def test_a_number_that_is_not_there_is_refused():
    with pytest.raises(DeclarationError, match=r"there is no figure or table '17\.3'"):
        chosen("17.3")


def test_differences_are_explained_below_their_table():
    entry = Entry(
        "Fig. 0",
        "a title",
        "figure",
        (Value("a|b", 2.0, document=1.0, where="p. 1", why="it doubles"), Value("c", 2.0, document=1.0)),
        ("More is to be said.",),
        b"picture",
    )
    text = document.section(entry)
    assert "| a\\|b | 1 (p. 1) |  | 2 | 2 | explained |" in text
    assert "| **unexplained** |" in text
    assert "*a|b*: it doubles." in text
    assert "![a title](pictures/thesis/fig_0.png)" in text
    assert "![" not in document.section(entry, pictured=False)
    found = {verdict: n for verdict, n in document.counts([entry]).items() if n}
    assert found == {"explained": 1, "unexplained": 1}


def test_an_entry_is_kept_and_found_again(tmp_path, monkeypatch):
    monkeypatch.setenv("MASKING_CACHE", str(tmp_path))
    calls = []

    def made():
        calls.append(1)
        return Entry("Fig. 0", "a title", "figure", (Value("x", math.nan, document=1.0),), ("words",), b"\x00picture")

    first, second = cache.cached("Fig. 0", made), cache.cached("Fig. 0", made)
    assert calls == [1]
    assert (first.picture, first.words, first.stem) == (second.picture, second.words, second.stem)
    assert math.isnan(second.values[0].ours)
    assert cache.is_cached("Fig. 0", made)
    assert not cache.is_cached("Fig. 1", made)


def test_the_page_and_its_pictures_are_written(tmp_path):
    numbers = ("Table 7.2", "Fig. 8.2", "Erratum: (7.4)")
    path = document.write(document.computed(numbers), tmp_path)
    text = path.read_text()
    for picture in re.findall(r"\]\((pictures/[^)]+)\)", text):
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
    assert text.index("### Table 7.2") < text.index("### Fig. 8.2") < text.index("### Erratum: (7.4)")


def reproduced(capsys, *arguments: str):
    """Return the exit status and what `python -m reproduction` prints."""
    return __main__.main(arguments), capsys.readouterr().out


def test_command_prints_an_entry(capsys):
    status, text = reproduced(capsys, "--only", "Table 8.4")
    assert status == 0
    assert "| nu1 | 0.7004 (Table 8.4) |  | 0.7004 | 1 | given |" in text
    status, text = reproduced(capsys, "--only", "Table 8.4", "--json")
    assert status == 0
    assert {v["verdict"] for v in json.loads(text)["entries"]["Table 8.4"]["values"]} == {"given"}
    assert reproduced(capsys, "--only", "17.3")[0] == 2
    assert reproduced(capsys, "--only", "")[0] == 2


def test_command_is_there_by_name():
    done = subprocess.run(
        [sys.executable, "-m", "reproduction", "--only", "17.3"],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert "there is no figure or table '17.3'" in done.stderr


def test_summary_counts_the_numbers_that_agree(tmp_path):
    made = document.compare(only="Erratum: (A.4)", out=tmp_path)
    assert str(made).startswith(
        "1 figures, tables and errata: 0 numbers agree, 0 in kind, 1 differ and are explained, 0 differ unexplained"
    )


PAGE = (Path(__file__).parents[2] / "docs" / "thesis.md").read_text(encoding="utf-8")
QUICK = tuple(n for n in ENTRIES if n.startswith(("Table 7", "Table 8", "Table 9", "ENOC Table")))
SLOW = tuple(pytest.param(n, marks=pytest.mark.search) for n in ENTRIES if n not in QUICK)


@pytest.mark.parametrize("number", [*QUICK, *SLOW])
def test_the_page_has_the_numbers_that_the_code_computes(number):
    rows = [line for line in document.section(ENTRIES[number]()).splitlines() if line.startswith("| ")]
    for row in rows:
        assert row.rsplit("|", 2)[0] in PAGE  # the class may refer to another table
