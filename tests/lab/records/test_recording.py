"""Recording, its file format, and the masking error."""

import json
import math
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from masking.analysis.masking_error import masking_error
from masking.display.json_text import json_text
from masking.errors import RecordError
from masking.lab.records.recording import FORMAT, Recording

T = np.array([0.0, 0.1, 0.2, 0.30000000000000004])


def sample() -> Recording:
    columns = {
        "t": T,
        "rig.x1": np.sin(T),
        "rig.x1'": np.cos(T),
        "virtual.x1": np.sin(T),
        "virtual.x1'": np.cos(T),
        "virtual.x2": T**2,
        "virtual.x2'": 2 * T,
        "input.u1": [0, 1, 2, 3],
        "input.u2": np.array([5e-324, -0.0, 1e308, -1e-300]),
    }
    return Recording(columns, {"name": "demo", "seed": 3, "declarations": {"virtual": {"name": "Größe θ"}}})


def test_comes_back_bit_for_bit_from_folder_and_from_file(tmp_path):
    recording = sample()
    folder = recording.save(tmp_path / "deep" / "run")
    assert sorted(p.name for p in folder.iterdir()) == ["manifest.json", "recording.parquet"]
    for path in (folder, str(folder), folder / "recording.parquet"):
        back = Recording.load(path)
        assert list(back.columns) == list(recording.columns)
        assert all(back[name].tobytes() == recording[name].tobytes() for name in recording.columns)
        assert back.manifest == {"format": FORMAT, **recording.manifest}
    assert json.loads((folder / "manifest.json").read_text("utf-8")) == back.manifest


def test_other_programs_read_the_table(tmp_path):
    table = pq.read_table(sample().save(tmp_path) / "recording.parquet")
    assert table.column("input.u1").to_pylist() == [0.0, 1.0, 2.0, 3.0]
    assert pq.ParquetFile(tmp_path / "recording.parquet").metadata.row_group(0).column(0).compression == "ZSTD"


def test_views_by_prefix():
    recording = sample()
    assert recording.coordinates == ("x1", "x2")
    assert recording.inputs == ("u1", "u2")
    assert recording.names("rig") == ("x1",)
    np.testing.assert_array_equal(recording.array("virtual"), np.column_stack([np.sin(T), T**2]))
    np.testing.assert_array_equal(recording.array("virtual", derivative=1), np.column_stack([np.cos(T), 2 * T]))
    assert recording.array("rig").shape == (4, 1)
    assert len(recording) == 4
    assert repr(recording) == "<Recording demo: 4 samples of 9 columns, t = 0 to 0.3>"


def test_is_read_only_and_can_be_pickled():
    recording = sample()
    with pytest.raises(ValueError, match="read-only"):
        recording["rig.x1"][0] = 1.0
    back = pickle.loads(pickle.dumps(recording))  # noqa: S301  # our own bytes
    np.testing.assert_array_equal(back["rig.x1"], recording["rig.x1"])


def test_the_callers_array_stays_writeable():
    own = np.arange(3.0)
    Recording({"t": own})
    own[0] = -1.0


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({}, "the recording has no column 't'; no name is allowed here"),
        ({"T": T}, "the recording has no column 't'; did you mean 'T'?"),
        ({"t": []}, "the recording has no samples"),
        ({"t": T, "rig.x": T[:3]}, "column 'rig.x' has 3 samples, 't' has 4"),
        ({"t": T, "rig.x": [0, np.nan, 1, np.nan]}, "column 'rig.x' is nan in row 1 (t = 0.1); 2 such rows in all"),
        ({"t": T, "rig.x": [0, 1, 2, -np.inf]}, "column 'rig.x' is -inf in row 3 (t = 0.3)"),
        ({"t": [0, np.nan, 1]}, "column 't' is nan in row 1"),
        ({"t": [0, 1, 1, 2]}, "column 't' must increase strictly: row 2 is 1 after 1"),
        ({"t": T[:, None]}, "column 't' has shape (4, 1); a column is 1-D"),
        ({"t": 1.0}, "column 't' has shape (); a column is 1-D"),
        ({"t": ["a", "b"]}, "column 't' does not hold real numbers (could not convert string to float: 'a')"),
        ({"": T}, "a column's name must be a text, not ''"),
    ],
)
def test_refuses_what_is_not_a_recording(columns, message):
    with pytest.raises(RecordError) as caught:
        Recording(columns)
    assert str(caught.value) == message


def test_a_missing_column_names_the_nearest():
    with pytest.raises(RecordError, match=r"no column 'virtual\.x3'; did you mean 'virtual\.x[12]'"):
        sample()["virtual.x3"]
    with pytest.raises(RecordError, match=r"no columns 'ideal\.\*'; allowed: rig, virtual, input"):
        sample().array("ideal")
    with pytest.raises(RecordError, match=r"no column 'input\.u1''; did you mean 'input\.u1'"):
        sample().array("input", derivative=1)


def test_load_says_what_is_wrong(tmp_path):
    remedy = "give a folder that holds recording.parquet, such as results/duffing"
    with pytest.raises(RecordError, match=rf"recording\.parquet: no such recording; {remedy}$"):
        Recording.load(tmp_path)
    with pytest.raises(RecordError, match=rf"^nowhere: no such recording; {remedy}$"):
        Recording.load("nowhere")
    with pytest.raises(RecordError, match=r"no such recording; the folder .*nowhere does not exist"):
        Recording.load(tmp_path / "nowhere" / "recording.parquet")
    for name, content in (("exp_rig.yaml", "name: rig\n"), ("empty.parquet", "")):
        text = tmp_path / name
        text.write_text(content)
        with pytest.raises(RecordError) as caught:
            Recording.load(text)
        assert str(caught.value) == f"{text} is not a recording: it is no parquet file"


@pytest.mark.parametrize(
    ("beside", "what"),
    [
        (None, "is missing"),
        ("{", "cannot be read"),
        ("\xff", "cannot be read"),
        ("[" * 100_000, "cannot be read"),
        ("{}", "says something else"),
    ],
)
def test_the_copy_inside_the_table_stands_in_for_a_bad_manifest(tmp_path, beside, what):
    path = sample().save(tmp_path) / "manifest.json"
    assert Recording.load(tmp_path).notes == ()
    if beside is None:
        path.unlink()
    else:
        path.write_text(beside, encoding="latin-1")
    back = Recording.load(tmp_path)
    assert back.manifest == {"format": FORMAT, **sample().manifest}
    assert back.notes == (f"manifest.json {what}: the copy inside recording.parquet was used.",)
    assert Recording.load((tmp_path / "recording.parquet").rename(tmp_path / "alone.parquet")).notes == ()


def test_a_manifest_is_read_as_texts_that_can_be_shown(tmp_path):
    manifest = json.dumps({"format": FORMAT, "name": "a\x1b[2J", "b": ["\0"]}).encode()
    path = _foreign(tmp_path / "a.parquet", pa.table({"t": [0.0, 1.0]}), manifest)
    assert Recording.load(path).manifest == {"format": FORMAT, "name": "a<U+001B>[2J", "b": ["<U+0000>"]}


def _foreign(path: Path, table: pa.Table, manifest: bytes | None) -> Path:
    metadata = None if manifest is None else {b"masking.manifest": manifest}
    pq.write_table(table.replace_schema_metadata(metadata), path)
    return path


@pytest.mark.parametrize(
    ("table", "manifest", "message"),
    [
        ({"t": [0.0, 1.0]}, None, "not a recording: the table carries no manifest"),
        ({"t": [0.0, 1.0]}, b"{", "the manifest inside the table is not JSON"),
        ({"t": [0.0, 1.0]}, b"[]", "its format is 'None'; this program reads 'masking recording 1'"),
        ({"t": [0.0, 1.0]}, b'{"format": "masking recording 9"}', "its format is 'masking recording 9'"),
        ({"t": ["a", "b"]}, b"{}", "column 't' holds string, not numbers"),
        ({"t": [0.0, 1.0], "x\x1b": [0.0, 1.0]}, b"{}", "the name of column 'x<U+001B>' holds a control character"),
        ({"t": [0.0, 1.0], "x": [1, None]}, b'{"format": "masking recording 1"}', "column 'x' is nan in row 1"),
    ],
)
def test_load_refuses_foreign_tables(tmp_path, table, manifest, message):
    path = _foreign(tmp_path / "foreign.parquet", pa.table(table), manifest)
    with pytest.raises(RecordError) as caught:
        Recording.load(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)


def test_load_refuses_a_record_whose_manifest_has_an_old_name(tmp_path):
    manifest = b'{"format": "masking recording 1", "fidelity": {"x1": 0.1}}'
    path = _foreign(tmp_path / "old.parquet", pa.table({"t": [0.0, 1.0]}), manifest)
    with pytest.raises(RecordError, match="'fidelity' in its manifest is called 'masking_error' now; make the record"):
        Recording.load(path)


def test_load_takes_other_kinds_of_numbers_and_several_chunks(tmp_path):
    chunks = pa.chunked_array([pa.array([0, 1], pa.int32()), pa.array([5], pa.int32())])
    path = _foreign(tmp_path / "r.parquet", pa.table({"t": chunks}), b'{"format": "masking recording 1"}')
    np.testing.assert_array_equal(Recording.load(path).t, [0.0, 1.0, 5.0])
    again = pa.table({"t": np.arange(3_000.0)})
    pq.write_table(
        again.replace_schema_metadata({"masking.manifest": json.dumps({"format": FORMAT})}), path, row_group_size=7
    )
    np.testing.assert_array_equal(Recording.load(path).t, np.arange(3_000.0))


def test_load_refuses_a_cut_off_file(tmp_path):
    path = sample().save(tmp_path) / "recording.parquet"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(
        RecordError, match=r"recording\.parquet is not a recording: the parquet file is cut off or damaged$"
    ):
        Recording.load(path)


def test_a_recording_is_replaced_only_if_asked_for(tmp_path):
    sample().save(tmp_path)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    other = Recording({"t": T}, {"name": "other"})
    said = r"holds an earlier recording, recording\.parquet; name another folder, or give overwrite=True$"
    with pytest.raises(RecordError, match=said):
        other.save(tmp_path)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before
    other.save(tmp_path, overwrite=True)
    assert Recording.load(tmp_path).name == "other"


def test_an_error_while_saving_leaves_the_folder_as_it_was(tmp_path, monkeypatch):
    sample().save(tmp_path)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq.ParquetWriter, "write_table", full)
    with pytest.raises(RecordError, match="the recording cannot be written: No space left on device"):
        Recording({"t": T}, {"name": "other"}).save(tmp_path, overwrite=True)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_what_a_killed_process_had_begun_to_save_is_removed_by_the_next(tmp_path):
    begun = "import os, sys; from pathlib import Path; from masking.lab.records.file_replacement import replacing\n"
    begun += "with replacing(Path(sys.argv[1])) as stream: os.kill(os.getpid(), 9)"
    path = tmp_path / "recording.parquet"
    assert subprocess.run([sys.executable, "-c", begun, path], check=False).returncode == -9
    (left,) = tmp_path.iterdir()
    beside = tmp_path / f".{path.name}.{os.getpid()}-0.partial"  # of a process that runs
    beside.touch()
    sample().save(tmp_path)
    assert not left.exists()
    assert beside.exists()


def test_save_says_when_the_folder_is_a_file(tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(RecordError, match="taken: the recording cannot be written: File exists"):
        sample().save(tmp_path / "taken")


def test_the_manifest_holds_numpy_values_and_infinities(tmp_path):
    manifest = {
        "masking_error": {"x": np.float64(0.5), "y": math.inf},
        "rate": np.int64(1000),
        "limits": np.array([1.0, np.nan]),
    }
    folder = Recording({"t": T}, manifest).save(tmp_path)
    text = (folder / "manifest.json").read_text()
    back = json.loads(text, parse_constant=pytest.fail)
    assert back["masking_error"] == {"x": 0.5, "y": "inf"}
    assert float(back["masking_error"]["y"]) == math.inf
    assert back["rate"] == 1000
    assert back["limits"] == [1.0, "nan"]


def test_the_manifest_refuses_what_json_cannot_hold(tmp_path):
    with pytest.raises(RecordError, match=r"'timing\.run' is of type set, which JSON cannot hold"):
        Recording({"t": T}, {"timing": {"run": {1}}}).save(tmp_path)
    assert not list(tmp_path.iterdir())


def test_importing_loads_neither_pyarrow_nor_pandas_and_saving_no_pandas(tmp_path):
    code = (
        "import sys, numpy as np\n"
        "from masking.lab.records.recording import Recording\n"
        "assert 'pyarrow' not in sys.modules and 'scipy' not in sys.modules\n"
        f"Recording.load(Recording({{'t': np.arange(3.0)}}).save({str(tmp_path)!r}))\n"
        "assert 'pyarrow.parquet' in sys.modules and 'pandas' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[3])


@given(
    hnp.arrays(np.float64, st.integers(1, 50), elements=st.floats(-1e3, 1e3)).filter(
        lambda a: np.linalg.norm(a) > 1e-3
    ),
    st.floats(-3, 3),
)
def test_masking_error_is_the_relative_size_of_the_error(ideal, factor):
    assert masking_error(ideal * (1 + factor), ideal) == pytest.approx(abs(factor), rel=1e-9, abs=1e-12)


def test_masking_error_of_orthogonal_parts_and_of_rest():
    t = np.arange(1000) * 2 * np.pi / 1000
    # A quarter of a period late: |cos - sin| / |cos| = sqrt(2) over whole periods.
    assert masking_error(np.sin(t), np.cos(t)) == pytest.approx(math.sqrt(2), rel=1e-12)
    rest = np.zeros(5)
    assert masking_error(rest, rest) == 0.0
    assert masking_error(rest + 1e-300, rest) == math.inf
    with pytest.raises(ValueError, match=r"one coordinate each, of equal length: got shapes \(5,\) and \(4,\)"):
        masking_error(rest, rest[:4])


def test_numbers_that_json_lacks_are_text():
    def refuse(constant):
        raise ValueError(constant)

    text = json_text({"at": np.array([1.0, np.nan]), "most": (np.inf, None), "file": Path("a")})
    assert json.loads(text, parse_constant=refuse) == {"at": [1.0, "nan"], "most": ["inf", None], "file": "a"}
