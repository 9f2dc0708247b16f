"""Modelling: a declared model, its equations, its scales and its compiled functions."""
