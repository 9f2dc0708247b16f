"""Sweep a parameter of the virtual system: the cart with a stop that is not there, over the frequency of its drive."""

import matplotlib.pyplot as plt
import numpy as np

import masking

ideal = masking.Experiment.load("cart_stop").changed(
    controller={"rate": "continuous"}, effects={"friction": False}, duration=30
)
frequencies = np.linspace(9.0, 14.0, 50)
found = []
for frequency in frequencies:
    run = ideal.changed(parameters={"Om": float(frequency)}).run()
    period = 2 * np.pi / frequency
    strobe = period * np.arange(np.ceil(20.0 / period), np.floor(30.0 / period))  # once in each, after the transient
    found.append(np.interp(strobe, run.t, run["virtual.x"]))
    assert max(run.manifest["masking_error"].values()) < 1e-6

figure, axes = plt.subplots()
axes.plot(np.repeat(frequencies, [len(x) for x in found]), 1e3 * np.concatenate(found), ".", markersize=3)
axes.set(xlabel="frequency of the drive (rad/s)", ylabel="x once in each period (mm)")
figure.savefig("bifurcation.png")

spread = [float(np.ptp(np.round(x, 5))) for x in found]
print(f"the period is that of the drive at {sum(s < 1e-4 for s in spread)} of {len(found)} frequencies")
