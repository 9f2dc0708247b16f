"""Order of the error of a held output: second in general, fourth where the wanted force begins without a rate."""

from __future__ import annotations

import numpy as np
import pytest

from masking.lab.runs.experiment import Experiment

RATES = np.array([250, 500, 1000, 2000, 4000])
C, K = 2.0, 100.0
RIG = {
    "cart.yaml": "name: cart\ncoordinates: {x: {unit: m, initial: 0}}\ninputs: {F: {unit: N}}\n"
    "parameters: {m: {value: 1, unit: kg}}\nequations: {m*x'': F}\n",
    "rig.yaml": "name: rig\nmodel: cart.yaml\nsensors: {s: {measures: x, unit: m}}\n"
    "limits: {inputs: {F: {max: 1000, unit: N}}}\n",
}


def runs(tmp_path, equation):
    """Times and positions at each rate of a cart that is released at 1 m, and moves by an equation."""
    declared = {"wanted.yaml": f"name: wanted\ncoordinates: {{x: {{initial: 1}}}}\nequations: {{x'': {equation}}}\n"}
    for rate in RATES:
        declared["experiment.yaml"] = (
            "name: released\nplant: rig.yaml\nvirtual: wanted.yaml\nduration: 2\n"
            f"controller: {{rate: {rate} Hz, observer: {{kind: disturbance, noise: 1e-9}}}}\n"
        )
        for name, text in (RIG | declared).items():
            (tmp_path / name).write_text(text)
        made = Experiment.load(tmp_path / "experiment.yaml").run()
        yield made, made.t, made["rig.x"]


def orders(errors):
    return np.log2(np.array(errors[:-1]) / errors[1:])


def test_a_damped_motion_errs_by_the_second_order_which_a_shifted_velocity_explains(tmp_path):
    """With g' = c K at the release, the cart moves as one that begins with h^2/12 g' instead of at rest."""
    shifted, plain = [], []
    w = np.sqrt(K - C * C / 4.0)
    for rate, (_, t, x) in zip(RATES, runs(tmp_path, f"-{C}*x' - {K}*x"), strict=True):
        for found, velocity in ((shifted, C * K / 12.0 / rate**2), (plain, 0.0)):
            truth = np.exp(-C * t / 2.0) * (np.cos(w * t) + (velocity + C / 2.0) / w * np.sin(w * t))
            found.append(np.max(abs(x - truth)))
    assert orders(plain) == pytest.approx(2.0, abs=0.1)
    assert orders(shifted)[:3].min() > 2.9  # the next order is the third


@pytest.mark.parametrize("equation", [f"-{K}*x", f"-{K}*x**3"])
def test_a_motion_without_a_rate_of_force_at_the_release_errs_by_the_fourth_order(equation, tmp_path):
    errors = [made.manifest["masking_error"]["x"] for made, _, _ in runs(tmp_path, equation)]
    assert orders(errors)[:3] == pytest.approx(4.0, abs=0.2)
