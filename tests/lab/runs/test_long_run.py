"""Long runs: chunks on disk are the run in one piece, parts are read by time, and memory does not grow with time."""

import json
import pickle
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import masking
from masking.display import thinning
from masking.display.json_text import json_text
from masking.errors import MaskingError, RecordError
from masking.lab.records import columns_on_disk, readers
from masking.lab.records.recording import Recording
from masking.lab.runs import long_run, simulated_run
from masking.lab.runs.experiment import Experiment
from masking.reports import long_record, run_measures, run_study

ROWS = 1000  # of a chunk, here


@pytest.fixture
def small_chunks(monkeypatch):
    for module in (simulated_run, long_run):
        monkeypatch.setattr(module, "CHUNK", ROWS)


@pytest.fixture
def on_disk(monkeypatch):
    monkeypatch.setattr(columns_on_disk, "LARGE", 0)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return a run of 80 s on the imperfect rig in memory, and its folder, with rows in groups of a thousand."""
    experiment = Experiment.load("huygens_rig")
    folder = tmp_path_factory.mktemp("run")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(long_run, "CHUNK", ROWS)
        long_run.run(experiment, folder)
    return Recording.load(folder), folder


SAMPLED = {"controller": {"rate": "1 kHz", "observer": "exact"}, "record": {"rate": "1 kHz"}}
STOPPED = {"stop": {"when": "synchronised", "eps": 0.5, "period": 6.0}}


@pytest.mark.parametrize(
    ("name", "duration", "sections"),
    [("huygens_rig", 20.0, {}), ("duffing", 250.0, {}), ("duffing", 50.0, SAMPLED), ("huygens_rig", 60.0, STOPPED)],
    ids=["twin", "continuous", "sampled", "stopped"],
)
def test_chunks_are_the_run_in_one_piece_to_the_last_bit(name, duration, sections, tmp_path, small_chunks):
    experiment = Experiment.load(name).changed(duration=duration, **sections)
    whole, chunks = experiment.run(), long_run.run(experiment, tmp_path)
    assert len(whole) > 2 * ROWS
    assert [*chunks.columns] == [*whole.columns]
    assert all(chunks[name].tobytes() == whole[name].tobytes() for name in whole.columns)
    changed = {"created", "timing", "masking_error"}
    here, there = ({n: x for n, x in r.manifest.items() if n not in changed} for r in (whole, chunks))
    assert json.loads(json_text(here)) == there
    assert chunks.manifest["masking_error"] == pytest.approx(whole.manifest["masking_error"], rel=1e-12)
    assert (whole.manifest.get("stop") or {}).get("met") == (chunks.manifest.get("stop") or {}).get("met")


def test_where_an_integrator_begins_anew_changes_nothing_that_counts(monkeypatch):
    experiment = Experiment.load("duffing").changed(duration=250.0)
    whole = experiment.run()
    monkeypatch.setattr(simulated_run, "CHUNK", ROWS)
    np.testing.assert_allclose(experiment.run()["ideal.x1"], whole["ideal.x1"], rtol=0, atol=1e-9)


def test_a_part_on_disk_is_that_in_memory(recorded, on_disk):
    whole, folder = recorded
    stored_one = Recording.load(folder)
    assert stored_one.is_on_disk
    assert not whole.is_on_disk
    assert (len(stored_one), stored_one.span, repr(stored_one)) == (len(whole), whole.span, repr(whole))
    for limits in ((None, 2.0), (2.5, 7.123), (79.0, None), (None, None), (0.9995, 1.0005)):
        part, same = stored_one.between(*limits), whole.between(*limits)
        assert not part.is_on_disk
        assert all(part[name].tobytes() == same[name].tobytes() for name in whole.columns)
    rows = (whole.t >= 2.5) & (whole.t < 7.123)
    np.testing.assert_array_equal(stored_one.between(2.5, 7.123)["input.V1"], whole["input.V1"][rows])
    np.testing.assert_array_equal(readers.read(f"{folder}@2.5:7.123").t, whole.t[rows])
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(stored_one))["input.V1"], whole["input.V1"])  # noqa: S301  # our own bytes
    assert sum(len(chunk["t"]) for chunk in stored_one.chunks(["t"])) == len(whole)
    for limits in ((5.0, 90.0), (-1.0, 2.0)):
        with pytest.raises(RecordError, match="the record goes from 0 s to 79"):
            stored_one.between(*limits)


def test_what_is_on_disk_is_checked_when_it_is_read(recorded, on_disk, tmp_path):
    whole, _ = recorded
    whole.save(tmp_path)
    loaded = Recording.load(tmp_path)
    replace(whole, manifest={"name": "another"}).save(tmp_path, overwrite=True)
    with pytest.raises(RecordError, match="was replaced since it was loaded; load it anew"):
        loaded.between(1.0, 2.0)
    again = Recording.load(tmp_path)
    again.save(tmp_path / "copy")
    assert all(Recording.load(tmp_path / "copy")[name].tobytes() == whole[name].tobytes() for name in whole.columns)
    file = tmp_path / "recording.parquet"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    damaged = Recording.load(tmp_path)
    with pytest.raises(RecordError, match="cut off or damaged"):
        [*damaged.chunks()]


def test_thinned_columns_keep_samples_or_extremes():
    generator = np.random.default_rng(3)
    x = generator.standard_normal(10_007)
    times, values = np.array_split(np.arange(10_007.0), 7), np.array_split(x, 7)
    chunks = [{"t": t, "x": y, "y": y} for t, y in zip(times, values, strict=True)]
    found = thinning.thinned(chunks, 4, {"t", "y"})
    np.testing.assert_array_equal(found["t"], np.arange(0.0, 10_007.0, 4.0))
    np.testing.assert_array_equal(found["y"], x[::4])
    pairs, stretches = found["x"][:2500].reshape(-1, 2), x[:10_000].reshape(-1, 8)
    np.testing.assert_array_equal(np.sort(pairs), np.column_stack([stretches.min(axis=1), stretches.max(axis=1)]))
    assert len(found["x"]) == len(found["t"])
    assert thinning.step_for(1000, 1000) == 1
    assert thinning.step_for(1001, 1000) == 2


def test_a_recording_on_disk_is_studied_as_in_memory(recorded, on_disk, monkeypatch):
    whole, folder = recorded
    monkeypatch.setattr(long_record, "_MOST", 30_000)  # of 79822 samples
    monkeypatch.setattr(long_record, "_WINDOW", 5_000)
    here, there = run_study.Study(whole), run_study.Study(Recording.load(folder))
    assert len(there.recording) == 19_956
    assert there.chi == pytest.approx(here.chi, rel=1e-12)
    assert there.errors == here.errors
    for a, b in zip(here.inputs, there.inputs, strict=True):
        assert (a.peak, a.demand, a.power, a.saturated) == (b.peak, b.demand, b.power, b.saturated)
        assert a.rms == pytest.approx(b.rms, rel=1e-12)
    assert there.anti_phase.alpha == pytest.approx(here.anti_phase.alpha, rel=1e-5)
    assert there.anti_phase.eps == pytest.approx(here.anti_phase.eps, rel=0.01)
    assert there.period == pytest.approx(here.period, rel=1e-5)
    measured = run_measures.measure(Recording.load(folder), ["peak", "chi", "eps"])
    assert measured["peak"] == max(use.peak for use in here.inputs)
    assert measured["eps"] == there.anti_phase.eps


def test_memory_does_not_grow_with_time(tmp_path):
    """Twenty minutes at 1 kHz take as much as two."""
    code = """
import resource, sys
from masking.lab.runs import error_budget, long_run
from masking.lab.runs.experiment import Experiment
experiment = Experiment.load("huygens_rig")
for minutes in (2, 20):
    long_run.run(error_budget.in_full(experiment, 60 * minutes / experiment.time_scale), sys.argv[1], overwrite=True)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""
    pytest.importorskip("resource", reason="it measures the memory of a process by the operating system")
    said = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=True)
    short, long = map(int, said.stdout.split())
    unit = 1024 if sys.platform == "darwin" else 1
    assert (long - short) / unit < 40 * 1024  # kB; its rows are 298 MB
    assert Recording.load(tmp_path).is_on_disk


def test_a_long_run_goes_to_disk_with_its_report(tmp_path, monkeypatch, on_disk):
    monkeypatch.setattr(long_run, "LARGE", 0)
    made = masking.run("duffing", out=tmp_path / "out")
    assert made.path == tmp_path / "out" / "recording.parquet"
    assert (tmp_path / "out" / "report.html").exists()
    assert masking.run("duffing").path is None
    with pytest.raises(MaskingError, match="too long for that; make the budget of a shorter duration"):
        masking.run("huygens_rig", out=tmp_path / "budget", budget=True)


def test_what_cannot_go_to_disk_says_why(tmp_path, monkeypatch):
    with pytest.raises(
        MaskingError, match="cannot run in chunks: the inputs of its virtual system come from the run itself"
    ):
        long_run.run(Experiment.load("cart_felt"), tmp_path)
    with pytest.raises(MaskingError, match="cannot run in chunks: its virtual system jumps, or depends on its past"):
        long_run.run(Experiment.load("escapements"), tmp_path)
    monkeypatch.setattr(long_run.shutil, "disk_usage", lambda _: SimpleNamespace(free=10))
    with pytest.raises(RecordError, match=r"and 9\.31e-09 GiB are free; make room"):
        long_run.run(Experiment.load("duffing"), tmp_path / "full")
    assert not [*(tmp_path / "full").iterdir()]
