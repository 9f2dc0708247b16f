"""Everything that may touch hardware, or a file of it: records, excitation, plants, runs.

In: an experiment, a plant or its address, files.
Out: a `Recording`.
Imports: compile, display, model, analysis, control.
"""
