"""Estimation: parameters fitted to records by least squares and by Kalman filters, and tests of residuals."""
