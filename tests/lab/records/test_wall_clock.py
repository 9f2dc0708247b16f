"""Wall clock: instants as seconds from the first; truths are those of the standard library."""

import datetime

import numpy as np
import pytest

from masking.lab.records import wall_clock

FIRST = datetime.datetime(2024, 2, 28, 23, 59, 58, 250_000, tzinfo=datetime.UTC)
STEPS = [0.0, 1.5, 2.0, 86400.25, 90000.125]


@pytest.mark.parametrize(
    "form", ["%Y-%m-%d %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S.%f", "%d-%b-%Y %I:%M:%S.%f %p", "%m/%d/%Y %H:%M:%S.%f"]
)
def test_dates_are_seconds_from_the_first(form):
    texts = [(FIRST + datetime.timedelta(seconds=step)).strftime(form) for step in STEPS]
    np.testing.assert_array_equal(wall_clock.seconds(texts), STEPS)


def test_zones_midnight_and_parts_of_a_second():
    assert wall_clock.seconds(["2024-05-03T10:00:00Z", "2024-05-03T12:30:00.5+02:00"]).tolist() == [0.0, 1800.5]
    assert wall_clock.seconds(["23:59:59.999", "00:00:00.001", "12:00:00:500"]).tolist() == [0.0, 0.002, 43200.501]
    assert wall_clock.seconds(["10:00:00,000000001", "10:00:00,000000003"]).tolist() == [0.0, 2e-9]


def test_what_is_no_instant_is_missing():
    found = wall_clock.seconds(["10:00:00", "25:00:00", "OVL", "10:00:02", "2024-02-30 10:00:00"])
    np.testing.assert_array_equal(found, [0.0, np.nan, np.nan, 2.0, np.nan])
    assert not any(map(wall_clock.is_stamp, ["12:30", "10:00:61", "2024-05-03", "1", "", "10:00:00 4"]))


def test_days_that_may_be_months_are_not_guessed():
    assert np.isnan(wall_clock.seconds(["03/05/2024 10:00:00", "04/05/2024 10:00:00"])).all()
    assert wall_clock.seconds(["12/05/2024 10:00:00", "13/05/2024 10:00:00"]).tolist() == [0.0, 86400.0]
    assert wall_clock.seconds(["03/05/2024 10:00:00", "03/05/2024 10:00:01"]).tolist() == [0.0, 1.0]
