"""Records in which a physical effect is hidden, for a benchmark of discovery: plain numpy, nothing of `masking`."""

from tests.benchmarks.hidden.cases import (
    FAMILIES,
    AnyFamily,
    Case,
    Family,
    Truth,
    acceptable,
    answers,
    cases,
    kin,
    truth,
)
from tests.benchmarks.hidden.generate import Record, gaps, generate, load, save
from tests.benchmarks.hidden.simulate import Hidden

__all__ = [
    "FAMILIES",
    "AnyFamily",
    "Case",
    "Family",
    "Hidden",
    "Record",
    "Truth",
    "acceptable",
    "answers",
    "cases",
    "gaps",
    "generate",
    "kin",
    "load",
    "save",
    "truth",
]
