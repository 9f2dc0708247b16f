"""Discovery without coordinates: components on a test bench, and first-order systems.

Records are made by `tests.benchmarks.components`, from closed forms; base parameters are 1 % off.
"""

import json
from collections import defaultdict

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import masking
from masking.app.cli import main
from masking.app.workflows import discovery_inputs
from masking.control.rig.twin import Twin
from masking.errors import DeclarationError, ModelError
from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.candidates import candidates
from masking.inference.discovery.places import degrees, places
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.simulation import simulate
from masking.lab.plants.simulated import SimulatedPlant
from masking.model.declaration import registry
from masking.model.effects import Span
from masking.model.modelling.model import Model, load_model
from tests.benchmarks import components

SECONDS, TANK_SECONDS = 20.0, 600.0
DAMPER = """
name: damper on a test bench
inputs: {d: {unit: m}, v: {unit: m/s}}
parameters: {k: {value: 1000, unit: N/m, std: 50}, c: {value: 20, unit: N*s/m, std: 2}}
outputs: {F: {expression: k*d + c*v, unit: N}}
elements: {strut: {displacement: d, rate: v, unit: N, acts: {F: 1}}}
"""
MOTOR = """
name: motor
states: {w: {unit: rad/s}}
inputs: {i: {unit: A}}
parameters:
  kt: {value: 0.1, unit: N*m/A}
  b: {value: 0.02, unit: N*m*s/rad}
  J: {value: 0.01, unit: kg*m**2, std: 1e-7, bounds: [1e-9, null]}
equations: {"w'": (kt*i - b*w)/J}
outputs: {speed: {expression: w, unit: rad/s}}
elements: {shaft: {rate: w, unit: N*m, acts: {w: -1/J}}}
"""
TANK = """
name: tank
states: {level: {unit: m}}
inputs: {q: {unit: m**3/s}}
parameters:
  A: {value: 0.5, unit: m**2, bounds: [1e-9, null]}
  r: {value: 0.05, unit: m**2/s}
equations: {"level'": (q - r*level)/A}
elements: {valve: {displacement: level, unit: m**3/s, acts: {level: -1/A}}}
"""
MODELS = {"damper": DAMPER, "motor": MOTOR, "tank": TANK}


def damper(hidden, **off):
    return lambda seed: components.component(hidden, SECONDS, seed, **off)


def nothing(d, v):
    return 0.0 * d


def moved(hidden):
    return damper(lambda d, v: hidden(d))


RECORDS = {
    "damper/none": damper(nothing),
    "damper/dry_friction": damper(lambda d, v: 0.4 * np.tanh(v / 1e-3)),
    "damper/hardening_spring": moved(lambda d: 2e7 * d**3),
    "damper/dahl_friction": moved(lambda d: 0.6 * components.dahl(d, 3e-4)),
    "damper/play_with_friction": moved(lambda d: 0.8 * components.dragged(d, 2e-3, 2e-4)),
    "damper/hysteresis": moved(lambda d: 800.0 * components.bouc_wen(d, 1e-3)),
    "damper/local_friction": damper(lambda d, v: 0.2 * np.tanh(v / 1e-3) * (1.0 + np.tanh((d - 1e-3) / 5e-4))),
    "damper/parameter": damper(nothing, k=1300.0),
    "damper/constant_force": damper(lambda d, v: 0.5 + 0.0 * d),
    "motor/none": lambda seed: components.motor(0.0, SECONDS, seed),
    "motor/dry_friction": lambda seed: components.motor(0.05, SECONDS, seed),
    "tank/none": lambda seed: components.tank(0.0, TANK_SECONDS, seed),
    "tank/hardening_spring": lambda seed: components.tank(0.02, TANK_SECONDS, seed),
}
# what is named, where, and its parameters in SI units
NAMED = {
    "damper/dry_friction": ("strut", {"fc": 0.4, "vs": 1e-3}),
    "damper/hardening_spring": ("strut", {"k3": 2e7}),
    "damper/dahl_friction": ("strut", {"fc": 0.6, "x0": 3e-4}),
    "damper/play_with_friction": ("strut", {"fc": 0.8, "gap": 2e-3, "x0": 2e-4}),
    "damper/hysteresis": ("strut", {"k": 800.0, "zmax": 1e-3}),
    "damper/local_friction": ("strut", {"fc": 0.4, "edge": 1e-3, "width": 5e-4, "vs": 1e-3}),
    "tank/hardening_spring": ("valve", {"k3": 0.02}),
    "motor/dry_friction": ("shaft", {"fc": 0.05}),
}
# One whole search for each kind of system is in the gate.
GATE = {"damper/dry_friction", "tank/hardening_spring"}
EACH_NAMED = [pytest.param(name, marks=[] if name in GATE else pytest.mark.search) for name in NAMED]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("components")
    for name, text in MODELS.items():
        (out / f"{name}.yaml").write_text(text)
    return out


@pytest.fixture(scope="module")
def discovered(folder):
    """Return what is found in a record; each is made and searched once."""
    known = {}

    def find(name):
        if name not in known:
            out = folder / name
            out.mkdir(parents=True)
            for seed, part in ((1, "train"), (2, "valid")):
                components.save(RECORDS[name](seed), out / f"{part}.csv")
            known[name] = masking.discover(
                out / "train.csv",
                model=folder / f"{name.split('/')[0]}.yaml",
                validation=out / "valid.csv",
                out=out / "found",
            )
        return known[name]

    return find


@pytest.mark.parametrize(("function", "size"), [(components.dahl, 3e-4), (components.bouc_wen, 1e-3)])
def test_the_memories_of_the_records_are_those_of_their_equations(function, size):
    rates = {
        components.dahl: lambda v, z: (v - abs(v) * z) / size,
        components.bouc_wen: lambda v, z: v - 0.5 * (abs(v) * z * abs(z) + v * z**2) / size**2,
    }
    motion, t = components.Motion.of(1, 5e-3), np.arange(8000) / 8000.0
    made = function(motion.at(t), size)
    told = solve_ivp(
        lambda x, z: rates[function](motion.rate(np.array([x]))[0], z), (0.0, t[-1]), [0.0], t_eval=t, max_step=1e-3,
        rtol=1e-8, atol=1e-12,
    )  # fmt: skip
    assert np.abs(made - told.y[0]).max() < 1e-4 * np.abs(made).max()


@pytest.mark.parametrize("name", EACH_NAMED)
def test_what_is_hidden_is_named_where_it_is(discovered, name):
    found, (on, parameters) = discovered(name), NAMED[name]
    assert (found.verdict, [(e.name, e.on) for e in found.effects]) == ("named", [(name.split("/")[1], on)])
    told = {key: found.effects[0].parameters[key][0] for key in parameters}
    assert told == pytest.approx(parameters, rel=0.02)
    assert f"<Discovery: named, {found.effects[0].name} in {on}; error on unseen data: " in repr(found)
    for sensor, after in found.simulation_error.validation[1].items():
        assert after < 1.1 * components.NOISE < found.simulation_error.adjusted[sensor]


def coarse(hidden, seed):
    """Return a record of a slow motion at 100 Hz, in which the bench goes some tenths of a millimetre in a sample."""
    motion, t = components.Motion.of(seed, 5e-3, 0.2, 2.0, 12), np.arange(round(8000 * SECONDS)) / 8000.0
    d, v = motion.at(t), motion.rate(t)
    made = {"t": t, "d": d, "v": v, "F": 1010.0 * d + 19.8 * v + hidden(d, v)}
    made = {name: column[::80] for name, column in made.items()}
    return made | {"F": components.noisy(made["F"], seed)}


@pytest.mark.search
def test_friction_that_builds_up_within_a_sample_is_found(folder):
    """In steps of a sample its state would diverge; that of bristles without damping is nearly the same."""
    for seed, part in ((1, "coarse"), (2, "unseen")):
        components.save(coarse(lambda d, v: 6.0 * components.dahl(d, 6e-5), seed), folder / f"{part}.csv")
    found = masking.discover(folder / "coarse.csv", model=folder / "damper.yaml", validation=folder / "unseen.csv")
    assert [(e.name, e.on) for e in found.effects] == [("dahl_friction", "strut")]
    assert {name for name, *_ in found.effects[0].alternatives} <= {"lugre_friction"}
    told = {name: value for name, (value, _) in found.effects[0].parameters.items()}
    assert told == pytest.approx({"fc": 6.0, "x0": 6e-5}, rel=0.01)


@pytest.mark.parametrize(
    "name", [*(pytest.param(f"{kind}/none", marks=pytest.mark.search) for kind in ("damper", "motor")), "tank/none"]
)
def test_nothing_hidden_is_nothing_missing(discovered, name):
    found = discovered(name)
    assert (found.verdict, found.effects) == ("none", ())


@pytest.mark.search
def test_a_parameter_that_is_off_is_no_effect(discovered):
    found = discovered("damper/parameter")
    assert (found.verdict, [e.name for e in found.effects]) == ("parameter", ["k"])
    assert found.effects[0].parameters["k"][0] == pytest.approx(1300.0, rel=1e-4)


@pytest.mark.search
def test_an_offset_may_be_of_the_component_or_of_the_sensor(discovered):
    found = discovered("damper/constant_force")
    last = found.effects[-1]
    told = {(last.name, last.on), *((name, on) for name, on, _ in last.alternatives)}
    assert found.verdict == "ambiguous"
    assert told >= {("constant_force", "strut"), ("sensor_offset", "F")}
    assert not found.next_experiment.separates  # they are the same
    d, v = found.next_experiment.commands.T
    assert np.abs(np.gradient(d) * components.RATE - v).max() < 1e-9  # the bench moves it: v is the rate of d


@pytest.mark.parametrize("name", EACH_NAMED)
def test_the_extended_model_simulates_the_record(discovered, folder, name):
    discovered(name)
    plant = folder / name / "found" / "plant.yaml"
    registry.check_plant_file(plant)
    twin = Twin.load(plant)
    Model(twin.base).validate()
    record = Data.read(folder / name / "valid.csv", twin)
    noise = components.NOISE * np.sqrt((record.readings**2).mean())
    if name == "motor/dry_friction":
        record = record.first(0.3)  # friction that holds takes thousands of steps between samples
    made = simulate(twin, record)
    assert np.sqrt((made.residual**2).mean()) < 1.15 * noise


def test_where_is_told_at_outputs_and_states(discovered, folder):
    discovered("damper/dry_friction")
    told = json.loads((folder / "damper/dry_friction/found/discovery.json").read_text())["localisation"]["latent_force"]
    assert (told["coordinates"], list(told["places"])) == ({"F": 1.0}, ["strut"])
    assert told["places"]["strut"]["energy"]["rate"] > 0.9
    # its mean product with the rate is fc |v|
    speed = np.abs(components.Motion.of(1, 5e-3).rate(np.arange(20_000) / 1e3)).mean()
    assert told["places"]["strut"]["loss"] == pytest.approx(0.4 * speed, rel=0.02)
    discovered("tank/hardening_spring")
    told = json.loads((folder / "tank/hardening_spring/found/discovery.json").read_text())["localisation"][
        "latent_force"
    ]
    assert (told["coordinates"], list(told["places"])) == ({"level": 1.0}, ["valve"])


@pytest.mark.search
def test_the_command_line_renames_columns(folder, capsys):
    out = folder / "renamed"
    names = {"t": "time", "d": "stroke", "v": "speed", "F": "load"}
    for seed, part in ((1, "train"), (2, "valid")):
        components.save(RECORDS["damper/hardening_spring"](seed), folder / f"{part}.csv", names)
    arguments = ["--model", str(folder / "damper.yaml"), "--map", "t=time,d=stroke,v=speed,F=load", "--out", str(out)]
    assert main(["discover", str(folder / "train.csv"), "--validate", str(folder / "valid.csv"), *arguments]) == 0
    assert capsys.readouterr().out.startswith("Hardening spring in strut, k3 = ")
    assert (out / "discovery.html").exists()


@pytest.mark.search
def test_an_extended_component_is_identified_and_looked_at_again(discovered, folder):
    discovered("damper/dahl_friction")
    found = folder / "damper/dahl_friction" / "found"
    record, valid = (folder / "damper/dahl_friction" / f"{part}.csv" for part in ("train", "valid"))
    names = ("k", "c", "dahl_friction_fc", "dahl_friction_x0")
    fit = masking.identify(record, plant=found / "plant.yaml", parameters=names, validation=[valid])
    assert dict(zip(names, fit.values, strict=True)) == pytest.approx(
        {"k": 1010.0, "c": 19.8, "dahl_friction_fc": 0.6, "dahl_friction_x0": 3e-4}, rel=2e-3
    )
    again = masking.discover(record, plant=found / "plant.yaml", validation=valid)
    assert again.verdict == "none"


def test_a_motor_is_identified_with_its_initial_speed(folder):
    components.save(components.motor(0.0, SECONDS, 1), folder / "free.csv")
    (folder / "rig.yaml").write_text("name: rig\nmodel: motor.yaml\nsensors: {speed: {measures: speed, unit: rad/s}}\n")
    fit = masking.identify(folder / "free.csv", plant=folder / "rig.yaml", parameters=("kt", "b"))
    told = [components.KT / components.J * 0.01, components.B / components.J * 0.01]  # J as it is declared
    assert fit.values == pytest.approx(told, rel=1e-3)
    with pytest.raises(
        ModelError, match="motor has no coordinates, whose motion the filter follows; take the method l"
    ):
        masking.identify(folder / "free.csv", plant=folder / "rig.yaml", parameters=("kt",), method="kalman")


def test_laws_are_tried_where_they_find_what_they_follow(folder):
    effects = masking.model.effects.EFFECTS
    taken = {}
    for name in MODELS:
        (place,) = places(registry.load_model(folder / f"{name}.yaml"))
        taken[name] = {
            effect for effect in effects if effects[effect].where == "element" and place.takes(effects[effect])
        }
    assert {"dry_friction", "hysteresis", "hardening_spring", "stop"} < taken["damper"]
    assert taken["motor"] >= {"dry_friction", "viscous_damping", "dahl_friction", "constant_force"}
    assert not taken["motor"] & {"hardening_spring", "linear_spring", "stop", "backlash", "local_friction"}
    assert taken["tank"] >= {"hardening_spring", "polynomial_spring", "constant_force"}
    assert not taken["tank"] & {"dry_friction", "viscous_damping", "hysteresis", "stop"}


def test_of_laws_that_stick_a_bench_has_those_that_no_force_need_move(folder):
    twin = discovery_inputs.rig(folder / "damper.yaml")
    rig, span = AugmentedModel(twin, ("k", "c")), Span(-5e-3, 5e-3, 5e-3, 0.1)
    spans = defaultdict(lambda: span)
    sticking = {one.effect for one in candidates(rig, spans, 2e-3) if one.sticks}
    assert "play_with_friction" in sticking
    assert not sticking & {"dry_friction", "stribeck_friction", "stop"}


def test_every_state_of_a_model_of_nothing_else_is_a_place(tmp_path):
    (tmp_path / "two.yaml").write_text(
        "name: two\nstates: {a: '', b: ''}\ninputs: {u: ''}\nequations: {\"a'\": u - a, \"b'\": a - b}\n"
    )
    twin = discovery_inputs.rig(tmp_path / "two.yaml", None)
    assert (degrees(twin.base), twin.sensors) == (("a", "b"), ("a", "b"))
    assert [place.name for place in places(twin.base)] == ["a", "b"]


def test_an_effect_that_an_element_has_no_motion_for_is_refused(folder):
    models = {name: load_model(folder / f"{name}.yaml") for name in MODELS}
    with pytest.raises(
        DeclarationError, match="'dry_friction' follows a rate, and that of 'valve' is not known from coo"
    ):
        models["tank"].attach("dry_friction", "valve", fc=1.0)
    with pytest.raises(DeclarationError, match="follows a displacement, and 'shaft' has none; give elements"):
        models["motor"].attach("hardening_spring", "shaft", k3=1.0)
    with pytest.raises(
        DeclarationError, match="follows an acceleration, and that of 'strut' is not known; an inertia ne"
    ):
        models["damper"].attach("added_mass", "strut", m=1.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "displacement: d, rate: v, unit: N, acts: {G: 1}",
            r"acts\.G: 'G' is not a coordinate or an output; allowed: F",
        ),
        ("unit: N, acts: {F: 1}", "elements.strut: an element needs a displacement, or a rate"),
        ("displacement: k, unit: N, acts: {F: 1}", "a displacement must contain a coordinate or an input"),
        ("displacement: d, rate: d, unit: N, acts: {F: 1}", "the rate of this displacement is in m/s, not in m"),
        ("displacement: d, rate: v, unit: N/m, acts: {F: 1}", "the force in N/m must be multiplied by m to act here"),
    ],
)
def test_an_element_that_does_not_fit_is_refused(tmp_path, text, message):
    path = tmp_path / "wrong.yaml"
    path.write_text(DAMPER.replace("displacement: d, rate: v, unit: N, acts: {F: 1}", text))
    with pytest.raises(DeclarationError, match=message):
        load_model(path).validate()


def test_a_loop_is_not_closed_around_a_component(folder):
    (folder / "bench.yaml").write_text("name: bench\nmodel: damper.yaml\nsensors: {F: {measures: F, unit: N}}\n")
    with pytest.raises(
        DeclarationError, match="of the plant has no coordinates: there is no motion to close a loop aro"
    ):
        masking.run("duffing", plant=str(folder / "bench.yaml"))
    with pytest.raises(ModelError, match="bench: its sensors read at once what is commanded"):
        SimulatedPlant(Twin.load(folder / "bench.yaml"))


def test_a_component_without_elements_is_refused(tmp_path):
    (tmp_path / "bare.yaml").write_text(DAMPER.partition("elements")[0])
    with pytest.raises(
        DeclarationError, match="damper on a test bench has no place for a force; declare where one may s"
    ):
        places(registry.load_model(tmp_path / "bare.yaml"))
