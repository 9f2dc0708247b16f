"""Plants with more coordinates than the controller's model: matched by name or by a sensor, the rest its own."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from masking.app.workflows.check import check
from masking.errors import DeclarationError, MaskingError
from masking.lab.plants.interface import Settings
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.runs.experiment import Experiment

M, N, C, K, KZ, CZ = 0.9, 0.1, 1.0, 40.0, 400.0, 0.2  # of the plant
ASSUMED_M, W, B = 1.0, 5.0, 0.5  # of the controller's model, and of what is wanted
PLANT = f"""
name: two masses
coordinates: {{z: {{unit: mm}}, y: {{unit: m}}}}
inputs: {{u: {{unit: N}}}}
parameters:
  m: {{value: {M}, unit: kg}}
  n: {{value: {N}, unit: kg}}
  c: {{value: {C}, unit: N*s/m}}
  k: {{value: {K}, unit: N/m}}
  kz: {{value: {KZ}, unit: N/m}}
  cz: {{value: {CZ}, unit: N*s/m}}
equations:
  n*z'': -kz*(z - y) - cz*(z' - y')
  m*y'': u - c*y' - k*y + kz*(z - y) + cz*(z' - y')
"""
ONE = f"""
name: one mass
coordinates: {{NAME: {{unit: m}}}}
inputs: {{u: {{unit: N}}}}
parameters: {{m: {{value: {ASSUMED_M}, unit: kg}}, c: {{value: {C}, unit: N*s/m}}, k: {{value: {K}, unit: N/m}}}}
equations: {{m*NAME'': u - c*NAME' - k*NAME}}
"""
WANTED = f"name: softer\ncoordinates: {{w: {{initial: 0.02}}}}\nequations: {{w'': -{W}**2*w - {B}*w'}}\n"
RIG = """
name: rig
model: plant.yaml
sensors: {s: {measures: y, gain: {value: 10, unit: V/m}, unit: V}}
limits: {inputs: {u: {max: 20, unit: N}}}
"""


def made(folder, controller, *, name="y", rig=RIG, more=""):
    """Experiment on two masses, one of which the controller's model has under a name."""
    files = {"plant": PLANT, "one": ONE.replace("NAME", name), "wanted": WANTED, "rig": rig}
    files["experiment"] = (
        "name: one of two masses\nplant: rig.yaml\nvirtual: wanted.yaml\nduration: 2\n"
        f"controller: {{model: one.yaml, {controller}}}\n{more}"
    )
    for stem, text in files.items():
        (folder / f"{stem}.yaml").write_text(text)
    return Experiment.load(folder / "experiment.yaml")


def truth(t, y0, scale=1.0):
    """Masses under the law of the controller's model: w = scale y is to follow its own equation."""

    def moving(_, state):
        z, y, vz, vy = state
        between = KZ * (z - y) + CZ * (vz - vy)
        u = ASSUMED_M * (-(W**2) * y - B * vy) + C * vy + K * y
        return [vz, vy, -between / N, (u - C * vy - K * y + between) / M]

    return solve_ivp(moving, (0.0, t[-1]), y0, t_eval=t, rtol=1e-11, atol=1e-14).y


@pytest.mark.parametrize("transform", ["", "transform: {matrix: [[2]]}\n", "transform: {expressions: {w: 2*y}}\n"])
def test_a_plant_with_a_coordinate_more_moves_as_scipy_says(transform, tmp_path):
    found = made(tmp_path, "rate: continuous", more=transform).run()
    begin = 0.01 if transform else 0.02
    z, y, vz, _ = truth(found.t, [begin, begin, 0.0, 0.0])
    assert found["rig.y"] == pytest.approx(y, abs=1e-9)
    assert found["rig.z"] == pytest.approx(1e3 * z, abs=1e-6)
    assert found["rig.z'"] == pytest.approx(1e3 * vz, abs=1e-5)  # mm/s
    assert found["virtual.w"] == pytest.approx(y * 0.02 / begin, abs=1e-9)


def test_its_own_coordinate_begins_where_the_experiment_says(tmp_path):
    found = made(tmp_path, "rate: continuous", more="initial: {z: 25, z': 100}\n").run()  # mm, mm/s
    z, y, *_ = truth(found.t, [0.025, 0.02, 0.1, 0.0])
    assert found["rig.z"] == pytest.approx(1e3 * z, abs=1e-6)
    assert found["rig.y"] == pytest.approx(y, abs=1e-9)


NAMED = RIG.replace("{s:", "{angle:")
SAMPLED = "rate: 500 Hz, observer: {kind: disturbance, noise: 1e-4}"


@pytest.mark.parametrize("name", ["y", "angle"])
def test_a_coordinate_is_found_by_its_name_or_by_that_of_its_sensor(name, tmp_path):
    """The second runs as the first, whose coordinate has the plant's name, but for rounding."""
    rig = NAMED if name == "angle" else RIG
    found, by_name = made(tmp_path, SAMPLED, name=name, rig=rig).run(), made(tmp_path, SAMPLED).run()
    assert found["rig.y"] == pytest.approx(by_name["rig.y"], abs=1e-14)
    assert found["virtual.w"] == pytest.approx(by_name["virtual.w"], abs=1e-14)
    assert found["virtual.w"] == pytest.approx(found["rig.y"], abs=1e-15)
    assert found["rig.z"][0] == pytest.approx(1e3 * found["rig.y"][0], abs=1e-6)  # at rest, held by the command
    assert found.manifest["masking_error"]["w"] < 0.05


def test_offline_and_step_by_step_are_the_same_numbers(tmp_path):
    experiment = made(tmp_path, SAMPLED + ", homing: 1")
    offline, plant, step = experiment.run(), SimulatedPlant(experiment.twin), experiment.controller()
    plant.configure(Settings(step.rate))
    plant.activate()
    before = experiment.sampled.before
    readings = []
    for _ in range(before + 200):
        sample = plant.read()
        readings.append(sample.values[0])
        plant.write(sample.index, step(sample.values))
    assert readings[before:] == pytest.approx(offline["sensor.s"][:200], abs=1e-12)


def test_the_order_of_coordinates_is_free(tmp_path):
    text = PLANT.replace("two masses", "the same, turned").replace(
        "{z: {unit: mm}, y: {unit: m}}", "{y: {unit: m}, z: {unit: mm}}"
    )
    both = made(tmp_path, "rate: continuous", more="transform: {expressions: {w: y}}\n")
    (tmp_path / "one.yaml").write_text(text)
    found = Experiment.load(tmp_path / "experiment.yaml").run()
    assert both.match.own == ("z",)
    assert found.manifest["masking_error"]["w"] < 1e-9  # its model is the plant's


def test_check_names_what_the_model_does_not_have(tmp_path):
    rig = RIG.replace("sensors: {s:", "sensors: {far: {measures: z, unit: mm}, s:")
    made(tmp_path, SAMPLED, rig=rig)
    (found,) = check(tmp_path / "experiment.yaml")
    assert (
        "z: the plant's own, not in the controller's model one mass (z passive, zero dynamics stable at rest: "
        "63.25 rad/s, damping ratio 0.0158)" in str(found)
    )
    assert "far: not used, the controller's model one mass has nothing that it reads" in str(found)


def test_a_coordinate_that_is_nowhere_is_refused(tmp_path):
    with pytest.raises(
        MaskingError,
        match=r"one mass has the coordinate q: the plant two masses has no coordinate of that name \(z, y\), and no "
        r"sensor of that name that reads a position \(sensors: s\); give the coordinate, or the sensor",
    ):
        made(tmp_path, SAMPLED, name="q").validate()


def test_a_limit_of_what_the_model_does_not_have_is_refused(tmp_path):
    rig = RIG.replace("limits: {", "limits: {coordinates: {y - z: {max: 5, unit: mm}}, ")
    with pytest.raises(
        DeclarationError,
        match=r"rig.yaml:\d+:\d+: limits.coordinates.y - z: z, which the controller's model one mass does not have, "
        "cannot be held to it; limit y, "
        "or add z to the controller's model",
    ):
        made(tmp_path, SAMPLED, rig=rig).validate()


def test_a_coordinate_may_be_any_function_that_a_sensor_reads(tmp_path):
    """The height of a link by its angle: positions, velocities and accelerations by hand."""
    link = (
        "name: link\ncoordinates: {th: {unit: rad}, z: {unit: rad}}\ninputs: {u: {unit: N}}\n"
        "parameters: {l: {value: 2, unit: m}, J: {value: 1, unit: kg*m**2}, w: {value: 3, unit: 1/s}}\n"
        "equations: {th'': u*l/J - w**2*th, z'': w**2*(th - z)}\n"
    )
    rig = "name: rig\nmodel: plant.yaml\nsensors: {y: {measures: l*sin(th), unit: m}}\n"
    rig += "limits: {inputs: {u: {max: 20, unit: N}}}\n"
    experiment = made(tmp_path, SAMPLED, rig=RIG)
    for name, text in (("plant", link), ("rig", rig)):
        (tmp_path / f"{name}.yaml").write_text(text)
    experiment = Experiment.load(tmp_path / "experiment.yaml")
    states, accelerations = (
        np.array([[0.3, 0.1, 0.7, -0.2], [-0.5, 0.0, 0.4, 0.1]]),
        np.array([[0.9, 5.0], [-1.1, 2.0]]),
    )
    found = experiment.match.seen(experiment.sampled_loop.kernels, states, accelerations)
    th, v, a = states[:, 0], states[:, 2], accelerations[:, 0]
    expected = [2 * np.sin(th), 2 * np.cos(th) * v, 2 * np.cos(th) * a - 2 * np.sin(th) * v**2]
    assert found == pytest.approx(np.column_stack(expected), abs=1e-14)
    assert experiment.twin_start[0] == pytest.approx(np.arcsin(0.01), abs=1e-12)
    assert experiment.twin_start[1] == pytest.approx(np.arcsin(0.01), abs=1e-9)  # z rests at th


def test_a_coordinate_of_another_dimension_is_refused(tmp_path):
    experiment = made(tmp_path, SAMPLED)
    text = (
        ONE.replace("NAME", "y")
        .replace("{y: {unit: m}}", "{y: {unit: rad}}")
        .replace("N*s/m", "N*s")
        .replace("N/m", "N")
    )
    (tmp_path / "one.yaml").write_text(text.replace("unit: kg", "unit: kg*m"))
    with pytest.raises(
        MaskingError, match="y is in 1 in the controller's model one mass, and in m in the plant two masses"
    ):
        Experiment.load(tmp_path / "experiment.yaml").validate()
    experiment.validate()
