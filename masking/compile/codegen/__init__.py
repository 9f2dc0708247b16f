"""Symbolic expressions to compiled code: the only place that prints code.

In: symbolic expressions.
Out: compiled functions, kept on disk.
Imports: numerics.

`graph` holds expressions as shared elementary operations, `linear` solves linear systems of them, `printers`
and `taylor` write them as statements, `source` as functions and modules, and `store` keeps modules on disk.
"""
