"""Procedures: springs, actuators and friction of a rig, each from a record made for it.

A slow ramp of force shows the spring and, between its way up and down, friction and hysteresis; two actuators that push
against each other show which is stronger; saw-teeth of growing amplitude show how the equilibrium shifts, and where.
Source: Rijlaarsdam (2008), section 4.2.3, Table B.4, appendices C.5 and C.6.

Records are columns (samples,): time in s, displacement and force in any unit, such as m and V; results are in these.
"""

from masking.procedures.actuators import ActuatorRatio, actuator_ratio
from masking.procedures.friction import EquilibriumShift, LocatedFriction, locate_friction, shift_of_equilibrium
from masking.procedures.springs import SpringCurve, spring_curve

__all__ = [
    "ActuatorRatio",
    "EquilibriumShift",
    "LocatedFriction",
    "SpringCurve",
    "actuator_ratio",
    "locate_friction",
    "shift_of_equilibrium",
    "spring_curve",
]
