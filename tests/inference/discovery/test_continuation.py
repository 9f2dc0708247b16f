"""Fits of long records: lightly damped oscillators find the truth from far off, and none ends worse than it began.

Records are made by the method of Dormand and Prince (scipy, order 8).
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate

from masking.app.workflows import discovery_inputs
from masking.inference.discovery import continuation, fitting
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.parameter_prior import prior_of
from masking.inference.estimation.identification_data import Data

TRUE = {"w2": 60.0, "k": 0.06, "c": 30.0}
MODELS = {
    "pendulum": '"q\'\'": "-w2*sin(q) - k*q\' + c*u"',
    "Duffing": '"q\'\'": "-w2*q - c*q**3 - k*q\' + w2*u"',
}
RATE = 50.0


def rates(law, p, force):
    """Return the equations of motion of a model that is typed out again."""
    if law == "pendulum":
        return lambda t, y: [y[1], -p["w2"] * np.sin(y[0]) - p["k"] * y[1] + p["c"] * force(t)]
    return lambda t, y: [y[1], -p["w2"] * y[0] - p["c"] * y[0] ** 3 - p["k"] * y[1] + p["w2"] * force(t)]


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Return what makes the twin of a model with parameters that are off; it is compiled once."""
    folder = tmp_path_factory.mktemp("models")

    def made(law):
        known = ", ".join(f"{name}: {{value: {value}}}" for name, value in TRUE.items())
        text = f"name: {law}\ncoordinates: {{q: {{}}}}\ninputs: {{u: {{}}}}\nparameters: {{{known}}}\n"
        (folder / f"{law}.yaml").write_text(f"{text}equations: {{{MODELS[law]}}}\n")
        twin = discovery_inputs.rig(folder / f"{law}.yaml", None)
        return AugmentedModel(twin, twin.equation_parameters())

    return {law: made(law) for law in MODELS}


def problem(rig, law, *, seconds, off, noise, driven, seed=0):
    """Return the estimation problem of a record, with declared parameters that are off to one side or the other."""
    rng, t = np.random.default_rng(seed), np.arange(round(seconds * RATE)) / RATE
    tones, phases = rng.uniform(0.2, 3.0, 8), rng.uniform(0.0, 6.3, 8)

    def force(at):
        return 0.05 * driven * float(np.sin(2.0 * np.pi * tones * at + phases).sum())

    motion = integrate.solve_ivp(
        rates(law, TRUE, force), (0.0, t[-1]), [1.3, 0.4], "DOP853", t, rtol=1e-9, atol=1e-11
    ).y[0]
    readings = motion + noise * motion.std() * rng.standard_normal(len(t))
    record = Data(
        "made", RATE, np.array([[force(at)] for at in t]), readings[:, None], hold="first-order"
    ).band_limited()
    declared = rig.start * (1.0 + off * rng.choice([-1.0, 1.0], len(rig.start)))
    prior = replace(prior_of(rig.twin, rig, 0.2), mean=declared)
    sigma = np.maximum(noise * motion.std(), 1e-4)
    return EstimationProblem(rig, record, prior, np.array([sigma]), 4)


@pytest.mark.parametrize("law", MODELS)
@pytest.mark.parametrize(
    "case",
    [
        {"seconds": 20.0, "off": 0.2, "noise": 0.0, "driven": False},
        {"seconds": 70.0, "off": 0.1, "noise": 1e-3, "driven": False},
        {"seconds": 60.0, "off": 0.05, "noise": 1e-2, "driven": True},
        {"seconds": 50.0, "off": 0.15, "noise": 1e-3, "driven": True},
    ],
)
def test_a_lightly_damped_motion_of_many_periods_finds_its_parameters(models, law, case):
    rig = models[law]
    asked = problem(rig, law, **case)
    found = fitting.fit(asked)
    size = asked.record.readings.size
    assert float(found.squares @ asked.weights) < (1.0 + 5.0 / np.sqrt(size)) * size
    true = np.array([TRUE[name] for name in rig.names])
    sure = found.deviations < 0.01 * true  # no force, no gain of it
    assert sure[rig.names.index("w2")]
    np.testing.assert_allclose(found.theta[sure], true[sure], rtol=0.03)


@pytest.mark.parametrize(("law", "seed"), [("pendulum", 0), ("Duffing", 1), ("pendulum", 2), ("Duffing", 3)])
def test_no_fit_is_worse_than_it_began(models, law, seed):
    """Of a model with another law than the record's, from values that are near or far."""
    rig, rng = models[law], np.random.default_rng(seed)
    other = next(name for name in MODELS if name != law)
    case = {"seconds": rng.uniform(20.0, 40.0), "off": rng.uniform(0.0, 0.3), "noise": 10.0 ** rng.uniform(-4, -2)}
    asked = problem(rig, other, **case, driven=bool(rng.integers(2)), seed=seed)
    known = fitting.fit(asked)
    assert known.cost <= fitting.fit(asked, frozen=True).cost
    friction = EffectInstance("dry_friction", "q", (0.05, 1e-3), (0,))
    begun = fitting.cost(asked, (friction,), known.theta, known.start)
    assert fitting.fit(asked, (friction,), theta=known.theta, start=known.start).cost <= begun


def test_an_effect_that_the_record_does_not_have_costs_no_more_than_none(models):
    """A friction that can only be positive goes to its bound, and the other parameters to where they are best then."""
    rig = models["pendulum"]
    asked = problem(rig, "pendulum", seconds=20.0, off=0.01, noise=1e-3, driven=True)
    known = fitting.fit(asked)
    friction = EffectInstance("dry_friction", "q", (0.5, 1e-3), (0,))
    found = fitting.fit(asked, (friction,), theta=known.theta, start=known.start)
    assert found.cost < known.cost + 1.0
    assert found.added[0] == pytest.approx(0.0, abs=1e-3)


def test_phase_is_lost_where_a_simulation_is_out_of_step(models):
    rig = models["pendulum"]
    asked = problem(rig, "pendulum", seconds=20.0, off=0.0, noise=1e-3, driven=False)
    readings = asked.record.readings
    assert continuation.loses_phase(asked, 2.0 * readings)
    assert not continuation.loses_phase(asked, 0.1 * readings)
    late = readings - np.roll(readings, 2, axis=0)  # 0.04 s of 0.8 s: 18 degrees
    assert not continuation.loses_phase(asked, late)
    late = readings - np.roll(readings, 4, axis=0)  # 36 degrees
    assert continuation.loses_phase(asked, late)


def test_a_fit_that_short_intervals_rule_out_ends_early(models):
    """A linear spring cannot follow one that hardens, even over a period; the law of the record can, from far off."""
    case = {"seconds": 70.0, "off": 0.1, "noise": 1e-3, "driven": False}
    done = dict[float, float]()
    for factor in (np.inf, 1.0):
        asked = problem(models["pendulum"], "Duffing", **case)
        fitting.fit(asked, rival=factor * asked.record.readings.size)
        done[factor] = asked.work.done
    assert done[1.0] < 0.5 * done[np.inf]
    asked = problem(models["Duffing"], "Duffing", **case)
    size = asked.record.readings.size
    found = fitting.fit(asked, rival=float(size))
    assert float(found.squares @ asked.weights) < (1.0 + 5.0 / np.sqrt(size)) * size
