"""Runs: an experiment offline, in real time and on hardware; when it stops, and what limits it.

`experiment` is declared, and runs by `simulated_run`, or by `rig_run` and `realtime` on a rig; `long_run` streams
what is long to disk. `self_test` and `safety_limits` come before; `feasibility` says what fits the limits,
`error_budget` and `remedies` what limits the masking error, `parted_motion` whether chaos or another attractor does.

In: an experiment.
Out: its recording: offline, in real time or on hardware, and what limits it.
Imports: numerics, declaration, display, effects, codegen, modelling, records, analysis, rig, control,
plants, signals.
"""
