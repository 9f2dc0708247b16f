"""A virtual system whose motion has impacts, masked: scipy integrates from one touch to the next."""

import numpy as np
from scipy.integrate import solve_ivp

from masking.lab.runs.experiment import Experiment
from masking.model.modelling.model import load_model

G, K, LAM = 1.0, 200.0, 0.1


def fall(t, y):
    return [y[1], -G]


def contact(t, y):
    return [y[1], K * max(-y[0], 0.0) ** 1.5 * max(1.0 - LAM * y[1], 0.0) - G]


def touch(t, y):
    return y[0]


def truth(times):
    """Return heights and speeds: free falls and contacts in turn, each from the instant at which the last ended."""
    t, y, found, is_free = 0.0, [1.0, 0.0], np.empty((2, len(times))), True
    touch.terminal = True
    while t < times[-1]:
        touch.direction = -1.0 if is_free else 1.0
        one = solve_ivp(
            fall if is_free else contact, (t, times[-1]), y, "DOP853", events=touch, rtol=1e-12, atol=1e-14,
            dense_output=True, first_step=1e-3 if times[-1] - t > 1e-3 else None,
        )  # fmt: skip
        rows = (times >= t) & (times <= one.t[-1])
        found[:, rows] = one.sol(times[rows])
        t, y, is_free = one.t[-1], [0.0 if one.status == 1 else one.y[0, -1], one.y[1, -1]], not is_free
    return found


def test_a_bouncing_ball_moves_as_from_touch_to_touch():
    times = np.linspace(0.0, 20.0, 2001)
    found = load_model("bouncing_ball").simulate(times, tolerance=1e-12).states.T
    assert np.max(np.abs(found - truth(times))) <= 1e-7


def test_a_bouncing_ball_is_masked_in_continuous_time():
    run = Experiment.load("bouncing_ball").run()
    assert max(run.manifest["masking_error"].values()) <= 1e-6
    scale = 10.0  # units of virtual time in a second
    expected = truth(run["t"] * scale)[0]
    assert np.max(np.abs(run["virtual.x"] - expected)) <= 1e-5


def test_on_the_imperfect_rig_each_impact_comes_when_it_should():
    """Friction, which the observer cancels late at each reversal, changes the speed, and so the next flight."""
    run = Experiment.load("bouncing_ball_rig").changed(duration=19).run()
    times = run["t"] * 10.0
    expected = truth(times)[0]

    def touches(heights):
        before = np.flatnonzero((heights[:-1] > 0.0) & (heights[1:] <= 0.0))
        return times[before] + heights[before] / (heights[before] - heights[before + 1]) * (times[1] - times[0])

    late = np.abs(touches(run["virtual.x"]) - touches(expected))
    assert len(late) == 8
    assert np.all(late[:4] <= 0.03)
    assert np.all(late <= 0.15)
    part = times <= 10.0
    found, wanted = run["virtual.x"][part], expected[part]
    assert np.linalg.norm(found - wanted) <= 0.03 * np.linalg.norm(wanted)
