"""Measure: `python -m tests.benchmarks.independent [COUNT] [SEED] [EFFECT ...] [real]`, COUNT records of each effect.

With `real`, each rig has imperfections beside its effect.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from scipy import stats

from masking import discover
from masking.errors import MaskingError
from tests.benchmarks.independent.cases import EFFECTS, GOOD, IMPERFECT, LIKE, REAL, Case


def judged(case: Case) -> tuple[str, str]:
    """Return how right the answer to a case is, and the answer in words."""
    u, x = case.told
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "model.yaml").write_text(case.rig.model())
        np.savez(Path(folder) / "record.npz", **case.rig.columns(case.times, u, x))
        try:
            found = discover(Path(folder) / "record.npz", model=Path(folder) / "model.yaml", tolerance=case.quality.off)
        except MaskingError as error:
            return "error", str(error)
    told = [(cause.name, cause.on) for cause in found.effects]
    left = max(found.simulation_error.validation[1].values()) / case.quality.noise
    words = f"{found.verdict} {told} left {left:.2f}"
    name, place = case.truth
    at = {place, f"x{place[-1]}"} if place == f"spring{case.rig.size}" else {place}  # of the last, from the ground
    beside = set() if case.quality is GOOD else {*IMPERFECT} - {name}
    others = [one for one in told if one[0] not in beside]
    # Offsets of a sensor and of a force are the same while a rig is linear: which of them it is, is open.
    last = {one for cause in found.effects[-1:] for one in (cause.name, *(other for other, _, _ in cause.alternatives))}
    is_sure = found.verdict == "named" or (found.verdict == "ambiguous" and last <= beside)
    if is_sure and len(others) == 1 and others[0][0] == name and others[0][1] in at:
        return "strict", words
    if any(one in LIKE[name] and on in at for one, on in told):
        return "class", words
    return ("open" if found.verdict in {"unknown", "ambiguous"} else "wrong"), words


def interval(right: int, whole: int) -> str:
    """Return a share with its 95 % interval of Clopper and Pearson."""
    low = stats.beta.ppf(0.025, right, whole - right + 1) if right else 0.0
    high = stats.beta.ppf(0.975, right + 1, whole - right) if right < whole else 1.0
    return f"{right}/{whole} = {right / whole:.0%} ({low:.0%} to {high:.0%})"


def main(arguments: list[str]) -> None:
    """Print each record, then the shares."""
    numbers = [int(one) for one in arguments if one.isdigit()]
    count, seed = [*numbers, *(2, 1)[len(numbers) :]][:2]
    effects = [one for one in arguments if one in EFFECTS] or [*EFFECTS]
    quality = REAL if "real" in arguments else GOOD
    found = Counter[str]()
    for i in range(seed, seed + count):
        for effect in effects:
            case, begin = Case(i, effect, quality), time.monotonic()
            _ = case.told
            middle = time.monotonic()
            how, words = judged(case)
            found[how] += 1
            seconds = f"{middle - begin:.0f} + {time.monotonic() - middle:.0f} s"
            print(f"{how:6s} {i} {' at '.join(case.truth)}, {case.rig.size} masses: {words}; {seconds}", flush=True)
    whole = sum(found.values())
    print("strictly right:", interval(found["strict"], whole))
    print("class right:   ", interval(found["strict"] + found["class"], whole))
    print("left open:     ", interval(found["open"], whole))
    print("wrong:         ", interval(found["wrong"] + found["error"], whole))


if __name__ == "__main__":
    main(sys.argv[1:])
