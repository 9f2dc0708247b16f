"""Symbolic expressions to compiled code: the only place that prints code.

In: symbolic expressions.
Out: compiled functions, kept on disk.
Imports: numerics, display.

`graph` holds expressions as shared elementary operations, `linear_systems` solves linear systems of them, `printers`
and `llvm_text` write them as statements, `generated_module` as functions and modules, `structs` describes what
kernels take together, and `module_store` keeps modules on disk, as long as `content_hashes` finds them current.
"""
