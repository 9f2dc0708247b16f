"""Stability of models and closed loops: equilibria, modes, periodic orbits, energy certificates, Lyapunov exponents."""
