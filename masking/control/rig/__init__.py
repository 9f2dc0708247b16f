"""The simulated rig: dynamics, sensors, actuators, imperfections, and the allocation of commands.

In: a declared plant and its model.
Out: the simulated rig (digital twin): dynamics, sensors, actuators, allocation.
Imports: numerics, declaration, effects, codegen, modelling.
"""
