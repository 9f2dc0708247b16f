"""Messages of what people who begin write wrong: what was given, where, and how to repair it, word for word."""

import pytest

from masking.app.workflows.check import check
from masking.errors import DeclarationError
from masking.model.declaration import registry
from masking.model.declaration.quantities import percent

PENDULUM = """name: pendulum
coordinates:
  th: {meaning: angle, initial: 0.3}
parameters:
  g: 9.81
  l: 0.5
equations:
  l*th'': -g*sin(th)
"""
POINT = "a number has a decimal point: write 9.81"
COMMA = f"a comma stands only between the arguments of a function; {POINT}"
LINEAR = (
    "this is not linear in th''; accelerations may appear on both sides, but only to the first power; write an "
    "equation that is solved for th'', and the square of a speed as th'**2"
)


def problems(text, tmp_path):
    """Return the problems of a model, each from its line on, without the lines that show where."""
    file = tmp_path / "m.yaml"
    file.write_text(text)
    (found,) = check(file)
    return [str(one).partition("m.yaml:")[2].partition("\n")[0] for one in found.problems]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("name: pendulum", "name: pendulum \x07", "1:16: the character U+0007 is not allowed; delete it"),
        ("name: pendulum", "# \u202e\nname: pendulum", "1:3: the character U+202E is not allowed; delete it"),
        ("  g: 9.81", "\tg: 9.81", "5:1: a tab is not allowed; use spaces"),
        ("name: pendulum", 'name: "a\\0b"', "1:8: name: the character U+0000 is not allowed in a text; delete it"),
        (
            "angle",
            '"\\u2067"',
            "3:18: coordinates.th.meaning: the character U+2067 is not allowed in a text; delete it",
        ),
        (
            "  l: 0.5",
            '  l: 0.5\n  "k\\n": 1',
            "7:4: parameters: the character U+000A is not allowed in a key; delete it",
        ),
    ],
)
def test_characters_that_no_text_may_have_are_refused_with_their_place(old, new, expected, tmp_path):
    assert problems(PENDULUM.replace(old, new, 1), tmp_path)[0] == expected


def test_a_file_of_windows_is_read_as_any_other(tmp_path):
    assert problems("\ufeff" + PENDULUM.replace("\n", "\r\n"), tmp_path) == []


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("g: 9.81", "g: 9,81", f"5:6: parameters.g: {COMMA}"),
        ("g: 9.81", "g: {value: 9,81}", f"5:14: parameters.g: '9,81' is no number; {POINT}"),
        ("g: 9.81", "g: {value: -9,81, meaning: gravity}",
         "5:14: parameters.g: '-9,81' is no number; a number has a decimal point: write -9.81"),
        ("  g: 9.81\n  l", "  g:\n    value: 9,81\n  l", f"6:12: parameters.g.value: {COMMA}"),
        ("-g*sin", "-9,81*sin", f"8:11: equations.l*th'': {COMMA}"),
        ("  l: 0.5", "   l: 0.5",
         "6:4: parameters: not YAML: 'l' is indented below 'g: 9.81', which is complete; begin it in column 3, as the "
         "line above"),
        ("  l: 0.5", " l: 0.5",
         "6:2: not YAML: 'l' begins in column 2, the lines above in column 3 and 1; begin it in one of these, below "
         "the key that it stands beside"),
        ("l*th'': -g*sin(th)", "0: l*th'' + g*sin(th)",
         "8:3: equations.0: the key 0 is not a text; write what it is on the left, such as x'': ..., or the number in "
         "quotes: '0': ..."),
        ("  g: 9.81", "  g:\n    value: 9.81\n  unit: m/s**2",
         "7:3: parameters.unit: 'unit' stands among the parameters, and is a field of one, such as of 'g'; indent it "
         "below 'g:', or write g: {..., unit: ...}"),
        ("{meaning: angle, initial: 0.3}", "{initial: 0.3}\n  unit: deg",
         "4:3: coordinates.unit: 'unit' stands among the coordinates, and is a field of one, such as of 'th'; indent "
         "it below 'th:', or write th: {..., unit: ...}"),
        ("l: 0.5", "l: {value: 0.5}, unit: m",
         "6:18: parameters: not YAML: '}' ends the value, and ', unit: m' follows it; write it before the '}', or in a "
         "line of its own"),
        ("l*th''", "l*th''**2", f"8:5: equations.l*th''**2: {LINEAR}"),
        ("-g*sin(th)", "-g*sin(th) - 0.1*abs(th'')", f"8:32: equations.l*th'': {LINEAR}"),
    ],
)  # fmt: skip
def test_each_is_said_with_its_place_and_a_remedy(old, new, expected, tmp_path):
    assert PENDULUM.count(old) == 1
    assert problems(PENDULUM.replace(old, new), tmp_path) == [expected]


def test_a_section_whose_lines_are_not_indented(tmp_path):
    first, second = problems(PENDULUM.replace("  th: {", "th: {"), tmp_path)
    assert first == (
        "2:13: coordinates: must be a mapping; indent the lines below it that belong to it, or write {key: value}"
    )
    assert second.startswith("3:1: th: the key 'th' is not known; ")


def test_equations_that_say_the_same(tmp_path):
    carts = """name: two carts
coordinates: {x: {initial: 0}, y: {initial: 0}, z: {initial: 0}}
parameters: {m: 2, k: 3}
equations:
  z'': -z
  m*x'' + m*y'': -k*x
  2*m*x'' + 2*m*y'': -k*y
"""
    assert problems(carts, tmp_path) == [
        "7:3: equations.2*m*x'' + 2*m*y'': 'm*x'' + m*y''' and '2*m*x'' + 2*m*y''' hold the same combination of x'' "
        "and y'', and do not determine each of them; write equations of which none follows from the others: each body "
        "has one of its own"
    ]


def test_a_zero_on_the_left_in_quotes_is_an_equation(tmp_path):
    assert problems(PENDULUM.replace("l*th'': -g*sin(th)", "'0': l*th'' + g*sin(th)"), tmp_path) == []


def test_a_parameter_that_is_named_like_a_field_and_used(tmp_path):
    text = PENDULUM.replace("  l: 0.5", "  l: {value: 0.5}\n  unit: 2").replace("-g*", "-unit*g*")
    assert problems(text, tmp_path) == []


DRIVEN = """name: driven
coordinates: {x: {initial: 0}}
inputs: {F: force}
parameters: {k: 1, A: 0.2}
equations: {"x''": "F - k*x"}
"""
RIG = {
    "model.yaml": DRIVEN,
    "plant.yaml": "name: rig\nmodel: model.yaml\nsensors: {s: {measures: x}}\nlimits: {inputs: {F: {max: 1}}}\n",
}


def write(folder, files):
    for name, text in files.items():
        (folder / name).write_text(text)


def test_a_parameter_that_an_experiment_alone_uses(tmp_path):
    assert problems(DRIVEN, tmp_path) == []
    write(tmp_path, RIG | {
        "model.yaml": DRIVEN.replace(", A: 0.2", ""), "virtual.yaml": DRIVEN,
        "run.yaml": "name: run\nplant: plant.yaml\nvirtual: virtual.yaml\ninputs: {F: A*sin(t)}\nduration: 1\n",
    })  # fmt: skip
    assert registry.assemble(registry.load_experiment(tmp_path / "run.yaml")).virtual_model.inputs == {}


def test_a_parameter_that_neither_a_rig_nor_its_model_uses(tmp_path):
    write(tmp_path, RIG)
    unused = r"4:20: parameters\.A: the parameter 'A' is not used; remove it or use it"
    with pytest.raises(DeclarationError, match=unused):
        registry.check_plant_file(tmp_path / "plant.yaml")
    effect = "effects: {noise: {effect: noise, at: s, parameters: {sigma: A/1000}}}\n"
    write(tmp_path, {"plant.yaml": RIG["plant.yaml"] + effect})
    registry.check_plant_file(tmp_path / "plant.yaml")


def test_a_part_that_is_huge_has_few_digits():
    assert percent(1e100) == "1e102 %"
    assert percent(123.4) == "12340 %"
