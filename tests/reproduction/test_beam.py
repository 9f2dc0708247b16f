"""The beam of Table 4.3: what the page says was discovered explains the record of the twin."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from masking.inference.estimation.simulation import simulate
from reproduction.beam import BEAM, RATE, extended, record, unseen_error
from reproduction.simulated_records import alone

PAGE = (Path(__file__).parents[2] / "docs" / "thesis.md").read_text(encoding="utf-8")
SECTION = PAGE.partition("### Table 4.3: ")[2].partition("\n### ")[0]
ROWS = {
    name: float(ours) for name, ours in re.findall(r"^\| (\w[^|]*) \| [^|]*\| [^|]*\| (-?[\d.]+) \|", SECTION, re.M)
}
FOUND = {name: value for name, value in ROWS.items() if not name.startswith("chi")}


def chi(part: str) -> float:
    return next(value for name, value in ROWS.items() if name.startswith("chi") and part in name)


def test_the_linear_model_leaves_what_the_page_says():
    assert simulate(alone(BEAM, is_true=False), record()).chi["s"] == pytest.approx(chi("linear model"), rel=1e-3)


def test_the_named_causes_shrink_the_gap_as_the_page_says():
    unseen = unseen_error(extended(FOUND))
    assert unseen == pytest.approx(chi("what was discovered"), rel=0.1)
    assert unseen < 0.1 * chi("w, z and c fitted")
    without = {name: value for name, value in FOUND.items() if "hysteresis" not in name}
    assert unseen_error(extended(without)) > 5.0 * unseen, "hysteresis is what makes the difference"


def test_the_values_on_the_page_do_so_in_a_second_implementation():
    """Equations of Bouc and Wen by scipy, with the spring of Table B.4, for the first 10 s."""
    given, spring = record(), alone(BEAM, is_true=True)
    rho = [spring.parameter_value(f"measured_spring3_k{i}") for i in range(6)]
    w, z, c = (FOUND[name] for name in "wzc")
    k, x0, delta = (FOUND[f"{name} of bouc_wen_hysteresis"] for name in ("k", "x0", "delta"))
    damping, volts = 2.0 * z * w + FOUND["c of viscous_damping"], given.commands[:, 0]
    late = spring.late(RATE)[0]

    def rate(t, y):
        x, v, h = y
        command = volts[max(0, int(np.floor(t * RATE - late + 1e-9)))] if t * RATE >= late else 0.0
        bend = v - (abs(v) * np.sign(h) + delta * v) * abs(h / x0)
        return [v, c * command - w**2 * x - np.polynomial.polynomial.polyval(x, rho) - damping * v - k * h, bend]

    times = np.arange(round(10.0 * RATE)) / RATE
    rest = extended(FOUND)
    ours = simulate(rest, given).readings[: len(times), 0]
    found = solve_ivp(rate, (0.0, times[-1]), (0.0, 0.0, 0.0), t_eval=times, max_step=0.5 / RATE, rtol=1e-6, atol=1e-9)
    theirs = 200.0 * found.y[0]
    late_half = slice(len(times) // 2, None)
    assert np.linalg.norm(theirs[late_half] - ours[late_half]) < 0.05 * np.linalg.norm(ours[late_half])
