"""Make the rig move as two coupled Duffing oscillators, and see how truly it does."""

import masking

recording = masking.run("duffing")
fidelity = recording.manifest["fidelity"]

print(f"{len(recording)} rows, {recording.t[-1]:.0f} s of the rig; relative errors {fidelity}")
assert max(fidelity.values()) < 1e-6
