"""Change a parameter: a beam that is damped more lets the Duffing oscillators synchronise sooner."""

import masking
from masking.analysis.synchronisation import peak_sum

left = {}
for damping in (0.02, 0.04, 0.08):
    recording = masking.run("duffing", changes={"z3": damping})
    tau = recording.t / recording.manifest["time_scale"]
    left[damping] = peak_sum(tau, recording["virtual.x1"], recording["virtual.x2"], window=20.0)[-1]

print(f"|x1 + x2| at the end, for each damping of the beam: {left}")
assert left[0.08] < left[0.04] < left[0.02]
