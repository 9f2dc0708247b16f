"""Modelling: a declared model, its equations, its scales and its compiled functions.

In: a declared model.
Out: its equations, its scales and its compiled functions.
Imports: numerics, declaration, display, effects, codegen.
"""
