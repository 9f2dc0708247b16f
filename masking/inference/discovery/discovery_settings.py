"""Settings of a discovery, in one frozen object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from masking.errors import DeclarationError, Problem
from masking.inference.discovery.decision_rules import RULES, DecisionRules

TOLERANCE = 0.01  # relative standard deviation of a parameter that declares none


@dataclass(frozen=True, kw_only=True)
class DiscoverySettings:
    """What a discovery is asked with, beside its record.

    Args:
        validation: another record to validate by; if not given, the last 30 % of the record are held out.
        parameters: names of the parameters to re-fit; if empty, all that appear in the equations.
        tolerance: prior standard deviation of a parameter that declares none, relative to its value, between 0 and 1.
        shooting_interval: multiple-shooting interval in s; by default the whole record in one interval, or a
            twentieth of the record for a model that does not settle.
        effects: dictionary of own effects, a file or a packaged name, whose effects are tried, too.
        rules: the thresholds of all decisions.

    Raises:
        DeclarationError: the tolerance is not between 0 and 1.
    """

    validation: str | Path | None = None
    parameters: Sequence[str] = ()
    tolerance: float = TOLERANCE
    shooting_interval: float | None = None
    effects: str | Path | None = None
    rules: DecisionRules = RULES

    def __post_init__(self) -> None:
        if not 0.0 < self.tolerance < 1.0:
            remedy = "give a part between 0 and 1, such as 0.01"
            raise DeclarationError(Problem(None, "tolerance", f"the tolerance is {self.tolerance:g}", remedy))
