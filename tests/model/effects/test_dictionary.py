"""Effects of one's own: found in records, declared in plants, and refused with the line and what to do about it.

Records are made here, by Runge and Kutta's method of order 4 in plain arithmetic.
"""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import masking
from masking.app.cli import main
from masking.app.workflows import discovery_inputs
from masking.compile.codegen import module_store
from masking.control.rig.twin import Twin
from masking.errors import DeclarationError
from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.candidates import candidates
from masking.lab.runs.error_budget import causes
from masking.model import effects
from masking.model.declaration import registry
from masking.model.declaration.dictionary_checks import factors
from masking.model.declaration.schema import OwnEffect
from masking.model.effects import EFFECTS, Effect, EffectParameter, Span
from masking.model.modelling.model import load_model
from masking.reports import discovery_text, model_files

RATE, SECONDS, SUBSTEPS = 500.0, 12.0, 4
K, C = 400.0, 4.0  # of the leaf, per mass
MAGNET = {"f0": 0.8, "x0": 0.02}
RIPPLE = {"a": 4e-5, "p": 1e-3}
START = -2.6e-3  # m, near rest beside the magnet
NOISE = 6e-6  # m
HIDDEN = {"magnet": {"magnet": MAGNET}, "ripple": {"ripple": RIPPLE}}

MODEL = """
name: leaf
coordinates: {x: {meaning: displacement, unit: m}}
inputs: {u: {meaning: force per mass, unit: m/s**2}}
parameters:
  k: {value: 402, unit: 1/s**2, meaning: stiffness}
  c: {value: 3.98, unit: 1/s, meaning: damping}
equations: {"x''": u - k*x - c*x'}
elements:
  leaf: {displacement: x, unit: m/s**2, acts: {x: -1}}
"""
DICTIONARY = """\
name: effects of our lab
dictionary:
  magnet:
    meaning: A magnet beside the leaf pulls it in.
    where: element
    expression: f0*(x0/(x0 + d))**2
    parameters:
      f0: {unit: F, meaning: force at rest}
      x0: {unit: D, meaning: distance at rest, bounds: [1e-6, null], tried: [1.2, 2, 4]}
  ripple:
    meaning: The scale of the encoder repeats its error.
    where: sensor
    expression: s + a*sin(2*pi*s/p)
    parameters:
      a: {unit: S, meaning: size}
      p: {unit: S, meaning: period, bounds: [1e-9, null], tried: [0.1, 0.2, 0.4, 0.8]}
    remedy: calibrate the scale over one period
"""
PLANT = """
name: leaf
model: ../leaf.yaml
sensors: {x: {measures: x, unit: m}}
own_effects: lab/own.yaml
effects:
  pull: {effect: magnet, at: leaf, parameters: {f0: 0.8, x0: 0.02}}
  error: {effect: ripple, at: x, parameters: {a: 4e-5, p: 1e-3}}
"""

MAGNET_ENTRY = Effect(
    "magnet",
    "A magnet beside the leaf pulls it in.",
    "f0*(x0/(x0 + d))**2",
    {
        "f0": EffectParameter("F", "force at rest"),
        "x0": EffectParameter("D", "distance at rest", bounds=(1e-6, None), tried=(1.2, 2.0, 4.0)),
    },
    label="pull of a magnet",
    family="springs",
)


def record(seed, magnet=None, ripple=None):
    """Return times, inputs, and what is read without noise of the leaf with what is hidden in it."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(RATE * SECONDS)) / RATE
    u = np.cos(2.0 * np.pi * np.outer(t, np.linspace(0.3, 8.0, 60)) + rng.uniform(0.0, 2.0 * np.pi, 60)).sum(axis=1)
    u *= 0.9 / np.abs(u).max()

    def slope(x, v, force):
        pull = magnet["f0"] * (magnet["x0"] / (magnet["x0"] + x)) ** 2 if magnet else 0.0
        return v, force - K * x - C * v - pull

    x, v, h, found = START if magnet else 0.0, 0.0, 1.0 / (RATE * SUBSTEPS), []
    for force in u:
        found.append(x)
        for _ in range(SUBSTEPS):
            a = slope(x, v, force)
            b = slope(x + 0.5 * h * a[0], v + 0.5 * h * a[1], force)
            c = slope(x + 0.5 * h * b[0], v + 0.5 * h * b[1], force)
            d = slope(x + h * c[0], v + h * c[1], force)
            x += h / 6.0 * (a[0] + 2.0 * b[0] + 2.0 * c[0] + d[0])
            v += h / 6.0 * (a[1] + 2.0 * b[1] + 2.0 * c[1] + d[1])
    read = np.array(found)
    if ripple:
        read += ripple["a"] * np.sin(2.0 * np.pi * read / ripple["p"])
    return t, u, read


def readings(twin, u, start):
    """Return what a twin of the leaf reads under held inputs, without noise, from a displacement in m."""
    y, p, found = twin.rest(np.array([start])), twin.values(), np.zeros((len(u), 1))
    for i, force in enumerate(u):
        twin.kernels.sense(i / RATE, y, p, np.zeros(1), found[i])
        twin.kernels.advance(i / RATE, y, np.array([force]), p, 1.0 / RATE, SUBSTEPS)
    return found[:, 0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("own")
    (out / "rig" / "lab").mkdir(parents=True)
    (out / "leaf.yaml").write_text(MODEL)
    (out / "rig" / "lab" / "own.yaml").write_text(DICTIONARY)
    (out / "rig" / "plant.yaml").write_text(PLANT)
    for seed, (name, what) in enumerate(HIDDEN.items()):
        t, u, read = record(seed, **what)
        read += NOISE * np.random.default_rng(seed).normal(size=len(t))
        np.savetxt(out / f"{name}.csv", np.column_stack([t, u, read]), header="t,u,x", delimiter=",", comments="")
    return out


@pytest.fixture(scope="module")
def own(folder):
    return folder / "rig" / "lab" / "own.yaml"


@pytest.fixture(scope="module")
def magnet(folder, own):
    """Return what is found in the record with a magnet, and where it is written."""
    out = folder / "found" / "magnet"
    return masking.discover(folder / "magnet.csv", model=folder / "leaf.yaml", effects=own, out=out), out


def write(path, text):
    path.write_text(text)
    return path


def problems(path):
    """Return what `masking check` says of a file, without its name."""
    (checked,) = masking.check(path)
    return [str(problem).partition(f"{path.name}:")[2] for problem in checked.problems]


class TestDiscovery:
    @pytest.mark.search
    def test_without_its_dictionary_it_gets_other_names(self, folder):
        found = masking.discover(folder / "magnet.csv", model=folder / "leaf.yaml")
        assert found.effects
        assert not {effect.name for effect in found.effects} & {"magnet", "ripple"}

    def test_with_its_dictionary_it_is_named(self, magnet):
        found, _ = magnet
        (effect,) = found.effects
        assert (found.verdict, effect.name, effect.on) == ("named", "magnet", "leaf")
        for name, truth in MAGNET.items():
            value, std = effect.parameters[name]
            assert value == pytest.approx(truth, rel=0.02)
            assert abs(value - truth) < 4.0 * std
        assert found.simulation_error.validation[1]["x"] < 1.1 * found.simulation_error.validation_noise_floor["x"]

    @pytest.mark.search
    def test_a_law_is_one_entry_also_in_the_dictionary_of_the_package(self, folder, own, magnet, monkeypatch):
        for entry in (MAGNET_ENTRY, effects.load(own)["ripple"]):  # in this order its kernels are those of the file's
            monkeypatch.setitem(EFFECTS, entry.name, entry)
        found = masking.discover(folder / "magnet.csv", model=folder / "leaf.yaml")
        (effect,) = found.effects
        assert (found.verdict, effect.name, effect.on) == ("named", "magnet", "leaf")
        assert effect.parameters == magnet[0].effects[0].parameters
        assert discovery_text.sentence(found).startswith("Pull of a magnet in leaf, f0 = ")

    def test_the_model_that_is_written_needs_no_dictionary(self, magnet):
        _, out = magnet
        model, plant = out / "models" / "leaf+magnet.yaml", out / "plant.yaml"
        assert [one.problems for one in masking.check(model, plant)] == [(), ()]
        assert "own_effects" not in plant.read_text()
        _, u, truth = record(2, **HIDDEN["magnet"])
        np.testing.assert_allclose(readings(Twin.load(plant), u, START), truth, atol=NOISE)
        page = (out / "discovery.html").read_text()
        assert "A magnet beside the leaf pulls it in." in page
        assert "force at rest" in page

    def test_a_plant_that_is_written_names_the_dictionary(self, folder, own, capsys):
        out = folder / "found" / "ripple"
        arguments = [str(folder / "ripple.csv"), "--model", str(folder / "leaf.yaml"), "--effects", str(own)]
        assert main(["discover", *arguments, "--out", str(out)]) == 0
        assert "ripple: The scale of the encoder repeats its error.; what helps: calibrate" in capsys.readouterr().out
        told = json.loads((out / "discovery.json").read_text())
        (effect,) = told["effects"]
        assert (told["verdict"], effect["name"], effect["on"]) == ("named", "ripple", "x")
        for name, truth in RIPPLE.items():
            assert effect["parameters"][name]["value"] == pytest.approx(truth, rel=0.02)
        plant = registry.load_plant(out / "plant.yaml")
        assert plant.own_effects == ("../../rig/lab/own.yaml",)
        assert [one.problems for one in masking.check(told["model"], told["plant"])] == [(), ()]
        _, u, truth = record(2, **HIDDEN["ripple"])
        np.testing.assert_allclose(readings(Twin.load(out / "plant.yaml"), u, 0.0), truth, atol=NOISE)

    def test_a_dictionary_that_is_not_there(self, folder, capsys):
        assert main(["discover", str(folder / "magnet.csv"), "--model", "setup", "--effects", "nowhere.yaml"]) == 2
        assert "there is no file nowhere.yaml; a dictionary of effects is a .yaml file" in capsys.readouterr().err
        assert main(["refine", "duffing_sampled", "--record", str(folder), "--effects", "setup"]) == 2
        assert "setup is a model; a dictionary of effects is needed here" in capsys.readouterr().err

    def test_what_is_tried_is_part_of_the_motion(self, folder, own):
        twin = discovery_inputs.with_effects(discovery_inputs.rig(folder / "leaf.yaml", None), own)
        span = Span(-2e-3, 1e-3, 2e-3, 0.03)
        spans = dict.fromkeys([("element", "leaf"), ("sensor", "x"), ("actuator", "u")], span)
        found = {c.key: c for c in candidates(AugmentedModel(twin, ("k", "c")), spans, 2e-3)}
        made = found["magnet", "leaf"]
        assert [instance.values for instance in made.instances] == [(0.0, part * 2e-3) for part in (1.2, 2.0, 4.0)]
        assert (made.factors, made.free) == ((0,), (0, 1))
        assert ("ripple", "x") in found


class TestPlants:
    def test_a_plant_has_effects_of_its_own(self, folder):
        plant = folder / "rig" / "plant.yaml"
        assert problems(plant) == []
        twin = Twin.load(plant).with_parameters({"k": K, "c": C})
        _, u, truth = record(2, magnet=MAGNET, ripple=RIPPLE)
        np.testing.assert_allclose(readings(twin, u, START), truth, atol=1e-9)

    def test_nothing_is_registered_anywhere(self, folder, own):
        changed = write(folder / "changed.yaml", DICTIONARY.replace("s + a*sin", "s - a*sin"))
        plants = [PLANT.replace("../leaf", "leaf").replace("lab/own.yaml", str(file)) for file in (own, changed)]
        before, after = (Twin.load(write(folder / "plant.yaml", plant)) for plant in plants)
        assert not {"magnet", "ripple"} & EFFECTS.keys()
        assert module_store.key({"twin": before.structure()}) != module_store.key({"twin": after.structure()})
        read = []
        for twin in (before, after):
            found = np.zeros(1)
            twin.kernels.sense(0.0, np.array([2.5e-4, 0.0]), twin.values(), np.zeros(1), found)
            read += [float(found[0])]
        assert read == pytest.approx([2.5e-4 + RIPPLE["a"], 2.5e-4 - RIPPLE["a"]])

    def test_an_effect_without_a_family_has_a_row_of_its_own_in_the_error_budget(self, folder):
        twin = Twin.load(folder / "rig" / "plant.yaml")
        assert causes(twin) == {"magnet": ("pull",), "ripple": ("error",)}
        lab = write(folder / "lab.yaml", DICTIONARY.replace("    where: e", "    family: springs\n    where: e"))
        plant = write(folder / "sprung.yaml", PLANT.replace("../leaf", "leaf").replace("lab/own.yaml", str(lab)))
        assert causes(Twin.load(plant)) == {"springs": ("pull",), "ripple": ("error",)}

    def test_it_is_attached_to_a_model(self, folder, own):
        made = load_model(folder / "leaf.yaml").attach(effects.load(own)["magnet"], "leaf", **MAGNET)
        made.validate()
        assert made.declaration.parameters["leaf_magnet_x0"].unit == "m"
        with pytest.raises(DeclarationError, match=r"'magnet' needs values; give x0 in m \(distance at rest\)"):
            load_model(folder / "leaf.yaml").attach(effects.load(own)["magnet"], "leaf", f0=1.0)

    def test_a_dictionary_is_named_once_or_twice(self, folder, own):
        plant = registry.load_plant(folder / "rig" / "plant.yaml")
        assert registry.with_dictionary(plant, own) is plant
        assert list(plant.files) == [str(folder / "rig" / "plant.yaml"), str(own)]
        other = write(folder / "other.yaml", DICTIONARY)
        with pytest.raises(DeclarationError) as caught:
            discovery_inputs.with_effects(Twin.load(folder / "rig" / "plant.yaml"), other)
        assert f"{other}:3:3: dictionary.magnet: the effect 'magnet' is in another dictionary" in str(caught.value)

    def test_a_fitted_plant_names_its_dictionary(self, folder):
        twin = Twin.load(folder / "rig" / "plant.yaml")
        made = model_files.fitted_plant(SimpleNamespace(twin=twin, names=(), values=(), std=()), folder / "results")
        assert made["own_effects"] == ["../rig/lab/own.yaml"]

    @pytest.mark.parametrize(
        ("old", "new", "expected"),
        [
            ("lab/own.yaml", "own.yaml", "5:14: own_effects: there is no file own.yaml; a dictionary of effects is a"),
            ("lab/own.yaml", "../leaf.yaml", "5:14: own_effects: ../leaf.yaml is a model; a dictionary of effects is"),
            ("effect: ripple", "effect: riple", "8:19: effects.error.effect: there is no effect 'riple'; did you mean"),
            ("at: x", "at: leaf", "8:31: effects.error.at: 'leaf' is no sensor of leaf; allowed: x"),
            ("f0: 0.8, ", "", "7:3: effects.pull: the effect magnet needs f0 [F]"),
        ],
    )
    def test_mistakes_in_a_plant(self, folder, old, new, expected):
        path = write(folder / "rig" / "bad.yaml", PLANT.replace(old, new))
        assert problems(path)[0].startswith(expected)


class TestDictionaries:
    def test_it_is_checked_and_shown(self, own, capsys):
        assert main(["check", str(own)]) == 0
        assert "a sound dictionary" in capsys.readouterr().out
        assert main(["show", str(own)]) == 0
        told = capsys.readouterr().out
        for words in ("effects of our lab", "in an element: f0*(x0/(x0 + d))**2", "a factor", "tried: 1.2, 2, 4"):
            assert words in told

    @pytest.mark.parametrize(
        ("old", "new", "expected"),
        [
            ("magnet:", "dry_friction:",
             "3:3: dictionary.dry_friction: the effect 'dry_friction' comes with the package, see 'masking show "
             "dry_friction'; choose another name"),
            ("where: element", "where: loop", "5:12: dictionary.magnet.where: must be 'element', 'sensor' or 'actu"),
            (", tried: [1.2, 2, 4]", "",
             "9:7: dictionary.magnet.parameters.x0: 'x0' is no factor of what the effect does; give values that a "
             "discovery begins from, such as 'tried: [0.1, 0.3, 1]', or a 'value' to hold"),
            ("f0", "f", "8:7: dictionary.magnet.parameters.f: the name 'f' is taken in an effect; choose another, su"),
            ("x0 + d)", "x0 + e)", "6:30: dictionary.magnet.expression: unknown symbol 'e'; allowed: d, d_rate, t, f"),
            ("x0 + d)", "x0 + d", "6:20: dictionary.magnet.expression: '(' is never closed"),
            ("x0 + d)", "d - d)", "6:21: dictionary.magnet.expression: is not finite"),
            ("x0 + d)", "x0 + d_rate)", "6:25: dictionary.magnet.expression: adds D/s to D"),
            ("f0*(x0", "f0*d*(x0", "6:17: dictionary.magnet.expression: the force is F, the expression D*F"),
            ("unit: F,", "unit: N,",
             "8:18: dictionary.magnet.parameters.f0.unit: 'N' is no unit here; units of an element are made of F, D "
             "and s, such as F/D"),
            ("meaning: A", "meening: A", "4:5: dictionary.magnet.meaning: the key 'meaning' is missing"),
            ("bounds: [1e-6, null]", "bounds: [2, 1]",
             "9:56: dictionary.magnet.parameters.x0.bounds: the lower bound 2 is above the upper bound 1"),
            ("tried: [1.2, 2, 4]", "value: 0",
             "9:77: dictionary.magnet.parameters.x0.value: 0 is below its lower bound 1e-06"),
            ("tried: [1.2, 2, 4]", f"tried: {[*range(61)]}",
             "7:5: dictionary.magnet.parameters: 61 combinations of values to try are too many; try at most 60"),
            ("f0: {unit: F,", "k: {value: 1}\n      f0: {unit: F,",
             "8:7: dictionary.magnet.parameters.k: the parameter 'k' is not used; remove it or use it"),
            ("    parameters:\n      f0", "    states: {" + "".join(f"{z}: {{rate: d_rate, unit: D}}, " for z in "xyz")
             + "}\n    parameters:\n      f0",
             "7:5: dictionary.magnet.states: 3 states are too many; an effect has at most 7 parameters and 2 states"),
            ("    parameters:\n      f0", "    parameters:\n" + "".join(f"      p{i}: 1\n" for i in range(5))
             + "      f0", "8:11: dictionary.magnet.parameters.p0: must be a mapping"),
            ("f0: {unit: F,", "".join(f"p{i}: {{value: 1}}\n      " for i in range(6)) + "f0: {unit: F,",
             "7:5: dictionary.magnet.parameters: 8 parameters are too many; an effect has at most 7 parameters and 2"),
            ("    where: e", "    family: sprigs\n    where: e",
             "5:13: dictionary.magnet.family: there is no family 'sprigs'; did you mean 'springs'?"),
            ("    where: e", "    nested: dry_fricton\n    where: e",
             "5:13: dictionary.magnet.nested: there is no effect 'dry_fricton'; did you mean 'dry_friction'?"),
            ("    where: e", "    nested: [ripple]\n    where: e",
             "5:13: dictionary.magnet.nested: 'ripple' cannot be nested in 'magnet'; remove it"),
            ("dictionary:", "dictionary: {}\nno:", "2:13: dictionary: the dictionary is empty; declare an effect in"),
        ],
    )  # fmt: skip
    def test_mistakes(self, tmp_path, old, new, expected):
        text = DICTIONARY.replace(old, new)
        assert text != DICTIONARY
        assert problems(write(tmp_path / "bad.yaml", text))[0].startswith(expected)

    def test_an_entry_of_a_file_has_the_form_of_the_package_s(self, tmp_path):
        text = DICTIONARY.replace("    where: e", "    label: pull of a magnet\n    family: springs\n    where: e")
        assert effects.load(write(tmp_path / "own.yaml", text))["magnet"] == MAGNET_ENTRY

    def test_simpler_effects_are_nested_in_it(self, tmp_path):
        text = DICTIONARY.replace("    where: e", "    nested: [linear_spring, hardening_spring]\n    where: e")
        assert effects.load(write(tmp_path / "own.yaml", text))["magnet"].nested == (
            "linear_spring",
            "hardening_spring",
        )

    def test_rates_and_sizes_of_states_have_units(self, tmp_path):
        states = "    states: {z: {rate: d_rate*z/x0, unit: D, size: f0}}\n    parameters:\n      f0"
        text = DICTIONARY.replace("(x0/(x0 + d))**2", "z/x0").replace("    parameters:\n      f0", states)
        found = problems(write(tmp_path / "bad.yaml", text))
        assert [line.splitlines()[0] for line in found] == [
            "7:52: dictionary.magnet.states.z.size: the state 'z' is D, the expression F",
        ]

    @pytest.mark.parametrize(
        ("where", "expression", "expected"),
        [
            ("element", "a*d + b*d**3", ("a", "b")),
            ("element", "a*tanh(d/b)", ("a",)),
            ("element", "(a + (b - a)*exp(-d))*tanh(d_rate)", ("a", "b")),
            ("element", "a*b*d", ("a",)),
            ("element", "where(d > 0, a*d, -b*d)", ("a", "b")),
            ("element", "where(d > a, b*(d - a), 0)", ("b",)),
            ("element", "max(a*d, 0) + b", ()),
            ("element", "d**3 + a*d + b", ()),
            ("element", "a*z", ("a",)),
            ("element", "a*z + b*d", ()),
            ("element", "a/b*d", ("a",)),
            ("sensor", "s*(1 + a) + b", ("a", "b")),
            ("sensor", "a*s + b", ()),
            ("actuator", "u + a*u**3 - b*abs(u)", ("a", "b")),
        ],
    )
    def test_factors_are_found(self, where, expression, expected):
        states = {"z": {"rate": "d_rate - b*z"}} if "z" in expression else {}
        declared = {"meaning": "", "where": where, "expression": expression, "states": states}
        assert factors(OwnEffect.model_validate({**declared, "parameters": {"a": {}, "b": {}}})) == expected
