"""Signals that excite a rig: multisines with a small crest factor, steps, ramps, saw-teeth, opposed sines and chirps.

In: lines, levels and durations.
Out: excitations: the samples of each channel.
Imports: numerics, display, records.

`Multisine` is a sum of sines with any lines; `minimise_crest` chooses its phases. `multisine`, `steps`, `ramp`,
`sawtooth`, `opposed_sines`, `linear_chirp` and `logarithmic_chirp` make an `Excitation`: the samples of each channel,
which is written to and read from csv or parquet.
"""

from masking.lab.signals.crest import minimise_crest
from masking.lab.signals.excitation import Excitation
from masking.lab.signals.multisines import Multisine, crest_factor, schroeder_phases, time_factor
from masking.lab.signals.waveforms import (
    linear_chirp,
    logarithmic_chirp,
    multisine,
    opposed_sines,
    ramp,
    sawtooth,
    steps,
)

__all__ = [
    "Excitation", "Multisine", "crest_factor", "linear_chirp", "logarithmic_chirp", "minimise_crest", "multisine",
    "opposed_sines", "ramp", "sawtooth", "schroeder_phases", "steps", "time_factor",
]  # fmt: skip
