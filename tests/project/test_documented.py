"""Numbers in the README and the documentation are those that the code gives."""

import re

import pytest

from tests.documented import marks
from tests.documented.values import VALUES, spread

MARKS = list(marks.marks())
QUICK = [mark for mark in MARKS if not mark.is_slow]


@pytest.mark.parametrize("mark", QUICK, ids=lambda mark: f"{mark.page.name}: {mark.call}")
def test_a_quick_number_is_what_the_code_gives(mark):
    computed = mark.computed()
    assert marks.is_same(mark.text, computed), f"now {computed}: python -m tests.documented --write"


def test_every_value_is_in_a_page_and_every_marker_is_whole():
    assert {mark.call.split()[0] for mark in MARKS} == VALUES.keys()
    for page in marks.PAGES:
        text = page.read_text(encoding="utf-8")
        assert text.count("<!-- computed: ") == text.count("<!-- end -->") == sum(m.page == page for m in MARKS)
        assert not re.findall(r"^<!-- computed: [^>]+ -->[^\n]", text, re.MULTILINE), "it would end its paragraph"


@pytest.mark.parametrize(
    ("written", "computed", "same"),
    [
        ("chi 0.036 ± 0.001", "chi 0.037  ±\n0.001", True),
        ("chi 0.036 ± 0.001", "chi 0.038 ± 0.001", False),
        ("16 equilibria", "17 equilibria", False),
        ("2e-5", "3e-5", True),
        ("2e-5", "2e-4", False),
        ("below 1e-8", "above 1e-8", False),
    ],
)
def test_numbers_may_differ_by_one_unit_of_their_last_digit(written, computed, same):
    assert marks.is_same(written, computed) is same


def test_a_block_of_python_gets_its_values():
    text = '\n```python\nfrom math import pi\n\n2 * pi  # 6.2, Table 1\npi / 3e4  # 1.0e-4\n"pi"  # a name\n```\n'
    expected = text.replace("6.2,", "6.3,").replace("1.0e-4", "0.00010")
    assert marks.Mark(marks.ROOT, "python", text).computed() == expected


def test_the_spread_is_that_of_numpy():
    assert spread([0.1, 0.1, 0.1]) == "0.1"
    assert spread([0.031, 0.035, 0.039]) == "0.035 ± 0.004"
    assert spread([12.0, 14.0, 16.0]) == "14 ± 2"
