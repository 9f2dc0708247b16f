"""Let the controller sample: its inputs are held for 1/4 ms, and the motion is no longer quite the virtual system's."""

import masking

continuous = masking.run("duffing").manifest["masking_error"]["x1"]
sampled = masking.run("duffing_sampled").manifest["masking_error"]["x1"]

print(f"relative error of x1: {continuous:.1e} in continuous time, {sampled:.1e} at 4 kHz")
assert continuous < 1e-6 < sampled < 0.5
