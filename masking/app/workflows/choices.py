"""Values that settings of the verbs may have, for the command line; loads no large package."""

from __future__ import annotations

from typing import get_args

from masking.inference.discovery.discovery_settings import TOLERANCE
from masking.lab.records.input_hold import InputHold

HOLDS = get_args(InputHold)
METHODS = ("least-squares", "kalman")  # of identify
STUDIED = ("model", "experiment")  # kinds of declaration that stability studies
EXPORTED = ("experiment", "plant", "model")  # kinds of declaration that export writes, in the order of preference
TARGETS = ("c", "fmu")  # of export
REALS = ("double", "float")

__all__ = ["EXPORTED", "HOLDS", "METHODS", "REALS", "STUDIED", "TARGETS", "TOLERANCE"]
