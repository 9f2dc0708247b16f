"""`make bench` runs: each of its parts that needs neither minutes nor a browser, with sizes that say nothing."""

import json

import pytest

from tests.benchmarks import __main__ as bench
from tests.benchmarks import table

SHORT = ("trajectory", "ensembles", "many", "sampled", "twin", "step", "authentication")


def test_parts_print_and_write_their_rows(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["bench", *SHORT, "--tiny", "--json", str(tmp_path / "bench.json")])
    monkeypatch.setattr(table, "is_tiny", False)
    bench.main()
    printed = capsys.readouterr().out
    written = json.loads((tmp_path / "bench.json").read_text())["rows"]
    assert len(written) >= 2 * len(SHORT)
    assert all(row["what"] in printed for row in written)
    assert {row["verdict"].partition(":")[0] for row in written} <= {"reached", "short", "not measured", ""}


def test_a_part_that_there_is_not_is_refused(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["bench", "speed"])
    with pytest.raises(SystemExit):
        bench.main()
    assert "the parts are trajectory, ensembles" in capsys.readouterr().err
