"""The tutorial as a newcomer types it: files saved and commands run in their order, each part in an empty folder.

A block of YAML or Python is saved under the name in its first line; `# NAME, added at the end` adds it to that file.
What a block of `text` shows was printed by the commands above it, in this order; `...` stands for anything, and a
number may differ by one unit in its last digit.
"""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from masking.app import cli
from tests.documented.marks import NUMBER, is_same
from tests.project.test_readme import blocks, lines

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
PARTS = re.split(r"^## ", PAGE, flags=re.MULTILINE)[1:]
FILE = re.compile(r"# ([\w.]+)(, added at the end)?\n")
STATUS = {  # in their order, of commands that the page says do not end with 0
    "masking check experiment_tip.yaml": [1, 0],
    "masking check beam_tip.yaml": [1],
    "masking run experiment.yaml --set w=12 --out results/fast": [1],
    "masking simulate drive.yaml drive_log.csv": [2],
}
NOT_RUN = {
    "python3 -m venv .venv": "the tests run in an environment already",
    ". .venv/bin/activate": "likewise",
    "python -m pip install ../masking": "test_packaging installs the wheel",
}


def save(block: str) -> None:
    """Write a block to the file that its first line names, or add it to that."""
    name, is_added = FILE.match(block).groups()
    with Path(name).open("a" if is_added else "w", encoding="utf-8") as file:
        file.write(block)


def ended(command: str) -> int:
    """Run a command of the page, and return its exit status."""
    program, *words = shlex.split(command)
    if program == "masking":
        return cli.main(words)
    program = {"python": sys.executable}.get(program, program)
    done = subprocess.run([program, *words], capture_output=True, text=True, check=False)
    print(done.stdout, done.stderr)
    return done.returncode


def after(shown: str, printed: str) -> str:
    """Return what was printed behind what the page shows, which is found piece by piece, whatever the white space."""
    printed = " ".join(printed.split())
    for piece in re.split(r"^\.\.\.$", shown, flags=re.MULTILINE):
        wanted = " ".join(piece.split())
        pattern = NUMBER.pattern.join(re.escape(part) for part in NUMBER.split(wanted))
        ends = [found.end() for found in re.finditer(pattern, printed) if is_same(wanted, found[0])]
        assert ends, f"the page shows\n{piece}\nand printed was\n{printed}"
        printed = printed[ends[0] :]
    return printed


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.partition("\n")[0])
def test_each_part_runs_as_it_is_typed(part, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    expected = {command: iter(statuses) for command, statuses in STATUS.items()}
    for language, block in blocks(part):
        if language in ("yaml", "python"):
            save(block)
        elif language == "sh":
            printed = ""
            for command in lines(block):
                if command not in NOT_RUN:
                    status = ended(command)
                    out, err = capsys.readouterr()
                    printed += out + err
                    assert status == next(expected.get(command, iter([0]))), f"{command}\n{printed}"
        else:
            assert language == "text", block
            printed = after(block, printed)


def test_it_is_the_first_page_of_the_guide_and_every_command_that_is_named_stands_in_it():
    site = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    assert site["nav"][1] == "tutorial.md"
    typed = {command for language, block in blocks(PAGE) if language == "sh" for command in lines(block)}
    assert NOT_RUN.keys() | STATUS.keys() <= typed


@pytest.mark.parametrize(
    ("shown", "printed"),
    [
        ("chi 0.021\n...\nend", "chi 0.023 and\n end"),
        ("b\n...\na", "a b"),
        ("12 samples", "13 samples"),
    ],
)
def test_what_was_not_printed_is_found(shown, printed):
    assert after("chi   0.021\n...\nend 2", "chi 0.022 of it, the end 2 of it") == " of it"
    with pytest.raises(AssertionError, match="the page shows"):
        after(shown, printed)
