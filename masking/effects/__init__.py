"""Physical effects that a model may lack: what each is, where it may sit, and how it is put there.

`EFFECTS` is the dictionary of all of them; `attach` puts one into an element of a declared model; `expressions`,
`parameters` and `unit_of` give the parts from which those of a sensor or an actuator are compiled.
"""

from masking.effects.attachment import Setting, attach, expressions, find, parameters, unit_of
from masking.effects.entries import EFFECTS, Effect, EffectParameter, EffectState

__all__ = [
    "EFFECTS",
    "Effect",
    "EffectParameter",
    "EffectState",
    "Setting",
    "attach",
    "expressions",
    "find",
    "parameters",
    "unit_of",
]
