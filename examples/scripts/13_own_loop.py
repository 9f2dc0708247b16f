"""Hold the controller in your hand: a loop of your own, here with a simulated rig that stands in for yours."""

import numpy as np

import masking
from masking.lab.plants.interface import Settings
from masking.lab.plants.simulated import SimulatedPlant

experiment = masking.Experiment.load("huygens_rig")
step = experiment.controller()
plant = SimulatedPlant(experiment.twin)
plant.configure(Settings(step.rate))
plant.activate()
positions = []
while step.index < 4000:  # the rig rests, is brought to its initial state, and is released at sample 0
    sample = plant.read()
    plant.write(sample.index, step(sample.values))
    positions.append(step.estimate[0])
plant.deactivate()

# What the first pendulum clock does by itself; 5 mm of the oscillator stand for pi/4.
times = np.arange(4000) / step.rate / experiment.time_scale
ideal = experiment.virtual.simulate(times, experiment.declaration.initial)["th1"] * 0.005 / (np.pi / 4)
error = np.linalg.norm(positions[-4000:] - ideal) / np.linalg.norm(ideal)
print(f"relative error of the first clock over 4 s: {error:.3f}")
assert error < 0.05
