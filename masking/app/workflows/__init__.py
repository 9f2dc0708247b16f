"""Workflows: the verbs as functions, files in and files out.

In: names of files and settings.
Out: results and files: each verb as a function.
Imports: numerics, declaration, display, effects, modelling, records, signals, analysis, rig, control, plants, exports,
    runs, estimation, discovery, procedures, reports.
"""
