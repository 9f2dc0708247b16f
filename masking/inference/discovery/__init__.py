"""Discovery: which physical effect a model is missing, found from a record that it does not reproduce.

In: a record that a model does not reproduce.
Out: the physical effect that the model lacks, and a verdict.
Imports: numerics, declaration, display, effects, codegen, records, signals, rig, estimation.
"""
