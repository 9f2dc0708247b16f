"""One scenario, the rig as coupled Duffing oscillators from a fixed seed, wherever the rig is: one and the same motion.

Offline the whole loop is one compiled function. In lockstep the controller is the one that drives rigs, and the rig is
a twin in its own process over UDP or a serial line, or an FMU: source in C, compiled by gcc, that fmpy steps.
"""

import numpy as np
import pytest

from masking.control.exports.fmu_unit import has_binary, write
from masking.control.exports.rig_units import twin_unit
from masking.lab.plants import adapters
from masking.lab.plants.interface import Sample
from masking.lab.runs import rig_run
from masking.lab.runs.experiment import Experiment
from tests.lab.runs.test_rig_run import assert_same_run, serving

pytestmark = pytest.mark.realtime

PLANT, SEED = "linear_rig", 3
CONTROLLER = {"rate": "1 kHz", "observer": {"kind": "disturbance", "noise": 1e-7}, "homing": 1}


@pytest.fixture(scope="module")
def experiment():
    loaded = Experiment.load("duffing", plant=PLANT)
    return loaded.changed(controller=CONTROLLER, record=None, duration=30, seed=SEED)


@pytest.fixture(scope="module")
def offline(experiment):
    found = experiment.run()
    moved, ideal = found["virtual.x1"], found["ideal.x1"]
    assert np.ptp(ideal) > 0.5  # of the model's unit: it moves
    assert np.abs(moved - ideal).max() < 0.05 * np.abs(ideal).max()
    return found


@pytest.mark.parametrize("address", ["udp://127.0.0.1:0", "serial:pty"])
def test_a_served_twin_moves_as_offline(experiment, offline, address):
    if address.startswith("serial"):
        pytest.importorskip("serial", reason="pyserial is not installed: pip install 'masking[serial]'")
    with serving(PLANT, "--address", address, "--lockstep", "--seed", SEED) as (_, served):
        found = rig_run.run(experiment, adapters.connect(served), rig_run.RunSettings(lockstep=True))
    assert_same_run(found, offline)


class Noisy:
    """An FMU of a rig at rest with the noise of its sensors, which is an input of it.

    The noise of a sample acts with the step before: one without power, in which the rig rests, comes before the first.

    Args:
        address: of the FMU, with noise as the last actuators.
        actuators: names of the others.
        seed: of the noise.
    """

    owns_clock = False

    def __init__(self, address, actuators, seed):
        self.plant, self.actuators, self.seed = adapters.connect(address), actuators, seed
        self.sensors = self.plant.sensors

    def configure(self, settings):
        self.plant.configure(settings)
        self.generator = np.random.default_rng(self.seed)

    def activate(self):
        self.plant.activate()
        self.plant.read()
        self.write(-1, np.zeros(len(self.actuators)))

    def read(self):
        sample = self.plant.read()
        return Sample(sample.index - 1, sample.values)

    def write(self, index, command):
        noise = self.generator.standard_normal(len(self.sensors))
        self.plant.write(index + 1, np.concatenate([command, noise]))

    def deactivate(self):
        self.plant.deactivate()


@pytest.mark.skipif(not has_binary(), reason="FMUs get no binary on this machine")
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.filterwarnings("ignore")  # fmpy's own
def test_an_fmu_of_the_twin_moves_as_offline(experiment, offline, version, tmp_path):
    pytest.importorskip("fmpy", reason="fmpy is not installed: pip install 'masking[fmu]'")
    twin = experiment.twin
    path = write(twin_unit(twin, "rig", experiment.sampled.rate), tmp_path)[version - 2]
    noise = [f"noise_{name}" for name in twin.sensors]
    where = f"fmu:{path}?sensors={','.join(twin.sensors)}&actuators={','.join([*twin.actuators, *noise])}"
    found = rig_run.run(experiment, Noisy(where, twin.actuators, SEED), rig_run.RunSettings(lockstep=True))
    assert_same_run(found, offline)
