"""Procedures: springs, friction, actuators, frequency responses and calibration, from records made for them.

In: records made for one procedure.
Out: springs, friction, actuators, frequency responses, calibration.
Imports: numerics, declaration, display, modelling, records, analysis, rig, estimation.
"""
