"""Declare a system of your own, a pair of Van der Pol oscillators that share a beam, and let the rig be it."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import masking

SYSTEM = """
name: two Van der Pol oscillators on a beam
coordinates: {x1: {initial: 0.4}, x2: {initial: -0.1}, x3: {initial: 0}}
parameters:
  a: {value: 0.3, meaning: limits the amplitude to 2 a}
  b: {value: 0.5, meaning: strength of the drive}
  k: {value: 0.1, meaning: coupling}
equations:
  x1'': -x1 + b*(1 - (x1/a)**2)*x1' + k*x3
  x2'': -x2 + b*(1 - (x2/a)**2)*x2' + k*x3
  x3'': -x3 - 2*x3' + k*(x1 + x2)
"""
EXPERIMENT = """
name: the rig as Van der Pol oscillators
plant: ideal
virtual: van_der_pol.yaml
time_scale: 0.1
duration: 100
"""

with TemporaryDirectory() as folder:
    Path(folder, "van_der_pol.yaml").write_text(SYSTEM)
    Path(folder, "experiment.yaml").write_text(EXPERIMENT)
    recording = masking.run(Path(folder, "experiment.yaml"))

amplitude = np.abs(recording["virtual.x1"][recording.t > 5.0]).max()
print(f"amplitude {amplitude:.3f}, relative errors {recording.manifest['masking_error']}")
assert max(recording.manifest["masking_error"].values()) < 1e-6
assert 0.5 < amplitude < 0.7
