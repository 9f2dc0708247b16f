"""Plants: what a controller drives, through one interface, in this process or behind a wire.

In: commands.
Out: readings: a rig, simulated here or behind a wire, through one interface.
Imports: numerics, display, codegen, records, rig.

What an amplifier mixes is the `allocation` of a plant file, which `masking.control.rig.allocation` reads.
"""
