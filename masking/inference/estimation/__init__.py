"""Estimation: parameters fitted to records by least squares and by Kalman filters, and tests of residuals.

In: records and a simulated rig.
Out: fitted parameters with uncertainties, and tests of residuals.
Imports: numerics, declaration, display, codegen, records, rig.
"""
