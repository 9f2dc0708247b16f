"""The faults of the table, as `python -m tests.campaigns faults --quick` produces them, and what judges them."""

import json
import re
from pathlib import Path

import pytest

from tests.campaigns.__main__ import main
from tests.campaigns.bench import Bench
from tests.campaigns.rerun import FAULTS
from tests.campaigns.table import Fault, examine


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    made = Bench(tmp_path_factory.mktemp("faults") / "bench")
    yield made
    made.close()


def test_the_table_is_whole():
    assert [fault.number for fault in FAULTS] == list(range(35))


def test_the_guide_has_the_table():
    page = (Path(__file__).parents[2] / "docs" / "rig_reference.md").read_text(encoding="utf-8")
    lines = page.partition("<!-- computed: faults_table -->")[2].partition("<!-- end -->")[0].splitlines()
    rows = [tuple(cell.strip() for cell in line.split("|")[1:4]) for line in lines if line.startswith("|")]
    assert rows[2:] == [(str(fault.number), fault.injected, fault.expected) for fault in FAULTS]


@pytest.mark.parametrize(
    "fault",
    [
        # The batch is 27: tests/app/workflows/test_batch.py has its trip, its zeros and its second try.
        pytest.param(
            fault,
            id=str(fault.number),
            marks=pytest.mark.search if fault.number == 27 else pytest.mark.realtime if fault.in_real_time else (),
        )
        for fault in FAULTS
    ],
)
def test_a_fault_is_survived(bench, fault):
    found = examine(fault, bench)
    assert found.broken == (), found.measured


def test_what_breaks_a_criterion_or_raises_fails(tmp_path):
    bench = Bench(tmp_path)

    def breaks(_, judgement):
        judgement.say("3 ticks")
        judgement.need(holds=False, broken="3 ticks, more than 2")

    def raises(*_):
        raise ValueError("unexpected")

    assert examine(Fault(1, "a", "b", breaks), bench).broken == ("3 ticks, more than 2",)
    assert examine(Fault(1, "a", "b", breaks, in_real_time=True), bench).tries == 3
    assert examine(Fault(1, "a", "b", raises), bench).broken == ("ValueError: unexpected",)


def test_the_command_line_prints_the_table_and_refuses_other_numbers(capsys):
    assert main(["faults", "28", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    (found,) = said["faults"]
    assert said["seconds"] >= found["seconds"] - 0.1
    assert (found["number"], found["passes"], found["broken"]) == (28, True, [])
    assert main(["faults", "28", "1"]) == 0
    assert re.search(r"\n2 of 2 pass, in \d+ s\n$", capsys.readouterr().out)
    assert main(["faults", "77"]) == 2
    assert "there is no fault 77; give numbers from 0 to 34" in capsys.readouterr().err
