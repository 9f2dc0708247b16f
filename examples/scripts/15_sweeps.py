"""Three sweeps: how fast discs synchronise, in which way Huygens' clocks do, and how sure that is on an imperfect rig.

`python examples/scripts/15_sweeps.py whole` makes them in full, on all cores.
"""

import sys

import numpy as np

import masking
from masking.analysis.synchronisation import running_peak, synchronisation_time

WHOLE = "whole" in sys.argv[1:]
WORKERS = None if WHOLE else 1
PERIODS = 10.0  # units of time: more than one period


def settled(recording: masking.Recording) -> float:
    """Return the time after which the sum of the discs stays below 1e-4 (definition 8.1)."""
    tau = recording.t / recording.manifest["time_scale"]
    return synchronisation_time(tau, recording["virtual.th1"] + recording["virtual.th2"], 1e-4)


def upsilon(recording: masking.Recording) -> float:
    """Return the time in which the sum of the discs decays to 1/e, once one mode is left (8.13)."""
    tau = recording.t / recording.manifest["time_scale"]
    peak = running_peak(tau, np.abs(recording["virtual.th1"] + recording["virtual.th2"]), PERIODS)
    late = (tau > PERIODS) & (peak < 1e-3) & (peak > 1e-6)
    return float(-1.0 / np.polyfit(tau[late], np.log(peak[late]), 1)[0])


def damping() -> float:
    """Return the damping of the middle disc at which the sum of the discs decays fastest: 0.394 in Fig. 8.4."""
    study = {"w3": 0.7252, "mu1": 0.0256, "mu2": 0.0256}  # Table 8.3
    over = {"z3": "0.05:2.5:200:log" if WHOLE else "0.2:0.8:13"}
    duration = 3000 if WHOLE else 800
    found = masking.sweep(
        "discs", over=over, measure=[settled, upsilon], changes=study, duration=duration, virtual=True, workers=WORKERS,
        out="results/sweep_discs", overwrite=True,
    )  # fmt: skip
    print(found)
    return float(found["z3"][np.nanargmin(found["upsilon"])])


def clocks() -> float:
    """Return the part of Huygens' clocks that end in anti-phase, over mass and damping, from 16 initial states each."""
    points = 100 if WHOLE else 3
    over = {"mu1,mu2": f"0.02:0.3:{points}", "z": f"0.02:0.6:{points}", "th2": "uniform:-0.785:0.785"}
    found = masking.sweep(
        "huygens", over=over, runs=16 if WHOLE else 2, sampling="latin", measure=["end"], virtual=True,
        workers=WORKERS, out="results/sweep_clocks", overwrite=True,
    )  # fmt: skip
    print(found)
    return float(np.mean([kind == "anti-phase" for kind in found["end"]]))


def rigs() -> float:
    """Return the part of imperfect rigs whose clocks synchronise; friction, damping, gains and springs are drawn."""
    over = {
        **{f"friction{i}.fc": "x:loguniform:0.5:2" for i in (1, 2, 3)},
        **{f"damping{i}.c": "x:uniform:0.5:1.5" for i in (1, 2, 3)},
        **{f"plant.c{i}": "x:normal:1:0.02" for i in (1, 2, 3)},
        **{f"plant.w{i}": "x:normal:1:0.005" for i in (1, 2, 3)},
    }
    found = masking.sweep(
        "huygens_rig", over=over, runs=1000 if WHOLE else 2, measure=["verdict", "alpha", "chi", "used"],
        duration=None if WHOLE else 60, workers=WORKERS, out="results/sweep_rigs", overwrite=True,
    )  # fmt: skip
    print(found)
    assert not any(found["error"])
    return float(np.mean([kind == "anti-phase" for kind in found["verdict"]]))


fastest = 0.0
if __name__ == "__main__":  # processes of the sweep import this script
    fastest = damping()
    print(f"fastest at z3 = {fastest:.3f}: results/sweep_discs/sweep.html")
    print(f"{clocks():.0%} of the clocks end in anti-phase: results/sweep_clocks/sweep.html")
    print(f"{rigs():.0%} of the rigs end in anti-phase: results/sweep_rigs/sweep.html")
assert __name__ != "__main__" or 0.3 < fastest < 0.5
