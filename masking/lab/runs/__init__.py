"""Runs: an experiment offline, in real time and on hardware; when it stops, and what limits it.

In: an experiment.
Out: its recording: offline, in real time or on hardware, and what limits it.
Imports: numerics, declaration, display, effects, codegen, modelling, records, analysis, rig, control,
plants, signals.
"""
