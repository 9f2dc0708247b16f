"""Find the effect that a controller's model is missing, put it into the control law, and reduce the masking error.

The rig's beam rubs; its damping is 5 % larger than in its controller's model, and its gains are 5 % smaller. It is
excited by multisines within its limits, once for estimation and once for validation. From these records alone come the
missing effect and its size; with both in block L, the masking error falls.
The page of the discovery, and the reports of both runs, are written to `results/refined`.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import masking
from masking.app.workflows import calibration_excitation
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.runs.experiment import Experiment

EXPERIMENT = """
name: Duffing oscillators on a rig that rubs
plant: linear_rig
virtual: duffing
controller: {rate: 1 kHz, observer: disturbance}
effects:  # of the rig, and not in its controller's model
  damping1: true  # 5 % more of each
  damping2: true
  damping3: true
  gains: {enabled: true, parameters: {e: -0.05}}
  friction3: true
duration: 100
"""

with TemporaryDirectory() as name:
    folder = Path(name)
    (folder / "experiment.yaml").write_text(EXPERIMENT)
    rig = Experiment.load(folder / "experiment.yaml").twin
    settings = {"seconds": 20.0, "lockstep": True, "say": print, "progress": lambda part: None}
    calibration_excitation.make(rig, SimulatedPlant(rig, seed=3), folder / "records", **settings)
    found = masking.refine(
        folder / "experiment.yaml",
        record=folder / "records" / "fit",
        validation=folder / "records" / "unseen",
        tolerance=0.05,
        out="results/refined",
        overwrite=True,
    )

print(found)

gap = found.discovery.simulation_error
(cause,) = found.discovery.effects
for sensor, left in gap.validation[1].items():
    assert left < 1.1 * gap.validation_noise_floor[sensor] < gap.validation[0][sensor]
assert (cause.name, cause.on) == ("dry_friction", "beam")
assert found.before.worst > 0.05
assert found.after.worst < 0.02
