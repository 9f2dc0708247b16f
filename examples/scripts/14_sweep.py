"""Sweep a parameter of the virtual system: a cart with a stop that is not there, and a gap from 0 to 3 mm before it."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import masking

ideal = masking.Experiment.load("cart_stop").changed(
    controller={"rate": "continuous"}, effects={"friction": False}, duration=40
)
gaps = np.linspace(0.0, 3.0, 50)  # mm
drive, found, errors = 18.5, [], []  # rad/s
period = 2 * np.pi / drive
strobe = period * np.arange(np.ceil(25.0 / period), np.floor(40.0 / period))  # once in each, after the transient
for gap in gaps:
    run = ideal.changed(parameters={"Om": drive, "z": 0.1, "edge": float(gap)}).run()
    found.append(1e3 * np.interp(strobe, run.t, run["virtual.x"]))
    errors.append(run.manifest["masking_error"]["x"])

figure, axes = plt.subplots()
axes.plot(np.repeat(gaps, len(strobe)), np.concatenate(found), ".", markersize=2)
axes.set(xlabel="gap before the stop (mm)", ylabel="displacement once in each period of the drive (mm)")
Path("results").mkdir(exist_ok=True)
figure.savefig("results/bifurcation.png")

periods = [len(np.unique(np.round(x, 1))) for x in found]
regular = [error for error, count in zip(errors, periods, strict=True) if count < 3]
print(f"{len(regular)} of 50 gaps repeat after one or two periods, the others later or never: results/bifurcation.png")
print(f"largest masking error of these: {max(regular):.1e}; chaotic motions part, however small a difference")
assert len(regular) > 10
assert max(periods) > 10
assert max(regular) < 1e-6
