"""Faults: what a rig loop must survive, produced on the served twin of a rig and evaluated by the plant's own record.

In: numbers of faults of the table.
Out: for each what was expected, what was measured, and whether the criterion is met.
Imports: numerics, declaration, records, rig, control, plants, exports, runs, workflows.
"""
