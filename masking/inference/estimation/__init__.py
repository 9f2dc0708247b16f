"""Estimation: parameters fitted to records by least squares and by Kalman filters, and tests of residuals.

`fit` estimates parameters, with their deviations and intervals, by the derivatives of `sensitivity`, from the data of
`identification_data`; `whiteness` says whether the intervals hold, `unit_check` whether a channel has another unit.
`simulation` has the error of a record beside a model, and that of noise alone.

In: records and a simulated rig.
Out: fitted parameters with uncertainties, and tests of residuals.
Imports: numerics, declaration, display, codegen, records, rig.
"""
