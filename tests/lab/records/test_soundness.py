"""Soundness of records: what was made to be wrong is suspected where it is, and nothing else is."""

import numpy as np
import pytest
from scipy import signal

from masking.lab.records.soundness import Signals, doubts, turn_of
from masking.lab.records.time_base import going_on

T = np.arange(8000) / 200.0
NOISE = np.random.default_rng(4).standard_normal(len(T))
DRIVEN = np.random.default_rng(5).uniform(-1.0, 1.0, 200)[(T * 5.0).astype(int)]
SWUNG = signal.lsim(([4.0], [1.0, 1.0, 16.0]), DRIVEN, T)[1]
TURNED = np.cumsum(3.0 + DRIVEN) / 200.0  # rad


def told(y, u=None, unit="1", **settings):
    inputs = {} if u is None else {"u": u}
    return doubts(Signals("the record", T, inputs, {"y": y}, {"y": unit}, **settings))


@pytest.mark.parametrize("start", [0.0, -np.pi])
@pytest.mark.parametrize("bits", [10, 24])
def test_readings_that_wrap(start, bits):
    quantum = 2.0 * np.pi / 2**bits
    wrapped = start + np.mod(np.round(TURNED / quantum) * quantum - start, 2.0 * np.pi)
    assert turn_of(wrapped) == pytest.approx(2.0 * np.pi, rel=0.01)
    (words,) = told(wrapped, DRIVEN, "rad")
    first = T[np.argmax(np.abs(np.diff(wrapped)) > 3.0)]
    assert words.startswith("y jumps by 6.28") and f"first at t = {first:.6g} s" in words
    assert words.endswith("declare it in the plant: sensors: {y: {wraps: 360 deg}}")
    assert "{wraps: 360 deg}" in told(np.rad2deg(wrapped), DRIVEN, "deg")[0]
    assert "{wraps: 5 V}" in told(np.mod(TURNED, 5.0), DRIVEN, "V")[0]
    assert not told(going_on(wrapped, 2.0 * np.pi), DRIVEN, "rad", turns={"y": 2.0 * np.pi})


def test_a_pendulum_at_the_seam_of_its_encoder():
    swing = 0.6 * np.cos(5.0 * T) * np.exp(-0.05 * T)
    wrapped = np.mod(np.round(swing / 0.0015) * 0.0015, 2.0 * np.pi)
    assert "{wraps: 360 deg}" in told(wrapped, unit="rad")[0]
    np.testing.assert_allclose(going_on(wrapped, 2.0 * np.pi), swing, atol=1e-3)
    begins_below = np.mod(-swing, 2.0 * np.pi)
    np.testing.assert_allclose(going_on(begins_below, 2.0 * np.pi), -swing, atol=1e-9)


def test_turns_that_cannot_be_counted_are_said():
    (words,) = told(np.cumsum(np.full(len(T), 0.45 * 360.0)), turns={"y": 360.0})
    assert "moves by up to 0.45 of a turn from one sample to the next" in words


@pytest.mark.parametrize("limit", [0.2, -0.15])
def test_readings_that_are_clipped(limit):
    y = np.minimum(SWUNG + 0.001 * NOISE, limit) if limit > 0.0 else np.maximum(SWUNG + 0.001 * NOISE, limit)
    (words,) = told(y, DRIVEN, "m")
    cut = y == limit
    first = T[np.argmax(cut[:-2] & cut[1:-1] & cut[2:])]
    assert words.startswith(f"y stays at {limit:g} m in ") and f"first at t = {first:.6g} s: is it clipped" in words


@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_a_rig_that_stops_while_commands_go_on(tmp_path, noise):
    y = np.where(T < 35.0, SWUNG, SWUNG[6999]) + noise * NOISE
    (tmp_path / "a.csv").write_text("t,u,y\n")
    (words,) = doubts(Signals(str(tmp_path / "a.csv"), T, {"u": DRIVEN}, {"y": y}, {}))
    assert "to the end, while u goes on: did the rig stop there? Then use what was recorded before, such as" in words
    assert float(words.rpartition("@:")[2]) == pytest.approx(35.0, abs=0.06)


def test_a_sensor_that_freezes_while_another_goes_on():
    frozen = np.where(T < 30.0, SWUNG, SWUNG[5990])
    (words,) = doubts(Signals("it", T, {"u": DRIVEN}, {"x": SWUNG + 0.01 * NOISE, "y": frozen + 0.0}, {}))
    assert words.startswith("y stays where it is from t = ") and "did the sensor stop there?" in words


@pytest.mark.parametrize(("mark", "count"), [(-9999.0, 7), (1e30, 1)])
def test_numbers_that_mark_what_is_missing(mark, count):
    y = SWUNG.copy()
    y[1000 : 1000 + 5 * count : 5] = mark
    (words,) = told(y, DRIVEN)
    assert f"y reads {mark:.6g} {'once' if count == 1 else '7 times'}, first at t = 5 s, far from all else" in words


SOUND = {
    "moves": (SWUNG, DRIVEN),
    "noise": (SWUNG + 0.01 * NOISE, DRIVEN),
    "coarse": (np.round(SWUNG / 0.05) * 0.05, DRIVEN),
    "noise alone": (NOISE, DRIVEN),
    "turns on": (TURNED, DRIVEN),
    "square": (np.sign(np.sin(T)), None),
    "relay": (np.sign(np.sin(7.0 * T)) + 0.01 * NOISE, DRIVEN),
    "steps": (DRIVEN, DRIVEN),
    "coarse sine": (np.round(np.sin(2.0 * T) / 0.02) * 0.02, np.cos(T)),
    "decays to rest": (np.round(np.exp(-T) * np.cos(9.0 * T) / 1e-3) * 1e-3, None),
    "rests after its commands": (
        np.round(signal.lsim(([4.0], [1.0, 4.0, 16.0]), np.where(T < 25.0, DRIVEN, 0.0), T)[1], 3),
        np.where(T < 25.0, DRIVEN, 0.0),
    ),
    "sticks again and again": (np.round(np.clip(np.sin(T), -0.6, 0.6) + 0.2 * np.sin(0.1 * T), 3), np.sin(T)),
    "one impact": (np.where(np.abs(T - 20.0) < 0.01, 5.0, SWUNG), DRIVEN),
    "saw-tooth, rounded": (signal.sawtooth(2.0 * T, 0.9), None),
}


@pytest.mark.parametrize("case", SOUND)
def test_nothing_is_suspected_of_sound_records(case):
    assert told(*SOUND[case]) == ()
