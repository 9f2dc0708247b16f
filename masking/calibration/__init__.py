"""Calibration: excite a rig, record it, fit its plant file to the records, and judge the fit by one it has not seen."""

from masking.calibration.stages import Calibration, Stage, calibrate

__all__ = ["Calibration", "Stage", "calibrate"]
