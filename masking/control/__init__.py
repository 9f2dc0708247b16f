"""Control: blocks L, D, G and T, the law, observers, instruments, and the closed loop, continuous or sampled.

In: a controller, a model and a plant.
Out: the control law in blocks L, D, G and T, observers, and the closed loop.
Imports: analysis, numerics, declaration, display, codegen, modelling, rig.
"""
