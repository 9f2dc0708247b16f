"""Folders of results: what is there is replaced where that is asked for, and by nothing else."""

import inspect

import pytest

import masking
from masking.app.cli import main
from masking.app.workflows.output_folders import check_folder
from masking.errors import RecordError

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


def test_what_a_verb_does_not_write_is_in_nobodys_way(tmp_path):
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    check_folder(tmp_path, "fit.json", overwrite=False)
    (tmp_path / "fit.json").write_text("{}", encoding="utf-8")
    check_folder(tmp_path, "simulation.json", overwrite=False)
    check_folder(tmp_path, "fit.json", overwrite=True)
    with pytest.raises(RecordError, match=r"fit\.json"):
        check_folder(tmp_path, "fit.json", overwrite=False)
