"""Plants: what a controller drives, through one interface, in this process or behind a wire.

`interface` is what a plant does, `simulated` a twin that does it, `adapters` finds those of an address.
`safety_chain` checks readings, commands and whether ticks come in time, by rules of `numerics.safety_kernels`, and
latches a trip, which `trip_memory` keeps when a server starts again. `serve` lets others drive a plant, one
`controller_session` at a time, and refuses them after a trip until it is acknowledged.

In: commands.
Out: readings: a rig, simulated here or behind a wire, through one interface.
Imports: numerics, display, codegen, records, rig.

What an amplifier mixes is the `allocation` of a plant file, which `masking.control.rig.allocation` reads.
"""
