"""How densely a run is recorded: the fastest oscillation of its virtual system."""

import numpy as np
import pytest

from masking.lab.runs.record_rate import fastest

FREQUENCY, COUPLING = 7.0, 3.0
DELAYED = {
    "coordinates": {"x": {}},
    "parameters": {"w": {"value": FREQUENCY}, "k": {"value": COUPLING}},
    "equations": {"x''": "-w**2*x + k*delay(x, 0.2)"},
}


@pytest.mark.parametrize("initial", [(0.0, 0.0), (0.4, -1.0)])
def test_what_depends_on_the_past_is_held_there(declared, initial):
    """With x(t - 0.2) held, x'' = -w^2 x + constant: an oscillation at w."""
    assert fastest(declared(**DELAYED), np.array(initial)) == pytest.approx(FREQUENCY, rel=1e-6)
