"""The documentation against the project: links, commands, imports, and the picture of the floors."""

import ast
import importlib
import importlib.util
import re
import shlex
from pathlib import Path

import pytest
import yaml

from masking.app.cli import main_program
from masking.lab.runs.experiment import Experiment
from masking.model.effects import EFFECTS
from tests.project.test_architecture import FLOORS, WINGS

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
EACH_PAGE = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
LINK = re.compile(r"\]\(([^)\s]+)\)")
NAMED_FILE = re.compile(r"`((?:docs|examples|tests|models|plants|dictionaries|masking|reproduction)/[\w/.]+\.\w+)`")
FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^(?: {4})?(masking [a-z].*)$", re.MULTILINE)


def slug(heading: str) -> str:
    """Return the anchor of a heading, as GitHub and Python-Markdown make it."""
    return re.sub(r"\s", "-", re.sub(r"[^\w\s-]", "", heading.strip().lower()))


def anchors(page: Path) -> set[str]:
    return {slug(heading) for heading in re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)}


@EACH_PAGE
def test_links_lead_somewhere(page):
    for link in LINK.findall(page.read_text(encoding="utf-8")):
        if link.startswith(("http:", "https:")):
            continue
        name, _, anchor = link.partition("#")
        target = page if not name else page.parent / name
        assert target.is_file(), link
        assert not anchor or anchor in anchors(target), link


@EACH_PAGE
def test_files_that_are_named_exist(page):
    for name in NAMED_FILE.findall(page.read_text(encoding="utf-8")):
        assert (ROOT / name).exists() or Path(name).name.startswith("my_"), name


def commands(page: Path) -> list[str]:
    """Return the commands of a page, without the comments behind them."""
    return [line.split(" #")[0].rstrip(" \\") for line in COMMAND.findall(page.read_text(encoding="utf-8"))]


@EACH_PAGE
def test_commands_are_accepted_by_the_parser(page, capsys):
    for command in commands(page):
        try:
            words = shlex.split(command.replace("PROCEDURE", "springs"))[1:]
            main_program._parser().parse_args(words)
        except SystemExit:
            pytest.fail(f"{command}: {capsys.readouterr().err}")


def is_module(node: ast.ImportFrom, alias: ast.alias) -> bool:
    return importlib.util.find_spec(f"{node.module}.{alias.name}") is not None


@EACH_PAGE
def test_imports_of_examples_work(page):
    blocks = [text for language, text in FENCED.findall(page.read_text(encoding="utf-8")) if language == "python"]
    for block in blocks:
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "masking":
                module = importlib.import_module(node.module)
                assert not [a.name for a in node.names if not hasattr(module, a.name) and not is_module(node, a)]


def test_commands_are_found():
    assert sum(len(commands(page)) for page in PAGES) > 30


def wings() -> str:
    """Return the wings of the package with their folders, the highest first."""
    rows = [f"{wing:<13}{'   '.join(folders)}".rstrip() for wing, folders in WINGS.items()]
    return "\n".join(reversed(rows))


def test_the_picture_of_the_wings_is_that_of_the_tested_table():
    assert wings() in (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8"), f"paste this:\n{wings()}"


def test_every_wing_and_folder_is_described():
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert not [folder for folder in [*WINGS, *FLOORS] if f"| `{folder}` |" not in text]


def test_pages_of_the_site_are_those_of_the_folder():
    site = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    named = set(re.findall(r"[\w]+\.md", str(site["nav"])))
    assert named == {page.name for page in PAGES if page.parent == ROOT / "docs"} | {"index.md"}


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_every_effect_is_in_the_table_with_its_meaning(effect):
    rows = (ROOT / "docs" / "declarations.md").read_text(encoding="utf-8").splitlines()
    cells = [[cell.strip() for cell in row.split("|")] for row in rows if row.startswith(f"| `{effect.name}` |")]
    (_, _, sits, parameters, meaning, _) = next(row for row in cells if len(row) == 6)
    assert sits == effect.where
    assert re.findall(r"`(\w+)`", parameters) == [*effect.parameters]
    assert meaning == effect.meaning


def test_the_cart_in_metres_of_the_declarations_moves_as_the_oscillator(tmp_path):
    blocks = FENCED.findall((ROOT / "docs" / "declare_experiment.md").read_text(encoding="utf-8"))
    (text,) = (body for language, body in blocks if language == "yaml" and "x/stroke" in body)
    (tmp_path / "cart.yaml").write_text(text, encoding="utf-8")
    run = Experiment.load(tmp_path / "cart.yaml").run()
    assert run.manifest["masking_error"]["x"] <= 0.03
    assert run["virtual.x"][0] == pytest.approx(0.5, abs=0.01)
    assert run["rig.x"][0] == pytest.approx(0.0025, abs=5e-5)
    assert run.t[-1] == pytest.approx(2.0)
