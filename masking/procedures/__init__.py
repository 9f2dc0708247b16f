"""Procedures: springs, friction, actuators, frequency responses and calibration, from records made for them."""
