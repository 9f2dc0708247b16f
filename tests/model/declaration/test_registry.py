"""Declarations: what is written is what is read, and every mistake is reported with its place and remedy."""

import hashlib
import itertools
import json
import math
from pathlib import Path

import pytest

from masking.errors import DeclarationError, Place, Problem
from masking.model.declaration import catalogue, registry
from masking.model.declaration.dimensions import check_dimensions, check_scales
from masking.model.declaration.experiment_checks import check_experiment, check_size, count_columns, recorded_rows
from masking.model.declaration.json_schema import json_schema
from masking.model.declaration.model_checks import check_model
from masking.model.declaration.schema import KINDS, ExperimentDeclaration, ModelDeclaration
from masking.model.declaration.strict_yaml import load, loads
from masking.model.declaration.units import (
    USUAL,
    coherent,
    conversion,
    describe,
    dimension_of,
    factor_of,
    named_by_pint,
)
from masking.model.modelling.scales import Units


def resolve_parameters(model, overrides):
    return Units.of(model).parameter_values(overrides, dimensionless=False)


MODEL = """\
name: Pair
source: a test
coordinates: {x1: first, x2: {meaning: second, initial: 0.25}}
inputs: {u1: a force}
parameters:
  w: {value: 0.5, meaning: frequency, bounds: [0, null]}
  k: w**2
definitions:
  spring: k*(x1 - x2)
equations:
  x1'': -spring + u1
  x2'': spring - w*x2'
outputs: {force: spring}
energy: (x1'**2 + x2'**2)/2 + k*(x1 - x2)**2/2
"""
PLANT = """\
model: pair.yaml
sensors: {s1: x1, s2: {measures: x2 + 0.5*x1, unit: V, gain: 3}}
limits: {inputs: {u1: {max: 2, unit: N}}, coordinates: {x1 - x2: {max: 1}}}
"""
EXPERIMENT = """\
plant: rig.yaml
virtual: pair.yaml
controller: {rate: 1 kHz}
initial: {x1: -0.6, x2': 0.1}
duration: 25
inputs: {u1: 0}
"""


@pytest.fixture
def folder(tmp_path):
    for name, text in (("pair", MODEL), ("rig", PLANT), ("run", EXPERIMENT)):
        (tmp_path / f"{name}.yaml").write_text(text)
    return tmp_path


def write(folder, name, text):
    path = folder / name
    path.write_text(text)
    return path


def problems(call, *args):
    """Give the first line of each problem, with only the last part of the file's path."""
    with pytest.raises(DeclarationError) as caught:
        call(*args)
    lines = []
    for problem in caught.value.problems:
        place = problem.place
        where = f"{place.line}:{place.column}: " if place else ""
        lines.append(f"{where}{problem.path}: {problem.message}" + (f"; {problem.remedy}" if problem.remedy else ""))
    return lines


def model_problems(folder, text, name="m.yaml"):
    return problems(registry.load_model, write(folder, name, text))


def test_model_is_read_as_written(folder):
    model = registry.load_model(folder / "pair.yaml")
    assert (model.name, list(model.coordinates), list(model.inputs)) == ("Pair", ["x1", "x2"], ["u1"])
    assert model.coordinates["x1"].initial is None
    assert model.coordinates["x2"].initial == 0.25
    assert model.parameters["k"].value.text == "w**2"
    assert {left.text: right.text for left, right in model.equations.items()}["x1''"] == "-spring + u1"
    assert resolve_parameters(model, {}) == {"w": 0.5, "k": 0.25}
    assert resolve_parameters(model, {"w": 3.0}) == {"w": 3.0, "k": 9.0}
    assert resolve_parameters(model, {"k": 7.0}) == {"w": 0.5, "k": 7.0}


def test_places_point_at_values(folder):
    path = folder / "pair.yaml"
    model = registry.load_model(path)
    assert model.place("parameters.w.value") == Place(str(path), 6, 14)
    assert model.key_place("definitions.spring") == Place(str(path), 9, 3)
    assert model.place("parameters.w.unit") == Place(str(path), 6, 6)  # not written: the block around it
    assert model.files == {str(path): hashlib.sha256(MODEL.encode()).hexdigest()}


def test_canonical_form_can_be_read_again(folder):
    for load_it, name in (
        (registry.load_model, "pair"), (registry.load_plant, "rig"), (registry.load_experiment, "run")
    ):  # fmt: skip
        declaration = load_it(folder / f"{name}.yaml")
        canonical = declaration.canonical()
        again = type(declaration).model_validate(json.loads(json.dumps(canonical)))
        assert again.canonical() == canonical
    assert canonical["controller"] == {"rate": "1000.0 Hz"}


def test_experiment_is_assembled(folder):
    assembly = registry.assemble(registry.load_experiment(folder / "run.yaml"))
    assert assembly.experiment.controller.rate == 1000.0
    assert assembly.experiment.name == "run"
    assert assembly.plant.sensors["s2"].gain.value == 3.0
    assert assembly.controller_model is assembly.plant_model


@pytest.mark.parametrize(
    ("text", "hertz"),
    [("1 kHz", 1000.0), ("250Hz", 250.0), ("2 ms", 500.0), ("1e-3 s", 1000.0), ("continuous", None)],
)
def test_rates(text, hertz):
    read = {"plant": "p", "virtual": "v", "duration": 1, "controller": {"rate": text}}
    found = ExperimentDeclaration.model_validate({"name": "n", **read}).controller.rate
    assert found == hertz


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("k: w**2", "k: v**2"),
         ["7:6: parameters.k: unknown symbol 'v'; allowed: w, k"]),
        (("+ u1", ""), ["4:10: inputs.u1: the input 'u1' is not used; remove it or use it"]),
        (("force: spring", "force: k"), []),
        (("value: 0.5", "value: -2, unit: kg"), ["6:14: parameters.w.value: w = -2 kg is below its lower bound 0"]),
        (("[0, null]", "[3, 1]"), ["6:47: parameters.w.bounds: the lower bound 3 is above the upper bound 1"]),
        (("  x2'': spring - w*x2'\n", "  2*x1'': spring - w*x2'\n"),
         ["12:3: equations.2*x1'': the equations determine x1'' twice (lines 11 and 12) and x2'' never; "
          "one of these must contain x2''"]),
        (("x2'': spring", "x2': spring"),
         ["12:3: equations.x2': the equation contains no acceleration, and none determines x2''; write x2'': ..."]),
        (("  x2'': spring - w*x2'\n", ""),
         ["3:26: coordinates.x2: no equation contains x2''; write x2'': ... under equations"]),
        (("x2'': spring - w*x2'", "x2'': spring - w*x2'\n  x1' + x1'': x2"),
         ["10:1: equations: 3 equations for 2 coordinates are too many"]),
        (("w*x2'", "w'*x2'"),
         ["12:18: equations.x2'': 'w'' is a derivative of 'w', which is not a coordinate; allowed: x1, x2"]),
        (("energy: (", "energy: x1''*("), ["14:9: energy: 'x1''' is an acceleration, which energy may not contain"]),
        (("inputs: {u1: a", "inputs: {x2: b, u1: a"),
         ["4:10: inputs.x2: the name 'x2' is already used in coordinates; rename one of them"]),
        (("x1: first", "sin: first"),
         ["3:15: coordinates.sin: the name 'sin' is taken: it is built in; choose another"]),
        (("x1: first", "t: first"), ["3:15: coordinates.t: the name 't' is taken: it is the time; choose another"]),
        (("spring: k*", "spring: force2*k*"), ["9:11: definitions.spring: unknown symbol 'force2'; ..."]),
        (("k: w**2", "k: w**2 + k"), ["7:3: parameters.k: defined by itself: k -> k"]),
        (("spring: k*", "spring: spring*k*"), ["9:3: definitions.spring: defined by itself: spring -> spring"]),
        (("k: w**2", "k: 1/(w - 0.5)"), ["7:6: parameters.k: divides by zero"]),
        (("energy: (", "energi: ("), ["14:1: energi: the key 'energi' is not known; did you mean 'energy'?"]),
        (("meaning: frequency", "meanin: frequency"),
         ["6:19: parameters.w.meanin: the key 'meanin' is not known; did you mean 'meaning'?"]),
        (("inputs: {u1: a force}", "inputs: [u1]"),
         ["4:9: inputs: must be a mapping; write 'key: value' lines or {key: value}"]),
        (("value: 0.5", "value: true"), ["6:14: parameters.w.value: must be an expression, not true"]),
        (("bounds: [0, null]", "bounds: [0, a]"), ["6:51: parameters.w.bounds.1: must be a finite number, not 'a'"]),
        (("name: Pair", "name: Pair\nname: Two"),
         ["2:1: name: the key 'name' stands here twice; the first is in line 1"]),
        (("name: Pair", "name: Pair\noscillators: [x1, x3]"),
         ["2:19: oscillators.1: 'x3' is not a coordinate; did you mean 'x2'?"]),
        (("energy:", "dissipation: x1'**2\nenergy:"),
         ["14:1: dissipation: dissipation stands only with a lagrangian; write it into the equations"]),
        (("energy:", "lagrangian: x1'**2\nenergy:"),
         ["10:1: equations: a model has equations or a lagrangian, not both"]),
        (("energy:", "terms: {x1'': -x1}\nenergy:"),
         ["14:1: terms: terms are only for a model that extends another; ..."]),
    ],
)  # fmt: skip
def test_mistakes_in_a_model(folder, change, expected):
    text = MODEL.replace(*change)
    assert text != MODEL
    if not expected:
        registry.load_model(write(folder, "m.yaml", text))
        return
    found = model_problems(folder, text)
    for line in expected:
        start = line.removesuffix("...")
        assert any(item == line or (line.endswith("...") and item.startswith(start)) for item in found), found
    assert len(found) <= max(2, len(expected)), found


def test_all_problems_of_a_file_at_once(folder):
    text = (
        MODEL.replace("source: a test", "sauce: a test")
        .replace("k*(x1 - x2)\n", "k*(x1 - x2\n")
        .replace("w*x2'", "w*x3'")
    )
    assert model_problems(folder, text) == [
        "2:1: sauce: the key 'sauce' is not known; did you mean 'source'?",
        "9:13: definitions.spring: '(' is never closed",
        "12:20: equations.x2'': unknown symbol 'x3''; did you mean 'x2''?",
    ]


@pytest.mark.parametrize(
    ("load", "name", "path", "before"),
    [
        (registry.load_plant, "plants/linear_rig", "allocation", "wiring"),
        (registry.load_experiment, "examples/clocks/huygens_rig", "controller.homing", "controller.approach"),
    ],
)
def test_a_key_that_was_renamed_is_refused_with_its_new_name(folder, load, name, path, before):
    now, old = path.split(".")[-1], before.split(".")[-1]
    text = (Path(__file__).parents[3] / f"{name}.yaml").read_text().replace(f"{now}:", f"{old}:")
    with pytest.raises(DeclarationError, match=f"{before}: the key '{old}' is not known; it is called '{now}' now"):
        load(write(folder, "old.yaml", text))


def test_the_first_of_many_problems_are_listed(folder):
    wrong = "".join(f"unknown_{i}: 1\n" for i in range(5000))
    (folder / "model.yaml").write_text(f"name: x\ncoordinates: [x]\nequations: {{x: -x}}\n{wrong}")
    with pytest.raises(DeclarationError) as refused:
        registry.load_model(folder / "model.yaml")
    lines = str(refused.value).splitlines()
    assert len(lines) <= 200
    assert any("the key 'unknown_0' is not known" in line for line in lines)
    assert "further problems are not listed" in lines[-1]


def test_message_with_caret(folder):
    path = write(folder, "m.yaml", MODEL.replace("w*x2'", "w*x9'"))
    with pytest.raises(DeclarationError) as caught:
        registry.load_model(path)
    assert str(caught.value) == (
        f"{path}:12:20: equations.x2'': unknown symbol 'x9''; did you mean 'x2''?\n"
        "    spring - w*x9'\n               ^^^"
    )


def test_places_in_folded_and_quoted_texts(folder):
    text = MODEL.replace("energy: (x1'**2 + x2'**2)/2", "energy: >-\n  x1'**2 +\n  bad1").replace(
        "x1'': -spring + u1", "x1'': '-spring + x1''*bad2 + u1'"
    )
    found = model_problems(folder, text)
    assert [line.split(";")[0] for line in found] == [
        "11:25: equations.x1'': unknown symbol 'bad2'",
        "16:3: energy: unknown symbol 'bad1'",
    ]


def test_extends_overrides_and_adds(folder):
    child = write(
        folder,
        "stiff.yaml",
        "name: Stiff\nextends: pair.yaml\nparameters: {w: 2, c: {value: 0.1, unit: '1'}}\n"
        "terms: {x1'': -c*x1**3}\noutputs: {speed: x1'}\n",
    )
    model = registry.load_model(child)
    assert resolve_parameters(model, {}) == {"w": 2.0, "k": 4.0, "c": 0.1}
    assert model.parameters["w"].meaning == "frequency"
    assert {left.text: right.text for left, right in model.equations.items()} == {
        "x1''": "(-spring + u1) + (-c*x1**3)",
        "x2''": "spring - w*x2'",
    }
    assert list(model.outputs) == ["force", "speed"]
    assert model.place("parameters.w.value") == Place(str(child), 3, 17)
    assert model.place("definitions.spring") == Place(str(folder / "pair.yaml"), 9, 11)
    assert set(model.files) == {str(child), str(folder / "pair.yaml")}
    write(folder, "stiff.yaml", child.read_text().replace("-c*x1**3", "-c*x7**3"))
    with pytest.raises(DeclarationError, match=r"stiff\.yaml:4:18: equations\.x1'': unknown symbol 'x7'"):
        registry.load_model(child)


def test_terms_of_a_lagrangian_are_forces(folder):
    base = "name: L\ncoordinates: {q: angle}\nparameters: {m: 2}\nlagrangian: m*q'**2/2 + cos(q)\nforces: {q: -q'}\n"
    write(folder, "base.yaml", base)
    child = write(folder, "child.yaml", "extends: base.yaml\nterms: {q: sin(t)}\n")
    assert registry.load_model(child).forces["q"].text == "(-q') + (sin(t))"
    write(folder, "child.yaml", "extends: base.yaml\nterms: {p: sin(t)}\n")
    assert problems(registry.load_model, child) == [
        "2:9: terms.p: 'p' is not a coordinate; did you mean 'q'?"
    ] or problems(registry.load_model, child) == ["2:9: terms.p: 'p' is not a coordinate; allowed: q"]


def test_cyclic_extends(folder):
    for name, base in (("a", "b"), ("b", "c"), ("c", "a")):
        write(folder, f"{name}.yaml", f"extends: {base}.yaml\n")
    assert problems(registry.load_model, folder / "a.yaml") == ["1:10: extends: extends itself: a -> b -> c -> a"]
    write(folder, "d.yaml", "name: D\nextends: nowhere.yaml\n")
    assert problems(registry.load_model, folder / "d.yaml") == [
        "2:10: extends: there is no file nowhere.yaml; a model is a .yaml file"
    ]


def test_names_of_the_registry(folder, monkeypatch):
    there = {path.stem: path for path in sorted(folder.glob("*.yaml"))}
    monkeypatch.setattr(catalogue, "files", lambda kind: there)
    assert catalogue.names("model") == ["pair", "rig", "run"]
    assert registry.load_model("pair").name == "Pair"
    assert problems(registry.load_model, "piar") == [": there is no model 'piar'; did you mean 'pair'?"]


def test_unknown_override(folder):
    model = registry.load_model(folder / "pair.yaml")
    assert problems(resolve_parameters, model, {"ww": 1.0}) == ["ww: Pair has no parameter 'ww'; did you mean 'w'?"]
    with pytest.raises(DeclarationError, match=r"w = -1 is below its lower bound 0"):
        resolve_parameters(model, {"w": -1.0})
    with pytest.raises(DeclarationError, match=r"w = nan is not finite"):
        resolve_parameters(model, {"w": math.nan})


@pytest.mark.parametrize(
    ("name", "change", "expected"),
    [
        ("run", ("x1: -0.6, ", ""),
         "4:1: initial: no initial value for x1; give initial.x1 here or coordinates.x1.initial in Pair"),
        ("run", ("x1: -0.6", "x1: -0.6, x3: 0"),
         "4:21: initial.x3: 'x3' is not a coordinate of Pair, nor the velocity of one; did you mean 'x2'?"),
        ("run", ("duration", "parameters: {v: 1}\nduration"),
         "5:14: parameters.v: 'v' is not a parameter of Pair; allowed: w, k"),
        ("run", ("duration", "parameters: {w: -1}\nduration"),
         "5:17: parameters.w: w = -1 is below its lower bound 0"),
        ("run", ("1 kHz", "1 kHz, parameters: {z: 2}"),
         "3:40: controller.parameters.z: 'z' is not a parameter of Pair; ..."),
        ("run", ("duration", "transform: {matrix: [[1, 0]]}\nduration"),
         "5:21: transform.matrix: the matrix must have 2 rows of 2 entries"),
        ("run", ("duration", "transform: {matrix: [[1, x1], [0, 1]]}\nduration"),
         "5:26: transform.matrix.0.1: 'x1' may not be used here"),
        ("run", ("duration", "transform: {expressions: {x1: x1 + b}, parameters: {c: 1}}\nduration"),
         "5:36: transform.expressions.x1: unknown symbol 'b'; ..."),
        ("run", ("duration", "transform: {expressions: {x1: x1}}\nduration"),
         "5:13: transform.expressions: no expression for x2"),
        ("run", ("1 kHz", "1 k"),
         "3:20: controller.rate: the unit 'k' is not one of a rate; allowed: Hz, kHz, MHz, s, ms, us"),
        ("run", ("1 kHz", "0 Hz"), "3:20: controller.rate: the rate must be greater than 0 and finite, not 0"),
        ("run", ("duration: 25", "duration: -3"), "5:11: duration: must be greater than 0, not -3"),
        ("run", ("rig.yaml", "gir.yaml"), "1:8: plant: there is no file gir.yaml; a plant is a .yaml file"),
        ("run", ("duration: 25", "seed: 1.5\nduration: 25"), "5:7: seed: must be an integer of at least 0, not 1.5"),
        ("run", ("duration: 25", ""), "1:1: duration: the key 'duration' is missing"),
        ("run", ("duration", "transform: turn\nduration"), "5:12: transform: 'turn' is not a transform; ..."),
        ("run", ("duration: 25", "record: {rate: 1 MHz}\nduration: 25"),
         "5:16: record.rate: 1 MHz does not divide the controller's rate of 1 kHz; "
         "allowed: 1 kHz, 500 Hz, 250 Hz, 200 Hz, 100 Hz, ..."),
        ("run", ("duration: 25", "record: {rate: 300 Hz}\nduration: 25"),
         "5:16: record.rate: 300 Hz does not divide the controller's rate of 1 kHz; ..."),
        ("rig", ("{u1: {max", "{u2: {max"),
         "3:19: limits.inputs.u2: 'u2' is not an input of Pair; did you mean 'u1'?"),
        ("rig", ("x2 + 0.5", "x3 + 0.5"), "2:34: sensors.s2.measures: unknown symbol 'x3'; ..."),
        ("rig", ("x1 - x2:", "x1 - x5:"), "3:62: limits.coordinates.x1 - x5: unknown symbol 'x5'; ..."),
        ("rig", ("gain: 3", "gain: 0"), "2:62: sensors.s2.gain: the gain is 0"),
        ("rig", ("max: 2", "max: -2"), "3:29: limits.inputs.u1.max: must be greater than 0, not -2"),
    ],
)  # fmt: skip
def test_mistakes_where_files_meet(folder, name, change, expected):
    path = folder / f"{name}.yaml"
    assert change[0] in path.read_text()
    path.write_text(path.read_text().replace(*change))
    found = problems(lambda: registry.assemble(registry.load_experiment(folder / "run.yaml")))
    assert any(item == expected or (expected.endswith("...") and item.startswith(expected[:-3])) for item in found), (
        found
    )


def test_check_experiment_of_a_good_one_is_empty(folder):
    model = registry.load_model(folder / "pair.yaml")
    experiment = registry.load_experiment(folder / "run.yaml")
    assert check_experiment(experiment, registry.load_plant(folder / "rig.yaml"), model, model) == []


def test_json_schema_accepts_what_the_loader_accepts():
    for kind in KINDS:
        schema = json_schema(kind)
        assert schema["type"] == "object"
        assert schema["additionalProperties"] is False
        json.dumps(schema)
    assert set(json_schema("experiment")["required"]) >= {"virtual", "duration"}
    assert json_schema("experiment")["oneOf"] == [{"required": ["plant"]}, {"required": ["plants"]}]


def test_numbers_of_yaml():
    values = {
        key: node.value
        for key, node in loads("a: 1e-3\nb: 1E5\nc: .5\nd: 5.\ne: -3\nf: ~\ng: true\nh: x").value.items()
    }
    assert values == {"a": 1e-3, "b": 1e5, "c": 0.5, "d": 5.0, "e": -3.0, "f": None, "g": True, "h": "x"}


def test_files_that_cannot_be_read(tmp_path):
    (tmp_path / "latin.yaml").write_bytes("name: a\nsource: caf\xe9\n".encode("latin-1"))
    assert problems(load, tmp_path / "latin.yaml") == ["2:12: : the file is not UTF-8; save it as UTF-8"]
    (tmp_path / "big.yaml").write_text("a: " + "x" * 2**20)
    assert problems(load, tmp_path / "big.yaml") == ["1:1: : the file is larger than 1048576 bytes"]
    assert problems(load, tmp_path / "none.yaml") == ["1:1: : there is no such file"]


SI = """\
name: Mass
coordinates: {x: {unit: m}}
inputs: {u: {unit: V}}
parameters: {m: {value: 2, unit: kg}, c: {value: 3, unit: N*s/m}, k: {value: 8, unit: N/m}, g: {value: 1, unit: N/V}}
equations:
  m*x'': -c*x' - k*x + g*u
energy: m*x'**2/2 + k*x**2/2
"""


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("c*x'", "c*x"), "6:10: equations.m*x'': subtracts kg*m/s**2 from kg*m/s"),
        (("m*x'': -c", "x'': -c"), "6:8: equations.x'': the left side is m/s**2, the right side kg*m/s**2"),
        (("k*x**2", "k*x"), "7:9: energy: adds kg*m/s**2 to kg*m**2/s**2"),
        (("g*u", "g*u*sin(x)"), "6:28: equations.m*x'': takes sin of m; its argument must be dimensionless"),
        (("unit: N/V", "unit: N/Volt9"),
         "4:113: parameters.g.unit: 'Volt9' is not a unit; units are written as in N*s/m**2"),
        (("g*u", "g*u*2**u"),
         "6:28: equations.m*x'': the exponent is kg*m**2/s**3/A; an exponent must be dimensionless"),
    ],
)  # fmt: skip
def test_dimensions(folder, change, message):
    model = registry.load_model(write(folder, "si.yaml", SI))
    assert check_dimensions(model) == []
    model = registry.load_model(write(folder, "si.yaml", SI.replace(*change)))
    problem = check_dimensions(model)[0]
    shown = f"{problem.place.line}:{problem.place.column}: {problem.path}: {problem.message}"
    assert shown + (f"; {problem.remedy}" if problem.remedy else "") == message


def test_scales_of_a_dimensionless_model_give_no_time_a_unit(folder):
    text = MODEL + "scales: {time: {value: 1/18.3, unit: s}, length: {value: 5, unit: mm}}\n"
    assert check_dimensions(registry.load_model(write(folder, "scaled.yaml", text))) == []


@pytest.mark.parametrize("name", catalogue.names("model"))
def test_packaged_models_are_sound(name):
    model = registry.load_model(name)
    assert check_dimensions(model) == []
    assert ModelDeclaration.model_validate(model.canonical()).canonical() == model.canonical()


def test_models_without_units_are_not_looked_at(folder):
    assert check_dimensions(registry.load_model(folder / "pair.yaml")) == []


def test_units_and_conversion():
    assert describe(dimension_of("N*s/m**2")) == "kg/m/s"
    assert describe(dimension_of("V")) == "kg*m**2/s**3/A"
    assert dimension_of("rad") == dimension_of("1")
    written = {"deg/s": "rad/s", "rpm": "rad/s", "N*mm": "N*m", "kN": "N", "bar": "Pa", "mm/s**2": "m/s**2", "": ""}
    assert {unit: coherent(unit) for unit in written} == written
    assert (factor_of("rads/s"), describe(dimension_of("rads/s"))) == (1.0, "1/s")  # angles, no doses of radiation
    assert factor_of("mm") == pytest.approx(1e-3, rel=1e-15)
    assert factor_of("km/h") == pytest.approx(1 / 3.6, rel=1e-15)
    scales = {"length": "mm", "time": "s", "mass": "kg", "voltage": "V"}
    assert conversion("N/m", scales) == (1.0, {"length": 0, "time": -2, "mass": 1, "voltage": 0}, "N/m")
    assert conversion("mm/s", {"length": "m", "rate": "Hz"}) == (
        pytest.approx(1e-3), {"length": 1, "rate": 1}, "m/s",
    )  # fmt: skip
    assert conversion("m", {"area": "m**2"}).exponents == {"area": 0.5}
    with pytest.raises(DeclarationError) as caught:
        conversion("N/m", {"length": "m", "time": "s"})
    assert str(caught.value) == (
        "scales: the unit N/m cannot be made dimensionless: no scale for mass; "
        "add one under scales; there are length, time"
    )
    for bad in ("kg m", "m^2", "m +s", "__import__('os')", "2**m", "furlongg"):
        with pytest.raises(DeclarationError):
            dimension_of(bad)


def test_component_without_coordinates_is_legal(folder):
    text = "name: Spring\ninputs: {d: displacement}\nparameters: {k: 3}\noutputs: {f: -k*d}\n"
    model = registry.load_model(write(folder, "c.yaml", text))
    assert check_model(model) == []
    assert isinstance(model, ModelDeclaration)


MACHINE = """\
name: Machine
coordinates: {q1: {unit: m}, q2: {unit: m}}
inputs: {v1: {unit: V}, v2: {unit: V}}
parameters: {k: {value: 1, unit: N/m}, m: {value: 2, unit: kg}, g: {value: 1, unit: N/V}}
equations:
  m*q1'': -k*q1 + g*v1
  m*q2'': -k*q2 + g*v2
"""
WIRED = """\
model: machine.yaml
sensors:
  s1: {measures: q1, gain: {value: 200, unit: V/m}, unit: V}
  s2: {measures: q1 - q2', gain: 3, unit: mV}
limits:
  inputs: {v1: {max: 10, unit: mV}, v2: {max: 10, unit: V}}
  coordinates: {q1 - q2: {max: 3, unit: mm}}
  power: {value: 8, unit: W}
"""
SOUND = WIRED.replace("q1 - q2', gain: 3, unit: mV", "q1 - q2, gain: {value: 3, unit: mV/mm}, unit: mV")


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("", ""), []),
        (("v2: {max: 10, unit: V}", "v2: {max: 10}"), []),  # a unit that is not written is the input's own
        (("v2: {max: 10, unit: V}", "v2: {max: 10, unit: A}"),
         ["6:57: limits.inputs.v2.unit: the input v2 is in V, the limit in A"]),
        (("v2: {max: 10, unit: V}", "v2: {max: 10, unit: Vlt}"),
         ["6:57: limits.inputs.v2.unit: 'Vlt' is not a unit; units are written as in N*s/m**2"]),
        (("unit: mm}}", "unit: s}}"), ["7:41: limits.coordinates.q1 - q2.unit: q1 - q2 is in m, the limit in s"]),
        (("q1 - q2: {", "q1 - q2': {"), ["7:17: limits.coordinates.q1 - q2': subtracts m/s from m"]),
        (("unit: W", "unit: N"), ["8:27: limits.power.unit: a power is in W, the limit in N"]),
        (("unit: V/m", "unit: V"),
         ["3:7: sensors.s1: 200 V times q1 [m] is V*m, not V; measure another quantity, "
          "give the gain in V/m with its value in that unit, or correct the unit"]),
        (("{measures: q1, gain: {value: 200, unit: V/m}", "{measures: q1', gain: 200"),
         ["3:7: sensors.s1: 200 times q1' [m/s] is m/s, not V; measure another quantity, "
          "give the gain in V/(m/s) with its value in that unit, or correct the unit"]),
        (("  s1: {measures: q1, gain: {value: 200, unit: V/m}, unit: V}", "  s1: q1"), []),
    ],
)  # fmt: skip
def test_units_of_a_plant(folder, change, expected):
    write(folder, "machine.yaml", MACHINE)
    path = write(folder, "wired.yaml", SOUND.replace(*change) if change[0] else SOUND)
    experiment = "plant: wired.yaml\nvirtual: machine.yaml\nduration: 1\ninitial: {q1: 0, q2: 0}\n"
    experiment += "inputs: {v1: 0, v2: 0}\n"
    assembly = registry.assemble(registry.load_experiment(write(folder, "moved.yaml", experiment)))
    if expected:
        assert problems(registry.check_plant_file, path) == expected
    else:
        registry.check_plant_file(path)
    assert [str(problem).splitlines()[0] for problem in registry.check_units(assembly)] == [
        f"{path}:{line}" for line in expected
    ]


def test_a_limit_without_a_unit_is_in_that_of_what_it_bounds_or_refused(folder):
    short = MACHINE.replace("q1: {unit: m}, q2: {unit: m}", "q1: {unit: mm}, q2: {unit: mm}")
    bare = SOUND.replace("{max: 3, unit: mm}", "{max: 3}")
    write(folder, "machine.yaml", MACHINE)
    registry.check_plant_file(write(folder, "wired.yaml", bare))
    write(folder, "machine.yaml", short)
    registry.check_plant_file(write(folder, "wired.yaml", SOUND))
    assert problems(registry.check_plant_file, write(folder, "wired.yaml", bare)) == [
        "7:26: limits.coordinates.q1 - q2: the limit of 3 has no unit, and what it bounds is declared in mm; "
        "write 'unit: mm', or the unit that the limit is in"
    ]


PENDULUM = """\
name: Cart with a pendulum
coordinates: {x: {unit: m}, phi: {unit: rad}}
inputs: {u: {unit: N}, w: {unit: N*m}}
parameters: {m: {value: 2, unit: kg}, J: {value: 1, unit: kg*m**2}}
equations: {m*x'': u, J*phi'': w}
"""
FELT = "name: Felt\ncoordinates: {y: {unit: m}}\ninputs: {F: {unit: N}}\nparameters: {m: {value: 1, unit: kg}}\n"
FELT += "equations: {m*y'': F}\n"


@pytest.mark.parametrize(
    ("transform", "source", "expected"),
    [
        ("x + l*phi", "{sensor: s, factor: 30}", []),
        ("x + 20*phi", "{sensor: s, factor: 30}", []),
        ("2*x", "{sensor: s}", ["inputs.F: s measures x in m, and the input F of Felt is in N; "
         "give a factor, which multiplies what the sensor measures, or take another sensor"]),
    ],
)  # fmt: skip
def test_live_inputs_have_units_and_numbers_of_a_transform_any(folder, transform, source, expected):
    write(folder, "pendulum.yaml", PENDULUM)
    write(folder, "felt.yaml", FELT)
    write(folder, "bench.yaml", "model: pendulum.yaml\nsensors: {s: {measures: x, unit: m}, a: {measures: phi}}\n")
    experiment = "plant: bench.yaml\nvirtual: felt.yaml\nduration: 1\ninitial: {y: 0}\n"
    experiment += "controller: {rate: 500 Hz, observer: disturbance}\n"
    experiment += (
        f"transform: {{expressions: {{y: {transform}}}, parameters: {{{'l: 1' if 'l' in transform else ''}}}}}\n"
    )
    experiment += f"inputs: {{F: {source}}}\n"
    assembly = registry.assemble(registry.load_experiment(write(folder, "run.yaml", experiment)))
    found = [str(problem).splitlines()[0].split(": ", 1)[1] for problem in registry.check_units(assembly)]
    assert found == expected


def test_what_a_sensor_measures_and_the_model_of_a_plant_have_units_too(folder):
    write(folder, "machine.yaml", MACHINE)
    found = problems(registry.check_plant_file, write(folder, "wired.yaml", WIRED))
    assert found == ["4:18: sensors.s2.measures: subtracts m/s from m"]
    write(folder, "machine.yaml", MACHINE.replace("g*v2", "v2"))
    (found,) = problems(registry.check_plant_file, write(folder, "wired.yaml", SOUND))
    assert found == "7:11: equations.m*q2'': adds kg*m**2/s**3/A to kg*m/s**2"


@pytest.mark.parametrize("name", catalogue.names("plant"))
def test_packaged_plants_are_sound(name):
    registry.check_plant_file(name)


@pytest.mark.parametrize("name", catalogue.names("experiment"))
def test_packaged_experiments_are_sound(name):
    assembly = registry.assemble(registry.load_experiment(name))
    assert registry.check_units(assembly) == []
    columns = count_columns(assembly.plant_model, assembly.virtual_model)
    assert check_size(assembly.experiment, recorded_rows(assembly.experiment, 1.0, 10.0), columns) == []


def test_a_file_of_another_kind_is_told_in_one_line(folder, monkeypatch):
    monkeypatch.chdir(folder)
    needs = "an experiment is needed here, which names a plant and a model"
    for load_it, file, expected in (
        (registry.load_experiment, "pair.yaml",
         f"pair.yaml is a model; {needs}: 'plant: ideal', 'virtual: pair.yaml'"),
        (registry.load_experiment, "rig.yaml", f"rig.yaml is a plant; {needs}: 'plant: rig.yaml', 'virtual: duffing'"),
        (registry.load_experiment, "setup", f"setup is a model; {needs}: 'plant: ideal', 'virtual: setup'"),
        (registry.load_plant, "pair.yaml",
         "pair.yaml is a model; a plant is needed here, which names a model: 'model: pair.yaml'"),
        (registry.load_plant, "run.yaml",
         "run.yaml is an experiment; a plant is needed here, such as the experiment's own: rig.yaml"),
        (registry.load_model, "rig.yaml",
         "rig.yaml is a plant; a model is needed here, such as the plant's own: pair.yaml"),
        (registry.load_model, "run.yaml",
         "run.yaml is an experiment; a model is needed here, such as the experiment's own: pair.yaml"),
        (registry.load_model, "ideal", "ideal is a plant; a model is needed here"),
    ):  # fmt: skip
        with pytest.raises(DeclarationError) as caught:
            load_it(file)
        assert str(caught.value) == expected
    write(folder, "run.yaml", EXPERIMENT.replace("rig.yaml", "pair.yaml"))
    assert problems(lambda: registry.assemble(registry.load_experiment("run.yaml"))) == [
        "1:8: plant: pair.yaml is a model; a plant is needed here, which names a model: 'model: pair.yaml'"
    ]


def test_kinds(folder, monkeypatch):
    monkeypatch.chdir(folder)
    kinds = {name: catalogue.kind_of(name) for name in ("pair.yaml", "rig.yaml", "run.yaml", "ideal", "setup")}
    assert kinds == {"pair.yaml": "model", "rig.yaml": "plant", "run.yaml": "experiment", "ideal": "plant",
                     "setup": "model"}  # fmt: skip
    assert catalogue.kind_of_keys({"name", "parameters"}) is None
    assert catalogue.kind_of_keys({"coordinates", "equations", "limits"}) == "model"
    assert catalogue.kind_of(write(folder, "bad.yaml", "name: on\nvirtual: pair\n")) == "experiment"
    fields = {kind: set(declaration.model_fields) for kind, declaration in KINDS.items()}
    for kind, own in catalogue.OWN_KEYS.items():
        others = set().union(*(fields[other] for other in fields if other != kind))
        assert own == fields[kind] - others


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("exp_rig", "there is no {kinds} 'exp_rig'; did you mean the file exp_rig.yaml?"),
        ("./exp_rig", "there is no file ./exp_rig; did you mean the file ./exp_rig.yaml?"),
        ("dir.yaml", "dir.yaml is a folder; name a file in it; {a} is a .yaml file"),
        ("dir", "dir is a folder; ..."),
        ("nowhere.yaml", "there is no file nowhere.yaml; {a} is a .yaml file"),
        ("plainfile", "there is no {kinds} 'plainfile'; write ./plainfile for the file plainfile"),
        ("x" * 300, "there is no {kinds} 'xxx..."),
        ("~nobody9/x.yaml", "there is no file ~nobody9/x.yaml; {a} is a .yaml file"),
        ("a\0b.yaml", "there is no file a\0b.yaml; {a} is a .yaml file"),
    ],
)
def test_files_that_are_not_there(tmp_path, monkeypatch, name, expected):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, "exp_rig.yaml", EXPERIMENT)
    write(tmp_path, "plainfile", "")
    for made in ("dir", "dir.yaml"):
        (tmp_path / made).mkdir()
    for call, kinds, a in (
        (registry.load_experiment, "experiment", "an experiment"),
        (catalogue.kind_of, "model, plant, experiment or dictionary", "a declaration"),
    ):
        with pytest.raises(DeclarationError) as caught:
            call(name)
        wanted, found = expected.format(kinds=kinds, a=a), str(caught.value)
        assert found.startswith(wanted[:-3]) if wanted.endswith("...") else found == wanted


def test_coordinates_may_be_called_y_and_n(folder):
    text = "name: n\ncoordinates: {y: a, n: b}\nequations:\n  y'': -y\n  n'': n\n"
    model = registry.load_model(write(folder, "yn.yaml", text))
    assert (model.name, list(model.coordinates)) == ("n", ["y", "n"])
    for word in ("on", "Off", "YES", "no"):
        assert problems(loads, f"a: {word}") == [
            f"1:4: a: '{word}' is true or false in YAML 1.1; quote it or write true/false"
        ]


def test_a_refused_scalar_hides_nothing(folder):
    text = MODEL.replace("value: 0.5", "value: 010").replace("w*x2'", "w*x9'").replace("a test", "yes")
    assert [line.split(";")[0] for line in model_problems(folder, text)] == [
        "2:9: source: 'yes' is true or false in YAML 1.1",
        "6:14: parameters.w.value: '010' is an octal number in YAML",
        "12:20: equations.x2'': unknown symbol 'x9''",
    ]
    write(folder, "base.yaml", MODEL)
    child = "name: C\nextends: base.yaml\nparameters: {w: 010}\n"
    assert len(model_problems(folder, child)) == 1
    assert len(model_problems(folder, child + "energi: 3\n")) == 2


@pytest.mark.parametrize("section", ["parameters", "coordinates", "inputs", "definitions"])
def test_a_misspelt_section_is_one_problem(folder, section):
    wrong = section.replace("s", "z")
    (line,) = model_problems(folder, MODEL.replace(section, wrong))
    assert f"the key '{wrong}' is not known; did you mean '{section}'?" in line
    found = model_problems(folder, MODEL.replace(section, wrong).replace("w*x2'", "w*x2' + e"))
    assert [item.split(": ")[2].split(";")[0] for item in found][-1] == "unknown symbol 'e'"
    assert len(found) == 2


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("p:\n  k:{value: 1, unit: N}\n",
         "2:20: p: not YAML: mapping values are not allowed in this context; write a space after ':'"),
        ("p: {k:{value: 1}}", "1:5: p: not YAML: no space after ':' in 'k:{value: 1}}'; write a space after ':'"),
        ("e:\n  x'':-k*x\n  z'': 2\n",
         "2:3: e: not YAML: no space after ':' in 'x'':-k*x'; write a space after ':'"),
        ("a: 1\nbeta\nc: 2\n", "2:1: not YAML: no ':' after 'beta'; write beta: ..."),
        ("e:\n  x'' : -x\n  z'' -x\n", "3:3: e: not YAML: no ':' after 'z'' -x'; write z'': ..."),
        ("p:\n  w\n  k: 2\n", "2:3: p: not YAML: no ':' after 'w'; write w: ..."),
        ("a: b: c", "1:5: a: not YAML: mapping values are not allowed in this context; quote a text that holds ': '"),
        ("name: foo\n  bar: 2",
         "2:3: name: not YAML: 'bar' is indented below 'name: foo', which is complete; "
         "begin it in column 1, as the line above"),
    ],
)  # fmt: skip
def test_what_is_not_yaml(text, expected):
    def shown(line):  # which path PyYAML has come to, and how it ends the sentence, is its own affair
        where, _, rest = line.partition("not YAML: ")
        return where.split(" ")[0], rest.replace("allowed here", "allowed in this context")

    (line,) = problems(loads, text)
    assert shown(line) == shown(expected)


def test_a_byte_order_mark_is_skipped(tmp_path):
    (tmp_path / "bom.yaml").write_bytes(b"\xef\xbb\xbfa: 1\nb: on\n")
    assert [line.split(" ")[0] for line in problems(load, tmp_path / "bom.yaml")] == ["2:4:"]


def test_numbers_without_unit_are_called_so(folder):
    for change, expected in (
        (("k*x + g*u", "k*x + g*u + 3"), "adds a number without unit to kg*m/s**2"),
        (("k*x + g*u", "k*x + g*u - 3"), "subtracts a number without unit from kg*m/s**2"),
        (
            ("-c*x' - k*x + g*u", "c*x'/(k*x)*g/g*u/u"),
            "the left side is kg*m/s**2, the right side a number without unit",
        ),
    ):
        problem = check_dimensions(registry.load_model(write(folder, "si.yaml", SI.replace(*change))))[0]
        assert problem.message == expected


def test_all_missing_scales_at_once(folder):
    scales = "scales: {time: {value: 1, unit: s}, length: {value: 1, unit: m}}\n"
    model = registry.load_model(write(folder, "m.yaml", MACHINE + scales))
    found = [(p.place.line, p.place.column, p.path, p.message, p.remedy) for p in check_scales(model)]
    start, mass, voltage = "add to scales: ", "'mass: {value: 1, unit: kg}'", "'voltage: {value: 1, unit: V}'"
    end = ", with the value that suits"
    assert found == [
        (3, 21, "inputs.v1.unit",
         "the unit V cannot be made dimensionless: no scale for mass and current (also of v2)",
         start + voltage + end),
        (4, 34, "parameters.k.unit",
         "the unit N/m cannot be made dimensionless: no scale for mass", start + mass + end),
        (4, 60, "parameters.m.unit",
         "the unit kg cannot be made dimensionless: no scale for mass", start + mass + end),
        (4, 85, "parameters.g.unit",
         "the unit N/V cannot be made dimensionless: no scale for current", f"{start}{voltage}, {mass}{end}"),
    ]  # fmt: skip
    whole = scales.replace("}}", "}, voltage: {value: 1, unit: V}, mass: {value: 1, unit: kg}}")
    assert check_scales(registry.load_model(write(folder, "m.yaml", MACHINE + whole))) == []
    assert check_scales(registry.load_model(write(folder, "m.yaml", MACHINE))) == []
    taken = scales.replace("length", "mass")  # the proposal takes another name
    assert "mass2: " in check_scales(registry.load_model(write(folder, "m.yaml", MACHINE + taken)))[1].remedy
    wrong = registry.load_model(write(folder, "m.yaml", MODEL + "scales: {time: {value: 1, unit: sec9}}\n"))
    assert [problem.message for problem in check_dimensions(wrong)] == ["'sec9' is not a unit"]


def test_which_equation_lacks_its_acceleration(folder):
    text = "coordinates: {a: '', b: '', c: ''}\nequations:\n  {}\n  {}\n  {}\ndefinitions: {d: {}}\n"
    for lines, expected in (
        (("a'' + b'': a", "a'' - b'': b", "b'' - d: 1", "a''"),
         ["5:3: equations.b'' - d: the equations determine a'' and b'' by 3 equations (lines 3, 4 and 5) "
          "and c'' never; one of these must contain c''"]),
        (("a'' + b'': a", "a'': b", "b'' - d: 1", "c''"), []),
        (("a'' + b'' + c'': a", "a'' + b'': b", "d: 1", "a''"), []),
        (("a'': b", "a'' + c'': a", "b'' + a'' : d", "a"), []),
        (("a'': a", "2*b: b", "c*d: c", "b''*c''"), []),
    ):  # fmt: skip
        filled = text.replace("{}", "%s") % lines
        path = write(folder, "m.yaml", filled)
        if expected:
            assert problems(registry.load_model, path) == expected
    long = [f"x{i}" for i in range(1100)]  # a chain in which the last equation moves all others on
    chain = "".join(f"  {a}'' + {b}'': 1\n" for a, b in itertools.pairwise(long)) + "  x0'': 1\n"
    registry.load_model(
        write(folder, "long.yaml", f"coordinates: {{{', '.join(f'{x}: a' for x in long)}}}\nequations:\n{chain}")
    )


@pytest.mark.parametrize(
    ("duration", "record", "expected"),
    [
        ("25", "", []),
        ("1e9", "", ["5:11: duration: 1e9 units are 1e12 rows, 1e5 GiB; "
                     "shorten duration or record less: 'record: {rate: ...}'"]),
        ("5e7", "record: {rate: 100 Hz}",
         ["5:11: duration: 5e7 units are 5e9 rows, 522 GiB; shorten duration or lower record.rate"]),
        ("5e7", "record: {rate: 0.1 Hz}", []),
    ],
)  # fmt: skip
def test_size_of_a_recording(folder, duration, record, expected):
    text = EXPERIMENT.replace("duration: 25", f"duration: {duration}\n{record}")
    path = write(folder, "run.yaml", text)
    assembly = registry.assemble(registry.load_experiment(path))
    columns = count_columns(assembly.plant_model, assembly.virtual_model)
    assert columns == 14
    found = check_size(assembly.experiment, recorded_rows(assembly.experiment, 1.0, 10.0), columns)
    assert [str(problem) for problem in found] == [f"{path}:{line}" for line in expected]


def test_rows_of_a_recording(folder):
    continuous = EXPERIMENT.replace("1 kHz", "continuous")
    load_it = registry.load_experiment
    assert recorded_rows(load_it(folder / "run.yaml"), 0.1, 10.0) == 2501.0
    assert recorded_rows(load_it(write(folder, "c.yaml", continuous)), 0.1, 10.0) == 251.0
    recorded = load_it(write(folder, "c.yaml", continuous + "record: {rate: 100 Hz}\n"))
    assert recorded_rows(recorded, 0.1, 10.0) == 251.0
    assert recorded_rows(recorded, 2.0, 10.0) == 5001.0


def test_a_problem_as_json():
    problem = Problem(Place("m.yaml", 3, 7), "parameters.k", "is wrong", "correct it", "    k\n    ^")
    assert json.loads(json.dumps(problem.as_dict())) == {
        "file": "m.yaml", "line": 3, "column": 7, "path": "parameters.k", "message": "is wrong", "remedy": "correct it",
    }  # fmt: skip
    assert Problem(None, "", "is wrong").as_dict() == {
        "file": None, "line": None, "column": None, "path": "", "message": "is wrong", "remedy": "",
    }  # fmt: skip


@pytest.mark.parametrize("name", USUAL)
def test_units_that_are_read_without_pint_are_those_of_pint(name):
    assert USUAL[name] == named_by_pint(name)
