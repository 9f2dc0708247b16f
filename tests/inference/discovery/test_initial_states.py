"""Initial states of a motion that sticks when its record begins; records integrated from event to event."""

import numpy as np

from masking.app.workflows import discovery_inputs
from masking.inference.discovery import fitting
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.parameter_prior import prior_of
from masking.inference.estimation.identification_data import Data
from tests.benchmarks.independent.machine import Contact, Element, Machine, simulated

RATE, SUBSTEPS, NOISE, LEVEL = 500.0, 16, 1e-6, 5.0
MODEL = """
name: two masses
coordinates: {x1: {unit: m}, x2: {unit: m}}
inputs: {u: {unit: N}}
parameters: {m: {value: 3, unit: kg}, k: {value: 2000, unit: N/m}, c: {value: 6, unit: N*s/m}}
equations: {m*x1'': u, m*x2'': 0}
elements:
  between: {displacement: x1 - x2, unit: N, force: k*d + c*d_rate, acts: {x1: -1, x2: 1}}
  ground: {displacement: x2, unit: N, force: k*d + c*d_rate, acts: {x2: -1}}
"""


def test_a_mass_that_sticks_at_the_begin_does_not_keep_the_others_from_their_initial_states(tmp_path):
    (tmp_path / "model.yaml").write_text(MODEL)
    twin = discovery_inputs.rig(tmp_path / "model.yaml", None)
    rig = AugmentedModel(twin, ())
    spring = [Element(np.array(row), lambda d, v, z, t: 2000.0 * d + 6.0 * v) for row in ([1.0, -1.0], [0.0, 1.0])]
    held = Contact(np.array([0.0, 1.0]), lambda d, v: LEVEL, LEVEL)
    rng, t = np.random.default_rng(1), np.arange(1500) / RATE
    u = np.interp(t, t[::60], 8.0 * rng.standard_normal(25))[:, None]
    truth = simulated(Machine(np.full(2, 3.0), spring, np.eye(2)[:, :1], [held]), u, RATE, start=np.zeros(2))
    friction = EffectInstance("dry_friction", "ground", (LEVEL, 1e-4), (0,))
    sticks, speed = np.abs(truth.rate[:, 1]) < 1e-4, np.abs(truth.rate[:, 0])
    begins = np.flatnonzero(sticks & (speed > 0.1 * speed.max()))[::12]
    assert len(begins) > 5
    for begin in begins:
        readings = truth.displacement[begin:] + NOISE * rng.standard_normal((len(t) - begin, 2))
        record = Data("made", RATE, u[begin:], readings)
        problem = EstimationProblem(rig, record, prior_of(twin, rig, 0.01), np.full(2, NOISE), SUBSTEPS)
        stuck = friction.at_step(rig.mobilities["ground"], problem.dt / SUBSTEPS)
        found = fitting.fit(problem, (stuck,), frozen=True)
        assert found.cost < 1.2 * readings.size
        np.testing.assert_allclose(found.start[0, 2], truth.rate[begin, 0], rtol=0.02)
