"""Numerics: kernels of integrators and of the sampled loop, and the codes with which they stop.

Smooth models are integrated by `taylor_integrator`, many at once by `lanes`, and all others by `runge_kutta`, with
`events` and `delayed` expressions; where one gives up, it returns one of the `stop_codes`, which
`codegen.compiled_functions` raises as an error. `motion_sensitivities` are derivatives of a simulated motion,
`least_squares` fits by them. `sampled_loop` is the step of a controller, with `output_hold`, `energy_balance` and
`virtual_memory`; `safety_kernels` decides what a reading or a command breaks.

In: arrays and compiled right-hand sides.
Out: series, and the codes with which a kernel stops.
Imports: nothing.
"""
