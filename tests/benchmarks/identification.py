"""Fits beside scipy: the same records, the same optimum; and how often intervals of 95 % hold the truth."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from masking.control.rig.twin import Twin
from masking.inference.estimation.fit import fit
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.sensitivity import Sensitivity
from tests.benchmarks.table import Row, few, judged, limited, told

NAMES = ("w1", "z1", "w2", "z2", "w3", "z3", "c1", "c2", "c3", "mu1", "mu2")
SIZE = (0.04, 0.04, 0.25)
SHORT, LONG, REPEATS = 8.0, 200.0, 200
LARGEST_DIFFERENCE = 1e-4


def rows() -> Iterator[Row]:
    """Measure fits of the eleven parameters of the linear rig."""
    twin = Twin.load("linear_rig")
    off = 1.0 + 0.1 * np.random.default_rng(1).uniform(-1.0, 1.0, len(NAMES))
    truth = np.array([twin.parameter_value(name) for name in NAMES])
    far = twin.with_parameters(dict(zip(NAMES, map(float, off * truth), strict=True)))
    yield _beside_scipy(twin, far)
    record = recorded(twin, LONG, 1000.0, 0)
    fit(far, record, NAMES)  # compiles
    seconds = timed(lambda: fit(far, record, NAMES))
    note = "eleven parameters that are up to 10 % off, 200 s at 1 kHz of three sensors"
    yield limited("fit of 200 s", f"{seconds:.3g} s", "", seconds, at_most=10.0, unit="s", note=note)
    inside, worst = 0, 0.0
    repeats = few(REPEATS)
    for seed in range(repeats):
        found = fit(far, recorded(twin, 20.0, 500.0, seed), NAMES)
        inside += int(np.sum((found.intervals[:, 0] <= truth) & (truth <= found.intervals[:, 1])))
        worst = max(worst, float(np.abs(found.values / truth - 1.0).max()))
    part = inside / (repeats * len(NAMES))
    yield judged("intervals of 95 %", f"{part:.1%}", "", part, at_least=0.93, note=f"{repeats} repeats, noise 1e-3")
    yield told("largest relative error in these", f"{worst:.2e}")


def recorded(twin: Twin, seconds: float, rate: float, seed: int) -> Data:
    """Return a record of the twin under sines from 0.3 to 6 Hz, with noise of 1e-3 of the stroke."""
    t = np.arange(round(seconds * rate)) / rate
    phases, lines = np.random.default_rng(7).uniform(0, 7, (3, 20)), 2 * np.pi * np.linspace(0.3, 6.0, 20)
    waves = [np.sin(lines * t[:, None] + phase).sum(axis=1) / np.sqrt(20) for phase in phases]
    made = Data("record", rate, np.array(waves).T * SIZE, np.zeros((len(t), 3)), twin.delay)
    clean = Sensitivity(twin, ()).simulate(np.empty(0), twin.rest(np.zeros(3)), made.acting, rate=rate, substeps=2)
    return replace(made, readings=clean + 1e-3 * np.random.default_rng(seed).standard_normal(clean.shape))


def timed(run: object) -> float:
    """Return the seconds that a call takes."""
    begin = time.process_time()
    run()  # type: ignore[operator]
    return time.process_time() - begin


def _beside_scipy(twin: Twin, far: Twin) -> Row:
    """Fit one short record by `least_squares` over `solve_ivp`, and by masking."""
    record = recorded(twin, SHORT, 500.0, 0)
    sensitivity = Sensitivity(far, NAMES)
    fit(far, record, NAMES)  # compiles
    ours = [timed(lambda: fit(far, record, NAMES)) for _ in range(3)]
    found = fit(far, record, NAMES)
    scale = np.concatenate([sensitivity.start(), [1e-3] * 3, [1e-2] * 3])
    period, acting = 1.0 / record.rate, np.ascontiguousarray(record.acting)

    def residuals(x: np.ndarray) -> np.ndarray:
        values = x * scale
        p, y = sensitivity.parameters(values[: len(NAMES)]), values[len(NAMES) :]
        out, reading, dy = np.empty_like(record.readings), np.empty(3), np.empty(6)
        derivative, none = far.kernels.twin_derivative, np.zeros(3)
        for index, command in enumerate(acting):
            far.kernels.sense(0.0, y, p, none, reading)
            out[index] = reading

            def slope(t: float, y: np.ndarray, command: np.ndarray = command) -> np.ndarray:
                derivative(t, np.ascontiguousarray(y), command, p, dy)
                return dy.copy()

            y = solve_ivp(slope, (0.0, period), y, rtol=1e-8, atol=1e-10).y[:, -1]
        return ((record.readings - out) / found.sigma).ravel()

    begin = time.process_time()
    theirs = least_squares(residuals, [*np.ones(len(NAMES)), *np.zeros(6)], x_scale="jac", max_nfev=few(6))
    seconds = time.process_time() - begin
    difference = float(np.abs(theirs.x[: len(NAMES)] * scale[: len(NAMES)] / found.values - 1.0).max())
    note = f"{SHORT:g} s at 500 Hz, shortest of 3 of ours; values differ by {difference:.1e}"
    what = "fit of eleven parameters: masking / least_squares over solve_ivp"
    return judged(what, f"{min(ours):.3g} s", f"{seconds:.4g} s", seconds / min(ours), at_least=100.0, note=note)
