"""Two runs on one page: what differs in what was declared, and in what came out."""

import copy
import json

import numpy as np
import pytest

import masking
from masking.app.cli import main
from masking.errors import RecordError
from masking.lab.records.recording import Recording
from masking.reports import comparison_page
from masking.reports.comparison_page import Comparison, Measure

MANIFEST = {
    "name": "run",
    "virtual_name": "pair",
    "oscillators": ["x1", "x2"],
    "parameters": {"w": 3.0, "z": 0.1},
    "limits": {"u": {"max": 1.0, "unit": "V"}},
    "declarations": {
        "experiment": {"name": "a", "duration": 100, "controller": {"rate": "continuous"}},
        "virtual": {
            "description": "one",
            "parameters": {"w": {"value": 3.0, "meaning": "m"}, "z": {"value": 0.1}},
            "oscillators": ["x1", "x2"],
        },
    },
}


def recorded(w=3.0, error=0.01, amplitude=1.0):
    """Two oscillators in anti-phase with a ratio of amplitudes of 2, masked with a known relative error."""
    t = np.linspace(0.0, 100.0, 4001)
    ideal = amplitude * np.sin(w * t)
    columns = {"t": t, "virtual.x1": (1.0 + error) * ideal, "virtual.x2": -0.5 * ideal}
    columns |= {"ideal.x1": ideal, "ideal.x2": -0.5 * ideal, "input.u": 0.25 * np.cos(w * t)}
    manifest = copy.deepcopy(MANIFEST)
    manifest["parameters"]["w"] = manifest["declarations"]["virtual"]["parameters"]["w"]["value"] = w
    return Recording(columns, manifest)


@pytest.fixture
def pair(tmp_path):
    recorded().save(tmp_path / "one")
    recorded(w=3.3, error=0.02).save(tmp_path / "two")
    return tmp_path / "one", tmp_path / "two"


def test_parameters_and_declarations_that_differ_are_listed_and_no_others(pair):
    made = masking.compare(*pair)
    assert [(row.name, row.first, row.second) for row in made.parameters] == [("w", 3.0, 3.3)]
    assert [row.name for row in made.declarations] == ["virtual.parameters.w.value"]
    assert made.sentence == "Parameters of the virtual system that differ: w = 3 and 3.3."


def test_points_of_an_input_from_a_file_are_no_parameters():
    runs = recorded(), recorded()
    for value, run in enumerate(runs):
        run.manifest["declarations"]["experiment"]["inputs"] = {"F": {"file": "force.csv", "interpolation": "linear"}}
        run.manifest["parameters"] |= {"F_c0": float(value), "F_c1": 2.0 * value, "F_at": 0.1, "F_gain": 1.0 + value}
    assert [row.name for row in Comparison(*runs, ("a", "b")).parameters] == ["F_gain"]


def test_measures_are_those_of_the_motions(pair):
    """chi is the relative error, alpha the ratio of amplitudes (definition 5.3), and the sines are in anti-phase."""
    measures = {row.name: row for row in masking.compare(*pair).measures}
    assert measures["masking error chi of x1"].first == pytest.approx(0.01, rel=1e-6)
    assert measures["masking error chi of x1"].second == pytest.approx(0.02, rel=1e-6)
    assert measures["masking error chi of x1"].change == pytest.approx(1.0, rel=1e-6)
    assert measures["verdict of x1 and x2"].first == "anti-phase"
    assert measures["alpha of x1 and x2"].first == pytest.approx(2.02, rel=1e-3)
    assert measures["phase of x1 and x2 at the end (pi)"].second == pytest.approx(1.0, abs=1e-3)
    assert measures["peak of u (V)"].first == pytest.approx(0.25)
    assert {"eps of x1 and x2", "tau_s of x1 and x2", "length (units of time)"} & measures.keys()


def test_a_run_beside_itself_is_equal(pair):
    made = masking.compare(pair[0], pair[0])
    assert made.sentence == "No parameter differs. The results are equal."
    assert made.names == (str(pair[0]), str(pair[0]))


def test_other_settings_and_other_systems_are_named():
    first, second = recorded(), recorded(amplitude=2.0)
    second.manifest["declarations"]["experiment"]["controller"]["rate"] = "1000.0 Hz"
    assert Comparison(first, second, ("a", "b")).sentence == "The declarations differ in experiment.controller.rate."
    second.manifest["virtual_name"] = "clocks"
    assert Comparison(first, second, ("a", "b")).sentence == "The virtual systems are pair and clocks."


@pytest.mark.parametrize(
    ("first", "second", "row"),
    [
        (2.0, 1.0, ("m", "2", "1", "\N{MINUS SIGN}50 %")),
        (0.001, 2.5, ("m", "0.001", "2.5", "+249900 %")),
        (None, 1.0, ("m", "\N{EN DASH}", "1", "")),
        ("beating", "death", ("m", "beating", "death", "")),
        (0.0, 1.0, ("m", "0", "1", "")),
    ],
)
def test_a_change_is_given_where_it_makes_sense(first, second, row):
    assert Measure("m", first, second).row == row


def test_runs_without_a_common_coordinate_are_compared_by_their_measures():
    other = Recording({"t": [0.0, 1.0, 2.0], "virtual.y": [0.0, 1.0, 0.0]}, {"name": "other"})
    made = Comparison(recorded(), other, ("a", "b"))
    assert comparison_page.figure(made).caption == "Not shown: the runs have no coordinate in common."
    assert any(row.second is None for row in made.measures)


def test_the_command_writes_a_page_and_numbers(pair, capsys, tmp_path):
    words = ["compare", *map(str, pair), "--out", str(tmp_path / "both")]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "w = 3 and 3.3" in said
    assert said.endswith(f"page: {tmp_path / 'both' / 'comparison.html'}\n")
    page = (tmp_path / "both" / "comparison.html").read_text(encoding="utf-8")
    assert "<h1>Runs one and two</h1>" in page
    assert (tmp_path / "both" / "comparison.png").read_bytes().startswith(b"\x89PNG")
    told = json.loads((tmp_path / "both" / "comparison.json").read_text(encoding="utf-8"))
    assert told["parameters"] == {"w": {"one": 3.0, "two": 3.3}}
    assert main(words) == 2
    assert "holds an earlier result, comparison.html" in capsys.readouterr().err
    assert main([*words, "--overwrite", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["runs"] == ["one", "two"]
    with pytest.raises(RecordError, match="no such recording"):
        masking.compare(pair[0], tmp_path / "three")


def test_recordings_in_memory_are_compared(pair):
    first, second = map(Recording.load, pair)
    assert masking.compare(first, second).measures == masking.compare(*pair).measures
    assert masking.compare(first, second).names == ("first", "second")
