"""An exported FMU in fmpy, stepped by hand."""

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave


class Slave:
    """An instance of an FMU: `begin` with the first inputs, then `set`, `step` and `get`."""

    def __init__(self, path, folder):
        self.description = fmpy.read_model_description(str(path))
        fmpy.extract(str(path), str(folder))
        kind = FMU2Slave if self.description.fmiVersion == "2.0" else FMU3Slave
        self.is_2 = kind is FMU2Slave
        simulation = self.description.coSimulation
        self.fmu = kind(
            guid=self.description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=simulation.modelIdentifier,
            instanceName="one",
        )
        self.fmu.instantiate()
        listed = self.description.modelVariables
        self.inputs, self.outputs = (
            [v.valueReference for v in listed if v.causality == kind] for kind in ("input", "output")
        )

    def begin(self, inputs):
        if self.is_2:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.set(inputs)
        self.fmu.exitInitializationMode()

    def set(self, inputs):
        (self.fmu.setReal if self.is_2 else self.fmu.setFloat64)(self.inputs, list(map(float, inputs)))

    def get(self):
        return np.array((self.fmu.getReal if self.is_2 else self.fmu.getFloat64)(self.outputs))

    def step(self, time, length):
        self.fmu.doStep(currentCommunicationPoint=time, communicationStepSize=length)
