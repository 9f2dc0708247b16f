"""Errata of the source document, each shown by a calculation."""

from __future__ import annotations

import numpy as np
import sympy as sp
from scipy.integrate import cumulative_simpson
from scipy.optimize import minimize_scalar

from masking.lab.signals import Multisine, crest_factor
from masking.model.modelling.model import load_model
from reproduction.comparison import Entry, Value

# Table B.2, in units of pi.
_PHASES = (
    *(1.5706, 0.1425, 1.2977, 1.7042, 1.4277, 1.8201, 1.0641, 0.0000, 0.7113, 0.6608, 0.6606, 1.4765, 1.7126),
    *(1.8925, 1.5232, 0.8378, 1.9196, 1.9680, 0.0724, 1.2242, 0.1689, 0.0000, 1.3600, 0.1597, 0.6171),
)
PRINTED_TH = 7.4524e-7  # Table 7.2
GAINS = (3.1054e5, 3.4505e5, 1.8686e4)  # Table 4.2, lam_i
RHO = (0.091796394850297, 0.084268742935300, 0.680504615284765)  # Table B.4, rho_i1


def gains() -> Entry:
    """Table 4.1 and 4.2: lam_i."""
    si, ours = load_model("setup").parameter_values(), load_model("setup").dimensionless().parameter_values()
    wbar = 0.5 * (si["w1"] + si["w2"])
    power = "the table's (nu wbar^2/l) c has wbar^2 in the numerator: printed over ours is wbar^4"
    rows = [
        Value(
            f"lam{i} = nu c{i}/(l wbar^2)",
            ours[f"c{i}"],
            document=printed,
            where="Table 4.2",
            independent=truth,
            why=power,
        )
        for i, printed, truth in zip((1, 2, 3), GAINS, (9.945, 11.05, 0.5984), strict=True)
    ]
    rows += [
        Value(
            f"nu wbar^2 c{i}/l, as printed",
            si["nu"] * wbar**2 * si[f"c{i}"] / si["l"],
            document=printed,
            where="Table 4.2",
        )
        for i, printed in zip((1, 2, 3), GAINS, strict=True)
    ]
    rows += [
        Value(
            f"w{i}^2/lam{i}, against rho_{i}1",
            ours[f"w{i}"] ** 2 / ours[f"c{i}"],
            document=rho,
            where="Table B.4",
            within=0.35,
        )
        for i, rho in zip((1, 2, 3), RHO, strict=True)
    ]
    words = (
        "x = l xi and tau = wbar t make the input gain nu c/(l wbar^2). Printed over ours is "
        f"{GAINS[0] / ours['c1']:.0f} = wbar^4 = {wbar**4:.0f}. Only ours agrees with the measured springs: a static "
        f"input v holds xi = lam v/w^2, so that w1^2/lam1 = {ours['w1'] ** 2 / ours['c1']:.4f} is to be rho_11 = "
        f"{RHO[0]:.4f}; the printed gain would make it {ours['w1'] ** 2 / GAINS[0]:.2g}.",
    )
    return Entry("Erratum: Table 4.1", "Input gains lam in the dimensionless equations", "erratum", tuple(rows), words)


def cubic() -> Entry:
    """Table 7.2 and 7.3: th."""
    si = load_model("duffing_si").parameter_values()
    ours = load_model("duffing_si").dimensionless().parameter_values()["beta"]
    scale = (si["l"] / si["w"]) ** 2
    rows = (
        Value(
            "th = beta l^2/wbar^2",
            ours,
            document=PRINTED_TH,
            where="Tables 7.2 and 7.3",
            independent=0.3333,
            why="printed is ten times (l/wbar)^2, without beta; with it the oscillators would be linear",
        ),
        Value("10 (l/wbar)^2, in SI units", 10.0 * scale, document=PRINTED_TH, where="Tables 7.2 and 7.3"),
        Value(
            "beta that the printed th would belong to, 1/(m^2 s^2)",
            PRINTED_TH / scale,
            document=si["beta"],
            where="Table 7.2",
            why="a stiffness of 10 is none of the table's",
        ),
    )
    words = (
        f"Table 7.1 says beta = (wbar/l)^2 th, so that th = beta l^2/wbar^2 = {ours:.4f}. (l/wbar)^2 by itself is "
        f"{scale:.4e}: the printed 7.4524e-7 has its digits, ten times as large, and lacks the factor beta. Fig. 7.2 "
        "agrees with 1/3.",
    )
    return Entry("Erratum: Table 7.2", "Cubic stiffness of the Duffing oscillators", "erratum", rows, words)


def oscillator() -> Entry:
    """Equation (4.13)."""
    w, z = 0.9443, 0.3362
    printed = np.linalg.eigvals(np.array([[0.0, 1.0], [-(w**2), 2.0 * z * w]]))
    ours = np.linalg.eigvals(np.array([[0.0, 1.0], [-(w**2), -2.0 * z * w]]))
    rows = (
        Value("largest real part of an eigenvalue, as it should be", float(ours.real.max())),
        Value("largest real part of an eigenvalue, as printed", float(printed.real.max())),
    )
    words = (
        "(4.13) prints xi'' = -th1^2 xi + 2 th2 th1 xi' + th3 v. With the values of Table 4.2 it would grow; the sign "
        "of the damping is that of (4.4).",
    )
    return Entry("Erratum: (4.13)", "Sign of the damping", "erratum", rows, words)


def beam_sum() -> Entry:
    """Equations (7.4) and (7.7)."""
    x3, mu, w, th = sp.symbols("x3 mu w th")
    x = x3  # of the third oscillator, which is the beam
    third = float(mu * (w**2 * (x - x3) + th * (x - x3) ** 3))
    rows = (Value("a third term of the sum, with x3 - x3 = 0", third),)
    words = (
        "(7.4) and (7.7) sum over three oscillators; there are two, and Table 7.2 has no mu3, w_3 of an oscillator or "
        "th_3. Read literally, with the displacement x3 - x3, the third term vanishes; ours sums to two.",
    )
    return Entry("Erratum: (7.4)", "The sum over the oscillators", "erratum", rows, words)


def damping_entry() -> Entry:
    """Equation (8.11), last entry."""
    w3, si = 0.7252, 4.5564
    rows = []
    for what, factor in (("dimensionless w3", 1.0), ("w3 in rad/s, as printed", si / w3)):
        best = minimize_scalar(
            lambda z3, factor=factor: -1.0 / np.max(_sum_values(z3 * factor).real),
            bounds=(0.01, 0.8),
            method="bounded",
            options={"xatol": 1e-6},
        )
        rows.append(
            Value(
                f"fastest z3 with {what}",
                float(best.x),
                document=0.39,
                where="p. 48",
                why=f"w3 in rad/s makes the damping {si / w3:.4f} times as large, and the optimum so much smaller",
            )
        )
    words = (
        "The last entry of (8.11) is -2 z3 w3 with the letter of the frequency in rad/s; only the dimensionless one "
        "has the optimum that the document prints.",
    )
    return Entry("Erratum: (8.11)", "Last entry of the sum system's matrix", "erratum", tuple(rows), words)


def reaction() -> Entry:
    """Equations (A.4) and (A.10)."""
    m1, m2, m3 = 0.0411, 0.0578, 1.0
    # Acceleration of the centre of mass of the free machine under u2 alone, an internal force.
    forces = {"u3 - u1 - u2": -1.0, "u3 - u1 + u2": 1.0}
    total = {name: (1.0 + sign) / (m1 + m2 + m3) for name, sign in forces.items()}
    rows = tuple(
        Value(
            f"centre of mass under an internal u2 = 1, with {name}",
            value,
            independent=0.0,
            within=0.0,
            why=why,
            given=not why,
        )
        for (name, value), why in zip(
            total.items(), ("", "an actuator between oscillator and beam cannot move their centre of mass"), strict=True
        )
    )
    words = (
        "One of (A.4) and (A.10) has +u2 on the beam, the other -u2. The actuators of the oscillators push against "
        "the beam: without springs to the ground the centre of mass stays, and the nett input is u3 - u1 - u2 (4.3).",
    )
    return Entry("Erratum: (A.4)", "Reaction of the actuators on the beam", "erratum", rows, words)


def stiffness_power() -> Entry:
    """Equations (A.21) and (A.33)."""
    model = load_model("setup_identical").dimensionless()
    run = model.simulate(np.linspace(0.0, 100.0, 4001), tolerance=1e-12)
    p = model.parameter_values()
    drift = {}
    for what, stiffness in (("w3^2", p["w3"] ** 2), ("w3, as printed", p["w3"])):
        x, v = run.positions, run.velocities
        kinetic = 0.5 * (p["mu1"] * v[:, 0] ** 2 + p["mu2"] * v[:, 1] ** 2 + v[:, 2] ** 2)
        springs = 0.5 * sum(p[f"mu{i + 1}"] * p[f"w{i + 1}"] ** 2 * (x[:, i] - x[:, 2]) ** 2 for i in (0, 1))
        energy = kinetic + springs + 0.5 * stiffness * x[:, 2] ** 2
        lost = cumulative_simpson(2.0 * p["z3"] * p["w3"] * v[:, 2] ** 2, x=run.times, initial=0)
        balance = energy + lost
        drift[what] = float(np.ptp(balance) / balance[0])
    rows = (
        Value("energy that is not accounted for, over the first, with w3^2", drift["w3^2"]),
        Value("energy that is not accounted for, over the first, with w3", drift["w3, as printed"]),
    )
    words = (
        "The derivative of the energy is -2 z3 w3 xi_3'^2 (A.3). Along a simulated motion the energy and what was "
        "dissipated stay the same in sum with w3^2 in the place of (A.21) and (A.33), and not with w3.",
    )
    return Entry("Erratum: (A.21)", "Power of the beam's frequency", "erratum", rows, words)


def crest() -> Entry:
    """Section 4.2.1: the crest factor of Table B.2."""
    signal, beat, sampled = table_b_2()
    why = f"the lines 0.01 + k {1 / beat:.4f} Hz are not harmonics of one period: over 200 s their phases turn"
    rows = (
        Value("crest factor over one beat of 0.96 s, 1000 samples", sampled, document=1.4838, where="p. 24"),
        Value("crest factor over one beat, with the peaks between samples", crest_factor(signal, beat)),
        Value(
            "crest factor over the record of 200 s",
            crest_factor(signal, 200.0),
            document=1.4838,
            where="p. 24",
            independent=2.66,
            why=why,
        ),
    )
    words = ("The optimised signal has the printed crest factor over one beat only. " + why[0].upper() + why[1:] + ".",)
    return Entry("Erratum: 4.2.1", "Crest factor of the excitation", "erratum", rows, words)


def table_b_2() -> tuple[Multisine, float, float]:
    """Return the printed multisine, the time of one beat in s, and the crest factor of 1000 samples of a beat."""
    lines = np.linspace(0.01, 25.0, 25)
    signal, beat = Multisine(lines, 1.0, np.pi * np.array(_PHASES)), float(1.0 / (lines[1] - lines[0]))
    samples = signal.sample(beat * np.arange(1000) / 1000)
    return signal, beat, float(np.abs(samples).max() / np.sqrt(np.mean(samples**2)))


def _sum_values(z3: float) -> np.ndarray:
    """Return the eigenvalues of the sum system of Table 8.3 with a damping ratio."""
    w3, mu = 0.7252, 0.0256
    a = np.array([[0, 1, 0, 0], [-1, 0, 2, 0], [0, 0, 0, 1], [mu, 0, -(2 * mu + w3**2), -2 * z3 * w3]], dtype=float)
    return np.linalg.eigvals(a)
