"""MuJoCo: a plant that is a model in MJCF, with sensors and actuators by name."""

from __future__ import annotations

import math
from typing import Final, final

import mujoco
import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import PlantError, PlantMismatchError
from masking.lab.plants import address as addresses
from masking.lab.plants import mjcf_size
from masking.lab.plants.interface import Settings
from masking.lab.plants.stepped import SteppedPlant

FORM: Final = "mujoco:rig.xml?sensors=x,v&actuators=motor"
MOST_STEPS: Final = 100_000  # of a sample: some seconds even of a small model
_OPTIONS: Final = ("sensors", "actuators", "key")
_UNSTABLE: Final = tuple(getattr(mujoco.mjtWarning, f"mjWARN_BADQ{kind}") for kind in ("POS", "VEL", "ACC"))


@final
class MujocoPlant(SteppedPlant):
    """The model of an MJCF file, from its start or from a keyframe, at `mujoco:rig.xml`.

    The options `sensors` and `actuators` choose, order and rename (`NAME:THEIRS`); by default all are taken that have a
    name. A sensor has as many channels as numbers, the first of which is called as the sensor is, the others
    `NAME.1` and so on. `key` is the name of a keyframe. The time step is that of the file, or the next shorter one that
    divides a sample. Commands are limited by the model's `ctrlrange`.
    """

    def __init__(self, address: str) -> None:
        where = addresses.parse(address, _OPTIONS, FORM)
        self._file = where.place
        mjcf_size.check(where.place)
        try:
            self._model = mujoco.MjModel.from_xml_path(where.place)
        except (ValueError, RuntimeError) as error:
            raise PlantMismatchError(f"{address}: {' '.join(str(error).split())}; correct the file") from error
        self._declared = float(self._model.opt.timestep)
        if not 0.0 < self._declared < math.inf:
            raise PlantMismatchError(f"{address}: its timestep is {self._declared:g} s; give one above 0")
        readings = _readings(self._model)
        motors = {name: i for i in range(self._model.nu) if (name := self._model.actuator(i).name)}
        sensors = where.channels("sensors", tuple(readings), readings)
        actuators = where.channels("actuators", tuple(motors), motors)
        super().__init__(tuple(sensors), tuple(actuators))
        self._read = np.array([readings[name] for name in sensors.values()])
        self._driven = np.array([motors[name] for name in actuators.values()])
        self._data, self._steps = mujoco.MjData(self._model), 1
        self._key = _keyframe(self._model, where) if "key" in where.options else None

    def begin(self, settings: Settings) -> None:
        """Go to the start, with a time step that divides a sample."""
        steps = 1.0 / (settings.rate * self._declared)
        if steps > MOST_STEPS:
            raise PlantMismatchError(
                f"{self._file}: a sample would take {steps:.3g} steps of {self._declared:g} s, more than {MOST_STEPS}; "
                "give it a longer timestep, or run it at a higher rate"
            )
        self._steps = max(1, math.ceil(steps - 1e-9))
        self._model.opt.timestep = 1.0 / (settings.rate * self._steps)
        if self._key is None:
            mujoco.mj_resetData(self._model, self._data)
        else:
            mujoco.mj_resetDataKeyframe(self._model, self._data, self._key)
        self._data.ctrl[:] = 0.0

    def step(self, command: Array) -> None:
        """Move by one sample."""
        self._data.ctrl[self._driven] = command
        mujoco.mj_step(self._model, self._data, self._steps)
        if any(self._data.warning[kind].number for kind in _UNSTABLE):  # upon which MuJoCo begins anew
            remedy = "give it a shorter timestep"
            raise PlantError(f"the simulation of {self._file} became unstable at {self._data.time:g} s; {remedy}")

    def readings(self) -> Array:
        """Readings now: after a step, MuJoCo's are those of its beginning."""
        mujoco.mj_forward(self._model, self._data)
        values: Array = self._data.sensordata[self._read]  # a copy, since it is indexed by an array
        return values

    def end(self) -> None:
        """Set the controls to zero."""
        self._data.ctrl[:] = 0.0


def _readings(model: mujoco.MjModel) -> dict[str, int]:
    """Channels of the named sensors, and where each is in `sensordata`."""
    found: dict[str, int] = {}
    for i in range(model.nsensor):
        if name := model.sensor(i).name:
            first, count = int(model.sensor_adr[i]), int(model.sensor_dim[i])
            found |= {name if k == 0 else f"{name}.{k}": first + k for k in range(count)}
    return found


def _keyframe(model: mujoco.MjModel, where: addresses.Address) -> int:
    names = [model.key(i).name for i in range(model.nkey)]
    if where.options["key"] not in names:
        known = ", ".join(filter(None, names)) or "none with a name"
        raise PlantMismatchError(f"{where.text}: there is no keyframe '{where.options['key']}'; there are {known}")
    return names.index(where.options["key"])
