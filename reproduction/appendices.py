"""Errata of chapter 4 and of appendices B and C, and what their other figures and tables show."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from masking.inference.estimation.simulation import simulate
from masking.inference.procedures.friction import shift_of_equilibrium
from masking.lab.signals import Multisine, crest_factor, sawtooth
from masking.model.modelling.model import Model, load_model
from reproduction.comparison import Entry, Value
from reproduction.simulated_records import PEAK, RATE, alone, multisine_record, recorded

NAMES = ("blue", "red", "beam")
# Table B.3, in units of pi.
_PHASES = (
    *(0.5160, 1.0146, 1.2792, 0.1630, 0.2704, 0.6175, 1.8581, 0.4419, 1.4532, 0.3311, 2.9592, 0.8852, 1.2443),
    *(1.6920, 1.3122, 1.5676, 0.7970, 0.4583, 0.0768, 0.1754, 2.0268, 0.1898, 1.3690, 0.5438, 1.6525, 0.7727),
    *(0.3312, 0.1863, 1.2465, 0.9476, 0.3167, 1.2186, 1.5124, 1.1894, 0.7794, 0.3178, 0.8564, 0.7474, 1.0013),
    *(1.0380, 0.0072, 0.6064, 0.8849, 1.7063, 0.9052, 0.5380, 0.8555, 1.7034, 1.8075, 0.4661),
)
# Appendix C.6.1, in SI units.
SLIT, RADIUS, LENGTH, SPEED, MASS = 0.5e-3, 3e-2, 4.83e-2, 0.15, 0.6
KINEMATIC, DYNAMIC = 13.30e-6, 1.813e-5  # of air at 20 degrees, m^2/s as printed, and Pa s
PERIOD = 60.0  # s, of a saw-tooth of appendix C.6.2
TEETH = 4


def momentum() -> Entry:
    """Equation (4.3): an actuator between two bodies moves their centre of mass."""
    printed = Path(__file__).parent / "models" / "setup_printed.yaml"
    values = load_model("setup").parameter_values()
    why = "a force between an oscillator and the beam leaves their momentum as it is"
    rows = []
    for i in (1, 2):
        for name, model in (("ours", load_model("setup")), ("as printed", load_model(printed))):
            pushed = _momentum(model, i)
            rows.append(
                Value(f"sum of m x'' per m3 under u{i} = 1 V, {name}, m/s^2", pushed, independent=0.0, why=why)
                if name != "ours"
                else Value(f"sum of m x'' per m3 under u{i} = 1 V, ours, m/s^2", pushed, independent=0.0, given=True)
            )
    why = "of the gains of Table B.1 and the masses of Table 4.4, one is off: (4.3) holds for mu_i = c3/c_i only"
    rows += [
        Value(f"mu{i} with which (4.3) would hold, c3/c{i}", values["c3"] / values[f"c{i}"], x, "Table 4.4", why=why)
        for i, x in ((1, 0.0411), (2, 0.0578))
    ]
    words = (
        "Per mass of the beam, the force that adds c_i u_i to x_i'' is mu_i c_i u_i. (4.3) takes c3 u_i from the beam "
        "instead, since appendix C.5 found the forces of the actuators equal; with the printed gains and masses the "
        "momentum of the free machine then changes under an internal force, by 46 % of the force for u1. The packaged "
        "model `setup` takes mu_i c_i u_i; no figure needs the form of (4.3), which has the same motion wherever all "
        "three inputs are free.",
    )
    return Entry("Erratum: (4.3)", "Reaction of the oscillators' actuators", "erratum", tuple(rows), words)


def excitation() -> Entry:
    """Table 4.1: nu = 0.42 V as the largest input of every actuator."""
    si = load_model("setup").parameter_values()
    rows = [
        Value(f"oscillator {i} under a static {volts:g} V, strokes", si[f"c{i}"] * volts / si[f"w{i}"] ** 2 / si["l"])
        for volts in (0.42, 0.105)
        for i in (1, 2)
    ]
    reach = 12.0 / 5.0  # the axis of Fig. C.6, of half the way of a saw-tooth of 0.105 V
    rows.append(Value("the axis of Fig. C.6, 12 mm, strokes", reach))
    words = (
        "Table 4.1 scales every input by nu = 0.42 V, the maximum that can be applied. C.6.2 allows 0.42 V on the beam "
        "and 0.105 V on the oscillators: 0.42 V would drive them to more than ten strokes, 0.105 V to the travel that "
        "Fig. C.6 ends at. The records of chapter 4 are compared with the twin under 0.105 V and 0.42 V.",
    )
    return Entry("Erratum: Table 4.1, nu", "Largest input of the oscillators", "erratum", tuple(rows), words)


def red_spring() -> Entry:
    """Table B.4: the spring of the red oscillator."""
    rho, si = load_model("setup_springs_table").parameter_values(), load_model("setup").parameter_values()
    rows = []
    for i in (1, 2):
        linear = si[f"w{i}"] ** 2 * si["l"] / (si[f"c{i}"] * si["nu"])
        full = sum(rho[f"rho{i}{j}"] for j in range(6))
        rows.append(Value(f"static input at full stroke over the linear one, {NAMES[i - 1]}", full / linear))
    unit = si["c2"] * si["nu"]
    table = {f"measured_spring2_k{j}": rho[f"rho2{j}"] * unit / si["l"] ** j for j in range(6)}
    table["measured_spring2_k1"] -= si["w2"] ** 2
    chi = {
        spring: simulate(alone(2, is_true=False), multisine_record(2, chosen)).chi["s"]
        for spring, chosen in (("Fig. 4.6", {}), ("Table B.4", table))
    }
    why = "with the printed spring the printed linear model would fit the red oscillator half as well as it does"
    rows += [
        Value(f"chi, multisine, red, spring of {spring}", x, 0.1025, "Table 4.3", within=0.25, why=why, twin=True)
        for spring, x in chi.items()
    ]
    words = (
        "Fig. 4.6 and its text have both oscillators 'very linear and nearly identical', the linear model 'almost "
        "indistinguishable' from them. The polynomial that Table B.4 prints for the red one is 35 % off the linear "
        "model at full stroke. The twin and `setup_springs` have the coefficients of the blue one for both; "
        "`setup_springs_table`, and the effect `table_spring2` of the twin, have the printed ones.",
    )
    return Entry("Erratum: Table B.4", "Spring of the red oscillator", "erratum", tuple(rows), words)


def air() -> Entry:
    """Appendix C.6.1: the drag of the air in the slit of a voice coil."""
    mean = RADIUS * SPEED / (2.0 * SLIT)
    across = np.linspace(-0.5, 0.5, 2001)
    parabola = 1.0 - (2.0 * across) ** 2
    transported = {name: factor * float(np.trapezoid(parabola, across)) for name, factor in _PROFILES.items()}
    wall = 2.0 * math.pi * RADIUS * LENGTH
    drag = {
        "as printed": KINEMATIC * wall * 12.0 / 11.0 * mean / SLIT,
        "ours": DYNAMIC * wall * 6.0 * mean / SLIT,  # dv/dxi = 4 (3/2) v/t at the wall
    }
    why = "a parabola whose mean is the mean velocity peaks at 3/2 of it; 12/11 transports 8/11 of the volume"
    units = "the gradient at the wall is 6 v/t, not 12/11 v/t, and the force needs the dynamic viscosity"
    rows = [Value(f"volume transported, factor {n}", x, independent=1.0, why=why) for n, x in transported.items()]
    rows += [Value(f"drag, {n}, N", x, 1.2e-3, "C.8", within=0.1, why=units) for n, x in drag.items()]
    rows.append(Value("deceleration of an oscillator by that, m/s^2", drag["ours"] / MASS, 2e-3, "p. 77", why=units))
    si = load_model("setup").parameter_values()
    rows.append(Value("deceleration that is observed, 2 z1 w1 v, m/s^2", 2.0 * si["z1"] * si["w1"] * SPEED))
    words = ("The conclusion stands: air is a hundredth of the damping that is observed.",)
    return Entry("Erratum: C.6.1", "Drag of the air in a voice coil", "erratum", tuple(rows), words)


def table_b_3() -> Entry:
    """The multisine of 50 lines, whose phases were optimised to p = 2."""
    lines = np.linspace(0.01, 25.0, 50)
    beat = float(1.0 / (lines[1] - lines[0]))
    found = Multisine(lines, 1.0, np.pi * np.array(_PHASES))
    rows = (
        Value("crest factor of Table B.3 over a beat of 1.96 s", crest_factor(found, beat)),
        Value("largest phase that is printed, of pi", max(_PHASES)),
        Value("phases printed beyond 2 pi", float(sum(x > 2.0 for x in _PHASES))),
    )
    words = (
        "The document prints no crest factor for 50 lines; their phases are those of p = 2. Two of them are beyond "
        "2 pi, which no phase of Table B.2 is.",
    )
    return Entry("Table B.3", "Multisine of 50 lines", "table", rows, words)


def table_c_2() -> Entry:
    """Eigenfrequencies of the parts, beside those that were identified."""
    si = load_model("setup").parameter_values()
    heavier = "the table's are of parts without actuators and sensors, which chapter 4 has in motion"
    rows = (
        Value("w3/(2 pi), Hz", si["w3"] / (2.0 * math.pi), 1.92, "Table C.2, main beam", why=heavier),
        Value("w1/(2 pi), Hz", si["w1"] / (2.0 * math.pi), 3.64, "Table C.2, oscillator", why=heavier),
        Value("mass of the rig's beam per that of Table C.2's, of one spring", (1.92 * 2.0 * math.pi / si["w3"]) ** 2),
        Value("mass of oscillator 1 per that of Table C.2's, of one spring", (3.64 * 2.0 * math.pi / si["w1"]) ** 2),
    )
    words = (
        "The negative-stiffness mechanism that Table C.1 weighs lowers the oscillators' frequency too. Which part of "
        "each weight of Table C.1 moves is legible in part only, so that no mass ratio is made of it.",
    )
    return Entry("Table C.2", "Eigenfrequencies of beam and oscillator", "table", rows, words)


def fig_c_6() -> Entry:
    """Shift of the equilibrium in saw-teeth of growing force, on the twin."""
    rows = []
    for i, name in enumerate(NAMES, start=1):
        force = sawtooth(PEAK[i - 1], number=TEETH, period=PERIOD, rate=RATE)
        record = recorded(alone(i, is_true=True), force["u"][:, None])
        stroke = 5.0  # mm per V of the sensor
        found = shift_of_equilibrium(force.times, stroke * record.readings[:, 0], force["u"])
        rows += [
            Value(f"largest travel theta, {name}, mm", float(found.travel[-1]), twin=True),
            Value(f"delta of the largest travel, {name}, mm", float(found.shift[-1]), twin=True),
        ]
    words = (
        "The axes of Fig. C.6 end at 12 mm and 1.4 mm; its curves are not legible in the text. Its text has the beam's "
        "hysteresis much stronger than that of the oscillators, and the friction of the red one above its hysteresis. "
        "On the twin, which has the stop at 5.8 mm that this experiment led to, the red oscillator travels less.",
    )
    return Entry("Fig. C.6", "Shift of the equilibrium over the travel", "figure", tuple(rows), words)


_PROFILES = {"3/2": 1.5, "12/11": 12.0 / 11.0}


def _momentum(model: Model, actuator: int) -> float:
    """Return the sum of m_i x_i'' per mass of the beam at rest in the origin under 1 V of an actuator."""
    p, rates = model.parameter_values(), np.empty(6)
    model.kernels.derivative(0.0, np.zeros(6), np.eye(3)[actuator - 1], model.values(), rates)
    return float(np.array([p["mu1"], p["mu2"], 1.0]) @ rates[3:])
