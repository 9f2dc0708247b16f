"""Every experiment and every script in examples/ does what it says."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from masking.lab.runs.experiment import Experiment
from masking.model.declaration import catalogue, registry

EXAMPLES = Path(__file__).parents[2] / "examples"
SCRIPTS = sorted((EXAMPLES / "scripts").glob("*.py"))
SHORT = 30.0  # longer than the slowest period of any of them
# What another of the gate shows as well: one controller or one start more, or the ideal rig of one that is imperfect.
LIKE_OTHERS = {
    "bouc_wen", "bouncing_ball", "cart_alone", "cart_felt_observer", "cart_reference", "delayed_oscillators",
    "discs_enoc", "duffing_enoc", "duffing_sampled", "escapements", "pendula_wide", "setup_undamped",
}  # fmt: skip
STUDIES = {"09_silverbox", "10_discover_and_refine", "12_stability"}  # of half a minute each


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=name, marks=pytest.mark.search if name in LIKE_OTHERS else ())
        for name, path in catalogue.files("experiment").items()
    ],
)
def test_experiment_runs(path):
    declaration = registry.load_experiment(path)
    short = declaration.model_copy(update={"duration": min(SHORT, declaration.duration)})
    run = Experiment(registry.assemble(short)).run()
    assert all(np.isfinite(column).all() for column in run.columns.values())
    bar = 1e-6 if declaration.controller.rate is None else 0.2
    assert max(run.manifest["masking_error"].values()) <= bar


def test_each_experiment_is_found_by_its_name():
    assert set(catalogue.names("experiment")) == {
        path.stem for path in EXAMPLES.glob("*/*.yaml") if path.parent.name not in ("batches", "many", "measured")
    }


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, id=path.stem, marks=pytest.mark.search if path.stem in STUDIES else ()) for path in SCRIPTS],
)
def test_script_runs(path):
    runpy.run_path(str(path), run_name="__main__")


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_script_ends_in_an_assertion(path):
    assert path.read_text().rstrip().splitlines()[-1].startswith("assert ")
