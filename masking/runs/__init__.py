"""Runs: an experiment offline, in real time and on hardware; when it stops, and what limits it."""
