"""Numerics: kernels of integrators and of the sampled loop, and the codes with which they stop."""
