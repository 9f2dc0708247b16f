"""Machine code on disk: found by other processes, loaded without numba, never mistaken for another's."""

import os
import subprocess
import sys
import time
from functools import cache

import numpy as np
import pytest

import masking
from masking.codegen import native, store
from masking.codegen.files import read_sealed, write_sealed
from masking.codegen.graph import Graph
from masking.codegen.source import DECORATOR, Module

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


def number(value):
    """Return a module with one function that returns a number."""
    module = Module("test", {})
    module.add_text("f(t: float) -> float", f"{DECORATOR}\ndef f(t):\n    return {value}")
    return module


CHANGES = {
    "cut off": lambda code, other: code[:-1],
    "empty": lambda code, other: b"",
    "one bit": lambda code, other: code[:99] + bytes([code[99] ^ 1]) + code[100:],
    "one bit of the checksum": lambda code, other: bytes([code[0] ^ 1]) + code[1:],
    "another function": lambda code, other: other,
    "no machine code": lambda code, other: b"text",
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_file_that_does_not_hold_what_its_name_says_is_made_anew(tmp_path, monkeypatch, change):
    monkeypatch.setenv("MASKING_CACHE", str(tmp_path))
    monkeypatch.setattr(native, "_libraries", {})
    monkeypatch.setattr(native, "_linker", cache(native._linker.__wrapped__))
    paths = {}
    for value in (1.5, 2.5):
        made = store.load(f"{value}", lambda value=value: number(value))
        assert made.function("f")(0.0) == value
        (paths[value],) = tmp_path.glob(f"objects/{made.objects['f']}.*.o")
    whole = paths[1.5].read_bytes()
    paths[1.5].write_bytes(change(whole, paths[2.5].read_bytes()))
    native._libraries.clear()
    native._linker.cache_clear()
    assert store.load("1.5", lambda: number(1.5)).function("f")(0.0) == 1.5
    assert read_sealed(paths[1.5]) is not None
    for folder in ("modules", "texts"):
        for file in (tmp_path / folder).iterdir():
            file.write_bytes(change(file.read_bytes(), b"print()"))
    assert not store.exists("1.5")
    assert store.load("1.5", lambda: number(1.5)).function("f")(0.0) == 1.5
    assert store.exists("1.5")


def test_equal_functions_of_different_modules_are_compiled_once(tmp_path, monkeypatch):
    monkeypatch.setenv("MASKING_CACHE", str(tmp_path))
    for key in ("a", "b"):
        module = number(3.5)
        module.add_text(f"{key}(t: float) -> float", f"{DECORATOR}\ndef {key}(t):\n    return t")
        assert store.load(key, lambda module=module: module).function("f")(0.0) == 3.5
    assert len(list(tmp_path.glob("texts/*"))) == 2
    assert len(list(tmp_path.glob("objects/*"))) == 1


def test_an_argument_of_a_kernel_says_its_type():
    module = Module("test", {})
    with pytest.raises(TypeError, match="f: t is of the type 'str'; give float, int, Vector, Matrix"):
        module.add("f(t: str)", Graph(), [], {})


def test_linked_functions_are_compiled_apart_from_those_that_call_them(tmp_path, monkeypatch):
    monkeypatch.setenv("MASKING_CACHE", str(tmp_path))

    def caller():
        module = Module("caller", {})
        module.add_link("law(kind: int, x, rows: Matrix)")
        text = f"{DECORATOR}\ndef f(kind, x, rows):\n    law(kind, x[1:], rows[1:])"
        module.add_text("f(kind: int, x, rows: Matrix)", text)
        return module

    def law(sign):
        module = Module("law", {})
        text = f"{DECORATOR}\ndef law(kind, x, rows):\n    rows[0, kind] = {sign}x[0] * x.size + rows.shape[0]"
        module.add_text("law(kind: int, x, rows: Matrix)", text)
        return module

    for sign, expected in (("+", 17.0), ("-", -13.0)):
        own = store.load(f"law{sign}", lambda sign=sign: law(sign)).function("law")
        rows = np.zeros((3, 4))
        store.load("caller", caller, {"law": own}).function("f")(2, np.array([7.0, 5.0, 6.0, 1.0]), rows)
        assert rows[1, 2] == expected
        assert np.count_nonzero(rows) == 1
    assert len(list(tmp_path.glob("objects/*"))) == 3  # two laws, and one function that calls either


def test_machine_code_that_is_not_used_for_long_is_removed(tmp_path, monkeypatch):
    monkeypatch.setenv("MASKING_CACHE", str(tmp_path))
    for name, days in (("old", 61), ("new", 59)):
        write_sealed(tmp_path / "objects" / name, b"")
        os.utime(tmp_path / "objects" / name, (time.time() - 86400 * days,) * 2)
    store.load("a", lambda: number(1.0))
    assert [file.name for file in (tmp_path / "objects").iterdir()] == ["new"]
