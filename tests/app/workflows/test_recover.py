"""What is left of a run on a rig that did not end in order, and the time that its ticks took."""

import itertools
import json
import os
import resource
import signal
import subprocess
import time

import numpy as np
import pytest

from masking.app import cli
from masking.app.workflows.recover import recover
from masking.app.workflows.run import report
from masking.display.json_text import json_text
from masking.errors import PlantLostError, RecordError
from masking.lab.plants import operating_system
from masking.lab.plants.interface import Sample
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.records import child_process, recorder, stream, stream_reader
from masking.lab.records.recording import Recording
from masking.lab.records.tick_times import histogram
from masking.lab.runs import loop_rows, rig_run
from masking.lab.runs.experiment import Experiment
from tests.lab.runs.test_rig_run import compiled, recovered, written
from tests.support.forked import Forked


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    """Return an experiment of a twin in lockstep, of 200 samples of homing and some hundred behind them."""
    compiled("linear_rig")
    return Experiment.load(written(tmp_path_factory.mktemp("rig"), controller={"homing": 0.2}, duration=10))


class Jumping(SimulatedPlant):
    """A twin whose ticks jump, or that is lost, at a sample."""

    def __init__(self, twin, at, by=0):
        super().__init__(twin)
        self.at, self.by, self.reads = at, by, 0

    def read(self):
        sample = super().read()
        self.reads += 1
        if self.reads > self.at and not self.by:
            raise PlantLostError("the cable is off; plug it in")
        return Sample(sample.index + (self.by if self.reads > self.at else 0), sample.values)

    def write(self, index, command):
        super().write(index - (self.by if self.reads > self.at else 0), command)


def same(found, expected):
    """Tell whether two recordings have the same columns, to the last bit."""
    return list(found.columns) == list(expected.columns) and all(
        np.array_equal(found[name], expected[name]) for name in expected.columns
    )


def test_a_stream_gives_the_recording_of_the_run_exactly(experiment, tmp_path):
    expected = rig_run.run(
        experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True, stream=tmp_path)
    )
    found = recover(tmp_path)
    assert same(found.recording, expected)
    assert same(Recording.load(tmp_path), expected)
    ours, theirs = found.recording.manifest, expected.manifest
    assert {k: v for k, v in ours.items() if k not in {"rig", "created"}} == {
        k: v for k, v in theirs.items() if k not in {"rig", "created"}
    }
    assert ours["rig"]["end"] == "killed"
    ticks = Recording.load(tmp_path / "ticks")
    assert np.count_nonzero(ticks["index"] < 0) == found.homing == 201
    assert len(ticks) == found.rows == 201 + len(expected)
    np.testing.assert_array_equal(ticks["sensor.s1"][201:], expected["sensor.s1"])
    assert str(found).splitlines()[1:3] == [
        "no tick is missing",
        "the run ended in order, but its recording was not saved",
    ]
    assert not stream.is_in(tmp_path)
    assert report(tmp_path).path.exists()


def test_the_record_of_a_run_has_nothing_of_its_stream(experiment, tmp_path):
    plain = rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True))
    streamed = rig_run.run(
        experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True, stream=tmp_path)
    )
    assert same(streamed, plain)
    assert "recorder" not in streamed.manifest["rig"]


@pytest.mark.parametrize("by", [10**9, 2**60, 2**63 + 5])
def test_an_index_that_jumps_ends_the_run_and_keeps_what_was_before(experiment, tmp_path, by):
    whole = rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True))
    began = time.monotonic()
    found = rig_run.run(
        experiment, Jumping(experiment.twin, 301, by), rig_run.RunSettings(lockstep=True, stream=tmp_path)
    )
    assert time.monotonic() - began < 10.0
    assert found.manifest["rig"]["end"] == "tripped"
    assert len(found) == 100
    np.testing.assert_array_equal(found["sensor.s2"], whole["sensor.s2"][:100])
    assert recover(tmp_path).rows == 302


def test_a_lost_plant_leaves_a_stream(experiment, tmp_path):
    whole = rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True))
    with pytest.raises(PlantLostError):
        rig_run.run(experiment, Jumping(experiment.twin, 301), rig_run.RunSettings(lockstep=True, stream=tmp_path))
    found = recover(tmp_path)
    assert (found.rows, len(found.recording)) == (301, 100)
    np.testing.assert_array_equal(found.recording["input.V1"], whole["input.V1"][:100])


def test_in_the_homing_there_are_ticks_alone(experiment, tmp_path):
    with pytest.raises(PlantLostError):
        rig_run.run(experiment, Jumping(experiment.twin, 50), rig_run.RunSettings(lockstep=True, stream=tmp_path))
    found = recover(tmp_path)
    assert (found.rows, found.homing, found.recording) == (50, 50, None)
    assert found.why == "the run ended in the homing, before the release"
    assert not (tmp_path / "recording.parquet").exists()


def test_a_run_is_recovered_as_it_was_declared_whatever_became_of_its_files(experiment, tmp_path):
    path = written(tmp_path, controller={"homing": 0.2}, duration=10)
    made = Experiment.load(path)
    whole = rig_run.run(made, SimulatedPlant(made.twin), rig_run.RunSettings(lockstep=True, stream=tmp_path / "run"))
    path.write_text("name: another\n")
    found = recover(tmp_path / "run", out=tmp_path / "out").recording
    assert found.manifest["declarations"] == json.loads(json_text(whole.manifest["declarations"]))
    assert found.manifest["files"] == whole.manifest["files"]
    assert all(np.array_equal(found[name], whole[name]) for name in whole.columns)


def damaged(folder, pages):
    """Write the stream of a folder again, in a number of pages, and change a byte in its middle."""
    found = stream_reader.read(folder)
    (folder / stream.ROWS).unlink()
    writer, first = stream.StreamWriter(folder), 0
    for table in np.array_split(found.table, pages):
        writer.append(first, table)
        first += len(table)
    writer.close()
    data = bytearray((folder / stream.ROWS).read_bytes())
    data[len(data) // 2] ^= 1
    (folder / stream.ROWS).write_bytes(data)


def test_damage_is_told_and_the_stream_stays(experiment, tmp_path, capsys):
    rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True, stream=tmp_path))
    damaged(tmp_path, 5)
    assert cli.main(["recover", str(tmp_path), "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert "were changed (page" in answer["damages"][0]
    assert answer["missing"] > 0
    assert stream.is_in(tmp_path)
    assert cli.main(["recover", str(tmp_path)]) == 2
    assert "holds an earlier result" in capsys.readouterr().err
    assert cli.main(["recover", str(tmp_path), "--overwrite"]) == 1


def test_a_stream_without_a_sound_page_says_so(experiment, tmp_path, capsys):
    rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True, stream=tmp_path))
    damaged(tmp_path, 1)
    assert cli.main(["recover", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "no tick of the run is readable (" in said
    assert "were changed (page" in said


def test_a_folder_that_holds_a_stream_is_not_run_into(experiment, tmp_path, capsys):
    rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True, stream=tmp_path))
    with pytest.raises(RecordError, match="did not end in order; make a recording of it by 'masking recover"):
        rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True, stream=tmp_path))
    path = next(iter(experiment.declaration.files))
    assert cli.main(["rig", "run", path, "--plant", "udp://127.0.0.1:9", "--out", str(tmp_path)]) == 2
    assert f"masking recover {tmp_path}" in capsys.readouterr().err
    assert cli.main(["recover", str(tmp_path / "none")]) == 2
    assert "holds no stream of a run; name a folder with stream.json" in capsys.readouterr().err


def test_full_disks_end_the_run_in_order(experiment, tmp_path, monkeypatch):
    start, size = subprocess.Popen, 3 * recorder.MOST  # a page is never larger than a third of it

    def popen(command, **more):
        return start(command, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)), **more)

    monkeypatch.setattr(child_process.subprocess, "Popen", popen)
    made = experiment.changed(duration=10_000)
    folder = tmp_path / "run"
    found = rig_run.run(
        made, SimulatedPlant(made.twin), rig_run.RunSettings(lockstep=True, stream=folder, spare=tmp_path / "spare")
    )
    assert found.manifest["rig"]["end"] == "disk full"
    assert found.manifest["rig"]["recorder"]["note"].startswith("no place was left")
    left = recover(folder)
    assert 0 < left.rows < len(found) + 201
    assert left.end.startswith("it is cut off")


def test_a_recorder_that_is_killed_in_a_run_is_replaced_and_counted(experiment, tmp_path, monkeypatch):
    made = []

    def started(*given, **more):
        made.append(recorder.Recorder(*given, **more))
        return made[0]

    monkeypatch.setattr(loop_rows, "Recorder", started)

    def kill(part):
        if 0.5 <= part < 0.51:
            os.kill(made[0].process, signal.SIGKILL)

    folder = tmp_path / "run"
    expected = rig_run.run(
        experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(progress=kill, stream=folder)
    )
    assert expected.manifest["rig"]["recorder"] == {
        "ended": 1,
        "lost": 0,
        "note": "1 recorder was killed and replaced",
    }
    found = recover(folder)
    assert same(found.recording, expected)
    assert (found.missing, found.damages) == (0, ())


RUN = """
import sys
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.runs import rig_run
from masking.lab.runs.experiment import Experiment
made = Experiment.load(sys.argv[1])
rig_run.run(made, SimulatedPlant(made.twin), rig_run.RunSettings(stream=sys.argv[2]))
"""


@pytest.mark.parametrize("both", [False, True], ids=["the controller", "controller and recorder"])
def test_of_a_run_that_is_killed_nothing_is_lost(tmp_path, both):
    compiled("linear_rig")
    path, folder = written(tmp_path, controller={"homing": 0.2}, duration=500), tmp_path / "run"
    with Forked([path, folder], RUN) as started:
        until = time.monotonic() + 60.0
        while not (folder / stream.ROWS).exists() or (folder / stream.ROWS).stat().st_size < 200_000:
            assert time.monotonic() < until
            assert started.poll() is None
            time.sleep(0.01)
        if both:
            children = subprocess.run(["ps", "-o", "pid=", "--ppid", str(started.pid)], capture_output=True, check=True)
            for child in children.stdout.split():
                os.kill(int(child), signal.SIGKILL)
        started.kill()
    found = recovered(folder)
    ticks = Recording.load(folder / "ticks")
    assert (found.missing, found.damages) == (0, ())
    assert ticks["tick"].tolist() == list(range(found.rows))
    assert found.end.startswith("it is cut off" if both else "the process of the controller was killed")
    assert len(found.recording) == found.rows - found.homing > 100
    timed = found.recording.manifest["rig"]["timing"]
    assert {name: sum(part["counts"]) for name, part in timed.items()} == dict.fromkeys(timed, found.rows)
    assert timed.keys() >= {"controller"}


# --- timing -----------------------------------------------------------------------------------------------------------


def test_a_histogram_counts_every_tick_once():
    values = np.concatenate([10.0 ** np.random.default_rng(0).uniform(-7.0, 1.5, 999), [3.0]])
    found = histogram(values, np.arange(1000) + 5)
    edges = [0.0, *found["edges"], np.inf]
    assert found["counts"] == [
        int(np.count_nonzero((values >= a) & (values < b))) for a, b in itertools.pairwise(edges)
    ]
    assert (found["edges"][0], found["edges"][-1]) == pytest.approx((1e-6, 10.0))
    assert (found["max"], found["at"]) == (values.max(), int(values.argmax()) + 5)
    assert found["median"] == np.median(values)


def test_the_manifest_has_the_timing_of_the_run(experiment):
    found = rig_run.run(experiment, SimulatedPlant(experiment.twin)).manifest["rig"]["timing"]
    assert set(found) == {"lateness", "controller", "work"}
    assert len({sum(part["counts"]) for part in found.values()}) == 1
    assert found["work"]["median"] > found["controller"]["median"] > 0.0
    lockstep = rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True)).manifest[
        "rig"
    ]["timing"]
    assert set(lockstep) == {"controller", "work"}


class Clock:
    """A clock that only moves when it is told to, or slept on."""

    def __init__(self):
        self.now = 0

    def monotonic_ns(self):
        self.now += 100
        return self.now

    def sleep(self, seconds):
        self.now += max(0, round(seconds * 1e9))


def test_overruns_are_counted_exactly_and_not_made_up_for(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(operating_system, "time", clock)
    deadlines, stalls = operating_system.Deadlines(1000.0), {10: 5.4, 40: 1.6, 70: 0.9, 90: 20.3}  # ms
    begins, missed = [], []
    for tick in range(120):
        if tick:
            deadlines.wait(lambda: False)
        begins.append(clock.now)
        missed.append(deadlines.missed)
        clock.now += round(1e6 * stalls.get(tick, 0.05))
    # A stall of n periods and a part leaves out n of them, and the next tick begins on the grid. Less than a period
    # late none is left out, and the next tick begins at once.
    expected = {tick + 1: int(ms) for tick, ms in stalls.items() if ms > 2.0}
    assert {k: b - a for k, (a, b) in enumerate(itertools.pairwise(missed), 1) if b > a} == expected
    assert np.diff(begins).min() > 0.3e6
    np.testing.assert_allclose(np.delete(begins, 41) % 1_000_000, 0, atol=2000)


def test_rows_go_to_a_stream_that_has_their_units(experiment, tmp_path):
    made = loop_rows.recorder(experiment, tmp_path / "run", tmp_path)
    made.close()
    content = json.loads((tmp_path / "run" / stream.MANIFEST).read_text())
    assert content["columns"]["sensor.s1"]["unit"] == experiment.assembly.plant.sensors["s1"].unit
    assert content["rate"] == 1000.0
    assert content["files"]
    made.discard()
    assert not (tmp_path / "run").exists()
