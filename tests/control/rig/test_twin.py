"""Twin: each effect does in its place what the dictionary says, against numpy and closed forms."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg
from scipy.integrate import solve_ivp

from masking.control.rig.twin import Twin
from masking.errors import DeclarationError, RecordError
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.simulated_run import run_twin
from masking.model.declaration import registry, schema

# A bench: a mass on a spring whose force is under test, and a free mass, each pushed by its own input.
BENCH = {
    "name": "bench",
    "coordinates": {"a": {"unit": "m"}, "b": {"unit": "m"}},
    "inputs": {"f": {"unit": "m/s**2"}, "g": {"unit": "m/s**2"}},
    "parameters": {"k": {"value": 100, "unit": "1/s**2"}, "h": {"value": 0.25}, "l": {"value": 1, "unit": "m"}},
    "equations": {"a''": "-k*l*(a/l) + f", "b''": "4*h*g"},
    "elements": {"track": {"displacement": "a", "unit": "m/s**2", "acts": {"a": -1}}},
}
SENSORS = ("raw", "moved", "scaled", "clipped", "filtered", "coarse", "noisy", "all")
ACTUATORS = ("plain", "strong", "leaning", "limited", "dead", "stepped", "slow", "warm", "whole")
EFFECTS = {
    "offset": {"effect": "sensor_offset", "at": ["moved", "all"], "parameters": {"e0": 0.3}},
    "scale": {"effect": "sensor_gain", "at": ["scaled", "all"], "parameters": {"e": -0.1}},
    "range": {"effect": "sensor_saturation", "at": "clipped", "parameters": {"limit": 1.5}},
    "filter": {"effect": "sensor_lag", "at": "filtered", "parameters": {"tau": 0.02}},
    "noise": {"effect": "noise", "at": ["noisy", "all"], "parameters": {"sigma": 0.2}},
    "steps": {"effect": "quantisation", "at": ["coarse", "all"], "parameters": {"step": 0.25}},
    "gain": {"effect": "actuator_gain", "at": ["strong", "whole"], "parameters": {"e": 0.05}},
    "zero": {"effect": "actuator_offset", "at": ["leaning", "whole"], "parameters": {"u0": -0.2}},
    "supply": {"effect": "saturation", "at": ["limited", "whole"], "parameters": {"limit": 0.6}},
    "gap": {"effect": "dead_zone", "at": "dead", "parameters": {"width": 0.1}},
    "converter": {"effect": "dac_quantisation", "at": "stepped", "parameters": {"step": 0.125}},
    "coil": {"effect": "actuator_lag", "at": "slow", "parameters": {"tau": 0.05}},
    "heat": {"effect": "thermal", "at": ["warm", "whole"], "parameters": {"r": 3.0, "tau": 4.0}},
    "friction": {
        "effect": "dry_friction", "at": "track", "parameters": {"fc": "0.001*k*l", "vs": 1e-4}, "enabled": False,
    },
    "wall": {
        "effect": "stop", "at": "track", "parameters": {"edge": 0.004, "k": 1e5, "c": 0.5}, "enabled": False,
    },
    "memory": {"effect": "hysteresis", "at": "track", "parameters": {"k": 30, "zmax": 0.002}, "enabled": False},
}  # fmt: skip
PLANT = {
    "name": "bench rig",
    "model": "bench.yaml",
    "sensors": {name: {"measures": "a + b", "gain": {"value": 2, "unit": "V/m"}, "unit": "V"} for name in SENSORS},
    "actuators": {name: {"unit": "m/s**2"} for name in ACTUATORS},
    "allocation": {"f": "plain", "g": " + ".join(f"{2 + i}*{name}/(8*h)" for i, name in enumerate(ACTUATORS[1:]))},
    "effects": EFFECTS,
}


def bench(folder, *, changes=None, **parts):
    (folder / "bench.yaml").write_text(json.dumps(BENCH))
    (folder / "rig.yaml").write_text(json.dumps({**PLANT, **parts}))
    found = {name: schema.EffectChange.model_validate(change) for name, change in (changes or {}).items()}
    return Twin(registry.load_plant(folder / "rig.yaml"), registry.load_model(folder / "bench.yaml"), found)


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    return bench(tmp_path_factory.mktemp("bench"))


def switched(twin, **on):
    return twin.changed({name: schema.EffectChange(enabled=state) for name, state in on.items()})


def read(twin, y, noise=None):
    found = np.empty(len(SENSORS))
    noise = np.zeros(len(SENSORS)) if noise is None else noise
    twin.kernels.sense(0.0, y, twin.values(), noise, found)
    return dict(zip(SENSORS, found, strict=True))


def rates(twin, y, **commands):
    u, found = np.array([commands.get(name, 0.0) for name in ACTUATORS]), np.empty(len(y))
    twin.kernels.twin_derivative(0.0, y, u, twin.values(), found)
    return dict(zip(twin.state_names, found, strict=True))


def state(twin, **values):
    return np.array([values.get(name, 0.0) for name in twin.state_names])


def advance(twin, y, seconds, *, step=1e-4, **commands):
    u, y = np.array([commands.get(name, 0.0) for name in ACTUATORS]), y.copy()
    rows = [y.copy()]
    for _ in range(round(seconds / 1e-3)):
        twin.kernels.advance(0.0, y, u, twin.values(), 1e-3, round(1e-3 / step))
        rows.append(y.copy())
    return dict(zip(twin.state_names, np.array(rows).T, strict=True))


# Sensors and actuators.


def test_states_are_named(twin):
    internal = ("memory_z", "coil_a", "heat_warm_P", "heat_whole_P", "filter_m")
    assert twin.state_names == ("a", "b", "a'", "b'", *internal)


@pytest.mark.parametrize("position", [-1.3, -0.4, 0.0, 0.11, 0.62, 2.0])
def test_each_sensor_gives_what_its_effect_makes_of_a_value(twin, position):
    xi = np.linspace(-1.0, 2.0, len(SENSORS))
    given = state(twin, a=0.25 * position, b=0.75 * position, filter_m=0.7)
    found, s = read(twin, given, xi), 2.0 * position
    expected = {
        "raw": s, "moved": s + 0.3, "scaled": 0.9 * s, "clipped": np.clip(s, -1.5, 1.5), "filtered": 0.7,
        "coarse": 0.25 * np.floor(s / 0.25 + 0.5), "noisy": s + 0.2 * xi[6],
        "all": 0.25 * np.floor(((s + 0.3) * 0.9 + 0.2 * xi[7]) / 0.25 + 0.5),  # in the order of the file
    }  # fmt: skip
    assert found == pytest.approx(expected, rel=1e-14, abs=1e-14)
    assert rates(twin, given)["filter_m"] == pytest.approx((s - 0.7) / 0.02, rel=1e-12)


@pytest.mark.parametrize("u", [-2.0, -0.55, -0.05, 0.0, 0.07, 0.33, 1.9])
def test_each_actuator_does_what_its_effect_makes_of_a_command(twin, u):
    on = state(twin, coil_a=0.4, heat_warm_P=1.0, heat_whole_P=2.0)
    weights = {name: (2 + i) / 2.0 for i, name in enumerate(ACTUATORS[1:])}
    none = {"leaning": -0.2, "slow": 0.4, "whole": -0.2}  # what they do without a command
    chained = np.clip(1.05 * u - 0.2, -0.6, 0.6)
    expected = {
        "strong": 1.05 * u, "leaning": u - 0.2, "limited": np.clip(u, -0.6, 0.6), "dead": u - np.clip(u, -0.1, 0.1),
        "stepped": 0.125 * np.floor(u / 0.125 + 0.5), "slow": 0.4, "warm": u, "whole": chained,
    }  # fmt: skip
    idle = sum(weights[name] * value for name, value in none.items())
    assert rates(twin, on)["b'"] == pytest.approx(idle, rel=1e-13)
    for name, value in expected.items():
        found = rates(twin, on, **{name: u})
        assert found["b'"] - idle == pytest.approx(weights[name] * (value - none.get(name, 0.0)), rel=1e-12, abs=1e-12)
        assert found["a'"] == 0.0
    assert rates(twin, on, plain=u)["a'"] == u
    assert rates(twin, on, slow=u)["coil_a"] == pytest.approx((u - 0.4) / 0.05, rel=1e-12)
    assert rates(twin, on, warm=u)["heat_warm_P"] == pytest.approx((3.0 * u**2 - 1.0) / 4.0, rel=1e-12)
    # What the coil is given counts, after the limit before it.
    assert rates(twin, on, whole=u)["heat_whole_P"] == pytest.approx((3.0 * chained**2 - 2.0) / 4.0, rel=1e-12)


def test_lag_and_heat_follow_in_first_order(twin):
    found = advance(twin, state(twin, a=0.3, b=0.2), 0.2, slow=0.5, warm=0.8)
    t = np.arange(201) * 1e-3
    np.testing.assert_allclose(found["coil_a"], 0.5 * (1 - np.exp(-t / 0.05)), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found["heat_warm_P"], 3.0 * 0.64 * (1 - np.exp(-t / 4.0)), rtol=1e-9, atol=1e-12)
    # The sensor's lag behind 2 (a + b): the masses move by their own equations.
    y = solve_ivp(
        lambda t, y: [y[2], y[3], -100 * y[0], 3.5 * -0.0 + WEIGHT["slow"] * 0.5 * (1 - np.exp(-t / 0.05))
                      + WEIGHT["warm"] * 0.8 - WEIGHT["leaning"] * 0.2 - WEIGHT["whole"] * 0.2,
                      (2 * (y[0] + y[1]) - y[4]) / 0.02],
        (0, 0.2), [0.3, 0.2, 0, 0, 0], "DOP853", t_eval=t, rtol=1e-11, atol=1e-13,
    ).y  # fmt: skip
    np.testing.assert_allclose(found["filter_m"], y[4], rtol=1e-7, atol=1e-9)


WEIGHT = {name: (2 + i) / 2.0 for i, name in enumerate(ACTUATORS[1:])}


def test_an_effect_that_is_off_is_as_if_absent(twin):
    off = switched(twin, **dict.fromkeys(EFFECTS, False))
    at = state(off, a=0.1, b=0.231, filter_m=9.0, coil_a=9.0)
    assert set(read(off, at, np.ones(len(SENSORS))).values()) == {2 * 0.331}
    for name in ACTUATORS[1:]:
        assert rates(off, at, **{name: 0.83})["b'"] == pytest.approx(WEIGHT[name] * 0.83, rel=1e-14)
    assert rates(off, at, plain=3.0)["a'"] == -100 * 0.1 + 3.0
    assert off.noise() == {}
    # No function is compiled anew for switches and values.
    assert off.kernels.generated.path == twin.kernels.generated.path


def test_changes_of_an_experiment_win(twin):
    changes = {"scale": {"parameters": {"e": 0.5}}, "offset": {"enabled": False}}
    changed = twin.changed({name: schema.EffectChange.model_validate(c) for name, c in changes.items()})
    found = read(changed, state(changed, b=0.1))
    assert (found["scaled"], found["moved"]) == pytest.approx((0.3, 0.2), rel=1e-14)
    assert changed.kernels.generated.path == twin.kernels.generated.path


def test_the_controller_is_told_the_noise(twin):
    rounding = 0.25 / np.sqrt(12.0)
    expected = {"coarse": rounding, "noisy": 0.2, "all": np.hypot(rounding, 0.2)}
    assert twin.noise() == pytest.approx(expected, rel=1e-12)


def test_allocation_is_what_the_file_says(twin):
    expected = np.zeros((2, len(ACTUATORS)))
    expected[0, 0], expected[1, 1:] = 1.0, list(WEIGHT.values())
    np.testing.assert_allclose(twin.allocation, expected, rtol=1e-12, atol=1e-12)


def packaged(plant, **changes):
    declaration = registry.load_plant(plant)
    changes = {name: schema.EffectChange(enabled=state) for name, state in changes.items()}
    return Twin(declaration, registry.load_model(declaration.model), changes)


def test_allocation_of_the_packaged_rigs():
    """The gains of the oscillators' actuators of section C.5."""
    np.testing.assert_array_equal(packaged("linear_rig").allocation, np.eye(3))
    np.testing.assert_allclose(packaged("tue_rig").allocation, np.diag([1 / 1.078, 1 / 1.109, 1.0]), rtol=1e-14)


def test_commands_are_in_the_units_of_their_actuators():
    """A mass of 2 kg under 3000 mN, or under an amplifier of 1.5 N/V that gets 2000 mV, is accelerated by 1.5 m/s^2."""
    model = schema.ModelDeclaration.model_validate(
        {"name": "mass", "coordinates": {"x": {"unit": "mm"}}, "inputs": {"f": {"unit": "mN"}},
         "parameters": {"m": {"value": 2000, "unit": "g"}, "g": {"value": 1500, "unit": "mN/V"}},
         "equations": {"x''": "f/m"}}
    )  # fmt: skip
    alone = {"name": "bench", "model": "mass", "sensors": {"s": {"measures": "x", "unit": "mm"}}}
    wired = alone | {"actuators": {"V": {"unit": "mV"}}, "allocation": {"f": "g*V"}}
    for plant, command in ((alone, 3000.0), (wired, 2000.0)):
        twin = Twin(schema.PlantDeclaration.model_validate(plant), model)
        out = np.empty(2)
        twin.kernels.twin_derivative(0.0, np.zeros(2), np.array([command]), twin.values(), out)
        assert out == pytest.approx([0.0, 1.5])


# Elements.


def test_dry_friction_stops_an_oscillator_in_finite_time(twin):
    """Each half period takes 2 fc/k of the amplitude, until the spring is too weak to go on."""
    fc, k = 0.1, 100.0
    rubbing = switched(twin, friction=True)
    made = advance(rubbing, state(rubbing, a=0.0095), 2.5)
    half = round(np.pi / np.sqrt(k) / 1e-3)
    turning = [0.0095 - 2 * fc / k * i for i in range(5)]
    found = np.abs(made["a"][[half * i for i in range(5)]])
    np.testing.assert_allclose(found, turning, atol=0.03 * 2 * fc / k)
    rest = np.array(made["a'"][5 * half + 100 :])
    # 1.5 mm is left, 0.5 mm beyond the last turn: it creeps there, at the rate at which friction balances the spring.
    at = np.abs(made["a"][5 * half + 100 :])
    assert at.max() < fc / k
    np.testing.assert_allclose(np.abs(rest), 1e-4 * np.arctanh(k * at / fc), rtol=0.02)


def test_a_stop_lets_in_no_further_than_the_energy_goes(twin):
    stopped = switched(twin, wall=True)
    speed, depth = 0.2, 0.2 / np.sqrt(1e5 + 100.0)
    made = advance(stopped, state(stopped, a=0.004, **{"a'": speed}), 0.05, step=2e-5)
    reached = made["a"].max() - 0.004
    assert 0.5 * depth < reached < depth
    assert made["a'"].min() > -speed  # damped
    undisturbed = advance(stopped, state(stopped, a=-0.0039), 0.5)
    t = np.arange(501) * 1e-3
    np.testing.assert_allclose(undisturbed["a"], -0.0039 * np.cos(10 * t), atol=1e-9)


def test_hysteresis_travels_with_the_state(twin):
    """Against the equations of Bouc and Wen written out, integrated by scipy."""
    bound = switched(twin, memory=True)
    made = advance(bound, state(bound, a=0.01), 1.5)

    def slope(_, y):
        a, v, z = y
        part = abs(z / 0.002)
        return [v, -100 * a - 30 * z, v - 0.5 * abs(v) * z / 0.002 * part - 0.5 * v * part**2]

    found = solve_ivp(slope, (0, 1.5), [0.01, 0, 0], t_eval=np.arange(1501) * 1e-3, rtol=1e-10, atol=1e-13).y
    np.testing.assert_allclose(made["a"], found[0], atol=1e-8)
    np.testing.assert_allclose(made["memory_z"], found[2], atol=1e-8)
    assert np.abs(made["memory_z"]).max() <= 0.002
    assert np.abs(made["a"][-600:]).max() < 0.009  # it takes energy


RED = {"V1": 0.0, "V2": 1.0, "V3": 0.0}


@pytest.fixture(scope="module")
def full():
    return packaged("tue_rig")


def pushed(twin, seconds):
    """Push the red oscillator of the rig with a command far too large, from rest."""
    y, u = twin.rest(np.zeros(3)), np.array(list(RED.values()))
    rows = []
    for _ in range(round(seconds / 1e-3)):
        twin.kernels.advance(0.0, y, u, twin.values(), 1e-3, 20)
        rows.append(y.copy())
    return dict(zip(twin.state_names, np.array(rows).T, strict=True))


def test_the_red_oscillator_is_stopped_and_its_coil_warms_up(full):
    """0.42 V is 23.25 * 0.42 / 1.109 = 8.8 m/s^2: against 20000 1/s^2, 0.44 mm beyond 5.8 mm at the very most at rest.

    On the way there it gains 8.81 * 5.8 mm of energy at most, which the stop takes in sqrt(2 * 8.81 * 5.8 mm / 20000).
    """
    made = pushed(full, 3.0)
    reach = made["x2"] - made["x3"]
    assert reach[1000:].min() > 0.0058
    assert reach[1000:].max() < 0.0058 + 8.81 / 20000
    assert reach.max() < 0.0058 + 8.81 / 20000 + np.sqrt(2 * 8.81 * 0.0058 / 20000)
    t = np.arange(1, 3001) * 1e-3
    np.testing.assert_allclose(made["heat_V2_P"], 45.35 * 0.42**2 * (1 - np.exp(-t / 10)), rtol=1e-9)
    assert not made["heat_V1_P"].any()
    free = pushed(replace(full, changes={"red_stop": schema.EffectChange(enabled=False)}), 3.0)
    assert (free["x2"] - free["x3"]).max() > 0.0075


# Noise, delay and the loop.


@pytest.fixture(scope="module")
def loop_run():
    """Return a function that runs the packaged linear rig as Duffing oscillators, (seconds, seed, effects)."""

    def make(seconds, seed=0, **effects):
        settings = {"rate": "1 kHz", "observer": {"kind": "disturbance", "noise": 1e-4}}
        found = Experiment.load("duffing", plant="linear_rig").changed(controller=settings, effects=effects)
        return run_twin(found.sampled_loop, found.sampled.end, duration=seconds, seed=seed)

    return make


def test_noise_is_white_of_the_declared_size_and_follows_the_seed(loop_run):
    made = loop_run(10.0, seed=3, noise={"parameters": {"sigma": 2e-3}})
    q = made.states[:, :3]
    noise = made.readings - 200.0 * np.array([q[:, 0] - q[:, 2], q[:, 1] - q[:, 2], q[:, 2]]).T
    count = len(noise)
    np.testing.assert_allclose(noise.std(axis=0), 2e-3, rtol=4 / np.sqrt(2 * count))
    np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=4 * 2e-3 / np.sqrt(count))
    for lag in (1, 2, 5):
        assert np.abs(np.mean(noise[lag:] * noise[:-lag], axis=0)).max() < 4 * 2e-3**2 / np.sqrt(count)
    assert np.abs(np.corrcoef(noise.T) - np.eye(3)).max() < 4 / np.sqrt(count)
    again = loop_run(10.0, seed=3, noise={"parameters": {"sigma": 2e-3}})
    np.testing.assert_array_equal(again.readings, made.readings)
    other = loop_run(1.0, seed=4, noise={"parameters": {"sigma": 2e-3}})
    assert not np.isclose(other.readings, made.readings[:1001], rtol=0, atol=1e-9).any(axis=1).all()


@pytest.mark.parametrize("samples", [0, 1, 4])
def test_commands_act_as_late_as_declared(loop_run, samples):
    """The set-up's linear equations solved exactly under the commands that were recorded, so many samples late."""
    made = loop_run(0.5, delay={"parameters": {"samples": samples}})
    w, z = np.array([12.5521, 14.0337, 9.7369]), np.array([0.3362, 0.4296, 0.0409])
    c, mu = np.array([20.9218, 23.2465, 1.2589]), np.array([0.0411, 0.0578])
    flow = np.zeros((9, 9))
    flow[:3, 3:6] = np.eye(3)
    for i in (0, 1):
        row = np.zeros(6)
        row[[i, 2, 3 + i, 5]] = -(w[i] ** 2), w[i] ** 2, -2 * z[i] * w[i], 2 * z[i] * w[i]
        flow[3 + i, :6] = row
        flow[5, :6] -= mu[i] * row
    flow[5, [2, 5]] -= w[2] ** 2, 2 * z[2] * w[2]
    flow[3:6, 6:] = [[c[0], 0, 0], [0, c[1], 0], [-mu[0] * c[0], -mu[1] * c[1], c[2]]]
    step = linalg.expm(flow * 1e-3)
    states, commands = made.states, made.applied
    assert np.ptp(commands, axis=0).min() > 1e-3
    count = len(states) - 1
    moved = states[samples:count] @ step[:6, :6].T + commands[: count - samples] @ step[:6, 6:].T
    error = np.abs(moved - states[samples + 1 : count + 1]).max(axis=0)
    assert (error < 1e-11 * np.abs(states).max(axis=0)).all(), error


# Refusals.


def refusal(folder, **effects):
    with pytest.raises(DeclarationError) as error:
        _ = bench(folder, effects=effects).effects
    return str(error.value).replace(str(folder), "")


def test_an_unknown_effect_is_refused_with_its_place(tmp_path):
    text = refusal(tmp_path, wear={"effect": "dry_fricton", "at": "track"})
    assert text.startswith("/rig.yaml:1:")
    assert "effects.wear.effect: there is no effect 'dry_fricton'; did you mean 'dry_friction'?" in text


@pytest.mark.parametrize(
    ("use", "message"),
    [
        ({"effect": "dry_friction", "at": "trak", "parameters": {"fc": 1}},
         ".at: 'trak' is no element of bench rig; did you mean 'track'?"),
        ({"effect": "noise", "at": "rau", "parameters": {"sigma": 1}},
         ".at: 'rau' is no sensor of bench rig; did you mean 'raw'?"),
        ({"effect": "noise", "at": "track", "parameters": {"sigma": 1}},
         ".at: 'track' is no sensor of bench rig"),
        ({"effect": "saturation", "at": "f", "parameters": {"limit": 1}},
         ".at: 'f' is no actuator of bench rig"),
        ({"effect": "dry_friction", "parameters": {"fc": 1}},
         ": the effect dry_friction needs a place: which element; write 'at: track'"),
        ({"effect": "delay", "at": "raw"},
         ": the effect delay sits in the loop, not at raw"),
        ({"effect": "noise", "at": "raw", "parameters": {"sigma": 1, "sigm": 2}},
         ".parameters.sigm: the effect noise has no parameter 'sigm'; did you mean 'sigma'?"),
        ({"effect": "thermal", "at": "warm"},
         ": the effect thermal needs r [W/U**2]"),
        ({"effect": "stop", "at": "track"},
         ": the effect stop needs k [F/D], edge [D]"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_with_its_place(tmp_path, use, message):
    text = refusal(tmp_path, e=use)
    assert text.startswith("/rig.yaml:1:")
    assert f"effects.e{message}" in text


def test_all_refusals_come_at_once(tmp_path):
    wrong = {"a": {"effect": "wear"}, "b": {"effect": "noise", "at": "rau"}}
    assert len(refusal(tmp_path, **wrong).splitlines()) >= 3


def test_an_effect_of_an_element_of_another_unit_is_refused(tmp_path):
    """A parameter that is an expression has the unit of the place, or is refused."""
    twin = bench(tmp_path, effects={"e": {"effect": "dry_friction", "at": "track", "parameters": {"fc": "k"}}})
    with pytest.raises(DeclarationError, match=r"unit"):
        _ = twin.attached


@pytest.mark.parametrize(
    ("allocation", "message"),
    [
        ({"f": "plain"},
         "nothing is allocated to the input g; write what it gets of the actuators, such as 'g: plain'"),
        ({"f": "plain**2", "g": "strong"},
         "allocation.f: the allocation must be a sum of actuators times numbers; put anything else into effects"),
        ({"f": "plain + 1", "g": "strong"}, "allocation.f: the allocation must be a sum of actuators times numbers"),
        ({"f": "plain*strong", "g": "strong"}, "allocation.f: the allocation must be a sum of actuators times numbers"),
        ({"f": "plian", "g": "strong"}, "did you mean 'plain'?"),
        ({"f": "plain", "g": "strong", "e": "slow"}, "allocation.e: 'e' is not an input of bench"),
    ],
)  # fmt: skip
def test_an_allocation_that_is_none_is_refused_with_its_place(tmp_path, allocation, message):
    twin = bench(tmp_path, allocation=allocation)
    with pytest.raises(DeclarationError) as error:
        _ = twin.allocation
    assert "rig.yaml:1:" in str(error.value)
    assert message in str(error.value)


def test_a_change_of_an_effect_that_is_not_there_is_refused_with_its_place(tmp_path):
    run = {"name": "run", "plant": "linear_rig", "virtual": "duffing", "duration": 1}
    (tmp_path / "run.yaml").write_text(json.dumps({**run, "effects": {"dampng1": True}}))
    with pytest.raises(DeclarationError) as error:
        _ = Experiment.load(tmp_path / "run.yaml").twin.effects
    assert str(error.value).startswith(f"{tmp_path}/run.yaml:1:")
    assert "effects.dampng1" in str(error.value)
    assert "did you mean 'damping1'?" in str(error.value)


def test_a_change_of_a_parameter_that_is_not_there_is_refused(tmp_path):
    twin = bench(tmp_path, changes={"noise": {"parameters": {"sgima": 1.0}}, "nois": {"enabled": False}})
    with pytest.raises(DeclarationError) as error:
        _ = twin.effects
    assert "effects.noise.parameters.sgima: the effect noise has no parameter 'sgima'; did you mean 'sigma'?" in str(
        error.value
    )
    assert "effects.nois: bench rig has no effect 'nois'; did you mean 'noise'?" in str(error.value)


def test_samples_between_which_no_motion_is_seen_are_refused():
    """A clock in microseconds that is taken for one in seconds."""
    twin = Twin.load("linear_rig")
    assert twin.resolving(1000.0) == twin.substeps(1000.0)
    with pytest.raises(RecordError, match=r"1000 s apart: .* --map t=time:ms"):
        twin.resolving(1e-3)


def test_the_state_of_a_sensor_follows_readings_without_their_noise(tmp_path):
    """(2 (a + b) - m)/tau, whatever the noise that is declared before the lag."""
    effects = {name: EFFECTS[name] for name in ("noise", "filter")}
    effects = {"noise": effects["noise"] | {"at": "filtered"}, "filter": effects["filter"]}
    twin = bench(tmp_path, effects=effects)
    found = rates(twin, state(twin, a=0.3, b=0.2, filter_m=0.4))
    assert found["filter_m"] == pytest.approx((2.0 * 0.5 - 0.4) / 0.02)
