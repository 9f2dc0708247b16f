"""Lock files against the project and against pip; licences on the page against those that the packages state."""

import re
import subprocess
import sys
import tomllib
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
LOCKS = {"dev": ROOT / "requirements.txt", "docs": ROOT / "requirements-docs.txt"}  # by the extra that each is for
DRIVERS = {"nidaqmx"}  # of instruments, which no test needs
ENTRY = re.compile(r"^([\w.-]+)==(\S+)(?: ; [^\\\n]+)?((?: \\\n    --hash=sha256:[0-9a-f]{64})+)\n", re.MULTILINE)
PAGE = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")
FIRST, _, SECOND = PAGE.partition("## Licences that ask for changes back")
ROWS = dict(re.findall(r"^\| (\S+) \| [^|]+ \| ([^|]+) \|$", FIRST, re.MULTILINE))
COPYLEFT = re.compile("GPL|MPL|Mozilla|GNU|EUPL|CDDL")


def locked(path: Path) -> dict[str, str]:
    """Return the version of each package in a lock file."""
    return {canonicalize_name(name): version for name, version, _ in ENTRY.findall(path.read_text(encoding="utf-8"))}


def required(*extras: str) -> list[Requirement]:
    lines = PROJECT["dependencies"] + [line for extra in extras for line in EXTRAS[extra]]
    return [Requirement(line) for line in lines]


@pytest.mark.parametrize("path", LOCKS.values(), ids=LOCKS)
def test_each_line_of_a_lock_file_is_a_version_with_hashes(path):
    text = path.read_text(encoding="utf-8")
    others = [line for line in ENTRY.sub("", text).splitlines() if not line.startswith("#")]
    assert others == []  # no source of packages either
    assert len(locked(path)) == len(ENTRY.findall(text))


@pytest.mark.parametrize("extra", LOCKS)
def test_each_dependency_is_locked_to_a_version_that_is_allowed(extra):
    found = locked(LOCKS[extra])
    for one in required(extra):
        assert one.specifier.contains(found[canonicalize_name(one.name)]), one


def test_each_optional_package_is_locked():
    found = set().union(*map(locked, LOCKS.values()))
    assert {canonicalize_name(one.name) for one in required(*EXTRAS)} - found == DRIVERS


def test_lock_files_agree():
    dev, docs = map(locked, LOCKS.values())
    assert {name: (dev[name], docs[name]) for name in dev.keys() & docs.keys() if dev[name] != docs[name]} == {}


def test_pip_finds_the_lock_complete_and_what_is_installed_is_locked():
    asked = ["install", "--dry-run", "--no-index", "--require-hashes", "--requirement", LOCKS["dev"]]
    done = subprocess.run([sys.executable, "-m", "pip", *asked], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Would install" not in done.stdout


def installed(name: str) -> Distribution | None:
    try:
        return distribution(name)
    except PackageNotFoundError:
        return None


def licence(package: Distribution) -> str:
    """Return what a package states of its licence, in the form that it has: an expression, a class, a text."""
    stated = package.metadata
    classes = [c.rpartition(" :: ")[2] for c in stated.get_all("Classifier") or [] if c.startswith("License")]
    text = stated.get("License") or ""
    return stated.get("License-Expression") or (text if 0 < len(text) < 40 else " and ".join(classes)) or "in a file"


@pytest.mark.parametrize("one", required(*EXTRAS), ids=str)
def test_the_page_has_the_licence_of_each_dependency(one):
    package = installed(one.name)
    assert one.name in ROWS
    assert package is None or ROWS[one.name] == licence(package)


def test_packages_that_ask_for_changes_back_are_named_and_optional_but_for_one():
    shown = {}
    for name in set().union(*map(locked, LOCKS.values())):
        package = installed(name)
        if package is not None and COPYLEFT.search(licence(package)):
            shown[name] = f"| {package.name} |"
    assert {"asammdf", "nptdms", "tqdm"} <= shown.keys()
    section = SECOND.partition("\n## ")[0].lower()
    assert [name for name, row in shown.items() if row.lower() not in section] == []
    assert shown.keys() & closure() == {"tqdm"}


def closure() -> set[str]:
    """Return all packages that come with the project where no extra is asked for."""
    found, pending = set[str](), [one.name for one in required()]
    while pending:
        name = canonicalize_name(pending.pop())
        package = installed(name)
        if name not in found and package is not None:
            needs = [Requirement(line) for line in package.requires or []]
            pending += [one.name for one in needs if one.marker is None or one.marker.evaluate({"extra": ""})]
        found.add(name)
    return found
