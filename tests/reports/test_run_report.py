"""The report: page, figures and summary of recordings given in closed form."""

import base64
import html.parser
import math
import re
import subprocess
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from masking.errors import RecordError
from masking.lab.records.recording import Recording
from masking.model.declaration.quantities import percent
from masking.reports import run_figures, style
from masking.reports.run_report import limits_used, report, summary, warnings
from masking.reports.run_study import Study, parameters

FIGURES = ["displacements", "others", "synchronisation", "inputs", "masking_error"]


def duffing(samples: int = 20_000, error: float = 3e-9, **manifest: object) -> Recording:
    """Two oscillators whose sum decays as exp(-tau / 300), as seen on a rig 18 times as fast."""
    scale = 1 / 18.0
    tau = np.linspace(0.0, 2500.0, samples)
    half_sum, half_difference = -0.55 * np.exp(-tau / 300), -0.05 - 0.3 * (1 - np.exp(-tau / 300))
    ideal = {
        "x1": (half_sum + half_difference) * np.cos(tau),
        "x2": (half_sum - half_difference) * np.cos(tau),
        "x3": 0.02 * np.exp(-tau / 300) * np.sin(tau),
    }
    columns = {"t": tau * scale}
    for name, motion in ideal.items():
        columns[f"rig.{name}"] = columns[f"virtual.{name}"] = motion * (1 + error)
        columns[f"ideal.{name}"] = motion
    columns["input.u1"] = 0.21 * np.cos(tau)
    columns["input.u2"] = 0.005 * np.cos(tau)
    told = {
        "name": "duffing",
        "seed": 7,
        "versions": {"masking": "0.1.0", "numpy": "2.4"},
        "commit": "f00dfeed",
        "declarations": {"virtual": {"parameters": {"w3": {"value": 0.5316, "unit": 1, "meaning": "beam frequency"}}}},
        "columns": {
            "t": {"unit": "s", "meaning": "time"},
            "virtual.x3": {"unit": "1", "meaning": "displacement of the beam"},
            "input.u1": {"unit": "V", "meaning": "voltage of actuator 1"},
        },
        "time_scale": scale,
        "virtual_name": "coupled Duffing oscillators",
        "plant_name": "ideal rig",
        "oscillators": ["x1", "x2"],
        "mode": "sampled",
        "rate": 1000,
        "limits": {"u1": {"max": 0.42, "unit": "V"}, "u2": {"max": 0.42, "unit": "V"}},
        "timing": {"compile": 0.2, "run": 1.5},
        "energy": {"virtual": 2e-11},
    }
    return Recording(columns, told | manifest)


class Page(html.parser.HTMLParser):
    """Collects the tags, the text and the attributes that could refer to something outside the page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.words: list[str] = []
        self.open: list[str] = []
        self.references: list[str] = []
        self.feed(text)
        self.text = re.sub(r"\s+", " ", "".join(self.words))

    def handle_starttag(self, tag, attrs):
        assert tag not in {"script", "link", "iframe", "object"}
        if tag not in {"meta", "img", "br"}:
            self.open.append(tag)
        self.references += [value for name, value in attrs if name in {"src", "href", "srcset"}]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def page_of(result) -> Page:
    text = result.path.read_text("utf-8")
    assert "url(" not in text
    assert "@import" not in text
    page = Page(text)
    assert page.open == []
    return page


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    recording = duffing()
    recording.save(folder)
    return report(recording, folder)


def test_writes_the_page_and_its_figures(made):
    assert made.path.name == "report.html"
    assert [path.stem for path in made.figures] == FIGURES
    assert all(path.read_bytes().startswith(b"\x89PNG\r\n") for path in made.figures)


def test_the_page_holds_its_figures_and_refers_to_nothing_else(made):
    prefix = "data:image/png;base64,"
    references = page_of(made).references
    assert all(reference.startswith(prefix) for reference in references)
    assert [base64.b64decode(r.removeprefix(prefix)) for r in references] == [p.read_bytes() for p in made.figures]


def test_the_page_says_what_happened(made):
    text = page_of(made).text
    assert (
        "The ideal rig moved as coupled Duffing oscillators: masking error χ ≤ 3 · 10\N{MINUS SIGN}9 in each coordinate"
        in text
    )
    assert "over 2500 units of time. x1 and x2 went from in-phase (0.000 π) to anti-phase (1.000 π)." in text
    assert "Displacement of the beam" in text
    assert "u1voltage of actuator 10.21 V0.148 V0.42 V50 %" in text.replace("\n", "")
    assert "w30.5316beam frequency" in text
    assert "numpy 2.4" in text
    assert "f00dfeed" in text
    assert "recording.parquet, manifest.json, displacements.png" in text
    assert "None" not in text
    assert not re.search(r"\bnan\b", text)


def test_the_summary():
    lines = summary(duffing()).splitlines()
    # The sum is 2 * 0.55 exp(-tau / 300); its peak over the last three periods lies up to 6 pi before the end.
    sums = re.fullmatch(r"  peak sum   \|x1 \+ x2\| from 1\.1 to (\S+)", lines.pop(4))
    assert 1.1 * np.exp(-2500 / 300) <= float(sums[1]) <= 1.1 * np.exp(-(2500 - 6.0 * np.pi) / 300) * 1.01
    words = r"  anti-phase alpha = (\S+), eps = (\S+) over the last fifth; within 5 % of the amplitude from (\S+) on"
    fit = re.fullmatch(words, lines.pop(3))
    # The sum falls to 0.05 of the amplitude, 0.35 at last.
    assert float(fit[3]) == pytest.approx(300 * math.log(1.1 / (0.05 * 0.35)), rel=0.02)
    assert float(fit[1]) == pytest.approx(1.0, abs=5e-3)
    # alpha takes up the part of the sum that is there all along, about half of it.
    assert 0.3 < float(fit[2]) / (1.1 * np.exp(-2000 / 300)) < 1.0
    assert lines == [
        "The ideal rig moved as coupled Duffing oscillators: "
        "masking error chi <= 3e-9 in each coordinate over 2500 units of time.",
        "x1 and x2 went from in-phase (0.000 pi) to anti-phase (1.000 pi).",
        "  error      x1 3e-9  x2 3e-9  x3 3e-9",
        "  inputs     u1 50 % of 0.42 V  u2 1.2 % of 0.42 V",
        "  energy     drift of the virtual system 2e-11",
        "  record     20000 samples, 139 s of the rig, sampled at 1 kHz, seed 7",
        "  time       compile 0.2 s  run 1.5 s",
    ]


@pytest.mark.parametrize(
    ("error", "verb"), [(1e-3, "moved as"), (0.1, "moved roughly as"), (0.5, "did not move as"), (0.0, "moved as")]
)
def test_the_verb_follows_the_masking_error(error, verb):
    sentence = summary(duffing(2000, error)).splitlines()[0]
    assert sentence.startswith(f"The ideal rig {verb} coupled Duffing oscillators: masking error chi ")


# ---- the values that ran


def virtual(**declared: object) -> dict[str, object]:
    return {"parameters": declared}


def test_shows_the_values_that_ran_and_names_the_changes(tmp_path):
    declared = virtual(
        w3={"value": 0.5316, "meaning": "beam"}, th1={"value": "1/3"}, w1={"value": 1.0}, k={"value": "w3**2"}
    )
    changes = {"experiment": {"parameters": {"w3": 0.6, "w1": 1.0}}, "virtual": declared}
    ran = {"w3": 0.6, "th1": 1 / 3, "w1": 1.0, "k": 0.36}
    result = report(duffing(2000, declarations=changes, parameters=ran), tmp_path)
    assert "  changed    w3 = 0.6\n" in result.summary
    text = page_of(result).text
    assert "Changed: w3 = 0.6 (declared 0.5316)." in text
    assert "w30.6 (declared 0.5316)beamth10.3333333 (= 1/3)w11k0.36 (= w3**2)" in text


def test_what_ran_counts_even_where_no_change_is_stated():
    declarations = {"virtual": virtual(w3={"value": 0.5316})}
    assert "  changed    w3 = 0.6\n" in summary(duffing(2000, declarations=declarations, parameters={"w3": 0.6}))
    assert "changed" not in summary(duffing(2000, declarations=declarations, parameters={"w3": 0.5316}))
    assert "changed" not in summary(duffing(2000))


def test_parameters_with_units_are_shown_in_them(tmp_path):
    declared = virtual(l={"value": 5, "unit": "mm"}, w={"value": 2, "unit": "rad/s"}, b={"value": "l", "unit": "mm"})
    changes = {"experiment": {"parameters": {"l": 6}}, "virtual": declared}
    si = duffing(2000, declarations=changes, parameters={"l": 0.006, "w": 2.0, "b": 0.006})
    assert [(p.value, p.scaled, p.is_changed) for p in parameters(si)] == [
        (pytest.approx(6.0), None, True),
        (2.0, None, False),
        (pytest.approx(6.0), None, False),
    ]
    assert "  changed    l = 6 mm\n" in summary(si)
    # With the scales l = 6 mm and 1/w the same values run as ones.
    changes["virtual"] = {**declared, "scales": {"length": {"value": "l", "unit": "m"}}}
    scaled = duffing(2000, declarations=changes, parameters={"l": 1.0, "w": 1.0, "b": 1.0})
    assert [(p.value, p.scaled, p.is_changed) for p in parameters(scaled)] == [
        (6.0, 1.0, True),
        (2.0, 1.0, False),
        ("l", 1.0, False),
    ]
    text = page_of(report(scaled, tmp_path)).text
    assert "parametervalueunitin its scalesmeaningl6 (declared 5)mm1w2rad/s1bl" in text


def test_a_unit_that_nobody_knows_is_no_reason_to_fail():
    odd = duffing(100, declarations={"virtual": virtual(c={"value": 5, "unit": "furlong**x"})}, parameters={"c": 7.0})
    (found,) = parameters(odd)
    assert (found.value, found.unit, found.is_changed) == (7.0, "SI unit of furlong**x", False)


# ---- warnings


def test_a_limit_exceeded_is_said_first(tmp_path):
    # Peaks: u1 0.21 V, u2 0.005 V.
    limits = {"u1": {"max": 0.028, "unit": "V"}, "u2": {"max": 0.0049, "unit": "V"}}
    recording = duffing(2000, limits=limits)
    said = (
        "Not possible on this rig: u1 needs 0.21 V, 7.5 times its limit of 0.028 V; "
        "u2 needs 0.005 V, 2 % above its limit of 0.0049 V."
    )
    assert warnings(recording) == [said]
    assert limits_used(recording) == {"u1": pytest.approx(7.5), "u2": pytest.approx(0.005 / 0.0049)}
    result = report(recording, tmp_path)
    first, second, *_ = result.summary.splitlines()
    assert first.startswith("The ideal rig would move as coupled Duffing oscillators: ")
    assert second == said
    page = result.path.read_text("utf-8")
    assert page.index("would move as") < page.index('<p class="card wrong">Not possible') < page.index("went from")
    assert '<div class="wrong"><dt>largest use of a limit' in page


@pytest.mark.parametrize(
    ("error", "verb"), [(0.0, "would move as"), (0.1, "would move roughly as"), (0.5, "would not move as")]
)
def test_what_is_not_possible_is_not_said_to_have_happened(error, verb):
    recording = duffing(2000, error, limits={"u1": {"max": 0.1, "unit": "V"}})
    assert summary(recording).startswith(f"The ideal rig {verb} coupled Duffing oscillators: ")


def test_an_input_at_its_limit_does_not_exceed_it():
    recording = duffing(2000, limits={"u1": {"max": 0.21 * (1 - 1e-13)}})
    assert warnings(recording) == []
    assert limits_used(recording) == {"u1": pytest.approx(1.0)}


@pytest.mark.parametrize(
    ("rate", "words", "half"), [(1000, "1 kHz", "0.5 ms"), (250.0, "250 Hz", "2 ms"), (0.25, "0.25 Hz", "2 s")]
)
def test_the_cost_of_sampling_is_named(rate, words, half, tmp_path):
    said = (
        f"Sampled at {words}, inputs act half a sample ({half}) late on average, and nothing here compensates for it; "
        "'observer: disturbance' does, and a higher controller.rate reduces it."
    )
    recording = duffing(2000, 0.02, rate=rate)
    assert warnings(recording) == [said]
    assert summary(recording).splitlines()[1] == said
    assert said in page_of(report(recording, tmp_path)).text


@pytest.mark.parametrize(
    ("kind", "is_late"), [("exact", True), ("differences", True), ("kalman", False), ("disturbance", False)]
)
def test_only_an_observer_with_a_model_makes_up_for_sampling(kind, is_late):
    told = warnings(duffing(2000, 0.02, observer={"kind": kind}))
    assert [text.partition(",")[0] for text in told] == ["Sampled at 1 kHz"] * is_late


@pytest.mark.parametrize(
    ("told", "words"),
    [
        (
            {"kind": "disturbance", "order": 2, "delay": 1, "bandwidth": {"x1": 250.0, "x2": 250.0, "x3": 148.3}},
            "disturbance observer, order 2, bandwidth 250/250/148 rad/s, 1 sample of delay predicted",
        ),
        (
            {"kind": "kalman", "order": 0, "delay": 0, "bandwidth": {"x1": 60.0}},
            "Kalman filter, bandwidth 60 rad/s, no delay",
        ),
        ({"kind": "differences", "delay": 2}, "differences of the positions, 2 samples of delay not predicted"),
    ],
)
def test_the_observer_is_told(told, words, tmp_path):
    recording = duffing(2000, observer=told)
    assert f"\n  observer   {words}\n" in summary(recording)
    assert f"observer{words}" in page_of(report(recording, tmp_path)).text
    assert "observer" not in summary(duffing(2000, observer={"kind": "exact"}))


def cut(limit: float, power: float | None = None, **manifest: object) -> Recording:
    """The duffing record, whose u1 was demanded up to 0.21 V and held back."""
    whole = duffing(20_000, **manifest)
    columns = dict(whole.columns)
    columns["demanded.u1"], columns["demanded.u2"] = columns["input.u1"], columns["input.u2"]
    columns["input.u1"] = np.clip(columns["input.u1"], -limit, limit)
    if power is not None:
        columns["power.u1"] = columns["power.u2"] = np.full(len(whole), power)
    return Recording(columns, whole.manifest)


def test_saturation_is_said_with_what_was_demanded(tmp_path):
    # |0.21 cos| is above 0.105 for two thirds of the time.
    limits = {name: {"max": 0.105, "unit": "V"} for name in ("u1", "u2")}
    recording = cut(0.105, limits=limits)
    said = "u1 was at its limit for 67 % of the run: demanded up to 200 % of 0.105 V; the rig could not follow there."
    assert warnings(recording) == [said]
    result = report(recording, tmp_path)
    assert result.summary.splitlines()[1] == said
    page = result.path.read_text("utf-8")
    assert page.index("moved as") < page.index('<p class="card wrong">') < page.index("went from")
    assert '<div class="wrong"><dt>largest demand against a limit' in page
    assert '<th class="n">demanded</th>' in page
    plate = run_figures.figures(Study(recording))[3]
    above, below = plate.figure.axes
    assert above.get_title(loc="right") == "demanded 200 %, applied 100 % of 0.105 V"
    assert max(np.max(line.get_ydata()) for line in above.lines) == pytest.approx(0.21)
    assert "demanded" not in below.get_title(loc="right")
    assert "Thin orange lines are what was demanded." in plate.caption


def test_power_that_holds_back_is_told_apart_and_stands_in_the_table(tmp_path):
    declarations = {"plant": {"limits": {"power": {"value": 8.0, "unit": "W"}}}}
    recording = cut(0.105, power=7.9, declarations=declarations)
    assert warnings(recording) == [
        "u1 was held back by its mean power of 8 W for 67 % of the run: demanded up to 50 % of 0.42 V; "
        "the rig could not follow there."
    ]
    assert "7.9 of 8 W" in page_of(report(recording, tmp_path)).text


STOP = {
    "met": True,
    "at": 211.47,
    "of": ["x1", "x2"],
    "phase": "anti",
    "eps": 0.05,
    "periods_needed": 1.5,
    "duration": 2500.0,
}


def test_what_ended_a_run_is_said():
    said = "The run ended after 211.5 of 2500 units of time, when x1 and x2 were in anti-phase to 5 % of the amplitude."
    assert said in summary(duffing(stop=STOP)).splitlines()
    said = "The run was not ended early: x1 and x2 were in-phase to 5 % of the amplitude for 1.5 periods at no time."
    assert said in summary(duffing(stop={**STOP, "met": False, "at": None, "phase": "in"})).splitlines()


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (lambda t: np.cos(1.05 * t), "x1 and x2 beat with a period of 125.7: they are not synchronised."),
        (lambda t: np.cos(t) * np.exp(-t / 100), "x2 has come to rest."),
        (lambda t: np.cos(2 * t), "x1 and x2 are locked 2:1"),
    ],
)
def test_other_kinds_of_motion_are_named(other, said):
    whole = duffing()
    tau = whole.t * 18
    columns = {**whole.columns, "virtual.x1": np.cos(tau), "virtual.x2": other(tau)}
    lines = summary(Recording(columns, whole.manifest)).splitlines()
    assert [line for line in lines if line.startswith(said)]


BUDGET = {
    "sentence": "Remedy first: friction (chi 0.03 -> 0.01 without).",
    "chi": {"x1": 0.03, "x2": 0.03, "x3": 0.03},
    "rms": 0.03,
    "rows": [
        {"cause": "springs", "chi": {"x1": "inf", "x2": "inf", "x3": "inf"}, "rms": "inf", "note": "it stopped"},
        {"cause": "friction", "chi": {"x1": 0.01, "x2": 0.01, "x3": 0.01}, "rms": 0.01, "remedy": "align the coil"},
        {"cause": "sampling", "chi": {"x1": 0.03, "x2": 0.03, "x3": 0.03}, "rms": 0.03, "remedy": "a higher rate"},
    ],
    "without_all": {"cause": "all of these", "chi": {"x1": 0.0, "x2": 0.0, "x3": 0.0}, "rms": 0.0},
}


def test_what_limits_the_masking_error_is_drawn_and_tabulated(tmp_path):
    recording = duffing(2000, observer={"kind": "kalman"}, budget=BUDGET)
    result = report(recording, tmp_path)
    assert [path.stem for path in result.figures] == [*FIGURES, "budget"]
    assert BUDGET["sentence"] in result.summary
    text = page_of(result).text
    assert "Remedy first: friction (χ 0.03 → 0.01 without)." in text
    assert (
        "without friction0.010.010.010.01\N{MINUS SIGN}67 %align the coil"
        "sampled faster0.030.030.030.030 %"
        "without springsinfinfinfinfdivergesit stopped"
        "without all0000\N{MINUS SIGN}100 %"
    ) in text
    axes = run_figures.figures(Study(recording))[-1].figure.axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == [
        "without friction", "sampled faster", "without springs", "without all",
    ]  # fmt: skip
    assert "diverges" in [text.get_text() for text in axes.texts]


def test_a_budget_that_is_lacking_is_noted_only_where_there_could_be_one(tmp_path):
    said = "What limits the masking error. Not shown: "
    assert said in page_of(report(duffing(500, observer={"kind": "kalman"}), tmp_path)).text
    assert said not in page_of(report(duffing(500), tmp_path)).text


def test_there_is_no_warning_without_a_reason():
    assert warnings(duffing(2000)) == []
    assert warnings(duffing(2000, 0.02, mode="continuous", rate=None)) == []
    assert warnings(Recording({"t": [0.0]})) == []
    assert limits_used(Recording({"t": [0.0], "input.u": [1.0]})) == {}


def test_a_masking_error_above_one_is_said_with_the_causes_that_were_measured():
    rig = {"end": "finished", "counters": {"late": 3, "missed": 80}, "timing": {"controller": {"counts": [900, 20]}}}
    (other,) = warnings(duffing(2000, 1.5, mode="real time"))
    assert other.startswith("The masking error is above 1 (x1 1.5, x2 1.5, x3 1.5): a rig at rest would be nearer")
    assert "Nothing that was measured explains it: compare zeros, noise, gains and delay" in other
    other, cause = warnings(duffing(2000, 1.5, mode="real time", rig=rig))
    assert other.endswith("a rig at rest would be nearer to the wanted motion.")
    assert cause.startswith("8 % of the samples were late or missed")
    held = {"experiment": {"controller": {"regulate": {"energy": 0.1}}}}
    assert warnings(duffing(2000, 1.5, mode="real time", declarations=held)) == []
    assert warnings(duffing(2000, 0.99, mode="real time")) == []


def test_commands_faster_than_the_rig_allows_are_said():
    """0.21 cos(18 t) changes by 3.78 a second."""
    (said,) = warnings(duffing(20_000, limits={"u1": {"max": 1.0, "rate": 2.0}, "u2": {"max": 1.0, "rate": 2.0}}))
    assert re.fullmatch(r"u1 changes by 3\.78 \S*/s, where 2 are allowed: on the rig, commands are slowed\.", said)
    assert warnings(duffing(20_000, limits={"u1": {"max": 1.0, "rate": 4.0}})) == []


def test_the_longest_summary_is_fourteen_lines():
    changes = {"virtual": virtual(w3={"value": 1.0}), "experiment": {"parameters": {"w3": 2.0}}}
    lines = summary(
        duffing(2000, 0.1, limits={"u1": {"max": 0.1}}, declarations=changes, oscillators=["x1", "x2", "x3"])
    ).splitlines()
    assert len(lines) <= 14
    assert lines[-1].startswith("  time ")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("ideal rig", "The ideal rig moved as"),
        ("the ideal rig", "The ideal rig moved as"),
        ("my rig", "My rig moved as"),
        ("A rig", "A rig moved as"),
        ("our lab's rig", "Our lab's rig moved as"),
        ("Mary's rig", "Mary's rig moved as"),
        ("myrig", "The myrig moved as"),
        (" ", "The rig moved as"),
    ],
)
def test_the_article_follows_the_name(name, said):
    assert summary(duffing(2000, plant_name=name)).startswith(f"{said} coupled")


@pytest.mark.parametrize(
    ("speeds", "said"),
    [
        ((4.0, 1.3), "th1 and th2 kept no fixed phase."),
        ((0.0, 1.3), "th1 and th2 went from in-phase (0.000 pi) to no fixed phase."),
    ],
)
def test_a_phase_that_drifts(speeds, said):
    t = np.linspace(0.0, 600.0, 12_000)
    slip = np.where(t < 300, speeds[0] * t, speeds[1] * (t - 300))
    columns = {"t": t, "virtual.th1": np.cos(10 * t), "virtual.th2": np.cos(10 * t + slip)}
    assert said in summary(Recording(columns, {"oscillators": ["th1", "th2"]}))


def test_compilation_is_told_first():
    timing = {"run": 1.0, "ideal": 2.0, "compilation": 3.0}
    assert summary(duffing(2000, timing=timing)).endswith("  time       compilation 3 s  run 1 s  ideal 2 s")


def test_sections_that_would_be_empty_are_notes(tmp_path):
    recording = series(500, 1, oscillators=["th1"])
    noted = Recording(recording.columns, recording.manifest, ("manifest.json is missing.",))
    page = report(noted, tmp_path).path.read_text("utf-8")
    assert re.findall("<h2>(.*?)</h2>", page) == [
        "Displacements", "Inputs against their limits", "Masking error", "Notes", "Provenance",
    ]  # fmt: skip
    notes = re.findall("<li>(.*?)</li>", page)
    assert notes[:3] == [
        "manifest.json is missing.",
        "Other coordinates. Not shown: every coordinate is among the displacements.",
        "Synchronisation. Not shown: there is only one oscillator.",
    ]
    assert len(notes) == 4


def test_the_source_is_named_where_its_numbers_are(made):
    text = page_of(made).text
    assert "Rijlaarsdam (2008), (4.12)" in text
    assert "Rijlaarsdam (2008), definition 5.3" in text


@given(st.floats(-290, 290), st.floats(0.3, 8))
def test_a_logarithmic_axis_holds_two_powers_of_ten(exponent, decades):
    low, high = 10.0**exponent, 10.0 ** (exponent + decades)
    wide_low, wide_high = run_figures._two_decades(low, high)
    assert wide_low <= low < high <= wide_high
    assert math.floor(math.log10(wide_high) + 1e-9) > math.ceil(math.log10(wide_low) - 1e-9)


@pytest.mark.parametrize("peak", [1.1, 0.0999, 3.0, 1e-9, 2.4e17, 5e-324])
def test_a_constant_peak_has_two_labels(peak):
    _, (axes,) = style.sheet([2.0])
    run_figures._peaks(Study(series(30, 1)), [(np.full(30, peak), run_figures.INK, "")], "").draw(axes)
    axes.figure.canvas.draw()
    low, high = axes.get_ylim()
    labels = [text.get_text() for text in axes.get_yticklabels() if low <= text.get_position()[1] <= high]
    assert len([label for label in labels if label]) >= 2


def test_names_from_outside_are_escaped(tmp_path):
    evil = "<script>alert(1)</script> & $x_1$ $ \\frac"
    columns = {"virtual.x1": {"unit": "mm", "meaning": evil}}
    names = dict.fromkeys(("name", "plant_name", "virtual_name", "commit"), evil)
    recording = duffing(500, columns=columns, versions={evil: evil}, declarations={"virtual": {evil: evil}}, **names)
    page = page_of(report(recording, tmp_path))
    assert "alert(1)" in page.text


def series(samples: int, coordinates: int, amplitude: float = 1.0, step: float = 0.1, **manifest: object) -> Recording:
    """Coordinates th1, th2, ... spread evenly over the phases of one period, and one input."""
    t = step * np.arange(samples)
    columns = {"t": t, "input.u": 0.4 * amplitude * np.sin(t)}
    for k in range(coordinates):
        columns[f"virtual.th{k + 1}"] = columns[f"ideal.th{k + 1}"] = amplitude * np.cos(
            t - 2 * np.pi * k / coordinates
        )
    return Recording(columns, manifest)


TWO = ("th1", "th2")


@pytest.mark.parametrize(
    ("recording", "drawn", "said"),
    [
        (series(500, 1, oscillators=["th1"]), ["displacements", "inputs"], "Not shown: there is only one oscillator."),
        (
            series(500, 2, amplitude=0.0, oscillators=TWO, limits={"u": {"max": 0.4, "unit": "V"}}),
            ["displacements", "inputs"],
            "The rig stood still over 49.9 units of time.",
        ),
        (
            series(3, 2, oscillators=TWO),
            ["displacements", "inputs"],
            "Not shown: the record holds fewer than three periods of th1.",
        ),
        (series(1, 2, oscillators=TWO), ["displacements", "inputs"], "Not shown: th1 does not move."),
        (
            series(5000, 5, oscillators=[f"th{k}" for k in range(1, 6)], time_scale=0.5),
            FIGURES[:1] + FIGURES[2:4],
            "th5",
        ),
        (series(900, 3), ["displacements", "inputs"], "does not say which coordinates are oscillators"),
        (series(9, 0), ["inputs"], "Not shown: the record holds no coordinates."),
        (
            Recording({"t": [0.0, 1.0], "virtual.x": [0.0, 1.0]}),
            ["displacements"],
            "Not shown: the record holds no ideal motion to compare with.",
        ),
        (
            Recording({"t": [0.0, 1.0], "rig.x": [0.0, 1.0]}),
            ["displacements"],
            "Not shown: the record holds no inputs.",
        ),
        (Recording({"t": [0.0]}), [], "Not shown: the record holds no inputs."),
    ],
    ids=[
        "one",
        "still",
        "three samples",
        "one sample",
        "five",
        "no oscillators",
        "only inputs",
        "no ideal",
        "rig",
        "bare",
    ],
)
def test_says_what_is_not_shown_and_why(tmp_path, recording, drawn, said):
    result = report(recording, tmp_path)
    assert [path.stem for path in result.figures] == drawn
    assert said in page_of(result).text
    assert 1 <= len(result.summary.splitlines()) <= 14


def test_equal_motions_are_said_to_be_equal(tmp_path):
    result = report(series(500, 2, oscillators=TWO), tmp_path)
    assert "virtual and ideal are equal in every digit recorded" in page_of(result).text
    assert "th1 and th2 stayed in anti-phase (from 1.000 pi to 1.000 pi)." in result.summary


def test_an_oscillator_that_was_not_recorded():
    with pytest.raises(RecordError, match=r"no column 'virtual\.y1'; did you mean 'virtual\.x1'"):
        summary(duffing(100, oscillators=["y1", "x2"]))


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(RecordError, match="taken cannot be written: File exists; name another folder"):
        report(series(3, 1), tmp_path / "taken")


def test_masking_error_stated_by_the_run_stands_in_for_missing_columns():
    columns = {name: column for name, column in duffing(200).columns.items() if not name.startswith("ideal.")}
    found = Study(Recording(columns, {"masking_error": {"x1": 0.25, "x2": "inf"}}))
    assert found.chi == {"x1": 0.25, "x2": float("inf")}
    assert found.worst == "x2"


def test_limits_are_drawn_where_they_are_near():
    plate = run_figures.figures(Study(duffing(2000)))[3]
    near, far = plate.figure.axes
    levels = sorted(line.get_ydata()[0] for line in near.lines if line.get_color() == run_figures.LIMIT)
    assert levels == [-0.42, 0.42]
    assert not [line for line in far.lines if line.get_color() == run_figures.LIMIT]
    assert far.get_title(loc="right") == "peak 1.2 % of 0.42 V"
    assert "The limits of u2 lie far outside the axes." in plate.caption


def test_time_is_that_of_the_virtual_system():
    axes = run_figures.figures(Study(duffing(2000)))[0].figure.axes
    assert axes[1].get_xlabel() == "virtual time τ"
    assert axes[0].get_xlim() == pytest.approx((0.0, 2500.0))
    assert run_figures.figures(Study(series(50, 1)))[0].figure.axes[0].get_xlabel() == "time t"


def test_drawing_leaves_matplotlib_as_it_was(tmp_path):
    before = dict(mpl.rcParams)
    report(duffing(500), tmp_path)
    assert dict(mpl.rcParams) == before


def test_the_summary_loads_no_drawing_and_the_report_no_pyplot(tmp_path):
    code = (
        "import sys, numpy as np\n"
        "from masking.lab.records.recording import Recording\n"
        "from masking.reports.run_report import report, summary\n"
        "t = np.arange(50.0)\n"
        "recording = Recording({'t': t, 'virtual.x': np.sin(t), 'input.u': t}, {'limits': {'u': {'max': 99}}})\n"
        "summary(recording)\n"
        "assert not {'matplotlib', 'scipy', 'pyarrow'} & set(sys.modules)\n"
        f"report(recording, {str(tmp_path)!r})\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[2])


@given(st.integers(1, 4000), st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_fewer_points_keep_ends_and_extremes(samples, bins, seed):
    tau, values = np.arange(float(samples)), np.random.default_rng(seed).standard_normal(samples)
    thin_tau, thin_values = style.thin(tau, values, bins)
    assert thin_values.min() == values.min()
    assert thin_values.max() == values.max()
    assert (thin_tau[0], thin_tau[-1]) == (tau[0], tau[-1])
    assert np.all(np.diff(thin_tau) > 0)
    assert len(thin_tau) <= max(4 * bins, 3 * bins + 2)
    middle, low, high = style.envelope(tau, values, bins)
    assert len(middle) <= bins
    assert (low.min(), high.max()) == (values.min(), values.max())
    assert np.all(low <= high)


@pytest.mark.parametrize(
    ("name", "typeset"),
    [("x1", "$x_{1}$"), ("theta2", r"$\theta_{2}$"), ("u", "$u$"), ("th1", r"$\mathit{th}_{1}$"), ("a$b", "a$b")],
)
def test_symbols(name, typeset):
    assert style.symbol(name) == typeset


def test_percentages():
    assert [percent(part) for part in (0.5, 0.0123, 1.234, 0.0)] == ["50 %", "1.2 %", "123 %", "0 %"]


def test_a_homing_that_falls_short_is_told():
    reached = {"wanted": {"x1": -0.6, "x2": -0.5, "x3": 0.0}, "reached": {"x1": -0.3, "x2": -0.499, "x3": 0.001}}
    said = (
        "Homing did not reach the initial state: x1 = -0.3 instead of -0.6; give it more time "
        "(controller.homing), or begin with less (initial)."
    )
    assert warnings(duffing(2000, start=reached)) == [said]
    reached["reached"]["x1"] = -0.599
    assert warnings(duffing(2000, start=reached)) == []


def test_a_regulated_motion_is_not_blamed_for_what_it_holds():
    regulate = {"energy": 0.02, "phase": "anti"}
    recording = duffing(2000, 0.5, declarations={"experiment": {"controller": {"regulate": regulate}}})
    lines = summary(recording).splitlines()
    assert lines[0] == (
        "The ideal rig moved as coupled Duffing oscillators regulated to an energy of 0.02 and anti-phase motion, over "
        "2500 units of time."
    )
    assert any(line.endswith("against the system without regulation") for line in lines)


def test_a_run_on_a_plant_tells_how_it_kept_its_time():
    told = {"end": "finished", "counters": {"late": 3, "missed": 5, "clamped": 0}}
    lines = summary(duffing(2000, rig=told, states="estimated", mode="real time", rate=1000.0)).splitlines()
    assert "  rig        finished, 3 samples late, 5 samples missed; its motion is estimated" in lines
    assert not any("seed" in line for line in lines)
    lines = summary(duffing(2000, rig={"end": "finished", "counters": {}}, states="estimated")).splitlines()
    assert "  rig        finished, every sample in time; its motion is estimated" in lines
