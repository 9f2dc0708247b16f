"""The answers of `masking discover` on records of every kind: what was said, whether it is right, and what it took."""
