"""Look at a model: declared in SI units as measured, dimensionless by derivation, integrated by itself."""

import numpy as np

import masking

rig = masking.load_model("setup").dimensionless()
print(f"gains of the actuators, in units of 0.42 V: {[round(rig.value(c), 4) for c in ('c1', 'c2', 'c3')]}")
assert np.allclose([rig.value("w1"), rig.value("w2"), rig.value("w3")], [0.9443, 1.0557, 0.7325], atol=1e-4)

motion = rig.simulate(np.linspace(0.0, 100.0, 1001), initial={"x1": 0.005, "x2": 0.0})
assert motion["x1"][0] == 1.0  # a full stroke
assert abs(motion["x1"][-1]) < 1e-2  # damped away
