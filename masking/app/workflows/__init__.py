"""Workflows: the verbs as functions, files in and files out.

A module is named after its verb. `sweep` decides which rows there still are to make, and `sweep_work` makes them;
`batch_run` is one run of a `batch`; `learn` takes the `learning_steps`, with the records of `calibration_excitation`,
and `learned_rig` writes what was found. `output_folders` refuses folders that hold other results.

In: names of files and settings.
Out: results and files: each verb as a function.
Imports: numerics, declaration, display, effects, modelling, records, signals, analysis, rig, control, plants, exports,
    runs, estimation, discovery, procedures, reports.
"""
