"""Modelling: a declared model, its equations, its scales and its compiled functions.

In: a declared model.
Out: its equations, its scales and its compiled functions.
Imports: declaration, effects, codegen.
"""
