"""The operator's page shows what the loop wrote, stops it, and lets nobody else do so; datagrams say the same."""

import contextlib
import http.client
import json
import math
import re
import socket
import subprocess
import sys
import threading
import time
import urllib.parse

import numpy as np
import pytest

from masking.app.workflows.operator_process import GONE, attend
from masking.errors import MaskingError, OperatorError, RecordError
from masking.lab.records.datagrams import Datagrams
from masking.lab.records.ring import Ring, RingReader
from masking.lab.records.stop_switch import Presser, Switch, switches
from masking.reports import local_page
from masking.reports.operator_page import BINS, Monitor, OperatorPage, phase_between
from tests.support import chromium, stub_loop

browser = pytest.mark.skipif(chromium.PATH is None, reason="needs Chromium; on Debian 'apt-get install chromium'")


@contextlib.contextmanager
def looping(*arguments):
    """Give a loop in another process, its ring and its switch."""
    command = [sys.executable, "-m", "tests.support.stub_loop", *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        ring, switch = json.loads(process.stdout.readline())
        try:
            yield process, ring, switch
        finally:
            process.kill()
            process.wait()
            for path in (RingReader, Switch):
                with contextlib.suppress(RecordError):
                    path(ring if path is RingReader else switch).path.unlink()


@pytest.fixture(scope="module")
def tab():
    with chromium.browsing() as found:
        yield found


def written(columns, rows, **facts):
    """Return a closed ring that holds rows."""
    ring = Ring(columns, 1000.0, {"virtual.a": "m"}, **facts)
    for row in rows:
        ring.put(row)
    ring.close(remove=False)
    return ring.path


def test_a_monitor_has_the_smallest_and_largest_number_of_each_bin():
    table = np.random.default_rng(0).standard_normal((20_000, 3))
    table[:, 0] = np.arange(20_000) - 500
    path = written(("index", "virtual.a", "virtual.b"), table)
    monitor, reader = Monitor(RingReader(path)), RingReader(path)
    path.unlink()
    monitor.look(0.0)
    told = monitor.since(0, 0.0)
    every, missed = monitor.every, reader.take().missed
    assert every == 20
    assert told["first"] + len(told["bins"]) == (20_000 - 1) // every  # the last one is not whole yet
    for number, (low, high) in enumerate(told["bins"], told["first"]):
        rows = table[max(missed, number * every) : (number + 1) * every]
        assert low == [*rows[:, 1:].min(axis=0), rows[0, 0] / 1000.0]
        assert high == [*rows[:, 1:].max(axis=0), rows[-1, 0] / 1000.0]
    assert len(told["bins"]) == BINS
    assert told["unread"] == missed > 0
    assert json.loads(json.dumps(monitor.facts()))["panels"][0]["lines"][0]["unit"] == "m"


def test_a_monitor_sees_limits_rates_and_times():
    n = 3000
    t = np.arange(n) / 1000.0
    table = np.column_stack([np.arange(n), 0.3 * t, np.sin(t), np.full(n, 7e-6), np.arange(n) % 1000 == 999])
    table[1500:, 0] += 4.0
    table[::50, 3] = 40e-6
    bounds = [
        {
            "kind": "limit",
            "label": "a - b",
            "bound": 2.0,
            "zero": 0.5,
            "weights": {"virtual.a": 1.0, "virtual.b": -1.0},
        },
        {"kind": "limit", "label": "rate of a", "bound": 2.0, "over": 10, "weights": {"virtual.a": 1.0}},
    ]
    path = written(("index", "virtual.a", "virtual.b", "duration", "late"), table, bounds=bounds)
    monitor = Monitor(RingReader(path))
    path.unlink()
    monitor.look(0.0)
    told = monitor.since(0, 0.0)
    assert told["peak"] == [pytest.approx(np.abs(0.5 + 0.3 * t - np.sin(t)).max()), pytest.approx(0.3)]
    times = told["times"]
    assert (times["late"], times["missed"], times["worst"]) == (3, 4, 40e-6)
    assert 7e-6 <= times["p50"] < 8e-6
    assert times["p99"] == 40e-6  # 2 in 100 take this long
    assert sum(times["counts"]) == n


@pytest.mark.parametrize("phase", [0.0, 1.0, -2.0, math.pi])
def test_the_phase_is_that_of_two_sines(phase):
    t = np.arange(0.0, 12.0, 0.005)
    a, b = 3.0 + np.cos(7.3 * t + phase), 0.1 * np.cos(7.3 * t) - 1.0
    assert math.remainder(phase_between(t, a, b) - phase, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-3)
    assert math.isnan(phase_between(t, np.ones_like(t), b))


def test_a_switch_is_shared_and_goes_with_its_loop():
    made = Switch.make()
    other = next(one for one in switches() if one.path == made.path)
    assert (made.pressed, other.silence, other.published) == (0, math.inf, {})
    other.press(Presser.COMMAND_LINE)
    other.press(Presser.PAGE)
    other.see()
    assert made.pressed == Presser.COMMAND_LINE
    assert 0.0 <= made.silence < 1.0
    with pytest.raises(OperatorError, match="nothing has tripped"):
        other.acknowledge()
    made.publish(end="tripped", trip={"cause": "ESTOP"})
    assert other.published == {"end": "tripped", "trip": {"cause": "ESTOP"}}
    made.publish(trip={"cause": "CONTROLLER_EXCEPTION", "detail": "\N{SNOWMAN}" * 50_000})
    assert other.published["trip"]["cause"] == "CONTROLLER_EXCEPTION"
    assert len(other.published["trip"]["detail"]) > 1000
    made.acknowledge()
    assert other.is_acknowledged
    made.remove()
    with pytest.raises(RecordError, match="no switch of a running loop"):
        Switch(made.path)


@pytest.fixture
def page():
    path = written(("virtual.a",), np.zeros((10, 1)))
    switch = Switch.make()
    with OperatorPage(Monitor(RingReader(path), switch), switch) as found:
        yield found
    path.unlink()
    switch.remove()


def asked(page, method, path, body=b"", **headers):
    """Return the status and the content of an answer."""
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=10)
    headers = {"Host": f"127.0.0.1:{page.port}"} | {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, path, body or None, headers)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, content


def test_nobody_but_who_knows_the_address_reads_or_stops(page):
    path = f"/{page.token}/"
    assert asked(page, "GET", path)[0] == 200
    assert asked(page, "GET", f"{path}data?since=-1x")[0] == 200
    for wrong in (
        "/",
        "/data",
        "/stop",
        f"/{page.token}x/",
        f"{path}../",
        f"{path}%2e%2e/etc/passwd",
        f"{path}nothing",
    ):
        status, content = asked(page, "GET", wrong)
        assert (status, content) == (404, b"there is nothing here\n"), wrong
    assert asked(page, "GET", path, Host=f"evil.example:{page.port}")[0] == 404  # DNS rebinding
    assert asked(page, "POST", "/stop")[0] == 403
    assert asked(page, "POST", f"{path}stop", Host=f"evil.example:{page.port}")[0] == 403
    assert asked(page, "POST", f"{path}stop", Origin="http://evil.example")[0] == 403
    assert asked(page, "POST", f"{path}stop", b"x" * 2000)[0] == 413
    assert asked(page, "POST", f"{path}stop", Content_Length="-5")[0] == 400
    assert asked(page, "POST", f"{path}else")[0] == 404
    assert asked(page, "DELETE", path)[0] == 501
    assert not page.switch.pressed
    assert asked(page, "POST", f"{path}stop", Origin=f"http://127.0.0.1:{page.port}")[0] == 200
    assert page.switch.pressed == Presser.PAGE


def test_the_page_is_served_on_this_machine_alone(page):
    assert page.listener.getsockname()[0] == "127.0.0.1"
    with pytest.raises(MaskingError, match="this port cannot be had"):
        OperatorPage(page.monitor, page.switch, page.port)


def connected(page, text=b""):
    """Return a connection over which a text was sent."""
    made = socket.create_connection(("127.0.0.1", page.port), timeout=20)
    made.sendall(text)
    return made


@pytest.fixture
def slow(page):
    """Give 200 clients that send a byte now and then, and begin anew once they are turned away."""
    over = threading.Event()

    def drip():
        clients = [connected(page, b"GET / HTTP/1.1\r\nX: ") for _ in range(200)]
        dripping.set()
        while not over.wait(0.1):
            for n, client in enumerate(clients):
                try:
                    client.sendall(b"a")
                except OSError:
                    client.close()
                    clients[n] = connected(page, b"GET / HTTP/1.1\r\nX: ")
        for client in clients:
            client.close()

    dripping, thread = threading.Event(), threading.Thread(target=drip, daemon=True)
    thread.start()
    assert dripping.wait(30)
    yield
    over.set()
    thread.join()


def test_stop_is_heard_beside_200_slow_clients(page, slow):
    for _ in range(20):
        begun = time.monotonic()
        assert asked(page, "POST", f"/{page.token}/stop")[0] == 200
        assert time.monotonic() - begun < 5.0
    assert page.switch.pressed == Presser.PAGE


@pytest.mark.parametrize("begun", ["", "GET /", "POST /{}/stop HTTP/1.1\r\nContent-Length: 500\r\n\r\n"])
def test_a_request_that_does_not_become_whole_is_given_up(page, begun):
    is_closed, until = False, time.monotonic() + 20.0
    with connected(page, begun.format(page.token).encode()) as client:
        client.settimeout(0.2)
        while not is_closed and time.monotonic() < until:
            try:
                client.sendall(b"x" if begun else b"")
                is_closed = client.recv(100) == b""
            except TimeoutError:
                pass
            except ConnectionError:
                is_closed = True
    assert is_closed
    assert not page.switch.pressed


def test_whoever_shows_the_token_keeps_its_place(page, monkeypatch):
    monkeypatch.setattr(local_page, "_CONNECTIONS", 8)
    known = http.client.HTTPConnection("127.0.0.1", page.port, timeout=10)
    with contextlib.ExitStack() as way_out:
        way_out.callback(known.close)
        for turn in range(3):
            known.request("GET", f"/{page.token}/data?since=0")
            answer = known.getresponse()
            assert answer.status == 200
            assert answer.read()
            strangers = [way_out.enter_context(connected(page)) for _ in range(30)]
            assert strangers[0].recv(1) == b"", turn  # the oldest goes first
        local = known.sock.getsockname()
        known.request("POST", f"/{page.token}/stop")
        assert known.getresponse().status == 200
        assert known.sock.getsockname() == local


def test_stop_does_not_wait_for_a_look_at_the_rows(page, monkeypatch):
    looking, go_on = threading.Event(), threading.Event()

    def look(now):
        looking.set()
        go_on.wait(30)

    monkeypatch.setattr(page.monitor, "look", look)
    assert looking.wait(10)
    try:
        assert asked(page, "GET", f"/{page.token}/")[0] == 200
        assert asked(page, "POST", f"/{page.token}/stop")[0] == 200
        assert page.switch.pressed == Presser.PAGE
        with pytest.raises(TimeoutError), connected(page) as client:
            client.sendall(f"GET /{page.token}/data HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n\r\n".encode())
            client.settimeout(0.3)
            client.recv(1)
        assert page.switch.silence < 10.0  # the operator is there all the same
    finally:
        go_on.set()


def test_nothing_is_acknowledged_before_a_trip(page):
    path = f"/{page.token}/acknowledge"
    status, said = asked(page, "POST", path)
    assert (status, said) == (409, b"nothing has tripped: there is no cause yet that could be acknowledged\n")
    page.switch.press(Presser.PAGE)
    assert asked(page, "POST", path)[0] == 409
    assert not page.switch.is_acknowledged
    page.switch.publish(end="tripped", trip={"cause": "ESTOP"})
    assert asked(page, "POST", path)[0] == 200
    assert page.switch.is_acknowledged


def test_the_cause_of_a_trip_stays_until_it_is_read():
    with looping(60) as (process, ring, switch):
        attendant = attend(ring, switch, page=0)
        at = urllib.parse.urlsplit(attendant.page)

        def ask(method, path):
            connection = http.client.HTTPConnection(at.hostname, at.port, timeout=10)
            with contextlib.closing(connection):
                connection.request(method, at.path + path)
                return json.loads(connection.getresponse().read())

        ask("GET", "data?since=0")
        ask("POST", "stop")
        process.wait(30)
        time.sleep(GONE + 1.0)  # the browser was closed, and is opened again
        shown = ask("GET", "data?since=0")["state"]
        assert (shown["word"], shown["trip"]["cause"], shown["acknowledged"]) == ("TRIPPED", "ESTOP", False)
        ask("POST", "acknowledge")
        assert attendant.process.wait(20) == 0


def test_a_page_that_nobody_opened_keeps_nobody_waiting():
    with looping(60) as (process, ring, switch):
        attendant = attend(ring, switch, page=0)
        Switch(switch).press(Presser.COMMAND_LINE)
        assert attendant.process.wait(60) == 0
        process.wait(30)


def test_stop_reaches_the_loop_within_two_ticks():
    with looping(60) as (process, path, switch):
        reader, arrived = RingReader(path), []

        class Noted:
            def __getattr__(self, name):
                return getattr(opened, name)

            def press(self, presser):
                arrived.append(reader.count)
                opened.press(presser)

        opened = Switch(switch)
        with OperatorPage(Monitor(RingReader(path), opened), Noted()) as page:
            time.sleep(0.3)
            assert asked(page, "POST", f"/{page.token}/stop")[0] == 200
            told = json.loads(process.communicate(timeout=20)[0])
    assert told["rows"] - arrived[0] <= 2


def flat(content):
    """Parse JSON of numbers without depth, and nothing else, as plotting programs expect it."""
    number = r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?"
    assert re.fullmatch(rf'\{{"[\w.\']+":{number}(?:,"[\w.\']+":{number})*\}}', content), content
    return {name: float(value) for name, value in re.findall(rf'"([\w.\']+)":({number})', content)}


def test_datagrams_are_flat_json_with_a_timestamp():
    table = np.array([stub_loop.row(n) for n in range(50)])
    table[7, 1] = np.nan
    path = written(stub_loop.COLUMNS, table)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(10.0)
        datagrams = Datagrams(RingReader(path), f"127.0.0.1:{listener.getsockname()[1]}")
        path.unlink()
        assert datagrams.send() == 50
        for n in range(50):
            got = flat(listener.recv(1 << 16).decode())
            expected = {"timestamp": (n - stub_loop.BEFORE) / 1000.0} | dict(
                zip(stub_loop.COLUMNS, table[n], strict=True)
            )
            assert got == {name: value for name, value in expected.items() if not math.isnan(value)}
        datagrams.close()


@pytest.mark.parametrize("address", ["", "5005", "localhost:", "localhost:0", "localhost:99999", "[::1]"])
def test_an_address_without_host_and_port_is_refused(address):
    path = written(("a",), np.zeros((1, 1)))
    with pytest.raises(MaskingError, match="host and port"):
        Datagrams(RingReader(path), address)
    path.unlink()


def complaints(tab):
    found = [e for e in tab.events if e["method"] in {"Runtime.exceptionThrown", "Log.entryAdded"}]
    tab.events.clear()
    return found


@browser
def test_the_page_shows_the_numbers_of_the_ring_and_stops_the_loop(tab):
    with looping(60) as (process, ring, switch):
        attendant = attend(ring, switch, page=0)
        tab.open(attendant.page)
        tab.wait_for("view.bins.length > 300")
        assert tab.value("document.querySelector('#state b').textContent") == "RUNNING"
        assert tab.wait_for("document.querySelector('.big').textContent") == "180°"
        first, bins, facts = json.loads(tab.value("JSON.stringify([view.first, view.bins, F])"))
        columns = [line["column"] for panel in facts["panels"] for line in panel["lines"]]
        assert columns == ["rig.x1", "rig.x2", "virtual.th1", "virtual.th2"]
        places = [stub_loop.COLUMNS.index(name) for name in columns]
        for number, (low, high) in enumerate(bins, first):
            rows = np.array([stub_loop.row(n) for n in range(20 * number, 20 * (number + 1))])
            assert low[:-1] == rows[:, places].min(axis=0).tolist()
            assert high[:-1] == rows[:, places].max(axis=0).tolist()
        tab.press(" ", "Space")
        tab.wait_for("document.querySelector('#state b').textContent === 'TRIPPED'")
        assert tab.value("document.getElementById('cause').textContent") == "ESTOP"
        assert "release it once the rig is safe" in tab.value("document.getElementById('trip').innerText")
        assert tab.value("document.getElementById('stop').disabled")
        assert json.loads(process.communicate(timeout=20)[0])["stopped"] is not None
        assert attendant.process.is_alive  # until it is acknowledged
        assert complaints(tab) == []
        tab.value("document.getElementById('acknowledge').click()")
        attendant.process.wait(10)
        tab.call("Page.navigate", url="about:blank")


@browser
def test_the_page_says_that_a_loop_was_killed_and_ends_when_it_is_left(tab):
    with looping(1, "--die") as (process, ring, switch):
        attendant = attend(ring, switch, page=0)
        tab.open(attendant.page, dark=True)
        process.wait(30)
        tab.wait_for("document.querySelector('#state b').textContent === 'LOST'")
        assert "without a word" in tab.value("document.getElementById('why').textContent")
        tab.call("Page.navigate", url="about:blank")
        attendant.process.wait(20)
        with pytest.raises(RecordError):
            Switch(switch)
        with pytest.raises(RecordError):
            RingReader(ring)


@browser
def test_everything_fits_on_a_screen(tab, page):
    tab.open(page.address, 1280, 720)
    tab.wait_for("view.answers > 2")
    assert tab.value("document.documentElement.scrollHeight") <= 720
    assert tab.value("document.documentElement.scrollWidth") <= 1280
    assert tab.value("[...document.querySelectorAll('*')].every(e => parseFloat(getComputedStyle(e).fontSize) >= 12)")
    assert tab.value("document.querySelectorAll('[src], link[href]:not([href^=\"data:\"])').length") == 0
    assert complaints(tab) == []


@browser
def test_a_press_that_is_not_answered_is_repeated(tab):
    lost = "if (options.method === 'POST' && presses++ < 3) throw new Error('lost');"
    with looping(60) as (process, ring, switch):
        attendant = attend(ring, switch, page=0)
        tab.open(attendant.page)
        tab.wait_for("view.answers > 2")
        tab.value("window.presses = 0, window.through = window.fetch, 0")
        tab.value(f"window.fetch = async (path, options) => {{ {lost} return through(path, options); }}, 0")
        tab.value("document.getElementById('stop').click()")
        tab.wait_for("document.querySelector('#state b').textContent === 'TRIPPED'")
        assert tab.value("presses") == 4
        assert json.loads(process.communicate(timeout=20)[0])["stopped"] is not None
        tab.value("document.getElementById('acknowledge').click()")
        attendant.process.wait(10)
        tab.call("Page.navigate", url="about:blank")


def test_an_attendant_says_what_is_wrong():
    path, switch = written(("a",), np.zeros((1, 1))), Switch.make()
    with pytest.raises(MaskingError, match="this is no host and port"):
        attend(path, switch.path, stream="nowhere")
    path.unlink()
    switch.remove()
