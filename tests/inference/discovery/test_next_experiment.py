"""The next experiment: laws alike under a weak motion are separated by a strong one, equal laws by none.

The record is the response of one mass to held commands, by the matrix exponential of scipy. It has a quarter more
damping than is declared, which drag explains, too, as long as the motion is as large.
"""

import numpy as np
import pytest
from scipy import signal

from masking.app.workflows import discovery_inputs
from masking.inference.discovery import fitting
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.next_experiment import next_experiment
from masking.inference.discovery.parameter_prior import prior_of
from masking.inference.discovery.work_budget import Work
from masking.inference.estimation.identification_data import Data

RATE, COUNT, NOISE = 100.0, 1000, 0.02
MODEL = """name: weak
coordinates: {x: {unit: m}}
inputs: {u: {unit: N}}
parameters: {m: {value: 1.0, unit: kg, std: 0.0}, k: {value: 60.0, unit: N/m}, c: {value: 0.8, unit: N*s/m}}
equations: {"m*x''": u - k*x - c*x'}
elements: {spring: {displacement: x, unit: N, acts: {x: -1}}}
"""


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    """Return the problem of the record."""
    path = tmp_path_factory.mktemp("weak") / "model.yaml"
    path.write_text(MODEL)
    twin = discovery_inputs.rig(path, None)
    rig, rng = AugmentedModel(twin, ("k", "c")), np.random.default_rng(7)
    u = signal.sosfilt(signal.butter(2, 3.0, fs=RATE, output="sos"), rng.standard_normal(COUNT))
    a, b, *_ = signal.cont2discrete(
        (np.array([[0.0, 1.0], [-60.0, -1.0]]), np.array([[0.0], [1.0]]), np.eye(2), np.zeros((2, 1))), 1.0 / RATE
    )
    states = np.zeros((COUNT, 2))
    for i in range(COUNT - 1):
        states[i + 1] = a @ states[i] + b[:, 0] * u[i]
    sigma = NOISE * states[:, 0].std()
    record = Data("weak", RATE, u[:, None], states[:, :1] + sigma * rng.standard_normal((COUNT, 1)))
    return EstimationProblem(rig, record, prior_of(twin, rig, 0.01), np.array([sigma]), 2, work=Work(np.inf))


@pytest.fixture(scope="module")
def both(asked):
    """Return the record explained by more viscous damping, and by drag."""
    viscous, drag = (EffectInstance(name, "spring", (0.1,), (0,)) for name in ("viscous_damping", "quadratic_damping"))
    return fitting.fit(asked, (viscous,)), fitting.fit(asked, (drag,))


def test_a_strong_motion_tells_drag_from_viscous_damping(asked, both):
    before = asked.work.done
    found = next_experiment(asked, *both, ("viscous", "drag"), None)
    assert asked.work.done == before  # it has a budget of its own
    assert found.separates
    assert found.commands.shape == (COUNT, 1)  # as long as the record
    most = 3.0 * np.abs(asked.record.commands).max()
    assert np.abs(found.commands).max() <= most * (1.0 + 1e-9)
    assert found.peaks["u"] == pytest.approx(most, rel=1e-2)  # drag grows with the square of the rate


def test_no_experiment_separates_an_explanation_from_itself(asked, both):
    assert not next_experiment(asked, both[1], both[1], ("one", "the same"), None).separates


def test_a_limit_is_kept(asked, both):
    limit = 0.5 * np.abs(asked.record.commands).max(axis=0)
    assert np.abs(next_experiment(asked, *both, ("viscous", "drag"), limit).commands).max() <= limit[0] * (1.0 + 1e-9)
