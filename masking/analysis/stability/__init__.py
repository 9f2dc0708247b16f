"""Stability of models and closed loops: equilibria, modes, periodic orbits, energy certificates, Lyapunov exponents.

`study` collects what is found of a model. `equilibria` finds every state of rest in a box by intervals, and its
`stability_of` says which are stable, by eigenvalues of `modes`. What holds of all motions is proved by
`energy_certificate`, from `dissipation`, `boundedness` and `lasalle`. `orbits`, `attractors`, `basins` and
`lyapunov_exponent` are about motions, `transverse` and `settling` about synchronisation.
"""
