"""Control: blocks L, D, G and T, the law, observers, instruments, and the closed loop, continuous or sampled.

`law` joins the blocks: T in `transform`, D in `desired_dynamics`, L and G in `cancellation`, with `input_curves` of
inputs that act nonlinearly; `rig.allocation` has the actuators of each input. `relative_degree` decides whether a rig
can be masked at all, and `zero_dynamics` whether what is passive runs away, which `runs.feasibility` reports. A
controller at a rate is `sampled_controller`, with the gains of an `observer` and `known_instruments`; its step, which
observes, predicts over the delay, holds and limits, is `numerics.sampled_loop`.

In: a controller, a model and a plant.
Out: the control law in blocks L, D, G and T, observers, and the closed loop.
Imports: analysis, numerics, declaration, display, codegen, modelling, rig.
"""
