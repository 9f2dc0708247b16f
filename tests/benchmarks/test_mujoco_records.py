"""Records made by MuJoCo: its motion against ours and against the laws that are hidden, and what discovery finds."""

from dataclasses import replace

import numpy as np
import pytest

from masking.inference.estimation.simulation import simulate
from tests.benchmarks import mujoco_records
from tests.benchmarks.discovering import running, scoring
from tests.benchmarks.hidden import Hidden
from tests.benchmarks.hidden.cases import TRAINING, rig_of
from tests.benchmarks.hidden.excitation import commands, training
from tests.benchmarks.hidden.generate import Record
from tests.benchmarks.hidden.rig import ELEMENTS, PARAMETERS, RATE, SENSOR_GAIN, Rigs, linear_response
from tests.benchmarks.hidden.simulate import Batch
from tests.benchmarks.mujoco_records import generate, mjcf, motion

pytest.importorskip("mujoco", reason="MuJoCo is not installed here; the extra `dev` brings it")

CASES = {f"{case.effect}@{case.at}": case for case in mujoco_records.cases()}
QUICK = {"@", "dry_friction@spring1", "parameter@w1", "saturation@V3"}
SHARP = 2e-5  # m/s: so that tanh(v/vs) is nearly the sign


def told(cases, seconds):
    return commands(training, seconds, [[case.seed, TRAINING] for case in cases], [case.damping for case in cases])


def law(case):
    """Return the parameters and the effects with which the laws in numpy are to move as MuJoCo does."""
    effects = [Hidden(one.effect, one.at, {"vs": SHARP, **one.parameters}) for one in case.hidden]
    if case.effect == "parameter" and case.at[0] == "w":  # a stiffness changes alone
        number, before, after = PARAMETERS.index(case.at), rig_of(case, off=False), rig_of(case)
        return before, [Hidden("linear_spring", ELEMENTS[number], {"k": after[number] ** 2 - before[number] ** 2})]
    return rig_of(case), effects


def test_two_engines_move_the_same_rig_alike():
    case, (twin, _) = replace(CASES["@"], base_error=0.0), running.rig("own")
    u = told([case], 5.0)[:, :, 0]
    record = Record(np.arange(len(u)) / RATE, u, SENSOR_GAIN * motion(mjcf(case), u))
    assert max(simulate(twin, running.data(record, "MuJoCo")).chi.values()) < 1e-6


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.search) for name in CASES]
)
def test_what_is_hidden_moves_the_rig_as_its_law_says(name):
    case = CASES[name]
    u, (values, effects) = told([case], 3.0), law(case)
    moved = Batch(Rigs(np.array([values])), [effects]).motion(u)[:, :, 0]
    without = linear_response(Rigs(np.array([rig_of(case, off=False)])), u)[:, :, 0]
    size = np.sqrt((without**2).mean(axis=0))
    by_mujoco = motion(mjcf(case), u[:, :, 0])
    error, effect = (np.sqrt((x**2).mean(axis=0)) / size for x in (by_mujoco - moved, moved - without))
    assert (error < 0.01 * effect + 1e-9).all()
    assert effect.max() > 0.01 or not case.effect


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("dry_friction@spring1", id="friction loss"),
        pytest.param("parameter@w1", id="stiffness"),
        pytest.param("parameter@z2", id="damping"),
        pytest.param("saturation@V3", id="control range"),
        pytest.param("@", id="nothing"),
    ],
)
@pytest.mark.search
def test_discovery_finds_what_mujoco_hides(name):
    ((case, train, valid),) = generate([CASES[name]], 20.0, 20.0)
    answer = scoring.answer(running.discovered(case, train, valid)["answer"])
    score = scoring.judge(case, answer)
    assert score.right, f"{score.how}: {answer}"
    assert all(p.error is None or p.error < 0.02 for p in scoring.parameters(case, answer))


def test_noise_is_as_large_as_it_is_told_to_be():
    case = CASES["@"]
    ((_, train, _),) = generate([case], 4.0, 1.0)
    clean = SENSOR_GAIN * motion(mjcf(case), train.commands)
    noise = np.sqrt(((train.readings - clean) ** 2).mean(axis=0) / (clean**2).mean(axis=0))
    np.testing.assert_allclose(noise, case.noise, rtol=0.05)
