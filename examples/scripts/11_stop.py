"""End a run when the clocks have synchronised, say how they did, and show that they are not chaotic."""

import masking
from masking.analysis.stability.lyapunov_exponent import largest_exponent
from masking.analysis.synchronisation import synchronisation
from masking.lab.runs.experiment import Experiment

clocks = Experiment.load("huygens").changed(stop={"when": "synchronised", "of": ["th1", "th2"], "eps": 0.02})
recording = clocks.run()
stop = recording.manifest["stop"]
print(f"ended after {stop['at']:.0f} of {stop['duration']:.0f} units of time")

whole = masking.run("huygens")
verdict = synchronisation(whole.t, whole["virtual.th1"], whole["virtual.th2"], names=("th1", "th2"))
print(verdict)

exponent = largest_exponent(clocks.virtual, 1000.0)
print(exponent)

assert stop["met"] and len(recording) < len(whole) and verdict.kind == "anti-phase" and not exponent.is_chaotic
