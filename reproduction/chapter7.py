"""Chapter 7: Duffing oscillators, Tables 7.2 and 7.3, Fig. 7.2 and 7.3."""

from __future__ import annotations

import numpy as np

from masking.analysis.synchronisation import mean_phase
from masking.modelling.model import load_model
from reproduction.chapter5 import on_rigs
from reproduction.comparison import Entry, Value
from reproduction.errata import PRINTED_TH
from reproduction.experiments import Printed, experiment
from reproduction.motion import Motion, simulated
from reproduction.plots import transient

SEEN = 0.05  # of the amplitude: less is not seen in a picture
SLIP = "printed is ten times (l/wbar)^2, without beta; see the erratum of Table 7.2"


def table_7_2() -> Entry:
    """Parameters of the simulation, made dimensionless by the program."""
    values = load_model("duffing_si").dimensionless().parameter_values()
    rows = (
        Value("w (both)", values["w"], document=1.0, where="Table 7.2"),
        Value(
            "th (both), beta l^2/wbar^2",
            values["beta"],
            document=PRINTED_TH,
            where="Table 7.2",
            independent=0.3333,
            why=SLIP,
        ),
        Value("mu (both)", values["mu"], document=0.0495, where="Table 7.2"),
        Value("w3, that of the beam, in the new time", values["w3"], independent=0.5316),
    )
    return Entry("Table 7.2", "Parameters of the Duffing oscillators, simulation", "table", rows)


def table_7_3() -> Entry:
    """Parameters of the experiment."""
    setup = load_model("setup").dimensionless().parameter_values()
    duffing = load_model("duffing_driven").parameter_values()
    rows = (
        Value("w (both)", duffing["w1"], document=1.0, where="Table 7.3"),
        Value("th (both)", duffing["th1"], document=PRINTED_TH, where="Table 7.3", independent=0.3333, why=SLIP),
        Value("mu1, that of the rig", setup["mu1"], document=0.0411, where="Table 7.3"),
        Value("mu2, that of the rig", setup["mu2"], document=0.0578, where="Table 7.3"),
    )
    return Entry("Table 7.3", "Parameters of the Duffing oscillators, experiment", "table", rows)


def fig_7_2() -> Entry:
    """Simulated Duffing oscillators."""
    motion = simulated(load_model("duffing").dimensionless(), 2500.0)
    truths = {625: 0.1365, 1250: 0.0179, 1875: 0.0024, 2500: 0.0003}
    settled = motion.settled()
    values = (
        *sum_peaks(motion, 20.0, truths),
        time_value(motion, 2500.0, "p. 39"),
        Value("phase / pi at the end", float(mean_phase(motion.phase[-400:])[0] / np.pi), document=1.0, where="p. 39"),
        *on_rigs("duffing", ideal=600.0),
    )
    words = (
        "The document's initial state is (-0.6, -0.5, 0). Ours is within 1 % of the amplitude of anti-phase from tau "
        f"= {settled:.0f} on. With the printed th = {PRINTED_TH} the oscillators would be linear; the decay of the "
        "sum is that of th = 1/3.",
    )
    title = "Duffing oscillators, simulated"
    return Entry("Fig. 7.2", title, "figure", values, words, transient(motion, title))


def fig_7_3() -> Entry:
    """Experiment with Duffing oscillators, on the twin."""
    linear = load_model("setup").parameter_values()
    words = (
        "The beam of these oscillators can stand still although their mass ratios differ: with equal frequencies that "
        f"asks for mu1 x1 + mu2 x2 = 0, amplitudes in the ratio mu2/mu1 = {linear['mu2'] / linear['mu1']:.3f} for "
        "small motions. The document's explanation, that non-identical oscillators leave only the origin, holds for "
        "unequal frequencies (Fig. 5.2); in Duffing oscillators unequal amplitudes make the frequencies differ.",
        "The printed eps of 5e-4 is a thousandth of the amplitude. The document does not say over which part of the "
        "record it was found; no motion here, with or without imperfections, is that near to (5.3).",
    )
    printed = Printed("Fig. 7.3", "p. 41", alpha=2.22, eps=5e-4, phase=1.0, time=600.0, duration=600.0)
    title = "Experiment with Duffing oscillators, on the twin"
    return experiment(printed, title, "duffing", "duffing_driven", largest=0.01, words=words)


def sum_peaks(motion: Motion, window: float, truths: dict[int, float], *, within: float | None = None) -> list[Value]:
    """Return the peaks of the sum of two oscillators at times, beside those computed independently."""
    return [
        Value(
            f"peak of the sum over {window:g} before tau = {tau}",
            motion.peak(tau, window),
            independent=truth,
            within=within,
        )
        for tau, truth in truths.items()
    ]


def time_value(motion: Motion, printed: float, where: str) -> Value:
    """Return when the sum of two oscillators is within 1 % of the amplitude, beside the time that is printed."""
    ours, amplitude = motion.settled(), motion.amplitude()
    left = motion.peak(min(printed, motion.t[-1]), 20.0) / amplitude
    why = (
        f"the document reads its time off the picture, where the sum is {left:.2g} of the amplitude"
        if left < SEEN
        else ""
    )
    return Value("tau from which the sum stays within 1 % of the amplitude", ours, printed, where, why=why)
