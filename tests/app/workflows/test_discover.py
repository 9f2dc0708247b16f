"""The verb discover: what it says, what it writes, and what it refuses.

Records are made by `tests.benchmarks.hidden`, which shares no code with the models.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import io

import masking
from masking.app.cli import main
from masking.app.workflows import discovery_inputs
from masking.control.rig.twin import Twin
from masking.errors import DeclarationError, ModelError, RecordError
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.simulation import simulate
from masking.lab.records import readers
from masking.lab.records.record_form import RecordForm
from masking.lab.records.recording import Recording
from masking.reports import discovery_figures, discovery_page
from masking.reports.discovery_files import Origin
from tests.benchmarks import hidden

SECONDS = 14.0
NOISE = 1e-3
PLANT = """
name: linear rig
model: setup
sensors:
  s1: {measures: x1 - x3, gain: {value: 200, unit: V/m}, unit: V}
  s2: {measures: x2 - x3, gain: {value: 200, unit: V/m}, unit: V}
  s3: {measures: x3, gain: {value: 200, unit: V/m}, unit: V}
actuators: {V1: {unit: V}, V2: {unit: V}, V3: {unit: V}}
allocation: {u1: V1, u2: V2, u3: V3}
limits: {inputs: {V1: {max: 0.42, unit: V}, V2: {max: 0.42, unit: V}, V3: {max: 0.42, unit: V}}}
"""
KEYS = {"verdict", "closed", "effects", "simulation_error", "model", "next_experiment"}


BASE = hidden.Case("", "", "", {}, None, NOISE, "own", 0.01, 5, "none")
CASES = {
    "friction": replace(BASE, effect="dry_friction", at="spring1", parameters={"fc": 0.0055, "vs": 1e-3}),
    "force": replace(BASE, effect="constant_force", at="spring1", parameters={"f0": -0.0057}),
    "saturation": replace(BASE, effect="saturation", at="V3", parameters={"limit": 0.08}),
    "none": BASE,
    "parameter": replace(BASE, effect="parameter", at="z2", parameters={"relative": 0.08}, family="parameter"),
    "drift": BASE,
}
DRIFT = 0.02  # V/s, of s2; the record that validates begins where it has got to


def table(record, begun=None):
    """Return the columns of a recording; one of the sensors has drifted for a time, s, or does not."""
    columns = {"t": record.t}
    columns |= {f"input.V{i + 1}": x for i, x in enumerate(record.commands.T)}
    columns |= {f"sensor.s{i + 1}": x for i, x in enumerate(record.readings.T)}
    return columns if begun is None else columns | {"sensor.s2": columns["sensor.s2"] + DRIFT * (begun + record.t)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("discovery")
    (out / "plant.yaml").write_text(PLANT)
    made = hidden.generate([*CASES.values()], SECONDS, SECONDS)
    for name, (_, train, valid) in zip(CASES, made, strict=True):
        drifts = (0.0, SECONDS) if name == "drift" else (None, None)
        Recording(table(train, drifts[0]), {"name": name}).save(out / name / "train")
        Recording(table(valid, drifts[1]), {"name": name}).save(out / name / "valid")
    return out


@pytest.fixture(scope="module")
def discovered(folder):
    """Return what is found in a record, and its JSON; each is searched once."""
    known = {}

    def find(name):
        if name not in known:
            out, record = folder / "found" / name, folder / name
            found = masking.discover(
                record / "train", plant=folder / "plant.yaml", validation=record / "valid", out=out
            )
            known[name] = found, json.loads((out / "discovery.json").read_text())
        return known[name]

    return find


def test_friction_is_named_where_it_is(discovered):
    found, told = discovered("friction")
    (effect,) = told["effects"]
    assert (told["verdict"], effect["name"], effect["on"]) == ("named", "dry_friction", "spring1")
    truth = CASES["friction"].parameters["fc"]
    assert effect["parameters"]["fc"]["value"] == pytest.approx(truth, rel=0.02)
    assert (
        found.simulation_error.validation[1]["s1"]
        < 1.1 * found.simulation_error.validation_noise_floor["s1"]
        < found.simulation_error.adjusted["s1"]
    )


def test_nothing_hidden_is_nothing_missing(discovered, folder):
    _, told = discovered("none")
    assert (told["verdict"], told["effects"], told["model"]) == ("none", [], None)
    assert not (folder / "found" / "none" / "models").exists()
    assert "Nothing is missing" in (folder / "found" / "none" / "discovery.html").read_text()


def test_what_no_experiment_tells_apart_is_ambiguous(discovered):
    _, told = discovered("force")
    last = told["effects"][-1]
    names = {(last["name"], last["on"]), *((a["name"], a["on"]) for a in last["alternatives"])}
    assert told["verdict"] == "ambiguous"
    assert {("constant_force", "spring1"), ("sensor_offset", "s1")} <= names
    assert told["next_experiment"]["separates"] is False  # the rig is linear: they are the same


def test_a_wrong_parameter_is_no_effect(discovered, folder):
    _, told = discovered("parameter")
    (effect,) = told["effects"]
    assert (told["verdict"], effect["name"], effect["on"]) == ("parameter", "z2", "")
    value = Twin.load(folder / "found" / "parameter" / "plant.yaml").parameter_value("z2")
    truth = hidden.truth(CASES["parameter"]).rig["z2"]
    assert value == pytest.approx(effect["parameters"]["z2"]["value"]) == pytest.approx(truth, rel=1e-3)


def test_files_load_again_and_close_the_gap(discovered, folder):
    found, told = discovered("friction")
    assert [one.problems for one in masking.check(told["model"], told["plant"])] == [(), ()]
    twin = Twin.load(folder / "found" / "friction" / "plant.yaml")
    made = simulate(twin, found.validation_record)
    for sensor, chi in made.chi.items():
        assert chi == pytest.approx(told["simulation_error"]["validation"]["after"][sensor], rel=1e-3)
        assert chi < 1.1 * found.simulation_error.validation_noise_floor[sensor]
    assert "masking discover" in twin.base.source


@pytest.mark.search
def test_an_effect_of_an_actuator_is_the_plants(discovered):
    _, told = discovered("saturation")
    assert [one.problems for one in masking.check(told["model"], told["plant"])] == [(), ()]
    (effect,) = Twin.load(told["plant"]).effects
    assert (effect.kind, effect.at) == ("saturation", "V3")
    assert effect.parameters["limit"] == pytest.approx(0.08, rel=1e-3)


def test_the_drift_of_a_sensor_goes_on_from_record_to_record(discovered):
    found, told = discovered("drift")
    (effect,) = told["effects"]
    assert (told["verdict"], effect["name"], effect["on"]) == ("named", "sensor_drift", "s2")
    assert effect["parameters"]["rate"]["value"] == pytest.approx(DRIFT, rel=0.01)
    assert found.simulation_error.validation[1]["s2"] < 1.1 * found.simulation_error.validation_noise_floor["s2"]


def test_json_has_fixed_keys(discovered):
    _, told = discovered("friction")
    assert told.keys() >= KEYS
    assert told["effects"][0].keys() == {"name", "on", "parameters", "probability", "alternatives"}
    assert told["simulation_error"].keys() >= {"estimation", "validation", "noise_floor"}
    for part in ("estimation", "validation"):
        assert told["simulation_error"][part].keys() == {"before", "after"}
        assert all(chi.keys() == {"s1", "s2", "s3"} for chi in told["simulation_error"][part].values())
    assert len(told["records"]["record"]["sha256"]) == 64
    latent = told["localisation"]["latent_force"]
    assert latent["coordinates"]["x1"] > 0.95
    assert latent["places"]["spring1"]["energy"]["rate"] > 0.9
    assert {after["white"] for after in (one["after"] for one in told["localisation"]["whiteness"].values())} == {True}


def test_page_says_what_helps(discovered, folder):
    discovered("friction")
    out = folder / "found" / "friction"
    page = (out / "discovery.html").read_text()
    for words in (
        "Dry friction in spring1",
        "of the model error is at spring1",
        "Ljung and Box",
        "Dry friction in spring1 makes",
        "use leaf springs or air bearings",
        "data:image/png;base64",
        "SHA-256",
    ):
        assert words in page
    for name in ("comparison", "gap", "map", "course", "residual", "candidates"):
        assert (out / f"{name}.png").read_bytes()[:4] == b"\x89PNG"
    assert not list(out.parent.glob(".friction*"))


def test_command_line(folder, capsys):
    record = folder / "none"
    parts = [f"{record / 'train'}@:6", "--validate", f"{record / 'valid'}@:6"]
    where = [*parts, "--plant", str(folder / "plant.yaml")]
    assert main(["discover", *where, "--out", str(folder / "cli"), "--json", str(folder / "told.json")]) == 0
    assert "Nothing is missing" in capsys.readouterr().out
    assert json.loads((folder / "told.json").read_text())["verdict"] == "none"
    assert main(["discover", *where, "--parameters", "z9", "--json"]) == 2
    assert "hold no parameter 'z9'" in json.loads(capsys.readouterr().out)["error"]


def test_overwriting_leaves_nothing_of_an_earlier_discovery(discovered, folder, monkeypatch):
    (found, _), (other, _), out = discovered("friction"), discovered("none"), folder / "twice"
    drawn = {id(one): discovery_figures.figures(one) for one in (found, other)}
    monkeypatch.setattr(discovery_figures, "figures", lambda one: drawn[id(one)])
    discovery_page.save(found, out, Origin({}))
    (out / "models" / "mine.yaml").write_text("name: mine")
    masking.report(out, one_page=True)
    discovery_page.save(other, out, Origin({}))
    left = {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()}
    assert left == {*json.loads((out / "discovery.json").read_text())["files"], "models/mine.yaml"}
    assert not (out / "plant.yaml").exists()
    for named in (["models", ".", "../friction/train/manifest.json"], [7], None):  # no list of ours
        (out / "discovery.json").write_text(json.dumps({"files": named}))
        discovery_page.save(other, out, Origin({}))
    assert (out / "models" / "mine.yaml").exists()
    assert (folder / "friction" / "train" / "manifest.json").exists()


@pytest.mark.parametrize("name", ["friction", "none"])
def test_one_page_says_what_the_terminal_says(discovered, folder, name):
    found, told = discovered(name)
    made = masking.report(folder / "found" / name, folder / "sheets" / name, one_page=True)
    summary = discovery_page.summary(found)
    assert str(found) == summary
    assert repr(found).startswith("<Discovery: ")
    assert made.summary == told["sheet"]["title"]
    assert made.path.read_bytes().startswith(b"%PDF-")
    for paragraph in (text for every in told["sheet"]["sections"].values() for text in every):
        assert paragraph.removesuffix(".").lower() in summary.lower()
    assert told["sheet"]["errors"]["as declared"] == told["simulation_error"]["validation"]["before"]
    assert told["sheet"]["errors"]["noise floor"] == told["simulation_error"]["validation_noise_floor"]
    assert ("How sure" in told["sheet"]["sections"]) is (name == "friction")


def test_an_interrupt_leaves_nothing(folder):
    def stop(text, part):
        if part > 0.15:
            raise KeyboardInterrupt

    out = folder / "stopped"
    with pytest.raises(KeyboardInterrupt):
        masking.discover(folder / "none" / "train", plant=folder / "plant.yaml", out=out, tell=stop)
    assert not out.exists()
    assert not list(folder.glob(".stopped*"))


def spoiled(folder, change, name="spoiled.parquet", **settings):
    """Return the refusal of a record whose columns are changed."""
    kept = Recording.load(folder / "none" / "train")
    columns = {n: c.copy() for n, c in kept.columns.items()}
    path = folder / name.replace(".parquet", ".csv")
    columns = change(columns)
    np.savetxt(path, np.column_stack([*columns.values()]), header=",".join(columns), delimiter=",", comments="")
    with pytest.raises((RecordError, DeclarationError)) as refused:
        masking.discover(path, plant=folder / "plant.yaml", **settings)
    return str(refused.value)


def without(name):
    return lambda columns: {n: c for n, c in columns.items() if n != name}


def still(columns):
    rng = np.random.default_rng(1)
    return {n: c if n == "t" else 1e-3 * rng.normal(size=len(c)) * (n[0] == "s") for n, c in columns.items()}


def holes(columns):
    columns["sensor.s2"][7] = np.nan
    return columns


def two_clocks(columns):
    middle = len(columns["t"]) // 2
    columns["t"][middle:] = columns["t"][middle] + 2.0 * (columns["t"][middle:] - columns["t"][middle])
    return columns


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (without("sensor.s2"), "there is no column sensor.s2 or s2"),
        (without("t"), "--dt 0.001"),
        (still, "nothing moves"),
        (holes, "line 9 holds 'nan' in column 'sensor.s2' (t = "),
        (two_clocks, "the rate changes from "),
        (lambda columns: {n: c[:300] for n, c in columns.items()}, "300 samples are too few"),
    ],
    ids=["channel", "clock", "still", "nan", "clocks", "short"],
)
def test_bad_records_are_refused(folder, change, words):
    assert words in spoiled(folder, change)


def test_a_record_does_not_judge_itself(folder, tmp_path):
    record, copy = folder / "none" / "train", tmp_path / "copy.csv"
    columns = Recording.load(record).columns
    np.savetxt(copy, np.column_stack([*columns.values()]), header=",".join(columns), delimiter=",", comments="")
    end = columns["t"][-1]
    cases = {
        (record, record): "it holds the same samples as",
        (record, copy): "it holds the same samples as",
        (record, f"{record}@{end / 2:g}:"): f"its samples from {end / 2:g} s on are also in",
        (
            f"{copy}@{end / 4:g}:",
            f"{copy}@:{end / 2:g}",
        ): f"its samples from {end / 4:g} s to {end / 2:g} s are also in",
        (copy, f"{copy}@:{end / 2:g}"): f"its samples up to {end / 2:g} s are also in",
    }
    for (given, validation), words in cases.items():
        with pytest.raises(RecordError) as refused:
            masking.discover(given, plant=folder / "plant.yaml", validation=validation)
        assert words in str(refused.value)
        assert "leave --validate out, and the last 30 % of the record are held out" in str(refused.value)
    halves = f"{copy}@:{end / 2:g}", f"{copy}@{end / 2:g}:"
    parts = discovery_inputs.read(Twin.load(folder / "plant.yaml"), *halves, RecordForm())
    assert len(parts.record) + len(parts.validation) == len(columns["t"])


def test_a_mass_that_is_0_is_refused_as_it_is_declared(folder, tmp_path):
    path = tmp_path / "mass.yaml"
    path.write_text(
        "name: mass\ncoordinates: {x: {unit: m}}\ninputs: {f: {unit: N}}\nparameters: {m: {value: 0, unit: kg, bounds: "
        "[0, null]}, k: {value: 100, unit: N/m}}\nequations: {\"m*x''\": f - k*x}\n"
    )
    with pytest.raises(ModelError, match=r"singular at the declared values; look for a mass that is 0 \(m = 0\)"):
        masking.discover(folder / "none" / "train", model=path)


def test_bad_settings_are_refused(folder):
    record = folder / "none" / "train"
    with pytest.raises(DeclarationError, match="nothing to hold the record against"):
        masking.discover(record)
    with pytest.raises(DeclarationError, match="hold no parameter 'z9'"):
        masking.discover(record, plant=folder / "plant.yaml", parameters=["z9"])
    with pytest.raises(DeclarationError, match="tolerance is 0"):
        masking.discover(record, plant=folder / "plant.yaml", tolerance=0.0)
    with pytest.raises(RecordError, match=r"--map t=time,u1=V1"):
        readers.mapping("t:time")
    slow = {n: c[::2] for n, c in Recording.load(record).columns.items()}
    Recording(slow).save(folder / "slow")
    with pytest.raises(RecordError, match="two rates"):
        masking.discover(record, plant=folder / "plant.yaml", validation=folder / "slow")


def test_records_of_other_programs(tmp_path):
    t = np.arange(1000) / 100.0
    u, y = np.sin(t), np.cos(t)
    (tmp_path / "a.csv").write_text(
        "time;V1;V2;;\n" + "\n".join(f"{a:.3f};{b:.9f};{c:.9f};;" for a, b, c in zip(t, u, y, strict=True))
    )
    io.savemat(tmp_path / "b.mat", {"V1": u, "V2": y[:, None], "gain": 3.0, "other": np.zeros(7)})
    names = {"u1": "V1", "y1": "V2"}
    first = readers.read(tmp_path / "a.csv", {"t": "time", **names})
    second = readers.read(tmp_path / "b.mat", names, dt=0.01)
    for one in (first, second):
        np.testing.assert_allclose(one.t, t, atol=1e-12)
        np.testing.assert_allclose(one["u1"], u, atol=1e-8)
        np.testing.assert_allclose(one["y1"], y, atol=1e-8)
    with pytest.raises(RecordError, match="name the clock, such as --map t=time"):
        readers.read(tmp_path / "a.csv", names)
    with pytest.raises(RecordError, match=r"there is no column V3; did you mean 'V2'\?|did you mean 'V1'\?"):
        readers.read(tmp_path / "b.mat", {"u1": "V3"}, dt=0.01)


@pytest.mark.parametrize(
    ("given", "sensors"), [({"plant": "cart", "model": None}, ("encoder",)), ({"model": "cart"}, ("x",))]
)
def test_a_name_of_a_model_and_of_a_plant_is_what_it_is_given_as(given, sensors):
    assert discovery_inputs.rig(**given).sensors == sensors


def test_a_model_alone_is_read_by_its_coordinates(tmp_path):
    (tmp_path / "mass.yaml").write_text(
        "name: mass\ncoordinates: {x: {unit: m}}\ninputs: {f: {unit: N}}\nparameters: {m: {value: 1, unit: kg}, "
        "k: {value: 100, unit: N/m}}\nequations: {\"x''\": (f - k*x)/m}\n"
    )
    twin = discovery_inputs.rig(tmp_path / "mass.yaml", None)
    assert (twin.sensors, twin.actuators) == (("x",), ("f",))
    t = np.arange(500) / 100.0
    record = Recording({"t": t, "f": np.sin(9.0 * t), "x": np.sin(3.0 * t)})
    assert Data.of(record, twin).readings.shape == (500, 1)
