"""Spans: how far and how fast each place, sensor and actuator goes in a record, from which fits of effects start."""

from __future__ import annotations

import numpy as np
from scipy import signal

from masking.discovery.problem import EstimationProblem
from masking.discovery.smoothing import Motion
from masking.effects import Span
from masking.numerics.arrays import Array

REPLACED = (1.0, 0.3, 3.0)  # parts of an element's stiffness with which a law in its place begins


def spans(problem: EstimationProblem, motion: Motion) -> dict[tuple[str, str], Span]:
    """Return the span of each place, sensor and actuator: of an element, sensor or actuator with a name."""
    found, tones = dict[tuple[str, str], Span](), _tones(problem, motion.forces)
    for place, x, rate in zip(problem.rig.places, motion.displacement.T, motion.rate.T, strict=True):
        moved = x if place.element.displacement is not None else _moved(rate, problem.dt)
        span = _span(moved, float(np.sqrt((rate**2).mean())) or 1.0, tones)
        stiffness = problem.rig.stiffnesses.get(place.name, 0.0)
        stiffnesses = tuple(part * (stiffness or 1.0) for part in REPLACED)
        found["element", place.name] = Span(span.low, span.high, span.size, span.rate, span.tones, stiffnesses)
    for where, names, table in (
        ("sensor", problem.rig.twin.sensors, problem.record.readings),
        ("actuator", problem.rig.twin.actuators, problem.record.commands),
    ):
        for name, x in zip(names, table.T, strict=True):
            found[where, name] = _span(x)
    return found


def _moved(rate: Array, period: float) -> Array:
    """Return how far a place goes to and fro whose rate alone is known (m,): without what goes on and on."""
    found: Array = signal.detrend(np.cumsum(rate) * period)
    return found


def _tones(problem: EstimationProblem, forces: Array) -> tuple[float, ...]:
    """Return the frequencies in Hz at which the latent forces are strongest."""
    window, rules = np.hanning(len(forces)), problem.rules
    many = 4 * len(forces)
    power = sum(
        np.abs(np.fft.rfft(column * window, many)) ** 2 / column.var() for column in forces.T if column.var() > 0
    )
    if isinstance(power, int):
        return ()
    frequencies = np.fft.rfftfreq(many, problem.dt)
    (low, high), width = rules.tone_band, rules.tone_width
    power = np.where((frequencies > low) & (frequencies < high * problem.record.rate), power, 0.0)
    found = []
    for _ in range(rules.tones):
        i = int(np.argmax(power))
        found.append(float(frequencies[i]))
        power[max(0, i - width) : i + width + 1] = 0.0
    return tuple(found)


def _span(x: Array, rate: float = 0.0, tones: tuple[float, ...] = ()) -> Span:
    return Span(float(x.min()), float(x.max()), float(np.abs(x).max()), rate, tones)
