"""Make Huygens' clocks synchronise on an imperfect rig, by an observer that estimates what the model lacks.

Rijlaarsdam (2008) could not show this on the rig: section 9.2 blames model errors, noise and dry friction. The twin has
all of these. Positions that are differenced, with a linear model, leave the pendula stuck where friction holds them.
An observer that estimates disturbances beside the state makes up for it.
"""

import numpy as np

from masking.lab.records.recording import Recording
from masking.lab.runs.experiment import Experiment

ours = Experiment.load("huygens_rig")
thesis = ours.changed(controller={"rate": "1 kHz", "observer": "differences"})


def at_last(recording: Recording) -> tuple[float, float]:
    """Return |th1 + th2| over the amplitude, and the amplitude over the ideal one, in the last 10 units of time."""
    last = recording.t > recording.t[-1] - 10.0 * recording.manifest["time_scale"]
    th1, th2, ideal = (recording[name][last] for name in ("virtual.th1", "virtual.th2", "ideal.th1"))
    amplitude = np.abs(th1).max()
    return float(np.abs(th1 + th2).max() / amplitude), float(amplitude / np.abs(ideal).max())


for name, experiment in (("thesis' way", thesis), ("disturbance observer", ours)):
    together, amplitude = at_last(experiment.run())
    print(f"{name:>20}: |th1 + th2| = {together:.3f} of the amplitude, which is {amplitude:.2f} of the ideal one")

assert together < 0.05
assert 0.6 < amplitude < 1.4
