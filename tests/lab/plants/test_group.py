"""Several plants in one experiment: normal modes of two carts with a virtual spring, and runs on plants apart."""

from functools import cache

import numpy as np
import pytest
import yaml
from scipy import linalg

import masking
from masking.app.cli import main
from masking.control.rig.twin import Twin
from masking.errors import DeclarationError, ModelError, PlantMismatchError
from masking.lab.plants import adapters
from masking.lab.plants.conformance import check
from masking.lab.plants.group import PlantGroup, connect_each
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.runs import rig_run
from masking.lab.runs.experiment import Experiment
from masking.model.declaration import registry
from masking.model.declaration.composition import Part, compose
from masking.model.modelling.model import Model
from tests.lab.runs.test_rig_run import serving

pytestmark = pytest.mark.realtime

W0, WC, FIRST = 10.0, 3.0, 0.01


def beats(t):
    """Two equal masses, the first at 0.01 m: the mean of the normal modes in and against each other."""
    slow, fast = np.cos(W0 * t), np.cos(np.sqrt(W0**2 + 2 * WC**2) * t)
    return FIRST / 2 * np.column_stack([slow + fast, slow - fast])


def relative(found, expected):
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


@cache
def carts():
    return Experiment.load("two_carts").changed(duration=2)


@cache
def offline():
    return carts().run()


def carts_in(recording):
    return np.column_stack([recording["rig.a_x"], recording["rig.b_x"]])


def test_two_carts_move_as_two_masses_with_a_spring_between_them():
    still = dict.fromkeys(("a_friction", "b_friction"), False)
    exact = carts().changed(controller={"rate": "continuous"}, duration=10, effects=still)
    run = exact.run()
    assert relative(carts_in(run), beats(run.t)) < 1e-8
    assert relative(carts_in(offline()), beats(offline().t)) < 0.05
    assert offline().names("sensor") == ("a_encoder", "b_encoder")


def test_a_controller_may_be_wrong_about_one_of_the_plants():
    """With 0.9 of the mass of b, it gives b 0.9 of what it should."""
    settings = {"rate": "continuous", "parameters": {"b_m": 0.45}}
    run = carts().changed(controller=settings, effects=dict.fromkeys(("a_friction", "b_friction"), False)).run()
    spring = np.array([[W0**2 + WC**2, -(WC**2)], [-(WC**2), W0**2 + WC**2]])
    rate = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag([1.0, 0.9]) @ spring, np.zeros((2, 2))]])
    expected = [(linalg.expm(t * rate) @ [FIRST, 0.0, 0.0, 0.0])[:2] for t in run.t]
    assert relative(carts_in(run), expected) < 1e-8


def test_steps_of_two_plants_together_are_the_run_offline():
    twin = Twin.load("cart")
    group = PlantGroup({"a": SimulatedPlant(twin), "b": SimulatedPlant(twin)})
    found = rig_run.run(carts(), group, rig_run.RunSettings(lockstep=True))
    for name in ("sensor.a_encoder", "sensor.b_encoder", "input.a_u", "input.b_u"):
        assert np.abs(found[name] - offline()[name]).max() <= 1e-9 * np.abs(offline()[name]).max(), name


def test_one_plant_is_in_another_process_and_one_in_this():
    with serving("cart", "--lockstep") as (_, address):
        group = PlantGroup({"a": SimulatedPlant(Twin.load("cart")), "b": adapters.connect(address)})
        assert group.owns_clock
        found = rig_run.run(carts(), group, rig_run.RunSettings(lockstep=True))
    assert found["input.b_u"].tolist() == pytest.approx(offline()["input.b_u"].tolist(), rel=1e-9, abs=1e-12)
    assert found.manifest["rig"]["end"] == "finished"


def test_in_real_time_one_plant_is_simulated_here_and_one_has_a_clock_of_its_own():
    """The one with a clock does not wait: where a sample of it is missed, the simulated one is late by it."""
    with serving("cart") as (_, address):
        group = PlantGroup({"a": SimulatedPlant(Twin.load("cart")), "b": adapters.connect(address)})
        found = rig_run.run(carts(), group)
    assert found.manifest["mode"] == "real time"
    assert found.manifest["rig"]["end"] == "finished"
    assert found.t[-1] == pytest.approx(2.0, abs=0.02)
    assert relative(carts_in(found), beats(found.t)) < 0.1


def test_each_plant_has_an_address_of_its_own_on_the_command_line(tmp_path):
    file = tmp_path / "short.yaml"
    declared = {**Experiment.load("two_carts").declaration.canonical(), "duration": 1}
    file.write_text(yaml.safe_dump(declared))
    with serving("cart", "--lockstep") as (_, a), serving("cart", "--lockstep") as (_, b):
        plants = ["--plant", f"b={b}", "--plant", f"a={a}"]
        assert main(["rig", "run", str(file), *plants, "--lockstep", "--out", str(tmp_path / "out")]) == 0


@pytest.mark.parametrize(
    ("addresses", "names", "said"),
    [
        (["udp://h:1"], ("a", "b"), "several plants; give --plant a=ADDRESS --plant b=ADDRESS"),
        (["a=udp://h:1", "a=udp://h:2"], ("a", "b"), "several plants; give"),
        (["a=udp://h:1", "c=udp://h:2"], ("a", "b"), "several plants; give"),
        (["a=udp://h:1", "b=udp://h:2"], (), "the experiment has one plant; give its address"),
    ],
)
def test_addresses_that_are_not_those_of_the_plants_are_refused(addresses, names, said):
    with pytest.raises(PlantMismatchError, match=said):
        connect_each(addresses, names)


def test_a_group_keeps_the_rules_of_a_plant():
    twin = Twin.load("cart")
    assert not check(lambda: PlantGroup({"a": SimulatedPlant(twin), "b": SimulatedPlant(twin)}))


# Composition.


def part(name, plant):
    declared = registry.load_plant(plant)
    return Part(name, declared, registry.load_model(declared.model, registry.refer(declared, "model")))


def test_models_together_move_as_each_by_itself():
    """Two set-ups with definitions, parameters that are expressions, elements and scales: nothing connects them."""
    rig = part("p", "tue_rig")
    _, both = compose([rig, Part("q", rig.plant, rig.model)])
    times, start = np.linspace(0.0, 30.0, 20), {"x1": 0.3, "x2": -0.2, "x3": 0.0, "x3'": 0.1}
    rest = dict.fromkeys(("p_x1", "p_x2", "p_x3"), 0.0)
    alone = Model(rig.model).simulate(times, start)
    whole = Model(both).simulate(times, rest | {f"q_{name}": value for name, value in start.items()})
    for name in ("x1", "x2", "x3"):
        np.testing.assert_allclose(whole[f"q_{name}"], alone[name], rtol=0, atol=1e-8)
        assert not whole[f"p_{name}"].any()


LAGRANGIAN = """
name: swing
coordinates: {x: angle}
inputs: {u: torque}
parameters: {g: 9.81}
lagrangian: x'**2/2 + g*cos(x)
forces: {x: u}
"""


def written(folder, **plants):
    (folder / "swing.yaml").write_text(LAGRANGIAN)
    for name, content in plants.items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump({"name": name, "sensors": {"s": "x"}, **content}))
    return [folder / f"{name}.yaml" for name in plants]


def test_lagrangians_are_added_up(tmp_path):
    (file,) = written(tmp_path, swing_rig={"model": "swing.yaml"})
    _, model = compose([part("a", file), part("b", file)])
    assert model.lagrangian.text == "(a_x'**2/2 + a_g*cos(a_x)) + (b_x'**2/2 + b_g*cos(b_x))"
    assert model.forces["b_x"].text == "b_u"


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({"model": "swing.yaml"}, "one has a Lagrangian, one equations of motion; write both in the same way"),
        (
            {"model": "cart", "effects": {"delay": {"effect": "delay", "parameters": {"samples": 2}}}},
            "effects of the loop: not those of a; plants in one loop share them; write the same into late and cart",
        ),
        (
            {"model": "cart", "actuators": {"coil": {"unit": "A"}}, "allocation": {"u": "coil"}},
            "cart declares no actuators, late does; write actuators and allocation into both",
        ),
    ],
)
def test_plants_that_do_not_go_together_are_refused(tmp_path, other, said):
    (file,) = written(tmp_path, late=other)
    with pytest.raises(DeclarationError, match=said):
        compose([part("a", "cart"), part("b", file)])


def test_one_loop_misses_no_more_than_each_plant_bears(tmp_path):
    limits = {"inputs": {"u": {"max": 2, "unit": "A"}}, "missed": 0.05}
    effects = {"delay": {"effect": "delay", "parameters": {"samples": 1}}}
    (file,) = written(tmp_path, steady={"model": "cart", "limits": limits, "effects": effects})
    plant, _ = compose([part("a", "cart"), part("b", file)])
    assert plant.limits.missed == 0.05


def test_names_that_are_the_same_are_refused():
    with pytest.raises(DeclarationError, match="'a_x' of a is also that of another plant; give the plants other names"):
        compose([part("a", "cart"), part("a", "cart")])


@pytest.mark.parametrize(
    ("plants", "said"),
    [
        ("plant: cart\nplants: {a: cart, b: cart}", "plants: plant and plants are both given; name one plant with"),
        ("plants: {a: cart}", "plants: plants are at least two"),
        ("plants: {}", "plant: the key 'plant' is missing; name one plant with plant, or several with plants"),
        ("plants: {a: cart, b: cat}", "plants.b: there is no plant 'cat'; did you mean 'cart'"),
    ],
)
def test_what_an_experiment_says_of_its_plants_is_checked(tmp_path, plants, said):
    file = tmp_path / "run.yaml"
    file.write_text(f"name: run\n{plants}\nvirtual: two_masses\nduration: 1\n")
    with pytest.raises(DeclarationError, match=said):
        Experiment.load(file)


def test_each_plant_is_refined_by_itself():
    with pytest.raises(ModelError, match="has several plants: refine each in an experiment of its own"):
        masking.refine("two_carts", record="none.csv")
