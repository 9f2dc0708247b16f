"""Formats: records of other programs, and parts of records; values are closed forms of their times."""

import json
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import io

from masking.app import cli
from masking.app.workflows import discovery_inputs
from masking.errors import ModelError, RecordError
from masking.inference.estimation.identification_data import Data
from masking.lab.records import readers
from masking.lab.records.record_form import RecordForm
from masking.lab.records.recording import Recording
from masking.lab.records.time_slice import Part

# Version 7.3, as MATLAB marks it in the 512 bytes before an HDF5 file.
HEADER = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
T = np.arange(1000) / 100.0
CLOCK = st.integers(1, 1000)


def hdf5(path, content, matlab=False):
    """Write datasets by their paths."""
    with h5py.File(path, "w", userblock_size=512 if matlab else 0) as file:
        for name, values in content.items():
            file[name] = values
    if matlab:
        with path.open("r+b") as stream:
            stream.write(HEADER)
    return path


def refusal(path, *args, **settings):
    with pytest.raises(RecordError) as refused:
        readers.read(path, *args, **settings)
    return str(refused.value)


def test_names_of_columns_are_refused_or_shown(tmp_path):
    path = tmp_path / "a\x1b.csv"
    path.write_text("t,u\x1b[31m,y\n0,1,2\n1,2,3\n")
    assert "line 1, character 4 is U+001B, which no text holds" in refusal(path)
    path = hdf5(tmp_path / "a\x07.h5", {"t": T, "u\x1b[31m": T})
    made = readers.read(path, {"u": "u<U+001B>[31m"})
    assert (made.name, {*made.columns}) == ("a<U+0007>", {"t", "u"})
    path.with_suffix(".json").write_text(json.dumps({"t": [0, 1], "u\x07": [1, 2], "u<U+0007>": [3, 4]}))
    assert "column 'u<U+0007>' appears more than once" in refusal(path.with_suffix(".json"))


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Write two runs of different lengths, a clock of each, and what is no vector of numbers."""
    content = {
        "noise/time": T,
        "noise/u": np.sin(T)[None],
        "noise/y": np.cos(T)[:, None].astype(">f4"),
        "arrow/u": np.arange(300),
        "arrow/y": np.arange(300, dtype=np.uint8),
        "gain": 3.0,
        "table": np.zeros((3, 300)),
        "words": ["a", "b"],
        "complex": np.ones(1000) * 1j,
        "nothing": h5py.Empty("f"),
    }
    return hdf5(tmp_path_factory.mktemp("runs") / "runs.h5", content)


@pytest.fixture(scope="module")
def times(tmp_path_factory):
    """Write a table whose values are its times, on a clock that begins at 5 s."""
    path = tmp_path_factory.mktemp("times") / "times.csv"
    lines = [f"{5 + i / 100:.2f},{5 + i / 100:.2f}" for i in range(1000)]
    path.write_text("t,x\n" + "\n".join(lines))
    return path


# HDF5


@pytest.mark.parametrize("name", ["a.h5", "a.hdf5", "a.HDF5"])
def test_groups_are_named_by_their_paths(runs, tmp_path, name):
    path = tmp_path / name
    path.write_bytes(runs.read_bytes())
    made = readers.read(path, {"t": "noise/time", "u": "noise/u", "y": "noise/y"}, needed=("u", "y"))
    assert set(made.columns) == {"t", "u", "y"}
    np.testing.assert_array_equal(made["u"], np.sin(T))
    np.testing.assert_array_equal(made["y"], np.cos(T).astype(np.float32))
    assert readers.digest(path) == readers.digest(runs)


def test_columns_of_other_lengths_are_left_out(runs):
    made = readers.read(runs, {"u": "arrow/u"}, 0.1, needed=("u",))
    assert set(made.columns) == {"t", "u", "arrow/y", "table/1", "table/2", "table/3"}
    np.testing.assert_array_equal(made["u"], np.arange(300.0))
    np.testing.assert_allclose(made.t, np.arange(300) / 10.0)
    longest = readers.read(runs, dt=0.1)
    assert set(longest.columns) == {"t", "noise/time", "noise/u", "noise/y"}


def test_columns_that_are_needed_have_one_length(runs):
    assert refusal(runs, {"u": "noise/u", "y": "arrow/y"}, 0.1, ("u", "y")) == (
        f"{runs}: columns of different lengths: u (noise/u) has 1000, y (arrow/y) has 300 samples; give those of one "
        "run, with --map"
    )
    assert "t (noise/time) has 1000, u (arrow/u) has 300" in refusal(runs, {"t": "noise/time", "u": "arrow/u"})


def test_names_in_groups_are_told(runs):
    assert "no column noise/v; did you mean 'noise/" in refusal(runs, {"u": "noise/v"})
    assert "name the clock, such as --map t=noise/time" in refusal(runs, {"u": "noise/u", "y": "noise/y"})


def test_a_clock_of_another_length_is_not_needed_beside_dt(tmp_path):
    path = hdf5(tmp_path / "a.h5", {"t": np.arange(7.0), "u": np.arange(9.0)})
    assert len(readers.read(path, dt=0.5, needed=("u",))) == 9
    assert "t has 7, u has 9" in refusal(path, needed=("u",))


def test_matlab_7_3_is_hdf5(tmp_path):
    path = hdf5(tmp_path / "a.mat", {"V1": np.sin(T)[None], "run/V2": np.cos(T)[:, None], "#refs#/a": T}, matlab=True)
    with h5py.File(path, "r+") as file:
        file["on"] = np.ones((1, 1000), np.uint8)
        file["text"] = np.full((1000, 1), 65, np.uint16)
        file["none"] = np.array([0, 0], np.uint64)
        file["date"] = np.arange(1000, dtype=np.uint32)
        file["sparse/data"] = T
        file["sparse"].attrs["MATLAB_sparse"] = np.uint64(9)
        file["none"].attrs["MATLAB_empty"] = np.uint8(1)
        kinds = {
            "V1": "double",
            "run/V2": "double",
            "on": "logical",
            "text": "char",
            "none": "double",
            "date": "datetime",
        }
        for name, kind in kinds.items():
            file[name].attrs["MATLAB_class"] = np.bytes_(kind)
    assert path.read_bytes().startswith(b"MATLAB 7.3")
    made = readers.read(path, {"u": "V1", "y": "run/V2"}, 0.01, needed=("u", "y"))
    assert set(made.columns) == {"t", "u", "y", "on"}
    np.testing.assert_array_equal(made["y"], np.cos(T))


def test_hdf5_is_known_where_a_mat_file_has_no_mark_of_matlab(tmp_path):
    path = hdf5(tmp_path / "octave.mat", {"u/value": T})
    np.testing.assert_array_equal(readers.read(path, {"u": "u/value"}, 0.01)["u"], T)
    io.savemat(tmp_path / "old.mat", {"u": T})
    np.testing.assert_array_equal(readers.read(tmp_path / "old.mat", dt=0.01)["u"], T)


def test_files_that_hold_no_vectors_are_refused(runs, tmp_path):
    (tmp_path / "text.h5").write_text("t,u\n0,1\n")
    assert refusal(tmp_path / "text.h5").startswith(f"{tmp_path / 'text.h5'}: the HDF5 file cannot be read (")
    hdf5(tmp_path / "scalars.h5", {"a": 1.0, "b": np.zeros((2, 2))})
    assert refusal(tmp_path / "scalars.h5") == f"{tmp_path / 'scalars.h5'}: it holds no vectors of numbers"
    (tmp_path / "none.mat").write_bytes(HEADER.ljust(512, b"\0"))
    assert "the HDF5 file cannot be read" in refusal(tmp_path / "none.mat")
    assert "or a .parquet, .csv, .lvm, .mat, .h5, .npz, .json, .tdms, .mf4 or .mcap file" in refusal(
        tmp_path / "a.xlsx"
    )


def test_structures_cells_and_matrices_of_matlab_are_named_by_their_paths(tmp_path):
    cells = np.empty(2, object)
    cells[:] = [np.sin(T)[:, None], np.cos(T)[None]]
    held = {"run": {"time": T, "signals": {"values": T**2}}, "y": cells, "a": np.array([T, 2 * T, 3 * T]), "fs": 100.0}
    io.savemat(tmp_path / "nested.mat", held)
    names = {"t": "run/time", "x": "run/signals/values", "s": "y/1", "c": "y/2", "a3": "a/3"}
    made = readers.read(tmp_path / "nested.mat", names)
    for name, values in {"t": T, "x": T**2, "s": np.sin(T), "c": np.cos(T), "a3": 3 * T}.items():
        np.testing.assert_array_equal(made[name], values)


def test_parts_of_one_run_are_joined(tmp_path):
    first, second = np.empty(2, object), np.empty(2, object)
    first[:] = [np.array([T[:40], -T[:40]]), np.array([T[40:70], -T[40:70]])]
    second[:] = [np.array([T[70:90], -T[70:90]]), np.array([T[90:], -T[90:]])]
    io.savemat(tmp_path / "parts.mat", {"Y_id": first, "Y_vad": second, "Z": T[::2]})
    made = readers.read(tmp_path / "parts.mat", {"a": "Y_*/*/1", "b": "Y_*/*/2"}, 0.01)
    np.testing.assert_array_equal(made["a"], T)
    np.testing.assert_array_equal(made["b"], -T)
    assert len(readers.read(tmp_path / "parts.mat", {"a": "Y_id/*/1"}, 0.01)["a"]) == 70
    with pytest.raises(RecordError, match=r"there is no column X/\*/1"):
        readers.read(tmp_path / "parts.mat", {"a": "X/*/1"}, 0.01)


def _tdms(path):
    nptdms = pytest.importorskip("nptdms", reason="nptdms is not installed")
    clock = {"wf_increment": 0.01, "wf_start_offset": 0.0}
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment([nptdms.ChannelObject("rig", "x", np.sin(T), clock), nptdms.ChannelObject("rig", "u", T)])


def _mf4(path):
    asammdf = pytest.importorskip("asammdf", reason="asammdf is not installed")
    with asammdf.MDF() as file:
        for name, values in (("x", np.sin(T)), ("slow", T[::10])):
            group = file.append([asammdf.Signal(values, T[: len(values)], name=name)])
            file.groups[group].channel_group.acq_name = "rig" if name == "x" else "other"
        file.append([asammdf.Signal(T, T, name="u")])
        file.save(path)


def _mcap(path):
    writers = pytest.importorskip("mcap.writer", reason="mcap is not installed")
    with path.open("wb") as stream:
        writer = writers.Writer(stream)
        writer.start()
        channel = writer.register_channel(topic="/rig", message_encoding="json", schema_id=0)
        for t in T:
            when = 10**12 + round(t * 1e9)
            writer.add_message(channel, when, json.dumps({"x": float(np.sin(t)), "at": {"u": t}}).encode(), when)
        writer.finish()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # asammdf's, of a file cut off
@pytest.mark.parametrize(("write", "u"), [(_tdms, "rig/u"), (_mf4, "3/u"), (_mcap, "rig/at/u")])
def test_files_of_data_loggers(tmp_path, write, u):
    file = tmp_path / f"run.{write.__name__[1:]}"
    write(file)
    found = readers.read(file, {"t": "rig/time", "x": "rig/x", "u": u}, needed=("x", "u"))
    np.testing.assert_allclose(found.columns["t"], T, atol=1e-9)
    np.testing.assert_allclose(found.columns["x"], np.sin(T), atol=1e-12)
    np.testing.assert_allclose(found.columns["u"], T, atol=1e-12)
    file.write_bytes(file.read_bytes()[:20])
    with pytest.raises(RecordError, match=str(file)):
        readers.read(file)


def test_a_package_that_is_not_installed_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "nptdms", None)
    (tmp_path / "run.tdms").write_bytes(b"TDSm")
    with pytest.raises(RecordError, match=r"read by the package nptdms: pip install 'masking\[loggers\]'"):
        readers.read(tmp_path / "run.tdms")


def test_numpy_and_json(tmp_path):
    np.savez(tmp_path / "a.npz", t=T, y=np.array([np.sin(T), np.cos(T)]).T, name="text")
    assert set(readers.read(tmp_path / "a.npz").columns) == {"t", "y/1", "y/2"}
    np.testing.assert_array_equal(readers.read(tmp_path / "a.npz", {"c": "y/2"})["c"], np.cos(T))
    (tmp_path / "lists.json").write_text(json.dumps({"t": [0, 0.1, 0.2], "u": [1, 2.5, 3], "who": "me", "n": 3}))
    np.testing.assert_array_equal(readers.read(tmp_path / "lists.json")["u"], [1.0, 2.5, 3.0])
    (tmp_path / "samples.json").write_text(json.dumps([{"t": i / 10, "u": i**2} for i in range(9)]))
    np.testing.assert_array_equal(readers.read(tmp_path / "samples.json")["u"], np.arange(9.0) ** 2)
    np.save(tmp_path / "one.npy", np.array([T, 2 * T]))
    (tmp_path / "one.npy").rename(tmp_path / "one.npz")
    assert set(readers.read(tmp_path / "one.npz", {"t": "1"}).columns) == {"t", "2"}
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04")
    assert "the numpy file cannot be read" in refusal(tmp_path / "bad.npz")
    (tmp_path / "bad.json").write_text("[1, 2")
    assert "the JSON file cannot be read" in refusal(tmp_path / "bad.json")
    (tmp_path / "texts.json").write_text('{"a": ["b", "c"]}')
    assert refusal(tmp_path / "texts.json").endswith("it holds no vectors of numbers")


def test_a_text_without_names_gets_them(tmp_path, capsys):
    path = tmp_path / "bare.txt"
    np.savetxt(path, np.column_stack([T, np.sin(T)]))
    made = readers.read(path, ("t", "u"))
    np.testing.assert_array_equal(made["u"], np.sin(T))
    assert len(made.t) == len(T)
    assert "name its 2 columns, such as --columns t,u1" in refusal(path)
    assert refusal(path, ("t", "u", "y")).endswith("2 columns have 3 names, t, u, y; name each")
    path.write_text("1;2,5\n2;x\n")
    assert "line 2 holds 'x' in column 'u'" in refusal(path, ("t", "u"), None, ("u",))
    path.write_text("time,u\n0,1\n1,2\n")
    assert "line 1 names its columns, such as time" in refusal(path, ("t", "u"))
    words = ["simulate", "setup", str(path), "--map", "t=time", "--columns", "t,u"]
    assert cli.main(words) == 2
    assert "--map renames columns and --columns names" in capsys.readouterr().err


def test_files_that_are_cut_off_or_damaged_are_refused(runs, tmp_path):
    """Cut anywhere, a file is refused; with other bytes, it is read or refused, and raises nothing else."""
    whole, path = runs.read_bytes(), tmp_path / "a.h5"
    for size in range(0, len(whole) - 1, len(whole) // 23):
        path.write_bytes(whole[:size])
        assert "the HDF5 file cannot be read" in refusal(path)
    random = np.random.default_rng(0)
    for _ in range(200):
        spoiled = bytearray(whole)
        for at in random.integers(0, 4096, 8):
            spoiled[at] = random.integers(256)
        path.write_bytes(bytes(spoiled))
        try:
            readers.read(path, dt=0.1)
        except RecordError as error:
            assert str(error).startswith(f"{path}: ")


def test_reading_a_table_loads_no_h5py(times):
    imports = "import sys; from masking.lab.records import readers"
    code = f"{imports}; readers.read({str(times)!r}); assert 'h5py' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[3])


# Parts


@pytest.mark.parametrize(
    ("part", "first", "last"),
    [
        (":", 5.0, 14.99),
        ("7:9", 7.0, 8.99),
        ("7:", 7.0, 14.99),
        (":9", 5.0, 8.99),
        ("5:15", 5.0, 14.99),
        ("7.005:7.025", 7.01, 7.02),
        (" 7 : 8e0 ", 7.0, 7.99),
        ("6.11:6.13", 6.11, 6.12),
    ],
)
def test_a_part_keeps_the_instants_of_the_file(times, part, first, last):
    made = readers.read(f"{times}@{part}")
    np.testing.assert_array_equal(made.t, made["x"])
    assert (made.t[0], made.t[-1]) == (first, last)
    assert len(made) == round((last - first) * 100) + 1


@given(first=CLOCK, second=CLOCK, scale=st.sampled_from([1e-3, 0.01, 0.1, 1.0 / 3.0, 1e7 / 2**14]))
def test_parts_side_by_side_share_no_sample(first, second, scale):
    """However instants round: by products, by sums and by decimals."""
    at = f"{first * scale:.12g}"
    for t in (np.arange(1001) * scale, np.cumsum(np.full(1001, scale)) - scale, np.arange(1001) / (1.0 / scale)):
        before = Part("", Path(), None, float(at)).samples(t)
        after = Part("", Path(), float(at)).samples(t)
        assert (before ^ after).all()
        assert before.sum() == first


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ("7", "'7' is no part of a record; give two times in s, such as "),
        ("a:b", "'a:b' is no part of a record"),
        ("7-9", "'7-9' is no part of a record"),
        ("7:8:9", "'7:8:9' is no part of a record"),
        ("nan:", "'nan:' is no part of a record"),
        (":inf", "':inf' is no part of a record"),
        ("", "'' is no part of a record"),
        ("9:7", "the part ends at 7 s, but starts at 9 s; let it end later"),
        ("9:9", "the part ends at 9 s, but starts at 9 s; let it end later"),
        ("1:9", "the record goes from 5 s to 14.99 s; name a part of it"),
        ("7:15.1", "the record goes from 5 s to 14.99 s; name a part of it"),
        ("20:30", "the record goes from 5 s to 14.99 s; name a part of it"),
        (":4", "the record goes from 5 s to 14.99 s; name a part of it"),
        (
            "7.001:7.009",
            "no sample lies in this part; the record goes from 5 s to 14.99 s, with 0.01 s between samples",
        ),
    ],
)
def test_what_is_no_part_is_refused(times, part, words):
    told = refusal(f"{times}@{part}")
    assert told.startswith(f"{times}@{part}: ")
    assert words in told


def test_a_path_that_is_there_is_taken_as_it_stands(times, tmp_path):
    (tmp_path / "a.csv").write_text("t,x\n0,0\n1,1\n")
    (tmp_path / "a.csv@0:1.csv").write_text(times.read_text())
    (tmp_path / "me@home").mkdir()
    assert len(readers.read(tmp_path / "a.csv@0:1.csv")) == 1000
    assert len(readers.read(f"{tmp_path / 'a.csv@0:1.csv'}@6:7")) == 100
    (tmp_path / "me@home" / "a.csv").write_text(times.read_text())
    assert len(readers.read(f"{tmp_path / 'me@home' / 'a.csv'}@6:")) == 900
    assert "no such record" in refusal(tmp_path / "me@home" / "b.csv")
    assert "b.csv@1:2: no such record" in refusal(tmp_path / "b.csv@1:2")


def test_a_part_has_the_digest_of_its_file(times):
    assert readers.digest(f"{times}@7:9") == readers.digest(times)


def test_a_part_of_a_recording(tmp_path):
    Recording({"t": T, "x": T}, {"name": "kept"}).save(tmp_path / "run")
    for path in (tmp_path / "run", tmp_path / "run" / "recording.parquet"):
        made = readers.read(f"{path}@2:3")
        assert made.manifest["name"] == "kept"
        np.testing.assert_array_equal(made["x"], T[200:300])
    assert readers.digest(f"{tmp_path / 'run'}@2:3") == readers.digest(tmp_path / "run")


def test_what_is_wrong_outside_of_a_part_does_not_matter(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,x\n" + "\n".join(f"{t},{'nan' if t < 3.0 else t}" for t in T))
    assert "line 2 holds 'nan' in column 'x' (t = 0 s), not a number, and 299 more lines so" in refusal(
        path, needed=("x",)
    )
    np.testing.assert_array_equal(readers.read(f"{path}@3:", needed=("x",))["x"], T[300:])


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("% of today\nt,f,x\n\n0,1,2\n1,2,OVL\n2,3,4\n",
         "line 5 holds 'OVL' in column 'x' (t = 1 s), not a number; put numbers there, or use a part without"),
        ("t;f;x\n0,0;1,5;2,5\n0,5;1,5;1,2 V\n", "line 3 holds '1,2 V' in column 'x' (t = 0.5 s), not a number"),
        ("t f x\n0 1 2\n# a remark\n1 n/a 3\n2 3 n/a\n",
         "line 4 holds 'n/a' in column 'f' (t = 1 s), not a number, and 1 more line so;"),
        ("t,f,x\n0,1,2\n1,,3\n", "line 3 holds nothing in column 'f' (t = 1 s), not a number"),
        ("t,f,x\n0,1,2\nend,2,3\n", "line 3 holds 'end' in column 't', not a number; take the line out"),
    ],
    ids=["overflow", "decimal commas", "blanks", "empty", "end"],
)  # fmt: skip
def test_a_text_among_numbers_is_told_with_its_line(tmp_path, lines, words):
    path = tmp_path / "a.csv"
    path.write_text(lines)
    assert f"{path}: {words}" in refusal(path, needed=("f", "x"))


def test_a_text_is_told_with_the_column_of_the_file(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time,disp,note\n0,1,ok\n1,high,ok\n")
    assert "line 3 holds 'high' in column 'disp' (t = 1 s)" in refusal(path, names={"t": "time", "x": "disp"})


def test_a_clock_is_made_before_a_part_is_taken(runs):
    made = readers.read(f"{runs}@10:20", {"u": "arrow/u"}, 0.1, needed=("u",))
    np.testing.assert_array_equal(made["u"], np.arange(100.0, 200.0))
    np.testing.assert_allclose(made.t, np.arange(100, 200) / 10.0)


# Between samples


@pytest.fixture(scope="module")
def mass(tmp_path_factory):
    path = tmp_path_factory.mktemp("mass") / "mass.yaml"
    path.write_text(
        "name: mass\ncoordinates: {x: {unit: m}}\ninputs: {f: {unit: N}}\nparameters: {m: {value: 1, unit: kg}, "
        "k: {value: 100, unit: N/m}}\nequations: {\"x''\": (f - k*x)/m}\n"
    )
    return discovery_inputs.rig(path, None)


def test_smooth_inputs_become_straight_lines(mass):
    """Straight lines between samples of a sine carry sinc^2 of it; the ends of a record apart."""
    part = 0.1
    u = np.sin(2 * np.pi * part * 100 * T)
    made = Data.of(Recording({"t": T, "f": u, "x": u}), mass, hold="band-limited")
    assert (made.hold, made.late.tolist()) == ("first-order", [0.0])
    np.testing.assert_allclose(made.commands[3:-3, 0] * np.sinc(part) ** 2, u[3:-3], atol=1e-5)
    np.testing.assert_array_equal(made.readings[:, 0], u)


def test_a_hold_that_there_is_not_is_refused(mass):
    words = "hold is 'cubic': give 'zero-order' for .*, 'first-order' for .*, or .* 'band-limited' for .* filter"
    with pytest.raises(ModelError, match=words):
        Data.of(Recording({"t": T, "f": T, "x": T}), mass, hold="cubic")
    with pytest.raises(ModelError, match="hold is 'smooth': give 'zero-order' for commands"):
        Data.of(Recording({"t": T, "f": T, "x": T}), mass, hold="smooth")


def test_parts_of_one_file_are_records_of_a_discovery(mass, tmp_path):
    columns = {"g/clock": T, "g/f": np.sin(9.0 * T), "g/x": np.cos(3.0 * T)}
    path = hdf5(tmp_path / "a.h5", columns)
    names = {"t": "g/clock", "f": "g/f", "x": "g/x"}
    made = discovery_inputs.read(mass, f"{path}@:6", f"{path}@6:", RecordForm(hold="band-limited", columns=names))
    np.testing.assert_array_equal(made.record.readings[:, 0], np.cos(3.0 * T[:600]))
    np.testing.assert_array_equal(made.validation.readings[:, 0], np.cos(3.0 * T[600:]))
    digest = readers.digest(path)
    assert made.origin.records == {"record": (f"{path}@:6", digest), "validation": (f"{path}@6:", digest)}
    with pytest.raises(RecordError, match=r"a\.h5@:2: 200 samples are too few"):
        discovery_inputs.read(mass, f"{path}@:2", None, RecordForm(columns=names))


@pytest.mark.parametrize(
    ("unit", "second"), [("ms", 1e3), ("us", 1e6), ("µs", 1e6), ("ns", 1e9), ("min", 1.0 / 60.0), ("h", 1.0 / 3600.0)]
)
def test_the_unit_of_a_clock_stands_in_the_map_or_in_its_name(unit, second, tmp_path):
    def written(heading):
        rows = [f"{t * second!r},{x!r}" for t, x in zip(T.tolist(), np.sin(T).tolist(), strict=True)]
        (tmp_path / "r.csv").write_text("\n".join([f"{heading},x", *rows]) + "\n", encoding="utf-8")
        return tmp_path / "r.csv"

    read = [
        readers.read(written("time"), {"t": f"time:{unit}"}),
        readers.read(written("t"), {"t": f"t:{unit}"}),
        readers.read(written(f"t [{unit}]")),
        readers.read(written(f"time ({unit})"), {"t": f"time ({unit})"}),
        readers.read(f"{written(f't [{unit}]')}@2.005:5.005"),
    ]
    for found in read[:4]:
        assert found.t == pytest.approx(T, abs=1e-12)
    assert read[4].t == pytest.approx(T[201:501], abs=1e-12)


def test_a_unit_of_a_clock_that_is_none_is_refused_and_a_colon_in_a_name_is_none(tmp_path):
    (tmp_path / "r.csv").write_text("a:ms,x\n" + "\n".join(f"{t!r},0.5" for t in T.tolist()) + "\n")
    assert "the clock is given in 'mm'; give one of s, ms" in refusal(tmp_path / "r.csv", {"t": "a:mm"})
    assert readers.read(tmp_path / "r.csv", {"t": "a:ms"}).t == pytest.approx(T)
