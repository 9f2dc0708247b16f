"""Machine code on disk: found by other processes, loaded without numba, never mistaken for another's."""

from __future__ import annotations

import errno
import os
import py_compile
import stat
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import masking
from masking.compile.codegen import machine_code, module_store, trusted_files
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.graph import Graph
from masking.compile.codegen.trusted_files import read_sealed, write_sealed
from masking.compile.numerics.arrays import Matrix, Vector
from masking.compile.numerics.compilation import compiled

RUN = """
import sys, numpy as np
from masking.model.declaration.schema import ModelDeclaration
from masking.model.modelling.model import Model
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
    module, graph = Module("test", {}), Graph()
    module.add("f(t: float)", graph, [], {}, returns=graph.number(value))
    return module


def constant(value):
    @compiled
    def f(t: float) -> float:
        return value

    return f


def kernel_of(value):
    """Return a module with one kernel that returns a number."""
    module = Module("test", {})
    module.add_factory("f", constant, value)
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
    monkeypatch.setattr(machine_code, "_libraries", {})
    monkeypatch.setattr(machine_code, "_linker", cache(machine_code._linker.__wrapped__))
    paths = {}
    for value in (1.5, 2.5):
        made = module_store.load(f"{value}", lambda value=value: number(value))
        assert made.function("f")(0.0) == value
        (paths[value],) = tmp_path.glob(f"objects/{made.objects['f']}.*.o")
    whole = paths[1.5].read_bytes()
    paths[1.5].write_bytes(change(whole, paths[2.5].read_bytes()))
    machine_code._libraries.clear()
    machine_code._linker.cache_clear()
    assert module_store.load("1.5", lambda: number(1.5)).function("f")(0.0) == 1.5
    assert read_sealed(paths[1.5]) is not None
    for folder in ("modules", "texts"):
        for file in (tmp_path / folder).iterdir():
            file.write_bytes(change(file.read_bytes(), b"print()"))
    assert not module_store.exists("1.5")
    assert module_store.load("1.5", lambda: number(1.5)).function("f")(0.0) == 1.5
    assert module_store.exists("1.5")


CHILD = """
import json, sys
from masking.compile.codegen import module_store
from masking.compile.codegen.graph import Graph
from masking.compile.codegen.generated_module import Module

def number():
    module, graph = Module("test", {}), Graph()
    angle = graph.apply("atan", graph.symbol("t", varying=True))  # a function of the library, which is linked
    module.add("f(t: float)", graph, [], {}, returns=graph.add(graph.number(1.5), angle))
    return module

made = module_store.load("1.5", number)
assert made.function("f")(0.0) == 1.5
"""


def process(cache, **more):
    """Run a process that calls a kept function; return what it said."""
    environment = {**os.environ, "MASKING_CACHE": str(cache), **more}
    done = subprocess.run([sys.executable, "-c", CHILD], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stderr.splitlines()


@pytest.fixture
def child(tmp_path, monkeypatch, capfd):
    """Return a function that does the same in this process as if it were new, and gives what was said."""
    monkeypatch.setattr(machine_code, "_libraries", {})
    monkeypatch.setattr(machine_code, "_linker", cache(machine_code._linker.__wrapped__))
    monkeypatch.setattr(trusted_files, "_told", set())

    def call(place):
        monkeypatch.setenv("MASKING_CACHE", str(place))
        monkeypatch.setattr(trusted_files, "_private", cache(trusted_files._private.__wrapped__))
        machine_code._libraries.clear()
        machine_code._linker.cache_clear()
        trusted_files._told.clear()
        for name in [name for name in sys.modules if name.startswith("masking_generated_")]:
            monkeypatch.delitem(sys.modules, name)
        capfd.readouterr()
        exec(CHILD, {})  # noqa: S102  (the text of a process)
        return capfd.readouterr().err.splitlines()

    return call


def own(file):
    """Return whether a file is regular, of mode 0600, and sealed."""
    return not file.is_symlink() and stat.S_IMODE(file.stat().st_mode) == 0o600 and read_sealed(file) is not None


def linked(file):
    file.rename(file.with_name("elsewhere"))
    file.symlink_to(file.with_name("elsewhere"))


def pipe(file):
    file.unlink()
    os.mkfifo(file)


SPOILS = {
    "cut off": (lambda file: os.truncate(file, 40), "is damaged or another file; it is made anew"),
    "writable by others": (lambda file: file.chmod(0o622), "other users may write it; it is made anew"),
    "a link": (linked, "is not executed: it is a symbolic link; it is made anew"),
    "a pipe": (pipe, "is not executed: it is no file of this program; it is made anew"),
    "large": (lambda file: os.truncate(file, 2**40), "is not executed: it is no file of this program"),
}


@pytest.mark.parametrize(("spoil", "words"), SPOILS.values(), ids=SPOILS)
def test_machine_code_and_text_that_may_not_be_trusted_are_made_anew(tmp_path, child, spoil, words):
    child(tmp_path)
    for folder in ("modules", "texts", "objects"):
        (file,) = (tmp_path / folder).iterdir()
        assert own(file)
        spoil(file)
        (said,) = child(tmp_path)
        assert said.startswith(f"masking: {file} ")
        assert words in said
        assert own(file)
        assert not child(tmp_path)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_files_of_another_user_are_not_executed(tmp_path, child):
    child(tmp_path)
    for folder in ("modules", "texts", "objects"):
        (file,) = (tmp_path / folder).iterdir()
        os.chown(file, 1234, 1234)
        (said,) = child(tmp_path)
        assert said == f"masking: {file} is not executed: it belongs to another user; it is made anew"
        assert file.stat().st_uid == 0
    os.chown(tmp_path / "objects", 1234, 1234)
    said = child(tmp_path)
    assert "its folder belongs to another user; it is made anew" in said[0]
    assert "(the folder belongs to another user): they are kept in" in said[1]


def test_a_folder_that_others_may_write_into_is_closed_to_them(tmp_path, child):
    child(tmp_path)
    (tmp_path / "objects").chmod(0o777)
    (said,) = child(tmp_path)
    assert "is not executed: other users may write into its folder; it is made anew" in said
    assert stat.S_IMODE((tmp_path / "objects").stat().st_mode) == 0o755
    assert not child(tmp_path)


def test_compiled_python_beside_a_text_is_not_executed(tmp_path, monkeypatch):
    monkeypatch.setenv("MASKING_CACHE", str(tmp_path))
    made = module_store.load("4.75", lambda: kernel_of(4.75))
    for text in [*(tmp_path / "texts").iterdir()]:
        python = text.with_suffix(".py")
        python.write_text("raise SystemExit(1)")
        py_compile.compile(str(python))
    assert made.function("f")(0.0) == 4.75


def test_where_files_cannot_be_written_they_go_to_a_private_folder(tmp_path, child):
    (tmp_path / "file").write_text("")
    (tmp_path / "here").mkdir()
    places = tmp_path / "file", tmp_path / "file" / "below", Path("/proc/nowhere"), Path("/dev/full")
    for place in places:
        (said,) = child(place)
        assert said.startswith(f"masking: generated files cannot be kept in {place} (")
        assert said.endswith(" until this process ends")
        assert [*trusted_files._private().rglob("*.o")]
    assert process(places[0], TMPDIR=str(tmp_path / "here"))
    assert not [*(tmp_path / "here").iterdir()]


def test_without_any_place_machine_code_is_made_anew(tmp_path, monkeypatch, capsys):
    """A full disk, as files of which nothing can be written."""

    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setenv("MASKING_CACHE", str(tmp_path))
    monkeypatch.setattr(os, "fsync", full)
    monkeypatch.setattr(trusted_files, "_told", set())
    for _ in range(2):
        assert module_store.load("2.25", lambda: number(2.25)).function("f")(0.0) == 2.25
    said = capsys.readouterr().err.splitlines()
    assert said == [
        f"masking: generated files cannot be kept in {tmp_path} (No space left on device): "
        "they are made anew in each process"
    ]
    assert not [file for file in tmp_path.rglob("*") if file.is_file()]


@pytest.mark.parametrize(
    "code", [lambda code: code[:18] + b"\xff" + code[19:], lambda code: b"text", lambda code: code[:-99]]
)
def test_machine_code_of_another_processor_is_made_anew(tmp_path, child, code):
    """Sealed as ours, but not for this processor, no machine code, or cut off before it was sealed."""
    child(tmp_path)
    (file,) = (tmp_path / "objects").iterdir()
    write_sealed(file, code(read_sealed(file)))
    (said,) = (line for line in process(tmp_path) if line.startswith("masking: "))  # the linker writes, too
    assert said.startswith(f"masking: {file} is no machine code of this processor (")
    assert not child(tmp_path)


def test_a_file_that_is_cut_at_any_length_or_changed_anywhere_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(trusted_files, "_told", set())
    path = tmp_path / "objects" / "name"
    write_sealed(path, content := bytes(range(256)) * 4)
    whole = path.read_bytes()
    assert read_sealed(path) == content
    random = np.random.default_rng(1)
    for size in range(len(whole)):
        os.truncate(path, 0)
        path.write_bytes(whole[:size])
        assert read_sealed(path) is None
        changed = bytearray(whole)
        changed[size] ^= 1 << int(random.integers(8))
        path.write_bytes(changed)
        assert read_sealed(path) is None


def test_equal_functions_of_different_modules_are_compiled_once(tmp_path, monkeypatch):
    monkeypatch.setenv("MASKING_CACHE", str(tmp_path))
    for key in ("a", "b"):
        module, graph = number(3.5), Graph()
        module.add(f"{key}(t: float)", graph, [], {}, returns=graph.symbol("t", varying=True))
        assert module_store.load(key, lambda module=module: module).function("f")(0.0) == 3.5
    assert len(list(tmp_path.glob("texts/*"))) == 2
    assert len(list(tmp_path.glob("objects/*"))) == 1


@pytest.mark.parametrize("is_whole", [True, False], ids=["whole", "not bitcode"])
def test_what_a_wheel_brings_is_not_compiled_by_numba(tmp_path, monkeypatch, is_whole):
    def function(cache):
        monkeypatch.setenv("MASKING_CACHE", str(tmp_path / cache))
        return module_store.load("7.5", lambda: kernel_of(7.5))

    made, brought = function("one"), tmp_path / "brought"
    brought.mkdir()
    file = brought / module_store.bitcode_name(made.kernels["f"]["content"])
    file.write_bytes(made.bitcode("f") if is_whole else b"text")
    monkeypatch.setattr(module_store, "BROUGHT", brought)
    compiled, compile_it = list[int](), machine_code.compiled_by_numba
    monkeypatch.setattr(machine_code, "compiled_by_numba", lambda *given: compiled.append(1) or compile_it(*given))
    assert function("two").function("f")(0.0) == 7.5
    assert len(compiled) == (not is_whole)


def test_an_argument_of_a_kernel_says_its_type():
    module = Module("test", {})
    with pytest.raises(TypeError, match="f: t is of the type 'str'; give float, int, Vector, Matrix"):
        module.add("f(t: str)", Graph(), [], {})


def test_linked_functions_are_compiled_apart_from_those_that_call_them(tmp_path, monkeypatch):
    monkeypatch.setenv("MASKING_CACHE", str(tmp_path))

    def calling(law):
        @compiled
        def f(kind: int, x: Vector, rows: Matrix) -> None:
            law(kind, x[1:], rows[1:])

        return f

    def writing(sign):
        @compiled
        def law(kind: int, x: Vector, rows: Matrix) -> None:
            rows[0, kind] = sign * x[0] * x.size + rows.shape[0]

        return law

    def caller():
        module = Module("caller", {})
        module.add_link("law(kind: int, x, rows: Matrix)")
        module.add_factory("f", calling, "law")
        return module

    def law(sign):
        module = Module("law", {})
        module.add_factory("law", writing, sign)
        return module

    for sign, expected in ((1.0, 17.0), (-1.0, -13.0)):
        own = module_store.load(f"law{sign}", lambda sign=sign: law(sign)).function("law")
        rows = np.zeros((3, 4))
        module_store.load("caller", caller, {"law": own}).function("f")(2, np.array([7.0, 5.0, 6.0, 1.0]), rows)
        assert rows[1, 2] == expected
        assert np.count_nonzero(rows) == 1
    assert len(list(tmp_path.glob("objects/*"))) == 3  # two laws, and one function that calls either


def test_one_of_several_graphs_is_computed_by_its_number(tmp_path, monkeypatch):
    monkeypatch.setenv("MASKING_CACHE", str(tmp_path))

    def build():
        module, cases = Module("choice", {}), []
        for operation in ("mul", "sub"):
            graph = Graph()
            x, y = (graph.symbol(name, varying=True) for name in ("a", "b"))
            results = [("out[1, 0]", graph.apply(operation, x, y))]
            cases.append((graph, results, {"a": "x", "b": "p[1]"}))
        module.add_choice("f(kind: int, x: float, p, out: Matrix)", ["out[0, 1]", "out[1, 0]"], cases)
        return module

    f = module_store.load("choice", build).function("f")
    for kind, expected in ((0, 21.0), (1, 4.0), (2, 0.0), (-1, 0.0)):
        out = np.full((2, 2), 9.0)
        f(kind, 7.0, np.array([5.0, 3.0]), out)
        np.testing.assert_array_equal(out, [[9.0, 0.0], [expected, 9.0]])


def test_machine_code_that_is_not_used_for_long_is_removed(tmp_path, monkeypatch):
    monkeypatch.setenv("MASKING_CACHE", str(tmp_path))
    for name, days in (("old", 61), ("new", 59)):
        write_sealed(tmp_path / "objects" / name, b"")
        os.utime(tmp_path / "objects" / name, (time.time() - 86400 * days,) * 2)
    module_store.load("a", lambda: number(1.0))
    assert [file.name for file in (tmp_path / "objects").iterdir()] == ["new"]
