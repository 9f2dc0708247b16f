"""Answers on every suite: their scores by hand, the file that goes on where it stopped, and what each suite takes."""

import sys
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from masking.errors import RecordError
from masking.model.declaration import registry
from masking.model.effects.dictionary import EFFECTS
from tests.benchmarks import measured
from tests.benchmarks.answers import __main__ as runner
from tests.benchmarks.answers import reliability, scoring, suites
from tests.benchmarks.answers.scoring import Judgement, Line
from tests.benchmarks.independent import cases as independent
from tests.benchmarks.problems.drawn import Problem as Drawn

LINE = Line("quick", "one", "dry_friction at beam", "named", (("dry_friction", "beam"),), right=True, right_class=True,
            share=0.9, seconds=10.0)  # fmt: skip


NOT_SI = SimpleNamespace(names=("T",), unit="N*mm")


def found(verdict, *causes, probability=0.99, unit=None, law=None):
    """Return what judges and lines read of a discovery with two sensors."""
    floor = {"a": 5.0, "b": 1.0}
    errors = SimpleNamespace(
        validation=({"a": 13.0, "b": 1.0}, {"a": (25 + 36) ** 0.5, "b": 1.5}), validation_noise_floor=floor,
        adjusted={"a": 12.0, "b": 1.0},
    )  # fmt: skip
    effects = [SimpleNamespace(name=name, on=on, probability=probability) for name, on in causes]
    return SimpleNamespace(
        verdict=verdict, effects=effects, least_sure=effects[-1] if effects else None,
        simulation_error=errors, unit=unit, law=law, none_of_these=0.01, shooting_interval=None,
        twin=SimpleNamespace(dictionary=EFFECTS), explanation=SimpleNamespace(move="one more cause"),
    )  # fmt: skip


def test_the_share_is_of_what_exceeds_the_noise():
    assert scoring.share(13.0, 5.0, 5.0) == 1.0
    assert scoring.share(13.0, 13.0, 5.0) == 0.0
    assert scoring.share(13.0, 61**0.5, 5.0) == pytest.approx(0.5)  # rms of 12 and 6 beyond a noise of 5
    assert scoring.share(5.0, 73**0.5, 3.0) == pytest.approx(-1.0)  # 4 and 8 beyond 3
    assert scoring.share(2.0, 2.0, 3.0) is None  # there is no gap


def test_adjusted_parameters_are_worse_beyond_chance_over_all_sensors():
    floor = {"a": 1.0, "b": 2.0}
    assert scoring.exceeds({"a": 3.0, "b": 8.0}, {"a": 3.0, "b": 7.0}, floor)  # 5 against 21.25**0.5
    assert not scoring.exceeds({"a": 3.0, "b": 8.1}, {"a": 3.0, "b": 8.0}, floor)  # 1.3 % more is chance
    assert not scoring.exceeds({"a": 4.0, "b": 6.0}, {"a": 3.0, "b": 8.0}, floor)


def test_a_line_has_the_errors_of_the_sensor_that_shows_the_gap():
    line = scoring.answered(Line("s", "n", "t", ""), found("named", ("stop", "x")), Judgement(True, True, False))
    assert (line.sensor, line.declared, line.adjusted, line.floor) == ("a", 13.0, 12.0, 5.0)
    assert line.share == pytest.approx(0.5)
    assert line.over_noise == pytest.approx(61**0.5 / 5.0)
    assert (line.status, line.causes, line.probability) == ("right", (("stop", "x"),), 0.99)
    law = SimpleNamespace(place="x", error=(None, {"a": 5.0, "b": 1.0}))
    line = scoring.answered(line, found("unknown", law=law), Judgement(False, False, False))
    assert (line.status, line.share, line.named, line.found) == ("unknown", 1.0, pytest.approx(61**0.5), 5.0)


def test_a_summary_counts_each_answer_once():
    wrong = replace(LINE, right=False, right_class=False)
    lines = [
        LINE,
        replace(LINE, name="two", verdict="unknown", right=False, share=0.5, seconds=20.0),
        replace(wrong, name="three", confident_wrong=True, false=("overflow",), share=0.0),
        replace(wrong, name="four", verdict="traceback", share=None, is_adjusted_worse=True),
    ]
    cells = scoring.summary("quick", lines).split(" | ")
    assert cells[:9] == ["| quick", "4", "1", "2", "1", "2", "1", "1", "1"]
    assert cells[9:11] == ["0.50", "10"]  # of 0.9, 0.5 and 0; of 10, 10, 10 and 20
    told = scoring.table(lines)
    assert len({row.count("|") for row in told[:6]}) == 1
    assert "FALSE: overflow" in told[4]
    assert "CONFIDENT" in told[4]


def test_only_answers_that_differ_are_listed():
    others = {name: replace(LINE, name=name) for name in ("same", "slower", "share", "cause", "gone")}
    lines = {
        "same": LINE, "slower": replace(LINE, seconds=99.0), "share": replace(LINE, share=0.8),
        "cause": replace(LINE, causes=(("stop", "beam"),)),
    }  # fmt: skip
    keyed = [{("quick", name): line for name, line in every.items()} for every in (lines, others)]
    rows = scoring.differences(*keyed)[2:]
    assert [row.split(" | ")[1] for row in rows] == ["share", "cause"]
    assert "stop at beam" in rows[1]


def fake(name, discover, lacking=""):
    return suites.Problem("fake", name, "nothing", lambda _: discover, lambda _: Judgement(True, True, False), lacking)


def test_a_file_goes_on_where_it_stopped(tmp_path, monkeypatch, capsys):
    calls, out = Counter(), tmp_path / "answers.jsonl"

    def discover(name):
        calls[name] += 1
        if name == "refused":
            raise RecordError("too short")
        return found("none") if name == "sound" else 1 / 0

    every = [fake(name, lambda name=name: discover(name)) for name in ("sound", "refused", "broken")]
    every.append(fake("absent", None, "no data"))
    monkeypatch.setattr(runner, "SUITES", {"fake": lambda: iter(every)})
    for part in ("1/2", "1/1", "1/1"):
        monkeypatch.setattr(sys, "argv", ["answers", "--out", str(out), "--part", part])
        assert runner.main() == 0
        with out.open("a") as file:
            file.write('{"suite": "fa' if part == "1/2" else "")  # as an interrupt leaves it
            file.write("\n")
    assert calls == {"sound": 1, "refused": 1, "broken": 1}
    lines = {line.name: line for line in scoring.read(out).values()}
    assert {name: line.status for name, line in lines.items()} == {
        "sound": "right", "refused": "wrong", "broken": "wrong",
    }  # fmt: skip
    assert lines["refused"].error == "too short"
    assert "ZeroDivisionError" in lines["broken"].error
    assert "absent: left out, no data" in capsys.readouterr().err


@pytest.mark.parametrize("name", measured.SETS)
def test_each_measured_set_is_a_model_with_a_command_and_names_of_the_dictionary(name):
    truth, example = measured.SETS[name], measured.examples()[name]
    assert registry.load_model(example).name == name
    words = measured.command(example)
    assert words[:2] == ["discover", next(word for word in words if word.startswith(truth.folder))]
    assert truth.right | truth.beside | measured.FALSE <= {*EFFECTS}
    assert truth.right


def test_every_set_and_every_example_is_there():
    assert {*measured.examples()} == {*measured.SETS}
    assert len({truth.folder for truth in measured.SETS.values()}) == 15
    if measured.DATA.exists():
        assert {truth.folder for truth in measured.SETS.values()} == {one.name for one in measured.DATA.iterdir()}


def test_slopes_are_those_of_the_motion():
    t = np.array([0.0, 0.1, 0.25, 0.3, 0.5])
    made = measured.slopes(t, 20.0, d=3.0 * t, F=t)
    np.testing.assert_allclose(made["v"], 3.0)
    np.testing.assert_allclose(np.diff(made["t"]), 0.05)


@pytest.mark.parametrize(
    ("answer", "right", "has_class", "confident", "false"),
    [
        (found("named", ("dry_friction", "shaft")), True, True, False, ()),
        (found("ambiguous", ("dry_friction", "shaft"), probability=0.5), True, True, False, ()),
        (found("unknown", ("dry_friction", "shaft")), False, True, False, ()),
        (found("named", ("dry_friction", "shaft"), ("overflow", "shaft")), False, True, True, ("overflow",)),
        (found("unknown", ("dry_friction", "shaft"), ("overflow", "shaft")), False, True, False, ()),
        (found("named", ("delay", "")), False, False, True, ()),
        (found("named", ("delay", ""), probability=0.6), False, False, False, ()),
        (found("none"), False, False, False, ()),
        (found("named", ("dry_friction", "shaft"), unit=NOT_SI), False, True, True, ("unit of T",)),
    ],
)  # fmt: skip
def test_measured_answers_are_judged_by_the_main_cause(answer, right, has_class, confident, false):
    assert suites.judged_measured(measured.SETS["hsm150"], answer) == Judgement(right, has_class, confident, false)


def second(effect, quality=independent.GOOD):
    made = independent.Case(3, effect, quality, rate=200.0, seconds=4.0)
    _ = made.told
    return made, made.truth[1]


def test_answers_on_the_second_generator_are_judged_by_class_and_place():
    case, at = second("play")
    assert suites.judged_second(case, found("named", ("backlash", at))) == Judgement(True, True, False)
    assert suites.judged_second(case, found("named", ("backlash", "u1"))) == Judgement(False, False, True)
    assert suites.judged_second(case, found("named", ("play", at), ("sensor_gain", "x1"))) == Judgement(
        False, True, True
    )
    real, at = second("play", independent.REAL)
    assert suites.judged_second(real, found("named", ("sensor_gain", "x1"), ("play", at))) == Judgement(
        True, True, False
    )
    nothing, _ = second(independent.NOTHING)
    assert suites.judged_second(nothing, found("none")).right
    assert suites.judged_second(nothing, found("named", ("play", at))).confident_wrong
    outside, at = second("sinh")
    assert suites.judged_second(outside, found("unknown")).right
    assert not suites.judged_second(outside, found("named", ("hardening_spring", at))).right


def test_a_machine_in_which_nothing_hides_moves_as_a_linear_one():
    case, _ = second(independent.NOTHING)
    u, x = case.told
    linear = case.rig.scale * case.rig.linear(u, case.rate)
    left = (x - linear)[20:].std(axis=0) / x.std(axis=0)
    np.testing.assert_allclose(left, case.quality.noise, rtol=0.1)


def test_rounds_of_the_second_generator_do_not_repeat():
    names = [problem.name for problem in suites.of_second(72)]
    assert len({*names}) == len(names)
    assert names[:24] == [problem.name for problem in suites.of_second()]


def test_random_problems_are_judged_by_each_hidden_law():
    named, nameless = (Drawn("", "", {}, [(name, ("spring1",))], "") for name in ("stop", "valve"))
    assert suites.judged_problem(named, found("named", ("stop", "spring1"))) == Judgement(True, True, False)
    assert suites.judged_problem(named, found("unknown")) == Judgement(False, False, False)
    assert suites.judged_problem(named, found("named", ("stop", "spring1"), ("play", "spring1"))) == Judgement(
        False, True, True
    )
    assert suites.judged_problem(nameless, found("unknown")).right


def test_answers_are_right_as_often_as_they_say_within_an_interval_of_wilson():
    lines = [replace(LINE, name=str(i), probability=0.99, right=i < 9) for i in range(10)]
    lines += [replace(LINE, name="open", verdict="unknown", none=0.7, probability=None)]
    lines += [replace(LINE, name="nothing", verdict="none", probability=None)]  # it states no probability
    middle, sure = reliability.bins(reliability.stated(lines))
    assert middle == (pytest.approx(0.7), 1, 1)
    assert sure == (pytest.approx(0.99), 9, 10)
    # Newcombe (1998), Stat. Med. 17(8), 857-872, table I, method 3.
    for right, count, ends in ((81, 263, (0.2553, 0.3662)), (15, 148, (0.0624, 0.1605)), (0, 20, (0.0, 0.1611))):
        assert reliability.Bin(0.5, right, count).interval == pytest.approx(ends, abs=5e-5)
    assert reliability.table(lines)[2:] == [
        "| quick | 70 % | 1 | 100 % | 21 to 100 % |", "| quick | 99 % | 10 | 90 % | 60 to 98 % |"
    ]  # fmt: skip


def test_the_diagram_of_several_suites_is_drawn(tmp_path):
    lines = [replace(LINE, suite=suite, probability=0.5) for suite in ("measured", "second")]
    reliability.diagram(lines, tmp_path / "diagram.png")
    assert (tmp_path / "diagram.png").read_bytes().startswith(b"\x89PNG")
