"""Spans: the range of each place, sensor and actuator in a record, from which fits start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import signal

from masking.discovery.problem import EstimationProblem
from masking.discovery.smoothing import Motion
from masking.effects import Span
from masking.numerics.arrays import Array

REPLACED = (1.0, 0.3, 3.0)  # parts of an element's stiffness with which a law in its place begins


def spans(problem: EstimationProblem, motion: Motion) -> dict[tuple[str, str], Span]:
    """Return the range of each place, sensor and actuator: of an element, sensor or actuator with a name.

    Args:
        problem: the record and the rig.
        motion: the smoothed record.
    """
    rig, record = problem.rig, problem.record
    found, tones = dict[tuple[str, str], Span](), _tones(problem, motion.forces)
    for place, x, rate in zip(rig.places, motion.displacement.T, motion.rate.T, strict=True):
        moved = x if place.element.displacement is not None else _moved(rate, problem.dt)
        span = _span(moved, float(np.sqrt((rate**2).mean())) or 1.0, tones)
        stiffness = rig.stiffnesses.get(place.name, 0.0)
        stiffnesses = tuple(part * (stiffness or 1.0) for part in REPLACED)
        found["element", place.name] = replace(span, stiffnesses=stiffnesses)
    for where, names, table in (
        ("sensor", rig.twin.sensors, record.readings),
        ("actuator", rig.twin.actuators, record.commands),
    ):
        for name, x in zip(names, table.T, strict=True):
            found[where, name] = _span(x)
    return found


def _moved(rate: Array, dt: float) -> Array:
    """Return how far a place goes to and fro whose rate alone is known (m,): without what goes on and on."""
    found: Array = signal.detrend(np.cumsum(rate) * dt)
    return found


def _tones(problem: EstimationProblem, forces: Array) -> tuple[float, ...]:
    """Return the frequencies in Hz at which the latent forces are strongest."""
    rules, rate, window, many = problem.rules, problem.record.rate, np.hanning(len(forces)), 4 * len(forces)
    power = sum(
        np.abs(np.fft.rfft(column * window, many)) ** 2 / column.var() for column in forces.T if column.var() > 0
    )
    if isinstance(power, int):
        return ()
    frequencies = np.fft.rfftfreq(many, 1.0 / rate)
    (low, high), width = rules.tone_band, rules.tone_width
    power = np.where((frequencies > low) & (frequencies < high * rate), power, 0.0)
    found = []
    for _ in range(rules.tones):
        i = int(np.argmax(power))
        found.append(float(frequencies[i]))
        power[max(0, i - width) : i + width + 1] = 0.0
    return tuple(found)


def _span(x: Array, rate: float = 0.0, tones: tuple[float, ...] = ()) -> Span:
    return Span(float(x.min()), float(x.max()), float(np.abs(x).max()), rate, tones)
