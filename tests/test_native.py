"""Machine code on disk: found by other processes, loaded without numba, never mistaken for another's."""

import os
import subprocess
import sys

import numpy as np
import pytest

import masking

RUN = """
import sys, numpy as np
from masking.declaration.schema import ModelDeclaration
from masking.modelling.model import Model
t = np.linspace(0.0, 1.0, 5)
for text in sys.argv[1:]:
    w = [float(x) for x in text.split(",")]
    coordinates = {f"x{i}": {"initial": 1.0} for i in range(len(w))}
    equations = {f"x{i}''": f"-{x}*x{i}" for i, x in enumerate(w)}
    model = Model(ModelDeclaration.model_validate({"name": "m", "coordinates": coordinates, "equations": equations}))
    found = model.simulate(t, tolerance=1e-12)
    np.testing.assert_allclose(found.positions, np.cos(np.outer(t, np.sqrt(w))), rtol=0, atol=1e-10)
print("numba.core" in sys.modules)
"""


def test_modules_compiled_by_different_processes_run_side_by_side(tmp_path):
    """Numba counts functions anew in each process, so that two processes give different functions one name."""
    environment = {**os.environ, "MASKING_CACHE": str(tmp_path)}
    for systems, loads_numba in ((["1"], True), (["4,9"], True), (["1", "4,9"], False)):
        command = [sys.executable, "-c", RUN, *systems]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert done.stdout.strip() == str(loads_numba)


@pytest.mark.parametrize(
    ("q", "said"),
    [
        (np.zeros(3, dtype=np.float32), "q must be a C-contiguous float64 array of dimension 1, not float32"),
        (np.zeros(6)[::2], "q must be a C-contiguous float64 array of dimension 1"),
        (np.zeros((3, 1)), r"not float64 of shape \(3, 1\)"),
        ([0.0, 0.0, 0.0], "q must be an array, not list"),
    ],
)
def test_only_arrays_that_machine_code_can_read_are_passed(q, said):
    kernels = masking.load_model("duffing").kernels
    with pytest.raises(TypeError, match=said):
        kernels.accelerations(0.0, q, np.zeros(3), np.zeros(0), np.zeros(8), np.zeros(3))


def test_a_wrong_number_of_arguments_is_refused():
    with pytest.raises(TypeError, match="accelerations takes t, q, v, u, p, out: got 2 arguments"):
        masking.load_model("duffing").kernels.accelerations(0.0, np.zeros(3))


def test_an_unknown_function_is_refused_with_the_nearest_name():
    with pytest.raises(AttributeError, match="did you mean 'accelerations'"):
        _ = masking.load_model("duffing").kernels.acceleration
