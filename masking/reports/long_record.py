"""Long record: a recording on disk, as it is drawn, and what needs all of its samples, window by window."""

from __future__ import annotations

import itertools
from typing import Final

import numpy as np

from masking.analysis.synchronisation import AntiPhase, interpolate
from masking.lab.records.recording import Recording

_MOST: Final = 3 * 2**19  # samples that are studied at once: 15 in each second of a day
_WINDOW: Final = 2**17  # samples that are looked at one after the other


def drawn(recording: Recording) -> Recording:
    """Recording with as many samples as are studied at once: one that is on disk, with fewer and in memory.

    Motions are sampled, inputs keep the least and the greatest value of each stretch of time.
    """
    if not recording.is_on_disk:
        return recording
    prefix = "virtual" if recording.coordinates else "rig"
    moving = [f"{kind}.{name}" for kind in (prefix, "ideal") for name in recording.names(kind)]
    more = [name for name in recording.columns if name.partition(".")[0] in {"input", "demanded", "power"}]
    passive = (recording.manifest.get("passive") or {}).get("coordinates") or ()
    more += [f"rig.{name}" for name in passive if f"rig.{name}" not in moving]
    return recording.thinned(_MOST, moving, ["t", *moving, *more])


def deviation(recording: Recording, names: tuple[str, str], fit: AntiPhase, start: float, scale: float) -> float:
    """Eps of definition 5.3 over all samples of the end of a recording, from `start` in s on.

        eps = max |a(t) - alpha b(t + T/2)|

    `names` are those of the columns a and b, `fit` has alpha and T, and `scale` is seconds per unit of time of T.
    Source: Rijlaarsdam (2008), (5.3).
    """
    (first, last), shift, largest = recording.span, 0.5 * fit.period * scale, 0.0
    window = (last - first) / max(1, len(recording) - 1) * _WINDOW
    edges = np.append(np.arange(start, last - shift, window), last - shift)
    for begin, end in itertools.pairwise(edges.tolist()):
        part = recording.between(begin, min(end + 1.1 * shift, last))
        now = part.t <= end
        g = part[names[0]][now] - fit.alpha * interpolate(part.t, part[names[1]], part.t[now] + shift)
        largest = max(largest, float(np.abs(g).max(initial=0.0)))
    return largest
