"""Chapter 9: Huygens' pendulum clocks, Table 9.2, Fig. 9.2 and section 9.2."""

from __future__ import annotations

import math

import numpy as np

from masking.analysis.synchronisation import mean_phase
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.feasibility import Motion as Demanded
from masking.model.modelling.model import load_model
from reproduction.chapter5 import on_rigs
from reproduction.chapter7 import sum_peaks, time_value
from reproduction.comparison import Entry, Value, declared
from reproduction.motion import THESIS, masked, simulated
from reproduction.plots import sums, transient


def table_9_2() -> Entry:
    """Parameters of the clocks."""
    rows = (
        *declared(load_model("huygens"), {"w1": 1.0, "z": 0.2041, "mu1": 0.25}, "Table 9.2"),
        Value("Om = w3 / wbar", 4.0825 / 3.1321, document=1.3034, where="Table 9.2"),
        Value("w = sqrt(g / 1 m), rad/s", math.sqrt(9.81), document=3.1321, where="Table 9.2"),
    )
    return Entry("Table 9.2", "Parameters of Huygens' clocks", "table", rows)


def fig_9_2() -> Entry:
    """Simulated clocks."""
    motion = simulated(load_model("huygens"), 400.0)
    truths = {100: 0.107, 200: 0.0067, 300: 4.1e-4, 350: 1.1e-4, 400: 3e-5}
    values = (
        *sum_peaks(motion, 10.0, truths),
        time_value(motion, 350.0, "p. 54", 10.0),
        Value("phase / pi at the end", float(mean_phase(motion.phase[-400:])[0] / np.pi), document=1.0, where="p. 54"),
        *on_rigs("huygens", ideal=400.0),
    )
    title = "Huygens' clocks, simulated"
    return Entry("Fig. 9.2", title, "figure", values, (), transient(motion, title))


def section_9_2() -> Entry:
    """Clocks on the rig, which the document never got to synchronise, and the power that stronger coupling asks for."""
    ours = Experiment.load("huygens_rig")
    good = masked(ours)
    bad = masked(ours.changed(controller={**THESIS, "homing": 3}))
    last = [float(np.abs(m.a + m.b)[m.t > m.t[-1] - 10.0].max()) for m in (good, bad)]
    use = {name: demand(Experiment.load(name)) for name in ("pendula", "pendula_fast", "pendula_wide")}
    travel = demand(Experiment.load("pendula_wide"), "coordinate")
    values = (
        Value("sum / amplitude at last on the twin, our observer", last[0] / good.amplitude(0.02), twin=True),
        Value("sum / amplitude at last on the twin, the document's way", last[1] / bad.amplitude(0.02), twin=True),
        Value("demand over limit, 1 Hz and 1 degree", use["pendula"]),
        Value("demand over limit, 5 Hz", use["pendula_fast"], document=2.75, where="p. 56"),
        Value("demand over limit, 45 degrees", use["pendula_wide"], document=2.50, where="p. 56"),
        Value("travel over the stroke, 45 degrees", travel),
    )
    words = (
        "The document saw no synchronisation of the clocks on the rig and suspects cancellation errors and actuator "
        "power. On the twin its way leaves the pendula stuck where friction holds them; an observer that estimates "
        "disturbances, with the measured springs, lets them synchronise.",
        "The document does not say what it counts as power, nor how its beam moves; ours is the largest demand of any "
        "actuator over its limit of 0.42 V, of the linear rig from rest at full stroke. By this count its two ways of "
        "strengthening the coupling ask for less than half of what it prints. That of 45 degrees needs "
        f"{100.0 * travel:.0f} % of the stroke between an oscillator and the beam besides, and would meet its ends.",
    )
    title = "Clocks on the twin: our observer and the document's way"
    picture = sums({"disturbance observer": good, "document's way": bad}, title)
    return Entry("Section 9.2", title, "figure", values, words, picture)


def demand(experiment: Experiment, kind: str = "command") -> float:
    """Return the largest demand of a kind, of the actuators of a rig by default, over its limit."""
    uses, _, _ = Demanded(experiment).resolve()
    return max(use.part for use in uses if use.kind == kind)
