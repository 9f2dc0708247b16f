"""The pages that declare a model, a plant and an experiment, as a user types them: in their order, in one folder."""

import pytest

from tests.documented.marks import ROOT
from tests.project.test_readme import blocks, lines
from tests.project.test_tutorial import FILE, after, ended, save

PAGES = ("declare_model", "declare_plant", "declare_experiment")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("declare")


@pytest.mark.parametrize("page", PAGES)
def test_files_are_sound_and_commands_print_what_is_shown(page, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    ran, printed = 0, ""
    for language, block in blocks((ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")):
        if language == "yaml" and FILE.match(block):
            save(block)
        elif language == "sh":
            for command in lines(block):
                status = ended(command)
                out, err = capsys.readouterr()
                printed += out + err
                assert status == 0, f"{command}\n{printed}"
                ran += 1
        elif language == "text":
            printed = after(block, printed)
    assert ran >= 2
