"""Records of cases: training and validation, made in batches, kept in one file; and the gaps that effects make."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from tests.benchmarks.hidden.cases import (
    DIRT,
    NOISE,
    TRAINING,
    VALIDATION,
    VALIDATION_NOISE,
    Case,
    rig_of,
)
from tests.benchmarks.hidden.excitation import commands, training, validation
from tests.benchmarks.hidden.rig import RATE, SENSOR_GAIN, Array, Rigs, linear_response
from tests.benchmarks.hidden.simulate import Batch, Hidden

SUBSTEPS = 2  # of a sample: readings are right to 5e-6 V
AT_ONCE = 64  # cases in one batch, with two records each
INPUT_NOISE = 0.01  # of an input's rms, white, held over samples, in dirty records
COLOURED = 0.5  # part of the variance of a dirty reading's noise
CORRELATION = 0.05  # s: time constant of coloured noise
SMALL = 1e-4  # relative change of a parameter, for slopes


@dataclass(frozen=True)
class Record:
    """What is known of a run: times (m,) in s, commands (m, 3) and readings (m, 3) in V.

    Row k holds the readings at t[k] and the commands from then on until t[k + 1].
    """

    t: Array
    commands: Array
    readings: Array


def generate(
    cases: Sequence[Case], seconds: float = 60.0, validation_seconds: float = 60.0
) -> list[tuple[Case, Record, Record]]:
    """Return each case with a record for training and one for validation, in V and s.

    The rig starts both at rest in its equilibrium under zero commands, which a constant force or an offset shifts.
    """
    made: list[tuple[Case, Record, Record]] = []
    for start in range(0, len(cases), AT_ONCE):
        few = cases[start : start + AT_ONCE]
        told = _commands(few, seconds, validation_seconds)
        readings = _readings(few, told)
        ends = [round(seconds * RATE), round(validation_seconds * RATE)]
        for i, case in enumerate(few):
            records = []
            for row, end in zip((i, i + len(few)), ends, strict=True):
                parts = (x[:end, :, row].copy() for x in (told, readings))
                records.append(Record(np.arange(end) / RATE, *parts))
            made.append((case, records[0], records[1]))
    return made


def gaps(cases: Sequence[Case], seconds: float = 60.0, *, left: bool = False) -> Array:
    """Return chi (cases, 3): how far what is hidden moves each reading of the training record, relatively.

    There is no noise. The reference is the same rig without hidden effects, with its parameters as declared but for the
    base error. With `left`, what small changes of the eleven parameters explain is taken off first, by one fit to all
    three readings.
    """
    parts = [_gaps(cases[i : i + AT_ONCE], seconds, left=left) for i in range(0, len(cases), AT_ONCE)]
    return np.concatenate(parts) if parts else np.zeros((0, 3))


def _gaps(cases: Sequence[Case], seconds: float, *, left: bool) -> Array:
    told = commands(training, seconds, [[c.seed, TRAINING] for c in cases], [c.damping for c in cases])
    batch = Batch(Rigs(np.array([rig_of(c) for c in cases])), [(*c.hidden, *c.imperfections) for c in cases])
    values = np.array([rig_of(c, off=False) for c in cases])
    without = SENSOR_GAIN * linear_response(Rigs(values), told)
    gap = batch.quantised(batch.readings(batch.motion(told, substeps=SUBSTEPS))) - without
    size = np.sqrt((without**2).mean(axis=0))
    if left:
        slopes = np.empty((values.shape[1], *gap.shape))
        for i in range(values.shape[1]):
            moved = values.copy()
            moved[:, i] *= 1.0 + SMALL
            slopes[i] = (SENSOR_GAIN * linear_response(Rigs(moved), told) - without) / SMALL
        for row in range(len(cases)):
            matrix = (slopes[:, :, :, row] / size[:, row]).reshape(len(slopes), -1).T
            fitted = np.linalg.lstsq(matrix, (gap[:, :, row] / size[:, row]).ravel(), rcond=None)[0]
            gap[:, :, row] -= np.tensordot(fitted, slopes[:, :, :, row], axes=1)
    chi: Array = np.sqrt((gap**2).mean(axis=0)) / size
    return chi.T


def _commands(cases: Sequence[Case], seconds: float, validation_seconds: float) -> Array:
    """Return the commands (samples, 3, 2 cases) in V of all trainings, then of all validations; short ones end in 0."""
    n = len(cases)
    told = np.zeros((round(max(seconds, validation_seconds) * RATE), 3, 2 * n))
    dampings = [case.damping for case in cases]
    for start in range(0, n, 16):
        few = range(start, min(start + 16, n))
        for shift, span, shapes, stream in (
            (0, seconds, training, TRAINING),
            (n, validation_seconds, validation, VALIDATION),
        ):
            part = commands(shapes, span, [[cases[i].seed, stream] for i in few], [dampings[i] for i in few])
            told[: len(part), :, [i + shift for i in few]] = part
    return told


def _readings(cases: Sequence[Case], told: Array) -> Array:
    """Return the readings (samples, 3, 2 cases) in V with noise, quantised last."""
    twice = (*cases, *cases)
    batch = Batch(Rigs(np.array([rig_of(c) for c in twice])), [(*c.hidden, *c.imperfections) for c in twice])
    disturbance = None
    if any(case.dirty for case in cases):
        disturbance = np.zeros_like(told)
        for row, case in enumerate(twice):
            if case.dirty:
                rng = np.random.default_rng([case.seed, DIRT, int(row >= len(cases))])
                size = INPUT_NOISE * np.sqrt((told[:, :, row] ** 2).mean(axis=0))
                disturbance[:, :, row] = size * rng.standard_normal(told.shape[:2])
    readings = batch.readings(batch.motion(told, disturbance, substeps=SUBSTEPS))
    noise = np.empty_like(readings)
    for row, case in enumerate(twice):
        noise[:, :, row] = case.random(NOISE if row < len(cases) else VALIDATION_NOISE).standard_normal(told.shape[:2])
    rows = [row for row, case in enumerate(twice) if case.dirty]
    if rows:
        noise[:, :, rows] = _half_coloured(noise[:, :, rows], [(twice[r].seed, 2 + (r >= len(cases))) for r in rows])
    noise *= np.array([case.noise for case in twice])
    return batch.quantised(readings + noise)


def _half_coloured(white: Array, seeds: Sequence[tuple[int, int]]) -> Array:
    """Return noise (samples, 3, records) of variance 1, a part of it from a filter of first order, by white noise."""
    keep = np.exp(-1.0 / (RATE * CORRELATION))
    rngs = [np.random.default_rng([seed, DIRT, int(stream)]) for seed, stream in seeds]
    other = np.stack([rng.standard_normal(white.shape[:2]) for rng in rngs], axis=-1)
    other[1:] *= np.sqrt(1.0 - keep**2)
    for k in range(1, len(other)):
        other[k] += keep * other[k - 1]
    return np.asarray(np.sqrt(1.0 - COLOURED) * white + np.sqrt(COLOURED) * other)


def save(path: Path | str, batch: Sequence[tuple[Case, Record, Record]]) -> None:
    """Keep generated records in one .npz; all trainings must be equally long, and all validations."""
    arrays = {
        f"{kind}_{what}": np.array([getattr(one[number], what) for one in batch])
        for number, kind in ((1, "training"), (2, "validation"))
        for what in ("commands", "readings")
    }
    np.savez(path, cases=json.dumps([asdict(case) for case, _, _ in batch]), **arrays)  # type: ignore[arg-type]


def load(path: Path | str) -> list[tuple[Case, Record, Record]]:
    """Return what `save` kept."""
    with np.load(path, allow_pickle=False) as kept:
        cases = [_case(one) for one in json.loads(str(kept["cases"]))]
        pairs = []
        for kind in ("training", "validation"):
            told, readings = kept[f"{kind}_commands"], kept[f"{kind}_readings"]
            t = np.arange(told.shape[1]) / RATE if cases else np.zeros(0)
            pairs.append([Record(t, *parts) for parts in zip(told, readings, strict=True)])
    return list(zip(cases, *pairs, strict=True))


def _case(kept: dict[str, object]) -> Case:
    case = Case(**kept)  # type: ignore[arg-type]
    second = case.second and Hidden(**case.second)  # type: ignore[arg-type]
    return replace(case, second=second, imperfections=tuple(Hidden(**one) for one in case.imperfections))  # type: ignore[arg-type]
