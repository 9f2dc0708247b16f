"""FMU: a plant that is a functional mock-up unit for co-simulation, of FMI 2.0 or 3.0, through fmpy."""

from __future__ import annotations

import re
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, final

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

from masking.compile.numerics.arrays import Array
from masking.errors import PlantError, PlantMismatchError, RecordError
from masking.lab.plants import address as addresses
from masking.lab.plants.interface import Settings
from masking.lab.plants.stepped import SteppedPlant
from masking.lab.records import unpacked_size

FORM: Final = "fmu:rig.fmu?sensors=x&actuators=u"
_OPTIONS: Final = ("sensors", "actuators")
_MOST_FILES: Final = 10_000  # in a unit
_KINDS: Final = {"2.0": (FMU2Slave, "Real"), "3.0": (FMU3Slave, "Float64")}  # class, type of numbers


@final
class FmuPlant(SteppedPlant):
    """The unit of a file, at `fmu:rig.fmu`.

    The options `sensors` and `actuators` choose, order and rename (`NAME:THEIRS`); by default sensors are all outputs
    and actuators all inputs that are scalar floating-point numbers. Other inputs keep their start values. A sample is
    one communication step.
    """

    def __init__(self, address: str) -> None:
        where = addresses.parse(address, _OPTIONS, FORM)
        self._path = where.place
        if not Path(self._path).is_file():
            raise PlantMismatchError(f"{address}: there is no file '{self._path}'; write the address as {FORM}")
        try:
            _check_size(Path(self._path))
            self._described = fmpy.read_model_description(self._path)
        except RecordError as error:
            raise PlantMismatchError(str(error)) from error
        except Exception as error:  # whatever fmpy raises at a file that is none
            reason = " ".join(str(error).split())
            raise PlantMismatchError(f"{address}: no FMU that fmpy reads ({reason}); correct the file") from error
        version = str(self._described.fmiVersion)
        if self._described.coSimulation is None or version not in _KINDS:
            remedy = "give one for co-simulation of FMI 2.0 or 3.0"
            raise PlantMismatchError(f"{address}: an FMU of FMI {version} that cannot be stepped so; {remedy}")
        self._identifier = str(self._described.coSimulation.modelIdentifier)
        if re.fullmatch(r"[A-Za-z_]\w*", self._identifier, re.ASCII) is None:  # the name of the library in the file
            raise PlantMismatchError(
                f"{address}: its modelIdentifier '{self._identifier}' is no name; correct the file"
            )
        self._kind, self._number = _KINDS[version]
        outputs, inputs = ({
            v.name: int(v.valueReference)
            for v in self._described.modelVariables
            if v.causality == causality and v.type == self._number and not getattr(v, "dimensions", None)
        } for causality in ("output", "input"))  # fmt: skip
        sensors = where.channels("sensors", tuple(outputs), outputs)
        actuators = where.channels("actuators", tuple(inputs), inputs)
        super().__init__(tuple(sensors), tuple(actuators))
        self._outputs = [outputs[name] for name in sensors.values()]
        self._inputs = [inputs[name] for name in actuators.values()]
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._unit: Any = None

    def begin(self, settings: Settings) -> None:
        """Make an instance, at its start."""
        self._period, self._time = 1.0 / settings.rate, 0
        self._folder = tempfile.TemporaryDirectory(prefix="masking-fmu-")
        with self._errors("cannot be started"):
            self._unit = self._kind(
                guid=self._described.guid,
                unzipDirectory=fmpy.extract(self._path, self._folder.name),
                modelIdentifier=self._identifier,
                instanceName="plant",
            )
            self._unit.instantiate()
            if self._kind is FMU2Slave:
                self._unit.setupExperiment(startTime=0.0)
            self._unit.enterInitializationMode()
            self._call("set")(self._inputs, [0.0] * len(self._inputs))
            self._unit.exitInitializationMode()

    def step(self, command: Array) -> None:
        """Move by one communication step."""
        with self._errors("has stopped"):
            self._call("set")(self._inputs, command.tolist())
            self._unit.doStep(currentCommunicationPoint=self._time * self._period, communicationStepSize=self._period)
        self._time += 1

    def readings(self) -> Array:
        """Outputs."""
        with self._errors("cannot be read"):
            return np.array(self._call("get")(self._outputs), dtype=np.float64)

    def end(self) -> None:
        """Give the instance and its files back."""
        unit, folder, self._unit, self._folder = self._unit, self._folder, None, None
        try:
            if unit is not None:
                unit.terminate()
                unit.freeInstance()
        finally:
            if folder is not None:
                folder.cleanup()

    def _call(self, verb: str) -> Callable[..., Any]:
        call: Callable[..., Any] = getattr(self._unit, verb + self._number)
        return call

    @contextmanager
    def _errors(self, what: str) -> Iterator[None]:
        """Turn whatever fmpy raises into an error of a plant."""
        try:
            yield
        except Exception as error:
            reason = " ".join(str(error).split())
            remedy = "a step of another length may do: change controller.rate"
            raise PlantError(f"{self._path} {what} ({type(error).__name__}: {reason}); {remedy}") from error


def _check_size(path: Path) -> None:
    """Refuse a file that unpacks to too much, by a RecordError; whatever zipfile raises where it is none."""
    with zipfile.ZipFile(path) as packed:
        files = packed.infolist()
    unpacked_size.check(path, sum(one.file_size for one in files))
    if len(files) > _MOST_FILES:
        raise RecordError(f"{path}: it holds {len(files)} files, more than {_MOST_FILES}; leave out what is not needed")
