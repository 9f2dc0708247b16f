"""The shape of the package: who may import whom, and what no module may hold."""

import ast
import re
import sys
import tomllib
from collections import Counter
from graphlib import CycleError, TopologicalSorter
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2] / "masking"

# The wings, from the ground up, and the folders of each. A wing imports from those above it in this list, and all of
# them from `errors` and `display`.
WINGS: dict[str, tuple[str, ...]] = {
    "compile": ("numerics", "codegen"),
    "model": ("declaration", "effects", "modelling"),
    "analysis": (),
    "control": ("rig", "exports"),
    "lab": ("records", "signals", "plants", "runs"),
    "inference": ("estimation", "procedures", "discovery"),
    "reports": (),
    "app": ("workflows", "cli"),
}
SHARED = ("errors", "lazy_imports", "process_environment", "display")
# Open to all folders; a module that loads late counts as imported by who uses it.
OPEN = {"errors", "lazy_imports", "process_environment"}

# Each folder, from the ground up, and what it may import.
FLOORS: dict[str, set[str]] = {
    "errors": set(),
    "lazy_imports": set(),
    "process_environment": set(),
    "numerics": set(),
    "display": set(),
    "declaration": {"display"},
    "effects": {"declaration"},
    "codegen": {"numerics", "display"},
    "modelling": {"numerics", "declaration", "display", "effects", "codegen"},
    "records": {"numerics", "display"},
    "signals": {"numerics", "display", "records"},
    "analysis": {"numerics", "codegen", "display", "modelling"},
    "rig": {"numerics", "declaration", "effects", "codegen", "modelling"},
    "control": {"analysis", "numerics", "declaration", "display", "codegen", "modelling", "rig"},
    "plants": {"numerics", "display", "codegen", "records", "rig"},
    "exports": {"numerics", "display", "codegen", "declaration", "modelling", "rig", "control"},
    "runs": {
        *("numerics", "declaration", "display", "effects", "codegen", "modelling", "records", "analysis", "rig"),
        *("control", "plants", "signals"),
    },
    "estimation": {"numerics", "declaration", "display", "codegen", "records", "rig"},
    "discovery": {
        *("numerics", "declaration", "display", "effects", "codegen", "records", "signals", "rig", "estimation"),
    },
    "procedures": {"numerics", "declaration", "display", "modelling", "records", "analysis", "rig", "estimation"},
    "reports": {
        *("numerics", "declaration", "display", "effects", "modelling", "records", "analysis", "rig", "estimation"),
        *("discovery", "procedures"),
    },
    "workflows": {
        *(
            "numerics",
            "declaration",
            "display",
            "effects",
            "modelling",
            "records",
            "signals",
            "analysis",
            "rig",
            "control",
        ),
        *("plants", "exports", "runs", "estimation", "discovery", "procedures", "reports"),
    },
    "cli": {"display", "records", "rig", "plants", "runs", "reports", "workflows"},
}

# Packages from outside, and the folders that may import them; all others are free.
OUTSIDE: dict[str, set[str]] = {
    "control": {"modelling", "control", "analysis"},
    "h5py": {"records"},
    "jinja2": {"reports"},
    "llvmlite": {"codegen", "numerics"},
    "markupsafe": {"display", "modelling", "reports"},
    "matplotlib": {"display", "reports"},
    "PIL": {"reports"},
    "numba": {"numerics", "codegen"},
    "pint": {"declaration"},
    "platformdirs": {"codegen", "plants"},
    "pyarrow": {"records"},
    "pydantic": {"declaration", "records"},
    "sympy": {"declaration", "codegen", "modelling", "rig", "control", "analysis", "discovery", "workflows"},
    "tqdm": {"cli"},
    "uncertainties": {"declaration"},
    "yaml": {"declaration", "reports", "workflows"},
}

# A run and its study meet in the file on disk: only workflows and the command line know both. Mathematics on series,
# such as synchronisation, which knows neither, serves both.
ONLINE = {"control", "plants", "runs"}
OFFLINE = {"estimation", "discovery", "procedures", "reports"}

FORBIDDEN_CALLS = {"eval", "exec", "compile", "sympify", "parse_expr", "parse_latex", "lambdify", "__import__"}

FILES = sorted(ROOT.rglob("*.py"))
LATE = {
    alias.name: f"{node.module}.{alias.name}" if isinstance(node, ast.ImportFrom) else alias.name
    for node in ast.parse((ROOT / "lazy_imports.pyi").read_text(encoding="utf-8")).body
    if isinstance(node, ast.Import | ast.ImportFrom)
    for alias in node.names
}
MODULES = {".".join(p.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(".__init__") for p in FILES}


class Trees(dict[Path, ast.Module]):
    """The parsed text of each file, once it is asked for."""

    def __missing__(self, path: Path) -> ast.Module:
        self[path] = found = ast.parse(path.read_text(encoding="utf-8"))
        return found


TREES = Trees()


def folder_of(parts: tuple[str, ...] | list[str]) -> str:
    """Return the folder of the table that a module is in, or its wing where that has no folders."""
    return parts[1] if len(parts) > 1 and parts[1] in WINGS.get(parts[0], ()) else parts[0]


def module_of(path: Path) -> str:
    """Return the name that stands in the table: a module, or the folder that it is in."""
    return folder_of(path.relative_to(ROOT).with_suffix("").parts)


def folder_path(folder: str) -> Path:
    """Return where a folder of the table is."""
    wing = next((name for name, folders in WINGS.items() if folder in folders), None)
    return ROOT / folder if wing is None else ROOT / wing / folder


def wing_of(folder: str) -> str:
    """Return the wing of a folder; the folder itself where it is shared by all."""
    return next((wing for wing, folders in WINGS.items() if folder == wing or folder in folders), folder)


def imported(tree: ast.AST) -> set[str]:
    """Return the folders of ours that are imported anywhere in a tree, also by name through a lazy loader."""
    return {folder_of(name.split(".")[1:]) for name in named(tree) if name.startswith("masking.")}


def named(tree: ast.AST) -> set[str]:
    """Return all modules that are imported anywhere in a tree, with the packages they are in."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: imports are absolute"
            if node.module == "masking.lazy_imports":
                found |= {LATE[alias.name] for alias in node.names}
            elif (node.module or "").partition(".")[0] == "masking":
                found |= {n if (n := f"{node.module}.{alias.name}") in MODULES else node.module for alias in node.names}
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


def graph_within(folder: str) -> dict[str, set[str]]:
    """Return the modules of a folder, and which of the same folder each imports."""
    own = {name_of(path): TREES[path] for path in FILES if module_of(path) == folder}
    return {name: {n for n in named(tree) if n in own and n != name} for name, tree in own.items()}


def name_of(path: Path) -> str:
    """Return the dotted name of a module; a package's own is that of the package."""
    return ".".join(path.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(".__init__")


def test_the_table_lists_every_folder_once():
    wings = {wing for wing in WINGS if wing not in FLOORS}  # their own `__init__` only says what they are
    assert FLOORS.keys() | wings | {"__init__", "__main__"} == {module_of(path) for path in FILES}
    assert {path.parts[-2] for path in ROOT.glob("*/__init__.py")} == {*WINGS, "display"}
    assert {path.name for path in ROOT.glob("*.py")} == {f"{name}.py" for name in ("__init__", "__main__", *OPEN)}


def test_floors_stand_on_floors_below():
    below: set[str] = set()
    for folder, imports in FLOORS.items():
        assert imports <= below, f"{folder} stands on {sorted(imports - below)}, which stand above it"
        below.add(folder)


def test_wings_stand_on_wings_below():
    order = [*SHARED, *WINGS]
    for folder, imports in FLOORS.items():
        above = {name for name in imports if order.index(wing_of(name)) > order.index(wing_of(folder))}
        assert not above, f"{folder} imports {sorted(above)}, of wings above its own"


def test_no_two_files_have_one_name():
    names = Counter(path.name for path in FILES if path.name != "__init__.py")
    assert not [name for name, times in names.items() if times > 1]


@pytest.mark.parametrize("wing", WINGS)
def test_a_wing_says_what_comes_in_what_goes_out_and_what_it_imports(wing):
    used = {wing_of(name) for folder in (wing, *WINGS[wing]) for name in FLOORS.get(folder, ())} - {wing, *OPEN}
    if wing not in FLOORS:  # a wing with modules of its own says what a folder says
        assert said_imports(ROOT / wing) == (used or {"nothing"})


@pytest.mark.parametrize("folder", FLOORS)
def test_a_folder_imports_what_the_table_says_and_no_less(folder):
    found = set().union(*(imported(TREES[path]) for path in FILES if module_of(path) == folder))
    assert found - {folder, *OPEN} == FLOORS[folder]


@pytest.mark.parametrize("folder", [name for name in FLOORS if name not in OPEN])
def test_modules_of_a_folder_stand_in_an_order(folder):
    try:
        tuple(TopologicalSorter(graph_within(folder)).static_order())
    except CycleError as error:
        pytest.fail(f"{folder}: {' -> '.join(error.args[1])}")


def test_packages_from_outside_are_imported_where_the_table_says():
    assert not [
        f"{path.relative_to(ROOT)} may not import {root}"
        for path in FILES
        for root in {name.partition(".")[0] for name in named(TREES[path])} & OUTSIDE.keys()
        if module_of(path) not in OUTSIDE[root]
    ]


@pytest.mark.parametrize("folder", [name for name in FLOORS if name not in OPEN])
def test_a_folder_says_what_comes_in_what_goes_out_and_what_it_imports(folder):
    assert said_imports(folder_path(folder)) == (FLOORS[folder] or {"nothing"})


def said_imports(package: Path) -> set[str]:
    """Return what the docstring of a package says that it imports."""
    lines = str(ast.get_docstring(TREES[package / "__init__.py"]))
    return set(re.split(r",\s+", re.search(r"^In: .+\.\nOut: .+\.\nImports: ([^.]+)\.$", lines, re.MULTILINE)[1]))


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


def test_no_function_imports_our_own_modules():
    """The command line apart: a verb loads what it needs once it is asked for, so that the others start at once."""
    assert not [
        f"{path.relative_to(ROOT)}:{function.lineno}"
        for path in FILES
        if module_of(path) != "cli"
        for function in ast.walk(TREES[path])
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        if any(imported(n) for n in ast.walk(function) if isinstance(n, ast.Import | ast.ImportFrom))
    ]


def test_nothing_that_runs_text_is_called():
    """But for conditions of kernels: their text stands beside machine code in a module that is run in any case."""
    assert not [
        f"{path.relative_to(ROOT)}:{node.lineno}: {called(node)}"
        for path in FILES
        for node in ast.walk(TREES[path])
        if isinstance(node, ast.Call)
        and called(node) in FORBIDDEN_CALLS
        and path != ROOT / "compile/codegen/argument_conditions.py"
        # re.compile makes a pattern, no code
        and not (isinstance(node.func, ast.Attribute) and ast.unparse(node.func) == "re.compile")
    ]


def test_modules_are_short_and_named_after_nouns():
    long = [path for path in FILES if len(path.read_text(encoding="utf-8").splitlines()) > 500]
    vague = [p for p in FILES if {"utils", "util", "helpers", "misc"} & set(p.relative_to(ROOT).with_suffix("").parts)]
    assert not long + vague


# Packages that come with those that we declare, which choose their versions.
BROUGHT = {"pydantic-core": "pydantic", "llvmlite": "numba", "pillow": "matplotlib"}


def test_packages_that_are_imported_are_declared():
    def normal(name: str) -> str:
        return re.sub("[-_.]+", "-", re.split("[^A-Za-z0-9._-]", name)[0]).lower()

    project = tomllib.loads((ROOT.parent / "pyproject.toml").read_text())["project"]
    needed = {normal(line) for line in project["dependencies"]}
    optional = {normal(line) for lines in project["optional-dependencies"].values() for line in lines}
    roots = {name.partition(".")[0] for path in FILES for name in named(TREES[path])}
    known = packages_distributions()
    imports = {normal(known[root][0]) for root in roots - sys.stdlib_module_names - {"masking"} if root in known}
    assert needed <= imports <= needed | optional | BROUGHT.keys()
