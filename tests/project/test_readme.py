"""The blocks of the README, run as they stand, in their order, in a folder that holds nothing but `examples/`.

A block of YAML that begins with `# NAME.yaml` is written to that file and checked. Commands run in this process.
"""

import re
import shlex
from pathlib import Path

import pytest

from masking.app import cli

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
EXIT_STATUS = {"masking check pendula_fast": 1}  # the README says what 1 is: the rig is not strong enough
NOT_RUN = {
    ". .venv/bin/activate": "the tests run in an environment already",
    "python examples/scripts/10_discover_and_refine.py": "minutes; test_examples runs it",
    "masking play duffing": "ends at an interrupt; test_play_page plays",
    "masking rig serve tue_rig": "ends at an interrupt; test_rig serves",
    "masking rig run huygens_rig --plant udp://127.0.0.1:5005": "80 s; test_rig runs in lockstep",
    "masking rig calibrate tue_rig --model setup_springs": "minutes of the twin's clock; test_calibration",
}


def blocks(text: str) -> list[tuple[str, str]]:
    return BLOCK.findall(text)


def lines(block: str) -> list[str]:
    """Return the commands of a block, without the comments behind them."""
    return [line.split(" #")[0].rstrip() for line in block.splitlines() if line]


def recipe(target: str) -> list[str]:
    """Return the commands of a target of the Makefile, as one would type them."""
    (found,) = re.findall(
        rf"^{target}:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
    )
    return [line.strip().removeprefix("$(BIN)/") for line in found.splitlines()]


def run(command: str) -> None:
    """Run one command of the README, a target of make by its recipe."""
    words = shlex.split(command)
    if words[0] == "make":
        for each in recipe(words[1]):
            run(each)
        return
    assert words[0] == "masking", command
    assert cli.main(words[1:]) == EXIT_STATUS.get(command, 0), command


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_blocks_run_in_their_order(folder):
    ran, left = 0, set(NOT_RUN)
    for language, block in blocks(README):
        if language == "yaml":
            name = re.match(r"# (\w+\.yaml)\n", block)[1]
            (folder / name).write_text(block, encoding="utf-8")
        elif language == "python":
            exec(compile(block, "README.md", "exec"), {})  # noqa: S102  # our own page
        else:
            for command in lines(block):
                if command in NOT_RUN:
                    left.discard(command)
                else:
                    run(command)
                    ran += 1
    assert not left, "no longer in the README"
    assert ran >= 10
    for path in sorted(folder.glob("*.yaml")):
        assert cli.main(["check", path.name]) == 0, path.name
    assert (folder / "results" / "my_experiment" / "report.html").is_file()


def test_an_own_rig_is_masked_in_five_commands(folder, capsys):
    (_, first), *_ = blocks(README)
    section = README.partition("## Your own rig\n")[2].partition("\n## ")[0]
    *files, (_, own), _ = blocks(section)
    for _, block in files:
        (folder / re.match(r"# (\w+\.yaml)\n", block)[1]).write_text(block, encoding="utf-8")
    assert len(lines(first)) + len(lines(own)) <= 5
    for command in lines(own):
        run(command)
    said = capsys.readouterr().out
    assert "masking error chi = " in said
    assert float(re.search(r"masking error chi = ([\d.e-]+)", said)[1]) < 0.01
