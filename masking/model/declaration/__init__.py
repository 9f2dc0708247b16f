"""Declarations: YAML files that say what a model, a plant and an experiment are, read strictly and checked whole.

`schema` has their keys, and `schema_errors` says what it refuses, unknown and missing keys; `model_checks`,
`experiment_checks` and `dictionary_checks` are beyond it. `catalogue` finds files by their names, and `registry`
loads them; `units` and `expression` read what values hold, `quantities` writes numbers with units as text.

In: YAML files.
Out: checked declarations, or every problem with its place.
Imports: display.
"""
