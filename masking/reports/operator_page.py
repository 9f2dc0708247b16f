"""A running loop as its operator sees it: traces, the difference of two phases, how near each limit is, and times.

Everything is read from the loop's `Ring` and `Switch`, by another process, so that the loop waits for nothing. The
ring's facts say what there is to show besides its columns:

    name, plant   titles
    pair          the two virtual coordinates whose phases are compared
    sizes         by column: what one of its unit is in the numbers of the rows, by default 1
    bounds        what is limited, as `Bound` has it: kind, label, unit, bound, trip, zero, weights of columns, over
"""

from __future__ import annotations

import asyncio
import json
import math
import re
import time
from collections import deque
from collections.abc import Coroutine, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any, Final, final

import numpy as np

from masking.analysis.synchronisation import period
from masking.compile.numerics.arrays import Array
from masking.display.palette import COLOURS
from masking.display.symbols import markup
from masking.errors import OperatorError
from masking.lab.records.ring import RingReader
from masking.lab.records.stop_switch import Presser, Switch, is_running
from masking.reports import html
from masking.reports.html import prose
from masking.reports.local_page import Answer, LocalPage

WINDOW: Final = 12.0  # s that the traces show
BINS: Final = 600  # points of a trace: the smallest and largest number of a few rows
_RECENT: Final = 1.0  # s in which the largest value counts as the present one
_SILENT: Final = 0.5  # s without a row, after which a loop counts as silent
_DECADES, _PARTS = (-6, -2), 20  # of durations: powers of ten of a second, and bins in each
_EDGES: Final = np.logspace(*_DECADES, (_DECADES[1] - _DECADES[0]) * _PARTS + 1)
_LEAST: Final = 200  # points from which a period is taken
_PHASE_RATE, _MEMORY = 200.0, 60.0  # Hz and s of the motion from which a phase is taken
_TITLES: Final = {"virtual": "Virtual system", "rig": "Rig", "sensor": "Sensors"}
_LOOK, _PHASED = 0.04, 0.25  # s between looks at the rows, and at the phases
_TAKEN: Final = "; a page that shows a trip gives its port back once that is acknowledged"


@dataclass(frozen=True, eq=False)
class Bound:
    """One thing that is limited: the magnitude of zero + weights of columns."""

    kind: str  # "limit", "command" or "heat"
    label: str  # its name
    unit: str  # of its bound
    bound: float  # the largest magnitude that is allowed
    trip: float  # the least that is too much
    zero: float  # its value where all columns are zero
    columns: list[int]  # places of the columns that it is made of
    weights: Array  # of these
    over: int  # rows over which the rate of the expression is taken, 0 for the expression itself
    rate: float  # rows per second

    @classmethod
    def of(cls, entry: Mapping[str, Any], reader: RingReader) -> Bound:
        """Limit that an entry of the ring's facts declares."""
        weights = {str(name): float(weight) for name, weight in entry["weights"].items()}
        return cls(
            str(entry["kind"]), str(entry["label"]), str(entry.get("unit", "")), float(entry["bound"]),
            float(entry.get("trip", entry["bound"])),
            float(entry.get("zero", 0.0)), [reader.columns.index(name) for name in weights],
            np.array(list(weights.values())), int(entry.get("over", 0)), reader.rate,
        )  # fmt: skip

    def values(self, table: Array) -> Array:
        """Its magnitude in each of some rows (m, columns) in a row, from the first that has one."""
        found = self.zero + table[:, self.columns] @ self.weights
        return np.abs(found if not self.over else (found[self.over :] - found[: -self.over]) * self.rate / self.over)


@final
class Monitor:
    """What has been seen of a loop, by a ring reader of its own; `look` sees what is new."""

    def __init__(self, reader: RingReader, switch: Switch | None = None, window: float = WINDOW) -> None:
        self.reader, self.switch, self.window = reader, switch, window
        facts, columns = reader.facts, reader.columns
        shown = [name for name in columns if name.split(".")[0] in _TITLES and not name.endswith("'")]
        if any(name.startswith(("virtual.", "rig.")) for name in shown):
            shown = [name for name in shown if not name.startswith("sensor.")]
        self.shown = tuple(shown)
        self.every = max(1, math.ceil(window * reader.rate / BINS))
        self._places = [columns.index(name) for name in shown]
        self._sizes = np.array([float(facts.get("sizes", {}).get(name, 1.0)) for name in shown])
        self._bins = _Bins(self.every, len(shown) + 1)  # the last is the time
        self.bounds = [Bound.of(entry, reader) for entry in facts.get("bounds", ())]
        self.now, self.peak = [math.nan] * len(self.bounds), [0.0] * len(self.bounds)
        self._largest: deque[tuple[float, list[float]]] = deque()  # of each bound, at each look in the last second
        self._before = np.empty((0, len(columns)))
        self._overlap = max([one.over for one in self.bounds], default=0)
        self.times = _Times()
        self.missed, self._changed, self._last = 0, -math.inf, math.nan
        self._index = columns.index("index") if "index" in columns else None
        pair = [f"virtual.{name}" for name in facts.get("pair", ())]
        self._pair = [columns.index(name) for name in pair] if len(pair) == 2 and set(pair) <= set(columns) else None
        self._thin = math.ceil(reader.rate / _PHASE_RATE)
        self._motion = np.empty((0, 3))  # t, and the pair
        self.phase = math.nan
        self._phases: list[tuple[float, float]] = []

    def look(self, now: float) -> None:
        """See the rows since the last call; `now` is in s of any clock that goes on."""
        taken = self.reader.take()
        if not len(taken.table):
            self._changed = now if self._changed == -math.inf else self._changed
            return
        self.missed += taken.missed
        self._changed, table = now, taken.table
        ticks = taken.first + np.arange(len(table)) if self._index is None else table[:, self._index]
        t = np.asarray(ticks, dtype=float) / self.reader.rate
        self._last = float(t[-1])
        self._bins.add(taken.first, np.column_stack([table[:, self._places] / self._sizes, t]))
        overlapping = table if taken.missed else np.concatenate([self._before, table])
        self._look_at_bounds(now, overlapping, len(table))
        self._before = overlapping[max(0, len(overlapping) - self._overlap) :] if self._overlap else self._before
        if self._pair is not None:
            kept = slice(-taken.first % self._thin, None, self._thin)
            motion = np.column_stack([t[kept], table[kept][:, self._pair]])
            self._motion = np.concatenate([self._motion, motion[motion[:, 0] >= 0.0]])[-int(_PHASE_RATE * _MEMORY) :]
        self.times.add(table, self.reader.columns)

    def _look_at_bounds(self, now: float, table: Array, new: int) -> None:
        """See how near each limit is in the new rows at the end of a table (m, columns)."""
        values = [one.values(table)[-new:] for one in self.bounds]
        self._largest.append((now, [float(np.max(one)) if len(one) else math.nan for one in values]))
        while self._largest[0][0] < now - _RECENT:
            self._largest.popleft()
        if self.bounds:
            self.now = np.fmax.reduce([found for _, found in self._largest]).tolist()
            self.peak = np.fmax(self.peak, self.now).tolist()

    def look_at_phase(self) -> None:
        """Compare the phases of the pair over the last period of the first of them."""
        if self._pair is None:
            return
        t, a, b = self._motion.T
        recent = t > self._last - self.window
        self.phase = phase_between(t[recent], a[recent], b[recent])
        if math.isnan(self.phase):  # a slow motion
            self.phase = phase_between(t, a, b)
        if len(t) and (not self._phases or t[-1] > self._phases[-1][0]):
            self._phases = [*self._phases[-BINS:], (float(t[-1]), self.phase)]

    def state(self, now: float) -> dict[str, Any]:
        """Loop's state in a word and what there is to say about it, as JSON can hold it."""
        published = self.switch.published if self.switch is not None else {}
        trip, end = published.get("trip"), str(published.get("end") or "ended")
        pressed = self.switch is not None and self.switch.pressed
        acknowledged = self.switch is not None and self.switch.is_acknowledged
        why = ""
        if trip:
            word = "TRIPPED"
        elif self.reader.is_closed:
            word, why = end.upper(), str(published.get("why", ""))
        elif not is_running(self.reader.process):
            word, why = "LOST", "the process of the run has ended without a word; the plant's watchdog stops the rig"
        elif pressed:
            word = "STOPPING"
        elif not self.reader.count:
            word, why = str(published.get("state", "DISARMED")), "no sample has come yet"
        elif now - self._changed > _SILENT:
            word, why = "SILENT", f"no sample has come for {now - self._changed:.0f} s"
        else:
            word = "HOMING" if self._last < 0.0 else "RUNNING"
        shown = {"trip": trip, "acknowledged": acknowledged, "t": plain(self._last)}
        return {"word": word, "why": why, "is_over": bool(trip) or self.reader.is_closed or word == "LOST", **shown}

    def facts(self) -> dict[str, Any]:
        """Facts that do not change, as JSON can hold them."""
        facts, units = self.reader.facts, self.reader.units
        panels: dict[str, list[dict[str, Any]]] = {}
        for place, column in enumerate(self.shown):
            prefix, _, name = column.partition(".")
            lines = panels.setdefault(prefix, [])
            unit = units.get(column, "")
            colour = COLOURS[len(lines) % len(COLOURS)]
            lines.append({"place": place, "column": column, "label": markup(name), "unit": unit, "colour": colour})
        pair = facts.get("pair", []) if self._pair else []
        labels = [prose(one.label, re.findall(r"\w+", one.label)) for one in self.bounds]
        bounds = [
            {"kind": one.kind, "label": label, "unit": one.unit, "bound": one.bound, "trip": one.trip}
            for one, label in zip(self.bounds, labels, strict=True)
        ]
        return {
            "name": facts.get("name", ""),
            "plant": facts.get("plant", ""),
            "rate": self.reader.rate,
            "window": self.window,
            "every": self.every,
            "bins": BINS,
            "panels": [{"title": _TITLES[prefix], "lines": lines} for prefix, lines in panels.items()],
            "pair": [markup(name) for name in pair],
            "bounds": bounds,
            "edges": _EDGES.tolist(),
            "attended": bool(facts.get("attended")),
        }

    def since(self, number: int, now: float) -> dict[str, Any]:
        """State to show, with the bins from a number on, as JSON can hold it."""
        first, bins = self._bins.since(number)
        return {
            "state": self.state(now),
            "count": self.reader.next,
            "unread": self.missed,
            "first": first,
            "bins": plain(bins),
            "phase": plain(self.phase),
            "phases": plain([one for one in self._phases if one[0] > self._last - self.window]),
            "now": plain(self.now),
            "peak": plain(self.peak),
            "times": self.times.as_dict(),
        }


@final
class _Bins:
    """The smallest and largest numbers of each few rows, the last `BINS` of them; row n is in bin n // every."""

    def __init__(self, every: int, columns: int) -> None:
        self.every, self.count = every, 0  # whole bins
        self._kept = np.full((BINS, 2, columns), np.nan)
        self._open = np.full((2, columns), np.nan)

    def add(self, first: int, rows: Array) -> None:
        """Add rows (m, columns), of which the first has a number."""
        numbers = (first + np.arange(len(rows))) // self.every
        begins = np.flatnonzero(np.diff(numbers, prepend=-1))
        least, most = np.fmin.reduceat(rows, begins), np.fmax.reduceat(rows, begins)
        for number, low, high in zip(numbers[begins].tolist(), least, most, strict=True):
            while self.count < number:
                self._kept[self.count % BINS] = self._open
                self._open[:] = np.nan
                self.count = self.count + 1 if number - self.count <= BINS else number - BINS
            self._open[0] = np.fmin(self._open[0], low)
            self._open[1] = np.fmax(self._open[1], high)

    def since(self, number: int) -> tuple[int, Array]:
        """Number of the first bin that is there from a number on, and the bins (m, 2, columns)."""
        first = max(number, self.count - BINS, 0)
        return first, self._kept[np.arange(first, max(first, self.count)) % BINS]


@dataclass
class _Times:
    """How long the controller took in each tick, and which were late."""

    counts: Array = field(default_factory=lambda: np.zeros(len(_EDGES) + 1, dtype=np.int64))  # of durations in each bin
    worst: float = 0.0  # the longest, s
    late: int = 0  # ticks that were
    missed: int = 0  # samples that never came
    _last: float = math.nan

    def add(self, table: Array, columns: Sequence[str]) -> None:
        """Count rows (m, columns)."""
        if "duration" in columns:
            durations = table[:, columns.index("duration")]
            self.counts += np.bincount(np.searchsorted(_EDGES, durations), minlength=len(self.counts))
            self.worst = max(self.worst, float(durations.max()))
        if "late" in columns:
            self.late += int(np.count_nonzero(table[:, columns.index("late")]))
        if "index" in columns:
            index = table[:, columns.index("index")]
            before = index[0] - 1.0 if math.isnan(self._last) else self._last
            self.missed += int(np.maximum(np.diff(index, prepend=before) - 1.0, 0.0).sum())
            self._last = float(index[-1])

    def _quantile(self, part: float) -> float:
        """Duration that a part of the ticks does not exceed, up to the width of a bin."""
        total = int(self.counts.sum())
        if not total:
            return math.nan
        place = int(np.searchsorted(np.cumsum(self.counts), part * total))
        return min(float(_EDGES[min(place, len(_EDGES) - 1)]), self.worst)

    def as_dict(self) -> dict[str, Any]:
        """Everything as JSON can hold it, s."""
        quantiles = {"p50": plain(self._quantile(0.5)), "p99": plain(self._quantile(0.99)), "worst": self.worst}
        return {"counts": self.counts.tolist(), **quantiles, "late": self.late, "missed": self.missed}


def phase_between(t: Array, a: Array, b: Array) -> float:
    """Phase of a minus that of b, fitted by sines over the last period of a, rad in (-pi, pi]; NaN without a period."""
    length = period(t, a) if len(t) >= _LEAST and np.ptp(a) > 0.0 else math.nan
    if not math.isfinite(length):
        return math.nan
    kept = t > t[-1] - length
    turn = 2.0 * math.pi / length * (t[kept] - t[-1])
    basis = np.column_stack([np.cos(turn), np.sin(turn), np.ones(len(turn))])
    found = np.linalg.lstsq(basis, np.column_stack([a[kept], b[kept]]), rcond=None)[0]
    first, second = found[0] - 1j * found[1]
    crossed = first * np.conj(second)
    return math.atan2(crossed.imag, crossed.real) if crossed else math.nan


def plain(values: Any) -> Any:  # noqa: ANN401  # numbers, or trees of them
    """Numbers as JSON can hold them: those that are not finite become null."""
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if isinstance(values, Iterable):
        return [plain(one) for one in values]
    return values if math.isfinite(values) else None


@final
class OperatorPage(LocalPage):
    """The page of one loop, served from the construction on; a context that ends the service.

    Port 0 is a free one; an `OperatorError` says that another is taken. The switch is what STOP presses.
    """

    def __init__(self, monitor: Monitor, switch: Switch, port: int = 0) -> None:
        self.monitor, self.switch, self._phased = monitor, switch, 0.0
        self._begin(html.render("operator", facts=monitor.facts()), port, "--page", _TAKEN)

    def _hear(self) -> None:
        self.switch.see()

    def _work(self) -> tuple[Coroutine[Any, Any, None], ...]:
        return (self._watch(),)

    async def _watch(self) -> None:
        """Look at the rows until the service ends."""
        while True:
            await asyncio.sleep(_LOOK)
            await self._loop.run_in_executor(self._rows, self._look)

    def _look(self) -> None:
        now = time.monotonic()
        self.monitor.look(now)
        if now - self._phased > _PHASED:
            self.monitor.look_at_phase()
            self._phased = now

    def _data(self, query: str) -> bytes:
        """State and the bins from a number on, as JSON."""
        digits = query.removeprefix("since=")
        number = int(digits) if digits.isascii() and digits.isdigit() and len(digits) < 16 else 0
        return json.dumps(self.monitor.since(number, time.monotonic()), allow_nan=False).encode()

    def _press(self, path: str) -> Answer:
        if path == "stop":
            self.switch.press(Presser.PAGE)
        elif path == "acknowledge":
            try:
                self.switch.acknowledge()
            except OperatorError as error:
                return Answer(HTTPStatus.CONFLICT, f"{error}\n".encode())
        else:
            return Answer(HTTPStatus.NOT_FOUND)
        return Answer(HTTPStatus.OK, b"{}", "application/json")
