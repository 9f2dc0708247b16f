"""Identical inputs give identical answers, however busy the machine is and in whatever order sets are."""

import json
import os
import subprocess
import sys

import pytest

from tests.inference.discovery.test_further_places import CASES, MODELS, record, tanh_of_maxwell

ROWS = 400  # of the record: short, and enough for a law without a name
BUSY = "while True: pass"


def numbers(content):
    """Return a discovery without the paths of its files."""
    files = {"model", "plant", "page"}
    kept = {key: value for key, value in content.items() if key not in files}
    return kept | {"records": {what: one["sha256"] for what, one in content["records"].items()}}


@pytest.fixture
def busy():
    """Keep each core busy with a process of its own."""
    made = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(os.cpu_count() or 1)]
    yield
    for one in made:
        one.kill()
        one.wait()


@pytest.fixture
def discovered(tmp_path):
    """Return the function that discovers the record in a process with its own order of sets."""
    (tmp_path / "model.yaml").write_text(MODELS[CASES[tanh_of_maxwell][0]])
    rows = record(tanh_of_maxwell, 1).splitlines()
    (tmp_path / "train.csv").write_text("\n".join(rows[: 1 + ROWS]) + "\n")

    def run(seed):
        out = tmp_path / f"found{seed}"
        asked = ["discover", tmp_path / "train.csv", "--model", tmp_path / "model.yaml", "--hold", "first-order"]
        environment = os.environ | {"PYTHONHASHSEED": str(seed)}
        subprocess.run([sys.executable, "-m", "masking", *asked, "--out", out], env=environment, check=True)
        return numbers(json.loads((out / "discovery.json").read_text()))

    return run


@pytest.mark.search
def test_two_discoveries_of_one_record_are_the_same_to_the_last_digit(discovered, request):
    first = discovered(1)
    request.getfixturevalue("busy")
    assert discovered(2) == first
