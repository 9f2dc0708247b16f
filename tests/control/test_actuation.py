"""Rigs whose inputs do not reach a virtual coordinate: the derivative in which they do, by hand."""

from __future__ import annotations

import pytest

from masking.control.actuation import check_actuation
from masking.control.blocks import Transform
from masking.errors import ActuationError
from masking.model.declaration import schema
from masking.model.modelling.model import Model

DECLARED = {
    "spring": ({"a": "u - (a - b)", "b": "a - b"}, "in derivative 2 of a, in derivative 4 of b"),
    "damper": ({"a": "u - (a' - b')", "b": "a' - b'"}, "in derivative 2 of a, in derivative 3 of b"),
    "chain": (
        {"a": "u - (a - b)", "b": "a - 2*b + c", "c": "b' - c'"},
        "in derivative 2 of a, in derivative 4 of b, in derivative 5 of c",
    ),
    "apart": ({"a": "u - a", "b": "-b**3"}, "in derivative 2 of a, never in b"),
}


@pytest.mark.parametrize("name", DECLARED)
def test_the_derivative_in_which_an_input_appears_is_said(name):
    motion, words = DECLARED[name]
    content = {"name": name, "coordinates": dict.fromkeys(motion, ""), "inputs": {"u": ""}}
    content["equations"] = {f"{c}''": right for c, right in motion.items()}
    rig = Model(schema.ModelDeclaration.model_validate(content))
    wanted = Model(
        schema.ModelDeclaration.model_validate({"name": "w", "coordinates": {"b": ""}, "equations": {"b''": "-b"}})
    )
    with pytest.raises(ActuationError) as refused:
        check_actuation(rig, Transform(rig, wanted, schema.Transform()))
    remedy = "mask a, or a combination that contains one of them"
    assert str(refused.value).endswith(f"An input appears first {words}: {remedy}")
