"""What records say of a rig: parameters, measured curves, and the effect that a model is missing.

`estimation` fits parameters, `procedures` measures a curve or a gain from a record that was made for it, `discovery`
finds what is missing; a delay is found there, as an effect.

In: records, and the model of a rig.
Out: estimates with their uncertainties, and a verdict.
Imports: compile, display, model, analysis, control, lab.
"""
