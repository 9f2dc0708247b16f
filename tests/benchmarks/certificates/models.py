"""The corpus: models by group, and all by name."""

from tests.benchmarks.certificates.entry import Entry
from tests.benchmarks.certificates.linear import CIRCULATORY, COINCIDENCES, GAPS, GYROSCOPIC, LINEAR
from tests.benchmarks.certificates.nonlinear import (
    CONSERVATIVE,
    FREE,
    FRICTION,
    HIDDEN,
    NEGATIVE,
    PENDULA,
    SELF_EXCITED,
    TIME,
    WRONG_ENERGY,
)

GROUPS = {
    "linear": LINEAR,
    "coincidences": COINCIDENCES,
    "gyroscopic": GYROSCOPIC,
    "circulatory": CIRCULATORY,
    "gaps": GAPS,
    "hidden motions": HIDDEN,
    "time": TIME,
    "free": FREE,
    "negative stiffness": NEGATIVE,
    "friction": FRICTION,
    "self-excited": SELF_EXCITED,
    "pendula": PENDULA,
    "conservative": CONSERVATIVE,
    "wrong energies": WRONG_ENERGY,
}
CORPUS: dict[str, Entry] = {name: entry for group in GROUPS.values() for name, entry in group.items()}
