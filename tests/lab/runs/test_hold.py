"""Order of the error of a held output: second in general, fourth but for the velocity that the release lacks."""

from __future__ import annotations

import numpy as np
import pytest

from masking.lab.runs.experiment import Experiment
from tests.benchmarks import held

RATES = (500, 1000, 2000)


def orders(errors):
    return np.log2(np.array(errors[:-1]) / errors[1:])


@pytest.mark.parametrize("system", held.SYSTEMS)
def test_the_error_is_of_second_order_and_a_shifted_velocity_explains_it_to_the_fourth(system):
    """A cart released at rest moves as one that begins with h^2/12 g', by scipy's integration of the wanted motion."""
    plain, shifted = zip(*(held.errors(system, rate) for rate in RATES), strict=True)
    assert orders(plain) == pytest.approx(2.0, abs=0.1)
    assert orders(shifted) == pytest.approx(4.0, abs=0.2)


def test_a_motion_without_a_rate_of_force_at_the_release_errs_by_the_fourth_order(tmp_path):
    found = []
    for rate in RATES:
        for name, text in held.declared("-100*x**3 + x", 1.0, rate).items():
            (tmp_path / name).write_text(text)
        (tmp_path / "cart.yaml").write_text(held.RIG["cart.yaml"].replace("c*x'", "0*c*x'"))
        found.append(Experiment.load(tmp_path / "experiment.yaml").run().manifest["masking_error"]["x"])
    assert orders(found) == pytest.approx(4.0, abs=0.2)
