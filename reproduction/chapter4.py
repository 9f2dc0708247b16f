"""Chapter 4: identification of the set-up, on the twin."""

from __future__ import annotations

import functools

import numpy as np

from masking.estimation.data import Data
from masking.estimation.fit import fit
from masking.estimation.kalman import extended_kalman
from masking.estimation.simulation import Simulated, simulate
from masking.modelling.model import load_model
from masking.procedures.springs import spring_curve
from masking.reports.style import Series
from masking.rig.twin import Twin
from masking.signals import Multisine, crest_factor, minimise_crest, multisine, ramp, steps, time_factor
from reproduction.comparison import Entry, Value, declared, experimental
from reproduction.errata import GAINS, table_b_2
from reproduction.plots import curves
from reproduction.simulated_records import RATE, alone, recorded

NAMES = ("blue", "red", "beam")
FREE = ("w", "z", "c")
FREE_MOTION = ("mu1", "mu2", "w3", "z3")  # the document, too, corrects the beam after it was identified alone
PEAK = (0.2, 0.2, 0.25)  # V, of the excitation of each
SECONDS = 200.0


def table_4_2() -> Entry:
    """Dimensionless parameters of the set-up, derived from those in SI units, and the mass ratios of Table 4.4."""
    model = load_model("setup").dimensionless()
    ours = model.parameter_values()
    printed = {
        **{f"w{i}": x for i, x in zip((1, 2, 3), (0.9443, 1.0557, 0.7325), strict=True)},
        **{f"z{i}": x for i, x in zip((1, 2, 3), (0.3362, 0.4296, 0.0409), strict=True)},
    }
    rows = list(declared(model, printed, "Table 4.2"))
    why = "the table multiplies by wbar^2 instead of dividing; see the erratum of Table 4.1"
    rows += [
        Value(f"lam{i}", ours[f"c{i}"], document=value, where="Table 4.2", independent=truth, why=why)
        for i, value, truth in zip((1, 2, 3), GAINS, (9.945, 11.05, 0.5984), strict=True)
    ]
    rows += declared(model, {"mu1": 0.0411, "mu2": 0.0578}, "Table 4.4")
    return Entry("Table 4.2", "Dimensionless parameters (with Tables 4.1, 4.4 and B.1)", "table", tuple(rows))


def fig_4_2() -> Entry:
    """The multisine whose crest factor is smallest."""
    printed, beat, sampled = table_b_2()
    ours = minimise_crest(Multisine.harmonic(np.arange(1, 26), beat), starts=12)
    turned = (
        f"over 200 s the phases of lines that are no harmonics turn; see the erratum of 4.2.1. Harmonics of "
        f"{beat:.4f} s keep theirs"
    )
    values = (
        Value("crest factor of Table B.2 over a beat of 0.96 s", sampled, document=1.4838, where="p. 24"),
        Value(
            "crest factor of Table B.2 over 200 s",
            crest_factor(printed, 200.0),
            document=1.4838,
            where="p. 24",
            independent=2.66,
            why=turned,
        ),
        Value(
            "crest factor of our 25 harmonics of 0.96 s",
            crest_factor(ours),
            document=1.4838,
            where="p. 24",
            why="the norm is minimised to p = 512 from 12 starts; the document stops at p = 10",
        ),
        Value(
            "time factor of Table B.2 over a beat, s",
            time_factor(printed, beat),
            document=200.0,
            where="p. 24",
            why="(4.8) with the printed crest factor gives 25 * 1.4838^2 / 2 = 27.5; 200 s is the length of the record",
        ),
        Value(
            "time factor of Table B.2 over 200 s, s",
            time_factor(printed, 200.0),
            document=200.0,
            where="p. 24",
            why="(4.8) over the record",
        ),
    )
    t = np.linspace(0.0, beat, 2001)
    wave = {"Table B.2": printed.sample(t), "ours": ours.sample(t)}
    title = "Multisine with the smallest crest factor, over one beat"
    return Entry(
        "Fig. 4.2",
        title,
        "figure",
        values,
        (),
        curves(13.2929 * t, [("v (unit amplitudes)", wave)], r"$\tau$", title, height=2.4),
    )


def fig_4_3() -> Entry:
    """Each oscillator alone under the multisine, and the parameters that are found."""
    chi = {1: 0.0649, 2: 0.1025, 3: 0.2267}
    truths = load_model("setup").parameter_values()
    rows, shown = [], []
    for number, printed in chi.items():
        found, made, filtered = _identified(number)
        rows.append(
            Value(f"chi, multisine, {NAMES[number - 1]}", found["s"], document=printed, where="Table 4.3", within=0.1)
        )
        ways = (
            (
                "least squares",
                made,
                "the twin has other springs, damping and gains than the linear model it is fitted by",
            ),
            ("extended Kalman filter", filtered, "as above; the document tuned by hand what its filter gave"),
        )
        for way, ours, why in ways:
            rows += [
                Value(f"{n}{number}, {way}", ours[n], truths[f"{n}{number}"], "Table B.1", within=0.1, why=why)
                for n in FREE
            ]
        response = _response(number, _wave(number))
        shown.append((response, number))
    title = "Response to the multisine, measured on the twin and simulated"
    return Entry("Fig. 4.3", title, "figure", experimental(*rows), (_why_twin(),), _pictured(shown, title, 60.0))


def fig_4_4() -> Entry:
    """Each oscillator alone under steps of growing amplitude."""
    chi = {1: 0.0666, 2: 0.0628, 3: 0.2796}
    rows, shown = [], []
    for number, printed in chi.items():
        response = _response(number, _stairs(number))
        rows.append(
            Value(
                f"chi, steps, {NAMES[number - 1]}", response.chi["s"], document=printed, where="Table 4.3", within=0.1
            )
        )
        shown.append((response, number))
    title = "Response to steps of growing amplitude, measured on the twin and simulated"
    words = ("The parameters are those that fit the multisine.",)
    return Entry("Fig. 4.4", title, "figure", experimental(*rows), words, _pictured(shown, title, 1e9))


def fig_4_5() -> Entry:
    """Free motion of the whole rig, and the mass ratios."""
    twin = Twin.load("tue_rig")
    released = np.array([-0.005, -0.004, 0.0])  # m, as in chapter 5
    record = recorded(twin, np.zeros((round(4.6 * RATE), 3)), moved=released)
    names = {f"{n}{i}": _identified(i)[1][n] for i in (1, 2, 3) for n in ("w", "z")}
    linear = Twin.load("linear_rig")
    begun = linear.with_parameters(names)
    found = fit(begun, record, FREE_MOTION)
    ours = dict(zip(found.names, map(float, found.values), strict=True))
    simulated = simulate(begun.with_parameters(ours), record)
    # The same from wrong values on a rig that is as the linear model: what the procedure itself does.
    plain = recorded(linear, np.zeros((round(4.6 * RATE), 3)), moved=released)
    check = fit(linear.with_parameters({"mu1": 0.06, "mu2": 0.04, "w3": 9.0, "z3": 0.06}), plain, FREE_MOTION)
    right = dict(zip(check.names, map(float, check.values), strict=True))
    absent = "on a rig that is as the linear model the same procedure finds them: friction and hysteresis go into them"
    rows = [
        Value(f"{name}, fitted", ours[name], document=x, where="Table 4.4", within=0.1, why=absent)
        for name, x in (("mu1", 0.0411), ("mu2", 0.0578))
    ]
    rows += [
        Value(f"{name}, fitted to the linear rig", right[name], document=x, where="Table 4.4")
        for name, x in (("mu1", 0.0411), ("mu2", 0.0578))
    ]
    printed = {"s1": 0.05448, "s2": 0.1307, "s3": 0.0869}
    rows += [
        Value(f"chi, free motion, {colour}", simulated.chi[s], document=x, where="Table 4.5", within=0.1)
        for (s, x), colour in zip(printed.items(), NAMES, strict=True)
    ]
    title = "Free motion of the whole rig, measured on the twin and simulated"
    series = [
        (f"{s} (V)", {"measured": record.readings[:, i], "simulated": simulated.readings[:, i]})
        for i, s in enumerate(simulated.sensors)
    ]
    picture = curves(13.2929 * simulated.times, series, r"$\tau$", title, height=1.2)
    return Entry("Fig. 4.5", title, "figure", experimental(*rows), (), picture)


def fig_4_6() -> Entry:
    """Spring characteristics from a slow ramp, beside the linear approximation and the printed polynomials."""
    values = load_model("setup_springs").parameter_values()
    si = load_model("setup").dimensionless().parameter_values()
    grid = np.linspace(-1.0, 1.0, 401)
    rows: list[Value] = []
    lines: list[tuple[str, dict[str, Series]]] = []
    for number in (1, 2, 3):
        twin = alone(number, is_true=True)
        wave = ramp(0.9 * 0.42 if number == 3 else 0.12 * 0.42, duration=60.0, rate=RATE)
        force = wave["u"]
        record = recorded(twin, force[:, None])
        curve = spring_curve(wave.times, record.readings[:, 0], force, scale=1.0, force_scale=0.42)
        rho = [values[f"rho{number}{j}"] for j in range(6)]
        printed = np.asarray(np.polynomial.polynomial.polyval(grid, rho), dtype=np.float64)
        inside = np.abs(grid) < min(abs(curve.lowest), curve.highest)
        measured = np.where(inside, curve.at(np.where(inside, grid, 0.0)) / 0.42, np.nan)
        linear = si[f"w{number}"] ** 2 / si[f"c{number}"] * grid
        calibrated = (1.078 / 1.03, 1.109 / 0.97, 1.0 / 1.03)[number - 1]
        secant = rho[1] + rho[3] + rho[5]
        off = (
            "a volt of this actuator makes another force than the model knows (appendix C.5 and the twin's error of "
            f"gain): {calibrated:.3f} times as many volts hold a displacement; hysteresis and friction add to that"
        )
        rows.append(
            Value(
                f"rho_{number}1, stiffness at 0, {NAMES[number - 1]}",
                float(curve.stiffness(0.0)) / 0.42,
                document=rho[1],
                where="Table B.4",
                within=0.02,
                why=off,
                twin=True,
            )
        )
        rows.append(
            Value(
                f"rho_{number}1, gain taken out",
                float(curve.stiffness(0.0)) / 0.42 / calibrated,
                document=rho[1],
                where="Table B.4",
                within=0.05,
                why="hysteresis: the loop's middle is the spring's only far from its turns",
                twin=True,
            )
        )
        rows.append(
            Value(
                f"w{number}^2/lam{number}, linear",
                si[f"w{number}"] ** 2 / si[f"c{number}"],
                document=rho[1],
                where="Table B.4",
                within=0.1,
                why=f"the linear spring lies between the tangent at 0 and the secant at full stroke, {secant:.3f}",
            )
        )
        lines.append(
            (
                f"v, {NAMES[number - 1]}",
                {"Table B.4": printed, "from the twin's ramp": measured / calibrated, "linear model": linear},
            )
        )
    title = "Spring characteristics"
    return Entry("Fig. 4.6", title, "figure", tuple(rows), (), curves(grid, lines, r"$\Delta\xi$", title, height=1.3))


@functools.cache
def _identified(number: int) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Return chi of each sensor, the parameters of least squares, and those of the extended Kalman filter."""
    record, linear = _wave(number), alone(number, is_true=False)
    found = fit(linear, record, FREE)
    off = linear.with_parameters({name: 1.1 * linear.parameter_value(name) for name in FREE})
    filtered = extended_kalman(off, record, FREE)
    least = dict(zip(found.names, map(float, found.values), strict=True))
    return found.chi, least, dict(zip(FREE, map(float, filtered.values), strict=True))


@functools.cache
def _wave(number: int) -> Data:
    """Return a record of one oscillator alone under the multisine."""
    made = multisine(table_b_2()[0], rate=RATE, duration=SECONDS)
    samples = made["u"][:, None] * PEAK[number - 1] / np.abs(made["u"]).max()
    return recorded(alone(number, is_true=True), samples, name=f"multisine, {NAMES[number - 1]}")


@functools.cache
def _stairs(number: int) -> Data:
    """Return a record of one oscillator alone under steps."""
    made = steps(PEAK[number - 1] / 2.0, number=4, hold=2.0, rate=RATE)
    return recorded(alone(number, is_true=True), made["u"][:, None], name=f"steps, {NAMES[number - 1]}")


def _response(number: int, record: Data) -> Simulated:
    linear = alone(number, is_true=False).with_parameters(_identified(number)[1])
    return simulate(linear, record)


def _why_twin() -> str:
    return (
        "Each oscillator of the twin is recorded alone, the others held, with friction, hysteresis, its measured "
        "spring, noise and steps of the sensor; the linear model (4.13) is fitted to the record of 200 s. The filter "
        "has the covariances of section 4.2.2 and begins 10 % off. In the document the beam is fitted worst, on the "
        "twin the red oscillator, whose spring of Table B.4 bends most."
    )


def _pictured(shown: list[tuple[Simulated, int]], title: str, tau: float) -> bytes:
    rows = []
    times = shown[0][0].times * 13.2929
    part = times <= tau
    for response, number in shown:
        readings = {"measured": response.record.readings[part, 0], "simulated": response.readings[part, 0]}
        rows.append((f"{NAMES[number - 1]} (V)", readings))
    return curves(times[part], rows, r"$\tau$", title, height=1.2)
