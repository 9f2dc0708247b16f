"""The wheel and the sdist: what they contain, and that they work away from the repository."""

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DECLARATIONS = ("models", "plants", "examples", "dictionaries")
SCRIPTS = ("04_model.py", "05_own_system.py")


@pytest.fixture(scope="module")
def distributions(tmp_path_factory) -> Path:
    """Build an sdist, and from it a wheel; return their folder."""
    out = tmp_path_factory.mktemp("dist")
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True, env=os.environ | {"PIP_NO_INDEX": "1"})
    return out


@pytest.fixture(scope="module")
def away(distributions, tmp_path_factory):
    """Install the wheel into an empty folder; return a function that runs Python there, away from the repository."""
    (wheel,) = distributions.glob("*.whl")
    site, cwd = tmp_path_factory.mktemp("site"), tmp_path_factory.mktemp("away")
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--target", str(site)]
    subprocess.run([*install, str(wheel)], check=True, capture_output=True)

    def run(*arguments: str) -> str:
        environment = os.environ | {"PYTHONPATH": str(site)}
        done = subprocess.run(
            [sys.executable, *arguments], cwd=cwd, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    run.cwd, run.site = cwd, site
    return run


def test_wheel_has_all_that_the_package_reads_and_nothing_else(distributions):
    (wheel,) = distributions.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    for folder in DECLARATIONS:
        shipped = {path.relative_to(ROOT / folder).as_posix() for path in (ROOT / folder).rglob("*.yaml")}
        assert shipped
        assert {f"masking/shipped/{folder}/{name}" for name in shipped} <= names
    package = [path for path in (ROOT / "masking").rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    assert {path.relative_to(ROOT).as_posix() for path in package} <= names
    assert "masking/py.typed" in names
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {"masking"}


def test_sdist_has_what_the_gate_needs(distributions):
    (sdist,) = distributions.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"pyproject.toml", "Makefile", "requirements.txt", "LICENSE", "reproduction/__main__.py"} <= names
    assert {path.relative_to(ROOT).as_posix() for path in (ROOT / "tests").rglob("*.py")} <= names
    assert not [name for name in names if name.startswith((".venv", "results/", "site/", ".git/"))]


def test_command_line_works_from_the_wheel(away):
    origin = away("-c", "import masking; print(masking.__file__)").strip()
    assert Path(origin).parent.parent == away.site
    assert "huygens_rig" in away("-m", "masking", "list")
    assert "masking error chi <=" in away("-m", "masking", "run", "duffing")
    assert (away.cwd / "results" / "duffing" / "report.html").is_file()


@pytest.mark.parametrize("name", SCRIPTS)
def test_examples_work_from_the_wheel(away, name):
    away(str(away.site / "masking" / "shipped" / "examples" / "scripts" / name))
