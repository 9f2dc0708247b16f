"""The report: page, figures and summary of recordings given in closed form."""

import base64
import html.parser
import re
import subprocess
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from masking import figures
from masking.errors import RecordError
from masking.recording import Recording
from masking.reporting import report, summary
from masking.study import percent, study

FIGURES = ["displacements", "others", "synchronisation", "inputs", "fidelity"]


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
        "The ideal rig moved as coupled Duffing oscillators: fidelity χ ≤ 3 · 10\N{MINUS SIGN}9 in each coordinate"
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
    fit = re.fullmatch(r"  anti-phase alpha = (\S+), eps = (\S+) over the last fifth", lines.pop(3))
    assert float(fit[1]) == pytest.approx(1.0, abs=5e-3)
    # alpha takes up the part of the sum that is there all along, about half of it.
    assert 0.3 < float(fit[2]) / (1.1 * np.exp(-2000 / 300)) < 1.0
    assert lines == [
        "The ideal rig moved as coupled Duffing oscillators: "
        "fidelity chi <= 3e-9 in each coordinate over 2500 units of time.",
        "x1 and x2 went from in-phase (0.000 pi) to anti-phase (1.000 pi).",
        "  fidelity   x1 3e-9  x2 3e-9  x3 3e-9",
        "  inputs     u1 50 % of 0.42 V  u2 1.2 % of 0.42 V",
        "  energy     drift of the virtual system 2e-11",
        "  record     20000 samples, 139 s of the rig, sampled at 1000 Hz, seed 7",
        "  time       compile 0.2 s  run 1.5 s",
    ]


@pytest.mark.parametrize(
    ("error", "verb"), [(1e-3, "moved as"), (0.1, "moved roughly as"), (0.5, "did not move as"), (0.0, "moved as")]
)
def test_the_verb_follows_the_fidelity(error, verb):
    sentence = summary(duffing(2000, error)).splitlines()[0]
    assert sentence.startswith(f"The ideal rig {verb} coupled Duffing oscillators: fidelity chi ")


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
    assert 1 <= len(result.summary.splitlines()) <= 12


def test_equal_motions_are_said_to_be_equal(tmp_path):
    result = report(series(500, 2, oscillators=TWO), tmp_path)
    assert "virtual and ideal are equal in every digit recorded" in page_of(result).text
    assert "th1 and th2 stayed in anti-phase (from 1.000 pi to 1.000 pi)." in result.summary


def test_an_oscillator_that_was_not_recorded():
    with pytest.raises(RecordError, match=r"no column 'virtual\.y1'; did you mean 'virtual\.x1'"):
        summary(duffing(100, oscillators=["y1", "x2"]))


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(RecordError, match="taken: the report cannot be written: File exists"):
        report(series(3, 1), tmp_path / "taken")


def test_fidelity_stated_by_the_run_stands_in_for_missing_columns():
    columns = {name: column for name, column in duffing(200).columns.items() if not name.startswith("ideal.")}
    found = study(Recording(columns, {"fidelity": {"x1": 0.25, "x2": "inf"}}))
    assert found.chi == {"x1": 0.25, "x2": float("inf")}
    assert found.worst == "x2"


def test_limits_are_drawn_where_they_are_near():
    plate = figures.plates(study(duffing(2000)))[3]
    near, far = plate.figure.axes
    levels = sorted(line.get_ydata()[0] for line in near.lines if line.get_color() == figures.LIMIT)
    assert levels == [-0.42, 0.42]
    assert not [line for line in far.lines if line.get_color() == figures.LIMIT]
    assert far.get_title(loc="right") == "peak 1.2 % of 0.42 V"
    assert "The limits of u2 lie far outside the axes." in plate.caption


def test_time_is_that_of_the_virtual_system():
    axes = figures.plates(study(duffing(2000)))[0].figure.axes
    assert axes[1].get_xlabel() == "virtual time τ"
    assert axes[0].get_xlim() == pytest.approx((0.0, 2500.0))
    assert figures.plates(study(series(50, 1)))[0].figure.axes[0].get_xlabel() == "time t"


def test_drawing_leaves_matplotlib_as_it_was(tmp_path):
    before = dict(mpl.rcParams)
    report(duffing(500), tmp_path)
    assert dict(mpl.rcParams) == before


def test_the_summary_loads_no_drawing_and_the_report_no_pyplot(tmp_path):
    code = (
        "import sys, numpy as np\n"
        "from masking.recording import Recording\n"
        "from masking.reporting import report, summary\n"
        "t = np.arange(50.0)\n"
        "recording = Recording({'t': t, 'virtual.x': np.sin(t), 'input.u': t}, {'limits': {'u': {'max': 99}}})\n"
        "summary(recording)\n"
        "assert not {'matplotlib', 'scipy', 'pyarrow'} & set(sys.modules)\n"
        f"report(recording, {str(tmp_path)!r})\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[1])


@given(st.integers(1, 4000), st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_fewer_points_keep_ends_and_extremes(samples, bins, seed):
    tau, values = np.arange(float(samples)), np.random.default_rng(seed).standard_normal(samples)
    thin_tau, thin_values = figures.thin(tau, values, bins)
    assert thin_values.min() == values.min()
    assert thin_values.max() == values.max()
    assert (thin_tau[0], thin_tau[-1]) == (tau[0], tau[-1])
    assert np.all(np.diff(thin_tau) > 0)
    assert len(thin_tau) <= max(4 * bins, 3 * bins + 2)
    middle, low, high = figures.envelope(tau, values, bins)
    assert len(middle) <= bins
    assert (low.min(), high.max()) == (values.min(), values.max())
    assert np.all(low <= high)


@pytest.mark.parametrize(
    ("name", "typeset"),
    [("x1", "$x_{1}$"), ("theta2", r"$\theta_{2}$"), ("u", "$u$"), ("th1", r"$\mathit{th}_{1}$"), ("a$b", r"a\$b")],
)
def test_symbols(name, typeset):
    assert figures.symbol(name) == typeset


def test_percentages():
    assert [percent(part) for part in (0.5, 0.0123, 1.234, 0.0, None)] == ["50 %", "1.2 %", "120 %", "0 %", ""]
