"""What a controller knows of its rig's effects."""

import pytest
import yaml

from masking.errors import DeclarationError
from masking.lab.runs.experiment import Experiment

KNOWN = {"rate": "500 Hz", "observer": "disturbance"}


def cart(**controller) -> Experiment:
    return Experiment.load("cart_bristles").changed(controller={**KNOWN, **controller}, duration=2)


def test_an_effect_that_is_named_is_the_same_as_one_that_the_model_declares(tmp_path):
    friction = {"effect": "dry_friction", "at": "guide", "parameters": {"fc": 0.02, "vs": 0.002}}
    path = tmp_path / "rubbing_cart.yaml"
    path.write_text(yaml.safe_dump({"name": "rubbing cart", "extends": "cart", "effects": {"friction": friction}}))
    declared = cart(model=str(path)).run().manifest["masking_error"]["x"]
    named = cart(effects={"friction": True}).run().manifest["masking_error"]["x"]
    assert named == pytest.approx(declared, rel=1e-9)
    assert named < 0.1 * cart().run().manifest["masking_error"]["x"]


def test_it_is_as_strong_as_the_controller_takes_it_to_be():
    model = cart(effects={"friction": {"parameters": {"fc": 0.01}}}).law.model
    assert model.value("friction_fc") == 0.01
    assert cart(effects={"friction": False}).law.model.states == cart().law.model.states
    assert "friction_fc" not in cart(effects={"friction": False}).law.model.parameters


def test_what_sticks_creeps_in_a_controller():
    sticking = {"friction": {"parameters": {"c": 500, "hold": 500}}}
    made = cart(effects=sticking)
    assert made.changed(effects=sticking).plant.states == ("friction_z",)
    assert made.law.model.states == ()


def test_a_model_without_the_place_is_refused_at_its_key(tmp_path):
    path = tmp_path / "bare.yaml"
    content = {
        "name": "bare", "coordinates": {"x": {"unit": "m"}}, "inputs": {"u": {"unit": "A"}},
        "parameters": {"b": {"value": 10, "unit": "N/(kg*A)"}}, "equations": {"x''": "b*u"},
    }  # fmt: skip
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(DeclarationError, match=r"controller\.effects\.friction: bare has no element 'guide'"):
        cart(model=str(path), effects={"friction": True}).validate()
