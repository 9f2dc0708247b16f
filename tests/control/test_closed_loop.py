"""What a new user asks for: masked on the ideal rig and on the imperfect twin, better than by hand."""

import numpy as np
import pytest

from masking.control.exports.controller_units import sampled_unit
from tests.benchmarks.wishes import GAPS, UNSENSED, WISHES, against_the_hand, driven, in_c, largest, own_loop, sweep
from tests.support.compiled_unit import GCC, CompiledUnit

BAR = 0.03
VAN_DER_POL = WISHES["Van der Pol"]


@pytest.mark.parametrize("text", WISHES)
def test_wish_on_the_ideal_rig(text):
    assert WISHES[text].on_ideal(WISHES[text].short) <= 1e-6


@pytest.mark.parametrize("text", WISHES)
def test_wish_on_the_imperfect_twin_beside_a_controller_written_by_hand(text):
    wish = WISHES[text]
    run = wish.run()
    assert largest(run) <= BAR
    assert largest(run) < wish.by_hand(run)


def test_a_push_without_a_force_sensor_is_felt_better_than_by_hand():
    ours, theirs = against_the_hand(WISHES[UNSENSED])
    assert ours < theirs


@pytest.mark.search
def test_a_sweep_on_the_imperfect_twin_beside_a_controller_written_by_hand():
    ideal, ours, theirs = sweep(GAPS[::14]).T
    assert len(ours) >= 2
    assert ideal.max() <= 1e-6
    assert np.median(ours) <= BAR
    assert np.all(ours < theirs)


def test_a_loop_of_ones_own_gives_the_run():
    ideal, ours = own_loop(VAN_DER_POL)
    assert ideal <= 1e-6
    assert ours == pytest.approx(largest(VAN_DER_POL.run()), rel=1e-6)


@pytest.mark.skipif(GCC is None, reason="there is no gcc")
def test_the_controller_in_c_gives_the_run(tmp_path):
    ideal, ours = in_c(VAN_DER_POL, tmp_path)
    assert ideal <= 1e-6
    assert ours == pytest.approx(largest(VAN_DER_POL.run()), rel=1e-6)


@pytest.mark.skipif(GCC is None, reason="there is no gcc")
def test_the_controller_in_c_gives_the_commands(tmp_path):
    experiment = VAN_DER_POL.experiment.changed(duration=40)
    run, ours, begun = experiment.run(), experiment.controller(), False
    unit = CompiledUnit(tmp_path, sampled_unit(experiment.sampled, "controller", 0.02))

    def both(readings):
        nonlocal begun
        if not begun:
            unit.init(readings)
            begun = True
        found, expected = unit.step(readings), ours(readings)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * 2.0)
        return found.copy()

    assert driven(experiment, both, run) <= BAR
