"""Operator of a run: what lets somebody who looks at it stop it, and the rows that are shown.

Nothing here waits for anybody: rows go to a `Ring`, and the `Switch` is a number in memory.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, Protocol, Self, final

import numpy as np

from masking.compile.numerics import safety_tables
from masking.compile.numerics.controller_sizes import LARGEST, POWER
from masking.control.stepwise_controller import SampledStep
from masking.errors import OperatorError
from masking.lab.plants.safety_chain import Cause, Chain, Rules, Trip
from masking.lab.records.ring import Ring, cells
from masking.lab.records.stop_switch import Presser, Switch
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.realtime import ANSWERED, INDEX, LOOP, Row
from masking.model.modelling.model import Model

ABSENCE: Final = 2.0  # s without the page, which an attended run bears
_FILE: Final = 10_000_000  # ns between looks at the file that stops a run
_KEPT: Final = 16.0  # s of rows
_BY: Final = {Presser.PAGE: "on the page", Presser.COMMAND_LINE: "from the command line"}


class Attendant(Protocol):
    """What shows the rows of a run."""

    def wait(self) -> None:
        """Wait until a trip is acknowledged, or nobody looks any more."""


Attend = Callable[[Path, Path], Attendant]


@final
class Operator:
    """Whoever looks at a run, as a context: `masking rig stop` finds its switch while inside.

    `attend` is called with the files of the ring and the switch once both are there, and starts the process that shows
    the rows. An attended run trips where the operator's page is not heard of for `ABSENCE`, and waits for it before. It
    also trips as soon as there is the `stop_file`, on a disk of this machine. `trip` is why it did, the homing
    included. An OperatorError where there is such a file already, or no folder for it.
    """

    def __init__(
        self, attend: Attend | None = None, *, is_attended: bool = False, stop_file: str | Path | None = None
    ) -> None:
        self._attend, self._file = attend, None if stop_file is None else Path(stop_file)
        if self._file is not None and not self._file.parent.is_dir():
            raise OperatorError(f"{self._file}: there is no folder {self._file.parent}; make it, or name another file")
        self.switch, self.is_attended = Switch.make(), is_attended
        self._looked = 0
        self._about: dict[str, object] = {}  # the run, as `masking rig stop` lists it
        self.trip: Trip | None = None
        self._shown: _Shown | None = None
        self._attendant: Attendant | None = None
        if self._file is not None and self._file.exists():
            self.switch.remove()
            remedy = "remove it once the rig is safe"
            raise OperatorError(f"{self._file}: this file stops the run, and it is there; {remedy}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._shown is not None:
            self._shown.ring.close()
        self.switch.remove()

    def begin(self, experiment: Experiment, controller: SampledStep, rules: Rules) -> None:
        """Show what a controller is about to do; in an attended run, wait until somebody looks."""
        names = {"name": experiment.declaration.name, "plant": experiment.assembly.plant.name}
        self._about = {**names, "since": time.time()}
        self.switch.publish(**self._about)
        if self._attend is None:
            return
        self._shown = _Shown(experiment, controller, rules, is_attended=self.is_attended)
        self._attendant = self._attend(self._shown.ring.path, self.switch.path)
        while self.is_attended and self.switch.silence > ABSENCE and not self.switch.pressed:
            time.sleep(0.02)

    def look(self, chain: Chain, tick: int) -> None:
        """Trip a chain where the switch was pressed, the file is there, or nobody attends; measured: 0.2 us."""
        pressed = self.switch.pressed
        if pressed:
            chain.stop(Cause.ESTOP, tick, _BY.get(Presser(pressed), ""))
        if self._file is None and not self.is_attended:
            return
        now = time.monotonic_ns()
        if self._file is not None and now - self._looked > _FILE:
            self._looked = now
            if self._file.exists():
                self.switch.press(Presser.FILE)
                chain.stop(Cause.ESTOP, tick, f"by the file {self._file}")
        if self.is_attended and now - self.switch.seen > ABSENCE * 1e9:
            chain.stop(Cause.UNATTENDED, tick, value=self.switch.silence, limit=ABSENCE)

    @property
    def put(self) -> Callable[[Row], None] | None:
        """Function that shows a row of the loop; None where nobody looks at rows."""
        return None if self._shown is None else self._shown.put

    def end(self, reason: str, trip: Trip | None) -> None:
        """Show the end of the run."""
        self.trip = trip
        self.switch.publish(**self._about, end=reason, **({} if trip is None else {"trip": trip.as_dict()}))
        if self._shown is not None:
            self._shown.ring.close()

    def wait(self) -> None:
        """Wait until the operator has acknowledged why the run tripped, if it did, or nobody looks at the page.

        An interrupt, of whoever has read the cause in the terminal, acknowledges it too.
        """
        if self.trip is not None and self._attendant is not None:
            try:
                self._attendant.wait()
            except KeyboardInterrupt:
                self.switch.acknowledge()


@final
class _Shown:
    """The rows that are shown; `is_attended` says whether the page must stay open."""

    def __init__(self, experiment: Experiment, controller: SampledStep, rules: Rules, *, is_attended: bool) -> None:
        sampled = controller.sampled
        rig, virtual = sampled.instruments.model, sampled.controller.virtual
        self._rate = controller.rate
        known = sampled.instruments
        sensors, actuators = (
            dict(zip(*pair, strict=True)) for pair in zip((known.sensors, known.actuators), known.units, strict=True)
        )
        both = {"virtual": virtual, "rig": rig}
        sizes = {f"{of}.{name}": model.shown[name].size for of, model in both.items() for name in _motion(model)}
        # The virtual motion, then what lies side by side in a row of the loop.
        groups = [
            {f"virtual.{name}": virtual.shown[name].unit for name in _motion(virtual)},
            {name: entry["unit"] for name, entry in list(LOOP.items())[INDEX:]},
            {f"sensor.{name}": unit for name, unit in sensors.items()},
            {f"applied.{name}": unit for name, unit in actuators.items()},
            {f"power.{name}": "W" for name in actuators},
            {f"rig.{name}": rig.shown[name].unit for name in _motion(rig)},
        ]
        units = {name: unit for group in groups for name, unit in group.items()}
        instant, motion, bound = controller.virtual()
        self._time, self._virtual, self._bound, self._transform = cells(instant), cells(motion), bound, bound.call
        self._stop = INDEX + len(units) - len(motion)
        condition = experiment.stop_condition
        pair = condition.names if condition else virtual.oscillators[:2]
        declaration, plant = experiment.declaration, experiment.assembly.plant
        self.ring = Ring(
            list(units), self._rate, units, rows=int(_KEPT * self._rate), name=declaration.name, plant=plant.name,
            pair=list(pair) if len(pair) > 1 else [], attended=is_attended, sizes=sizes,
            bounds=list(_bounds(controller, rules)),
        )  # fmt: skip

    def put(self, row: Row) -> None:
        """Show a row of the loop; measured: 0.6 us."""
        if row[ANSWERED]:
            self._time[0] = row[INDEX] / self._rate
            self._transform()
        self.ring.put(self._virtual, row[INDEX : self._stop])


def _motion(model: Model) -> list[str]:
    """Coordinates of a model, and then their rates."""
    return model.state_names[: 2 * len(model.coordinates)]


def _bounds(controller: SampledStep, rules: Rules) -> Iterator[dict[str, Any]]:
    """Limits that the chain watches, in the declared units, as `operator_page` takes them."""
    # The columns of the rig are in SI units, those of sensors in their own.
    known = controller.sampled.instruments
    declared = known.plant.limits
    rig = [f"rig.{name}" for name in _motion(known.model)]
    sensors = [f"sensor.{name}" for name in known.sensors]
    positions, rates = ({e.text: x for e, x in given.items()} for given in (declared.coordinates, declared.velocities))
    tables = (rules.limits, rules.weights, rules.estimated)
    for name, unit, row, weights, estimated in zip(rules.limited, rules.units[2], *tables, strict=True):
        is_rate, is_estimated = row[safety_tables.OVER] > 0.0, row[safety_tables.ESTIMATED] > 0.0
        columns = zip(rig, estimated, strict=False) if is_estimated else zip(sensors, weights, strict=True)
        yield {
            "kind": "limit",
            "label": f"rate of {name}" if is_rate else name,
            "unit": unit,
            "bound": (rates if is_rate else positions)[name].max,
            "trip": float(row[safety_tables.BOUND]),
            "zero": float(row[safety_tables.AT_ZERO]),
            "weights": {column: float(weight) for column, weight in columns if weight},
            "over": 0 if is_estimated else int(row[safety_tables.OVER]),
        }
    for name, row in zip(known.actuators, rules.commands, strict=True):
        unit = known.unit(name)
        yield {"kind": "command", "label": name, "unit": unit, "bound": float(row[LARGEST]),
               "weights": {f"applied.{name}": 1.0}}  # fmt: skip
        if 0.0 < row[POWER] < np.inf:
            yield {"kind": "heat", "label": name, "unit": "W", "bound": float(row[POWER]),
                   "weights": {f"power.{name}": 1.0}}  # fmt: skip
