"""Control: blocks L, D, G and T, the law, observers, instruments, and the closed loop, continuous or sampled.

`law` joins the blocks: T in `transform`, D in `desired_dynamics`, L in `cancellation`, G in `input_curves` and
`rig.allocation`. `relative_degree` decides whether a rig can be masked at all. A controller at a rate is
`sampled_controller`, with an `observer` and `known_instruments`; its step is `numerics.sampled_loop`.

In: a controller, a model and a plant.
Out: the control law in blocks L, D, G and T, observers, and the closed loop.
Imports: analysis, numerics, declaration, display, codegen, modelling, rig.
"""
