"""Folders of results: what is there is replaced where that is asked for, and by nothing else."""

import inspect
import os
import subprocess
import sys

import pytest

import masking
from masking.app.cli import main
from masking.app.workflows.output_folders import own_folder
from masking.errors import RecordError
from masking.lab.records.owned_folder import OwnedFolder

SHORT = """
plant: ideal
virtual: duffing
controller: {rate: continuous}
initial: {x1: -0.6, x2: -0.5}
duration: 2
"""
MEND = "name another folder with --out, or replace it with --overwrite (in Python, out= and overwrite=True)"


@pytest.fixture
def short(tmp_path):
    path = tmp_path / "short.yaml"
    path.write_text(SHORT, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", masking.__all__)
def test_every_verb_that_saves_can_be_told_to_overwrite_and_does_not_by_itself(name):
    verb = getattr(masking, name)
    if inspect.isfunction(verb) and "out" in inspect.signature(verb).parameters:
        assert inspect.signature(verb).parameters["overwrite"].default is False


def test_a_run_is_replaced_only_if_asked_for(capsys, short, tmp_path):
    out = tmp_path / "out"
    assert main(["run", str(short), "--out", str(out)]) == 0
    before = (out / "recording.parquet").read_bytes()
    capsys.readouterr()
    assert main(["run", str(short), "--set", "w3=0.6", "--out", str(out)]) == 2
    assert capsys.readouterr().err == f"masking: {out} holds an earlier result, recording.parquet; {MEND}\n"
    with pytest.raises(RecordError, match="holds an earlier result"):
        masking.run(short, out=out)
    assert (out / "recording.parquet").read_bytes() == before
    assert main(["run", str(short), "--set", "w3=0.6", "--out", str(out), "--overwrite"]) == 0
    assert masking.Recording.load(out).manifest["parameters"]["w3"] == 0.6


def test_an_animation_does_not_outlast_its_run(short, tmp_path):
    masking.run(short, out=tmp_path / "a")
    page = masking.animate(tmp_path / "a")
    masking.run(short, out=tmp_path / "a", overwrite=True)
    assert not page.exists()


def test_a_report_replaces_that_of_its_own_recording_alone(short, tmp_path):
    for name in ("a", "b"):
        masking.run(short, out=tmp_path / name)
    masking.report(tmp_path / "a")
    masking.report(tmp_path / "a" / "recording.parquet")
    with pytest.raises(RecordError, match=r"holds an earlier result, report\.html"):
        masking.report(tmp_path / "a", out=tmp_path / "b")
    masking.report(tmp_path / "a", out=tmp_path / "b", overwrite=True)


def held(folder, name, *, overwrite):
    with own_folder(folder, name, overwrite=overwrite):
        return True


def test_what_a_verb_does_not_write_is_in_nobodys_way(tmp_path):
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    assert held(tmp_path, "fit.json", overwrite=False)
    (tmp_path / "fit.json").write_text("{}", encoding="utf-8")
    assert held(tmp_path, "simulation.json", overwrite=False)
    assert held(tmp_path, "fit.json", overwrite=True)
    with pytest.raises(RecordError, match=r"fit\.json"):
        held(tmp_path, "fit.json", overwrite=False)


def test_a_folder_has_one_owner_and_nothing_of_it_stays(tmp_path):
    folder = tmp_path / "a" / "b"
    with own_folder(folder), pytest.raises(RecordError, match=rf"process {os.getpid()} writes into .*a/b; wait"):
        held(folder, "fit.json", overwrite=True)
    assert not (tmp_path / "a").exists()
    with own_folder(folder):
        (folder / "fit.json").write_text("{}", encoding="utf-8")
    assert [path.name for path in folder.iterdir()] == ["fit.json"]


def test_the_owner_of_a_folder_may_be_killed_and_its_child_stays_one(tmp_path):
    """The system frees a lock with the last process that has it."""
    folder = tmp_path / "a"
    code = (
        "import subprocess, sys; from masking.lab.records.owned_folder import OwnedFolder\n"
        "with OwnedFolder(sys.argv[1]) as owned:\n"
        "    child = subprocess.Popen(['cat'], stdin=sys.stdin, pass_fds=[owned.handle]) if sys.argv[2:] else None\n"
        "    print('owned', flush=True); sys.stdin.read()\n"
    )
    for more in ([], ["with a child"]):
        command = [sys.executable, "-c", code, str(folder), *more]
        reading, writing = os.pipe()
        with subprocess.Popen(command, stdin=reading, stdout=subprocess.PIPE) as process:
            assert process.stdout.readline() == b"owned\n"
            with pytest.raises(RecordError, match=f"process {process.pid} writes into"):
                held(folder, "fit.json", overwrite=True)
            process.kill()
            process.wait()
            if more:
                with pytest.raises(RecordError, match=f"process {process.pid} writes into"):
                    held(folder, "fit.json", overwrite=True)
        os.close(reading)
        os.close(writing)  # the child ends
        with OwnedFolder(folder, patience=60.0):
            pass
    assert not [*folder.iterdir()]


def test_of_two_runs_into_one_folder_one_wins_and_the_other_says_why(short, tmp_path):
    command = [sys.executable, "-m", "masking", "run", str(short), "--out", str(tmp_path / "out")]
    both = [subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    said = [process.communicate()[1] for process in both]
    ends = sorted(process.returncode for process in both)
    assert ends == [0, 2]
    (loser,) = (text for process, text in zip(both, said, strict=True) if process.returncode)
    assert "writes into" in loser or "holds an earlier result" in loser
