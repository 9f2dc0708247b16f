"""Numerics: kernels of integrators and of the sampled loop, and the codes with which they stop.

In: arrays and compiled right-hand sides.
Out: series, and the codes with which a kernel stops.
Imports: nothing.
"""
