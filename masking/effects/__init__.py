"""Physical effects that a model may lack: what each is, where it may sit, and how it is put there.

In: the name of an effect, ours or a user's.
Out: its law, parameters and states, and models with it attached.
Imports: declaration.


`EFFECTS` is the dictionary of all that come with the package, `load` reads a dictionary of one's own, and `dictionary`
puts both together; `attach` puts one into an element of a declared model, `attach_all` several; `expressions`,
`parameters` and `unit_of` give the parts from which those of a sensor or an actuator are compiled.
"""

from masking.effects.attachment import Attachment, Setting, attach, attach_all, expressions, find, parameters, unit_of
from masking.effects.entries import EFFECTS
from masking.effects.entry import Effect, EffectParameter, EffectState
from masking.effects.own import dictionary, load, own

__all__ = [
    "EFFECTS",
    "Attachment",
    "Effect",
    "EffectParameter",
    "EffectState",
    "Setting",
    "attach",
    "attach_all",
    "dictionary",
    "expressions",
    "find",
    "load",
    "own",
    "parameters",
    "unit_of",
]
