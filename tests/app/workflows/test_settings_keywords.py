"""The verbs as functions: what their signatures and their help show, and how little loading the package takes."""

import inspect
import subprocess
import sys
from dataclasses import fields
from importlib.metadata import version

import pytest

import masking
from masking.inference.discovery.discovery_settings import DiscoverySettings

VERBS = (
    *(
        "animate",
        "calibrate",
        "catalogue",
        "check",
        "compare",
        "discover",
        "export",
        "identify",
        "learn",
        "measure",
        "recover",
        "refine",
        "report",
    ),
    *("run", "show", "simulate", "stability", "sweep", "load_sweep"),
)


@pytest.mark.parametrize("name", VERBS)
def test_help_shows_and_explains_every_parameter_of_a_verb(name):
    verb = getattr(masking, name)
    for parameter in inspect.signature(verb).parameters.values():
        assert parameter.kind is not parameter.VAR_KEYWORD
        assert f"\n        {parameter.name}: " in verb.__doc__ or f"\n    {parameter.name}: " in verb.__doc__


@pytest.mark.parametrize("name", ["discover", "refine"])
def test_a_verb_takes_the_fields_of_its_settings(name):
    verb = getattr(masking, name)
    shown = inspect.signature(verb).parameters
    assert {field.name for field in fields(DiscoverySettings)} | {"plant", "out", "tell"} < set(shown)
    assert shown["tolerance"].default == DiscoverySettings().tolerance
    with pytest.raises(TypeError, match="unexpected keyword argument 'tolerence'"):
        verb("record", tolerence=0.1)


def test_the_package_loads_nothing_before_it_is_used():
    code = (
        "import sys, masking; masking.catalogue();"
        "sys.exit(any(m in sys.modules for m in ('numpy', 'sympy', 'numba', 'pydantic', 'masking.app.workflows')))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


def test_every_name_of_the_package_is_there():
    assert all(getattr(masking, name) is not None for name in masking.__all__)
    assert masking.__version__ == version("masking")
    assert "list" not in masking.__all__
