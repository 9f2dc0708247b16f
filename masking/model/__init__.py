"""Declared dynamics: YAML, physical effects, equations of motion.

In: YAML.
Out: checked declarations, the dictionary of effects, and `Model`.
Imports: compile, display.
"""
