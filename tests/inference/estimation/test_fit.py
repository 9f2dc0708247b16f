"""Fits: parameters that were hidden are found, as far off as is said; records that tell nothing are refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal, stats
from scipy.optimize import least_squares

from masking.app import cli
from masking.control.rig.twin import Twin
from masking.errors import ModelError, RecordError
from masking.inference.estimation.fit import fit
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.sensitivity import Sensitivity
from masking.lab.records.recording import Recording
from masking.lab.runs.experiment import Experiment
from masking.model.declaration import registry, schema
from masking.reports.model_files import save_fit as save

RATE = 500.0
ALL = ("w1", "z1", "w2", "z2", "w3", "z3", "c1", "c2", "c3", "mu1", "mu2")


def sines(seconds, seed=0, size=(0.04, 0.04, 0.25), rate=RATE):
    """Return three sums of sines (samples, 3), V, from 0.3 to 6 Hz."""
    generator = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    lines = 2 * np.pi * np.linspace(0.3, 6.0, 20)
    waves = [np.sin(lines * t[:, None] + generator.uniform(0, 7, 20)).sum(axis=1) / np.sqrt(20) for _ in size]
    return np.array(waves).T * size


def recorded(twin, commands, *, noise=1e-3, seed=0, start=None, rate=RATE, name="the record"):
    """Return what a twin reads under commands, with white noise; it begins at rest unless told otherwise."""
    start = twin.rest(np.zeros(3)) if start is None else start
    made = Data(name, rate, commands, np.zeros((len(commands), 3)), twin.delay)
    clean = Sensitivity(twin, ()).simulate(np.empty(0), start, made.acting, rate=rate, substeps=2)
    return replace(made, readings=clean + noise * np.random.default_rng(seed).standard_normal(clean.shape))


@pytest.fixture(scope="module")
def linear():
    return Twin.load("linear_rig")


@pytest.fixture(scope="module")
def far(linear):
    """The same with every parameter off by up to 10 %."""
    off = 1.0 + 0.1 * np.random.default_rng(1).uniform(-1.0, 1.0, len(ALL))
    return linear.with_parameters({n: linear.parameter_value(n) * f for n, f in zip(ALL, off, strict=True)})


@pytest.fixture(scope="module", params=[8, pytest.param(24, marks=pytest.mark.search)])
def repeats(request, linear, far):
    """Return the truth, and fits of eleven parameters to records that differ by their noise."""
    commands = sines(20.0)
    truth = np.array([linear.parameter_value(name) for name in ALL])
    return truth, [fit(far, recorded(linear, commands, seed=seed), ALL) for seed in range(request.param)]


def test_eleven_parameters_are_found(repeats):
    truth, fits = repeats
    off = np.array([found.values / truth - 1.0 for found in fits])
    assert np.abs(off).max() < 5e-3


def test_intervals_hold_the_truth_as_often_as_they_say(repeats):
    """Fewer intervals of 95 % that hold the truth than are asked for are a chance of 1 in 1000."""
    truth, fits = repeats
    inside = [(f.intervals[:, 0] <= truth) & (truth <= f.intervals[:, 1]) for f in fits]
    assert np.sum(inside) >= stats.binom.ppf(1e-3, np.size(inside), 0.95)
    errors = np.array([(found.values - truth) / found.std for found in fits])
    np.testing.assert_allclose(np.sqrt((errors**2).mean()), 1.0, atol=0.15)


def test_what_is_left_is_the_noise(repeats):
    for found in repeats[1]:
        np.testing.assert_allclose(found.sigma, 1e-3, rtol=0.05)
        for name, floor in found.floor.items():
            assert found.chi[name] == pytest.approx(floor, rel=0.05)
        assert found.notes == ()


def test_it_is_the_optimum_of_an_independent_solver(linear, far):
    """Against scipy's least squares with numerical derivatives, from the same start."""
    names = ("w1", "z2", "c3")
    start = linear.with_parameters({name: far.parameter_value(name) for name in names})
    record = recorded(linear, sines(4.0))
    found = fit(start, record, names)
    sensitivity, scale = Sensitivity(start, names), np.array([1.0] * 3 + [1e-3] * 3 + [1e-2] * 3)

    def residuals(x):
        y = np.concatenate([x[3:] * scale[3:]])
        simulated = sensitivity.simulate(x[:3], y, record.acting, rate=RATE, substeps=2)
        return ((record.readings - simulated) / found.sigma).ravel()

    theirs = least_squares(residuals, [*sensitivity.start(), *np.zeros(6)], x_scale="jac", xtol=1e-12, ftol=1e-14)
    np.testing.assert_allclose(found.values, theirs.x[:3], rtol=1e-6)
    covariance = np.linalg.inv(theirs.jac.T @ theirs.jac)
    np.testing.assert_allclose(found.std, np.sqrt(np.diag(covariance))[:3], rtol=1e-3)


def test_several_records_are_fitted_together_and_an_unseen_one_judges(linear, far):
    records = [recorded(linear, sines(6.0, seed=i), seed=i, name=f"record {i}") for i in (1, 2)]
    unseen = recorded(linear, sines(6.0, seed=3), seed=3)
    both = fit(far, records, ALL, validation=unseen)
    one = fit(far, records[0], ALL)
    assert (both.std < one.std).all()
    for name, floor in both.floor.items():
        assert both.validation[name] < 1.5 * floor
    assert fit(far, records[0], ("w1",), validation=unseen).validation["s1"] > 5 * both.validation["s1"]


def test_free_motion_from_an_unknown_state_tells_parameters(linear, far):
    start = linear.rest(np.array([2e-3, -1e-3, 1e-3]))
    start[3:6] = 0.01, 0.02, -0.01
    record = recorded(linear, np.zeros((3000, 3)), start=start, noise=1e-4)
    names = ("w1", "z1", "w2", "z2", "w3", "z3", "mu1", "mu2")
    begun = linear.with_parameters({name: far.parameter_value(name) for name in names})
    found = fit(begun, record, names)
    truth = np.array([linear.parameter_value(name) for name in names])
    assert (np.abs(found.values - truth) < 4.5 * found.std).all()


def test_windows_lead_where_the_whole_record_would_not(linear):
    """Frequencies that are 60 % off put the simulation out of step with all but the first second."""
    record = recorded(linear, sines(20.0, size=(0.05, 0.05, 0.3)))
    wrong = linear.with_parameters({"w1": 20.0, "w2": 9.0, "w3": 16.0, "z1": 0.05, "z2": 0.05})
    found = fit(wrong, record, ("w1", "z1", "w2", "z2", "w3"), shooting_interval=0.5)
    truth = np.array([linear.parameter_value(name) for name in found.names])
    np.testing.assert_allclose(found.values, truth, rtol=5e-3)


def test_effects_of_the_full_twin_are_found():
    """Dry friction, a gain of an actuator and the offset of a sensor, with all else as it is."""
    twin = Twin.load("tue_rig").changed({"weak_gain": schema.EffectChange(enabled=True)})
    truth = {"friction1_fc": 1.2 * twin.parameter_value("friction1_fc"), "weak_gain_e": -0.05, "offset_s3_e0": 0.02}
    record = recorded(twin.with_parameters(truth), sines(10.0, size=(0.1, 0.1, 0.3)), rate=RATE)
    found = fit(twin, record, tuple(truth))
    assert (np.abs(found.values - list(truth.values())) < 5 * found.std + 1e-4).all()


# Inputs that were measured, not commanded.


OSCILLATOR = {
    "name": "oscillator",
    "coordinates": {"x": {}},
    "inputs": {"u": {}},
    "parameters": {"w": {"value": 6.0}, "z": {"value": 0.1}, "c": {"value": 30.0}},
    "equations": {"x''": "-w**2*x - 2*z*w*x' + c*u"},
}


@pytest.fixture(scope="module")
def oscillator():
    plant = {"name": "rig", "model": "oscillator", "sensors": {"s": {"measures": "x", "gain": 1.0, "unit": "1"}}}
    return Twin(schema.PlantDeclaration.model_validate(plant), schema.ModelDeclaration.model_validate(OSCILLATOR))


@pytest.fixture(scope="module")
def measured():
    """A record by scipy, of an oscillator with w = 6.3, z = 0.05, c = 40 under inputs in straight lines."""
    generator, t = np.random.default_rng(0), np.arange(2000) / 10.0
    u = generator.standard_normal(len(t))
    system = ([[0.0, 1.0], [-(6.3**2), -2 * 0.05 * 6.3]], [[0.0], [40.0]], [[1.0, 0.0]], [[0.0]])
    x = signal.lsim(system, u, t, [0.5, -1.0], interp=True)[1] + 1e-3 * generator.standard_normal(len(t))
    return Data("the record", 10.0, u[:, None], x[:, None], hold="first-order")


def test_straight_inputs_are_fitted_without_bias(oscillator, measured):
    """From all of the record, and from windows of it; inputs that are held are half a sample late."""
    truth = np.array([6.3, 0.05, 40.0])
    for shooting_interval in (None, 5.0):
        found = fit(oscillator, measured, ("w", "z", "c"), shooting_interval=shooting_interval)
        assert (np.abs(found.values - truth) < 4 * found.std).all()
        np.testing.assert_allclose(found.sigma, 1e-3, rtol=0.05)
    held = fit(oscillator, replace(measured, hold="zero-order"), ("w", "z", "c"))
    assert held.sigma[0] > 100 * found.sigma[0]


def test_parts_of_a_record_keep_how_its_commands_go(measured):
    assert {part.hold for part in (measured.first(5.0), *measured.windows(5.0), measured)} == {"first-order"}
    with pytest.raises(ModelError, match=r"hold is 'cubic': give 'zero-order' for .* 'first-order' for measured"):
        replace(measured, hold="cubic")


def test_measured_inputs_act_when_they_are_measured(linear):
    """The delay of a plant is that of its commands."""
    found = Data.of(saved(T), linear, hold="first-order")
    np.testing.assert_array_equal(found.acting, found.commands)


@pytest.mark.parametrize(("part", "exact"), [(0.02, 1e-9), (0.1, 1e-5), (0.25, 1e-2)])
def test_band_limited_inputs_lose_nothing(part, exact):
    """Straight lines between samples of a sine carry sinc^2 of it; the ends of a record apart."""
    u = np.sin(2 * np.pi * part * np.arange(200))[:, None]
    made = Data("sine", 1.0, u, u).band_limited()
    np.testing.assert_allclose(made.commands[3:-3] * np.sinc(part) ** 2, u[3:-3], atol=exact)
    assert made.hold == "first-order"


# What cannot be told.


def test_parameters_that_only_act_together_are_named(linear):
    """Oscillator 1 is damped by 2 z1 w1, and by an effect with a coefficient of its own."""
    twin = linear.changed({"damping1": schema.EffectChange(enabled=True, parameters={"c": 0.4})})
    (note,) = fit(twin, recorded(twin, sines(6.0)), ("w1", "z1", "damping1_c")).notes
    assert note.startswith(
        "z1 and damping1_c cannot be distinguished from these records; fix one of them (--parameters"
    )


def test_a_parameter_that_is_not_excited_is_named(linear):
    record = recorded(linear, sines(6.0, size=(0.04, 0.04, 0.0)))
    still = replace(record, commands=record.commands * [1.0, 0.0, 0.0])
    (note,) = fit(linear, recorded(linear, still.commands), ("w1", "c2")).notes
    assert note.startswith("these records do not determine c2")


def test_a_parameter_named_twice_is_refused(linear):
    with pytest.raises(ModelError, match="parameters are named twice: w1"):
        fit(linear, recorded(linear, sines(1.0)), ("w1", "z1", "w1"))


def test_a_record_that_is_too_short_is_refused(linear):
    with pytest.raises(
        RecordError, match=r"20 samples of 3 sensors are too few for 17 unknowns: 11 parameters, and 6 of"
    ):
        fit(linear, recorded(linear, sines(0.04)), ALL)


def saved(t, columns=None, **changes):
    """Return a recording of the rig's six channels, with some of them changed."""
    generator = np.random.default_rng(0)
    names = ("input.V1", "input.V2", "input.V3", "sensor.s1", "sensor.s2", "sensor.s3")
    made = {"t": t, **{name: np.cumsum(generator.standard_normal(len(t))) for name in names}}
    made |= {name.replace("_", "."): values for name, values in changes.items()}
    return Recording({name: values for name, values in made.items() if values is not None}, {})


T = np.arange(1000) / 500.0


def test_columns_are_found_by_their_names(linear):
    found = Data.of(saved(T), linear)
    assert found.rate == pytest.approx(500.0, rel=1e-12)
    np.testing.assert_array_equal(found.readings[:, 1], saved(T)["sensor.s2"])
    np.testing.assert_array_equal(found.acting[1:], found.commands[:-1])


GAP = np.concatenate([T[:400], T[417:]])
RATES = np.concatenate([T[:500], T[499] + np.arange(1, 501) / 400.0])


@pytest.mark.parametrize(
    ("t", "changes", "said"),
    [
        (T, {"sensor_s2": None}, r"there is no column sensor\.s2 or s2; allowed: t, input"),
        (T, {"sensor_s2": np.where(T == 1.0, np.nan, 0.1)}, r"sensor\.s2' is nan in row 500"),
        (GAP, {}, r"17 samples are missing after t = 0\.798 s; cut the record there, and use one part$"),
        (RATES, {}, r"the rate changes from 500 to 400 Hz at t = 0\.998 s; use one part$"),
        (np.concatenate([T, T]), {}, r"must increase strictly: row 1000 is 0 after 1\.998"),
        (T[:3], {}, r"it has 3 samples; give a longer record"),
        (T, {f"{kind}_{name}": np.full(len(T), 0.2) for kind, names in (("input", ("V1", "V2", "V3")),
             ("sensor", ("s1", "s2", "s3"))) for name in names}, r"nothing moves: the commands are constant"),
        (T, {f"sensor_s{i}": np.full(len(T), 0.2) for i in (1, 2, 3)}, r"s1 reads 0\.2 throughout; check its cable"),
        (T, {f"sensor_s{i}": 0.2 + 0.01 * np.random.default_rng(i).standard_normal(len(T)) for i in (1, 2, 3)},
         r"the commands change, but the readings are white noise, which follows none of them; check the"),
    ],
)  # fmt: skip
def test_a_record_that_cannot_be_fitted_is_refused(linear, t, changes, said):
    with pytest.raises(RecordError, match=said):
        Data.of(saved(t, **changes), linear)


def test_readings_that_follow_a_command_by_any_time_are_no_noise():
    generator = np.random.default_rng(2)
    commands, readings = np.cumsum(generator.standard_normal((4000, 2)), axis=0), generator.standard_normal((4000, 3))
    assert not Data("noise", 500.0, commands, readings).answers
    readings[40:, 1] += 0.4 * (commands[:-40, 0] - commands[:, 0].mean()) / commands[:, 0].std()
    assert Data("buried", 500.0, commands, readings).answers


# What is written.


def test_what_is_written_runs_and_has_the_values(linear, far, tmp_path):
    record = recorded(linear, sines(6.0))
    names = ("w1", "z1", "c3")
    found = fit(linear.with_parameters({n: far.parameter_value(n) for n in names}), record, names)
    paths = save(found, tmp_path / "out")
    twin = Twin.load(paths["plant"])
    twin.validate()
    for name, value, std in zip(found.names, found.values, found.std, strict=True):
        assert twin.parameter_value(name) == pytest.approx(value, rel=1e-9)
        assert twin.base.parameters[name].std == pytest.approx(std, rel=1e-9)
    controller = {"rate": "1 kHz", "model": str(paths["model"]), "observer": "disturbance"}
    experiment = Experiment.load("duffing", plant="linear_rig").changed(controller=controller, duration=20, record=None)
    assert max(experiment.run().manifest["masking_error"].values()) < 0.01


def test_effects_that_were_fitted_are_written_where_they_sit(tmp_path):
    twin = Twin.load("tue_rig").changed({"strong_gain": schema.EffectChange(enabled=True)})
    record = recorded(twin, sines(4.0, size=(0.1, 0.1, 0.3)))
    found = fit(twin, record, ("friction1_fc", "strong_gain_V1_e", "offset_s2_e0"))
    made = Twin.load(save(found, tmp_path)["plant"])
    made.validate()
    values = dict(zip(found.names, found.values, strict=True))
    assert made.parameter_value("friction1_fc") == pytest.approx(values["friction1_fc"], rel=1e-8)
    gains = {effect.at: made._value(effect, "e") for effect in made.effects if effect.kind == "actuator_gain"}
    assert gains == pytest.approx({"V1": values["strong_gain_V1_e"], "V2": -0.03, "V3": 0.03}, rel=1e-8)
    offsets = {effect.at: made._value(effect, "e0") for effect in made.effects if effect.kind == "sensor_offset"}
    assert offsets == pytest.approx({"s1": 5e-4, "s2": values["offset_s2_e0"], "s3": 5e-4}, rel=1e-8)
    assert [e.label for e in made.effects if e.kind == "noise"] == ["noise_s1", "noise_s2", "noise_s3"]


# The verb.


@pytest.fixture(scope="module")
def folders(tmp_path_factory, linear):
    """Return the folders of two recordings of the linear rig."""
    made = []
    for seed in (1, 2):
        record = recorded(linear, sines(6.0, seed=seed), seed=seed)
        columns = {"t": np.arange(len(record)) / RATE}
        columns |= {f"input.{name}": column for name, column in zip(linear.actuators, record.commands.T, strict=True)}
        columns |= {f"sensor.{name}": column for name, column in zip(linear.sensors, record.readings.T, strict=True)}
        made.append(tmp_path_factory.mktemp("record") / f"r{seed}")
        Recording(columns, {}).save(made[-1])
    return made


def test_identify_fits_all_that_the_equations_hold(folders, linear, tmp_path, capsys):
    arguments = ["identify", folders[0], "--plant", "linear_rig", "--validate", folders[1], "--out", tmp_path, "--json"]
    assert cli.main([*map(str, arguments)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["parameters"].keys() == set(ALL)
    for name, found in told["parameters"].items():
        assert abs(found["value"] - linear.parameter_value(name)) < 5 * found["std"]
    for name, floor in told["floor"].items():
        assert told["chi"]["train"][name] == pytest.approx(floor, rel=0.1)
        assert told["chi"]["validation"][name] < 2 * floor
    Twin.load(told["plant"]).validate()


def test_identify_fits_another_model_through_the_plant(folders, capsys, tmp_path):
    """The model of measured springs, with one coefficient free, is not the linear rig's."""
    names = ["--parameters", "rho11,z1", "--out", str(tmp_path)]
    assert cli.main(["identify", str(folders[0]), "--plant", "linear_rig", "--model", "setup_springs", *names]) == 0
    out = capsys.readouterr().out
    assert "rho11" in out
    assert f"written: {tmp_path / 'model.yaml'}" in out
    assert registry.load_model(tmp_path / "model.yaml").extends == "setup_springs"


def test_identify_fits_a_part_of_a_table(folders, tmp_path, capsys):
    """As it fits a recording that has no more than this part."""
    kept = Recording.load(folders[0])
    inside = (kept.t > 0.9999) & (kept.t < 4.9999)
    Recording({name: column[inside] for name, column in kept.columns.items()}, {}).save(tmp_path / "part")
    names = [{"t": "time", "input.V1": "force"}.get(name, name) for name in kept.columns]
    table = np.column_stack([*kept.columns.values()])
    np.savetxt(tmp_path / "a.csv", table, "%.17g", ",", header=",".join(names), comments="")
    settings = ["--plant", "linear_rig", "--parameters", "w1,z1", "--json", "--overwrite"]
    settings += ["--out", str(tmp_path / "out")]
    told = []
    for record in ([str(tmp_path / "part")], [f"{tmp_path / 'a.csv'}@1:5", "--map", "t=time,V1=force"]):
        assert cli.main(["identify", *record, *settings]) == 0
        told.append(json.loads(capsys.readouterr().out)["parameters"])
    assert told[0] == told[1]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--parameters", "w1,w9"], "linear rig has no parameter 'w9'; did you mean 'w"),
        (["--plant", "nowhere"], "nowhere"),
        (["--validate", "nothing"], "nothing: no such record"),
    ],
)
def test_identify_refuses_and_writes_nothing(folders, tmp_path, capsys, arguments, said):
    out = tmp_path / "out"
    assert cli.main(["identify", str(folders[0]), "--plant", "linear_rig", "--out", str(out), *arguments]) != 0
    assert said in capsys.readouterr().err
    assert not out.exists()
