"""What the command line prints is visible text, whatever comes from outside."""

import io
import sys

import pytest

from masking.app.cli import main_program
from masking.app.cli.terminal import printable
from masking.display.characters import UNFIT

FIRST_PLANE = "".join(map(chr, range(0x10000)))


@pytest.mark.parametrize("encoding", ["utf-8", "ascii", "cp1252"])
def test_whatever_is_printed_is_visible_in_any_encoding(monkeypatch, encoding):
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding))
    with printable():
        print(FIRST_PLANE)
        sys.stdout.flush()
    assert not UNFIT.search(raw.getvalue().decode(encoding).replace("\r\n", "\n"))


def test_a_hostile_file_name_acts_on_no_terminal(capsys, tmp_path):
    path = tmp_path / "a\x1b]0;owned\x07\u202e.yaml"
    path.write_text("name: \u00e9\nname: 2\n", encoding="utf-8")
    assert main_program.main(["check", str(path)]) == 2
    with pytest.raises(SystemExit):
        main_program.main(["check", str(path), "--\x1b[2J"])
    shown = "".join(capsys.readouterr())
    assert "<U+001B>]0;owned<U+0007><U+202E>.yaml:2:1: name: the key 'name' stands here twice" in shown
    assert "<U+001B>[2J" in shown
    assert not UNFIT.search(shown)
