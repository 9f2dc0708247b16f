"""Everything that may touch hardware, or a file of it: records, excitation, plants, runs.

Safety has one door. `plants.safety_chain` checks each reading and each command, by the limits that
`runs.safety_limits` takes from a plant file; no command of a run is written but behind it: by `runs.realtime`, and by
`plants.serve` (through `plants.served_plant_guard`) for whoever drives a served plant that has limits.
`plants.conformance` alone, which `masking rig check` runs, writes small commands of its own, within the limits of a
plant file where one is given. Before a plant is armed, `runs.self_test` tries it, and `plants.arming` asks its
operator. Where the process that drives it is killed, `plants.zero_after_kill` has the last word.

In: an experiment, a plant or its address, files.
Out: a `Recording`.
Imports: compile, display, model, analysis, control.
"""
