"""Hang Huygens' two clocks on the rig: they start almost in step and end in anti-phase, the beam at rest."""

import numpy as np

import masking
from masking.analysis.synchronisation import phase_difference

recording = masking.run("huygens")
phase = phase_difference(recording.t, recording["virtual.th1"], recording["virtual.th2"])

print(f"phase difference: {phase[0] / np.pi:.2f} pi at first, {phase[-1] / np.pi:.2f} pi at last")
assert abs(phase[0]) < 0.3 * np.pi
assert abs(abs(phase[-1]) - np.pi) < 0.01 * np.pi
