"""Reports: facts, sentences, tables, figures, pages and files of each result.

In: results.
Out: their text, figures, pages and files.
Imports: numerics, declaration, display, effects, modelling, records, analysis, rig, estimation, discovery,
procedures.
"""
