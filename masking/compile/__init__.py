"""From expressions to machine code, and the kernels that it runs.

In: symbolic expressions and sizes.
Out: compiled functions: integrators, the sampled loop, rules of safety, filters.
Imports: display.
"""
