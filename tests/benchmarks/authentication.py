"""What a tag costs: to add it to a frame and to check it, with keyed BLAKE2b and with HMAC-SHA256, in turn."""

from __future__ import annotations

import hmac
import timeit
from collections.abc import Callable, Iterator

import numpy as np

from masking.lab.plants import wire
from masking.lab.plants.authentication import TAG, Key
from masking.lab.plants.wire import Kind
from tests.benchmarks.table import Row, few, limited

CALLS, ROUNDS = 2000, 200
MOST = 5.0  # us
SENSORS = 3
BOUNDS = (1, 2, 5, 10, 20, 50, 100)


def rows() -> Iterator[Row]:
    """Measure a frame of three sensors."""
    ours, theirs, plain = microseconds()
    note = f"frame of {SENSORS} sensors, both sides together; to write and read it without a tag takes {plain:.1f} us"
    what = "tag of a frame: add and check, beside HMAC-SHA256"
    yield limited(what, f"{ours:.2f} us", f"{theirs:.2f} us", ours, at_most=MOST, unit="us", note=note)


def microseconds() -> tuple[float, float, float]:
    """Return what a tag takes in us, added and checked, ours and with HMAC-SHA256, and what the frame takes without."""
    values = np.ones(SENSORS)
    frame = wire.encode(Kind.SENSORS, 7, 1, values=values)
    tags, key = Key(b"a key for the benchmark").tags(7, b"a nonce of the server")[0], bytes(64)

    def ours() -> None:
        assert tags.is_on(tags.add(frame))

    def theirs() -> None:
        tagged = frame + hmac.digest(key, frame, "sha256")[:TAG]
        assert hmac.compare_digest(hmac.digest(key, tagged[:-TAG], "sha256")[:TAG], tagged[-TAG:])

    def plain() -> None:
        wire.decode(wire.encode(Kind.SENSORS, 7, 1, values=values))

    found = shortest(ours, theirs, plain)
    return found[0], found[1], found[2]


def shortest(*calls: Callable[[], object]) -> list[float]:
    """Return the shortest time of a call of each function in us, measured in turn."""
    timers = [timeit.Timer(call) for call in calls]
    rounds = [[timer.timeit(CALLS) for timer in timers] for _ in range(few(ROUNDS))]
    return [min(times) / CALLS * 1e6 for times in zip(*rounds, strict=True)]


def bound(time: float) -> str:
    """Return the next round number of us, which a slower moment of the same machine keeps to."""
    return f"{next(most for most in BOUNDS if most > 1.2 * time)} us"
