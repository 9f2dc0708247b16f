"""A stream: what is cut is an exact prefix, what is changed is found, a full disk loses nothing promised."""

import contextlib
import errno
import itertools
import json
import os
import resource
import signal
import subprocess
import sys
import time
from hashlib import blake2b

import numpy as np
import pytest

from masking.errors import RecordError
from masking.lab.records import child_process, recorder, ring, stream, stream_pages, stream_reader
from masking.lab.records.recorder import Recorder

pytestmark = pytest.mark.realtime

WIDTH = 5
TABLE = np.random.default_rng(3).standard_normal((400, WIDTH))
COLUMNS = {f"c{i}": {"unit": "V", "meaning": ""} for i in range(WIDTH)}


def begun(folder, spare=None):
    """Begin a stream; give its writer."""
    content = {"columns": COLUMNS, "rate": 1000.0, "spare": str(spare or folder), "number": "1f"}
    stream.begin(folder, content)
    return stream.StreamWriter(folder)


def add(writer, until, seed=0):
    """Add the rows of the table in pages of any size."""
    sizes = np.random.default_rng(seed)
    while writer.next < until:
        first = writer.next
        writer.append(first, TABLE[first : min(until, first + int(sizes.integers(1, 25)))])


@pytest.fixture
def whole(tmp_path):
    """Return a folder with a stream that ended in order, and its bytes."""
    writer = begun(tmp_path / "run")
    add(writer, 400)
    writer.end({"why": "closed"})
    return tmp_path / "run", (tmp_path / "run" / stream.ROWS).read_bytes()


def is_part_of_the_table(found):
    return np.array_equal(found.table, TABLE[found.numbers]) and np.all(np.diff(found.numbers) > 0)


def test_what_was_written_is_read(whole):
    found = stream_reader.read(whole[0])
    np.testing.assert_array_equal(found.table, TABLE)
    assert found.numbers.tolist() == list(range(400))
    assert (found.damages, found.end) == ((), {"why": "closed"})
    assert list(found.manifest["columns"]) == list(COLUMNS)


def test_a_cut_at_any_byte_reads_as_an_exact_prefix(whole):
    folder, data = whole
    last = 0
    for at in np.sort(np.random.default_rng(1).integers(0, len(data), 200)):
        (folder / stream.ROWS).write_bytes(data[:at])
        found = stream_reader.read(folder)
        np.testing.assert_array_equal(found.table, TABLE[: len(found.table)])
        assert last <= len(found.table)
        assert (found.damages, found.end) == ((), None)
        last = len(found.table)
    assert last > 300


def test_every_changed_byte_is_found_and_costs_its_page_alone(whole):
    folder, data = whole
    where = np.random.default_rng(2)
    for _ in range(200):
        at, by = int(where.integers(len(data))), int(where.integers(1, 256))
        (folder / stream.ROWS).write_bytes(data[:at] + bytes([data[at] ^ by]) + data[at + 1 :])
        found = stream_reader.read(folder)
        assert len(found.damages) == 1, at
        assert is_part_of_the_table(found)
        lost = sorted({*range(400)} - {*found.numbers.tolist()})
        assert len(lost) <= 24
        if lost:
            assert f"rows {lost[0]} to {lost[-1]}" in found.damages[0]


def test_a_changed_manifest_is_found_and_its_copy_is_used(whole):
    folder, _ = whole
    text = (folder / stream.MANIFEST).read_bytes()
    for at in range(0, len(text), 7):
        (folder / stream.MANIFEST).write_bytes(text[:at] + bytes([text[at] ^ 1]) + text[at + 1 :])
        found = stream_reader.read(folder)
        assert found.damages == ("stream.json was changed or is missing; its copy in stream.rows was used",)
        assert is_part_of_the_table(found)
        assert len(found.table) == 400
    (folder / stream.MANIFEST).unlink()
    assert len(stream_reader.read(folder).table) == 400


def test_pages_that_are_removed_exchanged_or_repeated_are_found(whole):
    folder, data = whole
    starts = [at for at in range(len(data)) if data.startswith(b"MASKPAGE", at)] + [len(data)]
    parts = [data[a:b] for a, b in itertools.pairwise(starts)]
    head = data[: starts[0]]
    removed = [*parts[:5], *parts[6:]]
    exchanged = [*parts[:5], parts[6], parts[5], *parts[7:]]
    repeated = [*parts[:6], parts[5], *parts[6:]]
    for changed in (removed, exchanged, repeated):
        (folder / stream.ROWS).write_bytes(head + b"".join(changed))
        found = stream_reader.read(folder)
        assert found.damages
        assert is_part_of_the_table(found)
        assert len(found.table) > 300


def test_a_writer_goes_on_behind_the_last_whole_page(tmp_path):
    writer = begun(tmp_path)
    add(writer, 150)
    writer.close()
    rows = tmp_path / stream.ROWS
    rows.write_bytes(rows.read_bytes()[:-7])
    writer = stream.StreamWriter(tmp_path)
    assert 120 < writer.next < 150
    add(writer, 400, seed=1)
    writer.end({"why": "closed"})
    found = stream_reader.read(tmp_path)
    np.testing.assert_array_equal(found.table, TABLE)
    assert found.damages == ()


def test_where_bringing_to_disk_fails_the_second_place_goes_on(tmp_path, monkeypatch):
    writer = begun(tmp_path / "run", tmp_path / "spare")
    add(writer, 100)

    def fails(_):
        raise OSError(errno.EIO, "Input/output error")

    with monkeypatch.context() as patched:
        patched.setattr(stream.os, "fdatasync", fails)
        writer.sync()
    add(writer, 400, seed=1)
    writer.end({"why": "closed"})
    found = stream_reader.read(tmp_path / "run")
    np.testing.assert_array_equal(found.table, TABLE)
    assert (found.damages, writer.moved) == ((), 1)
    spare = next((tmp_path / "spare").iterdir())
    spare.write_bytes(spare.read_bytes()[:-30])
    cut = stream_reader.read(tmp_path / "run")
    assert (len(cut.table), cut.damages, cut.end) == (400, (), None)


def test_a_second_writer_and_a_reader_are_told_to_wait(tmp_path):
    writer = begun(tmp_path)
    with pytest.raises(RecordError, match="another process records into this stream"):
        stream.StreamWriter(tmp_path)
    with pytest.raises(RecordError, match="is being recorded into this stream"):
        stream_reader.read(tmp_path)
    writer.close()


def test_a_folder_with_a_stream_is_not_written_over(whole):
    with pytest.raises(RecordError, match=r"did not end in order; make a recording of it by 'masking recover .*run'"):
        stream.begin(whole[0], {})
    stream.remove(whole[0])
    assert not list(whole[0].iterdir())
    with pytest.raises(RecordError, match="holds no stream of a run"):
        stream_reader.read(whole[0])


# --- with a recorder in a process of its own --------------------------------------------------------------------------


def fed(rows, made, rate=1000.0, kill=()):
    """Put rows that begin with their number at a rate; kill the recorder at some; return how soon this is seen."""
    row, noticed, killed = np.zeros(WIDTH), [], None
    for n in range(rows):
        row[:] = n
        made.ring.put(row)
        if n in kill:
            os.kill(made.process, signal.SIGKILL)
            killed = (made.ended, time.monotonic())
        if killed and made.ended > killed[0]:
            noticed.append(time.monotonic() - killed[1])
            killed = None
        time.sleep(1.0 / rate)
    return noticed


def fed_in_pages(rows, made, size=20):
    """Put rows that begin with their number, a few at a time: the next once these are on disk, or no place is left."""
    row, until = np.zeros(WIDTH), time.monotonic() + 60.0
    for n in range(rows):
        row[:] = n
        made.ring.put(row)
        while n % size == size - 1 and not made.is_full and stream.written(made.folder) <= n:
            assert time.monotonic() < until
            time.sleep(0.001)


def test_a_recorder_that_is_killed_is_replaced_and_no_row_is_lost(tmp_path):
    made = Recorder(tmp_path, COLUMNS, 1000.0, tmp_path)
    noticed = fed(900, made, kill=(100, 450))
    made.close()
    found = stream_reader.read(tmp_path)
    assert found.table[:, 0].tolist() == list(range(900))
    assert found.end["why"] == recorder.CLOSED
    assert found.damages == ()
    assert len(noticed) == 2
    assert max(noticed) < 0.2
    assert made.note == "2 recorders were killed and replaced"
    assert not made.ring.path.exists()


def test_after_too_many_deaths_it_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder, "STARTS", 2)
    made = Recorder(tmp_path, COLUMNS, 1000.0, tmp_path)
    for _ in range(2):
        killed, until = made.process, time.monotonic() + 5.0
        os.kill(killed, signal.SIGKILL)
        while made.process == killed and time.monotonic() < until:
            time.sleep(0.01)
    assert made.is_lost
    fed(5, made)
    made.close()
    assert made.lost == 5
    assert made.note == (
        "2 recorders were killed, and no other was started: what followed was not streamed; 5 rows were not streamed"
    )


WRITER = """
import os, sys, time
import numpy as np
from masking.lab.records.recorder import Recorder
made = Recorder(sys.argv[1], {f"c{i}": {"unit": "V", "meaning": ""} for i in range(5)}, 1000.0, sys.argv[1])
row = np.zeros(5)
for n in range(100_000):
    row[:] = n
    made.ring.put(row)
    if n == int(sys.argv[2]):
        os.kill(os.getpid(), 9)
    time.sleep(0.001)
"""


@pytest.mark.parametrize("row", [0, 13, 200])
def test_of_a_loop_that_is_killed_no_row_is_lost(tmp_path, row):
    subprocess.run([sys.executable, "-c", WRITER, str(tmp_path), str(row)], check=False, timeout=30)
    until = time.monotonic() + 10.0
    found = None
    while (found is None or found.end is None) and time.monotonic() < until:
        with contextlib.suppress(RecordError):
            found = stream_reader.read(tmp_path)
        time.sleep(0.02)
    assert found.end["why"] == recorder.KILLED
    assert found.table[:, 0].tolist() == list(range(row + 1))


def limited(monkeypatch, size):
    """Let recorders write at most a number of bytes into one file."""
    start = subprocess.Popen

    def popen(command, **more):
        return start(command, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)), **more)

    monkeypatch.setattr(child_process.subprocess, "Popen", popen)


def test_where_the_disk_is_full_the_rest_goes_to_the_second_place(tmp_path, monkeypatch):
    limited(monkeypatch, 40_000)
    made = Recorder(tmp_path / "run", COLUMNS, 1000.0, tmp_path / "spare")
    fed_in_pages(1000, made)
    made.close()
    found = stream_reader.read(tmp_path / "run")
    assert found.table[:, 0].tolist() == list(range(1000))
    assert (found.end["moved"], found.damages) == (1, ())
    assert len(list((tmp_path / "spare").iterdir())) == 1
    stream.remove(tmp_path / "run")
    assert not list((tmp_path / "spare").iterdir())


def test_where_both_places_are_full_it_is_said_and_what_is_there_is_sound(tmp_path, monkeypatch):
    limited(monkeypatch, 20_000)
    made = Recorder(tmp_path / "run", COLUMNS, 1000.0, tmp_path / "spare")
    fed_in_pages(2000, made)
    assert made.is_full
    made.close()
    found = stream_reader.read(tmp_path / "run")
    assert made.lost == 2000 - len(found.table)
    lost = f"{made.lost} rows were not streamed"
    assert made.note == f"no place was left for the stream of the run: it was stopped; {lost}"
    assert 300 < len(found.table) < 1000
    assert found.table[:, 0].tolist() == list(range(len(found.table)))
    assert (found.end, found.damages) == (None, ())


def test_a_recorder_whose_messages_find_no_place_says_by_its_status_that_the_disk_is_full(tmp_path):
    made = ring.Ring(list(COLUMNS), 1000.0)
    stream.begin(tmp_path / "run", {"columns": COLUMNS, "rate": 1000.0, "spare": str(tmp_path), "number": "1"})
    command = [sys.executable, "-m", "masking.lab.records.recorder", str(made.path), str(tmp_path / "run")]
    try:
        with (tmp_path / "errors").open("wb") as errors:
            ended = subprocess.run(
                command, stdout=subprocess.PIPE, stderr=errors, timeout=60, check=False,
                preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1, 1)),
            )  # fmt: skip
    finally:
        made.close()
    assert ended.returncode == recorder.FULL
    assert (tmp_path / "errors").stat().st_size == 1


def test_pages_are_as_their_documentation_says():
    """The layout and the chain, written out again."""
    page = stream_pages.page_bytes(b"c" * 16, 7, stream_pages.DATA, b"12345678", first=3, rows=1, width=1)
    head = b"MASKPAGE" + b"".join(
        n.to_bytes(size, "little") for n, size in ((7, 8), (3, 8), (1, 4), (1, 4), (0, 4), (8, 4))
    )
    check = blake2b(head, digest_size=8).digest()
    chain = blake2b(b"c" * 16 + head + b"12345678", digest_size=16).digest()
    assert page == head + check + b"12345678" + chain


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text(json.dumps({}))
    with pytest.raises(RecordError, match="no stream can be written"):
        Recorder(tmp_path / "file", COLUMNS, 1000.0, tmp_path)
