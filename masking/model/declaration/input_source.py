"""Where an input of the virtual system comes from."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, Literal

from masking.errors import nearest
from masking.model.declaration.fields import Block, Formula, Name, Number, Positive, TextField

KINDS: Final = ("expression", "file", "signal", "sensor", "push")
SIGNALS: Final = ("steps", "ramp", "sawtooth", "linear_chirp", "logarithmic_chirp", "multisine")

Interpolation = Literal["linear", "previous", "cubic"]
Several = tuple[Number, ...]


class InputSource(Block):
    """Where an input of the virtual system comes from: one of these.

    `expression` of the time; the `column` of a `file`; a `signal` of `signals` with `arguments`; a `sensor` of
    the rig; `push`, the force along a coordinate of the rig that the disturbance observer finds `above` a frequency in
    rad/s. `interpolation` says what a file or a signal is between its points. `factor` multiplies what a sensor
    measures, or a push.
    """

    expression: Formula | None = None
    file: TextField | None = None
    column: TextField | None = None
    signal: TextField | None = None
    arguments: dict[Name, Number | Several] = {}
    interpolation: Interpolation | None = None
    sensor: TextField | None = None
    push: TextField | None = None
    above: Positive | None = None
    factor: Number = 1.0

    @property
    def kinds(self) -> list[str]:
        """Return of which kinds it is."""
        return [kind for kind in KINDS if getattr(self, kind) is not None]

    @property
    def is_series(self) -> bool:
        """Whether it is known before the run, point by point."""
        return self.file is not None or self.signal is not None

    @property
    def is_live(self) -> bool:
        """Whether it is known in the run alone."""
        return self.sensor is not None or self.push is not None

    def problems(self) -> Iterator[tuple[str, str, str]]:
        """Yield what is wrong with it alone: part, message, remedy."""
        kinds = self.kinds
        if len(kinds) != 1:
            what = " and ".join(kinds) or "nothing"
            yield "", f"an input comes from one source, not from {what}", f"write one of {', '.join(KINDS)}"
            return
        if self.is_series and self.interpolation is None:
            remedy = "write 'interpolation: linear', previous or cubic"
            yield "", f"a {kinds[0]} is known at points: it must say what it is between them", remedy
        if self.signal is not None and self.signal not in SIGNALS:
            yield "signal", f"there is no signal '{self.signal}'", nearest(self.signal, SIGNALS)
        for part, kind in {"column": "file", "arguments": "signal", "above": "push"}.items():
            if getattr(self, part) and kinds != [kind]:
                yield part, f"{part} is for a {kind}", f"leave it out, or write {kind}"
        if self.interpolation is not None and not self.is_series:
            yield "interpolation", "interpolation is for a file or a signal", "leave it out"
        if self.factor != 1.0 and not self.is_live:
            yield "factor", "factor is for a sensor or a push", "leave it out"
