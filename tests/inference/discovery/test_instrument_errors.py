"""Imperfections of a rig, adjusted beside a missing effect."""

from dataclasses import replace

import numpy as np
import pytest

import masking
from masking.app.workflows import discovery_inputs
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.inference.discovery.discovery_settings import DiscoverySettings
from masking.inference.discovery.discovery_stages import discover
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.instrument_errors import GAIN, with_imperfections
from masking.inference.discovery.parameter_prior import prior_of
from masking.inference.estimation.identification_data import Data
from masking.model.effects import GAINS_AND_ZEROS
from masking.reports import discovery_text
from tests.benchmarks.independent.cases import REAL, Case

RATE = 200.0


def record_of(case, folder):
    """Return the rig of a case as its model declares it, and its record."""
    (folder / "model.yaml").write_text(case.rig.model())
    twin = discovery_inputs.rig(folder / "model.yaml", None)
    u, x = case.told
    return twin, Data("record", case.rate, case.rig.scale * u, x)


@pytest.fixture
def problem(tmp_path):
    twin, record = record_of(Case(3, "stop", rate=RATE, seconds=2.0), tmp_path)
    rig = AugmentedModel(twin, twin.equation_parameters())
    return EstimationProblem(rig, record, prior_of(twin, rig, 0.01), 1e-3 * record.readings.std(axis=0), 2)


def test_readings_with_imperfections_are_those_of_the_rig_with_these_effects(problem):
    """A gain and a zero of the sensor and of the actuator, by hand; the rig is linear and at rest before."""
    wider = with_imperfections(problem)
    assert [one.effect for one in wider.rig.imperfections] == [*GAINS_AND_ZEROS, "delay"]
    start, theta = wider.rig.rest[None, :], wider.prior.mean.copy()
    theta[-5:-1] = 0.03, 2e-4, -0.02, 0.1
    pushed = replace(problem, record=replace(problem.record, commands=0.98 * problem.record.commands + 0.1))
    plain = pushed.equations(problem.prior.mean, start).simulated
    np.testing.assert_allclose(wider.equations(theta, start).simulated, 1.03 * plain + 2e-4, rtol=1e-9, atol=1e-12)


def test_slopes_by_imperfections_are_those_of_differences(problem):
    wider = with_imperfections(problem)
    start, theta = wider.rig.rest[None, :], wider.prior.mean + 0.5 * wider.prior.deviation
    law = EffectInstance("hardening_spring", "spring1", (1e6,), (0,))

    def cost(values):
        return float(wider.equations(values, start, [law], np.array([1e6])).squares @ wider.weights)

    slopes = -2.0 * wider.equations(theta, start, [law], np.array([1e6])).gradient
    for i in range(len(problem.prior.mean), len(theta)):
        step = np.zeros(len(theta))
        step[i] = 1e-3 * wider.prior.deviation[i]
        assert slopes[i] == pytest.approx((cost(theta + step) - cost(theta - step)) / (2.0 * step[i]), rel=2e-2), i


def test_a_rig_in_which_other_effects_are_tried_has_its_imperfections(problem):
    """As where a closed form is tried in the place of the dictionary."""
    wider = with_imperfections(problem)
    other = replace(wider, rig=replace(wider.rig, tried=(wider.rig.twin.dictionary["hardening_spring"],)))
    start, theta = wider.rig.rest[None, :], wider.prior.mean + wider.prior.deviation
    law = EffectInstance("hardening_spring", "spring1", (1e6,), (0,))
    simulated = [one.equations(theta, start, [law], np.array([1e6])).simulated for one in (wider, other)]
    np.testing.assert_allclose(*simulated, rtol=1e-12)


def test_many_imperfections_are_adjusted_beside_a_law_and_written(tmp_path):
    case = Case(3, "hardening_spring", REAL, RATE, 12.0)
    (tmp_path / "model.yaml").write_text(case.rig.model())
    np.savez(tmp_path / "record.npz", **case.rig.columns(case.times, *case.told))
    given = {"model": tmp_path / "model.yaml", "tolerance": REAL.off, "out": tmp_path / "found"}
    found = masking.discover(tmp_path / "record.npz", **given)
    assert (found.verdict, [(one.name, one.on) for one in found.effects]) == ("named", [case.truth])
    again = masking.simulate(tmp_path / "found" / "plant.yaml", tmp_path / f"record.npz@0:{0.7 * 12.0}")
    assert again.chi == pytest.approx(found.simulation_error.estimation[1], rel=0.02)
    known = {one.name: next(iter(one.parameters.values())) for one in found.imperfections}
    late, std = known["delay"]
    assert late + 3.0 * std > 0.5 / RATE  # half a sample to a whole one
    assert late - 3.0 * std < 1.0 / RATE
    assert abs(known["sensor_gain"][0]) < 3.0 * GAIN
    assert "small errors that a rig has" in discovery_text.sentence(found)


@pytest.mark.search
def test_a_single_imperfection_beside_a_law_is_a_cause(tmp_path):
    case = Case(3, "hardening_spring", replace(REAL, gain=0.0, offset=0.0, late=(4, 4)), RATE, 12.0)
    twin, record = record_of(case, tmp_path)
    found = discover(twin, record, settings=DiscoverySettings(tolerance=REAL.off))
    assert not found.imperfections
    assert {one.name for one in found.effects} == {"hardening_spring", "delay"}
