"""Procedures: springs, friction, actuators, frequency responses and calibration, from records made for them.

`measurement` makes a sentence of what `springs`, `friction`, `actuator_ratio` and `frequency_response` find;
`calibration_findings` compares the models of a calibration.

In: records made for one procedure.
Out: springs, friction, actuators, frequency responses, calibration.
Imports: numerics, declaration, display, modelling, records, analysis, rig, estimation.
"""
