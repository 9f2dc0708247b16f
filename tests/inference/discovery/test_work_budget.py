"""Effects of a slow rig whose motion is micrometres: nothing that is tried may depend on units, or on seconds.

Records are the exact response of one mass to held commands, by the matrix exponential of scipy.
"""

from functools import partial

import numpy as np
import pytest
from scipy import signal

import masking
from masking.inference.discovery.explanation import AT_ONCE, FEWEST, fitted
from masking.inference.discovery.work_budget import FEWEST_RUNS, MOST_STEPS, Work
from masking.inference.estimation.identification_data import Data

MASS, STIFFNESS, DAMPING = 2.54, 82.2, 1.52  # 0.9 Hz
RATE, COUNT, NOISE = 33.0, 1600, 2e-4
MODEL = """name: slow
coordinates: {x: {unit: m}}
inputs: {u: {unit: N}}
parameters:
  m: {value: 2.56, unit: kg}
  k: {value: 82.0, unit: N/m}
  c: {value: 1.53, unit: N*s/m}
equations: {"m*x''": u}
elements: {spring: {displacement: x, unit: N, force: k*d + c*d_rate, acts: {x: -1}}}
"""


def moved(late=0):
    """Return a command and the displacement (m,), of which the command acts some samples late."""
    rng = np.random.default_rng(5)
    sections = signal.butter(2, 3.0, fs=RATE, output="sos")
    u = signal.sosfilt(sections, rng.standard_normal(COUNT))
    rates, push = np.array([[0.0, 1.0], [-STIFFNESS / MASS, -DAMPING / MASS]]), np.array([[0.0], [1.0 / MASS]])
    a, b, *_ = signal.cont2discrete((rates, push, np.eye(2), np.zeros((2, 1))), 1.0 / RATE)
    y, state = np.zeros(COUNT), np.zeros(2)
    for i in range(COUNT):
        y[i] = state[0]
        state = a @ state + b[:, 0] * (u[i - late] if i >= late else 0.0)
    size = 2e-6 / y.std()
    return u * size, y * size


def found(folder, u, y):
    """Return what is discovered in a record."""
    noise = NOISE * y.std() * np.random.default_rng(6).standard_normal(len(y))
    np.savez(folder / "record.npz", t=np.arange(len(u)) / RATE, u=u, x=y + noise)
    (folder / "model.yaml").write_text(MODEL)
    return masking.discover(folder / "record.npz", model=folder / "model.yaml", out=folder / "out")


@pytest.mark.search
def test_a_delay_of_half_a_period_is_named(tmp_path):
    one = found(tmp_path, *moved(late=8))
    assert (one.verdict, one.closed, [cause.name for cause in one.effects]) == ("named", True, ["delay"])
    assert one.effects[0].parameters["tau"][0] == pytest.approx(8.0 / RATE, rel=1e-3)


def test_the_limit_of_a_sensor_is_named(tmp_path):
    u, y = moved()
    limit = 0.6 * np.abs(y).max()
    one = found(tmp_path, u, np.clip(y, -limit, limit))
    assert (one.verdict, [cause.name for cause in one.effects]) == ("named", ["sensor_saturation"])
    assert one.effects[0].parameters["limit"][0] == pytest.approx(limit, rel=1e-3)


@pytest.mark.search
def test_an_offset_and_a_constant_force_are_one_to_a_record(tmp_path):
    u, y = moved()
    one = found(tmp_path, u, y + 0.4 * y.std())
    force = STIFFNESS * 0.4 * y.std()
    values = {"sensor_offset": 0.4 * y.std(), "constant_force": -force, "actuator_offset": force}
    assert one.verdict == "ambiguous"
    cause = one.effects[-1]
    assert {cause.name, *(name for name, _, _ in cause.alternatives)} == {*values}
    other = next(part for name, _, part in cause.alternatives if name in values)
    assert other == pytest.approx(cause.probability)
    assert next(iter(cause.parameters.values()))[0] == pytest.approx(values[cause.name], rel=0.02)


def test_readings_of_commands_before_the_record_do_not_count():
    record = Data("made", 100.0, np.zeros((6, 1)), np.arange(12.0).reshape(6, 2), late=1.0)
    assert np.isnan(record.counted(np.array([1.5]))).all(axis=1).tolist() == [True] * 3 + [False] * 3
    assert record.residuals(np.zeros((6, 2)), np.array([1.5]))[:, 0].tolist() == [0.0, 0.0, 0.0, 6.0, 8.0, 10.0]


def test_work_is_counted_in_steps():
    work = Work.allowed(1000, 4)
    assert work.most == max(MOST_STEPS, FEWEST_RUNS * 4000)
    work.add(10, 4)
    assert work.done == 40.0
    assert not work.ends()
    work.add(int(work.most), 1)
    assert work.ends()
    assert work.is_cut


def test_searches_of_one_answer_share_what_it_may_do():
    first = Work.allowed(1000, 4)
    second, kept = first.another(), first.kept(0.5)
    second.add(int(0.2 * second.most), 1)
    assert not second.is_over
    second.add(int(first.most), 1)  # counts in the answer, too
    assert second.is_over
    assert second.ends()
    assert not first.ends()
    first.add(int(0.6 * first.most), 1)
    assert first.ends()  # both together did more than an answer may
    assert not kept.ends()


def test_fits_of_which_the_first_take_all_the_work_end_there():
    work = Work(100.0)
    made = []

    def job(number, rival):
        made.append(number)
        work.add(30, 1)
        return number

    found = fitted([partial(job, i) for i in range(11)], 0.0, work)
    assert sorted(made) == [*range(AT_ONCE)]
    assert found == [*range(AT_ONCE), *[None] * (11 - AT_ONCE)]
    assert work.is_cut


def test_fits_that_begin_where_the_work_of_the_whole_answer_is_over_are_fewer():
    answer = Work(100.0)
    search = Work(100.0, answer)
    answer.add(101, 1)  # by another search
    assert search.done == 0.0
    assert search.is_over
    found = fitted([partial(lambda number, _: number, i) for i in range(11)], 0.0, search)
    assert found == [*range(FEWEST), *[None] * (11 - FEWEST)]
    assert search.is_cut
