"""Rows of a loop in memory: no reader gets a torn row, each knows what it missed, and rows outlive their writer."""

import contextlib
import subprocess
import sys
import time

import numpy as np
import pytest

from masking.errors import RecordError
from masking.lab.records.ring import Ring, RingReader

pytestmark = pytest.mark.realtime

WRITER = """
import os, sys, time
import numpy as np
from masking.lab.records.ring import Ring
ring = Ring([f"c{i}" for i in range(40)], 1000.0, {"c0": "V"}, rows=256, name="test")
print(ring.path, flush=True)
sys.stdin.readline()
row = np.empty(40)
for n in range(int(sys.argv[1])):
    row[:] = n
    ring.put(row)
os.kill(os.getpid(), 9)
"""


@contextlib.contextmanager
def written(rows):
    """Give a process that waits for a line before it writes rows and is killed, and a reader of its ring."""
    command = [sys.executable, "-c", WRITER, str(rows)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        reader = RingReader(process.stdout.readline().strip())
        yield process, reader
    reader.path.unlink()


def test_no_row_is_torn_and_every_missed_one_is_counted():
    with written(200_000) as (process, reader):
        process.stdin.write("\n")
        process.stdin.flush()
        expected, until = 0, time.monotonic() + 60.0
        while reader.next < 200_000 and time.monotonic() < until:
            taken = reader.take()
            assert taken.first == expected + taken.missed
            numbers = taken.first + np.arange(len(taken.table))
            np.testing.assert_array_equal(taken.table, np.repeat(numbers[:, None], 40, axis=1))
            expected = taken.first + len(taken.table)
    assert expected == 200_000


def test_rows_outlive_a_writer_that_is_killed():
    with written(100) as (process, reader):
        process.communicate("\n", timeout=30)
        assert process.returncode == -9
        assert (reader.columns[0], reader.rate, reader.units, reader.facts["name"]) == (
            "c0",
            1000.0,
            {"c0": "V"},
            "test",
        )
        assert (reader.process, reader.is_closed) == (process.pid, False)
        taken = reader.take()
        assert (taken.first, taken.missed, len(taken.table)) == (0, 0, 100)
        assert len(reader.take().table) == 0


def test_a_reader_takes_parts_and_the_newest():
    ring = Ring(["t"], 10.0, rows=16)
    reader, other = RingReader(ring.path), RingReader(ring.path)
    for n in range(5):
        ring.put(np.array([float(n)]))
    assert reader.take(2).table.ravel().tolist() == [0.0, 1.0]
    assert reader.take().table.ravel().tolist() == [2.0, 3.0, 4.0]
    assert other.last(2).table.ravel().tolist() == [3.0, 4.0]
    for n in range(5, 40):
        ring.put(np.array([float(n)]))
    taken = reader.take()
    assert taken.missed == 20
    assert taken.table.ravel().tolist() == list(range(25, 40))
    ring.close()
    assert reader.is_closed
    assert not ring.path.exists()


@pytest.mark.parametrize("content", [b"", b"MASKRING", b"x" * 200, b"MASKRING" + b"\x7f" * 100])
def test_what_is_no_ring_is_refused(tmp_path, content):
    (tmp_path / "ring").write_bytes(content)
    with pytest.raises(RecordError, match="no ring of rows"):
        RingReader(tmp_path / "ring")
    with pytest.raises(RecordError, match="no ring of rows"):
        RingReader(tmp_path / "none")
