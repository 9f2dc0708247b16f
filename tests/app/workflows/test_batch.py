"""Batches: what a plan asks for, a journal that survives any cut, and runs that are neither lost nor made twice."""

import contextlib
import csv
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from masking.app import cli
from masking.app.workflows import batch
from masking.control.rig.twin import Twin
from masking.errors import DeclarationError, RecordError
from masking.lab.records import stream
from masking.lab.records.journal import Journal
from masking.lab.records.recording import Recording
from masking.lab.records.stop_switch import Presser, switches
from masking.lab.runs import batch_plan as plans
from masking.model.declaration import catalogue
from tests.campaigns.bench import Bench
from tests.campaigns.twins import PLANT

EXPERIMENT = {
    "name": "Duffing oscillators",
    "plant": PLANT,
    "virtual": "duffing",
    "controller": {"rate": "1 kHz", "model": "setup_springs", "observer": "disturbance", "homing": 0.5},
    "initial": {"x1": -0.6, "x2": -0.5},
    "duration": 10,
}
VARIED = {"initial.x1": [-0.6, -0.4], "parameters.w3": [0.53, 0.6]}


def written(folder, plan=None, **changes):
    """Write a plan and its experiment; return the path of the plan."""
    folder.mkdir(exist_ok=True)
    (folder / "experiment.yaml").write_text(json.dumps(EXPERIMENT | changes))
    path = folder / "plan.yaml"
    path.write_text(json.dumps({"name": "several", "experiment": "experiment.yaml", **(plan or {})}))
    return path


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    made = Bench(tmp_path_factory.mktemp("batch") / "bench")
    yield made
    made.close()


def lines(folder):
    """Return the events of a journal that another process may write."""
    with contextlib.suppress(OSError):
        content = (folder / batch.JOURNAL).read_bytes().split(b"\n")[:-1]
        return [json.loads(line.rpartition(b"\t")[0]) for line in content]
    return []


def awaited(is_there):
    until = time.monotonic() + 60.0
    while not is_there():
        assert time.monotonic() < until
        time.sleep(0.01)


def test_the_runs_are_all_combinations_in_the_order_of_the_file(tmp_path):
    *_, runs = plans.load(written(tmp_path, {"vary": {**VARIED, "seed": [3, 4]}, "repeats": 2}))
    values = list(itertools.product(*VARIED.values(), [3, 4])) * 2
    assert [tuple(run.settings.values()) for run in runs] == values
    assert [run.number for run in runs] == list(range(1, 17))


@pytest.mark.parametrize(
    ("plan", "place", "message"),
    [
        ("vary: {initial.x9: [1]}", "3:21", "x9"),
        ("vary: {parameters.w9: [1]}", "3:24", "w9"),
        ("vary: {initial.x1: []}", "3:8", "has no values"),
        ("repeats: 0", "3:10", "must be at least 1, not 0"),
        ("cool: -1", "3:7", "must be at least 0, not -1"),
        ("cool: 1e300", "3:7", "must be at most 604800 s, a week, not 1e+300"),
        ("patience: 1e300", "3:11", "must be at most 604800 s, a week, not 1e+300"),
        ("vary: {initial.x1: [1, 2]}\nrepeats: 1e300", "3:1", "asks for more than 10^15 runs; at most 1000000"),
        ("budget: {trips: 0}", "3:17", "must be at least 1, not 0"),
        ("vary: {initial.x1: [1, a]}", "3:24", "must be a finite number, not 'a'"),
        ("repeat: 2", "3:1", "did you mean 'repeats'?"),
        ("vary: {initial.x1: [1, 2]}\nrepeats: 500001", "3:1", "asks for 1000002 runs; at most 1000000 are allowed"),
    ],
)
def test_what_is_wrong_with_a_plan_is_said_with_its_place(tmp_path, capsys, plan, place, message):
    path = written(tmp_path)
    path.write_text(f"name: several\nexperiment: experiment.yaml\n{plan}\n")
    for arguments in (["check"], ["rig", "batch", "--out", str(tmp_path / "out")]):
        assert cli.main([*arguments, str(path)]) == 2
        said = "".join(capsys.readouterr())
        assert f"{path}:{place}: " in said
        assert message in said
    assert not (tmp_path / "out").exists()


def test_a_budget_of_energy_needs_a_plant_whose_heating_is_known(tmp_path):
    path = written(tmp_path, {"experiment": "cart_van_der_pol", "budget": {"energy": 1}})
    with pytest.raises(DeclarationError, match=r"budget\.energy: .* does not say how its commands heat"):
        plans.load(path)


def test_packaged_plans_are_sound():
    assert catalogue.names("batch")
    for name in catalogue.names("batch"):
        assert plans.load(name)[2]


def test_a_journal_that_is_cut_anywhere_is_an_exact_prefix(tmp_path):
    path = tmp_path / "a.journal"
    with Journal(path) as journal:
        for i in range(5):
            journal.add(event="begin", run=i, text="ä\n")
        whole = journal.entries
    data = path.read_bytes()
    ends = [i + 1 for i, byte in enumerate(data) if byte == 10]
    for at in range(len(data)):
        path.write_bytes(data[:at])
        with Journal(path) as journal:
            assert journal.entries == whole[: sum(end <= at for end in ends)]
            journal.add(event="end")
        with Journal(path) as journal:
            assert journal.entries[-1] == {"event": "end"}


def test_every_changed_byte_of_a_journal_is_found(tmp_path):
    path = tmp_path / "a.journal"
    with Journal(path) as journal:
        for i in range(3):
            journal.add(event="begin", run=i)
    data = path.read_bytes()
    for at, by in itertools.product(range(len(data)), (1, 7, 128)):
        path.write_bytes(data[:at] + bytes([data[at] ^ by]) + data[at + 1 :])
        with pytest.raises(RecordError, match=r"line \d was changed"):
            Journal(path)


def test_a_full_disk_takes_nothing_from_a_journal(tmp_path):
    path = tmp_path / "a.journal"
    code = (
        "import resource, sys; from pathlib import Path; from masking.lab.records.journal import Journal\n"
        "from masking.errors import RecordError\n"
        "journal = Journal(Path(sys.argv[1])); journal.add(event='begin')\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (60, 60))\n"
        "try: journal.add(event='a longer line than what is left of the disk')\n"
        "except RecordError as error: print(error)\n"
    )
    said = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, check=True).stdout
    assert "make room, then start the same again" in said
    with Journal(path) as journal:
        assert journal.entries == [{"event": "begin"}]


def test_energy_is_that_of_the_plants_own_record(bench, tmp_path):
    served = bench.served()
    made = batch.run(written(tmp_path, {"plant": served.address, "lockstep": True}), tmp_path / "out")
    served.record()
    own, twin = served.record(), Twin.load(PLANT)
    heating = twin.declaration.limits.power.heating
    assert heating.unit == "W/V**2"
    spent = heating.value * float(np.sum(own.array("input") ** 2)) / 1000.0
    assert plans.used(made.runs)["energy"] == pytest.approx(spent, rel=1e-12)
    assert spent > 0.0


def test_a_batch_that_is_killed_in_a_run_goes_on_and_repeats_nothing(tmp_path_factory):
    folder = tmp_path_factory.mktemp("killed")
    starts = [-0.6, -0.5, -0.4]
    plan, out = written(folder, {"vary": {"initial.x1": starts}}, duration=60), folder / "out"
    command = [sys.executable, "-m", "masking", "rig", "batch", str(plan), "--out", str(out), "--json"]
    rows = out / "runs" / "2-1" / stream.ROWS
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        awaited(lambda: rows.exists() and rows.stat().st_size > 150_000)
        process.kill()
    first = (out / "runs" / "1-1" / "recording.parquet").read_bytes()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    ends = [(e["run"], e["try"], e["end"]) for e in lines(out) if e["event"] == "end"]
    assert ends[0] == (1, 1, "finished")
    assert ends[1][:2] == (2, 1)
    assert ends[1][2] in {"interrupted", "cut off"}
    assert ends[2:] == [(2, 2, "finished"), (3, 1, "finished")]
    assert (out / "runs" / "1-1" / "recording.parquet").read_bytes() == first
    assert len(Recording.load(out / "runs" / "2-1")) > 10  # what there was is kept
    assert [row["initial.x1"] for row in json.loads(done.stdout)["runs"]] == starts
    assert len(list(csv.DictReader((out / "batch.csv").read_text().splitlines()))) == 3
    assert "3 of 3 runs ended as planned" in (out / "batch.html").read_text()
    assert batch.run(plan, out).done == 3
    assert len(lines(out)) == 9  # the plan, four begun, four ended: nothing was made again


def test_a_run_whose_process_is_killed_is_kept_and_made_again(bench, tmp_path_factory):
    folder = tmp_path_factory.mktemp("controller")
    plan = {"vary": {"initial.x1": [-0.55]}, "retries": 1}
    path, place = written(folder, plan, duration=60), folder / "out" / "runs" / "1-1"
    code = (
        "import sys; from masking.app.workflows import batch\n"
        "made = batch.run(sys.argv[1], sys.argv[2]); print([e['end'] for e in made.runs[0].ends])"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, path, folder / "out"], stdout=subprocess.PIPE, text=True
    ) as process:
        rows = place / stream.ROWS
        awaited(lambda: rows.exists() and rows.stat().st_size > 150_000)
        (child,) = map(int, Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split())
        os.kill(child, signal.SIGKILL)
        said = process.communicate()[0]
    assert said == "['failed', 'finished']\n"
    assert len(Recording.load(place / "ticks")) > 500
    kept, whole = Recording.load(place).array("input"), Recording.load(folder / "out" / "runs" / "1-2").array("input")
    assert len(kept) > 10
    assert np.array_equal(kept, whole[: len(kept)])  # the same twin, the same seed: an exact prefix


def test_a_plan_and_an_experiment_that_are_edited_meanwhile_change_nothing(tmp_path):
    plan = written(tmp_path, {"vary": {"initial.x1": [-0.6, -0.5]}})

    def edit(_):
        written(tmp_path, {"vary": {"initial.x1": [-0.1]}}, initial={"x2": 0.3}, duration=30)

    made = batch.run(plan, tmp_path / "out", say=edit)
    assert made.done == 2
    for number, start in ((1, -0.6), (2, -0.5)):
        declared = Recording.load(tmp_path / "out" / "runs" / f"{number}-1").manifest["declarations"]["experiment"]
        assert declared["initial"] == {"x1": start, "x2": -0.5}
        assert declared["duration"] == 10


def test_an_emergency_stop_ends_the_batch_and_every_run_is_in_the_table(bench, tmp_path):
    served = bench.served()
    plan = {"plant": served.address, "lockstep": True, "repeats": 3, "retries": 5}
    path, out = written(tmp_path, plan, duration=200), tmp_path / "out"
    command = [sys.executable, "-m", "masking", "rig", "batch", str(path), "--out", str(out), "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        awaited(lambda: stream.is_in(out / "runs" / "1-1"))
        for switch in switches():
            switch.press(Presser.COMMAND_LINE)
        said = json.loads(process.communicate()[0])
    assert process.returncode == 1
    assert "stopped by a person (ESTOP)" in said["why"]
    assert [row["end"] for row in said["runs"]] == ["not made"] * 3
    assert said["used"]["trips"] == 1
    assert all("stopped by a person" in row["why"] for row in said["runs"])
    assert len([e for e in lines(out) if e["event"] == "begin"]) == 1


def test_a_trip_in_the_homing_is_one_and_budgets_end_a_batch(bench, tmp_path):
    served = bench.served()
    plan = {"plant": served.address, "lockstep": True, "repeats": 2, "retries": 3, "budget": {"trips": 2}}
    path = written(tmp_path, plan)

    def say(text):
        served.damage(what="add", channel=0, at=300, value=0.4)  # after the zeros, before the release

    say("")
    made = batch.run(path, tmp_path / "out", say=say)
    served.damage()
    (first, second) = made.rows
    assert [end["cause"] for end in made.runs[0].ends] == ["SENSOR_JUMP"] * 2
    assert first["trips"] == "SENSOR_JUMP SENSOR_JUMP"
    assert made.why == "the budget of trips, 2, is used up"
    assert (second["end"], second["why"], second["tries"]) == ("not made", made.why, 0)
    assert plans.used(made.runs)["energy"] > 0.0
    assert len(Recording.load(tmp_path / "out" / "runs" / "1-1" / "ticks")) >= 300
    path.write_text(path.read_text().replace('"trips": 2', '"trips": 9'))
    assert batch.run(path, tmp_path / "out").done == 2  # a larger budget, the same runs
    (tmp_path / "experiment.yaml").write_text(json.dumps(EXPERIMENT | {"duration": 11}))
    with pytest.raises(RecordError, match="holds a batch of other runs"):
        batch.run(path, tmp_path / "out")


def test_a_plant_that_does_not_answer_is_waited_for_and_said(tmp_path):
    plan = {"plant": "udp://127.0.0.1:9", "lockstep": True, "repeats": 2, "patience": 0.5}
    made = batch.run(written(tmp_path, plan), tmp_path / "out")
    assert made.done == 0
    assert "the plant was not reached for" in made.why
    assert all(row["end"] == "not made" and row["why"] == made.why for row in made.rows)
