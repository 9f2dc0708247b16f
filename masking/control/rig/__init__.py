"""The simulated rig: dynamics, sensors, actuators, imperfections, and the allocation of commands.

`twin` is the rig with all that it does wrong, whose laws are in `effects`; its noise is drawn, with the seed of a run,
by `runs.simulated_run` and `plants.simulated`. `assumed_rig` and `sensor_errors` are what a controller knows of it.

In: a declared plant and its model.
Out: the simulated rig (digital twin): dynamics, sensors, actuators, allocation.
Imports: numerics, declaration, effects, codegen, modelling.
"""
