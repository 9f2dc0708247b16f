"""Clocks: what is wrong with instants that were made to be wrong is told, and what to do about it."""

import numpy as np
import pytest

from masking.errors import RecordError
from masking.inference.procedures.channel_names import Source
from masking.lab.records.clock import rate, running_on
from masking.lab.records.recording import Recording

N = 20_000
INDEX = np.arange(N)
T = INDEX / 500.0


def normal(size, count=N):
    return size * np.random.default_rng(3).standard_normal(count)


def without(t, *cuts):
    return np.delete(t, np.concatenate([np.arange(a, b) for a, b in cuts]))


def rates(*parts):
    """Return instants of so many steps at one rate after another; each of `parts` is (rate, steps)."""
    return np.concatenate([[0.0], np.cumsum(np.concatenate([np.full(count, 1.0 / at) for at, count in parts]))])


def told(t, name="the record"):
    with pytest.raises(RecordError) as refused:
        rate(t, name)
    return str(refused.value)


@pytest.mark.parametrize("start", [0.0, 1234.5, 1.7e9])
def test_a_steady_clock_has_its_rate(start):
    assert rate(np.round(start + T, 6), "the record") == pytest.approx(500.0, rel=1e-7)


@pytest.mark.parametrize(
    ("t", "most", "step"),
    [
        (T + normal(4e-6), 5 * 4e-6, "0.002"),
        (T + normal(2e-4), 5 * 2e-4, "0.002"),
        (1.7e9 + T + normal(1e-4), 5e-4, "0.002"),
        (np.round(INDEX / 600.0, 3), 0.00055, "0.00166667"),
        (np.floor(INDEX / 600.0 * 1000.0) / 1000.0, 0.00105, "0.00166667"),
        (np.round(INDEX / 400.0, 3), 0.00055, "0.0025"),
        (np.round(INDEX / 900.0, 3), 0.00055, "0.00111111"),
        (np.round(INDEX[:500] / 60.0, 3), 0.00055, "0.0166667"),
    ],
    ids=["microseconds", "tenth", "epoch", "600 Hz", "cut", "400 Hz", "900 Hz", "60 Hz"],
)
def test_stamps_that_are_rounded_or_jitter(t, most, step):
    words = told(t)
    start, _, rest = words.partition(" s; ")
    assert start.startswith("the record: the time stamps are rounded or jitter by up to ")
    assert most / 4.0 < float(start.split()[-1]) <= most
    assert rest.startswith(f"if the samples are regular, leave the clock out and give --dt {step};")


@pytest.mark.parametrize(
    ("t", "words"),
    [
        (rates((500, 10000), (250, 9999)), "from 500 to 250 Hz at t = 20 s; use one part"),
        (rates((250, 100), (500, 19000)), "from 250 to 500 Hz at t = 0.4 s; use one part"),
        (rates((500, 500), (501, 400)), "from 500 to 501 Hz at t = 1 s; use one part"),
        (rates((500, 5000), (250, 5000), (500, 5000)), "from 500 to 250 Hz at t = 10 s, and 1 more time; use one part"),
        (np.round(rates((600, 9000), (300, 9000)), 3), "from 600 to 300 Hz at t = 15 s; use one part"),
        (without(rates((500, 10000), (250, 9999)), (3000, 3004)), "from 500 to 250 Hz at t = 20 s; use one part"),
    ],
    ids=["half", "start", "little", "there and back", "rounded", "with a gap"],
)
def test_a_rate_that_changes(t, words):
    assert told(t) == f"the record: the rate changes {words}"


@pytest.mark.parametrize(
    ("t", "words"),
    [
        (without(T, (10000, 10001)), "1 sample is missing after t = 19.998 s; cut the record there, and use one part"),
        (
            without(T, (400, 417), (9000, 9001)),
            "17 samples are missing after t = 0.798 s, and there is 1 more gap; cut",
        ),
        (
            without(T, (400, 401), (9000, 9003), (15000, 15500)),
            "1 sample is missing after t = 0.798 s, and there are 2",
        ),
        (without(T, (4000, 12000)), "8000 samples are missing after t = 7.998 s; cut"),
        (without(np.round(T + normal(2e-5), 4), (9000, 9003)), "3 samples are missing after t = 17.998 s; cut"),
        (without(np.round(INDEX / 600.0, 3), (9000, 9001)), "1 sample is missing after t = 14.998 s; cut"),
        (
            T[np.random.default_rng(0).random(N) > 0.2],
            "more gaps; interpolate it at one rate, such as --resample 500, or use one part",
        ),
        (np.array([0.0, 1.0, 2.0, 4.0]), "1 sample is missing after t = 2 s; cut"),
    ],
    ids=["one", "two", "three", "pause", "jitter", "rounded", "fifth", "short"],
)
def test_gaps(t, words):
    assert words in told(t)


@pytest.mark.parametrize(
    "t",
    [
        np.cumsum(1.0 / (500.0 * (1.0 + 0.01 * INDEX / N))),
        np.cumsum(1.0 / (500.0 * (1.0 + 0.01 * np.sin(INDEX / 2000.0)))),
    ],
    ids=["drift", "sine"],
)
def test_a_clock_that_wanders(t):
    words = told(t)
    assert "its clock is not steady: samples are from 0.00198 s to 0.002" in words
    assert "Hz; interpolate it at one rate, such as --resample 50" in words


@pytest.mark.parametrize(
    ("t", "start", "part"),
    [
        (rates((500, 10000), (250, 5000)), "@5:", "@5:20"),
        (rates((500, 5000), (250, 10000)), "@:50", "@10:50"),
        (without(T, (4000, 4010), (14000, 14001)), "", "@8.02:28.002"),
    ],
)
def test_the_longest_part_is_named(t, start, part, tmp_path):
    path = tmp_path / "record.csv"
    path.touch()
    assert told(t, f"{path}{start}").endswith(f"use one part, such as {path}{part}")


def test_procedures_and_identification_have_one_rule():
    source = Source("the record", Recording({"t": T + normal(4e-6), "x": T}))
    with pytest.raises(RecordError, match="the record: the time stamps are rounded or jitter by up to"):
        source.rate()


@pytest.mark.parametrize(("late", "periods"), [(0.5, "1.5"), (1.3, "2.3"), (20.5, "21.5"), (100.25, "101.3")])
@pytest.mark.parametrize("jitter", [0.0, 1e-6])
def test_a_hole_that_is_no_whole_number_of_samples_is_said_to_be_one(late, periods, jitter):
    t = T[:2000] + normal(jitter)[:2000] if jitter else T[:2000].copy()
    t[1000:] += late / 500.0
    assert f"{periods} sample periods, after t = 1.99" in told(t)


@pytest.mark.parametrize("bits", [16, 24, 32])
def test_stamps_of_a_counter_that_begins_anew_go_on(bits):
    counts = 2000.0 * INDEX + 1500.0
    np.testing.assert_array_equal(running_on(np.mod(counts, 2.0**bits)), counts - (1500 // 2**bits) * 2**bits)


def test_a_clock_that_goes_back_by_itself_is_no_counter_that_begins_anew():
    counts = np.concatenate([2000.0 * INDEX[:100], 2000.0 * INDEX[50:100]])
    np.testing.assert_array_equal(running_on(counts), counts)
    np.testing.assert_array_equal(running_on(T - 1.0), T - 1.0)
