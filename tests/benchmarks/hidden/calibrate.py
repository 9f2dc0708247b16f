"""Find the amplitudes of `amplitudes.py`: `python -m tests.benchmarks.hidden.calibrate [effect@place ...]`.

Every effect acts alone in the declared rig, under the reference excitation of 60 s, at a step of 1 ms (its error is
below 1e-5 V). A secant method in the logarithms of the amplitude and of chi runs for all of them side by side.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from tests.benchmarks.hidden.catalogue import CHI, PLACED, parameters
from tests.benchmarks.hidden.excitation import Signals, channel, commands, signals, training
from tests.benchmarks.hidden.rig import Array, Damping, Rigs, declared
from tests.benchmarks.hidden.simulate import Batch, Hidden

SECONDS = 60.0
REFERENCE_SEED = 20080049
ROUNDS = 8
CLOSE = 0.03  # of chi
LARGEST_STEP = 1.5  # of a logarithm


def reference(damping: Damping) -> Array:
    """Return the commands (samples, 3, 1) in V of the reference excitation."""
    return commands(training, SECONDS, [[REFERENCE_SEED]], [damping])


def changes(keys: list[str], amplitudes: Array, told: Array, known: Signals, damping: Damping) -> Array:
    """Return chi (effects, 3) of each channel for each effect alone, in the declared rig under commands `told`."""
    effects = []
    for key, amplitude in zip(keys, amplitudes, strict=True):
        entry, place = PLACED[key]
        effects.append([Hidden(entry.effect, place, parameters(key, float(amplitude), known, known.levels))])
    rigs = Rigs(np.repeat(declared(damping)[None], len(keys), axis=0))
    batch = Batch(rigs, effects)
    readings = batch.quantised(batch.readings(batch.motion(np.repeat(told, len(keys), axis=2), substeps=1)))
    without = known.readings[:, :, None]
    gap: Array = np.sqrt(((readings - without) ** 2).mean(axis=0) / (without**2).mean(axis=0))
    return gap.T


def first_amplitude(key: str, known: Signals) -> float:
    """Return a first amplitude for a chi of 0.03."""
    entry, place = PLACED[key]
    part = {"dead_zone": 0.03, "dac_quantisation": 0.3, "actuator_offset": 0.03, "actuator_cubic": 0.02}
    if entry.effect in part:
        return float(part[entry.effect] * known.levels[channel(place)] ** entry.power)
    return entry.first


def search(places: list[str], damping: Damping) -> tuple[Array, Array]:
    """Return amplitudes and chi (places, 3 strengths) of effects by name and place."""
    goal = np.log(np.tile(list(CHI.values()), len(places)))
    keys = [key for key in places for _ in CHI]
    told = reference(damping)
    (known,) = signals(told, [damping])
    log = np.log([first_amplitude(key, known) for key in keys]) + goal - np.log(0.03)
    free = np.array([PLACED[key][0].fixed is None for key in keys])
    for row, key in enumerate(keys):
        log[row] = np.log((PLACED[key][0].fixed or [np.exp(log[row])] * 3)[row % 3])
    slope, low, high = np.ones(len(keys)), np.full(len(keys), -np.inf), np.full(len(keys), np.inf)
    best, reached = log.copy(), np.full(len(keys), np.inf)
    before = (log, np.full(len(keys), np.nan))
    for n in range(ROUNDS):
        began = time.perf_counter()
        todo = np.flatnonzero((np.abs(reached - goal) > CLOSE) & (free | (n == 0)))
        if not len(todo):
            break
        got = np.full(len(keys), np.nan)
        found = changes([keys[i] for i in todo], np.exp(log[todo]), told, known, damping).max(axis=1)
        got[todo] = np.log(np.maximum(np.nan_to_num(found, nan=1e3), 1e-9))
        better = np.abs(got - goal) < np.abs(reached - goal)
        best[better], reached[better] = log[better], got[better]
        low, high = np.where(got < goal, np.fmax(low, log), low), np.where(got > goal, np.fmin(high, log), high)
        with np.errstate(all="ignore"):
            secant = (got - before[1]) / (log - before[0])
        slope = np.where(np.isfinite(secant) & (secant > 0.2), np.minimum(secant, 12.0), slope)
        before = (log, got)
        trial = log + np.clip((goal - got) / slope, -LARGEST_STEP, LARGEST_STEP)
        with np.errstate(all="ignore"):
            trial = np.where((trial <= low) | (trial >= high), (low + high) / 2.0, trial)
        log = np.where(np.isfinite(trial) & free, trial, log)
        print(
            f"{damping} round {n}: {len(todo)} left, {time.perf_counter() - began:.0f} s", file=sys.stderr, flush=True
        )
    return np.exp(best).reshape(-1, 3), np.exp(reached).reshape(-1, 3)


def main() -> None:
    """Print the levels of the reference excitation and the lines of the table."""
    places = sys.argv[1:] or list(PLACED)
    dampings: tuple[Damping, ...] = ("own", "light")
    found = {damping: search(places, damping) for damping in dampings}
    lines = []
    for row, key in enumerate(places):
        amplitudes = ", ".join(f"({', '.join(f'{a:.4g}' for a in found[d][0][row])})" for d in found)
        chi = "; ".join(" ".join(f"{c:.3f}" for c in found[d][1][row]) for d in found)
        lines.append(f'    "{key}": ({amplitudes}),  # {chi}')
    for damping in dampings:
        print(f'    "{damping}": np.array({np.round(signals(reference(damping), [damping])[0].levels, 6).tolist()}),')
    print("\n".join(lines))


if __name__ == "__main__":
    main()
