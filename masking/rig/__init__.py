"""The simulated rig: dynamics, sensors, actuators, imperfections, and the allocation of commands."""
