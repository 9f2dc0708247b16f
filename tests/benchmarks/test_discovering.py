"""The scoring of the benchmark of discovery: what counts as right, what as confidently wrong, and its numbers."""

import json
from dataclasses import replace

import pytest

from tests.benchmarks import hidden
from tests.benchmarks.discovering import scoring, sindy, suite, summary
from tests.benchmarks.discovering.scoring import Answer, Cause
from tests.benchmarks.hidden.rig import PARAMETERS


def case(effect, at, family="effect", second=None, imperfections=(), **parameters):
    return hidden.Case(
        f"{family}/{effect}@{at}", effect, at, parameters, "medium", 1e-3, "own", 0.01, 1, family,
        second and hidden.Hidden(*second), tuple(hidden.Hidden(*one) for one in imperfections),
    )  # fmt: skip


def told(verdict, *causes, rivals=(), between=(), closed=True):
    effects = [
        {"name": name, "on": on, "parameters": {}, "probability": 1.0, "alternatives": []} for name, on in causes
    ]
    if effects:
        effects[-1]["alternatives"] = [{"name": n, "on": on, "probability": p} for n, on, p in rivals]
    coming = {"separates": True, "between": list(between)} if between else None
    found = {"verdict": verdict, "closed": closed, "effects": effects, "next_experiment": coming}
    return scoring.answer(found)


DRY = case("dry_friction", "spring1", fc=1.0, vs=1e-3)
STRIBECK = ("stribeck_friction", "spring1")
BETWEEN = ("stribeck_friction at spring1", "dry_friction at spring1")
EMPTY, DIRTY_EMPTY = case("", "", "none"), case("", "", "dirty_none", imperfections=[("actuator_cubic", "V1")])
WEIGHT = case("constant_force", "spring1", f0=1.0)
OFF = case("parameter", "w1", "parameter", relative=0.1)
TWO = case("dry_friction", "beam", "two", second=("sensor_gain", "s1"))
PLAY = case("play_with_friction", "beam", "outside")
BILINEAR = case("bilinear_spring", "beam", "outside")
DIRTY = case("dry_friction", "spring1", "dirty", imperfections=[("actuator_cubic", "V1")])
OWN, CUBIC = ("dry_friction", "spring1"), ("actuator_cubic", "V1")


@pytest.mark.parametrize(
    ("hiding", "answer", "right", "how"),
    [
        (DRY, told("named", OWN), True, "exact"),
        (DRY, told("named", ("dry_friction", "spring2")), False, "wrong place"),
        (DRY, told("named", STRIBECK), False, "near kin"),
        (DRY, told("named", ("stop", "spring1")), False, "wrong effect"),
        (DRY, told("named", OWN, ("stop", "beam")), False, "more than is there"),
        (DRY, told("none"), False, "missed"),
        (DRY, told("unknown", OWN), False, "not known"),
        (DRY, told("failed"), False, "failed"),
        # kin: only with the truth among them and an experiment that tells
        (DRY, told("ambiguous", STRIBECK, rivals=[(*OWN, 0.4)], between=BETWEEN), True, "kin"),
        (DRY, told("ambiguous", STRIBECK, rivals=[(*OWN, 0.4)]), False, "left open, no experiment"),
        (DRY, told("ambiguous", STRIBECK, rivals=[(*OWN, 0.01)], between=BETWEEN), False, "near kin"),
        (DRY, told("ambiguous", OWN, rivals=[(*STRIBECK, 0.4)], between=BETWEEN), True, "on top"),
        (DRY, told("ambiguous", OWN, rivals=[(*STRIBECK, 0.4)]), False, "left open, no experiment"),
        (DRY, told("named", OWN, rivals=[(*STRIBECK, 0.06)]), True, "exact"),
        (
            DRY,
            told("ambiguous", ("stop", "beam"), rivals=[(*OWN, 0.4)], between=BETWEEN),
            False,
            "the truth among others that are no kin",
        ),
        # exact equivalents
        (WEIGHT, told("named", ("sensor_offset", "s1")), True, "equivalent"),
        (WEIGHT, told("ambiguous", ("sensor_offset", "s1"), rivals=[("constant_force", "spring1", 0.5)]),
         True, "equivalent"),
        (WEIGHT, told("named", ("sensor_offset", "s2")), False, "wrong place"),
        (case("delay", "actuators", seconds=1e-3), told("named", ("delay", "")), True, "exact"),
        # a gain of an actuator is no parameter of this rig
        (case("actuator_gain", "V1", e=0.1), told("parameter", ("actuator_gain", "V1")), True, "exact"),
        (case("actuator_gain", "V1", e=0.1), told("parameter", ("c1", "")), False, "wrong effect"),
        (OFF, told("parameter", ("w1", "")), True, "exact"),
        (OFF, told("parameter", ("linear_spring", "spring1")), True, "equivalent"),
        (OFF, told("parameter", ("w2", "")), False, "another parameter"),
        (OFF, told("named", ("linear_spring", "spring1")), False, "not `parameter` but `named`"),
        # what an engine made is judged by what is hidden in it
        (case(*OWN, "mujoco", fc=1.0), told("named", OWN), True, "exact"),
        (case(*OWN, "mujoco", fc=1.0), told("named", STRIBECK), False, "near kin"),
        (case("parameter", "w1", "mujoco", relative=0.1), told("named", ("linear_spring", "spring1")), False,
         "not `parameter` but `named`"),
        (case("", "", "mujoco"), told("parameter", ("w1", "")), False, "something where nothing is"),
        (EMPTY, told("none"), True, "nothing"),
        (EMPTY, told("parameter", ("w1", "")), False, "something where nothing is"),
        (DIRTY_EMPTY, told("unknown", CUBIC), True, "no confident name"),
        (DIRTY_EMPTY, told("named", CUBIC), False, "a small imperfection, named"),
        (DIRTY_EMPTY, told("named", OWN), False, "a name where no main effect is"),
        (DIRTY, told("named", OWN, CUBIC), True, "exact"),
        (DIRTY, told("named", CUBIC, OWN), False, "more than is there"),
        (TWO, told("named", ("sensor_gain", "s1"), ("dry_friction", "beam")), True, "exact"),
        (TWO, told("named", ("sensor_gain", "s1")), False, "only one of two"),
        (TWO, told("named", ("sensor_gain", "s1"), ("stop", "beam")), False, "wrong effect"),
        (PLAY, told("unknown", ("dry_friction", "beam")), True, "unknown"),
        (PLAY, told("ambiguous", ("dry_friction", "beam")), False, "another name, in doubt"),
        (PLAY, told("named", ("dry_friction", "beam")), False, "a wrong name"),
        (PLAY, told("named", ("dry_friction", "beam"), closed=False), True, "the nearest, marked"),
        (PLAY, told("named", ("dry_friction", "spring1"), closed=False), False, "a wrong name"),
        (DRY, told("named", STRIBECK, closed=False), False, "near kin"),
        (BILINEAR, told("named", ("stop", "beam")), True, "equivalent"),
    ],
)  # fmt: skip
def test_answers_are_judged_strictly(hiding, answer, right, how):
    score = scoring.judge(hiding, answer)
    assert (score.right, score.how) == (right, how), str(answer)
    marked = hiding.family == "outside" and not answer.closed
    assert score.confidently_wrong == (not right and not marked and answer.verdict in ("named", "parameter"))


def test_parameters_are_compared_in_their_own_units():
    def found(hiding, name, on, **values):
        return scoring.parameters(hiding, Answer("named", (Cause(scoring.key_of(name, on), values),)))

    (fc,) = found(DRY, *OWN, fc=(1.02, 0.011))
    assert fc.error == pytest.approx(0.02)
    assert fc.covered
    (late,) = found(case("delay", "actuators", seconds=2e-3), "delay", "", tau=(2.1e-3, 1e-5))
    assert late.error == pytest.approx(0.05)
    assert not late.covered
    (drift,) = found(case("stiffness_drift", "beam", k=-20.0), "stiffness_drift", "beam", k=(-0.2, 0.0))
    assert drift.error == pytest.approx(0.0)
    tone = found(
        case("periodic_force", "beam", a=0.0, b=2.0, f=1.5), "periodic_force", "beam", a=(0.1, 0.1), nu=(1.5, 1)
    )
    assert [one.error for one in tone] == pytest.approx([0.05, 0.0])
    (zero,) = found(case("polynomial_spring", "beam", k2=1.0), "polynomial_spring", "beam", k3=(2.0, 0.5))
    assert zero.error is None
    assert not zero.covered
    w1 = hidden.truth(OFF).rig["w1"]
    (off,) = scoring.parameters(OFF, Answer("parameter", (Cause(("parameter", "w1"), {"w1": (1.01 * w1, w1)}),)))
    assert off.error == pytest.approx(0.01)
    assert not found(DRY, *STRIBECK, fc=(1.0, 1.0))


def test_intervals_are_wilson_s():
    # Newcombe (1998), Statistics in Medicine 17, 857-872, table I, method 3
    for hits, count, low, high in ((81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611)):
        assert scoring.wilson(hits, count) == pytest.approx((low, high), abs=5e-5)
    assert scoring.wilson(0, 0) == (0.0, 1.0)


def test_gaps_are_told_in_units_of_the_noise():
    floor = {"s1": 0.1, "s2": 0.2}
    assert scoring.left_over({"s1": 0.11, "s2": 0.2}, floor) == pytest.approx(1.1)
    assert scoring.is_larger({"s1": 0.1, "s2": 0.2}, {"s1": 0.1, "s2": 0.21}, floor)
    assert not scoring.is_larger({"s1": 0.2, "s2": 0.2}, {"s1": 0.1, "s2": 0.21}, floor)


def outcome(verdict, causes, after):
    effects = [{"name": n, "on": on, "parameters": {}, "probability": 1.0, "alternatives": []} for n, on in causes]
    gap = {"validation": {"before": {"s1": 0.1}, "after": {"s1": after}}}
    answer = {
        "verdict": verdict,
        "closed": True,
        "effects": effects,
        "simulation_error": gap,
        "validation_noise_floor": {"s1": 0.01},
    }
    return {"tool": "masking", "answer": answer, "seconds": 30.0, "memory": 0.5}


def test_bars_count_what_they_say():
    made = [(DRY, "named", [OWN], 0.0101), (DRY, "named", [("dry_friction", "beam")], 0.05), (EMPTY, "none", [], 0.2)]
    results = [summary.Result.of(one, outcome(*rest)) for one, *rest in made]
    bars = {bar.what: bar for bar in summary.bars(results, ())}
    assert (bars["hidden effect, noise 1e-3"].hits, bars["hidden effect, noise 1e-3"].count) == (1, 2)
    assert bars["hidden effect, noise 1e-3"].verdict == "short"
    assert bars["no effect: verdict none"].verdict == "reached"
    assert bars["named records: gap after at most 1.1 of the noise"].hits == 1
    assert bars["gap larger than before"].hits == 1
    assert bars["two effects: both right"].verdict == "not measured"
    cells = summary.confusion(results).cells
    assert cells == {("dry_friction", "dry_friction"): (1, 1), ("none", "none"): (1, 0)}


def test_terms_of_pysindy_mean_what_they_look_like():
    assert sindy.meanings(0, "sign(v1)") == [("dry_friction", "spring1")]
    assert sindy.meanings(2, "d3^3") == [("hardening_spring", "beam")]
    assert sindy.meanings(0, "d2") == [("linear_spring", "x1-x2")]
    assert sindy.meanings(1, "d1 v2") == [("terms", "d1 v2")]
    gain = [sindy.meanings(0, "V1"), sindy.meanings(0, "d1")]
    assert scoring.judge(case("actuator_gain", "V1", e=0.1), scoring.ranked(OFF, gain, "named")).right
    assert scoring.judge(OFF, scoring.ranked(OFF, gain[1:], "parameter")).right
    assert {key for term in ("d1", "v1", "V1") for kind, key in sindy.meanings(0, term) if kind == "parameter"} <= set(
        PARAMETERS
    )


def test_outcomes_are_kept_by_seed_and_sources(tmp_path):
    assert suite.restored(json.loads(json.dumps(suite.kept(TWO)))) == TWO
    assert suite.key(DRY, "a") != suite.key(DRY, "b")
    assert suite.key(DRY, "a") != suite.key(replace(DRY, seed=2), "a")
    path = tmp_path / "outcomes.jsonl"
    assert suite.read(path) == {}
    path.write_text(json.dumps({"key": "one"}) + '\n{"key": "tw', encoding="utf-8")
    assert list(suite.read(path)) == ["one"]
    pieces = suite.pieces([DRY, TWO, DRY, EMPTY, DRY], 2)
    assert [[one.family for one in piece] for piece in pieces] == [["two"], ["effect", "effect"], ["effect"], ["none"]]
    assert 25 <= sum(line.count for line in suite.QUICK) <= 35
    assert sum(line.count for line in suite.FULL if line.family == "none") == 300
