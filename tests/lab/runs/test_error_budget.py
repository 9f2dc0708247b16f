"""What limits the masking error of a run on a twin, and what its limits do to it."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import masking
from masking.analysis.masking_error import masking_error
from masking.errors import IntegrationError, ModelError
from masking.lab.records.recording import Recording
from masking.lab.runs import error_budget as budgets
from masking.lab.runs.error_budget import ALL, NOTHING, SAMPLING, Budget, Row, budget, predict
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.remedies import Remedy
from masking.lab.runs.simulated_run import run_twin
from masking.model.effects import EFFECTS, FAMILIES
from masking.reports.run_report import summary, warnings

PLANTS = Path(__file__).parents[3] / "plants"
ON = "effects: {friction1: true, friction2: true, friction3: true}"
TEXT = """\
name: duffing on a twin
plant: {plant}
virtual: duffing
controller: {controller}
initial: {{x1: -0.6, x2: -0.5}}
duration: {duration}
{more}
"""


def written(tmp_path, plant="linear_rig", controller="{rate: 1 kHz}", duration=60, more=ON) -> Path:
    path = tmp_path / "experiment.yaml"
    path.write_text(TEXT.format(plant=plant, controller=controller, duration=duration, more=more))
    return path


def rig(tmp_path, *changes: tuple[str, str]) -> str:
    text = (PLANTS / "linear_rig.yaml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    return path.name


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> tuple[Experiment, Budget, list[float]]:
    experiment = Experiment.load(written(tmp_path_factory.mktemp("budget")))
    parts: list[float] = []
    return experiment, budget(experiment, parts.append), parts


def test_every_effect_belongs_to_a_cause_and_every_cause_has_effects():
    assert {effect.family for effect in EFFECTS.values()} == {*FAMILIES}
    assert len(set(FAMILIES)) == len(FAMILIES)


def test_only_what_is_switched_on_is_a_cause(found):
    _, made, _ = found
    assert {row.cause: row.effects for row in made.rows} == {
        "friction": ("friction1", "friction2", "friction3"),
        "saturation": ("limits",),
        "noise": ("noise",),
        "delay": ("delay",),
        SAMPLING: (),
    }
    assert (made.whole.cause, made.without_all.cause) == (NOTHING, ALL)
    assert set(made.without_all.effects) == {"friction1", "friction2", "friction3", "limits", "noise", "delay"}


def test_the_run_as_it_is_and_without_a_cause_are_those_of_the_experiment(found, tmp_path):
    experiment, made, _ = found
    assert made.whole.chi == experiment.run().manifest["masking_error"]
    without = Experiment.load(written(tmp_path, more="")).run()
    (row,) = (row for row in made.rows if row.cause == "friction")
    assert row.chi == without.manifest["masking_error"]


def test_what_remains_without_all_is_the_method_itself(found):
    _, made, _ = found
    assert made.without_all.worst < 1e-5
    assert made.whole.worst > 1e-3


def test_the_progress_never_goes_back_and_ends_at_one(found):
    _, _, parts = found
    assert parts == sorted(parts)
    assert parts[-1] == 1.0


def test_faster_sampling_keeps_the_delay_in_seconds_and_the_observer(found):
    experiment, _, _ = found
    bench = budgets._Bench(experiment)
    slow, fast = bench.loop(frozenset()), bench.loop(frozenset({SAMPLING}))
    assert (fast.sampled.rate, fast.twin.delay, fast.sampled.delay) == (10 * slow.sampled.rate, 10, 10)
    assert slow.twin.delay == 1
    assert fast.sampled.observer == slow.sampled.observer
    quiet = bench.loop(frozenset({"noise"}))
    assert np.array_equal(quiet.sampled.gain, slow.sampled.gain)


def test_what_the_controller_knows_is_told(tmp_path):
    # The rig has 5 % more damping than its model, which a controller with 5 % more knows.
    declared = masking.load_model("setup")
    more = ", ".join(f"z{i}: {1.05 * declared.value(f'z{i}'):.17g}" for i in (1, 2, 3))
    effects = "effects: {damping1: true, damping2: true, damping3: true, friction1: true}"
    path = written(tmp_path, controller=f"{{rate: 1 kHz, parameters: {{{more}}}}}", more=effects)
    made = budget(Experiment.load(path))
    rows = {row.cause: row for row in made.rows}
    assert "knows" in rows["damping"].note
    assert not rows["friction"].note
    assert rows["damping"].rms > made.whole.rms
    assert "damping1" not in made.without_all.effects
    assert made.without_all.worst < 1e-5


def test_a_run_that_stops_counts_as_infinitely_wrong(found, monkeypatch):
    experiment, _, _ = found
    good = budgets.run_twin

    def stops(loop, *args, **settings):
        if not loop.twin.noise():
            raise IntegrationError("grew without bound")
        return good(loop, *args, **settings)

    monkeypatch.setattr(budgets, "run_twin", stops)
    made = budget(experiment)
    row = next(row for row in made.rows if row.cause == "noise")
    assert set(row.chi.values()) == {math.inf}
    assert row.note == "grew without bound"
    manifest = {"budget": made.as_dict()}
    assert summary(Recording({"t": [0.0, 1.0], "virtual.x1": [0.0, 1.0]}, manifest))


def row(cause: str, chi: float) -> Row:
    return Row(cause, (), {"x": chi})


@pytest.mark.parametrize(
    ("rows", "rest", "said"),
    [
        ([row("friction", 0.012), row("noise", 0.03)], 1e-6, "Remedy first: friction (chi 0.031 -> 0.012 without)."),
        ([row("friction", 0.03), row(SAMPLING, 0.002)], 1e-6,
         "Remedy first: sampling (chi 0.031 -> 0.002 sampled at 10 kHz)."),
        ([row("friction", 0.03), row("noise", math.inf)], 1e-6,
         "No single cause limits the masking error; all together do (chi 0.031 -> 1e-06 without any of them)."),
        ([row("friction", 0.03)], 0.03,
         "Nothing that can be switched off limits the masking error (chi 0.031, and 0.03 without any of it)."),
    ],
)  # fmt: skip
def test_the_sentence(rows, rest, said):
    assert Budget(row(NOTHING, 0.031), tuple(rows), row(ALL, rest), 1000.0).sentence == said


def test_a_change_that_is_refused_or_with_which_the_run_stops_as_well_is_no_remedy(found, monkeypatch):
    experiment, bench = found[0], budgets._Bench(found[0])  # a run that stops by itself takes seconds

    def refused():
        raise ModelError("the model has that already")

    for made in (refused, lambda: replace(experiment)):
        monkeypatch.setattr(budgets, "remedies", lambda *_, made=made: [Remedy("a change", made)])
        with monkeypatch.context() as patch:
            patch.setattr(budgets._Bench, "run", stopped)
            whole = bench.row(NOTHING, frozenset(), (), "", lambda _: None)[0]
            assert whole.rms == math.inf
            found_row = bench.remedied(whole, whole, False, {})
        assert found_row.remedied is None
        assert found_row.remedy == ""


def stopped(*_):
    raise IntegrationError("the step became too small")


def test_a_run_tells_its_budget_unless_it_is_not_wanted(tmp_path):
    path = written(tmp_path, duration=20)
    recording = masking.run(path, out=tmp_path / "out")
    told = Recording.load(tmp_path / "out").manifest["budget"]
    assert told == json.loads(json.dumps(recording.manifest["budget"]))
    assert told["sentence"] in summary(recording)
    assert (tmp_path / "out" / "budget.png").is_file()
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "<h2>What limits the masking error</h2>" in page
    assert "<td>without friction</td>" in page
    assert "budget" not in masking.run(path, budget=False).manifest
    assert masking.run(path, budget=True).manifest["budget"]["rows"] == told["rows"]


def test_there_is_no_budget_of_a_controller_that_knows_the_state(tmp_path):
    path = written(tmp_path, plant="ideal", controller="{rate: continuous}", more="", duration=5)
    assert "budget" not in masking.run(path).manifest
    with pytest.raises(ModelError, match="there is no budget of a controller that knows the true state"):
        masking.run(path, budget=True)


# ---- limits


def test_after_saturation_nothing_is_wound_up(tmp_path):
    weak = rig(tmp_path, ("max: 0.42", "max: 0.02"))
    path = written(tmp_path, plant=weak, more="", duration=200)
    experiment = Experiment.load(path)
    recording = experiment.run()
    demanded, applied = recording.array("demanded"), recording.array("input")
    assert np.abs(applied).max() <= 0.02
    cut = np.flatnonzero(np.any(demanded != applied, axis=1))
    assert 0 < len(cut) < cut[-1] < len(recording) // 2
    # From soon after on, the rig moves as the virtual system does from where it then is.
    first = cut[-1] + 200
    names = recording.coordinates
    initial = dict(zip(names, recording.array("virtual")[first], strict=True))
    initial |= {f"{n}'": v for n, v in zip(names, recording.array("virtual", 1)[first], strict=True)}
    tau = recording.t[first : first + 3000] / experiment.time_scale
    ideal = masking.load_model("duffing").simulate(tau - tau[0], initial)
    for name in names:
        assert masking_error(recording[f"virtual.{name}"][first : first + 3000], ideal[name]) < 0.01
    other, said = warnings(recording)
    assert other.startswith("The masking error is above 1 (")
    assert said.startswith("V1 was at its limit for ")
    assert " of the run: demanded up to " in said
    assert said.endswith(" of 0.02 V; the rig could not follow there.")


def test_the_mean_power_stays_within_its_limit(tmp_path):
    heat = "effects:\n  heat: {effect: thermal, at: [V1, V2, V3], parameters: {r: 45.35, tau: 0.5, limit: 1e6}}\n"
    power = ("value: 8, unit: W, heating: {value: 45.35, unit: W/V**2}", "value: 0.01, unit: W, time: 0.5, "
             "heating: {value: 45.35, unit: W/V**2}")  # fmt: skip
    hot = rig(tmp_path, ("max: 0.42", "max: 4.2"), power, ("effects:\n", heat))
    experiment = Experiment.load(written(tmp_path, plant=hot, more="", duration=60))
    recording = experiment.run()
    powers = recording.array("power")
    assert 0.0099 < powers.max() <= 0.01 * (1 + 1e-12)
    assert "held back by its mean power of 0.01 W for " in warnings(recording)[0]
    run = run_twin(experiment.sampled_loop, experiment.sampled.end, duration=float(recording.t[-1]), seed=0)
    names = experiment.twin.state_names
    true = run.states[:, [names.index(f"heat_V{i}_P") for i in (1, 2, 3)]]
    assert 0.0099 < true.max() <= 0.01 * (1 + 1e-9)


def test_the_predicted_delay_is_the_largest_that_a_run_bears():
    """Runs of experiments that declare the delay fall on both sides of the bound."""
    experiment = masking.Experiment.load("cart_van_der_pol")
    found = predict(experiment)
    assert found.delay == 2
    assert found.most is not None

    def chi(samples):
        made = experiment.changed(effects={"delay": {"parameters": {"samples": samples}}})
        return made.run().manifest["masking_error"]

    assert found.chi == pytest.approx(chi(2), rel=1e-9)
    assert max(chi(found.most).values()) <= 0.1 < max(chi(found.most + 1).values())
    assert f"it stays below 0.1 up to a delay of {found.most} samples, and the plant has 2" in str(found)
