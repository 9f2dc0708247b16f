"""Declarations: YAML files that say what a model, a plant and an experiment are, read strictly and checked whole."""
