"""What a new user asks for: masked on the ideal rig and on the imperfect twin, better than by hand."""

import numpy as np
import pytest

from masking.exports.controllers import sampled_unit
from masking.runs.experiment import Experiment
from tests.benchmarks.wishes import WISHES, driven, largest
from tests.compiled_unit import GCC, CompiledUnit

BAR = 0.03


@pytest.mark.parametrize("text", WISHES)
def test_wish_on_the_ideal_rig(text):
    assert WISHES[text].on_ideal(WISHES[text].short) <= 1e-6


@pytest.mark.parametrize("text", WISHES)
def test_wish_on_the_imperfect_twin_beside_a_controller_written_by_hand(text):
    wish = WISHES[text]
    run = wish.run()
    assert largest(run) <= BAR
    assert largest(run) < wish.by_hand(run)


def van_der_pol():
    return Experiment.load("cart_van_der_pol").changed(duration=40)


def test_a_loop_of_ones_own_gives_the_run():
    run = van_der_pol().run()
    assert driven(van_der_pol(), van_der_pol().controller(), run) == pytest.approx(largest(run), rel=1e-6)


@pytest.mark.skipif(GCC is None, reason="there is no gcc")
def test_the_controller_in_c_gives_the_run(tmp_path):
    experiment, ours = van_der_pol(), van_der_pol().controller()
    run, unit, begun = experiment.run(), None, False
    unit = CompiledUnit(tmp_path, sampled_unit(experiment.sampled, "controller", 0.02))

    def both(readings):
        nonlocal begun
        if not begun:
            unit.init(readings)
            begun = True
        found, expected = unit.step(readings), ours(readings)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * 2.0)
        return found.copy()

    assert driven(experiment, both, run) <= 0.03
