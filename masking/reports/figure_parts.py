"""Numbers of figures: units of small values, spectra, and remarks on omissions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from masking.compile.numerics.arrays import Array

PREFIXES = {1.0: "", 1e3: "m", 1e6: "µ", 1e9: "n"}  # of small values, by the factor
LEAST = 0.1  # of the largest value that is drawn, in its unit


def shown(unit: str, *values: Array | Sequence[float]) -> tuple[float, str]:
    """Factor and unit in which values of a unit are drawn together: small metres, volts and newtons in mm, µm or nm."""
    largest = max((float(np.abs(v).max()) for v in values if len(v)), default=0.0)
    if not largest or unit.partition("/")[0] not in {"m", "V", "N"}:
        return 1.0, unit
    by, prefix = next(((by, prefix) for by, prefix in PREFIXES.items() if by * largest >= LEAST), (1e9, "n"))
    return by, f"{prefix}{unit}"


def first_of(count: int, total: int, what: str = "") -> str:
    """Remark that only some are shown, of what is counted, in the plural; "" if all are."""
    return f" The first {count} of {total}{what and f' {what}'} are shown." if total > count else ""


def noise_density(deviation: float, rate: float) -> float:
    """Amplitude density of white noise of a standard deviation, sampled at a rate in Hz."""
    return float(deviation * np.sqrt(2.0 / rate))


def spectral_density(values: Array, rate: float, segments: int = 8, bins: int = 24) -> tuple[Array, Array]:
    """Frequencies in Hz, evenly over their logarithm, and the root of the power spectral density there (bins,).

    Of values (samples,), in their unit per root of Hz; `segments` overlap by half (Welch), and `bins` are per decade.
    """
    from scipy import signal  # noqa: PLC0415  # takes longer to load than all else here, and few figures need it

    length = min(max(2 * len(values) // (segments + 1), 16), len(values))
    f, power = signal.welch(values, rate, nperseg=length, detrend="constant")
    place = np.floor(bins * np.log10(f[1:] / f[1])).astype(int)
    first = np.flatnonzero(np.diff(place, prepend=-1))
    counts = np.diff(np.append(first, len(place)))
    mean = [np.add.reduceat(column, first) / counts for column in (f[1:], power[1:])]
    return mean[0], np.sqrt(np.maximum(mean[1], 1e-300))
