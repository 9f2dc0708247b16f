"""Declarations: YAML files that say what a model, a plant and an experiment are, read strictly and checked whole.

In: YAML files.
Out: checked declarations, or every problem with its place.
Imports: display.
"""
