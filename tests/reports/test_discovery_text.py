"""What is said of a discovery: each sentence against numbers that are given, so that it holds for no others."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from masking.inference.discovery import latent_force
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.discovery_result import Named, SimulationError
from masking.inference.discovery.explanation import Explanation
from masking.inference.discovery.next_experiment import NextExperiment
from masking.model.declaration.quantities import number, power, quantity
from masking.model.effects import EFFECTS
from masking.reports import discovery_figures, discovery_page, discovery_text, panels
from masking.reports.text import capped, signed
from tests.inference.discovery.test_force_decomposition import INSTANCES, discoveries, rig

__all__ = ["discoveries", "rig"]  # fixtures

SENSORS = ("s1", "s2", "s3")


def gaps(declared, after, floor, adjusted=None):
    """Return a gap that is the same in both records; parameters alone leave what is declared if nothing is said."""
    each = (dict(zip(SENSORS, declared, strict=True)), dict(zip(SENSORS, after, strict=True)))
    noise = dict(zip(SENSORS, floor, strict=True))
    return SimulationError(each, each, noise, noise, dict(zip(SENSORS, adjusted or declared, strict=True)))


def test_without_effects_the_title_says_what_is_left(discoveries):
    found = replace(discoveries("friction"), verdict="unknown", effects=())
    found = replace(
        found, simulation_error=gaps((1.33, 0.1, 0.1), (0.94, 0.1, 0.1), (0.001, 0.1, 0.1), (0.94, 0.1, 0.1))
    )
    assert discovery_text.error_change(found) == (
        "The validation error of s1 is 133 % as declared and 94 % with adjusted parameters; the noise floor is 0.1 %"
    )


def test_a_parameter_is_compared_with_what_is_declared(discoveries):
    named = (Named("z2", "", {"z2": (0.02, 1e-5)}, 1.0),)
    found = replace(discoveries("friction"), verdict="parameter", effects=named)
    found = replace(found, simulation_error=gaps((0.027, 1e-3, 1e-3), (1e-3, 1e-3, 1e-3), (1e-3, 1e-3, 1e-3)))
    assert "The validation error of s1 is 2.7 % as declared and 0.1" in discovery_text.error_change(found)


@pytest.mark.parametrize(
    ("after", "floor", "told"),
    [(0.98, 0.01, "s1 (error 98 %): check units"), (0.8, 0.01, ""), (0.98, 0.9, "")],
)
def test_a_reading_that_is_hardly_followed(discoveries, after, floor, told):
    found = replace(
        discoveries("friction"), simulation_error=gaps((1.0, 0.1, 0.1), (after, 0.1, 0.1), (floor, 0.1, 0.1))
    )
    said = discovery_text.unfollowed_readings(found)
    assert told in said
    assert bool(said) is bool(told)
    assert said in discovery_text.sentence(found)


def test_commands_that_seem_measured_are_told(discoveries):
    found = replace(discoveries("friction"), simulation_error=gaps((1.0, 0.1, 0.1), (0.2, 0.1, 0.1), (0.01, 0.1, 0.1)))
    told = discovery_text.sentence(replace(found, first_order_hold={"s1": 0.01, "s2": 0.1, "s3": 0.1}))
    assert told.endswith(
        "the model alone leaves 1 % of s1, against 20 %: if they were measured, use --hold first-order"
    )


def test_a_law_that_may_be_nothing_is_not_offered(discoveries):
    sure, unsure = (Named("stiffness_drift", "spring1", {"k": (-4.0, std)}, 0.9) for std in (1.0, 161.0))
    found = replace(discoveries("friction"), verdict="unknown")
    assert "The nearest known effect is stiffness drift in spring1" in discovery_text.sentence(
        replace(found, effects=(sure,))
    )
    lost = replace(found, effects=(unsure,))
    assert "nearest" not in discovery_text.sentence(lost)
    assert discovery_text.reported(lost) == []
    springs = Named("polynomial_spring", "spring1", {"k2": (0.0, 1.0), "k3": (9.0, 1.0)}, 0.9)
    assert discovery_text.reported(replace(found, effects=(springs,))) == [springs]


def test_opposite_cross_dampings_are_one_gyroscopic_coupling(discoveries):
    on, back = (
        Named("cross_damping", at, {"c": (c, 4e-6)}, 0.9) for at, c in (("q on p", -0.02), ("p on q", 0.020007))
    )
    found = replace(discoveries("friction"), effects=(on, back))
    assert discovery_text.opposite(found) == (
        "The forces of q on p and of p on q are opposite, within their uncertainty: a gyroscopic coupling"
    )
    away = replace(back, parameters={"c": (0.023, 4e-6)})
    assert discovery_text.opposite(replace(found, effects=(on, away))) == ""
    assert len(discovery_text.remedies(found)) == 1


@pytest.mark.parametrize(("wide", "how"), [(1.0, "beyond"), (10.0, "within")])
def test_parameters_that_moved_are_told(discoveries, wide, how):
    found = discoveries("friction")
    at, known = found.rig.names.index("z2"), found.explanation.hypothesis
    theta = found.rig.start.copy()
    theta[at] *= 1.05
    prior = found.problem.prior
    moved = replace(
        found,
        explanation=replace(
            found.explanation, hypothesis=replace(known, theta=theta, covariance=0.0 * known.covariance)
        ),
        problem=replace(found.problem, prior=replace(prior, deviation=wide * prior.deviation)),
    )
    assert discovery_text.adjustments(moved).startswith("Adjusted: z2 = ")
    assert discovery_text.adjustments(moved).endswith(f", 5 % more than declared, {how} its prior uncertainty")
    off = Named("z2", "", {"z2": (theta[at], 0.0)}, 1.0)
    assert discovery_text.adjustments(replace(moved, verdict="parameter", effects=(off,))) == ""
    assert [*discovery_text.adjusted_parameters(moved)] == ["z2"]


@pytest.mark.parametrize(("value", "told"), [(2.1, "5 % more than"), (1.8, "10 % less than"), (-1.0, "where 2 is")])
def test_how_far_a_value_is_off(value, told):
    assert discovery_text.deviation_words(value, 2.0).startswith(told)


def coming(found, peak, separation=1e3):
    """Return a discovery that leaves two causes open, and an experiment with a peak."""
    settings = {"peak": {"V1": peak, "V2": 0.01, "V3": 0.1}, "lowest": "3 Hz", "highest": "12 Hz", "seconds": 30.0}
    other = Explanation("effects", (("dahl_friction", "spring1"),), found.explanation.hypothesis)
    last = replace(found.effects[-1], probability=0.6, alternatives=(("dahl_friction", "spring1", 0.4),))
    told = NextExperiment("multisine", settings, separation, ("one", "other"), np.zeros((1, 3)))
    return replace(found, verdict="ambiguous", effects=(last,), rivals=(found.rivals[0], other), next_experiment=told)


def test_an_experiment_is_said_in_words(discoveries):
    found = discoveries("friction")
    most = float(np.abs(found.record.commands[:, 0]).max())
    said = discovery_text.deciding_experiment(coming(found, 3.0 * most))
    assert said.startswith(f"a multisine of V1 up to {quantity(3.0 * most, 'V')}, V2 up to 10 mV and V3 up to ")
    assert ", 3 to 12 Hz, 30 s long, would tell dry friction in spring1 from Dahl friction in spring1" in said
    assert "{" not in said
    lasting = discovery_text.sentence(coming(found, 3.0 * most, separation=0.0))
    assert lasting.endswith("No excitation that was tried can tell dry friction in spring1 from "
                            "Dahl friction in spring1")  # fmt: skip
    assert "multisine" not in discovery_text.cause_with_values(found, coming(found, most).effects[0])


def test_limits_are_asked_for_where_there_are_none(discoveries):
    found = coming(discoveries("friction"), 1.0)
    declaration = found.twin.declaration
    limited = declaration.limits.inputs.keys() >= set(found.twin.actuators)
    assert ("a plant file may declare limits" in discovery_text.deciding_experiment(found)) is not limited


def test_a_delay_of_the_only_actuator_is_told_once():
    last = Named("delay", "", {"samples": (0.01, 1e-3)}, 0.5, (("delay", "force", 0.5),))
    one, two = (
        SimpleNamespace(
            verdict="ambiguous",
            effects=(last,),
            least_sure=last,
            dictionary=EFFECTS,
            twin=SimpleNamespace(actuators=actuators),
        )
        for actuators in (("force",), ("force", "torque"))
    )
    assert discovery_text.possible_causes(one) == ["a delay of force"]
    assert discovery_text.probabilities(one, last) == {"a delay of force": 1.0}
    assert not discovery_text.is_open(one)
    assert discovery_text.possible_causes(two) == ["a delay of all actuators", "a delay of force"]
    assert discovery_text.cause_label(two, "delay", "force") == "Delay of force"


@pytest.mark.parametrize(
    ("name", "told"),
    [("lugre_friction", "LuGre friction"), ("bouc_wen_hysteresis", "Bouc-Wen hysteresis"),
     ("dry_friction", "dry friction"), ("dac_quantisation", "DAC quantisation"),
     ("stribeck_friction", "Stribeck friction")],
)  # fmt: skip
def test_effects_are_named_after_people(name, told):
    assert EFFECTS[name].spoken == told


def test_the_map_credits_each_law_with_its_own_part(discoveries):
    found = discoveries("friction")
    latent = latent_force.force_at(found, "spring1")
    friction, hypothesis = INSTANCES["friction"], found.explanation.hypothesis
    weak = EffectInstance("hardening_spring", "spring1", (1e-3,), (0,))
    both = (hypothesis.instances[0], weak)
    laws = [discovery_figures.along(found, latent, [instance]) for instance in both]
    assert np.allclose(discovery_figures.along(found, latent, both), sum(laws))
    assert laws[0].max() == pytest.approx(friction.values[0], rel=0.05)
    assert discovery_figures.share(latent, laws[0]) > 0.8
    assert discovery_figures.share(latent, laws[1]) < 0.01
    effects = tuple(Named(instance.effect, instance.at, {}, 1.0) for instance in both)
    together = replace(
        found, effects=effects, explanation=replace(found.explanation, hypothesis=replace(hypothesis, instances=both))
    )
    said = discovery_figures._explained(together, latent, "force", laws[0])
    assert said.startswith("Dry friction in spring1 and hardening spring in spring1 together explain ")
    alone = replace(together, effects=effects[1:])  # the other is not offered at this place
    part = discovery_figures._explained(replace(alone, explanation=together.explanation), latent, "force", laws[1])
    assert part.startswith("Hardening spring in spring1 explains ")
    assert "; the whole finding explains " in part


def test_no_force_is_told_where_a_parameter_explains_it(discoveries):
    found = discoveries("friction")
    latent = latent_force.force_at(found, "spring1")
    small = replace(latent, before=1e-9 * latent.before)
    told = discovery_figures._explained(replace(found, verdict="parameter"), small, "force", None)
    assert told.startswith("With the parameters that were found, the record shows no force at spring1")


def test_the_shooting_interval_is_stated(discoveries):
    whole = discoveries("friction")
    assert (whole.as_dict()["shooting_interval"], discovery_text.intervals(whole)) == (None, "")
    found = replace(whole, problem=replace(whole.problem, interval=250))  # of 1 kHz
    said = "Simulated in shooting intervals of 0.25 s, each from an initial state of its own"
    assert found.as_dict()["shooting_interval"] == pytest.approx(0.25)
    assert discovery_text.intervals(found) == said
    assert f"{said}." in discovery_page.summary(found, None)


@pytest.mark.parametrize(
    ("unit", "largest", "shown"),
    [
        ("m", 2.0, (1.0, "m")),
        ("m/s", 0.02, (1e3, "mm/s")),
        ("m", 2e-6, (1e6, "µm")),
        ("N", 3e-8, (1e9, "nN")),
        ("V", 1e-15, (1e9, "nV")),
        ("m", 0.0, (1.0, "m")),
        ("rad", 2e-6, (1.0, "rad")),
    ],
)
def test_figures_have_the_unit_of_what_they_show(unit, largest, shown):
    assert panels.shown(unit, np.array([0.0, -largest]), [0.5 * largest]) == shown


def test_numbers_read_as_people_write_them():
    assert number(120.0, 2) == "120"
    assert number(31_960.0, 2) == "32000"
    assert number(3e-7) == "3e-7"
    assert quantity(120.0, "N", 2) == "120 N"
    assert quantity(31_960.0, "N", 2) == "32 kN"
    assert quantity(999.9, "N", 2) == "1 kN"
    assert quantity(23.4, "W") == "23.4 W"
    assert quantity(-0.1234, "m") == "-123 mm"
    assert quantity(1200.0, "N/m") == "1200 N/m"
    assert quantity(3.2e-5, "m/s**2") == "32 µm/s²"
    assert capped(1.59e7) == "> 1000 %"
    assert capped(0.5) == "50 %"
    assert signed(1.1) == "+110 %"


def test_powers_have_units():
    assert power(5.4e-5, ("m/s**2", "m", "m/s")) == "54 µW/kg"
    assert power(2.0, ("N", "m", "m/s")) == "2 W"
    assert power(3.0, ("N*m", "rad", "rad/s")) == "3 W"
    assert power(3.0, ("N", "mm", "mm/s")) == "3 mW"
    assert power(3.0, ("V/s**2", "V", "V/s")) == power(3.0, ("", "", "")) == ""
    assert power(0.0, ("N", "m", "m/s")) == "0 W"
