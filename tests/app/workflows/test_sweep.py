"""Sweeps: rows that depend on their number alone, that survive any end, and that closed forms confirm."""

import contextlib
import json
import shutil
import subprocess
import sys
from concurrent.futures import Future
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy import integrate, stats

from masking import load_sweep, sweep
from masking.app import cli
from masking.app.workflows import sweep_work
from masking.errors import DeclarationError, RecordError
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.sweep_values import Design
from masking.reports.sweep_page import figures
from masking.reports.text import share
from tests.benchmarks.killed_sweeps import RUNS, compared, killed

BEAM = {"mu1": 0.0, "mu2": 0.0}  # of Huygens' clocks: the beam alone is a linear oscillator


def decay(recording):
    """Return the damping ratio of the beam by the decay of its maxima over two periods."""
    x = recording["virtual.x"]
    at = np.flatnonzero((x[1:-1] > x[:-2]) & (x[1:-1] >= x[2:])) + 1
    before, here, after = x[at - 1], x[at], x[at + 1]
    peaks = here - 0.125 * (after - before) ** 2 / (after - 2.0 * here + before)
    fall = np.log(peaks[0] / peaks[2]) / 2.0
    return fall / np.hypot(2.0 * np.pi, fall)


def failing(recording):
    """Raise for half of the runs."""
    if recording["virtual.th1"][0] > 0.0:
        raise ValueError("it begins on the right")
    return recording["virtual.th1"][-1]


def equal(one, other):
    assert list(one.columns) == list(other.columns)
    for name, column in one.columns.items():
        if isinstance(column, np.ndarray):
            assert column.tobytes() == other[name].tobytes(), name
        else:
            assert all(np.array_equal(a, b) for a, b in zip(column, other[name], strict=True)), name


def test_damping_comes_out_as_it_went_in(tmp_path):
    """Of a linear oscillator the logarithmic decrement is 2 pi z/sqrt(1 - z^2)."""
    z = np.linspace(0.02, 0.3, 8)
    given = {"over": {"z": z}, "changes": BEAM, "duration": 20, "virtual": True, "workers": 1}
    found = sweep("huygens", measure=[decay], out=tmp_path / "a", **{**given, "over": {"z": z, "x": [1.0]}})
    assert np.abs(found["decay"] / z - 1.0).max() < 2e-4  # maxima between samples
    assert found["run"].tolist() == [*range(8)]
    table = pq.read_table(tmp_path / "a" / "rows")  # one data set for whatever reads parquet
    assert table.num_rows == 8
    assert sorted(table.column("z").to_pylist()) == sorted(z)
    assert (tmp_path / "a" / "sweep.html").is_file()


def test_rows_are_bit_equal_for_any_number_of_processes_and_parts(tmp_path):
    given = {
        "over": {"mu1,mu2": "uniform:0.05:0.2", "th2": "normal:-0.5:0.2"}, "runs": 6, "seed": 3, "duration": 30,
        "measure": ["chi", "end", "maxima.th1"], "sampling": "sobol",
    }  # fmt: skip
    alone = sweep("huygens", **given, workers=1, out=tmp_path / "alone")
    equal(alone, sweep("huygens", **given, workers=2, out=tmp_path / "two"))
    for k in (1, 2):
        sweep("huygens", **given, workers=1, part=(k, 2), out=tmp_path / f"part{k}")
    shutil.copytree(tmp_path / "part1", tmp_path / "whole")
    shutil.copytree(tmp_path / "part2" / "rows", tmp_path / "whole" / "rows", dirs_exist_ok=True)
    written = {file: file.stat().st_mtime_ns for file in (tmp_path / "whole" / "rows").iterdir()}
    equal(alone, sweep("huygens", **given, workers=1, out=tmp_path / "whole"))
    assert written == {file: file.stat().st_mtime_ns for file in (tmp_path / "whole" / "rows").iterdir()}
    assert alone["chi"].max() < 1e-6
    assert load_sweep(tmp_path / "part2").sentence.startswith("The rig as Huygens' pendulum clocks: 3 of 6 runs over")
    with pytest.raises(RecordError, match="holds another sweep: what varies"):
        sweep("huygens", **{**given, "seed": 4}, workers=1, out=tmp_path / "alone")
    alone_virtual = sweep(
        "huygens", **{**given, "measure": ["maxima.th1"]}, virtual=True, out=tmp_path / "v", workers=1
    )
    for one, other in zip(alone["maxima.th1"], alone_virtual["maxima.th1"], strict=True):
        assert np.allclose(one, other, atol=1e-6)  # a rig that is masked moves as the virtual system by itself


def test_a_sweep_that_is_killed_goes_on_without_repeating_or_losing_a_run(tmp_path):
    given = {**RUNS, "over": {"z": "0.1:0.3:20", "th2": "-0.7:0.7:15"}, "duration": 40.0}
    assert killed(tmp_path / "killed", given, workers=(2, 1))
    assert compared(tmp_path / "killed", given, tmp_path / "undisturbed") == 300


def test_a_run_that_fails_is_a_row_with_a_reason(tmp_path):
    given = {"duration": 20, "workers": 1}
    found = sweep("huygens", over={"mu1": [0.1, 0.25, 1.5]}, **given, out=tmp_path / "a", measure=["chi"])
    assert [bool(text) for text in found["error"]] == [False, False, True]
    assert "mu1" in found["error"][2]
    assert np.isnan(found["chi"][2])
    assert np.isfinite(found["chi"][:2]).all()
    assert "3 runs over mu1, 1 failed" in found.sentence
    over = {"mu1": [0.1, 1.5, 0.25, -0.1], "th2'": [0.0, 0.1]}
    found = sweep("huygens", over=over, virtual=True, **given, out=tmp_path / "v", measure=["period"])
    assert [text.partition("mu1 = ")[2] for text in found["error"]] == [
        "", "", *["1.5 is above its upper bound 1"] * 2, "", "", *["-0.1 is below its lower bound 0"] * 2,
    ]  # fmt: skip
    assert np.isfinite(found["period"]).tolist() == [not text for text in found["error"]]
    found = sweep("huygens", over={"th1": [-0.5, 0.5]}, virtual=True, **given, out=tmp_path / "b", measure=[failing])
    assert found["error"] == ["", "ValueError: it begins on the right"]
    assert "it begins on the right" in (tmp_path / "b" / "sweep.html").read_text()


def test_runs_of_which_nothing_varies_begin_where_the_model_declares(tmp_path):
    def first(recording):
        return float(recording["virtual.x"][0])

    (tmp_path / "pulled.yaml").write_text(
        "name: a spring\ncoordinates: {x: {meaning: displacement, initial: 0.3}}\nequations: {\"x''\": -x}\n"
    )
    (tmp_path / "pulled_cart.yaml").write_text(
        "name: a spring\nplant: cart\nvirtual: pulled.yaml\ntransform: {matrix: [[1]]}\n"
        "controller: {rate: continuous}\nduration: 10\n"
    )
    found = sweep(tmp_path / "pulled_cart.yaml", runs=2, virtual=True, measure=[first], workers=1, out=tmp_path / "a")
    assert found["first"].tolist() == [0.3, 0.3]


def test_imperfections_of_a_plant_are_drawn_about_their_declared_values(tmp_path):
    short = Experiment.load("huygens_rig").changed(duration=3)
    over = {"friction1.fc": "x:normal:1:0.2", "plant.w1": "x:uniform:0.99:1.01"}
    found = sweep(short, over=over, runs=3, measure=["chi", "used"], workers=1, out=tmp_path / "a")
    assert found["error"] == [""] * 3
    assert len(np.unique(found["chi"])) == 3
    assert len(np.unique(found["seed"])) == 3  # of the noise
    still = sweep(short, over={"friction1.fc": "x:1,1"}, measure=["chi"], workers=1, out=tmp_path / "b")
    assert still["chi"][0] == still["chi"][1] == max(short.run().manifest["masking_error"].values())


def test_draws_follow_their_distributions_and_a_fit(tmp_path):
    cov = np.array([[4.0, 1.2], [1.2, 1.0]])
    content = {"parameters": {"a": {"value": 10.0}, "b": {"value": -3.0}}, "covariance": cov.tolist()}
    (tmp_path / "fit.json").write_text(json.dumps(content))
    for sampling in ("random", "latin", "sobol"):
        over = {"k": "normal:2:0.5", "plant": f"fit:{tmp_path / 'fit.json'}", "m": "loguniform:0.1:10"}
        points = Design.of(over, 4000, 1, sampling).points
        assert points.shape == (4000, 4)
        assert stats.kstest(points[:, 0], stats.norm(2.0, 0.5).cdf).pvalue > 1e-3
        assert stats.kstest(np.log10(points[:, 3]), stats.uniform(-1.0, 2.0).cdf).pvalue > 1e-3
        assert np.abs(np.cov(points[:, 1:3].T) - cov).max() < 0.3
        assert np.abs(points[:, 1:3].mean(axis=0) - [10.0, -3.0]).max() < 0.15
    grid = Design.of({"a": "1:2:3", "b": "1:100:3:log", "c": [5.0]}, None, 0, "random").points
    assert grid[:, 0].tolist() == [1.0] * 3 + [1.5] * 3 + [2.0] * 3
    assert np.allclose(grid[:3, 1], [1.0, 10.0, 100.0])


def test_a_branch_is_followed_up_and_down(tmp_path):
    """Duffing's equation under a force folds: up and down differ between the folds, and nowhere else."""
    path = tmp_path / "folded.yaml"
    path.write_text(
        "name: a spring that hardens\ncoordinates: {x: {meaning: displacement, initial: 0}}\n"
        "parameters: {f: {value: 0.2, meaning: force}}\n"
        "equations: {\"x''\": -0.1*x' - x - x**3 + f*cos(1.5*t)}\n"
    )
    experiment = tmp_path / "folded_cart.yaml"
    experiment.write_text(
        "name: a fold\nplant: cart\nvirtual: folded.yaml\ntransform: {matrix: [[1]]}\n"
        "controller: {rate: continuous}\nduration: 125.66370614359172\n"  # 30 periods of the force
    )
    given = {"over": {"f": "0.1:1.0:10"}, "virtual": True, "continuation": True, "workers": 1}
    found = sweep(experiment, **given, measure=["maxima.x"], out=tmp_path / "a")
    assert found["way"] == ["up"] * 10 + ["down"] * 10
    largest = np.array([row.max() for row in found["maxima.x"]])
    up, down = largest[:10], largest[10:][::-1]
    # Harmonic balance: ((1 - 1.5^2 + 0.75 a^2)^2 + 0.15^2) a^2 = f^2 has three roots between the folds, else one.
    split = np.abs(up - down) > 0.1
    assert split.any()
    assert not split[[0, -1]].all()
    for f, a in zip(found["f"][:10], up, strict=True):
        roots = np.roots([0.5625, 1.5 * (1.0 - 2.25), (1.0 - 2.25) ** 2 + 0.0225, -(f**2)])
        amplitudes = np.sqrt(roots[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0)].real)
        assert np.abs(amplitudes / a - 1.0).min() < 0.1


def test_the_way_down_begins_where_the_way_up_ended(tmp_path):
    """The frequency of a force is swept up and down: one path, as scipy follows it, that stays on the upper branch.

    From rest, the oscillator ends on the lower branch at the frequency at which the path turns.
    """
    (tmp_path / "swept.yaml").write_text(
        "name: a swept sine\ncoordinates: {x: {meaning: displacement, initial: 0}}\n"
        "states: {phase: {meaning: phase of the force, initial: 0}}\n"
        "parameters: {w: {value: 1, meaning: frequency of the force}}\n"
        "equations: {\"x''\": -0.1*x' - x - x**3 + 0.3*cos(phase), \"phase'\": w}\n"
    )
    (tmp_path / "swept_cart.yaml").write_text(
        "name: a swept sine on a cart\nplant: cart\nvirtual: swept.yaml\ntransform: {matrix: [[1]]}\n"
        "controller: {rate: continuous}\nduration: 70\n"
    )

    def last(recording):
        return float(recording["virtual.x"][-1])

    def run(w, start):
        def rate(_, y):
            return [y[1], -0.1 * y[1] - y[0] - y[0] ** 3 + 0.3 * np.cos(y[2]), w]

        times = np.linspace(35.0, 70.0, 3501)
        return integrate.solve_ivp(rate, (0.0, 70.0), start, "DOP853", times, rtol=1e-11, atol=1e-12).y

    given = {"over": {"w": "1.1:1.7:7"}, "virtual": True, "continuation": True, "workers": 1}
    found = sweep(tmp_path / "swept_cart.yaml", **given, measure=["maxima.x", last], out=tmp_path / "a")
    path = np.linspace(1.1, 1.7, 7)
    motions = [run(path[0], np.zeros(3))]
    for w in [*path[1:], *path[::-1]]:
        motions.append(run(w, motions[-1][:, -1]))
    np.testing.assert_allclose(found["w"], [*path, *path[::-1]], rtol=1e-12)
    np.testing.assert_allclose(found["last"], [y[0, -1] for y in motions], atol=1e-5)
    largest = np.array([y[0].max() for y in motions])
    np.testing.assert_allclose([row.max() for row in found["maxima.x"]], largest, rtol=5e-3)
    assert largest[6:8].min() > 5.0 * run(path[-1], np.zeros(3))[0].max()


def test_pictures_name_words_units_and_shares():
    columns = {
        "run": np.arange(6), "m": np.repeat([1.0, 2.0, 3.0], 2), "end": ["rest", "other"] * 2 + ["other"] * 2,
        "tau_s": np.array([3.0, 3.0, 4.0, 4.0, 5.0, 5.0]), "alpha": 1.0 + 1e-7 * np.arange(6),
    }  # fmt: skip
    over = [{"name": "m", "grid": [1.0, 2.0, 3.0], "factor": False, "unit": "kg"}]
    shares, curve, flat = figures(
        {"over": over, "measures": ["end", "tau_s", "alpha"], "units": {"tau_s": "units of time"}}, columns
    )
    axes = shares.figure.axes[0]
    assert axes.get_xlabel() == "$m$ (kg)"
    assert axes.get_xlim() == (0.5, 3.5)
    heights = [max(path.vertices[:, 1]) for path in axes.collections[0].get_paths()]
    assert heights == [0.5]  # at rest, of the first and the second value
    assert curve.figure.axes[0].get_ylabel() == r"$\tau_{s}$ (units of time)"
    low, high = flat.figure.axes[0].get_ylim()
    assert high - low >= 1e-3  # nothing that a reader would take for a change
    table = {"run": np.arange(20000), "m": np.repeat([1.0, 2.0], 10000), "k": np.tile([1.0, 2.0], 10000)}
    table["end"] = ["rest", *["other"] * 19999]
    over += [{"name": "k", "grid": [1.0, 2.0], "factor": False}]
    mapped, *_ = figures({"over": over, "measures": ["end"]}, table)
    assert [text.get_text() for text in mapped.figure.legends[0].get_texts()] == ["rest < 0.01 %", "other > 99.99 %"]
    words, *_ = figures({"over": [], "measures": ["end"]}, columns)
    assert [text.get_text() for text in words.figure.axes[0].get_yticklabels()] == ["rest", "other"]


@pytest.mark.parametrize(
    ("runs", "of", "text"),
    [
        (0, 7, "0 %"), (7, 7, "100 %"), (1, 160_000, "< 0.01 %"), (159_999, 160_000, "> 99.99 %"),
        (1, 10_000, "0.01 %"), (9_999, 10_000, "99.99 %"), (1, 300, "0.33 %"), (1, 30, "3.3 %"), (1, 3, "33 %"),
        (299, 300, "99.67 %"), (1, 200, "0.5 %"), (118_880, 160_000, "74 %"), (24, 25, "96 %"),
    ],
)  # fmt: skip
def test_a_share_is_all_or_none_only_if_it_is(runs, of, text):
    assert share(runs / of) == text


def test_the_command_says_what_happened_and_refuses_what_cannot_be(tmp_path, capsys):
    command = ["sweep", "huygens", "--over", "mu1,mu2=0.1:0.25:3", "--over", "z=0.1,0.2", "--virtual"]
    command += ["--duration", "30", "--measure", "end,period"]
    out = ["--workers", "1", "--out", str(tmp_path / "a")]
    assert cli.main([*command, *out]) == 0
    said = capsys.readouterr().out
    assert "6 runs over mu1,mu2 and z; " in said
    assert {file.name for file in (tmp_path / "a").glob("*.png")} == {"map_end.png", "map_period.png"}
    assert cli.main([*command, *out, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["done"] == 6
    for more, message in (
        (["--over", "zz=1"], "nothing called 'zz' to vary; did you mean 'z'?"),
        (["--over", "z=0.1:0.2"], "'0.1:0.2' cannot be read"),
        (["--over", "z=normal:0.2:0.1"], "say how many runs"),
        (["--over", "z=0.1,0.2", "--measure", "alhpa"], "is no measure of these runs; did you mean 'alpha'?"),
        (["--over", "z=0.1,0.2", "--virtual", "--measure", "chi"], "without a rig; leave --virtual out"),
        (["--over", "z=0.1,0.2", "--continuation"], "give --virtual"),
        (["--over", "z=0.1,0.2", "--part", "3/2"], "there is no part 3/2"),
    ):
        assert cli.main(["sweep", "huygens", *more, "--out", str(tmp_path / "b")]) == 2
        assert message in capsys.readouterr().err
    with pytest.raises(DeclarationError, match="nothing varies"):
        sweep("huygens", out=tmp_path / "b")


def test_rows_that_are_missing_are_found():
    from masking.lab.records.table_chunks import missing

    assert missing([], 0, 5) == [(0, 5)]
    assert missing([(0, 2), (1, 3), (7, 9)], 0, 12) == [(3, 7), (9, 12)]
    assert missing([(0, 20)], 5, 12) == []


def test_chunks_are_of_whole_chains_and_grow_up_to_two_seconds():
    def submit(first, last):
        future = Future()
        future.set_result((first, last, {}, 1e-2 * (last - first)))
        return future

    chunks = [one[:2] for one in sweep_work._chunks(SimpleNamespace(chain=3), [(0, 60), (90, 1200)], submit, 1)]
    assert [row for first, last in chunks for row in range(first, last)] == [*range(60), *range(90, 1200)]
    assert chunks[:3] == [(0, 3), (3, 15), (15, 60)]
    assert max(last - first for first, last in chunks) == 198


def test_rows_of_another_sweep_and_every_changed_byte_of_a_plan_are_refused(tmp_path):
    over = {"w3": np.linspace(0.4, 0.7, 4)}
    for name, values in (("a", over), ("b", {"w3": over["w3"] - 0.2})):
        sweep("duffing", over=values, virtual=True, duration=20, workers=1, out=tmp_path / name)
    for file in (tmp_path / "a" / "rows").iterdir():
        shutil.copy(file, tmp_path / "b" / "rows")
    with pytest.raises(RecordError, match=r"rows-0.*\.parquet has rows of another sweep; remove it"):
        load_sweep(tmp_path / "b")
    plan = tmp_path / "a" / "sweep.json"
    data, whole = plan.read_bytes(), dict(load_sweep(tmp_path / "a").facts)
    for at in range(0, len(data), 7):
        plan.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        with contextlib.suppress(RecordError):  # but for a blank that is no part of what the plan says
            assert dict(load_sweep(tmp_path / "a").facts) == whole


CALL = """
import masking

print("begun")

def least(recording):
    return float(recording["virtual.th1"].min())

if {0}:
    over = {{"mu1": [0.1, 0.2]}}
    found = masking.sweep("huygens", over=over, virtual=True, duration=5, workers=2, measure=[{1}], out="out")
    print(list(found.columns)[2], len(found))
"""
GUARD = '__name__ == "__main__"'
UNGUARDED = "begins a sweep when it is imported"


@pytest.mark.parametrize(
    ("guard", "measure", "is_typed", "said"),
    [
        pytest.param("True", "'end.th1'", False, "begun\nend.th1 2\n", id="a script without functions"),
        pytest.param(GUARD, "least", False, "least 2\n", id="a script with functions"),
        pytest.param("True", "least", False, UNGUARDED, id="a script with functions that calls when it is imported"),
        pytest.param("True", "lambda r: 1.0", False, "cannot import a function of this sweep", id="no name"),
        pytest.param("True", "least", True, "cannot import a function of a notebook or a prompt", id="a prompt"),
    ],
)
def test_a_script_may_call_it_anywhere_but_for_its_own_functions(tmp_path, guard, measure, is_typed, said):
    """The language is the judge: the script runs as its user runs it, and in 'begun' says how often it is imported."""
    script = tmp_path / "script.py"
    script.write_text(CALL.format(guard, measure), encoding="utf-8")
    command = [sys.executable, "-" if is_typed else str(script)]
    given = script.read_text(encoding="utf-8") if is_typed else None
    run = subprocess.run(command, input=given, cwd=tmp_path, capture_output=True, text=True, check=False)
    if said.endswith("2\n"):
        assert (run.returncode, run.stderr) == (0, "")
        assert run.stdout.endswith(said)
    else:
        assert said in run.stderr
        assert run.stderr.strip().endswith("or make the runs in this process, with workers=1")
        assert run.stderr.count("Traceback") == 1
