"""Chapter 7: Duffing oscillators, Tables 7.2 and 7.3, Fig. 7.2 and 7.3."""

from __future__ import annotations

import numpy as np

from masking.analysis.synchronisation import mean_phase
from masking.model.modelling.model import load_model
from reproduction.chapter5 import on_rigs
from reproduction.comparison import Entry, Value, declared
from reproduction.errata import PRINTED_TH
from reproduction.experiments import Printed, experiment
from reproduction.motion import Motion, simulated
from reproduction.plots import transient

SEEN = 0.05  # of the amplitude: less is not seen in a picture
TABLES = "Tables 7.2 and 7.3"
SLIP = "printed is ten times (l/wbar)^2, without beta; see the erratum of Table 7.2"


def table_7_2() -> Entry:
    """Parameters of the simulation, made dimensionless by the program."""
    model = load_model("duffing_si").dimensionless()
    values = model.parameter_values()
    rows = (
        Value("w (both)", values["w"], document=1.0, where=TABLES),
        Value(
            "th (both), beta l^2/wbar^2",
            values["beta"],
            document=PRINTED_TH,
            where=TABLES,
            independent=0.3333,
            why=SLIP,
        ),
        *declared(model, {"mu": 0.0495}, "Table 7.2"),
        Value("w3, that of the beam, in the new time", values["w3"], independent=0.5316),
    )
    return Entry("Table 7.2", "Parameters of the Duffing oscillators, simulation", "table", rows)


def table_7_3() -> Entry:
    """Parameters of the experiment."""
    driven = load_model("duffing_driven")
    th = driven.parameter_values()["th1"]
    rows = (
        *declared(driven, {"w1": 1.0, "mu1": 0.0411, "mu2": 0.0578}, "Table 7.3"),
        Value("th (both)", th, document=PRINTED_TH, where=TABLES, independent=0.3333, why=SLIP),
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
        "The printed eps of 5e-4 is taken to be in metres, a tenth of the stroke: see the erratum of Fig. 7.3. The "
        "document does not say over which part of the record it was found.",
    )
    printed = Printed("Fig. 7.3", "p. 41", alpha=2.22, eps=0.1, phase=1.0, time=600.0, duration=600.0)
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


def time_value(motion: Motion, printed: float, where: str, window: float = 20.0) -> Value:
    """Return when the sum of two oscillators is within 1 % of the amplitude, beside the time that is printed."""
    ours, amplitude = motion.settled(), motion.amplitude()
    left = motion.peak(min(printed, motion.t[-1]), window) / amplitude
    why = (
        f"the document reads its time off the picture; over the {window:g} before, the sum is {left:.2g} of "
        "the amplitude"
        if left < SEEN
        else ""
    )
    return Value("tau from which the sum stays within 1 % of the amplitude", ours, printed, where, why=why)
