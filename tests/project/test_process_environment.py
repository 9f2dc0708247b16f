"""The folder that the program is started in, full of modules named as those of Python: none of them is run."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
import yaml

from masking import process_environment
from masking.app.cli.main_program import VERBS
from masking.lab.records.child_process import Child
from masking.model.declaration import catalogue

ROOT = Path(process_environment.__file__).parents[1]
MARK = "open(__file__ + '.run', 'w').close()\n"
PYTHON = [sys.executable, "-m"]
STARTED = {
    "sweep": ["sweep", "cart.yaml", "--over", "mu=0.5,1", "--workers", "2", "--virtual"],
    "batch": ["rig", "batch", "plan.yaml"],
    "export": ["export", "cart.yaml", "--to", "fmu"],
}  # processes of others
OTHERS = [
    *([verb.name] for verb in VERBS if not verb.verbs and verb.name not in STARTED),
    *(["rig", part.name] for verb in VERBS if verb.name == "rig" for part in verb.verbs if part.name not in STARTED),
    ["measure", "springs"],  # those of other procedures load the same
]
LIMIT = 300.0  # s


def environment():
    return os.environ | {"PYTHONPATH": str(ROOT)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a module of each name in Python and in our packages, which leaves a mark if it is run.

    Python itself runs a few of them before the first line of any package that `python -m` names; these are not there.
    """
    made = tmp_path_factory.mktemp("hostile")
    (made / "own").mkdir()
    (made / "own" / "__init__.py").write_text("import sys; print(*sys.modules)")
    (made / "own" / "__main__.py").touch()
    done = subprocess.run([*PYTHON, "own"], cwd=made, env=environment(), capture_output=True, text=True, check=True)
    names = {*sys.stdlib_module_names, *packages_distributions(), "sitecustomize", "usercustomize"}
    for name in names - {"masking", *done.stdout.split()}:
        (made / f"{name}.py").write_text(MARK)
    declared = yaml.safe_load(catalogue.files("experiment")["cart_van_der_pol"].read_text())
    (made / "cart.yaml").write_text(yaml.safe_dump(declared | {"duration": 5}))
    (made / "plan.yaml").write_text("{name: two, experiment: cart.yaml, vary: {initial.x: [0.5, 0.6]}}")
    assert all((made / f"{name}.py").is_file() for name in ("random", "secrets", "numbers", "pickle", "numpy"))
    return made


def masking(folder, *arguments):
    return subprocess.run(
        [*PYTHON, "masking", *arguments], cwd=folder, env=environment(), capture_output=True, text=True,
        check=False, timeout=LIMIT,
    )  # fmt: skip


def run_from(folder):
    """Return the modules of the folder that were run."""
    return sorted(path.name.split(".")[0] for path in folder.glob("*.run"))


def test_no_verb_runs_a_module_of_the_current_folder(folder):
    with ThreadPoolExecutor(2) as threads:
        done = [*threads.map(lambda call: masking(folder, *call, "--help"), OTHERS)]
    assert [one.stderr for one in done if one.returncode] == []
    assert run_from(folder) == []


@pytest.mark.parametrize("verb", STARTED)
def test_no_process_that_a_verb_starts_does(folder, verb):
    done = masking(folder, *STARTED[verb])
    assert done.returncode == 0, done.stderr
    assert run_from(folder) == []


def test_no_process_of_a_run_on_a_served_rig_does(folder):
    serve = ["rig", "serve", "cart", "--lockstep", "--address", "udp://127.0.0.1:0", "--sessions", "1"]
    with subprocess.Popen(
        [*PYTHON, "masking", *serve], cwd=folder, env=environment(), stderr=subprocess.PIPE, text=True
    ) as server:
        address = server.stderr.readline().split()[-1]
        done = masking(folder, "rig", "run", "cart.yaml", "--plant", address, "--lockstep", "--page")
        server.kill()
    assert done.returncode == 0, done.stderr
    assert "operator's page: http" in done.stderr
    assert run_from(folder) == []


def test_a_child_finds_the_package_of_its_parent_in_the_current_folder(tmp_path):
    (tmp_path / "masking").symlink_to(ROOT / "masking")
    code = (
        "from masking.lab.records.child_process import Child\n"
        "print(Child('inspect', ['--details', 'masking']).output(60))"
    )
    given = {name: text for name, text in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=given, capture_output=True, text=True, check=True
    )
    (origin,) = (line.split()[1] for line in done.stdout.splitlines() if line.startswith("Origin"))
    assert Path(origin) == ROOT / "masking" / "__init__.py"


def test_a_child_has_the_variables_that_it_needs_and_no_relative_folder(monkeypatch):
    for name, value in {
        "PYTHONPATH": f"{os.pathsep}lib{os.pathsep}/opt/lib", "PATH": f":bin:{os.environ['PATH']}", "CPATH": "/opt",
        "LD_LIBRARY_PATH": ":lib", "LD_PRELOAD": "", "GIT_DIR": "/opt", "MASKING_OWN": "1", "LC_TIME": "C",
    }.items():  # fmt: skip
        monkeypatch.setenv(name, value)
    code = "import json, os; print(json.dumps(dict(os.environ)), flush=True); os._exit(0)"
    found = json.loads(Child("timeit", ["-n1", "-r1", code]).output(60.0))
    assert found["PATH"] == os.pathsep.join(part for part in os.environ["PATH"].split(os.pathsep) if part[:1] == "/")
    assert found["PYTHONPATH"] == os.pathsep.join([str(ROOT), "/opt/lib"])
    assert (found["MASKING_OWN"], found["LC_TIME"]) == ("1", "C")
    assert not {"CPATH", "LD_LIBRARY_PATH", "LD_PRELOAD", "GIT_DIR"} & found.keys()
