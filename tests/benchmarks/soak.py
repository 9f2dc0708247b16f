"""Soak: a controller that is killed a thousand times, and a million mutated frames.

    python -m tests.benchmarks.soak --kills 1000 --frames 1000000

Controllers run on a served twin at 1 kHz and are killed at random instants; the plant's own record says when its
commands were zero. Then, in lockstep, each frame of a sound run comes with mutated ones on both ways: bytes changed,
cut off, added or all random, and sound frames of any kind from other sessions. Only the sound ones may act.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np

from masking.errors import MaskingError
from masking.lab.plants import wire
from masking.lab.plants.wire import Kind
from masking.lab.records.recording import Recording
from tests.campaigns.bench import Bench
from tests.campaigns.damage import DamagedPlant
from tests.campaigns.processes import LATEST, zero_after

MANY = 25  # mutated frames with each sound one
CHUNK = 4000  # samples of a run
LATE = 0.02  # s after it runs, within which a controller is killed


def kills(number: int, folder: Path) -> Counter[int]:
    """Kill controllers; return how many ticks later the plant was at zero, how often; -1 where it did not latch."""
    bench, random, found = Bench(folder), np.random.default_rng(), Counter[int]()
    try:
        for _ in range(number):
            served = bench.served(lockstep=False)
            with bench.controller(served.address) as controller:
                time.sleep(float(random.uniform(0.0, LATE)))
            found[_judged(served.record(), controller.said)] += 1
    finally:
        bench.close()
    return found


def _judged(own: Recording, said: object) -> int:
    """Return how many ticks later a plant was at zero; -1 where it did not stay there, or nothing ran."""
    latch = own.manifest["latch"]
    if latch is None or said != "running" or own.array("input")[own["tick"] >= latch["tick"]].any():
        return -1
    return zero_after(own)


def mutated(sound: bytes, random: np.random.Generator) -> list[bytes]:
    """Return frames that a receiver must not use."""
    frame, found = wire.decode(sound), list[bytes]()
    for _ in range(MANY):
        what, changed = random.integers(5), bytearray(sound)
        if what == 0:
            for at in random.integers(0, len(changed), random.integers(1, 9)):
                changed[at] ^= int(random.integers(1, 256))
        elif what == 1:
            changed = changed[: random.integers(0, len(changed))]
        elif what == 2:
            at = random.integers(0, len(changed) + 1)
            changed[at:at] = random.bytes(int(random.integers(1, 40)))
        elif what == 3:
            changed = bytearray(random.bytes(int(random.integers(0, 300))))
        else:
            kind = Kind(int(random.integers(1, 10)))
            more = {"text": "{}"} if kind in wire.TEXTUAL else {"values": frame.values + 3.0}
            changed = bytearray(wire.encode(kind, int(random.integers(1, 2**62)), frame.index + 1, **more))
        if changed != sound:
            found.append(bytes(changed))
    return found


def frames(number: int, folder: Path) -> tuple[int, int]:
    """Mutate frames; return how many there were, and how many commands and samples were other than those sent."""
    bench, random, many, wrong = Bench(folder), np.random.default_rng(), 0, 0

    def spoil(sound: bytes) -> list[bytes]:
        nonlocal many
        found = mutated(sound, random)
        many += len(found)
        return found

    try:
        while many < number:
            ended = bench.run(samples=CHUNK, made=partial(DamagedPlant, spoil=spoil))
            if ended.run.reason != "finished":
                raise MaskingError(f"after {many} mutated frames: {ended.cause or ended.run.reason}")
            rows = len(ended.run.applied) - 1
            wrong += int((ended.own.array("input")[:rows] != ended.run.applied[:rows]).any(axis=1).sum())
            sensors = ended.own.array("sensor")[: len(ended.run.sensors)]
            wrong += int((sensors != ended.run.sensors[: len(sensors)]).any(axis=1).sum())
    finally:
        bench.close()
    return many, wrong


def main() -> int:
    """Print what was found; return 1 where a criterion is not met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--frames", type=int, default=1_000_000)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="masking-soak-") as name:
        began = time.monotonic()
        found = kills(chosen.kills, Path(name) / "kills")
        spread = ", ".join(f"{ticks}: {many}" for ticks, many in sorted(found.items()))
        print(f"{chosen.kills} kills, ticks to zero: {spread} ({time.monotonic() - began:.0f} s)", flush=True)
        began = time.monotonic()
        many, wrong = frames(chosen.frames, Path(name) / "frames")
        print(f"{many} mutated frames: {wrong} acted ({time.monotonic() - began:.0f} s)")
    return int(bool(wrong) or any(not 0 <= ticks <= LATEST for ticks in found))


if __name__ == "__main__":
    sys.exit(main())
