"""Coefficients of the Runge-Kutta method of Dormand and Prince of order 8(5, 3), with dense output of order 7.

Source: Hairer, Norsett and Wanner (1993), Solving Ordinary Differential Equations I, 2nd ed., section II.5 and II.6;
their Fortran code DOP853, as scipy has its coefficients.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import DOP853

STAGES = DOP853.n_stages
# Rows 0-11: stages; row 12: the solution of order 8; rows 13-15: further stages of the dense output.
A = np.zeros((16, 16))
A[:STAGES, :STAGES], A[STAGES, :STAGES], A[STAGES + 1 :] = DOP853.A, DOP853.B, DOP853.A_EXTRA
C = np.concatenate([DOP853.C, [1.0], DOP853.C_EXTRA])
D, E3, E5 = DOP853.D, DOP853.E3, DOP853.E5
