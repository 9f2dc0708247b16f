"""Physical effects that a model may lack: one dictionary, whose entries hold everything that is known of an effect.

In: the name of an effect, ours or a user's.
Out: its law, parameters and states, and models with it attached.
Imports: declaration.

`EFFECTS` is the dictionary that comes with the package, `load` reads a user's own, and `dictionary` joins them;
`attach` puts an effect into an element of a declared model, `attach_all` several, and `with_own` those that the model
declares; `expressions`, `parameters` and `unit_of` give the parts from which those of a sensor or an actuator are
compiled.
"""

from masking.model.effects.attachment import (
    Attachment,
    Setting,
    attach,
    attach_all,
    expressions,
    parameters,
    unit_of,
    with_own,
)
from masking.model.effects.dictionary import (
    CROSS_DAMPING,
    DELAY,
    EFFECTS,
    FORCE,
    GAINS_AND_ZEROS,
    LATE,
    OFFSET,
    ROUNDING,
    dictionary,
    load,
    own,
)
from masking.model.effects.entry import FAMILIES, SATURATION, Directed, Effect, EffectParameter, Span, Trial

__all__ = [
    "CROSS_DAMPING", "DELAY", "EFFECTS", "FAMILIES", "FORCE", "GAINS_AND_ZEROS", "LATE", "OFFSET", "ROUNDING",
    "SATURATION", "Attachment", "Directed", "Effect", "EffectParameter", "Setting", "Span", "Trial", "attach",
    "attach_all", "dictionary", "expressions", "load", "own", "parameters", "unit_of", "with_own",
]  # fmt: skip
