"""Analysis of motions: masking error, synchronisation, stability and its proofs.

In: series, or a model.
Out: masking error, synchronisation, stability and its proofs.
Imports: numerics, display, codegen, modelling.
"""
