"""JSON of results: numpy values, complex numbers and paths in, standard JSON out."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from masking.display.json_text import Result, json_text, plain
from masking.errors import RecordError


@dataclass(frozen=True)
class Response(Result):
    """A result with a property among its names."""

    json_names = ("gain", "phases")
    gain: float
    table: np.ndarray

    @property
    def phases(self):
        """Phases of the table, rad."""
        return np.angle(self.table)


def test_a_result_shows_the_names_that_it_lists():
    response = Response(2.0, np.array([1.0, 1.0j]))
    assert response.as_dict() == {"gain": 2.0, "phases": [0.0, pytest.approx(np.pi / 2)]}


def test_values_that_json_lacks():
    content = {"complex": np.array([1.0 - 2.0j]), "path": Path("a/b"), 3: (np.float64("inf"), np.int64(4), None)}
    assert json.loads(json_text(content)) == {"complex": [[1.0, -2.0]], "path": "a/b", "3": ["inf", 4, None]}


def test_what_json_cannot_hold_is_named_with_its_place():
    with pytest.raises(RecordError, match=r"'a\.1' is of type set, which JSON cannot hold"):
        plain({"a": [1, {2}]})
