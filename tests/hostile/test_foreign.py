"""Files and numbers that others made: each ends in a sentence soon, and what would take too much is not begun."""

import dataclasses
import functools
import json
import os
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from masking.app import cli
from masking.app.workflows import compare
from masking.app.workflows.recover import recover
from masking.errors import DeclarationError, MaskingError, PlantMismatchError, RecordError
from masking.lab.plants import adapters
from masking.lab.plants.interface import Settings
from masking.lab.records import foreign_json, named_files, readers, stream
from masking.lab.records.time_base import Resampling
from masking.lab.runs import batch_plan
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.realtime import LOOP
from masking.lab.runs.sweep_values import Design

MJCF = (
    '<mujoco>{head}<worldbody><body><joint name="j" type="slide"/>{inside}<geom size="1"/></body></worldbody>'
    '<actuator><motor name="u" joint="j"/></actuator><sensor><jointpos name="y" joint="j"/></sensor></mujoco>'
)
COPIES = '<replicate count="{}">{}</replicate>'
SITE = '<site size="1"/>'
MODELS = {
    "a billion copies": (MJCF.format(head="", inside=COPIES.format(10**9, SITE)), "more than 20000 elements"),
    "copies of copies": (
        MJCF.format(head="", inside=COPIES.format(300, COPIES.format(300, SITE))),
        "more than 20000 elements",
    ),
    "copies of an included file": (
        MJCF.format(head="", inside=COPIES.format(30000, '<include file="part.xml"/>')),
        "more than 20000 elements",
    ),
    "a time step of 0": (MJCF.format(head='<option timestep="0"/>', inside=""), "give one above 0"),
    "a time step of nan": (MJCF.format(head='<option timestep="nan"/>', inside=""), "give one above 0"),
    "a time step of 1e-300 s": (MJCF.format(head='<option timestep="1e-300"/>', inside=""), "longer timestep"),
    "a document type": ('<!DOCTYPE l [<!ENTITY a "b">]>' + MJCF.format(head="", inside=""), "document type"),
    "an asset that is a pipe": (
        MJCF.format(head='<asset><mesh name="m" file="pipe.obj"/></asset>', inside=""),
        "no regular file",
    ),
    "an included pipe": (MJCF.format(head='<include file="pipe.obj"/>', inside=""), "no regular file"),
    "many numbers of a sensor": (MJCF.format(head='<size nuser_sensor="2000000000"/>', inside=""), "numbers"),
    "a field of 1e10 heights": (
        MJCF.format(head='<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>', inside=""),
        "numbers",
    ),
    "an unknown plugin": (
        MJCF.format(head='<extension><plugin plugin="evil"/></extension>', inside=""),
        "correct the file",
    ),
    "not closed": ("<mujoco><worldbody>" + "<body>" * 5000, "no XML"),
    "nothing": ("", "no XML"),
    "bytes": ("\0\1\2", "no XML"),
}


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo keeps a log where it is run


def connected(address):
    plant = adapters.connect(address)
    plant.configure(Settings(rate=100.0))


@pytest.mark.parametrize("name", MODELS)
def test_a_model_of_mujoco_is_refused(tmp_path, name):
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'masking[mujoco]'")
    text, words = MODELS[name]
    os.mkfifo(tmp_path / "pipe.obj")
    (tmp_path / "part.xml").write_text(f"<mujoco>{SITE}</mujoco>")
    (tmp_path / "a.xml").write_text(text)
    with pytest.raises(PlantMismatchError, match=words) as refused:
        connected(f"mujoco:{tmp_path / 'a.xml'}")
    assert "\n" not in str(refused.value)


def test_a_model_of_mujoco_may_have_copies(tmp_path):
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'masking[mujoco]'")
    (tmp_path / "a.xml").write_text(MJCF.format(head="", inside=COPIES.format(50, SITE)))
    connected(f"mujoco:{tmp_path / 'a.xml'}")


DESCRIPTION = (
    '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="m" guid="{{1}}">'
    '<CoSimulation modelIdentifier="{}"/><ModelVariables>'
    '<ScalarVariable name="y" valueReference="0" causality="output" variability="continuous" initial="calculated">'
    '<Real/></ScalarVariable><ScalarVariable name="u" valueReference="1" causality="input" variability="continuous">'
    '<Real start="0"/></ScalarVariable></ModelVariables><ModelStructure><Outputs><Unknown index="1"/></Outputs>'
    "</ModelStructure></fmiModelDescription>"
)


def unit(path, identifier="m", size=0, count=0):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as packed:
        packed.writestr("modelDescription.xml", DESCRIPTION.format(identifier))
        with packed.open("resources/zeros", "w", force_zip64=True) as file:
            for _ in range(size):
                file.write(bytes(2**20))
        for number in range(count):
            packed.writestr(f"resources/{number}", b"")
    return path


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"size": 300}, "unpacks to 300 MiB"),
        ({"count": 10_000}, "holds 10002 files"),
        ({"identifier": "../../../../tmp/evil"}, "is no name"),
        ({"identifier": "/tmp/evil"}, "is no name"),  # noqa: S108
    ],
)
def test_a_unit_of_an_fmu_is_refused_before_it_is_unpacked(tmp_path, monkeypatch, given, words):
    fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed: pip install 'masking[fmu]'")
    monkeypatch.setattr(fmpy, "extract", lambda *_: pytest.fail("it was unpacked"))
    with pytest.raises(PlantMismatchError, match=words):
        connected(f"fmu:{unit(tmp_path / 'a.fmu', **given)}")


COLUMNS = {name: {"unit": "1", "meaning": ""} for name in LOOP}
MANIFEST = {
    "columns": COLUMNS, "rate": 1000.0, "number": "0", "ring": "/x", "lockstep": True, "declarations": {},
    "created": "2026-01-01T00:00:00+00:00", "commit": None, "files": {}, "versions": {}, "inputs": {},
}  # fmt: skip
LAST = {"why": "closed", "rows": 50, "lost": 0}
STREAMS = {
    "no inputs": ({"inputs": None}, LAST, "inputs: must be an object, not null"),
    "files as text": ({"files": "x"}, LAST, "files: must be an object"),
    "no rate": ({"rate": None}, LAST, "rate: must be a number, not null"),
    "a rate of 0": ({"rate": 0}, LAST, "rate: must be from 1e-09 to 1e+09"),
    "a rate of 1e-320": ({"rate": 1e-320}, LAST, "rate: must be from 1e-09 to 1e+09"),
    "a rate in words": ({"rate": "x"}, LAST, "rate: must be a number, not \"x\""),
    "a rate that is true": ({"rate": True}, LAST, "rate: must be a number, not true"),
    "columns in a list": ({"columns": [*COLUMNS]}, LAST, "columns: must be an object"),
    "a column without a unit": ({"columns": {"tick": {"meaning": ""}}}, LAST, "tick: the key 'unit' is missing"),
    "other columns": ({"columns": {f"<b>{n}": c for n, c in COLUMNS.items()}}, LAST, "columns: there is no 'tick'"),
    "declarations in a list": ({"declarations": []}, LAST, "declarations: must be an object"),
    "lockstep in words": ({"lockstep": "no"}, LAST, "lockstep: must be true or false"),
    "an end without a reason": ({}, {"x": 1}, "stream.rows: the key 'why' is missing"),
    "an end in a list": ({}, [], "stream.rows: the whole: must be an object"),
    "a number of rows in words": ({}, {"why": "closed", "rows": "a"}, "rows: must be a whole number"),
}  # fmt: skip


def streamed(folder, changes, end, rows):
    stream.begin(folder, {**MANIFEST, "spare": str(folder), **changes})
    rows = rows[:, : len({**MANIFEST, **changes}["columns"])]
    writer = stream.StreamWriter(folder)
    writer.append(0, rows)
    writer.end(end)
    return folder


def rows_of(count):
    rows = np.zeros((count, len(COLUMNS)))
    rows[:, [*COLUMNS].index("tick")] = np.arange(count)
    return rows


@pytest.mark.parametrize("name", STREAMS)
def test_a_stream_is_refused(tmp_path, name):
    changes, end, words = STREAMS[name]
    folder = streamed(tmp_path / "run", changes, end, rows_of(50))
    before = {path: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(RecordError) as refused:
        recover(folder)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize(
    ("manifest", "rows", "words"),
    [
        ("[" * 100_000, b"x" * 100, "nested too deep"),
        ('{"a":' * 50_000 + "1" + "}" * 50_000, b"x" * 100, "nested too deep"),
        ("link", b"x" * 100, "it is no regular file"),
        ("{}", "pipe", "it is no regular file"),
        ("pipe", b"x" * 100, "it is no regular file"),
        ('{"format": "masking stream 1", "columns": 3}', b"x" * 100, "columns: must be an object"),
    ],
    ids=["lists", "objects", "link to a device", "rows in a pipe", "manifest in a pipe", "columns"],
)
def test_files_of_a_stream_are_refused(tmp_path, manifest, rows, words):
    for path, content in ((tmp_path / stream.MANIFEST, manifest), (tmp_path / stream.ROWS, rows)):
        if content == "pipe":
            os.mkfifo(path)
        elif content == "link":
            path.symlink_to("/dev/zero")
        else:
            path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(RecordError, match=words):
        recover(tmp_path)


def test_pages_of_no_rows_and_a_ring_in_a_pipe_are_passed_over(tmp_path):
    os.mkfifo(tmp_path / "ring")
    folder = tmp_path / "run"
    stream.begin(folder, {**MANIFEST, "spare": str(folder), "ring": str(tmp_path / "ring")})
    writer = stream.StreamWriter(folder)
    for rows in (rows_of(50)[:0], rows_of(50)):
        writer.append(0, rows)
    writer.sync()
    writer.close()
    assert recover(folder).rows == 50


def test_rows_without_the_number_of_a_tick_are_left_out(tmp_path):
    rows = rows_of(50)
    rows[20:30, [*COLUMNS].index("tick")] = np.nan
    rows[:, [*COLUMNS].index("index")] = -1.0
    found = recover(streamed(tmp_path / "run", {}, LAST, rows))
    assert found.rows == 40
    assert found.damages == ("stream.rows: 10 rows hold no number of a tick, and were left out",)


@pytest.mark.parametrize("open_one", [named_files.opened, named_files.content])
@pytest.mark.parametrize("kind", ["pipe", "link to a device", "folder"])
def test_what_is_no_regular_file_is_not_opened(tmp_path, kind, open_one):
    path = tmp_path / "a.csv"
    makers = {"pipe": os.mkfifo, "link to a device": lambda p: p.symlink_to("/dev/zero"), "folder": os.mkdir}
    makers[kind](path)
    with pytest.raises((OSError, RecordError), match="no regular file"):
        open_one(path)


def test_a_file_is_read_up_to_a_size(tmp_path):
    (tmp_path / "a").write_bytes(bytes(11))
    assert named_files.content(tmp_path / "a", 11) == bytes(11)
    with pytest.raises(OSError, match="more than 10 bytes"):
        named_files.content(tmp_path / "a", 10)


@dataclasses.dataclass
class Inner:
    unit: str


@dataclasses.dataclass
class Shape:
    columns: dict[str, Inner]
    rate: float
    why: str | None = None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 100_000, "a.json is no JSON: it is nested too deep"),
        ('{"a":' * 50_000 + "1" + "}" * 50_000, "a.json is no JSON: it is nested too deep"),
        (json.dumps({"columns": {}, "rate": 1, "more": json.loads("[" * 300 + "]" * 300)}), "nested too deep"),
        ("{", "a.json is no JSON"),
        ("\0", "a.json is no JSON"),
        ("9" * 5000, "a.json is no JSON"),
        ("[]", "a.json: the whole: must be an object, not []"),
        ('{"columns": {"x": {"unit": 3}}, "rate": 1}', "a.json: columns.x.unit: must be a text, not 3"),
        ('{"columns": {"x": {}}, "rate": 1}', "a.json: columns.x: the key 'unit' is missing"),
        ('{"columns": {}, "rate": 1e999}', "a.json: it holds a number that is not finite"),
        ('{"columns": {}, "rate": NaN}', "a.json: it holds a number that is not finite"),
        ('{"columns": {}, "rate": "' + "x" * 1000 + '"}', "rate: must be a number"),
    ],
)
def test_json_is_checked_against_its_shape(text, words):
    with pytest.raises(RecordError) as refused:
        foreign_json.parsed(text, Shape, "a.json")
    assert words in str(refused.value)
    assert len(str(refused.value)) < 200


def test_json_of_the_shape_stays_as_it_is():
    text = '{"columns": {"x": {"unit": "m", "more": [1, null]}}, "rate": 3, "other": {"a": 0.1}}'
    assert foreign_json.parsed(text, Shape, "a.json") == json.loads(text)


@pytest.mark.parametrize(
    ("over", "runs", "words"),
    [
        ({"a": "0:1:1000000000"}, None, "has 1000000000 values"),
        ({"a": "0:1:100000", "b": "0:1:100000"}, None, "asks for 1e+10 runs of 2 values each"),
        ({"a": "normal:0:1"}, 10**18, "asks for 1e+18 runs"),
        ({"a": "normal:0:inf"}, 3, "cannot be read"),
        ({"a": "normal:nan:1"}, 3, "cannot be read"),
        ({"a": "uniform:0:inf"}, 3, "cannot be read"),
        ({"a": "uniform:-1e308:1e308"}, 3, "cannot be read"),
        ({"a": "0:inf:3"}, None, "cannot be read"),
        ({"a": "-1:1:5:log"}, None, "cannot be read"),
        ({"a": "fit:/dev/zero"}, 3, "no regular file"),
        ({"a": "fit:a.json"}, 3, "parameters: must be an object"),
        ({"a": "fit:b.json"}, 3, "no fit with a covariance"),
    ],
)
def test_a_sweep_of_too_much_is_refused(tmp_path, over, runs, words):
    (tmp_path / "a.json").write_text('{"parameters": [], "covariance": [[1]]}')
    (tmp_path / "b.json").write_text('{"parameters": {"k": {"value": 1}}, "covariance": [[1, 2], [3]]}')
    with pytest.raises(DeclarationError) as refused:
        Design.of(over, runs, 0, "random")
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"event": "begin", "run": 0, "try": 1}, "run: must be from 1 to 2, not 0"),
        ({"event": "begin", "run": 3, "try": 1}, "run: must be from 1 to 2, not 3"),
        ({"event": "begin", "run": "a", "try": 1}, "run: must be a whole number"),
        ({"event": "end", "run": 1, "try": 1}, "the key 'end' is missing"),
        ({"event": "end", "run": 1, "end": "finished", "seconds": "x"}, "seconds: must be a number"),
        ({"event": ["begin"]}, "event: must be a text"),
        ({}, "the key 'event' is missing"),
    ],
)
def test_an_entry_of_a_journal_is_refused(entry, words):
    runs = [batch_plan.Run(1, {}), batch_plan.Run(2, {})]
    with pytest.raises(RecordError) as refused:
        batch_plan.progress(runs, [{"event": "batch"}, entry])
    assert f"entry 2 of the journal: {words}" in str(refused.value)


@pytest.mark.parametrize(
    ("rate", "words"),
    [
        ("1e-320", "is no rate"),
        ("1e300", "1.6e+301 samples"),
        ("1e12", "1.6e+13 samples, 2.38e+05 GiB"),
        ("1e999", "is no rate"),
    ],
)
def test_a_rate_to_resample_at_is_refused(tmp_path, rate, words):
    times = np.arange(800) / 50.0
    np.savetxt(tmp_path / "a.csv", np.column_stack([times, np.sin(times)]), delimiter=",", header="t,x", comments="")
    with pytest.raises(MaskingError) as refused:
        readers.read(tmp_path / "a.csv", needed=("x",), resampling=Resampling.of(rate))
    assert words in str(refused.value)


def test_a_record_without_a_channel_has_nothing_to_resample(tmp_path):
    (tmp_path / "a.csv").write_text("t,x\n0,1\n1,2\n2,3\n")
    assert [*readers.read(tmp_path / "a.csv", resampling=Resampling.of(10.0)).columns] == ["t"]


def test_a_duration_without_an_end_is_refused(tmp_path):
    text = "plant: ideal\nvirtual: duffing\ncontroller: {rate: 1 kHz}\nduration: 1e300\ntime_scale: 1e300\n"
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(DeclarationError, match="1e300 units are inf rows"):
        Experiment.load(tmp_path / "a.yaml").prepare(1e9)


def test_the_points_of_a_grid_are_in_the_order_of_its_axes():
    points = Design.of({"a": "1:2:2", "b": "normal:0:1", "c": "3,4,5"}, 2, 0, "random").points
    np.testing.assert_array_equal(points[:, 0], np.repeat([1.0, 2.0], 6))
    np.testing.assert_array_equal(points[:, 2], np.tile(np.repeat([3.0, 4.0, 5.0], 2), 2))
    np.testing.assert_array_equal(points[:, 1], np.tile(points[:2, 1], 6))


ERRORS = [
    (ValueError("odd\n\x1b[31m thing"), 70, "a defect of this program: ValueError: odd  [31m thing; please report it"),
    (KeyError("x"), 70, "a defect of this program: KeyError: 'x'"),
    (MemoryError(), 1, "there is not enough memory: give fewer runs"),
    (RecursionError("maximum"), 2, "nested deeper than can be followed"),
    (PermissionError(13, "Permission denied", "/a/b"), 1, "/a/b: Permission denied"),
    (MaskingError("a sentence"), 1, "masking: a sentence"),
    (KeyboardInterrupt(), 130, "masking: interrupted"),
]


@pytest.mark.parametrize("case", ERRORS, ids=lambda case: type(case[0]).__name__)
def test_whatever_happens_is_one_sentence(tmp_path, monkeypatch, capsys, case):
    error, status, words = case

    @functools.wraps(compare.compare)
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(compare, "compare", fail)
    assert cli.main(["compare", "a", "b"]) == status
    said = capsys.readouterr().err
    assert words in said
    assert len(said.splitlines()) == 1
    logs = [*tmp_path.glob("masking-*.log")]
    assert len(logs) == (status != 130 and not isinstance(error, MaskingError))
    for log in logs:
        assert str(log) in said
        assert "Traceback" in log.read_text()
        assert "'compare' 'a' 'b'" in log.read_text()
        assert log.stat().st_mode & 0o077 == 0


def test_a_recording_of_a_device_is_refused_by_the_program(tmp_path):
    (tmp_path / "a.csv").symlink_to("/dev/zero")
    words = [sys.executable, "-m", "masking", "identify", "duffing", "a.csv", "--model", "duffing"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
