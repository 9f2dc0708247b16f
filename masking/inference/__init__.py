"""What records say of a rig: parameters, measured curves, and the effect that a model is missing.

In: records, and the model of a rig.
Out: estimates with their uncertainties, and a verdict.
Imports: compile, display, model, analysis, control, lab.
"""
