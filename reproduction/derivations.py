"""Errata of the source document's definitions, theorems and derivations, each shown by a calculation."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp

from masking.model.modelling.model import load_model
from reproduction.comparison import Entry, Value

RELEASED, FAR = -0.5, -10.0
AMPLITUDE = 0.4  # of the oscillators in Fig. 7.3, strokes


def shape_functions() -> Entry:
    """Theorem 5.1 and A.1: eta_i are asked to be odd."""
    # Of each eta: the restoring force -eta(x) x, and the integral of s eta(s).
    shapes = {
        "eta(x) = x": (-(RELEASED**2), FAR**3 / 3.0),
        "eta(x) = 1 + x^2/3": (-(1.0 + RELEASED**2 / 3.0) * RELEASED, FAR**2 / 2.0 + FAR**4 / 12.0),
    }
    rows = [Value(f"restoring force at {RELEASED}, {name}", force) for name, (force, _) in shapes.items()]
    rows += [Value(f"integral of condition 2 at x = {FAR:g}, {name}", energy) for name, (_, energy) in shapes.items()]

    def left(_: float, y: np.ndarray) -> float:
        return float(y[0] - FAR)

    run = solve_ivp(lambda _, y: (y[1], -(y[0] ** 2)), (0.0, 50.0), (RELEASED, 0.0), events=left, rtol=1e-9, atol=1e-9)
    name = f"tau at which an oscillator released at {RELEASED} passes {FAR:g}, eta(x) = x"
    rows.append(Value(name, float(np.concatenate(run.t_events or [])[0])))
    words = (
        "Theorem 5.1 and A.1 ask for odd, one to one eta_i, which multiply their argument in (5.4)-(5.6). An odd eta "
        "makes the force even: it does not restore, and the integral of condition 2 of the theorem goes to minus "
        "infinity on one side. Even functions are meant: the proof needs eta_i(q) q odd and one to one, for the step "
        "from (A.23) to (A.24), and theorem 7.1 applies it with eta_i = 1 + beta_i q^2/w_i^2.",
        "Likewise sigma(0) = 0 and x sigma(x) > 0 belong to sigma(x) x, the force; theorem 7.1 applies sigma = 1.",
    )
    return Entry("Erratum: theorem 5.1", "Odd shape functions", "erratum", tuple(rows), words)


def printed_eps() -> Entry:
    """Fig. 7.3: eps = 5e-4."""
    stroke, printed = load_model("setup").parameter_values()["l"], 5e-4
    nearest = {"an amplitude of 0.4": printed, "eps = 0.1": printed / stroke}
    rows = (
        Value("eps over the stroke of 5 mm", printed / stroke),
        *(
            Value(
                f"phase / pi nearest to 1 that (5.3) allows with {name}",
                1.0 - math.asin(eps / AMPLITUDE) / math.pi,
            )
            for name, eps in nearest.items()
        ),
    )
    words = (
        "The eps of Fig. 7.3 is 5e-4 where those of Fig. 5.3 and 5.4, of comparable amplitudes, are 0.15 and 0.12. In "
        "strokes it would keep the phase within 0.0004 pi of pi throughout, of oscillators with unequal amplitudes "
        "on a beam that moves. In metres it is a tenth of the stroke, which is what Fig. 7.3 is compared with.",
    )
    return Entry("Erratum: Fig. 7.3", "Unit of eps", "erratum", rows, words)


def inertia() -> Entry:
    """Equations (8.3) and (A.29): J_i."""
    g, length, why = 9.81, 0.25, "m l is no moment of inertia"
    rows = tuple(
        Value(
            f"point mass on 0.25 m, Hz, with J = {name}",
            math.sqrt(g * length / j) / (2.0 * math.pi),
            document=1.0,
            where="p. 56, approximately",
            why=why,
        )
        for name, j in (("m l^2", length**2), ("m l", length))
    )
    words = (
        "Below (8.3) and (A.29) the inertia of a disc with an eccentric mass is J = m l + J. It is m l^2 + J, which "
        "the ENOC paper has below (5.2). A point mass alone, J = 0, must swing as a pendulum of that length.",
        "Below (8.3) zeta_3 = b_3/(2 w_3 J_i) has the index of an outer disc; (A.29) has J_3.",
    )
    return Entry("Erratum: (8.3)", "Moment of inertia of a disc", "erratum", rows, words)


def power() -> Entry:
    """Equations (8.15) and (A.31): the derivative of the energy."""
    model = load_model("discs_eccentric").dimensionless()
    p = model.parameter_values()
    run = model.simulate(np.linspace(0.0, 50.0, 1001), tolerance=1e-12)
    x, v = run.positions, run.velocities
    rates, values = np.empty(6), model.values()
    acceleration = np.empty_like(v)
    for k, state in enumerate(np.hstack([x, v])):
        model.kernels.derivative(0.0, state, np.empty(0), values, rates)
        acceleration[k] = rates[3:]
    masses = np.array([p["mu1"], p["mu2"], 1.0])
    twist, twisting = x[:, :2] - x[:, 2:], v[:, :2] - v[:, 2:]
    springs = (masses[:2] * twist * twisting).sum(axis=1) + p["w3"] ** 2 * x[:, 2] * v[:, 2]
    weights = masses * np.array([p["nu1"], p["nu2"], p["nu3"]]) ** 2
    stored = springs + (weights * np.sin(x) * v).sum(axis=1)
    dissipated = -2.0 * p["z3"] * p["w3"] * v[:, 2] ** 2
    rows = tuple(
        Value(
            f"largest error of dV/dt over its largest value, with {name}",
            float(np.abs((masses * acceleration**n * v).sum(axis=1) + stored - dissipated).max())
            / float(np.abs(dissipated).max()),
        )
        for name, n in (("theta'' theta'", 1), ("theta''^2 theta', as printed", 2))
    )
    words = (
        "(8.15) and (A.31) print J_i theta_i''^2 theta_i' in the derivative of the energy; that of J_i theta_i'^2/2 is "
        "J_i theta_i'' theta_i'. Along a simulated motion only this makes dV/dt = -2 z3 w3 theta_3'^2, per inertia of "
        "the middle disc: (A.20), (8.15) and (A.32) leave out that factor, m_3 or J_3. The weight in (8.15) is also to "
        "be multiplied by theta_i'.",
    )
    return Entry("Erratum: (8.15)", "Derivative of the kinetic energy", "erratum", rows, words)


def index() -> Entry:
    """Equation (A.12): the damper of oscillator 2."""
    p = load_model("setup").dimensionless().parameter_values()
    force = p["mu2"] * 2.0 * p["z2"] * p["w2"]
    why = "a damper between oscillator and beam cannot move their centre of mass"
    rows = (
        Value("internal forces of damper 2 in sum, with x2' - x3'", force - force, independent=0.0, given=True),
        Value(
            "internal forces of damper 2 in sum, with x1' - x3', as printed",
            force,
            independent=0.0,
            why=why,
        ),
    )
    words = (
        "(A.12) prints the damping of oscillator 2 with x1' - x3'. With oscillator 2 alone moving, at a speed of 1, "
        "its damper would act on the beam (A.13) and not on the oscillator. (4.2) has x2' - x3'.",
    )
    return Entry("Erratum: (A.12)", "Damper of oscillator 2", "erratum", rows, words)
