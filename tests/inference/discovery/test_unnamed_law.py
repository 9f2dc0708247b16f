"""Laws that no dictionary has: fitted as curves, written into the model, and true to what is promised of them.

Records are those of the benchmark: integrated by scipy from laws typed there.
"""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import masking
from masking.inference.discovery import (
    closed_form,
    force_decomposition,
    latent_force,
    unnamed_as_rival,
    validation_simulation,
    verdict,
)
from masking.inference.discovery.spline_bases import Curve, Term, pieces
from masking.inference.discovery.unnamed_law import Coverage, tabulated
from masking.model.declaration.expression import Expression
from masking.model.declaration.quantities import quantity
from masking.reports import discovery_figures, discovery_text, fit_figures, next_experiment_text, place_text
from tests.benchmarks.laws import records, scoring

CASE = records.Case("fluid 1.7", 1)


def test_a_curve_holds_every_spline_over_its_points():
    x = np.linspace(-0.7, 1.0, 400)
    curve = Curve(pieces(x, 9))
    truth = CubicSpline(curve.points, np.sin(3.0 * curve.points), bc_type="natural")
    inside = np.linspace(curve.points[0], curve.points[-1], 500)[1:-1]
    rows = curve.values(inside)
    factors = np.linalg.lstsq(rows, truth(inside), rcond=None)[0]
    np.testing.assert_allclose(rows @ factors, truth(inside), atol=1e-10)
    np.testing.assert_allclose(curve.values(inside, 1) @ factors, truth(inside, 1), atol=1e-8)
    assert np.abs(curve.bends()[[0, -1]] @ factors).max() < 1e-6
    np.testing.assert_allclose(rows.sum(axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize(
    "term",
    [
        Term("free_spring", (Curve(pieces(np.array([-0.7, 1.0]), 5)),)),
        Term("free_damping", (Curve(pieces(np.array([-3.0, 2.0]), 5)),)),
        Term("free_resistance", (Curve(pieces(np.array([-0.7, 1.0]), 5)),)),
        Term("free_rub", (Curve(pieces(np.array([-0.7, 1.0]), 4, is_even=True)),), sharp=0.1),
        Term(
            "free_surface", tuple(Curve(pieces(np.array(ends), 4, is_even=True)) for ends in ([-1.0, 1.0], [-3.0, 2.0]))
        ),
        Term("free_friction", sharp=0.1),
    ],
    ids=lambda term: term.kind,
)
def test_a_piece_as_an_expression_is_the_piece_of_the_curve(term):
    x, rate = np.random.default_rng(1).uniform([[-1.5], [-5.0]], [[1.5], [5.0]], (2, 400))
    values = term.values(x, rate)
    for instance, column in zip(term.instances("spring", np.ones(term.size)), values.T, strict=True):
        known, law = dict(zip(instance.entry.parameters, instance.values, strict=True)), instance.entry.expression
        made = [Expression(law).evaluate({**known, "d": d, "d_rate": v}) for d, v in zip(x, rate, strict=True)]
        np.testing.assert_allclose(made, column, atol=1e-9 * max(1.0, np.abs(column).max()))


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder, rig = tmp_path_factory.mktemp("law"), records.Rig.of(CASE)
    (folder / "model.yaml").write_text(records.model(rig, 1))
    for seed, name in ((1, "train"), (2, "unseen")):
        (folder / f"{name}.csv").write_text(records.table(records.record(rig, seed)))
    given = {"model": folder / "model.yaml", "validation": folder / "unseen.csv", "hold": "first-order"}
    return masking.discover(folder / "train.csv", **given, out=folder / "found"), rig, folder


def along(discovery, instance):
    """Return displacement and rate along the record, and the force of an effect there."""
    x, rate = (table[::20, 0] for table in (discovery.search.motion.displacement, discovery.search.motion.rate))
    known, force = dict(zip(instance.entry.parameters, instance.values, strict=True)), instance.entry.expression
    made = [Expression(force).evaluate({**known, "d": d, "d_rate": v}) for d, v in zip(x, rate, strict=True)]
    return x, rate, np.array(made)


def test_a_law_without_a_name_is_found_in_its_closed_form(found):
    discovery, rig, _ = found
    assert (discovery.verdict, discovery.law.place, discovery.law.closed) == ("unknown", "spring1", True)
    assert discovery.none_of_these > 0.5
    assert discovery.law.error[1]["q1"] == pytest.approx(records.NOISE, rel=0.1)
    assert [atom.name for atom, _, _ in discovery.law.form.formula.terms] == ["odd power of v"]
    assert discovery.law.instance.values[discovery.law.instance.names.index("n")] == pytest.approx(1.7, abs=0.01)
    x, rate, made = along(discovery, discovery.law.instance)
    truth = np.array([rig.hidden(d, v) for d, v in zip(x, rate, strict=True)])
    assert np.abs(made - truth).max() < 0.01 * np.abs(truth).max()


@pytest.mark.parametrize("parts", [20, 200])
def test_names_and_a_law_are_compared_in_the_same_intervals(found, parts):
    """In shorter intervals, names are not better than themselves."""
    discovery, _, _ = found
    named, short = discovery.explanation.hypothesis, replace(discovery.validation, interval=2000 // parts)
    validated = validation_simulation.validated(short, named)
    form = replace(discovery.law.form, explanation=discovery.explanation, validated=validated)
    law = replace(discovery.law, problem=short, form=form)
    matched = unnamed_as_rival._in_intervals_of(law, discovery)
    assert float(matched.after.squares @ short.weights) < 0.9 * float(discovery.after.squares @ short.weights)
    assert matched.simulation_error.validation[0]["q1"] < discovery.simulation_error.validation[0]["q1"]
    assert not unnamed_as_rival.evidence(matched, law) > 0.0


def test_the_tables_of_a_free_law_hold_its_force(found):
    discovery, _, _ = found
    x, rate, made = along(discovery, tabulated(discovery.law.free))
    force = discovery.law.free.force(x, rate)
    assert np.abs(made - force).max() < 1e-5 * np.abs(force).max()


def test_the_written_model_reproduces_what_is_promised(found):
    discovery, _, folder = found
    for name, promised in zip(("train", "unseen"), discovery.law.error, strict=True):
        made = masking.simulate(folder / "found" / "plant.yaml", folder / f"{name}.csv", hold="first-order")
        assert made.chi["q1"] == pytest.approx(promised["q1"], rel=0.01)
    content = json.loads((folder / "found" / "discovery.json").read_text())
    assert (content["verdict"], content["law"]["on"], content["law"]["closed"]) == ("unknown", "spring1", True)
    assert content["law"]["closed_form"]["terms"][0]["shape"] == "odd power of v"
    assert content["model"].endswith("model+unnamed_law.yaml")
    said = "A law without a name in spring1 explains the record: a force that grows with the 1.7th power of the rate"
    assert said in discovery_text.sentence(discovery)
    assert "law without a name" in (folder / "found" / "discovery.html").read_text()


def test_a_law_that_may_be_none_is_called_so(found):
    discovery, _, _ = found
    assert "there may be none" not in discovery_text.sentence(discovery)
    law = replace(discovery.law)
    law.__dict__["coverage"] = replace(discovery.law.coverage, band=1.2)
    assert "there may be none" in discovery_text.sentence(replace(discovery, law=law))


def test_the_page_begins_with_measured_before_and_after_the_law(found, monkeypatch):
    discovery, _, folder = found
    drawn = {}

    def compared(before, after, labels, heading):
        drawn.update(before=before, after=after, labels=labels, heading=heading)
        return comparison(before, after, labels, heading)

    comparison = fit_figures.comparison
    monkeypatch.setattr(fit_figures, "comparison", compared)
    first = discovery_figures.figures(discovery)[0]
    page = (folder / "found" / "discovery.html").read_text()
    assert page.index(first.title) < page.index("Simulation error") < page.index("Residuals")
    assert (folder / "found" / "comparison.png").read_bytes()[:4] == b"\x89PNG"
    again = masking.simulate(folder / "found" / "plant.yaml", folder / "unseen.csv", hold="first-order")
    scale = np.abs(again.record.readings).max()
    np.testing.assert_allclose(drawn["after"].readings, again.readings, atol=2e-4 * scale)
    assert drawn["before"].chi["q1"] == pytest.approx(discovery.simulation_error.validation[0]["q1"])
    assert drawn["labels"] == ("as declared", "with the finding")
    whole, zoomed = first.figure.axes[:2]
    assert [len(axes.lines) for axes in (whole, zoomed)] == [3, 3]
    assert np.ptp(zoomed.get_xlim()) < 0.3 * np.ptp(whole.get_xlim())


def test_the_residual_with_the_finding_is_that_of_the_law(found):
    discovery, _, _ = found
    before, after = discovery.localisation.whiteness["q1"]
    assert (before.white, after.white) == (False, True)
    rms = float(np.sqrt((discovery.unseen.residuals**2).mean()))
    assert rms == pytest.approx(float(discovery.validation.sigma[0]), rel=0.05)
    assert rms < 0.5 * float(np.sqrt((discovery.after.residuals**2).mean()))  # the name leaves more
    latent = latent_force.force_at(discovery.as_written, discovery.law.place)
    assert float((latent.after**2).mean()) < 1e-3 * float((latent.before**2).mean())


def test_the_band_of_a_law_holds_the_truth(found):
    discovery, rig, _ = found
    law = discovery.law
    x, rate = law.free.x, law.free.rate
    truth = np.array([rig.hidden(d, v) for d, v in zip(x, rate, strict=True)])
    middle, half = law.free.rows(x, rate) @ law.curves[0], 2.0 * law.deviation(x, rate)
    # Curves of few pieces hold a power within `closed_form.EXACT` of its size, beside what the record leaves open.
    assert np.mean(np.abs(middle - truth) < half + closed_form.EXACT * truth.std()) > 0.9
    assert half.max() < 0.05 * np.abs(truth).max()
    told = law.as_dict()["coverage"]
    assert told["band"] == pytest.approx(np.sqrt((half**2).mean()) / np.sqrt((truth**2).mean()), rel=0.01)
    assert told["widest"]["band"] >= told["band"]
    assert told["rate"] == pytest.approx((law.free.rate.min(), law.free.rate.max()))


def test_a_law_without_a_name_says_which_experiment_tells_more(found):
    discovery, _, _ = found
    (said,) = next_experiment_text.further(discovery)
    fastest = quantity(float(np.abs(discovery.law.free.rate).max()), "m/s", 2)
    assert said.startswith("Along the motion the law is known to ± ")
    assert said.endswith(f"a motion beyond speeds of {fastest} would tell how it goes on there")
    assert said in discovery_text.sentence(discovery)


def test_energy_of_a_cycle_is_that_of_the_law(found):
    discovery, rig, _ = found
    law = discovery.law
    place = discovery.localisation.latent.best
    truth = np.mean([rig.hidden(d, v) * v for d, v in zip(law.free.x, law.free.rate, strict=True)])
    assert place.decomposition.loss == pytest.approx(truth, rel=0.1)
    said = place_text.loss(place)
    assert re.fullmatch(r"\S+ [nµm]?W \(\S+ [nµm]?J per cycle of \S+ Hz\)", said)
    assert place.as_dict()["loss_per_cycle"] == pytest.approx(place.decomposition.loss / place.frequency)


def test_a_motion_has_a_frequency_where_most_of_it_is_near_one():
    t, noise = np.arange(20_000) / 1000.0, np.random.default_rng(1)
    sine = np.sin(2.0 * np.pi * 7.3 * t)
    assert force_decomposition.cycle(sine + 0.1 * noise.standard_normal(len(t)), 1000.0) == pytest.approx(7.3, rel=0.01)
    assert force_decomposition.cycle(np.exp(-t / 5.0) * sine, 1000.0) == pytest.approx(7.3, rel=0.01)
    assert force_decomposition.cycle(np.sign(sine), 1000.0) == pytest.approx(7.3, rel=0.01)  # of a triangle
    assert force_decomposition.cycle(noise.standard_normal(len(t)), 1000.0) is None
    assert force_decomposition.cycle(sine + np.sin(2.0 * np.pi * 31.0 * t), 1000.0) is None


@pytest.mark.parametrize(
    ("sides", "visited", "of", "ends"),
    [(("v",), 1.0, "speed", {0.9, 1.0}), (("d", "v"), 44 / 144, "displacement", {-0.2, 0.0, 0.2})],
)
def test_one_sine_visits_an_ellipse(sides, visited, of, ends):
    t = np.linspace(0.0, 2.0 * np.pi, 5000)
    x, rate = np.cos(t), -np.sin(t)
    known = Coverage.of(x, rate, rate, 0.01 + 0.1 * np.abs(rate) ** 8, sides)  # fastest in the middle of the travel
    assert known.visited == pytest.approx(visited, abs=0.03)  # a circle touches 44 of 12 x 12 cells
    assert known.widest.of == of
    assert {round(known.widest.low, 2), round(known.widest.high, 2)} <= ends


def test_every_shape_of_the_grammar_is_a_safe_expression_of_zero_and_one():
    for atom in closed_form.atoms(True, True):
        names = [f"p{i}" for i in range(atom.count)]
        for values in atom.starts():
            known = {"d": np.array([0.0, 0.5]), "d_rate": np.array([0.0, -0.3]), "x0": 1.0, "v0": 1.0}
            made = closed_form.evaluated(atom.text(names), {**known, **dict(zip(names, values, strict=True))})
            exact = [
                Expression(atom.text(names)).evaluate(
                    {**dict(zip(names, values, strict=True)), "d": d, "d_rate": v, "x0": 1.0, "v0": 1.0}
                )
                for d, v in ((0.0, 0.0), (0.5, -0.3))
            ]
            np.testing.assert_allclose(np.broadcast_to(made, 2), exact, rtol=1e-12, atol=1e-15)


def test_what_names_leave_makes_none_of_them_likelier():
    values = [verdict.none_of_these(left) for left in (0.0, 0.01, 0.1, 0.5, 1.0)]
    assert values == sorted(values)
    assert values[0] == verdict.NONE_LEAST
    assert verdict.none_of_these(verdict.NONE_HALF) == pytest.approx(0.5 * (1.0 + verdict.NONE_LEAST))
    assert verdict.none_of_these(0.0, shared=True) == verdict.SHARED
    assert verdict.none_of_these(0.0, rest=verdict.REST_HALF) == pytest.approx(0.5 * verdict.REST)
    assert verdict.none_of_these(0.0, rest=1.0) < verdict.REST < verdict.LIKELIER  # a rest alone refuses no name


def test_scores_of_probabilities_are_those_of_their_definitions():
    made = [outcome(p, right) for p, right in ((0.95, True), (0.95, True), (0.95, False), (0.6, True))]
    assert scoring.brier(made) == pytest.approx((2 * 0.05**2 + 0.95**2 + 0.4**2) / 4)
    assert scoring.reliability(made) == [
        (pytest.approx(0.6), 1.0, 1),
        (pytest.approx(0.95), pytest.approx(2 / 3), 3),
    ]


def outcome(probability, is_right):
    return scoring.Outcome("", "cubic", "named", "", "", probability, is_right, 0.0, 1.0, None, "", 1.0)


def test_a_law_that_ran_away_has_no_closed_form(found):
    law = found[0].law.free
    far = replace(law.hypothesis, covariance=1e308 * np.ones_like(law.hypothesis.covariance))
    assert closed_form.forms(replace(law, hypothesis=far), 1000) == []
