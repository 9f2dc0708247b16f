"""Records: recordings and measured tables on disk, their clocks and their noise.

In: files of recordings and measured tables.
Out: columns on one steady clock, and their noise.
Imports: numerics, display.
"""
