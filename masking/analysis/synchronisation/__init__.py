"""Synchronisation of oscillators: measures, a verdict on a record, and a detector that runs along.

All of it is mathematics on series: it knows neither rigs nor recordings. Numbers of sections, figures, definitions and
formulas are those of Rijlaarsdam (2008).
"""

from __future__ import annotations

from masking.analysis.synchronisation.detector import Detector, Watch
from masking.analysis.synchronisation.measures import (
    AntiPhase,
    anti_phase,
    interpolate,
    mean_phase,
    peak_sum,
    period,
    phase_difference,
    principal,
    running_peak,
    synchronisation_time,
)
from masking.analysis.synchronisation.synchronisation_verdict import Synchronisation, synchronisation

__all__ = [
    "AntiPhase", "Detector", "Synchronisation", "Watch", "anti_phase", "interpolate", "mean_phase", "peak_sum",
    "period", "phase_difference", "principal", "running_peak", "synchronisation", "synchronisation_time",
]  # fmt: skip
