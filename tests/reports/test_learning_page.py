"""What a row says of a discovery: never at once that something is left and that nothing is missing."""

from dataclasses import replace

import pytest

from masking.inference.discovery.discovery_result import Errors
from masking.reports import learning_page
from tests.inference.discovery.test_force_decomposition import discoveries, rig
from tests.reports.test_discovery_text import gaps

__all__ = ["discoveries", "rig"]  # fixtures


@pytest.mark.parametrize(
    ("left", "closed", "measured", "cause"),
    [
        (0.01, True, "explains all", "nothing is missing"),
        (0.01, False, "leaves no more than noise, which is not white", "no cause of it is found"),
        (0.5, False, "leaves more than noise", "no cause of it is found"),
    ],
)
def test_without_a_cause_a_row_says_one_thing(discoveries, left, closed, measured, cause):
    errors = gaps((1.0, 0.1, 0.1), (left, 0.1, 0.1), (0.01, 0.1, 0.1))
    errors = replace(errors, validation=Errors(*errors.validation))
    found = replace(discoveries("friction"), verdict="none", effects=(), simulation_error=errors)
    vars(found)["closed"] = closed
    row = learning_page.facts(found)
    assert row["measured"] == measured
    assert row["cause"].startswith(cause)
    assert row["after"] == pytest.approx(left / 0.01)
