"""Export: controllers, rigs and models as C and as FMUs.

In: a controller, a rig or a model.
Out: source files and FMUs that compute what the compiled kernels compute.
Imports: numerics, display, codegen, declaration, modelling, rig, control.
"""
