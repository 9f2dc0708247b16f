"""Every row of docs/thesis.md that is neither given nor an experiment on the twin, against a second implementation."""

import re
from pathlib import Path

import pytest

from tests import second_implementation

PAGE = (Path(__file__).parents[2] / "docs" / "thesis.md").read_text(encoding="utf-8")
DIGITS = 6e-4  # the page prints four
ROUNDING = 1e-8
PHASE = 1e-3  # of pi: Hilbert transforms differ by their ends
LOOSER = {"crest factor of our 25 harmonics of 0.96 s": 0.03}  # the least of many minima
LOOSER |= {f"crest factor, phases of 2p = {p}": 0.003 for p in (4, 20)}  # samples of the record differ
EXACT = "on the ideal rig"


def rows():
    """Return by entry the rows of the page: ours and the mark by name."""
    found = {}
    for section in re.split(r"^### ", PAGE, flags=re.MULTILINE)[1:]:
        number = re.match(r"((?:Erratum: )?[^:]+):", section)[1]
        lines = [line for line in section.splitlines() if line.startswith("| ") and not line.startswith("| ---")]
        cells = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)] for line in lines]
        found[number] = {c[1].replace("\\|", "|"): (c[4], c[6]) for c in cells if c[1]}
    return found


ROWS = rows()
COMPUTED = {
    (number, what): float(ours)
    for number, found in ROWS.items()
    for what, (ours, mark) in found.items()
    if not mark.startswith(("see ", "given")) and not mark.endswith("twin")
}
IDEAL = {row: ours for row, ours in COMPUTED.items() if EXACT in row[1]}


def test_every_row_is_given_an_experiment_or_computed_twice():
    assert {number for number, _ in COMPUTED.keys() - IDEAL.keys()} <= set(second_implementation.ENTRIES)
    assert set(second_implementation.ENTRIES) <= set(ROWS)


@pytest.mark.parametrize("number", second_implementation.ENTRIES)
def test_rows_are_what_a_second_implementation_computes(number):
    again = second_implementation.ENTRIES[number]()
    ours = {what: x for (of, what), x in COMPUTED.items() if of == number and (of, what) not in IDEAL}
    assert ours.keys() <= again.keys()
    for what, x in ours.items():
        nearness = PHASE if what.startswith("phase") else ROUNDING
        assert x == pytest.approx(again[what], rel=LOOSER.get(what, DIGITS), abs=nearness), what


def test_a_controller_that_knows_the_rig_masks_it_exactly():
    # Feedback linearisation (6.1)-(6.3) cancels the rig's dynamics: what is left is the error of integration.
    assert len(IDEAL) > 5
    assert max(IDEAL.values()) < ROUNDING


def test_the_second_implementation_imports_nothing_of_the_project():
    for path in Path(second_implementation.__file__).parent.glob("*.py"):
        imported = re.findall(r"^(?:from|import) ([\w.]+)", path.read_text(encoding="utf-8"), re.MULTILINE)
        allowed = {"itertools", "math", "numpy", "scipy", "tests.second_implementation"}
        assert {name for name in imported if not name.startswith(tuple(allowed))} == set()
