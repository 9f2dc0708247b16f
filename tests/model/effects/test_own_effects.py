"""Effects that a model declares: friction that sticks by hand, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from masking.errors import DeclarationError
from masking.lab.runs.experiment import Experiment
from masking.model.modelling.model import load_model

BLOCK = """
name: block on a spring
coordinates: {x: {unit: m, initial: 0.055}}
parameters: {m: {value: 1, unit: kg}, k: {value: 100, unit: N/m}, F: {value: 1, unit: N}}
equations: {m*x'': -k*x}
elements: {guide: {displacement: x, acts: {x: -1}, unit: N}}
effects: {rub: {effect: dry_friction, at: guide, parameters: {fc: F, c: 500, hold: 500}}}
"""
RIG = {
    "cart": "name: cart\ncoordinates: {x: {unit: m}}\ninputs: {u: {unit: N}}\n"
    "parameters: {M: {value: 2, unit: kg}}\nequations: {M*x'': u}\n",
    "rig": "name: rig\nmodel: cart.yaml\nsensors: {s: {measures: x, unit: m}}\n"
    "limits: {inputs: {u: {max: 50, unit: N}}}\n",
    "run": "name: run\nplant: rig.yaml\nvirtual: block.yaml\nduration: 2\n"
    "controller: {rate: 1 kHz, observer: {kind: disturbance, noise: 1.0e-6}}\n",
}


def block(folder, text=BLOCK):
    (folder / "block.yaml").write_text(text)
    return load_model(folder / "block.yaml")


def test_a_block_loses_twice_its_friction_over_the_stiffness_in_each_half_period_and_sticks(tmp_path):
    """Turning points of Coulomb friction: 55, -35, 15, 5 mm; there the spring pulls by less than the friction."""
    half = np.pi / 10.0
    x = block(tmp_path).simulate(np.array([0.0, half, 2 * half, 3 * half, 2.0, 3.0]))["x"]
    assert x == pytest.approx([0.055, -0.035, 0.015, 0.005, 0.005, 0.005], abs=5e-5)
    assert x[-1] == pytest.approx(x[-2], abs=1e-12)


def test_a_rig_without_friction_moves_as_one_that_sticks(tmp_path):
    block(tmp_path)
    for name, text in RIG.items():
        (tmp_path / f"{name}.yaml").write_text(text)
    made = Experiment.load(tmp_path / "run.yaml").run()
    assert made["rig.x"][-1] == pytest.approx(0.005, abs=5e-5)
    assert abs(made["rig.x'"][-1]) < 1e-4
    assert made.manifest["masking_error"]["x"] < 2e-3


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("at: rail", "block.yaml:7:11: effects.rub: block on a spring has no element 'rail'; allowed: guide"),
        ("parameters: {fc: 1}", "effects.rub: the effect dry_friction needs a place: which element; write 'at: guide'"),
        ("at: guide, parameters: {mu: 1}", "effects.rub: the effect 'dry_friction' has no parameter 'mu'"),
    ],
)
def test_an_effect_that_does_not_fit_is_refused_with_its_place(given, said, tmp_path):
    text = BLOCK.replace("at: guide, parameters: {fc: F, c: 500, hold: 500}", given)
    with pytest.raises(DeclarationError) as refused:
        block(tmp_path, text.replace(", F: {value: 1, unit: N}", ""))
    assert said in str(refused.value)
