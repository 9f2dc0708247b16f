"""The columns of variational equations over a step, against the same step in numpy."""

import numpy as np
import pytest

from masking.compile.codegen import column_step
from masking.compile.numerics.rig_sizes import LANES


def moved(columns, by_state, rates, h, coordinates):
    """Return S (n, width) after a step, with A (4 n, n) and B (4 n, width) of its stages."""
    n, slopes, at = len(columns), [], columns
    for stage in range(4):
        a, b = (table[stage * n : (stage + 1) * n].copy() for table in (by_state[:, :n], rates))
        a[:coordinates], b[:coordinates] = np.eye(n)[coordinates : 2 * coordinates], 0.0
        slopes.append(a @ at + b)
        at = columns + h * (1.0 if stage == 2 else 0.5) * slopes[-1]
    return columns + h / 6.0 * (slopes[0] + 2.0 * (slopes[1] + slopes[2]) + slopes[3])


@pytest.mark.parametrize("n", [6, 7, 8, 19])
@pytest.mark.parametrize("coordinates", [0, 1, 3])
def test_columns_move_as_in_numpy(n, coordinates):
    """Of sizes with code of their own, 6 and 7, and of others; a reading from beyond n would show."""
    (carry,) = column_step.link(6, coordinates, 1).values()
    generator = np.random.default_rng(n)
    columns, rates = generator.standard_normal((n, 3 * LANES)), generator.standard_normal((4 * n, 3 * LANES))
    by_state = generator.standard_normal((4 * n, n + 5))
    expected = moved(columns, by_state, rates, 0.01, coordinates)
    carry(by_state, rates, columns, 0.01)
    np.testing.assert_allclose(columns, expected, rtol=1e-12, atol=1e-13)
