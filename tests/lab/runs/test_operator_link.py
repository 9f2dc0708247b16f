"""Who looks at a run sees what is recorded, and stops it: from page, command line and file, and by looking away."""

import contextlib
import http.client
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
import urllib.parse

import numpy as np
import pytest

from masking.app import cli
from masking.app.workflows.operator_process import attend
from masking.errors import MaskingError
from masking.lab.plants.safety_chain import Cause, Trip
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.records import ring, stop_switch
from masking.lab.records.recording import Recording
from masking.lab.records.ring import RingReader
from masking.lab.records.stop_switch import Presser, Switch
from masking.lab.runs import rig_run
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.operator_link import ABSENCE, Operator
from masking.reports.operator_page import Monitor
from tests.benchmarks.operator_page import run
from tests.lab.plants.test_wire import MassSpring, damped
from tests.support import chromium
from tests.support.rig_runs import run_rig

pytestmark = pytest.mark.realtime

RUN = {"rate": 1000.0, "limits": np.array([0.2, 0.4])}


@pytest.fixture(scope="module")
def cart():
    return Experiment.load("cart_van_der_pol").changed(duration=60)


class Shown:
    """Stands for the process of the page: reads the ring here."""

    def __init__(self, path, of):
        self.reader, self.monitor = RingReader(path), Monitor(RingReader(path), Switch(of))

    def wait(self):
        pass


def test_what_is_shown_is_what_is_recorded(cart):
    shown = []
    with Operator(lambda *paths: shown.append(Shown(*paths)) or shown[-1]) as operator:
        recording = rig_run.run(cart, SimulatedPlant(cart.twin), rig_run.RunSettings(lockstep=True, operator=operator))
        reader, monitor = shown[0].reader, shown[0].monitor
        taken = reader.take()
        table = {name: taken.table[:, i] for i, name in enumerate(reader.columns)}
        kept = (table["index"] >= 0) & (table["index"] % cart.every == 0)
        assert reader.is_closed
        published = operator.switch.published
    assert published.pop("since") == pytest.approx(time.time(), abs=600.0)
    assert published == {"end": "finished", "name": cart.declaration.name, "plant": cart.assembly.plant.name}
    assert taken.missed == 0
    assert kept.sum() == len(recording.t) > 1000
    np.testing.assert_array_equal(table["index"][kept] / reader.rate, recording.t)
    for name in reader.columns:
        of = name.replace("applied.", "input.")
        if of in recording.columns:
            np.testing.assert_allclose(table[name][kept], recording[of], rtol=1e-12, atol=1e-15, err_msg=name)
    assert {"rig.x", "virtual.x", "sensor.encoder"} <= set(reader.columns) & set(recording.columns)
    assert {name: reader.units[name] for name in ("rig.x", "virtual.x'")} == {
        name: recording.units.get(name, "1") for name in ("rig.x", "virtual.x'")
    }
    monitor.look(0.0)
    told = monitor.since(0, 0.0)
    labels = [(bound["kind"], str(bound["label"])) for bound in monitor.facts()["bounds"]]
    peaks = dict(zip(labels, told["peak"], strict=True))
    assert peaks["limit", "<var>x</var>"] == pytest.approx(1e3 * np.abs(table["rig.x"]).max(), rel=0.02)  # mm
    assert told["state"]["word"] == "FINISHED"


@pytest.mark.parametrize(
    ("presser", "said"),
    [(Presser.PAGE, "pressed on the page;"), (Presser.COMMAND_LINE, "pressed from the command line;")],
)
def test_a_pressed_switch_trips_within_two_ticks(presser, said):
    with Operator() as operator:

        def on_tick(row):
            if row == 20:
                operator.switch.press(presser)

        ran = run_rig(damped, MassSpring(), **RUN, samples=500, lockstep=True, look=operator.look, on_tick=on_tick)
        operator.end(ran.reason, ran.trip)
        assert operator.switch.published["trip"]["cause"] == "ESTOP"
    assert (ran.reason, ran.trip.cause) == ("tripped", Cause.ESTOP)
    assert ran.trip.tick == 21
    assert said in str(ran.trip)
    assert not ran.applied[-1].any()


def test_a_file_trips(tmp_path):
    file = tmp_path / "STOP"
    file.unlink(missing_ok=True)
    with Operator(stop_file=file) as operator:

        def on_tick(row):
            if row == 100:
                file.touch()

        ran = run_rig(damped, MassSpring(), **RUN, samples=2000, look=operator.look, on_tick=on_tick)
    assert (ran.reason, ran.trip.cause, ran.trip.channel) == ("tripped", Cause.ESTOP, f"by the file {file}")
    assert 0.0 < ran.wall[-1] - ran.wall[100] < 0.5
    with pytest.raises(MaskingError, match="remove it once the rig is safe"):
        Operator(stop_file=file)


def test_an_attended_run_trips_where_nobody_looks():
    gone = threading.Event()

    def look():
        while not gone.wait(0.01):
            operator.switch.see()

    with Operator(is_attended=True) as operator:
        operator.switch.see()
        threading.Thread(target=look, daemon=True).start()
        try:
            ran = run_rig(
                damped, MassSpring(), **RUN, samples=60_000, look=operator.look,
                on_tick=lambda row: row < 300 or gone.set(),
            )  # fmt: skip
        finally:
            gone.set()
    assert (ran.reason, ran.trip.cause) == ("tripped", Cause.UNATTENDED)
    assert len(ran.wall) > 300
    assert ABSENCE < ran.trip.value < ABSENCE + 0.5
    assert "keep it open and visible" in str(ran.trip)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "stalled"])
@pytest.mark.parametrize("attended", [False, True], ids=["", "attended"])
def test_a_page_that_is_gone_stops_attended_runs_alone(cart, number, attended):
    attendants, threads, gone, over = [], [], [], threading.Event()

    def begin(*paths):
        attendants.append(attend(*paths, page=0))
        threads.append(threading.Thread(target=browse, args=(RingReader(paths[0]),), daemon=True))
        threads[0].start()
        return attendants[0]

    def browse(reader):
        at = urllib.parse.urlsplit(attendants[0].page)
        connection = http.client.HTTPConnection(at.hostname, at.port, timeout=5)
        with contextlib.suppress(OSError, http.client.HTTPException), contextlib.closing(connection):
            while not over.wait(0.05):
                connection.request("GET", f"{at.path}data?since=0")
                connection.getresponse().read()
                if reader.count > cart.sampled.rate:
                    os.kill(attendants[0].process.pid, number)
                    gone.append(reader.count)
                    return

    try:
        with Operator(begin, is_attended=attended) as operator:
            ran = run(cart, operator, seconds=60.0 if attended else 5.0)
    finally:
        over.set()
        for thread in threads:
            thread.join()
        for one in attendants:
            one.process.end(0.0)
    assert gone
    if not attended:
        assert ran.wall[-1] - ran.wall[gone[0]] > ABSENCE
    if attended:
        assert (ran.reason, ran.trip.cause) == ("tripped", Cause.UNATTENDED)
    else:
        assert (ran.reason, ran.trip) == ("finished", None)


@pytest.fixture
def alone(tmp_path, monkeypatch):
    """Let the switches of this test be the only ones."""
    for module in (ring, stop_switch):
        monkeypatch.setattr(module, "MEMORY", tmp_path)


@contextlib.contextmanager
def another(folder, since, name):
    """Give the switch of a run in another process, which says of itself what a run does."""
    code = (
        "import pathlib, sys\nfrom masking.lab.records import ring, stop_switch\n"
        "ring.MEMORY = pathlib.Path(sys.argv[1])\nmade = stop_switch.Switch.make()\n"
        "made.publish(name=sys.argv[3], plant='cart', since=float(sys.argv[2]))\nprint(made.path, flush=True)\ninput()"
    )
    command = [sys.executable, "-c", code, str(folder), str(since), name]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield Switch(process.stdout.readline().strip())
        finally:
            process.kill()


def test_the_command_line_stops_the_one_run_there_is(alone, capsys):
    assert cli.main(["rig", "stop", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["stopped"] == []
    with Operator() as operator:
        assert cli.main(["rig", "stop", str(os.getpid() + 1)]) == 2
        said = capsys.readouterr().err
        assert f"there is no run of process {os.getpid() + 1}" in said
        assert f"masking rig stop {os.getpid()}\n" in said
        assert "--all" not in said
        assert not operator.switch.pressed
        assert cli.main(["rig", "stop"]) == 0
        assert capsys.readouterr().out == f"stopped: process {os.getpid()}\n"
        assert operator.switch.pressed == Presser.COMMAND_LINE
    assert cli.main(["rig", "stop", "--all"]) == 1
    assert capsys.readouterr().out == "no run to stop\n"


def test_the_command_line_asks_which_of_several_runs_it_stops(alone, capsys, tmp_path):
    since = time.mktime((2031, 5, 4, 3, 2, 1, 0, 0, -1))
    with Operator() as own, another(tmp_path, since, "first\x1b[2J") as first, another(tmp_path, 0, "second") as second:
        assert cli.main(["rig", "stop"]) == 2
        said = capsys.readouterr().err
        assert "several runs go on" in said
        assert f"process {first.process}: first?[2J on cart, since 2031-05-04 03:02:01\n" in said
        assert f"process {os.getpid()}: about to begin\n" in said
        assert all(f"    masking rig stop {one.process}\n" in said for one in (own.switch, first, second))
        assert said.endswith("    masking rig stop --all\n")
        assert [one.pressed for one in (own.switch, first, second)] == [0, 0, 0]
        assert cli.main(["rig", "stop", str(first.process), "1"]) == 2
        said = capsys.readouterr().err
        assert f"process {first.process} stopped, but there is no run of process 1" in said
        assert [one.pressed for one in (own.switch, first, second)] == [0, Presser.COMMAND_LINE, 0]
        assert cli.main(["rig", "stop", "--all", "--json"]) == 0
        assert {*json.loads(capsys.readouterr().out)["stopped"]} == {os.getpid(), first.process, second.process}
        assert all(one.pressed for one in (own.switch, first, second))


def test_an_interrupt_in_the_terminal_acknowledges_what_it_says():
    class Interrupted:
        def wait(self):
            raise KeyboardInterrupt

    with Operator() as operator:
        operator._attendant = Interrupted()
        operator.end("tripped", Trip(Cause.ESTOP, "on the page", 7))
        operator.wait()
        assert operator.switch.is_acknowledged


def test_an_attended_run_needs_a_page(capsys, tmp_path):
    arguments = ["rig", "run", "cart_van_der_pol", "--plant", "udp://127.0.0.1:9", "--out", str(tmp_path / "out")]
    assert cli.main([*arguments, "--attended"]) == 2
    assert "add --page" in capsys.readouterr().err
    assert cli.main([*arguments, "--stop-file", str(tmp_path)]) == 2
    assert "remove it once the rig is safe" in capsys.readouterr().err


@pytest.mark.skipif(chromium.PATH is None, reason="needs Chromium; on Debian 'apt-get install chromium'")
def test_a_served_rig_is_run_and_stopped_from_the_page(cart, tmp_path):
    run(cart, None, 0.1)  # compiled
    masking = [sys.executable, "-m", "masking", "rig"]
    serve = [*masking, "serve", "cart", "--address", "udp://127.0.0.1:0", "--sessions", "1"]
    with (
        subprocess.Popen(serve, stderr=subprocess.PIPE, text=True) as server,
        contextlib.ExitStack() as way_out,
    ):
        way_out.callback(server.kill)
        said = server.stderr.readline()
        address = said.split()[-1]
        out = tmp_path / "out"
        command = [*masking, "run", "cart_van_der_pol", "--plant", address, "--out", str(out), "--page", "--attended"]
        command += ["--overwrite"]  # of a try before
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
            way_out.callback(running.kill)
            address = None
            while address is None:
                line = running.stderr.readline()
                assert line, "the run said nothing of a page"
                address = re.search(r"operator's page: (http://127\.0\.0\.1:\S+)", line)
            with chromium.browsing() as tab:
                tab.open(address[1])
                tab.wait_for("document.querySelector('#state b').textContent === 'RUNNING'", 60.0)
                tab.wait_for(
                    "parseFloat(document.getElementById('time').textContent.slice(4)) > 2.5"
                )  # homing takes 2 s
                tab.value("document.getElementById('stop').click()")
                tab.wait_for("document.querySelector('#state b').textContent === 'TRIPPED'")
                assert tab.value("document.getElementById('sentence').textContent").startswith("the emergency stop was")
                time.sleep(0.5)
                tab.value("document.getElementById('acknowledge').click()")
                _, errors = running.communicate(timeout=60)
        server.wait(30)
    assert running.returncode == 1
    assert "tripped: tick" in errors
    manifest = Recording.load(out).manifest
    assert (manifest["rig"]["end"], manifest["rig"]["trip"]["channel"]) == ("tripped", "on the page")
