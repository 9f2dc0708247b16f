"""Time base: channels on clocks of their own, written by other libraries, on one; truth by closed forms."""

import json

import numpy as np
import pytest

from masking.app.cli.main_program import _with_units
from masking.errors import DeclarationError, RecordError
from masking.lab.records import readers
from masking.lab.records.time_base import Resampling

RATE = 500.0
T = np.arange(2000) / RATE
BY_GROUP = {"u": "1/u", "y": "2/y"}


def motion(t):
    return np.sin(2.0 * np.pi * 3.0 * np.asarray(t))


def commands(t):
    """Held commands that change each 20 ms."""
    return np.random.default_rng(2).uniform(-1.0, 1.0, 1000)[np.floor(np.asarray(t) * 50.0 + 1e-6).astype(int)]


def mdf(path, *groups, **invalid):
    asammdf = pytest.importorskip("asammdf", reason="asammdf is not installed")
    with asammdf.MDF(version="4.10") as file:
        for name, t, values in groups:
            file.append([asammdf.Signal(values, t, name=name, invalidation_bits=invalid.get(name))])
        file.save(path)
    return path


def tdms(path, **channels):
    nptdms = pytest.importorskip("nptdms", reason="nptdms is not installed")
    begun = np.datetime64("2015-11-20T20:13:43.596313")
    written = [
        nptdms.ChannelObject("run", name, values, {
            "wf_start_time": begun + np.timedelta64(round(start * 1e6), "us"),
            "wf_start_offset": offset,
            "wf_increment": step,
        })
        for name, (start, offset, step, values) in channels.items()
    ]  # fmt: skip
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment(written)
    return path


def mcap(path, **topics):
    writers = pytest.importorskip("mcap.writer", reason="mcap is not installed")
    with path.open("wb") as stream:
        writer = writers.Writer(stream)
        writer.start()
        ids = {name: writer.register_channel(topic=name, message_encoding="json", schema_id=0) for name in topics}
        rows = sorted(
            (t, name, x) for name, (times, values) in topics.items() for t, x in zip(times, values, strict=True)
        )
        for t, name, x in rows:
            when = 1_423_155_837_204_827_070 + round(t * 1e9)  # ns since 1970
            writer.add_message(ids[name], when, json.dumps({name: float(x)}).encode(), when)
        writer.finish()
    return path


def sampled(file, names, rate, held=("u",)):
    return readers.read(file, names, needed=("u", "y"), resampling=Resampling.of(rate, held))


def refused(file, names=None, **settings):
    with pytest.raises(RecordError) as error:
        readers.read(file, names, needed=("u", "y"), **settings)
    return str(error.value)


SHIFT = T + 0.0413
FILES = {
    "tdms, start": lambda p: tdms(p, u=(0.0, 0.0, 0.002, commands(T)), y=(0.0413, 0.0, 0.002, motion(SHIFT))),
    "tdms, offset": lambda p: tdms(p, u=(0.0, 0.0, 0.002, commands(T)), y=(0.0, 0.0413, 0.002, motion(SHIFT))),
    "mdf, shifted": lambda p: mdf(p, ("u", T, commands(T)), ("y", SHIFT, motion(SHIFT))),
    "mdf, slower": lambda p: mdf(p, ("u", T, commands(T)), ("y", T[::5], motion(T[::5]))),
    "mcap, shifted": lambda p: mcap(p, u=(T, commands(T)), y=(SHIFT, motion(SHIFT))),
    "mcap, slower": lambda p: mcap(p, u=(T, commands(T)), y=(T[::4], motion(T[::4]))),
}  # fmt: skip
FILES["tdms, increment"] = lambda p: tdms(
    p, u=(0.0, 0.0, 0.002, commands(T)), y=(0.0, 0.0, 0.005, motion(np.arange(800) * 0.005))
)


@pytest.mark.parametrize("case", FILES)
@pytest.mark.parametrize("rate", [500.0, 1000.0, 250.0])
def test_channels_on_clocks_of_their_own(tmp_path, case, rate):
    kind = case.partition(",")[0]
    names = {"tdms": {"u": "run/u", "y": "run/y"}, "mdf": BY_GROUP, "mcap": {"u": "u/u", "y": "y/y"}}[kind]
    file = FILES[case](tmp_path / f"a.{'mf4' if kind == 'mdf' else kind}")
    said = refused(file, names)
    assert "two clocks: u has 2000 samples from 0 s on at 500 Hz, y has" in said
    assert "--resample 500 (in Python, resample=500)" in said
    assert "two clocks" in refused(file, names, dt=0.002)
    made = sampled(file, names, rate)
    assert np.diff(made["t"]) == pytest.approx(1.0 / rate, rel=1e-9)
    assert len(made) > 0.98 * 4.0 * rate - 50
    # half an interval of 10 ms of a sine of 3 Hz: (h w)^4 / 128 by the formula of cubics, 1.7 % by straight lines
    np.testing.assert_allclose(made["y"], motion(made["t"]), atol=1.5e-3)
    acting = [commands(made["t"] + late) for late in ((0.0, 0.002) if rate == 250.0 else (0.0,))]
    np.testing.assert_allclose(made["u"], np.mean(acting, axis=0), atol=1e-9)  # the hold, and its impulse


def test_equal_clocks_are_used_as_they_are(tmp_path):
    file = mdf(tmp_path / "a.mf4", ("u", T, commands(T)), ("y", T, motion(T)))
    for names in (BY_GROUP, {"t": "1/time", **BY_GROUP}, {"t": "2/time", **BY_GROUP}):
        made = readers.read(file, names, needed=("u", "y"))
        np.testing.assert_array_equal(made["t"], T)
        np.testing.assert_array_equal(made["y"], motion(T))
    alone = tdms(tmp_path / "a.tdms", u=(0.0, 0.0, 0.002, T), y=(0.0, 0.0, 0.002, motion(T)))
    np.testing.assert_array_equal(readers.read(alone, {"u": "run/u", "y": "run/y"}, needed=("u", "y"))["y"], motion(T))


def test_invalid_samples_are_missing(tmp_path):
    bad = np.zeros(len(T), bool)
    bad[500:520] = True
    values = np.where(bad, 0.0, motion(T))
    file = mdf(tmp_path / "a.mf4", ("u", T, commands(T)), ("y", T, values), y=bad)
    said = refused(file, BY_GROUP)
    assert (
        "20 samples are missing in y, the first at t = 1 s: no number, or marked as invalid; use one part, such as "
        in said
    )
    assert said.endswith(f"{file}@1.04:, or give --resample, which bridges single ones")
    hole = refused(file, BY_GROUP, resampling=Resampling(500.0, ("u",)))
    assert "y has no sample from 0.998 s to 1.04 s, 21 times its usual step; a hole is not interpolated" in hole
    made = sampled(f"{file}@1.04:", BY_GROUP, 500.0)
    np.testing.assert_allclose(made["y"], motion(made["t"]), atol=1e-9)
    single = np.zeros(len(T), bool)
    single[[500, 700, 900]] = True
    few = mdf(tmp_path / "b.mf4", ("u", T, commands(T)), ("y", T, np.where(single, 9.0, motion(T))), y=single)
    made = sampled(few, BY_GROUP, 500.0)
    np.testing.assert_allclose(made["y"], motion(made["t"]), atol=1e-5)
    assert made.notes == ("3 samples are missing in y, of 2000; what was asked for between others is interpolated",)


def test_two_rates_and_an_irregular_clock_in_a_text(tmp_path):
    rng = np.random.default_rng(1)
    uneven = np.cumsum(np.tile([0.008, 0.002], 400)) + rng.uniform(0.0, 1e-4, 800)
    slow = np.full(800, np.nan)
    slow[:200] = np.arange(200) * 0.02
    y = np.where(np.isfinite(slow), motion(slow), np.nan)
    rows = np.column_stack([uneven * 1e3, motion(uneven), slow, y])
    text = "\n".join(",".join("" if np.isnan(x) else f"{x:.9f}" for x in row) for row in rows)
    (tmp_path / "a.csv").write_text(f"ms,u,s,y\n{text}\n")
    made = sampled(tmp_path / "a.csv", {"u": "u@ms:ms", "y": "y@s"}, "200 Hz", held=())
    np.testing.assert_allclose(made["u"], motion(made["t"]), atol=1e-3)
    np.testing.assert_allclose(made["y"], motion(made["t"]), atol=5e-3)
    assert made["t"][-1] <= 3.98 + 1e-9


def test_held_commands_keep_their_impulse(tmp_path):
    file = mdf(tmp_path / "a.mf4", ("u", T + 0.0007, commands(T)), ("y", T, motion(T)))
    made = sampled(file, BY_GROUP, 70.0)
    fine = np.arange(0.0, 1.0, 1e-5) + 5e-6
    means = [commands(t - 0.0007 + fine / 70.0).mean() for t in made["t"][:200]]
    np.testing.assert_allclose(made["u"][:200], means, atol=1e-4)
    assert any(note.startswith("resampling u from 500 to 70 Hz loses") for note in made.notes)


def test_what_a_lower_rate_loses_is_said(tmp_path):
    fast = motion(T) + 0.3 * np.sin(2.0 * np.pi * 90.0 * T)
    file = mdf(tmp_path / "a.mf4", ("u", T, motion(T)), ("y", T, fast))
    (note,) = sampled(file, BY_GROUP, 100.0, held=()).notes
    assert note.startswith("resampling y from 500 to 100 Hz loses") and note.endswith("a higher one keeps it")
    assert not sampled(file, BY_GROUP, 500.0, held=()).notes


def test_channels_that_share_no_time_are_refused(tmp_path):
    file = mdf(tmp_path / "a.mf4", ("u", T, motion(T)), ("y", T + 60.0, motion(T)))
    assert "share no time: u from 0 s to 3.998 s, y from 60 s to 63.998 s" in refused(
        file, BY_GROUP, resampling=Resampling(500.0)
    )


@pytest.mark.parametrize(("text", "rate"), [(200, 200.0), ("200", 200.0), ("200 Hz", 200.0), ("1.5kHz", 1500.0)])
def test_a_rate_is_a_number_or_has_its_unit(text, rate):
    assert Resampling.of(text).rate == rate


@pytest.mark.parametrize("text", ["fast", "0", "-5 Hz", "1e999", "200 s", ""])
def test_what_is_no_rate_is_refused(text):
    with pytest.raises(DeclarationError, match="is no rate; give samples per second, such as 200, '200 Hz' or '1 kHz'"):
        Resampling.of(text)


def test_a_unit_behind_a_rate_belongs_to_it():
    given = ["simulate", "--resample", "200", "Hz", "model", "Hz"]
    assert _with_units(given) == ["simulate", "--resample", "200 Hz", "model", "Hz"]
