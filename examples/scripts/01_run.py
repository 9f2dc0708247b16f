"""Make the rig move as two coupled Duffing oscillators, and see how accurately it does."""

import masking

recording = masking.run("duffing")
errors = recording.manifest["masking_error"]

print(f"{len(recording)} rows, {recording.t[-1]:.0f} s of the rig; relative errors {errors}")
assert max(errors.values()) < 1e-6
