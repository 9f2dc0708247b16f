"""The shape of the package: who may import whom, and what no module may hold."""

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent / "masking"

# Each module imports only from rows above its own; the modules of a package share its row and import each other.
ROWS = (
    {"errors", "status"},
    {"declaration", "parquet", "hdf5", "part", "dop853", "linear"},
    {"markup"},
    {"recording", "drawing", "scales", "fidelity", "integrate", "synchronisation", "wiring"},
    {"signals", "formats"},
    {"sampling"},
    {"compile"},
    {"kernels"},
    {"effects"},
    {"equations"},
    {"lowering"},
    {"model"},
    {"blocks", "twin", "observer"},
    {"controller", "instruments", "sensitivity"},
    {"closed_loop", "sampled"},
    {"loop"},
    {"identification"},
    {"discovery"},
    {"plants"},
    {"realtime"},
    {"study"},
    {"figures", "wording"},
    {"tables"},
    {"page"},
    {"reporting", "calibration", "stability"},
    {"ending"},
    {"experiment"},
    {"budget"},
    {"rig"},
    {"feasibility"},
    {"refinement", "assessment"},
    {"describe", "thesis"},
    {"verbs"},
    {"cli", "__init__"},
)

# A run and its study meet in the file on disk: only a refinement, the verbs and the command line know both. Mathematics
# on series, such as synchronisation, which knows neither, serves both.
ONLINE = {
    "blocks",
    "observer",
    "instruments",
    "controller",
    "closed_loop",
    "sampled",
    "loop",
    "budget",
    "ending",
    "experiment",
    "feasibility",
}
ONLINE |= {"plants", "realtime", "rig"}
OFFLINE = {
    "study",
    "drawing",
    "markup",
    "figures",
    "wording",
    "tables",
    "page",
    "reporting",
    "identification",
    "discovery",
    "stability",
}

FORBIDDEN_CALLS = {"eval", "exec", "compile", "sympify", "parse_expr", "parse_latex", "lambdify", "__import__"}

FILES = sorted(ROOT.rglob("*.py"))
TREES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in FILES}
EACH_FILE = pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(ROOT).as_posix())


def module_of(path: Path) -> str:
    """Return the name that stands in the table: a module, or the package that it is in."""
    return path.relative_to(ROOT).with_suffix("").parts[0]


def imported(tree: ast.AST) -> set[str]:
    """Return the modules of ours that are imported anywhere in a tree, also by name through a lazy loader."""
    return {name.split(".")[1] for name in named(tree) if name.startswith("masking.")}


def named(tree: ast.AST) -> set[str]:
    """Return all modules that are imported anywhere in a tree, with the packages they are in."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: imports are absolute"
            if node.module == "masking":
                found |= {f"masking.{alias.name}" for alias in node.names}
            else:
                found.add(node.module or "")
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Call):
            texts = [a.value for a in node.args if isinstance(a, ast.Constant) and isinstance(a.value, str)]
            if called(node) in {"load", "import_module"}:
                found |= set(texts)
    return found


def called(node: ast.Call) -> str:
    """Return the last name of what is called: `load` of `lazy.load(...)`."""
    function = node.func
    return (
        function.id if isinstance(function, ast.Name) else function.attr if isinstance(function, ast.Attribute) else ""
    )


def test_the_table_lists_every_module_once():
    listed = [name for row in ROWS for name in row]
    assert sorted(listed) == sorted({module_of(path) for path in FILES})


@EACH_FILE
def test_a_module_imports_only_from_rows_above_it(path):
    module = module_of(path)
    row = {name: i for i, names in enumerate(ROWS) for name in names}
    for name in imported(TREES[path]) - {module}:
        assert row[name] < row[module], f"{module} may not import {name}"


@pytest.mark.parametrize(("side", "other"), [(ONLINE, OFFLINE), (OFFLINE, ONLINE)], ids=["online", "offline"])
def test_a_run_and_its_study_never_import_each_other(side, other):
    direct: dict[str, set[str]] = {}
    for path in FILES:
        direct.setdefault(module_of(path), set()).update(imported(TREES[path]))
    for start in side & direct.keys():
        reached, pending = set(), [start]
        while pending:
            name = pending.pop()
            if name not in reached:
                reached.add(name)
                pending += direct[name]
        assert not reached & other, f"{start} reaches {sorted(reached & other)}"


@EACH_FILE
def test_no_function_imports_our_own_modules(path):
    for function in ast.walk(TREES[path]):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            inside = [n for n in ast.walk(function) if isinstance(n, ast.Import | ast.ImportFrom)]
            assert not any(imported(node) for node in inside), f"line {function.lineno}"


@EACH_FILE
def test_nothing_that_runs_text_is_called(path):
    calls = {
        (called(node), node.lineno)
        for node in ast.walk(TREES[path])
        if isinstance(node, ast.Call)
        # re.compile makes a pattern, no code
        and not (isinstance(node.func, ast.Attribute) and ast.unparse(node.func) == "re.compile")
    }
    assert not [f"{name}, line {line}" for name, line in calls if name in FORBIDDEN_CALLS]


@EACH_FILE
def test_a_module_is_short_and_named_after_a_noun(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 500
    assert not {"utils", "util", "helpers", "misc"} & set(path.relative_to(ROOT).with_suffix("").parts)


# Packages that come with those that we declare, which choose their versions.
BROUGHT = {"pydantic-core": "pydantic", "llvmlite": "numba"}


def test_packages_that_are_imported_are_declared_and_have_a_version():
    def normal(name: str) -> str:
        return re.sub("[-_.]+", "-", re.split("[^A-Za-z0-9._-]", name)[0]).lower()

    project = tomllib.loads((ROOT.parent / "pyproject.toml").read_text())["project"]
    needed = {normal(line) for line in project["dependencies"]}
    optional = {normal(line) for lines in project["optional-dependencies"].values() for line in lines}
    lines = (ROOT.parent / "constraints.txt").read_text().splitlines()
    roots = {name.partition(".")[0] for tree in TREES.values() for name in named(tree)}
    known = packages_distributions()
    imports = {normal(known[root][0]) for root in roots - sys.stdlib_module_names - {"masking"} if root in known}
    assert needed <= imports <= needed | optional | BROUGHT.keys()
    assert needed | BROUGHT.keys() <= {normal(line) for line in lines if not line.startswith("#")}
