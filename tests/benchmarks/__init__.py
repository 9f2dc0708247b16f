"""Benchmarks: `python -m tests.benchmarks` from the top of the repository; never collected by pytest."""
